"""The study of commands runs at small size, and its robots are what they say."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pinocchio")
pytest.importorskip("mujoco")

import bench_commands as commands
import mujoco
from _commanded_rivals import (
    DELAYS,
    block_covariance,
    branches,
    described_bodies,
    instruments,
    least_squares,
    vectors,
)
from _commanded_robots import TICK, ClosedLoop, Gains, mjcf, recorded
from _undeclared_robots import inverse_dynamics
from bench_bodies import leg

CENTRE = np.array([0.2, 0.5, -0.8])
GAINS = Gains(kp=np.array([20.0, 20.0, 40.0]), kd=np.array([1.0, 1.0, 2.0]))


@pytest.fixture(scope="module")
def case():
    """Return a leg of seed 6: .1 mrad in the loop, a delay of 5 to 10 ms."""
    return commands.draw(6, leg(np.random.default_rng(1)), GAINS, CENTRE, 8.0)


def test_the_simulator_has_the_bodies_and_terms_that_it_is_given(case):
    """MuJoCo's inverse dynamics are Pinocchio's, and armature and damping beside."""
    numbers, nv = case["numbers"], 3
    model = mujoco.MjModel.from_xml_string(mjcf(case["described"], numbers))
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    q, v, a = np.random.default_rng(0).normal(size=(3, 20, nv))
    without = replace(numbers, coulomb=np.zeros(nv))
    expected = commands.torques(without, case["described"], (q, v, a))
    for row in range(len(q)):
        data.qpos, data.qvel, data.qacc = q[row], v[row], a[row]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(data.qfrc_inverse, expected[row], atol=1e-9)


def test_the_log_obeys_the_true_robot(case):
    """Applied torques are those of the true bodies and terms where joints move."""
    log = case["fitted"]
    motion = log.true_q, log.true_v, log.true_a
    true = commands.torques(case["numbers"], case["described"], motion)
    assert (commands.torque_error(log.applied, true, log.true_v) < 0.05).all()
    wrong = inverse_dynamics(case["described"], *motion)
    assert (commands.torque_error(wrong, true, log.true_v) > 0.1).all()


def test_the_simulator_agrees_with_that_of_the_package(case):
    """The package's stepper under the same drive, for one second."""
    from _simulated_models import torque_model

    from sklearn_vbjfa.simulation import simulate_controlled

    described, numbers = case["described"], case["numbers"]
    friction = {
        "viscous": numbers.damping,
        "coulomb": numbers.coulomb,
        "rotor_inertia": numbers.armature,
    }
    robot = torque_model(described, bodies=numbers.bodies, friction=friction)
    rng = np.random.default_rng(3)
    motion = commands.chirps(rng, CENTRE)
    quiet = {"deviation": 0.0, "in_loop": True, "rng": rng}
    log = recorded(described, numbers, GAINS, motion, 1.0, **quiet)
    ticks = TICK * np.arange(1001)
    wanted = motion(np.maximum(ticks + 0.5 * TICK - numbers.delay, 0.0))

    def control(row, q, v):
        return GAINS.torque(wanted[round(row)], q, v)

    made, _ = simulate_controlled(robot, control, CENTRE, np.zeros(3), ticks)
    rows = np.arange(5, 996, 5)
    # The difference is MuJoCo's friction, which gives way slowly where a joint sticks.
    away = np.abs(made[rows, :3] - log.true_q).max(axis=0)
    assert (away < 0.02 * np.ptp(log.true_q, axis=0)).all()


def test_the_closed_loop_repeats_the_log_from_its_commands(case):
    numbers, log = case["numbers"], case["judged"]
    missed = commands.position_errors(numbers, case["described"], GAINS, log)
    late = replace(numbers, delay=numbers.delay + 5e-3)
    later = commands.position_errors(late, case["described"], GAINS, log)
    assert (missed < 0.02 * log.true_q.std(axis=0)).all()
    assert (later > 2 * missed).all()


