"""Position-controlled robots: torques of the control law, its delay, bad input."""

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
    """Return sums of sines: positions, velocities and accelerations, (3, n, 3)."""
    rng = np.random.default_rng(seed)
    out = np.zeros((3, t.size, 3))
    for j in range(3):
        for f in rng.uniform(0.2, 1.5, size=6):
            w, phase = 2 * np.pi * f, rng.uniform(0, 2 * np.pi)
            for k in range(3):
                out[k, :, j] += 0.3 * w**k * np.sin(w * t + phase + 0.5 * np.pi * k)
    return out


def torques(q, v, a):
    """Return the torque for a motion of the arm."""
    rigid = inverse_dynamics(ARM, np.hstack([q, v, a]))
    return rigid + ARMATURE * a + VISCOUS * v


def held_commands(function, t):
    """Return rows that, held for a period, have the mean of a function of time."""
    # Inverse of sin(x) / x, the gain of a mean over DT, as a power series.
    middle, h = t + 0.5 * DT, 0.5 * DT
    values = [function(middle + k * h) for k in range(-2, 3)]
    second = np.tensordot([-1, 16, -30, 16, -1], values, 1) / (12 * h**2)
    fourth = np.tensordot([1, -4, 6, -4, 1], values, 1) / h**4
    return values[2] - DT**2 / 24 * second + 7 * DT**4 / 5760 * fourth


def command(t, delay, kp=KP, ahead=None):
    """Return the commanded positions that make the arm move as `states`, delayed."""

    def required(t):
        q, v, a = states(t)
        feedforward = 0.0 if ahead is None else ahead(t)
        return q + (torques(q, v, a) + KD * v - feedforward) / kp

    return held_commands(required, t + delay)


def record(delay=0.0, duration=12.0, **signals):
    """Return a recording of the arm with its commands."""
    t = DT * np.arange(round(duration / DT))
    q, v, a = states(t)
    recording = take_arrays(
        np.hstack([q, v, a]), np.zeros(q.shape), dt=DT, joint_names=NAMES
    )
    return replace(recording, signals={"q_desired": command(t, delay), **signals})


def identify(recording, drive=None, **settings):
    """Fit unfiltered states."""
    drive = PDDrive(KP, KD) if drive is None else drive
    keywords = {**EXACT, "dt": DT, "drive": drive, **settings}
    if recording.command is None and isinstance(drive, PDDrive):
        recording = drive.driven(recording)
    return RobotIdentifier(ARM, **keywords).fit_recording(recording)


def test_torque_follows_from_the_control_law():
    recording = record()
    driven = PDDrive(KP, KD).driven(recording)
    exact = torques(*np.split(recording.states, 3, axis=1))
    # Commands before the start of the recording are unknown.
    inside = slice(20, -20)
    assert_allclose(driven.tau[inside], exact[inside], rtol=0, atol=1e-4)
    feedback = KP * recording.q + KD * recording.states[:, 3:6]
    assert_allclose(driven.command, driven.tau + feedback, atol=1e-9)
    delayed = PDDrive(KP, KD, delay=0.01).driven(recording).tau
    assert_allclose(driven.torques(0.01)[inside], delayed[inside], atol=1e-4)
    assert driven.torques() is driven.tau


def test_commands_are_held_between_samples():
    """A step command counts half in its own row."""
    aim = np.zeros((60, 3))
    aim[30:] = 1.0
    recording = take_arrays(0 * aim, 0 * aim, dt=DT, joint_names=NAMES)
    recording = replace(recording, signals={"q_desired": aim})
    held = PDDrive(KP, KD).driven(recording).command / KP
    assert_allclose(held[30], 0.5)
    assert_allclose(held[:30].sum(axis=0), (1 - held[31:]).sum(axis=0), atol=1e-9)
    assert_array_equal(PDDrive(KP, KD).commands(recording), KP * aim)


def test_all_control_law_channels_are_used():
    t = DT * np.arange(2000)
    q, v, a = states(t)

    def rate(t):
        return 0.7 * states(t)[1]

    def ahead(t):
        return 0.2 * torques(*states(t))

    signals = {
        "v_desired": held_commands(rate, t),
        "tau_ff": held_commands(ahead, t),
        "kp": 0.0 * q + KP,
        "kd": 0.0 * q + KD,
    }
    recording = record(duration=10.0, **signals)
    recording.signals["q_desired"] = command(
        t, 0.0, ahead=lambda t: KD * rate(t) + ahead(t)
    )
    driven, inside = PDDrive().driven(recording), slice(20, -20)
    assert_allclose(driven.tau[inside], torques(q, v, a)[inside], rtol=0, atol=1e-4)


