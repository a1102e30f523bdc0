"""The solver: start, stopping and status."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa._core import _solver, _updates
from sklearn_vbjfa._core._updates import Prior
from tests.core import _problems

MODELS = ["jfa", "paper", "noise"]


def make_standardised(seed, n_features, n_samples=200, noise=0.4):
    """Moments of data with unit variances, and the data."""
    X, y, _ = _problems.make_data(seed, n_features, n_samples, noise)
    X, y = X / X.std(axis=0), y / y.std()
    return _problems.as_gram(X, y), X, y


def solve_plainly(moments, state, prior, *, max_iter, tol):
    """Solve by plain updates, without acceleration."""
    problem = _solver.IndependentProblem(moments, prior)
    steps = _solver.PlainSteps(problem, tol)
    return _solver.climb(steps, problem.evaluate(state), max_iter)


SOLVERS = [_solver.solve, solve_plainly]


class FailingMoments:
    """Moments with a wrong product with S_xx after some calls."""

    def __init__(self, moments, n_right):
        self.moments, self.remaining = moments, n_right
        self.n, self.xx = moments.n, moments.xx
        self.xy, self.yy, self.rest = moments.xy, moments.yy, moments.yy

    def without_last_digits(self):
        return self

    def residual(self, c):
        """Return S_xe and S_ee, or those for three times S_xx."""
        self.remaining -= 1
        wrong = 0.0 if self.remaining >= 0 else 2.0
        S_xe, S_ee = self.moments.residual(c)
        S_c = self.moments.S @ c
        return S_xe - wrong * S_c, S_ee + wrong * c @ S_c


def test_start_is_as_documented():
    moments, X, y = make_standardised(0, 4)
    prior = _problems.make_prior("paper", 200, 4)
    share = np.array([0.1, 0.2, 0.3, 0.4])
    state = _solver.start(moments, prior, share)
    assert_allclose(state.w_x_mean**2 + state.psi_x, 1.0, rtol=1e-14)
    assert_array_equal(state.psi_x, share)
    # w_z w_x is the first component of PLS: along X'y, with the best step.
    score = X @ (X.T @ y)
    step = (score @ y) / (score @ score)
    assert_allclose(state.w_z_mean * state.w_x_mean, step * X.T @ y, rtol=1e-12)
    rest = np.mean((y - step * score) ** 2)
    assert_allclose(state.psi_y + state.psi_z.sum(), rest, rtol=1e-12)
    assert_allclose(state.E_alpha, 1.0, rtol=1e-15)


@pytest.mark.parametrize("model", MODELS)
def test_acceleration_converges_to_the_plain_solution(model):
    moments, _, _ = make_standardised(1, 4)
    prior = _problems.make_prior(model, 200, 4)
    state = _solver.start(moments, prior, np.full(4, 0.3))
    if model != "jfa":
        # Here the bound would increase slowly for ever, as psi_y goes to zero.
        state = replace(state, psi_y=1e-9)
    options = {"max_iter": 5000, "tol": 1e-12}
    plain = solve_plainly(moments, state, prior, **options)
    fast = _solver.solve(moments, state, prior, **options)
    assert plain.status == fast.status == "converged"
    # The plain steps stop before the optimum: 1e-12 n per step over as many steps
    # as were taken, at a linear rate.
    assert fast.history[-1] >= plain.history[-1] - 1e-12 * 200 * plain.n_iter
    # A gain of 1e-12 per sample and step; the bound is quadratic in the coefficients.
    assert_allclose(
        _updates.coefficients_noisy(fast.state),
        _updates.coefficients_noisy(plain.state),
        atol=1e-5,
    )
    assert fast.n_iter < plain.n_iter


@pytest.mark.parametrize("solve", SOLVERS)
def test_stops_when_the_gain_per_sample_is_small(solve):
    moments, _, _ = make_standardised(3, 3)
    state = _solver.start(moments, Prior(), np.full(3, 0.3))
    tol = 1e-4
    solution = solve(moments, state, Prior(), max_iter=1000, tol=tol)
    assert solution.status == "converged"
    gains = np.diff(solution.history) / moments.n
    assert gains[-1] <= tol < gains[0]


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("n_right", [2, 6])
def test_a_decreasing_bound_stops_at_the_last_state(solve, n_right):
    moments, _, _ = make_standardised(5, 3)
    state = _solver.start(moments, Prior(), np.full(3, 0.3))
    failing = FailingMoments(moments, n_right)
    solution = solve(failing, state, Prior(), max_iter=100, tol=1e-12)
    assert solution.status == "bound_decreased"
    assert solution.fall > 1.0
    assert np.diff(solution.history).min() >= 0
    _, kept = _problems.iterate(moments, solution.state, Prior())
    assert_allclose(kept, solution.history[-1], rtol=1e-12)
