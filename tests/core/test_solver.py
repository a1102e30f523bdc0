"""The loop: where it starts, when it stops, and what it reports."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa._core import _predict, _solver
from sklearn_vbjfa._core._bound import bound
from sklearn_vbjfa._core._state import Prior
from sklearn_vbjfa._core._updates import VARIANCE_FLOOR, expect_hidden
from tests.core import _problems

MODELS = ["jfa", "paper", "noise"]


def make_standardised(seed, n_features, n_samples=200, noise=0.4):
    """Moments of data with unit variances, and the data."""
    X, y, _ = _problems.make_data(seed, n_features, n_samples, noise)
    X, y = X / X.std(axis=0), y / y.std()
    return _problems.as_gram(X, y), X, y


class FailingMoments:
    """Moments whose product with S_xx is wrong after some calls."""

    def __init__(self, moments, n_right):
        self.moments, self.left = moments, n_right
        self.n, self.xx = moments.n, moments.xx
        self.xy, self.yy = moments.xy, moments.yy

    def dot(self, v):
        """Return S_xx v, or three times as much."""
        self.left -= 1
        return self.moments.dot(v) * (1.0 if self.left >= 0 else 3.0)


def test_start_is_the_documented_one():
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
def test_acceleration_ends_where_the_plain_iteration_does(model):
    moments, _, _ = make_standardised(1, 4)
    prior = _problems.make_prior(model, 200, 4)
    state = _solver.start(moments, prior, np.full(4, 0.3))
    if model != "jfa":
        # Where the bound would creep for ever, as psi_y goes to zero.
        state = replace(state, psi_y=1e-9)
    options = {"max_iter": 5000, "tol": 1e-12}
    plain = _solver.solve(moments, state, prior, accelerate=False, **options)
    fast = _solver.solve(moments, state, prior, accelerate=True, **options)
    assert plain.status == fast.status == "converged"
    # The plain steps end short of the optimum: 1e-12 n per step over as many steps
    # as it had taken, at a linear rate.
    assert fast.history[-1] >= plain.history[-1] - 1e-12 * 200 * plain.n_iter
    # A gain of 1e-12 per sample and step, of a quadratic in the coefficients.
    assert_allclose(
        _predict.coefficients_noisy(fast.state),
        _predict.coefficients_noisy(plain.state),
        atol=1e-5,
    )
    assert fast.n_iter < plain.n_iter


@pytest.mark.parametrize("accelerate", [True, False])
@pytest.mark.parametrize("model", MODELS)
def test_history_never_falls(model, accelerate):
    moments, _, _ = make_standardised(2, 6, 60)
    prior = _problems.make_prior(model, 60, 6)
    state = _solver.start(moments, prior, np.full(6, 0.3))
    solution = _solver.solve(
        moments, state, prior, max_iter=500, tol=1e-10, accelerate=accelerate
    )
    assert solution.history.size > 10
    assert np.diff(solution.history).min() >= -1e-12 * abs(solution.history[-1])
    assert solution.history.size <= solution.n_iter <= 500


@pytest.mark.parametrize("accelerate", [True, False])
def test_stops_when_the_gain_per_sample_is_small(accelerate):
    moments, _, _ = make_standardised(3, 3)
    state = _solver.start(moments, Prior(), np.full(3, 0.3))
    tol = 1e-4
    solution = _solver.solve(
        moments, state, Prior(), max_iter=1000, tol=tol, accelerate=accelerate
    )
    assert solution.status == "converged"
    gains = np.diff(solution.history) / moments.n
    assert gains[-1] <= tol < gains[0]


@pytest.mark.parametrize("max_iter", [1, 2, 3, 4, 7])
def test_never_more_than_max_iter(max_iter):
    moments, _, _ = make_standardised(4, 3)
    state = _solver.start(moments, Prior(), np.full(3, 0.3))
    solution = _solver.solve(moments, state, Prior(), max_iter=max_iter, tol=0.0)
    assert solution.status == "max_iter"
    assert solution.n_iter == max_iter
    assert 1 <= solution.history.size <= max_iter


@pytest.mark.parametrize("accelerate", [True, False])
@pytest.mark.parametrize("n_right", [2, 5, 6, 9])
def test_a_fall_of_the_bound_stops_and_keeps_the_state_before(accelerate, n_right):
    moments, _, _ = make_standardised(5, 3)
    state = _solver.start(moments, Prior(), np.full(3, 0.3))
    solution = _solver.solve(
        FailingMoments(moments, n_right),
        state,
        Prior(),
        max_iter=100,
        tol=1e-12,
        accelerate=accelerate,
    )
    assert solution.status == "bound_decreased"
    assert solution.fall > 1.0
    assert np.diff(solution.history).min() >= 0
    hidden = expect_hidden(moments, solution.state)
    kept = bound(moments, solution.state, hidden, Prior())
    assert_allclose(kept, solution.history[-1], rtol=1e-12)


def test_known_noise_is_kept_and_zero_is_raised_to_the_floor():
    moments, _, _ = make_standardised(6, 3)
    known = np.array([0.0, 0.1, 0.2])
    prior = Prior(psi_x_fixed=known)
    state = _solver.start(moments, prior, np.full(3, 0.3))
    solution = _solver.solve(moments, state, prior, max_iter=200, tol=1e-9)
    assert_array_equal(solution.state.psi_x, np.maximum(known, VARIANCE_FLOOR))
    assert "psi_x" not in solution.at_floor


def test_variances_at_the_floor_are_listed():
    moments, _, _ = make_standardised(7, 2)
    state = _solver.start(moments, Prior(), np.full(2, 0.3))
    state = replace(state, psi_x=np.array([1e-3 * VARIANCE_FLOOR, 0.3]))
    solution = _solver.solve(moments, state, Prior(), max_iter=2, tol=0.0)
    assert_array_equal(solution.at_floor["psi_x"], [0])
    assert solution.state.psi_x[0] >= VARIANCE_FLOOR


def test_coordinates_give_the_state_back():
    state = _problems.make_state(8, 4)
    again = _solver._from_coordinates(_solver._coordinates(state), state)
    for name in ("w_z_mean", "w_z_var", "w_x_var", "alpha_rate", "psi_z", "psi_x"):
        assert_allclose(getattr(again, name), getattr(state, name), rtol=1e-14)
    assert_allclose(again.psi_y, state.psi_y, rtol=1e-14)
    point = _problems.make_state(8, 4, ard=False)
    again = _solver._from_coordinates(_solver._coordinates(point), point)
    assert_array_equal(again.w_z_var, np.zeros(4))


def make_sequence(rate):
    """Three states that approach a fourth one, each by the factor `rate`."""
    limit = _problems.make_state(9, 3)
    far = replace(_problems.make_state(10, 3), alpha_shape=limit.alpha_shape)
    end, start = (_solver._coordinates(state) for state in (limit, far))
    sequence = [
        _solver._from_coordinates(end + rate**k * (start - end), limit)
        for k in range(3)
    ]
    return sequence, limit


def test_extrapolation_finds_the_limit_of_a_geometric_sequence():
    # One rate for all coordinates: the step 1 / (1 - rate) = 2.5 is exact.
    sequence, limit = make_sequence(0.6)
    found = _solver._extrapolate(*sequence)
    for name in ("w_z_mean", "w_z_var", "w_x_mean", "alpha_rate", "psi_z", "psi_x"):
        assert_allclose(getattr(found, name), getattr(limit, name), rtol=1e-9)
    assert_allclose(found.psi_y, limit.psi_y, rtol=1e-9)


def test_extrapolation_has_a_longest_step():
    # The exact step would be 10; with 4 a coordinate goes (1 + 4 (rate - 1))^2 = 0.36
    # of the way that is left.
    sequence, limit = make_sequence(0.9)
    found = _solver._coordinates(_solver._extrapolate(*sequence))
    start, end = _solver._coordinates(sequence[0]), _solver._coordinates(limit)
    assert_allclose(found - end, 0.36 * (start - end), atol=1e-9)
    assert _solver._extrapolate(limit, limit, limit) is None
