"""Robots that are told positions: torques of the law, its delay, and bad input."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import InstrumentalVariables, RobotIdentifier
from sklearn_vbjfa.effects import CommandDelay
from sklearn_vbjfa.recording import take_arrays
from sklearn_vbjfa.recording._drives import velocities
from sklearn_vbjfa.robot import FitOptions, PDDrive
from tests.effects._arms import arm, inverse_dynamics
from tests.model._mujoco import followed
from tests.robot import EXACT as STATES_ALONE

DT = 0.005
ARM = arm("ZYX")
NAMES = tuple(ARM.names[1:])
KP, KD = np.array([40.0, 60.0, 20.0]), np.array([1.0, 2.0, 0.5])
ARMATURE, VISCOUS = np.array([0.1, 0.2, 0.05]), np.array([0.4, 0.6, 0.2])
FRICTION = ("viscous", "rotor_inertia")
EXACT = {**STATES_ALONE, "friction": FRICTION}


def states(t, seed=0):
    """Make sums of sines at any times: positions, velocities, accelerations."""
    rng = np.random.default_rng(seed)
    out = np.zeros((3, t.size, 3))
    for j in range(3):
        for f in rng.uniform(0.2, 1.5, size=6):
            w, phase = 2 * np.pi * f, rng.uniform(0, 2 * np.pi)
            for k in range(3):
                out[k, :, j] += 0.3 * w**k * np.sin(w * t + phase + 0.5 * np.pi * k)
    return out


def torques(q, v, a):
    """Torque that moves the arm so."""
    rigid = inverse_dynamics(ARM, np.hstack([q, v, a]))
    return rigid + ARMATURE * a + VISCOUS * v


def held(wanted, t):
    """Rows that, held for a period, have the mean of a function of time (n, nv)."""
    # The inverse of the gain of a mean over DT, sin(x) / x, in powers of x.
    middle, h = t + 0.5 * DT, 0.5 * DT
    around = [wanted(middle + k * h) for k in range(-2, 3)]
    second = np.tensordot([-1, 16, -30, 16, -1], around, 1) / (12 * h**2)
    fourth = np.tensordot([1, -4, 6, -4, 1], around, 1) / h**4
    return around[2] - DT**2 / 24 * second + 7 * DT**4 / 5760 * fourth


def command(t, delay, kp=KP, ahead=None):
    """Positions that, a delay later, make the drive move the arm as `states` does."""

    def wanted(t):
        q, v, a = states(t)
        further = 0.0 if ahead is None else ahead(t)
        return q + (torques(q, v, a) + KD * v - further) / kp

    return held(wanted, t + delay)


def told(delay=0.0, duration=12.0, **signals):
    """Record a motion of the arm, with its commands."""
    t = DT * np.arange(round(duration / DT))
    q, v, a = states(t)
    whole = take_arrays(
        np.hstack([q, v, a]), np.zeros(q.shape), dt=DT, joint_names=NAMES
    )
    return replace(whole, signals={"q_desired": command(t, delay), **signals})


def identify(recording, drive=None, **settings):
    """Fit to states without a filter."""
    drive = PDDrive(KP, KD) if drive is None else drive
    given = {**EXACT, "dt": DT, "drive": drive, **settings}
    if recording.command is None and isinstance(drive, PDDrive):
        recording = drive.driven(recording)
    return RobotIdentifier(ARM, **given).fit_recording(recording)


def delay_of(robot):
    """Return the delay and its deviation."""
    k = robot.parameter_names_.index("drive:delay")
    return robot.theta_[k], robot.theta_std_[k]


def test_the_law_makes_the_torque():
    recording = told()
    found = PDDrive(KP, KD).driven(recording)
    exact = torques(*np.split(recording.states, 3, axis=1))
    # What was commanded before the recording is not known.
    inside = slice(20, -20)
    assert_allclose(found.tau[inside], exact[inside], rtol=0, atol=1e-4)
    feedback = KP * recording.q + KD * recording.states[:, 3:6]
    assert_allclose(found.command, found.tau + feedback, atol=1e-9)
    later = PDDrive(KP, KD, delay=0.01).driven(recording).tau
    assert_allclose(found.torques(0.01)[inside], later[inside], atol=1e-4)
    assert found.torques() is found.tau


def test_a_command_acts_until_the_next_one():
    """A step, written out: halfway in its row, there before and after."""
    aim = np.zeros((60, 3))
    aim[30:] = 1.0
    recording = take_arrays(0 * aim, 0 * aim, dt=DT, joint_names=NAMES)
    recording = replace(recording, signals={"q_desired": aim})
    found = PDDrive(KP, KD).driven(recording).command / KP
    assert_allclose(found[30], 0.5)
    assert_allclose(found[:30].sum(axis=0), (1 - found[31:]).sum(axis=0), atol=1e-9)
    assert_array_equal(PDDrive(KP, KD).commands(recording), KP * aim)


def test_all_channels_of_the_law_are_used():
    t = DT * np.arange(2000)
    q, v, a = states(t)

    def rate(t):
        return 0.7 * states(t)[1]

    def ahead(t):
        return 0.2 * torques(*states(t))

    beside = {
        "v_desired": held(rate, t),
        "tau_ff": held(ahead, t),
        "kp": 0.0 * q + KP,
        "kd": 0.0 * q + KD,
    }
    recording = told(duration=10.0, **beside)
    recording.signals["q_desired"] = command(
        t, 0.0, ahead=lambda t: KD * rate(t) + ahead(t)
    )
    found, inside = PDDrive().driven(recording), slice(20, -20)
    assert_allclose(found.tau[inside], torques(q, v, a)[inside], rtol=0, atol=1e-4)


def test_a_velocity_is_as_late_as_the_recorded_one():
    """Drives filter theirs: by how much is found, joint by joint."""
    lag, t = np.array([0.001, 0.004, 0.007]), 0.005 * np.arange(1600)
    q, v, _ = states(t)
    late = np.column_stack([states(t - x)[1][:, j] for j, x in enumerate(lag)])
    noise = 0.02 * np.random.default_rng(0).normal(size=v.shape)
    recording = take_arrays(q, 0.0 * q, dt=0.005, joint_names=NAMES)
    found = velocities(replace(recording, v=late + noise))
    away = np.sqrt(((found - late)[50:-50] ** 2).mean(axis=0))
    plain = np.sqrt(((v - late)[50:-50] ** 2).mean(axis=0))
    assert (away < 0.1 * plain).all()


@pytest.mark.parametrize("delay", [-0.004, 0.0, 0.0072, 0.03])
def test_the_delay_is_found(delay):
    """Between samples, of commands that are known for the time before."""
    robot = identify(told(delay))
    found, std = delay_of(robot)
    assert found == pytest.approx(delay, abs=1e-5)
    assert 0 < std < 1e-3
    theta = robot.theta_[:-1].reshape(3, -1)
    assert_allclose(theta[:, 10], VISCOUS, rtol=0.02)
    (effect,) = robot.effects_
    assert isinstance(effect, CommandDelay)
    assert effect.delay == pytest.approx(delay, abs=1e-5)


def one_joint(joint, height=0.0, moment=1e-6):
    """Describe a body of 1 kg on a joint, without the joint's rotor."""
    model, lever = pin.Model(), np.array([0.0, 0.0, height])
    number = model.addJoint(0, joint, pin.SE3.Identity(), "j")
    model.inertias[number] = pin.Inertia(1.0, lever, moment * np.eye(3))
    return model


