"""Simulated robots under control: the equations of motion, their integration, seeds."""

from dataclasses import replace

import numpy as np
import pytest

pin = pytest.importorskip("pinocchio")

from sklearn_vbjfa.datasets import (  # noqa: E402  # noqa: E402  # noqa: E402
    EFFECTS,
    ClosedLoop,
    Gains,
    Recording,
    closed_loop_chunks,
    draw_motion,
    draw_plant,
    load_arm_model,
    load_head_model,
    make_closed_loop_recording,
    rigid_torques,
    simulate_tracking,
)
from sklearn_vbjfa.physical import is_consistent  # noqa: E402


def robot(load=load_head_model, effects=EFFECTS, seed=0, **options):
    """Draw a nominal model, a motion and a robot that differs from the model."""
    nominal, rng = load(), np.random.RandomState(seed)
    motion = draw_motion(nominal, 1.0, 3, rng)
    settings = {"perturbation": 0.25, "effect_size": 1.0, **options}
    plant = draw_plant(nominal, effects=effects, motion=motion, rng=rng, **settings)
    return nominal, motion, plant


def free(plant, state, dt, n, substeps=1):
    """Positions and velocities of the robot without torques or feedback."""
    nothing = np.zeros((n, 1, plant.model.nv))
    gains = Gains(stiffness=nothing[0, 0], damping=nothing[0, 0])
    loop = ClosedLoop(plant, gains, dt, state[None], nothing[0], substeps)
    q, v, *_ = loop.run(nothing, nothing, nothing)
    return q[:, 0], v[:, 0]


@pytest.mark.parametrize("name", ["head", "arm"])
def test_the_robot_follows_its_motion_roughly(name):
    recording = make_closed_loop_recording(
        name, duration=6.0, n_recordings=3, random_state=0
    )
    nv = recording.nv
    model = recording.nominal
    assert isinstance(recording, Recording)
    assert recording.robot_model().nv == nv == {"head": 7, "arm": 10}[name]
    assert recording.n_samples == 3 * 6 * {"head": 420, "arm": 480}[name]
    assert (recording.q < model.upperPositionLimit).all()
    assert (recording.q > model.lowerPositionLimit).all()
    for k, motion in enumerate(recording.motions):
        rows = recording.groups == k
        desired = motion.states(recording.t[rows])
        error = recording.q[rows] - desired[:, :nv]
        share = error.std(axis=0) / desired[:, :nv].std(axis=0)
        # low gains and a wrong model: neither exact nor lost
        assert 0.01 < np.median(share) < 0.5
        assert share.max() < 1.0


def test_true_inertias_differ_as_said_and_exist():
    recording = make_closed_loop_recording("arm", duration=1.0, random_state=0)
    nominal = [body.toDynamicParameters()[0] for body in recording.nominal.inertias[1:]]
    difference = recording.plant.inertial[:, 0] / nominal - 1
    assert 0.1 < np.sqrt(np.mean(difference**2)) < 0.4
    assert is_consistent(recording.plant.inertial).all()
    theta = recording.plant.theta(("viscous", "offset", "rotor_inertia"))
    theta = theta.reshape(10, 13)
    np.testing.assert_array_equal(theta[:, :10], recording.plant.inertial)
    np.testing.assert_array_equal(theta[:, 10], recording.plant.viscous)
    assert not theta[:, 11].any()
    np.testing.assert_array_equal(theta[:, 12], recording.plant.model.armature)


def test_a_free_robot_keeps_its_energy_and_better_with_shorter_steps():
    _, motion, plant = robot(load_arm_model, effects=())
    plant = replace(plant, viscous=np.zeros(10))
    state = motion.states(np.zeros(1))[0]
    data = plant.model.createData()
    nothing = np.zeros(10)
    state[20:] = pin.aba(plant.model, data, state[:10], state[10:20], nothing)
    drift = []
    for substeps in (1, 2, 4):
        rows = zip(*free(plant, state, 1 / 480, 480, substeps))
        energy = [pin.computeMechanicalEnergy(plant.model, data, *row) for row in rows]
        rows = zip(*free(plant, state, 1 / 480, 480, substeps))
        kinetic = [pin.computeKineticEnergy(plant.model, data, *row) for row in rows]
        drift.append(np.ptp(energy) / np.max(kinetic))
    assert drift[0] < 2e-3
    np.testing.assert_allclose(drift[0] / drift[1], 4.0, rtol=0.4)
    np.testing.assert_allclose(drift[1] / drift[2], 4.0, rtol=0.4)