def test_noise_in_the_loop_moves_the_robot_and_noise_in_the_log_does_not():
    robot = leg(np.random.default_rng(1))
    quiet = commands.draw(6, robot, GAINS, CENTRE, 2.0)["numbers"]
    motion = commands.chirps(np.random.default_rng(0), CENTRE)

    def moved(deviation, in_loop):
        rng = np.random.default_rng(5)
        settings = {"deviation": deviation, "in_loop": in_loop, "rng": rng}
        return recorded(robot, quiet, GAINS, motion, 2.0, **settings)

    still, logged, looped = moved(0.0, True), moved(3e-3, False), moved(3e-3, True)
    np.testing.assert_array_equal(logged.true_q, still.true_q)
    np.testing.assert_allclose((logged.q - logged.true_q).std(), 3e-3, rtol=0.2)
    assert np.abs(looped.true_q - still.true_q).max() > 1e-5


def test_who_knows_all_finds_the_values(case):
    found = commands.oracle(case)
    figures = commands.judge(case, found)
    for name in commands.VALUES:
        assert np.median(np.abs(figures[name])) < 0.05


def test_errors_by_blocks_are_those_of_repetitions():
    """Residuals that stay for a while scatter the estimate more than white ones."""
    rng = np.random.default_rng(0)
    blocks = np.repeat(np.arange(60), 20)
    A = rng.normal(size=(60, 2)).repeat(20, axis=0) + rng.normal(size=(1200, 2))
    found, said = [], []
    for _ in range(300):
        left = rng.normal(size=60).repeat(20) + 0.1 * rng.normal(size=1200)
        coef = np.linalg.lstsq(A, left)[0]
        found.append(coef)
        said.append(np.diag(block_covariance(A, left - A @ coef, blocks)))
    np.testing.assert_allclose(np.mean(said, axis=0), np.var(found, axis=0), rtol=0.2)


def test_tables_have_the_width_of_each_term_by_both_oracles(case):
    results = []
    for way, by_blocks in ((commands.ORACLE, False), (commands.BLOCKS, True)):
        found = commands.oracle(case, by_blocks=by_blocks)
        results.append({"seed": 6, "way": way, **commands.judge(case, found)})
    white, blocks = results
    assert white["armature"] == blocks["armature"]
    assert "delay_width" not in white
    assert blocks["delay_width"][0] > 0
    for result in results:
        result["seconds"] = 1.0
    text = commands.of_intervals(results)
    own = text.splitlines()
    assert any(line.startswith("oracle, blocks") for line in own)
    ratio = np.median(np.array(blocks["damping_width"]) / white["damping_width"])
    assert f"{ratio:.2f}" in text


def test_who_knows_no_body_knows_an_armature_worse(case):
    """But for bodies it knows the same: with these known it is the other oracle."""
    figures = commands.judge(case, commands.oracle_of_bodies(case))
    white = commands.judge(case, commands.oracle(case))
    assert (np.array(figures["armature_width"]) > white["armature_width"]).all()
    log, true = case["fitted"], vectors(case["real"])
    known = true + 1e-6 * np.random.default_rng(0).normal(size=(40, *true.shape))
    motion = log.true_q, log.true_v, log.true_a
    delay = case["numbers"].delay
    found = described_bodies(
        case["described"], GAINS, log, delay, 0.5 * TICK, motion, known
    )
    same = commands.oracle(case)
    for name in ("armature", "damping", "coulomb"):
        deviation = same.deviations[name]
        np.testing.assert_allclose(found.deviations[name], deviation, rtol=0.02)
        away = getattr(found.numbers, name) - getattr(same.numbers, name)
        assert (np.abs(away) < 0.05 * deviation).all()


def test_rivals_run_and_the_delay_is_found(case):
    described, log = case["described"], case["fitted"]
    true = case["numbers"].delay
    grid = least_squares(case["real"], GAINS, log, delays=DELAYS)
    assert abs(grid.numbers.delay - true) < 1.5e-3
    two_stage = instruments(case["real"], GAINS, log)
    assert abs(two_stage.numbers.delay - true) < 1.5e-3
    assert two_stage.deviations["delay"] > 0
    for way in ("package", "least squares, bodies free"):
        figures = commands.judge(case, commands.WAYS[way](described, GAINS, log))
        assert np.isfinite(figures["armature"]).all()
        assert figures["torque"] < 1.0


