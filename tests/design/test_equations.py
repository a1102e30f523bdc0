"""Information, torques and gradients of a design, against Pinocchio and differences."""

import math

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa.design import Lagrangian
from sklearn_vbjfa.effects import Stateful
from tests.design._chains import chain, problem_of
from tests.effects._arms import inverse_dynamics

KINDS = ("revolute", "prismatic", "continuous")
SMOOTH = ("viscous_quadratic", "load_friction", "spring", "rotor_inertia")


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return chain(tmp_path_factory.mktemp("chain"), KINDS, effort=80.0)


@pytest.fixture(scope="module")
def designed(path):
    return problem_of(path)


def drawn_states(problem, n=40):
    rng = np.random.default_rng(4)
    nv = problem.model.nv
    return rng.uniform(-1, 1, size=(n, 3 * nv)) * np.repeat([1.0, 2.0, 5.0], nv)


def literal_rows(model, problem, q, v, a):
    """Rows (nv, n_columns) of one sample: Pinocchio's regressor and the friction's."""
    data, nv, still = model.createData(), model.nv, problem.still
    rows = np.zeros((nv, problem.model.n_columns))
    bodies = pin.computeJointTorqueRegressor(model, data, q, v, a)
    first = len(problem.model.base)
    rows[:, :first] = bodies[:, problem.model.base]
    for span, one in zip(problem.model.spans, problem.model.effects):
        j = one.effect.joint
        # The mean of the sign of a velocity that is known with this deviation.
        sign = math.erf(v[j] / (math.sqrt(2) * still[j]))
        rows[j, span] = {"viscous": v[j], "coulomb": sign}[one.effect.name]
    return rows


def test_information_is_the_sum_over_samples_and_joints(designed):
    problem, _ = designed
    model = problem.model.features.model_
    states = drawn_states(problem)
    expected = np.zeros((problem.model.n_columns,) * 2)
    for q, v, a in (np.split(row, 3) for row in states):
        rows = literal_rows(model, problem, q, v, a)
        for j in range(model.nv):
            moving = v[j] ** 2 / (v[j] ** 2 + problem.still[j] ** 2)
            weight = (2 * problem.band / problem.noise**2)[j] * 0.01 * moving
            expected += weight * np.outer(rows[j], rows[j])
    found = problem.information(states, 0.01)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * expected.max())


def test_base_columns_and_friction_give_the_torques(designed):
    # Of the nominal robot: no friction, the description's inertias.
    problem, _ = designed
    model = problem.model.features.model_
    states = drawn_states(problem)
    found = problem.torques(problem.model(states))
    np.testing.assert_allclose(found, inverse_dynamics(model, states), atol=1e-8)


def test_no_base_column_is_a_combination_of_others(designed):
    problem, _ = designed
    M = problem.information(drawn_states(problem, 400), 0.01)
    size = np.sqrt(np.diag(M))
    assert np.linalg.eigvalsh(M / np.outer(size, size))[0] > 1e-6


def gradient_error(problem, z, joints=None):
    """Largest difference to central differences, over the size of the gradient."""
    lagrangian = Lagrangian(problem)
    # Limits are exceeded, so that penalties count, and there are multipliers.
    x = 1.15 * z.ravel()
    lagrangian(x)
    lagrangian.tighten(x)
    _, told = lagrangian(x)
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(6):
        way = rng.normal(size=x.size).reshape(z.shape)
        if joints is not None:
            way[[j for j in range(len(z)) if j not in joints]] = 0.0
        way = way.ravel() / np.linalg.norm(way)
        h = 1e-5
        ends = [lagrangian(x + sign * h * way)[0] for sign in (1, -1)]
        change = (ends[0] - ends[1]) / (2 * h)
        worst = max(worst, abs(change - told @ way) / np.linalg.norm(told))
    return worst


def test_gradient_of_the_whole_lagrangian(designed):
    problem, z = designed
    assert gradient_error(problem, z) < 1e-5


def test_gradient_with_candidate_effects(path):
    problem, z = problem_of(path, effects=SMOOTH)
    assert len(problem.questions.effects) == 3 * len(SMOOTH)
    assert gradient_error(problem, z) < 1e-4


@pytest.mark.slow
def test_gradient_with_stateful_effects(path):
    problem, z = problem_of(path, effects=("maxwell_slip", "spring"))
    assert any(isinstance(one.effect, Stateful) for one in problem.model.effects)
    assert gradient_error(problem, z) < 0.05