def test_halving_the_step_quarters_the_error():
    nominal, motion, plant = robot()
    fine, *rough = (
        np.concatenate(
            [
                q
                for q, *_ in closed_loop_chunks(
                    plant,
                    nominal,
                    [motion],
                    n=600,
                    dt=1 / 420,
                    encoder_noise=0.0,
                    rng=np.random.RandomState(0),
                    substeps=substeps,
                )
            ]
        )
        for substeps in (16, 1, 2)
    )
    errors = [np.sqrt(np.mean((q - fine) ** 2)) for q in rough]
    # less than the encoder noise of 1e-4 rad
    assert errors[0] < 1e-4
    assert 3.5 < errors[0] / errors[1] < 4.5


def test_forward_and_inverse_dynamics_agree():
    # Inverse dynamics of the motion that the simulated robot made, differentiated.
    _, motion, plant = robot()
    dt, n = 1 / 420, 840
    states = motion.states(np.arange(n) * dt)
    torques = plant.inverse_dynamics(states)
    gains = Gains(stiffness=np.zeros(7), damping=np.zeros(7))
    loop = ClosedLoop(plant, gains, dt, states[:1], torques[:1], substeps=4)
    command = plant.command(torques, dt)[:, None]
    nothing = np.zeros_like(command)
    q, _, behind, _ = loop.run(states[:, None, :7], command, nothing)
    q, behind = q[:, 0], behind[:, 0]
    middle = slice(1, -1)
    v = (q[2:] - q[:-2]) / (2 * dt)
    a = (q[2:] - 2 * q[1:-1] + q[:-2]) / dt**2
    again = plant.inverse_dynamics(np.hstack([q[middle], v, a]))
    error = (again - behind[middle]).std(axis=0) / torques.std(axis=0)
    assert error.max() < 0.02


def test_each_effect_has_its_share_and_can_be_left_out():
    *_, plant = robot()
    assert plant.lag > 0
    for value in (
        plant.coulomb,
        plant.stiction,
        plant.cable_spring,
        plant.cable_hysteresis,
        plant.shell_stiffness,
        plant.model.armature,
    ):
        assert (np.asarray(value) > 0).all()
    _, motion, bare = robot(effects=())
    states = motion.states(np.linspace(0, 5, 200))
    q, v = states[:, :7], states[:, 7:14]
    assert bare.lag == 0
    assert not np.any(bare.cable_torque(q))
    assert not np.any(bare.shell_torque(q))
    assert not np.any(bare.model.armature)
    np.testing.assert_allclose(bare.friction_torque(v), bare.viscous * v)
    _, _, double = robot(effect_size=2.0)
    np.testing.assert_allclose(double.coulomb, 2 * plant.coulomb)
    np.testing.assert_allclose(double.viscous, plant.viscous)
    with pytest.raises(ValueError, match=r"Unknown effect\(s\) \['rust'\]"):
        robot(effects=("rust",))


def test_friction_is_largest_at_creeping_speed():
    *_, plant = robot()
    plant = replace(plant, viscous=np.zeros(7))
    speeds = np.linspace(0, 100, 20001)[:, None] * plant.creep_speed
    torque = plant.friction_torque(speeds)
    np.testing.assert_allclose(torque[-1], plant.coulomb, rtol=0.1)
    assert (torque.max(axis=0) > 1.05 * plant.coulomb).all()
    assert (torque.max(axis=0) < plant.coulomb + plant.stiction).all()
    np.testing.assert_allclose(plant.friction_torque(-speeds), -torque)


def test_cables_lose_energy_on_a_round_trip():
    *_, plant = robot()
    q = plant.cable_rest + 0.5 * np.sin(np.linspace(0, 4 * np.pi, 2001))[:, None]
    torque = plant.cable_torque(q)[1000:]
    work = np.sum(0.5 * (torque[1:] + torque[:-1]) * np.diff(q[1000:], axis=0))
    assert work > 0
    spring = replace(plant, cable_hysteresis=np.zeros(7)).cable_torque(q)[1000:]
    lossless = np.sum(0.5 * (spring[1:] + spring[:-1]) * np.diff(q[1000:], axis=0))
    assert abs(lossless) < 1e-4 * work