def test_estimated_velocities_have_the_lag_of_recorded_ones():
    """The lag of the drive's velocity filter is estimated per joint."""
    lag, t = np.array([0.001, 0.004, 0.007]), 0.005 * np.arange(1600)
    q, v, _ = states(t)
    lagged = np.column_stack([states(t - x)[1][:, j] for j, x in enumerate(lag)])
    noise = 0.02 * np.random.default_rng(0).normal(size=v.shape)
    recording = take_arrays(q, 0.0 * q, dt=0.005, joint_names=NAMES)
    recording.signals.update(q_desired=q, v_desired=v)
    driven = PDDrive(0.0, 1.0).driven(replace(recording, v=lagged + noise))
    estimate = driven.command - driven.tau
    error = np.sqrt(((estimate - lagged)[50:-50] ** 2).mean(axis=0))
    unfiltered = np.sqrt(((v - lagged)[50:-50] ** 2).mean(axis=0))
    assert (error < 0.1 * unfiltered).all()


@pytest.mark.parametrize("delay", [-0.004, 0.0, 0.0072, 0.03])
def test_delay_is_estimated(delay):
    robot = identify(record(delay))
    k = robot.parameter_names_.index("drive:delay")
    assert robot.theta_[k] == pytest.approx(delay, abs=1e-5)
    assert 0 < robot.theta_std_[k] < 1e-3
    theta = robot.theta_[:-1].reshape(3, -1)
    assert_allclose(theta[:, 10], VISCOUS, rtol=0.02)
    (effect,) = robot.effects_
    assert isinstance(effect, CommandDelay)
    assert effect.delay == pytest.approx(delay, abs=1e-5)


def one_joint(joint, height=0.0, moment=1e-6):
    """Return a model of a 1 kg body on a joint, without rotor inertia."""
    model, lever = pin.Model(), np.array([0.0, 0.0, height])
    number = model.addJoint(0, joint, pin.SE3.Identity(), "j")
    model.inertias[number] = pin.Inertia(1.0, lever, moment * np.eye(3))
    return model


def simulate_steps(dt, delay, kp=30.0, kd=1.5, moment=0.04, viscous=0.3):
    """Record a joint that follows held commands, by the exact solution."""
    rng, t = np.random.default_rng(3), dt * np.arange(round(40.0 / dt))
    f, phase = rng.uniform(0.2, 1.5, 6), rng.uniform(0, 2 * np.pi, 6)
    aim = 0.2 * np.sin(2 * np.pi * f * t[:, None] + phase).sum(axis=1)
    rows, rest = divmod(delay, dt)
    motion = np.array([[0.0, 1.0], [-kp / moment, -(kd + viscous) / moment]])
    first, second = expm(motion * rest), expm(motion * (dt - rest))
    state, positions = np.array([aim[0], 0.0]), np.empty(t.size)
    for k in range(t.size):
        positions[k] = state[0]
        for transition, rows_back in ((first, rows + 1), (second, rows)):
            target = np.array([aim[max(int(k - rows_back), 0)], 0.0])
            state = target + transition @ (state - target)
    recording = take_arrays(positions[:, None], aim[:, None], dt=dt, joint_names=("j",))
    drive = PDDrive(kp, kd)
    return drive, drive.driven(replace(recording, signals={"q_desired": aim[:, None]}))


@pytest.mark.parametrize("dt", [0.002, 0.005, 1 / 30])
def test_delay_of_held_commands_is_estimated(dt):
    """Within 2 % of the sample period, at most 0.1 ms below 200 Hz."""
    delay, viscous, rotor = 0.0113, 0.3, 0.03
    drive, recording = simulate_steps(dt, delay)
    wheel = one_joint(pin.JointModelRZ(), moment=0.01)
    robot = RobotIdentifier(
        wheel, dt=dt, drive=drive, bodies="fixed", friction=FRICTION
    ).fit_recording(recording)
    terms = dict(zip(robot.parameter_names_, robot.theta_))
    assert abs(terms["drive:delay"] - delay) < max(1e-4, 0.02 * dt)
    assert terms["j:viscous"] == pytest.approx(viscous, rel=0.05)
    assert terms["j:rotor_inertia"] == pytest.approx(rotor, rel=0.05)


