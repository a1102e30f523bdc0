"""Designed motions: independent checks of limits, information and accuracy."""

import math

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.design import MotionLimits, design_motion
from sklearn_vbjfa.robot import FitOptions
from tests.design._chains import chain, posed, problem_of, swung
from tests.effects._arms import inverse_dynamics

KINDS = ("revolute", "prismatic", "continuous")
SHORT = {"duration": 3.0, "dt": 0.02, "random_state": 0}


def limits_of(nv, *, effort=60.0, reach=1.5, velocity=2.0):
    position = np.array([[-reach, reach]] * nv)
    return MotionLimits(
        position, np.full(nv, velocity), np.full(nv, 8.0), np.full(nv, effort)
    )


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return chain(tmp_path_factory.mktemp("designs"), KINDS, effort=60.0)


@pytest.fixture(scope="module")
def motion(path):
    return design_motion(path, limits=limits_of(3), **SHORT)


def literal_margins(model, limits, states):
    """Return relative distances to the limits, by Pinocchio's inverse dynamics."""
    q, v, a = np.split(states, 3, axis=1)
    tau = inverse_dynamics(model, states)
    low, high = limits.position.T
    half = (high - low) / 2
    return {
        "position": np.minimum(high - q, q - low).min(axis=0) / half,
        "velocity": 1 - np.abs(v).max(axis=0) / limits.velocity,
        "acceleration": 1 - np.abs(a).max(axis=0) / limits.acceleration,
        "torque": 1 - np.abs(tau).max(axis=0) / limits.torque,
    }


def test_limits_hold_between_the_samples(path, motion):
    # The model has one position per continuous joint.
    problem, _ = problem_of(path)
    fine = np.linspace(0, SHORT["duration"], 5_000)
    margins = literal_margins(
        problem.model.features.model_, motion.limits, motion.states(fine)
    )
    assert motion.within_limits
    for name, values in margins.items():
        assert values.min() > 0.0195, name
        np.testing.assert_allclose(motion.margins[name], values, atol=3e-3)
    # Some limit is nearly reached.
    assert min(values.min() for values in margins.values()) < 0.06


def test_columns_are_samples_of_one_motion(path, motion):
    problem, _ = problem_of(path)
    model = problem.model.features.model_
    assert motion.t.shape == (150,)
    assert motion.joint_names == ("chain_1", "chain_2", "chain_3")
    states = motion.states(motion.t)
    np.testing.assert_allclose(np.hstack([motion.q, motion.v, motion.a]), states)
    np.testing.assert_allclose(motion.tau, inverse_dynamics(model, states), atol=1e-8)
    ends = motion.states([0.0, motion.duration])
    np.testing.assert_allclose(ends[:, 3:], 0.0, atol=1e-9)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def random_feasible(limits, model, duration, rng):
    """Draw a Fourier motion that fills its limits, without code of the package."""
    nv, t = model.nv, np.linspace(0, duration, 150)
    k = np.arange(1, 6)
    w = 2 * np.pi * k / duration
    A, B = rng.normal(size=(2, 5, nv)) / k[:, None]
    c, s = np.cos(np.outer(t, w)), np.sin(np.outer(t, w))
    q = c @ A + s @ B
    v = c @ (w[:, None] * B) - s @ (w[:, None] * A)
    a = -c @ (w[:, None] ** 2 * A) - s @ (w[:, None] ** 2 * B)
    centre = 0.5 * (q.max(axis=0) + q.min(axis=0))
    states = [q - centre, v, a]
    kept = (limits.position[:, 1], limits.velocity, limits.acceleration)
    size = np.min([x / np.abs(y).max(axis=0) for x, y in zip(kept, states)], axis=0)
    states = np.hstack([size * signal for signal in states])
    while literal_margins(model, limits, states)["torque"].min() < 0.0:
        states = 0.9 * states
    return t, states


def literal_information(model, states, dt, limits):
    """Return the information on bodies and friction, scaled by torque limits."""
    data = model.createData()
    blocks = []
    for row in states:
        q, v, a = np.split(row, 3)
        bodies = pin.computeJointTorqueRegressor(model, data, q, v, a)
        friction = np.hstack([np.diag(v), np.diag(np.tanh(v / 0.04))])
        blocks.append(np.hstack([bodies, friction]) / limits.torque[:, None])
    X = np.concatenate(blocks)
    return dt * X.T @ X


def test_designed_motion_has_more_information_than_random_motions(path, motion):
    problem, _ = problem_of(path)
    model, limits = problem.model.features.model_, motion.limits
    rng = np.random.default_rng(0)
    fine = np.linspace(0, motion.duration, 150)
    designed = literal_information(model, motion.states(fine), 0.02, limits)
    n = 10 * model.nv
    drawn = [random_feasible(limits, model, motion.duration, rng) for _ in range(40)]
    random = [literal_information(model, states, 0.02, limits) for _, states in drawn]
    # Base columns of the model and friction.
    kept = np.r_[problem.model.base, n : n + 2 * model.nv]

    def log_det(M):
        M = M[np.ix_(kept, kept)]
        return 0.5 * np.linalg.slogdet(M)[1]

    best = max(log_det(M) for M in random)
    assert log_det(designed) > best + 3.0
    assert motion.condition_number < motion.start_condition_number