def test_a_lagged_command_gives_the_torques_asked_for():
    _, motion, plant = robot(load_arm_model)
    states = motion.states(np.arange(200) / 480)
    torques = plant.inverse_dynamics(states)
    gains = Gains(stiffness=np.zeros(10), damping=np.zeros(10))
    loop = ClosedLoop(plant, gains, 1 / 480, states[:1], torques[:1])
    command = plant.command(torques, 1 / 480)[:, None]
    *_, behind, sent = loop.run(states[:, None, :10], command, 0 * command)
    np.testing.assert_allclose(behind[:, 0], torques, atol=1e-9)
    np.testing.assert_array_equal(sent, command)


def test_commands_stay_within_the_effort_limits():
    _, motion, plant = robot()
    limit = plant.model.effortLimit
    gains = Gains(stiffness=np.zeros(7), damping=np.zeros(7))
    loop = ClosedLoop(
        plant, gains, 1 / 420, motion.states(np.zeros(1)), np.zeros((1, 7))
    )
    much = np.broadcast_to([[10 * limit]], (3, 1, 7))
    *_, sent = loop.run(np.zeros((3, 1, 7)), much, np.zeros((3, 1, 7)))
    np.testing.assert_array_equal(sent, np.broadcast_to(limit, sent.shape))


def test_a_seed_gives_the_same_recording_whatever_the_chunks():
    options = {"duration": 0.5, "n_recordings": 2}
    first, again, other = (
        make_closed_loop_recording("head", random_state=seed, **options)
        for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first.q, again.q)
    np.testing.assert_array_equal(first.tau, again.tau)
    assert not np.array_equal(first.q, other.q)
    # Recordings side by side are made in shorter pieces than one alone.
    quiet = {"encoder_noise": 0.0, "torque_noise": 0.0, "random_state": 0}
    one, pieces = (
        make_closed_loop_recording("head", duration=5.0, n_recordings=n, **quiet)
        for n in (1, 3)
    )
    np.testing.assert_allclose(pieces.select(0).q, one.q, atol=1e-12)
    np.testing.assert_allclose(pieces.select(0).tau, one.tau, atol=1e-12)


def test_a_seed_means_one_robot_however_much_is_recorded():
    first = make_closed_loop_recording("head", duration=0.5, random_state=0)
    longer = make_closed_loop_recording(
        "head", duration=1.0, n_recordings=3, random_state=0
    )
    np.testing.assert_array_equal(longer.plant.theta(), first.plant.theta())
    np.testing.assert_array_equal(longer.plant.cable_rest, first.plant.cable_rest)
    np.testing.assert_array_equal(longer.motions[0].phase, first.motions[0].phase)


def test_noise_enters_torques_as_said_and_through_the_feedback():
    options = {"duration": 4.0, "random_state": 0}
    clean = make_closed_loop_recording("head", torque_noise=0.0, **options)
    noisy = make_closed_loop_recording("head", torque_noise=0.05, **options)
    np.testing.assert_array_equal(noisy.q, clean.q)
    # 1680 samples: a deviation is known to 1.7 %
    np.testing.assert_allclose(
        (noisy.tau - clean.tau).std(axis=0), noisy.torque_noise, rtol=0.08
    )
    np.testing.assert_allclose(noisy.torque_noise, 0.05 * noisy.plant.torque_size)
    command = make_closed_loop_recording("head", torque="commanded", **options)
    np.testing.assert_array_equal(command.q, clean.q)
    # what the robot sees as errors of its encoders is in the commands
    jumps = np.diff(command.tau, 3, axis=0).std(axis=0)
    assert (jumps > 3 * np.diff(clean.tau, 3, axis=0).std(axis=0)).all()


def test_the_same_robot_can_be_moved_again():
    first = make_closed_loop_recording("arm", duration=0.5, random_state=0)
    again = make_closed_loop_recording(
        "arm", duration=0.5, n_recordings=2, plant=first.plant, random_state=1
    )
    assert again.plant is first.plant
    assert not np.array_equal(again.q[:240], first.q)
    second = again.select("motion_2")
    np.testing.assert_array_equal(second.q, again.q[240:])
    assert second.motions == again.motions[1:]