def stepped(dt, delay, kp=30.0, kd=1.5, moment=0.04, viscous=0.3):
    """Solve exactly how a joint follows commands that are held, and log both."""
    rng, t = np.random.default_rng(3), dt * np.arange(round(40.0 / dt))
    f, phase = rng.uniform(0.2, 1.5, 6), rng.uniform(0, 2 * np.pi, 6)
    aim = 0.2 * np.sin(2 * np.pi * f * t[:, None] + phase).sum(axis=1)
    rows, rest = divmod(delay, dt)
    motion = np.array([[0.0, 1.0], [-kp / moment, -(kd + viscous) / moment]])
    first, second = expm(motion * rest), expm(motion * (dt - rest))
    now, found = np.array([aim[0], 0.0]), np.empty(t.size)
    for k in range(t.size):
        found[k] = now[0]
        for jump, ago in ((first, rows + 1), (second, rows)):
            reached = np.array([aim[max(int(k - ago), 0)], 0.0])
            now = reached + jump @ (now - reached)
    recording = take_arrays(found[:, None], aim[:, None], dt=dt, joint_names=("j",))
    drive = PDDrive(kp, kd)
    return drive, drive.driven(replace(recording, signals={"q_desired": aim[:, None]}))


@pytest.mark.parametrize("dt", [0.002, 0.005, 1 / 30])
def test_the_delay_of_commands_that_are_held_is_found(dt):
    """Within 2 % of the sample period, at most 0.1 ms below 200 Hz."""
    delay, viscous, rotor = 0.0113, 0.3, 0.03
    drive, recording = stepped(dt, delay)
    wheel = one_joint(pin.JointModelRZ(), moment=0.01)
    robot = RobotIdentifier(
        wheel, dt=dt, drive=drive, bodies="fixed", friction=FRICTION
    ).fit_recording(recording)
    terms = dict(zip(robot.parameter_names_, robot.theta_))
    assert abs(terms["drive:delay"] - delay) < max(1e-4, 0.02 * dt)
    assert terms["j:viscous"] == pytest.approx(viscous, rel=0.05)
    assert terms["j:rotor_inertia"] == pytest.approx(rotor, rel=0.05)


