"""JFA regression: limits, invariances, attributes and messages."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa import JFARegressor
from tests.regression._problems import least_squares, make_regression


def test_noisy_coefficients_are_least_squares_at_convergence():
    X, y, _ = make_regression(2, 500)
    model = JFARegressor(query="noiseless", tol=1e-13).fit(X, y)
    # The remaining gain is 1e-13 per sample, whose root is 3e-7.
    assert_allclose(model.coef_noisy_, least_squares(X, y), rtol=1e-5)


def test_queries_and_their_standard_deviations():
    X, y, _ = make_regression(11, 5000)
    model = JFARegressor(query="noiseless", input_noise=np.full(4, 0.16), tol=1e-10)
    model.fit(X, y)
    mean, std = model.predict(X, return_std=True)
    assert_allclose(mean, X @ model.coef_ + model.intercept_)
    # 5000 samples for four coefficients: 1e-3 of the noise, 1e-2 at three standard
    # deviations, and twice as much in the estimate of the noise.
    assert_allclose(std**2, model.output_noise_, rtol=0.1)
    assert (std**2 > model.output_noise_).all()
    model.set_params(query="noisy").fit(X, y)
    mean, std = model.predict(X, return_std=True)
    assert_allclose(mean, X @ model.coef_noisy_ + model.intercept_)
    # Standard deviation of the training residuals, to the root of 2 / 5000.
    assert_allclose(std.mean(), np.std(y - mean), rtol=0.01)
    # Without known noise, the inputs may be exact: then these are noiseless queries.
    model.set_params(query="noiseless", input_noise=None).fit(X, y)
    mean, std = model.predict(X, return_std=True)
    assert np.mean(std**2) > 0.99 * np.mean((y - mean) ** 2)


def ill_conditioned(condition):
    """Return inputs of a given condition number, and the least-squares fit."""
    rng = np.random.default_rng(0)
    U, _ = np.linalg.qr(rng.normal(size=(500, 5)))
    V, _ = np.linalg.qr(rng.normal(size=(5, 5)))
    X = 20 * U * np.geomspace(1, 1 / condition, 5) @ V.T
    y = X @ rng.normal(size=5)
    y += 0.3 * y.std() * rng.normal(size=500)
    ols = least_squares(X, y)
    residual = y - y.mean() - (X - X.mean(axis=0)) @ ols
    variance = np.mean(residual**2)
    top = -0.5 * 500 * (np.log(2 * np.pi * np.var(X, axis=0)) + 1).sum()
    top -= 0.5 * 500 * (np.log(2 * np.pi * variance) + 1)
    return X, y, ols, variance, top


@pytest.mark.parametrize("condition", [1e1, 1e3, 2e5])
def test_a_converged_fit_has_the_maximum_likelihood(condition):
    X, y, ols, variance, top = ill_conditioned(condition)
    model = JFARegressor().fit(X, y)
    assert model.converged_
    assert (np.diff(model.elbo_history_) >= 0).all()
    assert model.elbo_history_[-1] == pytest.approx(top, abs=1e-4)
    # Distance to least squares in standard errors.
    difference = (X - X.mean(axis=0)) @ (model.coef_noisy_ - ols)
    assert np.sqrt(difference @ difference / variance) < 1e-3