def test_known_delay_is_not_a_parameter():
    robot = identify(record(0.012), PDDrive(KP, KD, delay=0.012))
    assert "drive:delay" not in robot.parameter_names_
    wrong = identify(record(0.012), PDDrive(KP, KD, delay=0.0))
    index = robot.parameter_names_.index("joint_2:viscous")
    assert robot.theta_[index] == pytest.approx(VISCOUS[1], rel=0.02)
    # A part of K d: the arm does not follow closely.
    assert VISCOUS[1] + 0.1 < wrong.theta_[index] < VISCOUS[1] + 0.012 * KP[1]


def test_delay_column_is_the_derivative_of_the_torque():
    recording = PDDrive(KP, KD).driven(record(0.01))
    robot = identify(recording)
    step = 1e-4

    slope = (recording.torques(0.01 + step) - recording.torques(0.01 - step)) / (
        2 * step
    )
    plan = replace(robot.robot_.plan, effects=(CommandDelay(delay=0.01),))
    equations = replace(robot.robot_, plan=plan).equations(recording)
    # The column is on the model's side of the equation, so its sign is opposite.
    assert_allclose(equations.Phi[20:-20, :, -1], -slope[20:-20], rtol=1e-4, atol=1e-3)


def test_saturated_samples_have_zero_weight():
    recording = record()
    exact = PDDrive(KP, KD).driven(recording)
    limit = np.quantile(np.abs(exact.tau), 0.8, axis=0)
    driven = PDDrive(KP, KD, saturation=limit).driven(recording)
    saturated = np.abs(exact.tau) >= limit
    assert_array_equal(driven.weight == 0, saturated)
    assert (np.abs(driven.tau) <= limit).all()
    with pytest.raises(ValueError, match=r"at its limit of \S+ for \d+ %"):
        PDDrive(KP, KD, saturation=0.1 * limit).driven(recording)


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
def test_invalid_drive_input_is_refused(case):
    message, options = BAD[case]
    signals = {name: options[name] for name in ("q_desired", "kp") if name in options}
    settings = {name: options[name] for name in ("drive", "gains") if name in options}
    with pytest.raises(ValueError, match=message):
        identify(record(**signals), **settings)


def test_missing_commands_are_refused():
    recording = record()
    del recording.signals["q_desired"]
    with pytest.raises(ValueError, match="needs the channel 'q_desired'"):
        identify(recording)


@pytest.mark.parametrize("drive", [PDDrive(KP, KD), PDDrive(KP, KD, delay=0.09)])
def test_a_delay_longer_than_a_tenth_of_the_motion_is_refused(drive):
    message = (
        r"is 0\.0\d+ s, more than a tenth of a recording of 0\.8 s: .* Record longer"
    )
    with pytest.raises(ValueError, match=message):
        identify(record(0.09, duration=0.8), drive)
    assert np.isfinite(identify(record(0.09, duration=3.0), drive).theta_).all()


@pytest.mark.filterwarnings("error::UserWarning")
def test_encoder_noise_of_a_held_joint_is_not_motion():
    recording = record()
    inputs = recording.inputs.copy()
    noise = 1e-5 * np.random.default_rng(0).normal(size=len(inputs))
    inputs[:, 2], inputs[:, [5, 8]] = 0.5 + noise, 0.0
    held_commands = take_arrays(inputs, recording.tau, dt=DT, joint_names=NAMES)
    aim = recording.signals["q_desired"].copy()
    aim[:, 2] = 0.5
    PDDrive(KP, KD).driven(replace(held_commands, signals={"q_desired": aim}))


# -- noise shared by positions and torques --------------------------------------------


def simulate_pendulum(where, sigma=3e-3, kp=200.0, kd=2.0, seconds=60.0, seed=0):
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


PENDULUM = {"dt": DT, "cutoff": 40.0, "options": FitOptions(state_cutoff=70.0)}
# The pendulum without its rotor inertia of 0.05 kg m^2.
BOB = one_joint(pin.JointModelRY(), -0.2)