def test_evolution_comes_closer_with_more_generations(case):
    pytest.importorskip("cma")
    described, log = case["described"], case["fitted"]
    loop = ClosedLoop(described, GAINS, vectors(described))
    errors = []
    for generations in (1, 12):
        found = commands.evolution(
            described, GAINS, log, population=8, generations=generations
        )
        away = loop.positions([found.numbers], log)[0, 0] - log.q
        errors.append(np.sum(away.var(axis=0) / log.q.var(axis=0)))
    assert errors[1] < errors[0]
    found = commands.WAYS["output error"](described, GAINS, log)
    away = loop.positions([found.numbers], log)[0, 0] - log.q
    assert np.sum(away.var(axis=0) / log.q.var(axis=0)) < errors[1]
    assert branches(described) == [[0, 1, 2]]


def test_cells_are_all_there_in_eighteen_seeds():
    assert len({commands.cell_of(seed) for seed in range(5000, 5018)}) == 18


def test_undeclared_frictions_are_those_of_the_package():
    """Their formula, beside the laws of the effects that are to be named."""
    from _commanded_robots import Undeclared

    from sklearn_vbjfa.effects import LoadFriction, Stribeck

    rng = np.random.default_rng(0)
    q, v, a = rng.normal(size=(3, 20, 1))
    load, motion = rng.normal(size=(20, 1)), np.hstack([q, v, a])
    for name, effect in (
        ("load_friction", LoadFriction()),
        ("stribeck", Stribeck(vs=0.3)),
    ):
        own = Undeclared(name=name, size=np.array([2.0]), speed=0.3)
        column = effect.fit(motion).transform(motion, load=load)
        expected = np.sign(v) * own.friction(load, v)
        np.testing.assert_allclose(2.0 * column, expected, atol=1e-12)


def test_a_robot_with_undeclared_friction_needs_more_torque(case):
    from _commanded_robots import Undeclared, load_of

    described, numbers = case["described"], case["numbers"]
    model = mujoco.MjModel.from_xml_string(mjcf(described, numbers))
    model.dof_frictionloss[:] = 0.0
    model.dof_damping[:] = 0.0
    data = mujoco.MjData(model)
    data.qpos, data.qvel = np.random.default_rng(0).normal(size=(2, 3))
    data.ctrl[:] = 1.0
    mujoco.mj_forward(model, data)
    # What is left of one newton metre is the rotors'.
    np.testing.assert_allclose(
        load_of(model, data), 1.0 - numbers.armature * data.qacc, atol=1e-9
    )
    more = Undeclared(name="stribeck", size=np.full(3, 0.5), speed=10.0)
    robot = commands.draw(6, described, GAINS, CENTRE, 3.0, undeclared=more)
    log = robot["fitted"]
    motion = log.true_q, log.true_v, log.true_a
    known = commands.torques(robot["numbers"], described, motion)
    rest = commands.lowpass(log.applied - known)
    rows = commands.moving(log.true_v)
    along = commands.lowpass(np.sign(log.true_v))
    for j in range(3):
        slope = along[rows[:, j], j] @ rest[rows[:, j], j]
        slope /= np.sum(along[rows[:, j], j] ** 2)
        assert 0.35 < slope < 0.6


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_package_follows_commands_with_what_it_found(case):
    import bench_commands_undeclared as undeclared

    none = undeclared.undeclared_of(0, 3)
    robot, effects = undeclared.fitted_by(commands.FIXED, case)
    assert undeclared.named_by(effects, none) == (0, 0)
    found = commands.found_by(robot, case["described"])
    own = undeclared.followed(robot, case)
    theirs = commands.position_errors(
        found.numbers, case["described"], GAINS, case["judged"]
    )
    np.testing.assert_allclose(own, theirs, rtol=0.2)
