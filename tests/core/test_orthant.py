"""Groups of non-negative coefficients: evidence and least squares."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from sklearn_vbjfa._core._groups import Groups, log_orthant


@pytest.mark.parametrize("correlation", [-0.5, 0.0, 0.8])
@pytest.mark.parametrize("mean", [(0.5, 1.0), (-1.0, 0.3), (-3.0, -2.0)])
def test_two_coefficients_by_quadrature(mean, correlation):
    covariance = np.array([[1.0, 2 * correlation], [2 * correlation, 4.0]])
    rest = covariance[1, 1] - covariance[0, 1] ** 2
    x = np.linspace(0.0, 12.0, 20_001)
    inner = stats.norm.sf(0.0, mean[1] + covariance[0, 1] * (x - mean[0]), rest**0.5)
    exact = np.log(np.trapezoid(stats.norm.pdf(x, mean[0], 1.0) * inner, x))
    assert_allclose(log_orthant(mean, covariance), exact, atol=0.25)


@pytest.mark.parametrize("seed", range(3))
def test_nine_elements_by_a_million_draws(seed):
    rng = np.random.default_rng(seed)
    columns = np.tril(np.ones((9, 9)))
    covariance = np.linalg.inv(5.0 * columns.T @ columns + np.eye(9))
    mean = 0.5 * np.abs(rng.normal(size=9)) * np.sqrt(np.diagonal(covariance))
    draws = rng.multivariate_normal(mean, covariance, size=1_000_000)
    exact = np.log((draws >= 0).all(axis=1).mean())
    assert_allclose(log_orthant(mean, covariance), exact, atol=0.7)


def groups(X, y, positive):
    moments = {"H": X.T @ X, "q": X.T @ y, "norms": (X**2).sum(axis=0)}
    unit = np.ones((1, X.shape[1]))
    return Groups(
        **{k: v[None] for k, v in moments.items()}, unit=unit, positive=positive
    )


def test_coefficients_are_not_negative():
    rng = np.random.default_rng(0)
    X = np.cumsum(rng.normal(size=(200, 5)), axis=1)
    true = np.array([1.0, 0.0, 2.0, 0.0, 0.5])
    y = X @ true + rng.normal(size=200)
    (coef,) = groups(X, y, True).coefficients()
    assert (coef >= 0).all()
    gradient = X.T @ (y - X @ coef)
    assert_allclose(gradient[coef > 0], 0.0, atol=1e-8)
    assert (gradient <= 1e-8).all()
    # Negative coefficients are evidence against the group, positive ones for it.
    unconstrained, positive = groups(X, y, False), groups(X, y, True)
    assert positive.evidence(0.1)[0] > unconstrained.evidence(0.1)[0]
    unconstrained_wrong, positive_wrong = groups(X, -y, False), groups(X, -y, True)
    assert positive_wrong.evidence(0.1)[0] < 0.0 < unconstrained_wrong.evidence(0.1)[0]
    assert_allclose(positive_wrong.gain(), 0.0, atol=1e-6)