@pytest.mark.parametrize("where", ["log", pytest.param("loop", marks=pytest.mark.slow)])
def test_noise_shared_by_inputs_and_torques_is_corrected(where):
    """The encoder noise is either in the control loop or only in the log."""
    drive, recording = simulate_pendulum(where)

    def rotor(recording, **more):
        robot = RobotIdentifier(BOB, drive=drive, bodies="fixed", **PENDULUM, **more)
        robot.fit_recording(recording)
        return robot.theta_[robot.parameter_names_.index("j:rotor_inertia")] / 0.05 - 1

    independent = replace(recording, feedback=None)
    assert abs(rotor(recording)) < 0.02
    # Correcting only the inputs, or nothing, leaves a bias.
    assert rotor(independent) > rotor(recording) + 0.04
    assert rotor(recording, input_noise=None) < -0.5


@pytest.mark.parametrize("where", ["log", pytest.param("loop", marks=pytest.mark.slow)])
def test_commands_are_valid_instruments(where):
    drive, recording = simulate_pendulum(where)
    settings = {"drive": drive, "projector": None, **PENDULUM}

    def bias(regressor):
        """Return relative errors of inertia, damping and dry friction."""
        robot = RobotIdentifier(BOB, regressor=regressor, **settings)
        robot.fit_recording(recording)
        queries = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
        accelerated, at_rest = robot.features_.matrices(queries)[:, 0] @ robot.theta_
        terms = dict(zip(robot.parameter_names_, robot.theta_))
        estimates = [accelerated - at_rest, terms["j:viscous"], terms["j:coulomb"]]
        return np.array(estimates) / [0.09, 0.3, 0.4] - 1

    plain, instrumented = (bias(LinearRegression()), bias(InstrumentalVariables()))
    assert (np.abs(plain) > 0.07).all()
    assert (np.abs(instrumented) < np.abs(plain) / 3).all()


# -- closed-loop simulation from commands ----------------------------------------------


@pytest.mark.slow
def test_closed_loop_simulation_reproduces_the_motion():
    recording = record(0.011, duration=6.0)
    # Holding torques for a period delays them by half of it.
    robot = identify(recording, PDDrive(KP, KD, period=2.5e-4))
    simulated = robot.follow(recording)
    size = np.sqrt((recording.states[:, :3] ** 2).mean(axis=0))
    error = np.sqrt(((simulated - recording.states)[:, :3] ** 2).mean(axis=0))
    assert (error < 2e-3 * size).all()
    # Restart from the recorded state every second.
    restarted = robot.follow(recording, window=1.0)
    rows = np.arange(0, len(restarted), 200)
    assert_array_equal(restarted[rows, :6], recording.states[rows, :6])
    undelayed = replace(recording, signals={"q_desired": command(recording.clock, 0.0)})
    other = robot.follow(undelayed, PDDrive(KP, KD, period=2.5e-4, delay=0.0))
    assert np.abs(other - simulated)[:, :3].max() < np.abs(error).max()


def test_follow_without_a_position_drive_is_refused():
    recording = record()
    robot = RobotIdentifier(ARM, **EXACT, dt=DT)
    robot.fit(recording.states, torques(*np.split(recording.states, 3, axis=1)))
    with pytest.raises(ValueError, match="needs a drive that takes positions"):
        robot.follow(recording)


# -- the closed loop in MuJoCo ---------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("limit", [None, 0.8])
def test_mujoco_matches_the_closed_loop_simulation(tmp_path, limit):
    """Check gains, delay, offset, and a limit that does not clip the offset."""
    recording = record(0.0113, duration=6.0)
    drive = PDDrive(KP, KD, period=2.5e-4)
    # Model files need consistent bodies.
    settings = {"friction": (*FRICTION, "offset"), "projector": "default"}
    robot, path = identify(recording, drive, **settings), tmp_path / "arm.xml"
    if limit is not None:
        most = limit * np.abs(drive.driven(recording).tau).max(axis=0)
        drive = PDDrive(KP, KD, period=2.5e-4, saturation=most)
    assert robot.to_mjcf(path, drive=drive) == ()
    own = robot.follow(recording, drive)[:, :3]
    commands = drive.commands(recording) / KP
    difference = followed(path, recording.states[0, :6], commands, DT) - own
    assert (np.sqrt((difference**2).mean(axis=0)) < 3e-3 * own.std(axis=0)).all()
    if limit is not None:
        free = robot.follow(recording)[:, :3]
        difference = np.sqrt(((free - own) ** 2).mean(axis=0))
        assert (difference > 0.02 * own.std(axis=0)).any()
