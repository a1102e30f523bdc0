"""Designed motions: rivals touch their limits, robots obey their laws, tables judge."""

from types import SimpleNamespace

import _design_motions as motions
import _design_robots as robots
import numpy as np
import pytest

pytest.importorskip("pinocchio")

import bench_design_condition as condition
import bench_design_intervals as intervals
import bench_design_rivals as rivals
from _undeclared_effects import ADDED, World
from _undeclared_robots import inverse_dynamics, nominal_robot

PERIOD, HARMONICS = 4.0, 4


@pytest.fixture
def arm():
    return nominal_robot("serial", np.random.default_rng(0), nv=3)


def limits(torque=1e9):
    return motions.Limits(
        position=np.array([[-1.0, 2.0], [0.0, 1.0], [-0.5, 0.5]]),
        velocity=np.array([2.0, 3.0, 1.0]),
        acceleration=np.array([6.0, 4.0, 50.0]),
        torque=np.full(3, torque),
    )


def stand_in(seed):
    """Put a random motion in the place of the designed one."""

    def design(source, limits, duration, dt, seed_of_robot):
        torque = motions.identified(getattr(source, "identifier_", source))
        rng = np.random.default_rng(seed)
        made = motions.random_motion(torque, limits, duration, HARMONICS, rng)
        return made, HARMONICS, {"within_limits": True}

    return design


# -- motions


def test_random_motions_stand_still_at_their_ends(arm):
    motion = motions.draw_series(limits(), PERIOD, HARMONICS, np.random.default_rng(1))
    for time in (0.0, PERIOD):
        _, v, a = motion.at(np.array([time]))
        np.testing.assert_allclose(v, 0.0, atol=1e-9)
        np.testing.assert_allclose(a, 0.0, atol=1e-9)


def test_velocities_and_accelerations_are_derivatives():
    motion = motions.draw_series(limits(), PERIOD, HARMONICS, np.random.default_rng(2))
    t, h = np.linspace(0.0, PERIOD, 50), 1e-5
    _, v, a = motion.at(t)
    before, after = motion.at(t - h), motion.at(t + h)
    np.testing.assert_allclose((after[0] - before[0]) / (2 * h), v, atol=1e-6)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * h), a, atol=1e-5)


def test_every_joint_touches_its_nearest_limit(arm):
    made = motions.random_motion(
        motions.rigid(arm), limits(), PERIOD, HARMONICS, np.random.default_rng(3)
    )
    margins = limits().margins(*made.at(np.linspace(0, PERIOD, 4001)), np.zeros((1, 3)))
    nearest = np.min([margins[k] for k in ("position", "velocity", "acceleration")], 0)
    np.testing.assert_allclose(nearest, 0.0, atol=6e-3)


def test_torque_limits_shrink_all_joints_together(arm):
    free = motions.random_motion(
        motions.rigid(arm), limits(), PERIOD, HARMONICS, np.random.default_rng(3)
    )
    t = np.linspace(0, PERIOD, 401)
    peak = np.abs(inverse_dynamics(arm, *free.at(t))).max(axis=0)
    held = inverse_dynamics(arm, free.centre[None], np.zeros((1, 3)), np.zeros((1, 3)))
    tight = motions.Limits(
        limits().position,
        limits().velocity,
        limits().acceleration,
        np.maximum(0.9 * peak, 1.2 * np.abs(held[0])),
    )
    made = motions.random_motion(
        motions.rigid(arm), tight, PERIOD, HARMONICS, np.random.default_rng(3)
    )
    load = np.abs(inverse_dynamics(arm, *made.at(t))) / tight.torque
    assert 0.97 < load.max() < 1.01


def test_margins_by_hand():
    bounds = limits(torque=10.0)
    q = np.array([[0.5, 0.25, 0.0], [1.25, 0.5, 0.25]])
    v = np.array([[1.0, 0.0, 0.5], [-1.5, 0.3, 0.0]])
    found = bounds.margins(q, v, np.zeros((2, 3)), np.array([[5.0, -8.0, 0.0]]))
    np.testing.assert_allclose(found["position"], [0.5, 0.5, 0.5])
    np.testing.assert_allclose(found["velocity"], [0.25, 0.9, 0.5])
    np.testing.assert_allclose(found["acceleration"], 1.0)
    np.testing.assert_allclose(found["torque"], [0.5, 0.2, 1.0])


def test_the_poor_part_lies_in_the_middle():
    part = limits().part(range_share=0.5, speed_share=0.25, acceleration_share=0.1)
    np.testing.assert_allclose(part.position[0], [-0.25, 1.25])
    np.testing.assert_allclose(part.velocity, [0.5, 0.75, 0.25])