def test_a_known_delay_is_no_parameter():
    robot = identify(told(0.012), PDDrive(KP, KD, delay=0.012))
    assert "drive:delay" not in robot.parameter_names_
    wrong = identify(told(0.012), PDDrive(KP, KD, delay=0.0))
    at = robot.parameter_names_.index("joint_2:viscous")
    assert robot.theta_[at] == pytest.approx(VISCOUS[1], rel=0.02)
    # A part of K d: the arm does not follow closely.
    assert VISCOUS[1] + 0.1 < wrong.theta_[at] < VISCOUS[1] + 0.012 * KP[1]


def test_the_column_is_the_derivative_by_the_delay():
    recording = PDDrive(KP, KD).driven(told(0.01))
    robot = identify(recording)
    step = 1e-4

    slope = (recording.torques(0.01 + step) - recording.torques(0.01 - step)) / (
        2 * step
    )
    at = replace(robot.robot_.plan, effects=(CommandDelay(delay=0.01),))
    made = replace(robot.robot_, plan=at).equations(recording)
    # The law moves by minus what the column adds to the model.
    assert_allclose(made.Phi[20:-20, :, -1], -slope[20:-20], rtol=1e-4, atol=1e-3)


def test_saturated_samples_count_nothing():
    recording = told()
    exact = PDDrive(KP, KD).driven(recording)
    most = np.quantile(np.abs(exact.tau), 0.8, axis=0)
    found = PDDrive(KP, KD, saturation=most).driven(recording)
    full = np.abs(exact.tau) >= most
    assert_array_equal(found.weight == 0, full)
    assert (np.abs(found.tau) <= most).all()
    with pytest.raises(ValueError, match=r"at its limit of \S+ for \d+ %"):
        PDDrive(KP, KD, saturation=0.1 * most).driven(recording)


