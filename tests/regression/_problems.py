"""Regression problems with input noise, and the comparison of two fits."""

import numpy as np
from numpy.testing import assert_allclose


def make_regression(seed, n_samples=300, n_features=4, noise=0.4, output_noise=0.3):
    """Return X, y and the coefficients of independent latent inputs."""
    rng = np.random.default_rng(seed)
    t = rng.normal(size=(n_samples, n_features))
    sign = rng.choice([-1, 1], n_features)
    coef = sign * rng.uniform(0.5, 2.0, n_features)
    X = t + noise * rng.normal(size=t.shape)
    return X, t @ coef + output_noise * rng.normal(size=n_samples), coef


def least_squares(X, y):
    """Coefficients of ordinary least squares with an intercept."""
    return np.linalg.lstsq(X - X.mean(axis=0), y - y.mean(), rcond=None)[0]


def bayesian_ridge(A, b):
    """Literal variational ridge regression: mean, covariance and noise."""
    (n, d), noise, precision = A.shape, 1.0, 1.0
    for _ in range(5000):
        cov = np.linalg.inv(A.T @ A / noise + precision * np.eye(d))
        ridge = cov @ A.T @ b / noise
        square = ridge @ ridge + np.trace(cov)
        precision = (1e-6 + d / 2) / (1e-6 + 0.5 * square)
        noise = (np.sum((b - A @ ridge) ** 2) + np.trace(A.T @ A @ cov)) / n
    return ridge, cov, noise


def assert_same_fit(model, reference, *, x_unit=1.0, y_unit=1.0, rtol=1e-6):
    """Assert that `model`, fitted in other units, equals `reference`.

    `x_unit` (scalar or one for each feature) and `y_unit` are the factors of the
    columns of `model`.
    """
    x_unit = np.broadcast_to(x_unit, reference.coef_.shape)
    ratio = y_unit / x_unit
    finite = np.isfinite(reference.coef_std_)
    scale = np.abs(reference.coef_noisy_).max() + 1e-300
    for name, unit in (
        ("coef_", ratio),
        ("coef_noisy_", ratio),
        ("coef_std_", np.abs(ratio)),
    ):
        found, expected = getattr(model, name) / unit, getattr(reference, name)
        np.testing.assert_array_equal(np.isfinite(found), np.isfinite(expected))
        assert_allclose(found[finite], expected[finite], rtol=rtol, atol=rtol * scale)
    y_scale = np.sqrt(reference._query_noise) + abs(reference.intercept_)
    shift = (model.intercept_ / y_unit - reference.intercept_) / y_scale
    assert abs(shift) < rtol
    noise = model.input_noise_
    unit = x_unit**2 if noise.ndim == 1 else np.outer(x_unit, x_unit)
    assert_allclose(noise / unit, reference.input_noise_, rtol=rtol, atol=1e-12)
    assert_allclose(model.output_noise_ / y_unit**2, reference.output_noise_, rtol=rtol)
    if hasattr(reference, "relevant_"):
        np.testing.assert_array_equal(model.relevant_, reference.relevant_)