def test_other_robots_will_do():
    model = pin.buildSampleModelManipulator()
    recording = make_closed_loop_recording(model, duration=0.5, random_state=0)
    assert recording.nv == model.nv
    assert recording.urdf is None
    assert recording.robot_model().nv == model.nv
    np.testing.assert_allclose(recording.dt, 1 / 480)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"duration": 0.01}, "are 4 samples; expected at least 16"),
        ({"n_recordings": 0}, "n_recordings must be at least 1"),
        ({"torque": "felt"}, "torque must be one of"),
        ({"effects": ("rust",)}, "Unknown effect"),
        ({"dt": 0.2}, "unstable under its nominal feedforward"),
    ],
)
def test_wrong_options(options, message):
    options = {"duration": 4.0, "random_state": 0, **options}
    with pytest.raises(ValueError, match=message):
        make_closed_loop_recording("head", **options)


def test_a_pinocchio_without_rotor_inertias_is_refused(monkeypatch):
    monkeypatch.setattr(pin, "__version__", "2.7.0")
    with pytest.raises(ImportError, match="need Pinocchio 3"):
        make_closed_loop_recording("head", duration=1.0, random_state=0)


# -- tracking: the true model needs no feedback, a wild one stops the robot


@pytest.fixture(scope="module", params=["head", "arm"])
def recording(request):
    return make_closed_loop_recording(request.param, duration=0.5, random_state=0)


def track(recording, feedforward, **options):
    rng = np.random.RandomState(7)
    motion = draw_motion(recording.nominal, 1.0, 3, rng)
    settings = {"duration": 4.0, "dt": recording.dt, "random_state": 0, **options}
    return simulate_tracking(recording.plant, motion, feedforward, **settings)


def test_the_true_model_needs_no_feedback(recording):
    plant, dt = recording.plant, recording.dt
    result = track(
        recording,
        lambda states: plant.command(plant.inverse_dynamics(states), dt),
        encoder_noise=0.0,
    )
    assert not result.failed
    assert result.duration == pytest.approx(4.0)
    # What is left is the integration of the motion.
    assert (result.feedback_rms < 1e-3 * plant.torque_size).all()
    assert (result.position_rmse < 2e-5).all()
    finer = track(
        recording,
        lambda states: plant.command(plant.inverse_dynamics(states), dt),
        encoder_noise=0.0,
        substeps=4,
    )
    # With finer steps the commands, held for a period, are not exact between samples.
    assert (finer.feedback_rms < 2e-2 * plant.torque_size).all()
    assert (finer.position_rmse < 3e-4).all()


def test_a_better_model_tracks_better(recording):
    plant, nominal = recording.plant, recording.nominal
    true = track(recording, plant.inverse_dynamics)
    declared = track(recording, lambda states: rigid_torques(nominal, states))
    nothing = track(recording, lambda states: 0.0 * states[:, : nominal.nv])
    for better, worse in ((true, declared), (declared, nothing)):
        for a, b in zip(better.averages(), worse.averages()):
            assert 0 < a < b
    n = round(4.0 / recording.dt)
    as_array = track(recording, np.zeros((n, nominal.nv)))
    np.testing.assert_array_equal(as_array.position_rmse, nothing.position_rmse)


def test_a_wild_model_stops_the_robot(recording):
    plant = recording.plant
    for wild, reason in (
        (lambda states: -4.0 * plant.inverse_dynamics(states), "limit|speed"),
        (lambda states: np.full((len(states), plant.model.nv), np.nan), "not a number"),
    ):
        result = track(recording, wild)
        assert result.failed
        assert np.isnan(result.averages()).all()
        assert np.isnan(result.feedback_rms).all()
        assert result.duration < 4.0
        assert any(part in result.failure for part in reason.split("|"))


def test_a_controller_that_is_too_slow_diverges(recording):
    plant = recording.plant
    result = track(recording, plant.inverse_dynamics, dt=0.2, duration=40.0)
    assert result.failed


def test_wrong_shapes(recording):
    with pytest.raises(ValueError, match="feedforward must have shape"):
        track(recording, np.zeros((3, 2)))
    with pytest.raises(ValueError, match="leaves nothing to judge"):
        track(recording, recording.plant.inverse_dynamics, settle=4.0)