@pytest.fixture(scope="module")
def with_effects(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parted")
    path = chain(folder, ("revolute", "revolute"), effort=40.0, seed=3)
    asked = ("load_friction", "spring", "rotor_inertia")
    return path, design_motion(path, effects=asked, **SHORT)


def test_given_effects_are_shown_or_reported_as_invisible(with_effects):
    _, motion = with_effects
    shown = {(one.name, one.joint) for one in motion.shows}
    hidden = {(one.name, one.joint) for one in motion.invisible}
    assert shown | hidden == {
        (name, joint)
        for name in ("load_friction", "spring", "rotor_inertia")
        for joint in (0, 1)
    }
    # The rotor inertia of the first joint is equivalent to inertia of its link.
    assert ("rotor_inertia", 0) in hidden
    assert ("spring", 0) in shown
    assert motion.within_limits
    assert all(np.isfinite(one.least) and one.least > 0 for one in motion.shows)


@pytest.mark.parametrize(
    ("reach", "velocity", "acceleration", "duration"),
    [(0.3, 0.5, 2.0, 4.0), (1.5, 2.0, 20.0, 1.5)],
)
def test_margin_of_two_per_cent_to_all_limits(
    tmp_path, reach, velocity, acceleration, duration
):
    # Motions of few harmonics.
    path = chain(tmp_path, ("revolute",), effort=60.0)
    limits = MotionLimits([[-reach, reach]], [velocity], [acceleration], [60.0])
    motion = design_motion(
        path, limits=limits, duration=duration, dt=0.01, random_state=0
    )
    model = pin.buildModelFromUrdf(str(path))
    fine = np.linspace(0, duration, 3_000)
    margins = literal_margins(model, limits, motion.states(fine))
    assert all(values.min() > 0.02 - 1e-4 for values in margins.values())


def pendulum_rows(path, states, still):
    """Columns of a joint's bodies, viscous and dry friction, (n, 12)."""
    model = pin.buildModelFromUrdf(str(path))
    data, v = model.createData(), states[:, 1]
    bodies = [
        np.ravel(pin.computeJointTorqueRegressor(model, data, *np.split(row, 3))).copy()
        for row in states
    ]
    signs = [math.erf(x / (math.sqrt(2) * still)) for x in v]
    return np.column_stack([bodies, v, signs])


def test_predicted_accuracy_matches_least_squares(tmp_path):
    path = chain(tmp_path, ("revolute",), effort=60.0)
    velocity, acceleration, dt = 2.0, 8.0, 0.005
    motion = design_motion(
        path,
        limits=limits_of(1, velocity=velocity),
        effects=("viscous_quadratic",),
        **SHORT,
    )
    t = np.arange(0, motion.duration, dt)
    states = motion.states(t)
    v, still = states[:, 1], 0.02 * velocity
    # Rows at rest have no weight; independent samples follow from the bandwidth.
    weight = v**2 / (v**2 + still**2) * 2 * motion.band * dt / motion.noise[0] ** 2
    root = np.sqrt(weight)[:, None]
    rows = root * pendulum_rows(path, states, still)
    # Two first moments and a moment of inertia, and friction.
    seen = np.flatnonzero(np.abs(rows).max(axis=0) > 1e-9)
    assert seen.size == 5
    rows = rows[:, seen]
    # Uniform distribution within the limits.
    rng, fastest = np.random.default_rng(0), 3.0 * np.pi * motion.curve.highest
    fastest = min(velocity, fastest)
    quickest = min(acceleration, 2 * np.pi * motion.curve.highest * fastest)
    drawn = rng.uniform(-1, 1, size=(5_000, 3)) * [1.5, fastest, quickest]
    usual = np.sqrt((pendulum_rows(path, drawn, still)[:, seen] ** 2).mean(axis=0))
    values = np.linalg.eigvalsh(rows.T @ rows / np.outer(usual, usual))
    condition = np.sqrt(values[-1] / values[0])
    assert motion.condition_number == pytest.approx(condition, rel=0.1)
    # F v |v|: the residual of the least distinguishable torque corresponds to a
    # difference of log likelihoods of 25.
    (shown,) = motion.shows
    assert shown.rival == ""
    F = shown.least / (fastest**2 / np.sqrt(5))
    y = F * root[:, 0] * v * np.abs(v)
    residual = y - rows @ np.linalg.lstsq(rows, y, rcond=None)[0]
    assert residual @ residual == pytest.approx(50.0, rel=0.15)


def test_equation_noise_follows_from_torque_and_encoder_noise(tmp_path):
    # White noise of the positions, twice differentiated, up to three times the highest
    # frequency: 2 dt s^2 (2 pi)^4 B^5 / 5, through the inertia of the joint.
    path, dt = chain(tmp_path, ("revolute",), effort=60.0), 0.01
    model = pin.buildModelFromUrdf(str(path))
    inertia = pin.crba(model, model.createData(), np.zeros(1))[0, 0]
    for encoder, torque, close in ((3e-3, 0.01, 0.15), (0.0, 0.2, 1e-3)):
        q, tau = swung(path, [0.4], 2_000, third=0.3)
        q += encoder * np.random.default_rng(0).normal(size=q.shape)
        robot = RobotIdentifier(
            path, dt=dt, options=FitOptions(torque_noise=torque)
        ).fit(q, tau)
        problem = posed(robot, limits=limits_of(1), duration=3.0, dt=dt)
        highest = problem.curve.highest
        band = 3.0 * highest
        accelerations = 2 * dt * encoder**2 * (2 * np.pi) ** 4 * band**5 / 5
        # Noise power is proportional to the bandwidth.
        cutoff = problem.robot.band(highest, dt)
        read = robot.torque_noise_**2 * cutoff / robot.cutoff_
        expected = np.sqrt(read + inertia**2 * accelerations)
        assert problem.noise == pytest.approx(expected, rel=close)
        assert not 0.9 < cutoff / robot.cutoff_ < 1.1