def test_the_highest_harmonic_is_read_off_a_motion():
    made = motions.draw_series(limits(), PERIOD, 7, np.random.default_rng(4))
    assert motions.top_harmonic(made, PERIOD) == 7


# -- robots


@pytest.mark.parametrize("kind", robots.KINDS)
def test_an_executed_motion_obeys_the_law_of_its_effect(kind):
    robot = robots.draw_robot(kind, 3.0, 5, n_joints=(2,))
    motion = motions.random_motion(
        motions.rigid(robot.nominal),
        robot.limits,
        5.0,
        HARMONICS,
        np.random.default_rng(6),
    )
    made = robots.execute(robot, motion, 5.0, 0.01, np.random.default_rng(7))
    # between reversals, where a step of the integration turns with the friction
    nv = robot.model.nv
    moving = np.abs(made.states[:, nv : 2 * nv]).min(axis=1) > 0.05
    error = (robots.inverse(robot, made, 0.01) - made.torque) / robot.torque_noise
    size = np.sqrt(np.mean(error[moving][20:] ** 2))
    # bristles remember what happened between the rows
    assert size < (0.5 if kind == "presliding" else 0.1)


@pytest.mark.parametrize(
    "kind", [k for k in robots.KINDS if k not in ("presliding", "rotor_inertia")]
)
def test_laws_are_those_of_the_other_studies(kind, arm):
    t = np.arange(400) * 0.01
    made = motions.draw_series(limits(), PERIOD, HARMONICS, np.random.default_rng(8))
    q, v, a = made.at(t)
    rigid = inverse_dynamics(arm, q, v, a)
    world = World(
        model=arm,
        q=q,
        v=v,
        a=a,
        t=t,
        dt=0.01,
        groups=np.zeros(400, dtype=int),
        rigid=rigid,
        declared_torque=rigid,
        declared=("viscous", "coulomb"),
        unit=np.ones(3),
    )
    drawn = ADDED[kind](world, 1, np.random.default_rng(9))
    law = robots.law(kind, {**drawn.fixed, **drawn.scaled}, 1, 0.01)
    found = []
    for i in range(400):
        smooth, dry = law(q[i], v[i], a[i], rigid[i])
        found.append(smooth + dry * np.tanh(v[i, 1] / 0.01))
    np.testing.assert_allclose(found, drawn.torque, atol=1e-9)


def test_bristles_are_those_of_the_other_studies(arm):
    t = np.arange(4000) * 0.001
    made = motions.draw_series(limits(), PERIOD, HARMONICS, np.random.default_rng(8))
    q, v, a = made.at(t)
    world = SimpleNamespace(q=q, v=v, dt=0.001, declared=())
    models = set()
    for seed in range(6):
        drawn = robots._draw_presliding(world, 1, np.random.default_rng(seed))
        law = robots.law("presliding", {**drawn.fixed, **drawn.scaled}, 1, 0.001)
        found = [law(q[i], v[i], a[i], None)[0] for i in range(4000)]
        np.testing.assert_allclose(found, drawn.torque, atol=0.05)
        models.add(drawn.fixed["model"])
    assert models == {"lugre", "maxwell_slip"}


# -- studies


def effect(name, joint, rivals=()):
    return SimpleNamespace(name=name, joint=joint, rivals=rivals)


def test_the_right_single_name():
    truth = SimpleNamespace(name="stribeck", joint=1, contains=("coulomb",))

    def judge(*found):
        return rivals.judge(truth, found)

    assert judge(effect("stribeck", 1)) == (True, True)
    assert judge(effect("stribeck", 1), effect("coulomb", 1)) == (True, True)
    assert judge(effect("stribeck", 1, ("presliding",))) == (False, True)
    assert judge(effect("presliding", 1, ("stribeck",))) == (False, True)
    assert judge(effect("stribeck", 0)) == (False, False)
    assert judge(effect("stribeck", 1), effect("spring", 0)) == (False, False)
    assert judge() == (False, False)


def test_seeds_to_work_with_and_to_confirm_are_kept_apart():
    arguments = SimpleNamespace(seeds=(0, 99))
    assert rivals.seeds_of(arguments)[1] == ""
    arguments.seeds = (100, 199)
    assert rivals.seeds_of(arguments)[1] == "_confirmation"
    arguments.seeds = (90, 110)
    with pytest.raises(SystemExit, match="to confirm"):
        rivals.seeds_of(arguments)


def test_every_kind_comes_up_with_a_size_that_was_asked_for():
    tasks = [rivals.task_of(seed) for seed in range(26)]
    assert {task["kind"] for task in tasks} == set(robots.KINDS)
    assert all(2.0 <= task["size"] <= 6.0 for task in tasks)


