"""Correlated latent inputs against a literal version with loops over samples."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.special import digamma, gammaln
from scipy.stats import multivariate_normal

from sklearn_vbjfa._core import _correlated
from sklearn_vbjfa._core._moments import from_data, standardise
from sklearn_vbjfa._core._solver import PlainSteps, climb
from tests.core._problems import ARD_RATE, ARD_SHAPE, as_gram

LOG_2PI = np.log(2 * np.pi)


def make_problem(seed, n_features, n_samples=60, noise=0.3):
    """Correlated inputs with correlated noise; X, y, psi (d, d) and coefficients."""
    rng = np.random.default_rng(seed)
    mix = rng.normal(size=(n_features, n_features)) + np.eye(n_features)
    t = rng.normal(size=(n_samples, n_features)) @ mix
    root = noise * rng.normal(size=(n_features, n_features))
    coef = rng.normal(size=n_features)
    X = t + rng.normal(size=t.shape) @ root
    y = t @ coef + 0.5 * rng.normal(size=n_samples)
    # Scale the noise covariance so that every direction of the samples has signal.
    psi = root.T @ root + 1e-3 * np.eye(n_features)
    S = X.T @ X / n_samples
    largest = np.linalg.eigvals(np.linalg.solve(S, psi)).real.max()
    return X, y, psi * min(1.0, 0.7 / largest), coef


def solve(X, y, psi, **options):
    options = {
        "ard_shape": ARD_SHAPE,
        "ard_rate": ARD_RATE,
        "max_iter": 500,
        "tol": 1e-9,
        **options,
    }
    return _correlated.solve_correlated(as_gram(X, y), psi, **options)


def problem_of(X, y, psi, common=False):
    return _correlated.CorrelatedProblem(
        as_gram(X, y), psi, ard_shape=ARD_SHAPE, ard_rate=ARD_RATE, common=common
    )


def solve_plainly(X, y, psi, *, max_iter, tol, common=False):
    """Solve by plain updates, without acceleration."""
    problem = problem_of(X, y, psi, common)
    return climb(PlainSteps(problem, tol), problem.start(), max_iter)


@dataclass(frozen=True, kw_only=True)
class LiteralState:
    mean: np.ndarray
    cov: np.ndarray
    shape: float
    rate: np.ndarray
    s2: float


def literal_start(X, y):
    """Ridge posterior with <alpha> = 1 and the variance of y as noise."""
    d = X.shape[1]
    s2 = y @ y / len(y)
    cov = np.linalg.inv(X.T @ X / s2 + np.eye(d))
    shape = ARD_SHAPE + 0.5
    return LiteralState(
        mean=cov @ X.T @ y / s2, cov=cov, shape=shape, rate=np.full(d, shape), s2=s2
    )


def literal_posterior_t(x, y, psi, Sigma_t, state):
    """Gaussian of t_i given x_i and y_i, from the quadratic form of the log-joint."""
    second = np.outer(state.mean, state.mean) + state.cov
    precision = np.linalg.inv(Sigma_t) + np.linalg.inv(psi) + second / state.s2
    cov = np.linalg.inv(precision)
    return cov @ (np.linalg.solve(psi, x) + state.mean * y / state.s2), cov


def literal_step(X, y, psi, state):
    """One iteration: q(T), q(beta), the output noise, q(alpha)."""
    n, d = X.shape
    Sigma_t = X.T @ X / n - psi
    E_tt, E_ty = np.zeros((n, d, d)), np.zeros((n, d))
    for i in range(n):
        mean, cov = literal_posterior_t(X[i], y[i], psi, Sigma_t, state)
        E_tt[i], E_ty[i] = np.outer(mean, mean) + cov, mean * y[i]
    alpha = state.shape / state.rate
    cov = np.linalg.inv(E_tt.sum(axis=0) / state.s2 + np.diag(alpha))
    mean = cov @ E_ty.sum(axis=0) / state.s2
    s2 = literal_noise(X, y, psi, Sigma_t, mean, cov / state.s2, alpha)
    cov = cov / state.s2 * s2
    return LiteralState(
        mean=mean,
        cov=cov,
        shape=state.shape,
        rate=ARD_RATE + 0.5 * np.diagonal(np.outer(mean, mean) + cov),
        s2=s2,
    )


def literal_noise(X, y, psi, Sigma_t, mean, G, alpha):
    """Noise that maximises the bound if the covariance of beta is G times the noise."""
    # With t integrated out y_i ~ N(mean't_i, s2 + mean'P mean), t_i being its estimate
    # from x_i only; the prior contributes alpha'diag(G) s2 - d log s2.
    n, d = X.shape
    P = np.linalg.inv(np.linalg.inv(Sigma_t) + np.linalg.inv(psi) + G)
    squares = sum((y[i] - mean @ P @ np.linalg.solve(psi, X[i])) ** 2 for i in range(n))

    def slope(log_s2):
        s2 = np.exp(log_s2)
        q = s2 + mean @ P @ mean
        return s2 * (n / q - squares / q**2 + alpha @ np.diagonal(G)) - d

    return float(np.exp(brentq(slope, -40.0, 40.0, xtol=1e-14, rtol=1e-15)))


def literal_bound(X, y, psi, state):
    """Bound on log p(X, y) minus log p(X), term by term: a bound on log p(y | X)."""
    n, d = X.shape
    Sigma_t = X.T @ X / n - psi
    second = np.outer(state.mean, state.mean) + state.cov
    total = 0.0
    for i in range(n):
        mean, cov = literal_posterior_t(X[i], y[i], psi, Sigma_t, state)
        E_tt = np.outer(mean, mean) + cov
        square = y[i] ** 2 - 2 * y[i] * state.mean @ mean + np.trace(second @ E_tt)
        total += -0.5 * (LOG_2PI + np.log(state.s2) + square / state.s2)
        total += multivariate_normal.logpdf(X[i], mean, psi)
        total -= 0.5 * np.trace(np.linalg.solve(psi, cov))
        total += multivariate_normal.logpdf(mean, np.zeros(d), Sigma_t)
        total -= 0.5 * np.trace(np.linalg.solve(Sigma_t, cov))
        total += 0.5 * (d * (1 + LOG_2PI) + np.linalg.slogdet(cov)[1])
        total -= multivariate_normal.logpdf(X[i], np.zeros(d), Sigma_t + psi)
    shape, rate = state.shape, state.rate
    E_alpha, E_log = shape / rate, digamma(shape) - np.log(rate)
    total += 0.5 * np.sum(E_log - LOG_2PI - E_alpha * np.diagonal(second))
    total += 0.5 * (d * (1 + LOG_2PI) + np.linalg.slogdet(state.cov)[1])
    total += np.sum(
        ARD_SHAPE * np.log(ARD_RATE)
        - gammaln(ARD_SHAPE)
        + (ARD_SHAPE - 1) * E_log
        - ARD_RATE * E_alpha
    )
    total += np.sum(
        shape - np.log(rate) + gammaln(shape) + (1 - shape) * digamma(shape)
    )
    return total


@pytest.mark.parametrize(("n_features", "seed"), [(1, 0), (2, 1), (4, 2), (6, 3)])
def test_iterations_equal_the_literal_ones(n_features, seed):
    X, y, psi, _ = make_problem(seed, n_features)
    state = literal_start(X, y)
    n_iter = 6
    bounds = []
    for k in range(n_iter):
        bounds.append(literal_bound(X, y, psi, state))
        if k == 0:
            first = literal_step(X, y, psi, state)
        state = literal_step(X, y, psi, state)
    bounds.append(literal_bound(X, y, psi, state))
    # An iteration evaluates the bound, the first one at the start.
    one = solve_plainly(X, y, psi, max_iter=2, tol=0.0)
    many = solve_plainly(X, y, psi, max_iter=n_iter + 1, tol=0.0)
    # The two forms differ by two or three inverses of matrices of condition 1e3.
    for found, expected in ((one.state, first), (many.state, state)):
        assert_allclose(found.beta_mean, expected.mean, rtol=1e-9)
        scale = np.abs(expected.cov).max()
        assert_allclose(found.beta_cov, expected.cov, atol=1e-9 * scale)
        assert_allclose(found.alpha_rate, expected.rate, rtol=1e-9)
        assert_allclose(found.psi_y, expected.s2, rtol=1e-9)
    assert_allclose(many.history, bounds, rtol=1e-9)


@settings(max_examples=20, derandomize=True, deadline=None)
@given(
    n_features=st.integers(1, 6),
    n_samples=st.integers(8, 60),
    seed=st.integers(0, 2**20),
    exact=st.booleans(),
    common=st.booleans(),
)
def test_bound_never_decreases(n_features, n_samples, seed, exact, common):
    X, y, psi, _ = make_problem(seed, n_features, n_samples)
    solution = solve(X, y, psi * (not exact), max_iter=100, common=common)
    assert solution.status in {"converged", "max_iter"}
    slack = 1e-11 * max(np.abs(solution.history).max(), n_samples)
    assert np.diff(solution.history).min(initial=0.0) >= -slack


@pytest.mark.parametrize("d", [1, 3])
def test_a_common_precision_is_one_gamma(d):
    X, y, psi, _ = make_problem(13, d)
    solution = solve(X, y, psi, common=True, tol=1e-12, max_iter=5000)
    state = solution.state
    assert state.alpha_shape == ARD_SHAPE + 0.5 * d
    square = np.sum(state.beta_mean**2 + np.diagonal(state.beta_cov))
    assert_allclose(state.alpha_rate, ARD_RATE + 0.5 * square, rtol=1e-10)
    if d == 1:
        separate = solve(X, y, psi, tol=1e-12, max_iter=5000)
        assert_allclose(solution.history[-1], separate.history[-1], rtol=1e-9)
        assert_allclose(state.beta_mean, separate.state.beta_mean, rtol=1e-4)


def test_posterior_covariance_is_the_scatter_of_the_estimate():
    # Corrected least squares over 2000 repetitions, with the noise known.
    rng = np.random.default_rng(15)
    n, d, n_runs = 500, 2, 2000
    root = np.array([[1.0, 0.6], [0.0, 0.8]])
    psi, coef, s = np.diag([0.3, 0.1]), np.array([1.0, -2.0]), 0.3
    estimates = np.empty((n_runs, d))
    for i in range(n_runs):
        t = rng.normal(size=(n, d)) @ root
        X = t + rng.normal(size=t.shape) * np.sqrt(np.diagonal(psi))
        y = t @ coef + s * rng.normal(size=n)
        estimates[i] = np.linalg.solve(X.T @ X - n * psi, X.T @ y)
    solution = solve(X, y, psi, ard_shape=1e-6, ard_rate=1e-6, tol=1e-11)
    found = _correlated.posterior_covariance(float(n), psi, solution)
    scatter = np.cov(estimates, rowvar=False)
    # Accuracy of a standard deviation: 1.6 % from 2000 runs, 10 % from 500 samples.
    ratio = np.sqrt(np.diagonal(found) / np.diagonal(scatter))
    assert_allclose(ratio, 1.0, atol=0.2)
    # The variational covariance treats t as known and is far too small.
    narrow = np.sqrt(np.diagonal(solution.state.beta_cov) / np.diagonal(scatter))
    assert narrow.max() < 0.75


@pytest.mark.parametrize("common", [True, False])
@pytest.mark.parametrize("exact", [True, False])
def test_the_solution_is_the_fixed_point_for_any_tolerance(exact, common):
    X, y, psi, _ = make_problem(23, 6, 80)
    psi = psi * (not exact)
    rough, fine = (
        solve(X, y, psi, tol=tol, max_iter=5000, common=common) for tol in (1e-3, 1e-12)
    )
    assert_allclose(rough.state.beta_mean, fine.state.beta_mean, rtol=1e-7, atol=1e-9)
    assert_allclose(rough.state.psi_y, fine.state.psi_y, rtol=1e-8)
    # A further step changes nothing.
    problem = problem_of(X, y, psi, common)
    after = problem.step(problem.evaluate(fine.state, 0.0, 0.0)).state
    assert_allclose(after.beta_mean, fine.state.beta_mean, rtol=1e-8, atol=1e-10)
    assert_allclose(after.E_alpha, fine.state.E_alpha, rtol=1e-7)
    assert_allclose(after.psi_y, fine.state.psi_y, rtol=1e-9)


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("seed", range(2))
def test_the_solution_does_not_depend_on_the_order_of_rows(seed, exact):
    # Strongly correlated inputs, one of them a sum, like the regressors of a robot.
    rng = np.random.default_rng(seed)
    T = rng.normal(size=(300, 1)) + 0.05 * rng.normal(size=(300, 8))
    X = np.column_stack([T, T[:, 0] + T[:, 1]])
    y = X @ rng.normal(size=9) + 0.1 * rng.normal(size=300)
    psi = np.zeros((9, 9)) if exact else 1e-5 * np.eye(9)
    options = {"ard_shape": 1e-6, "ard_rate": 1e-6, "max_iter": 20_000, "tol": 1e-7}
    solutions = []
    for order in (np.arange(300), rng.permutation(300)):
        data = standardise(from_data(X[order], y[order]), centred=True)
        found = _correlated.solve_correlated(data.moments, psi, **options)
        solutions.append(found.state.beta_mean)
    change = X / data.x_scale @ (solutions[0] - solutions[1])
    assert np.abs(change).max() < 1e-9 * y.std()


@pytest.mark.parametrize("common", [True, False])
@pytest.mark.parametrize("exact", [True, False])
def test_extrapolation_saves_steps(exact, common):
    X, y, psi, _ = make_problem(20, 5, 100)
    options = {"max_iter": 50_000, "tol": 1e-13, "common": common}
    plain = solve_plainly(X, y, psi * (not exact), **options)
    fast = solve(X, y, psi * (not exact), **options)
    # It continues to the fixed point, which costs steps if the plain ones are few.
    assert fast.n_iter < max(plain.n_iter, 20)
    assert_allclose(fast.history[-1], plain.history[-1], atol=1e-8)