BAD = {
    "no drive": ("drive must be a PDDrive, CurrentDrive", {"drive": "pd"}),
    "gains of channels": ("cannot be combined with gains", {"gains": "unknown"}),
    "no kp": ("kp is missing: give kp=", {"drive": PDDrive(kd=KD)}),
    "negative": ("kd must not be negative", {"drive": PDDrive(KP, -KD)}),
    "by name": (
        "one key in each joint's name; 0 of 'joint_1' are in 'joint_2'",
        {"drive": PDDrive({"joint_1": 1.0}, KD)},
    ),
    "delay": ("'auto' or a time in s", {"drive": PDDrive(KP, KD, delay="long")}),
    "recorded gains": (
        "kp must not be negative",
        {"drive": PDDrive(), "kp": np.full((2400, 3), -1.0)},
    ),
    "constant": (
        "commands are constant while joints move",
        {"q_desired": np.full((2400, 3), 0.5)},
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named(case):
    message, given = BAD[case]
    signals = {name: given[name] for name in ("q_desired", "kp") if name in given}
    settings = {name: given[name] for name in ("drive", "gains") if name in given}
    with pytest.raises(ValueError, match=message):
        identify(told(**signals), **settings)


def test_commands_are_needed():
    recording = told()
    del recording.signals["q_desired"]
    with pytest.raises(ValueError, match="needs the channel 'q_desired'"):
        identify(recording)


@pytest.mark.parametrize("drive", [PDDrive(KP, KD), PDDrive(KP, KD, delay=0.09)])
def test_a_delay_longer_than_a_tenth_of_the_motion_is_refused(drive):
    message = (
        r"is 0\.0\d+ s, more than a tenth of a recording of 0\.8 s: .* Record longer"
    )
    with pytest.raises(ValueError, match=message):
        identify(told(0.09, duration=0.8), drive)
    assert np.isfinite(identify(told(0.09, duration=3.0), drive).theta_).all()


@pytest.mark.filterwarnings("error::UserWarning")
def test_a_joint_that_is_held_does_not_move_for_the_noise_of_its_encoder():
    recording = told()
    inputs = recording.inputs.copy()
    noise = 1e-5 * np.random.default_rng(0).normal(size=len(inputs))
    inputs[:, 2], inputs[:, [5, 8]] = 0.5 + noise, 0.0
    held = take_arrays(inputs, recording.tau, dt=DT, joint_names=NAMES)
    aim = recording.signals["q_desired"].copy()
    aim[:, 2] = 0.5
    PDDrive(KP, KD).driven(replace(held, signals={"q_desired": aim}))


# -- noise that positions and torques have in common ----------------------------------


def pendulum(where, sigma=3e-3, kp=200.0, kd=2.0, seconds=60.0, seed=0):
    """Simulate a joint under its drive at 1 kHz, commanded and logged at 200 Hz."""
    rng = np.random.default_rng(seed)
    weight, moment, viscous, coulomb = 1.962, 0.09, 0.3, 0.4
    dt, sub = 1e-3, 4
    t = dt * np.arange(round(seconds / dt))
    f, phase = rng.uniform(0.2, 2.5, 8), rng.uniform(0, 2 * np.pi, 8)
    aim = (0.25 / np.sqrt(f) * np.sin(2 * np.pi * f * t[:, None] + phase)).sum(axis=1)
    aim = np.repeat(aim[::5], 5)
    noise = sigma * rng.normal(size=t.size)
    rows, q, v = np.empty((t.size, 2)), 0.0, 0.0
    for i in range(t.size):
        read = q + noise[i]
        tau = kp * (aim[i] - (read if where == "loop" else q)) - kd * v
        rows[i] = read, v
        for _ in range(sub):
            dry = coulomb * np.tanh(v / 0.005)
            v += (tau - weight * np.sin(q) - viscous * v - dry) / moment * dt / sub
            q += v * dt / sub
    (q, v), aim = rows[::5].T, aim[::5]
    recording = take_arrays(q[:, None], 0.0 * q[:, None], dt=DT, joint_names=("j",))
    signals = {"q_desired": aim[:, None]}
    recording = replace(recording, v=v[:, None], signals=signals)
    drive = PDDrive(kp, kd, delay=0.0, period=dt)
    return drive, drive.driven(recording)


SWUNG = {"dt": DT, "cutoff": 40.0, "options": FitOptions(state_cutoff=70.0)}
# The pendulum but for its rotor of 0.05 kg m^2.
BOB = one_joint(pin.JointModelRY(), -0.2)


@pytest.mark.parametrize("where", ["log", pytest.param("loop", marks=pytest.mark.slow)])
def test_noise_in_inputs_and_torques_is_taken_off_both(where):
    """Whether the controller applied the encoder's noise, or the log alone has it."""
    drive, recording = pendulum(where)

    def rotor(recording, **more):
        robot = RobotIdentifier(BOB, drive=drive, bodies="fixed", **SWUNG, **more)
        robot.fit_recording(recording)
        return robot.theta_[robot.parameter_names_.index("j:rotor_inertia")] / 0.05 - 1

    apart = replace(recording, feedback=None)
    assert abs(rotor(recording)) < 0.02
    # of the inputs alone, and of none
    assert rotor(apart) > rotor(recording) + 0.04
    assert rotor(recording, input_noise=None) < -0.5


@pytest.mark.parametrize("where", ["log", pytest.param("loop", marks=pytest.mark.slow)])
def test_commands_are_instruments_of_the_motion(where):
    drive, recording = pendulum(where)
    settings = {"drive": drive, "projector": None, **SWUNG}

    def off(regressor):
        """How far inertia, damping and dry friction are off, as shares."""
        robot = RobotIdentifier(BOB, regressor=regressor, **settings)
        robot.fit_recording(recording)
        asked = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
        pushed, still = robot.features_.matrices(asked)[:, 0] @ robot.theta_
        terms = dict(zip(robot.parameter_names_, robot.theta_))
        found = [pushed - still, terms["j:viscous"], terms["j:coulomb"]]
        return np.array(found) / [0.09, 0.3, 0.4] - 1

    plain, instrumented = off(LinearRegression()), off(InstrumentalVariables())
    assert (np.abs(plain) > 0.07).all()
    assert (np.abs(instrumented) < np.abs(plain) / 3).all()


# -- the closed loop, from commands alone ----------------------------------------------


@pytest.mark.slow
def test_a_robot_follows_its_commands_as_it_did():
    recording = told(0.011, duration=6.0)
    # Torques are held for a period, which is a delay of half of it.
    robot = identify(recording, PDDrive(KP, KD, period=2.5e-4))
    whole = robot.follow(recording)
    moved = np.sqrt((recording.states[:, :3] ** 2).mean(axis=0))
    left = np.sqrt(((whole - recording.states)[:, :3] ** 2).mean(axis=0))
    assert (left < 2e-3 * moved).all()
    # from every second's state again
    windows = robot.follow(recording, window=1.0)
    rows = np.arange(0, len(windows), 200)
    assert_array_equal(windows[rows, :6], recording.states[rows, :6])
    late = replace(recording, signals={"q_desired": command(recording.clock, 0.0)})
    other = robot.follow(late)
    assert np.abs(other - whole)[:, :3].max() > 10 * np.abs(left).max()


def test_what_follows_nothing_is_refused():
    recording = told()
    robot = RobotIdentifier(ARM, **EXACT, dt=DT)
    robot.fit(recording.states, torques(*np.split(recording.states, 3, axis=1)))
    with pytest.raises(ValueError, match="needs a drive that takes positions"):
        robot.follow(recording)


# -- the closed loop in MuJoCo ---------------------------------------------------------


def real(recording, drive=None, **settings):
    """Fit bodies that can be, which files must have."""
    return identify(recording, drive, projector="default", **settings)


def follows(robot, recording, path, **given):
    """Write the robot; return what MuJoCo and the package make of its commands."""
    drive = given.get("drive", robot.drive)
    left = robot.to_mjcf(path, **given)
    ahead = drive.commands(recording) / KP
    found = followed(path, recording.states[0, :6], ahead, DT)
    return found, robot.follow(recording, drive)[:, :3], left


def assert_same_motion(found, expected):
    """Compare positions (n, nv), by a share of how far each joint moves."""
    left = np.sqrt(((found - expected) ** 2).mean(axis=0))
    assert (left < 3e-3 * expected.std(axis=0)).all()


@pytest.mark.slow
@pytest.mark.parametrize("limit", [None, 0.8])
def test_mujoco_follows_commands_as_the_package_does(tmp_path, limit):
    """Gains, delay, an offset, and a limit that acts on the law and not on it."""
    recording = told(0.0113, duration=6.0)
    drive = PDDrive(KP, KD, period=2.5e-4)
    robot = real(recording, drive, friction=(*FRICTION, "offset"))
    if limit is not None:
        most = limit * np.abs(drive.driven(recording).tau).max(axis=0)
        drive = PDDrive(KP, KD, period=2.5e-4, saturation=most)
    mujoco, own, left = follows(robot, recording, tmp_path / "arm.xml", drive=drive)
    assert left == ()
    assert_same_motion(mujoco, own)
    if limit is not None:
        free = robot.follow(recording)[:, :3]
        away = np.sqrt(((free - own) ** 2).mean(axis=0))
        assert (away > 0.02 * own.std(axis=0)).any()