def test_one_robot_goes_through_all_three_motions():
    task = {"seed": 10, "kind": "ripple", "size": 6.0}
    result = rivals.run(
        task, stand_in(1), duration=6.0, effects=["ripple", "spring"], max_effects=1
    )
    assert "error" not in result
    assert list(result["arms"]) == list(rivals.ARMS)
    text = rivals.report([result])
    assert "first motion alone" in text
    assert "ripple" in rivals.line(result)


def test_an_error_counts_as_a_failure_and_is_told():
    def broken(loop, limits, duration, dt, seed):
        raise RuntimeError("no motion")

    task = {"seed": 10, "kind": "ripple", "size": 6.0}
    result = rivals.run(task, broken, duration=6.0, effects=["ripple"], max_effects=1)
    assert "no motion" in result["error"]
    assert list(result["arms"]) == ["first", "random"]
    assert "designed FAILED" in rivals.line(result)
    assert "counted as failures: 10" in rivals.report([result])


def test_intervals_of_one_robot():
    def design(*args):
        return stand_in(1)(*args)[:2]

    result = intervals.run(rivals.task_of(1), design, duration=8.0)
    assert "error" not in result
    assert len(result["both"]["ratio"]) == len(result["both"]["random_holds"]) > 0
    assert "median ratio" in intervals.line(result)
    assert "Target" in intervals.report([result])


def test_the_better_of_two_fits_has_the_smaller_ratio():
    robot = robots.draw_robot("spring", 3.0, 1, n_joints=(2,))
    truth = intervals.true_parameters(robot)

    def fit(deviation):
        return SimpleNamespace(
            identifiable_=np.ones(truth.size, dtype=bool),
            theta_std_=np.full(truth.size, deviation),
            theta_unconstrained_=truth + 0.5,
            parameter_names_=[f"p{i}" for i in range(truth.size)],
        )

    found = intervals.compare(robot, fit(0.2), fit(0.4))
    np.testing.assert_allclose(found["ratio"], 0.5)
    assert not any(found["designed_holds"])
    assert all(found["random_holds"])


def test_information_of_a_motion_by_hand(arm):
    bounds = limits(torque=20.0)
    base = condition.base_columns(arm, bounds, np.random.default_rng(0))
    motion = motions.draw_series(bounds, PERIOD, HARMONICS, np.random.default_rng(1))
    found = condition.figures(arm, bounds, base, motion, duration=PERIOD)
    t = np.arange(round(PERIOD / condition.ROWS)) * condition.ROWS
    n = base.columns.size
    W = condition.columns(arm, *motion.at(t))[:, :, base.columns].reshape(-1, n)
    sign, logarithm = np.linalg.slogdet(W.T @ W / 0.2**2)
    assert sign == 1
    assert found.nats == pytest.approx(0.5 * logarithm)
    # the noise of all joints is the same
    assert found.weighted == pytest.approx(found.plain)
    more = condition.figures(arm, bounds, base, motion, duration=4 * PERIOD)
    assert more.nats - found.nats == pytest.approx(0.5 * n * np.log(4.0))


def test_base_columns_are_independent_and_complete(arm):
    base = condition.base_columns(arm, limits(), np.random.default_rng(0))
    rng = np.random.default_rng(5)
    W = condition.columns(arm, *rng.normal(size=(3, 200, 3))).reshape(600, -1)
    rank = np.linalg.matrix_rank(W)
    assert rank == np.linalg.matrix_rank(W[:, base.columns]) == base.columns.size


def test_one_robot_against_random_motions(monkeypatch):
    monkeypatch.setattr(condition, "DURATION", PERIOD)
    urdf = condition.description("kr300", "")

    def design(path, bounds):
        import pinocchio as pin

        rng = np.random.default_rng(3)
        torque = motions.rigid(pin.buildModelFromUrdf(path))
        return motions.random_motion(torque, bounds, PERIOD, HARMONICS, rng), HARMONICS

    result = condition.run("kr300", urdf, n_motions=5, design=design)
    # the stand-in is one of the five
    assert result["best"].plain <= result["designed"].plain * (1 + 1e-9)
    assert result["best"].nats >= result["designed"].nats - 1e-9
    assert "KR300" in condition.line(result)
    assert "KR300 margin" in condition.report([result])


def test_frozen_limits_are_those_of_the_descriptions(measured_data_home):
    import pinocchio as pin

    for name in condition.LIMITS:
        urdf = condition.description(name, measured_data_home)
        model, bounds = pin.buildModelFromUrdf(urdf), condition.limits_of(name)
        low, high = bounds.position.T
        np.testing.assert_allclose(low, model.lowerPositionLimit, atol=1e-4)
        np.testing.assert_allclose(high, model.upperPositionLimit, atol=1e-4)
        np.testing.assert_allclose(bounds.velocity, model.velocityLimit, atol=1e-4)
        np.testing.assert_allclose(bounds.torque, model.effortLimit, rtol=1e-4)
