"""Wrong, doubtful and extreme input noise given to VB-JFA."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa import VBJFARegressor
from tests.regression._problems import make_regression

OFF_DIAGONAL = np.eye(4, k=1) + np.eye(4, k=-1)


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        (np.nan, r"must be finite, got NaN"),
        (1.5, r"in \[0, 1\), got 1\.5; give variances as an array"),
        (-0.1, r"in \[0, 1\), got -0\.1"),
        ([0.1, 0.1, -0.5, 0.1], r"must not be negative, got -0\.5 for feature 2"),
        ([0.1, 0.1], r"shape \(4,\) or a covariance of shape \(4, 4\).*shape \(2,\)"),
        (np.ones((1, 4, 4)), r"for 4 features, got an array of shape \(1, 4, 4\)"),
        (np.eye(4) + np.eye(4, k=1), r"must be symmetric"),
        (np.eye(4) - 2 * OFF_DIAGONAL, r"positive semidefinite, got a smallest eigen"),
        # An exact input cannot share noise with another.
        (np.diag([1.0, 0.0, 1.0, 1.0]) + OFF_DIAGONAL, r"must be positive semidef"),
    ],
)
def test_noise_that_cannot_be(noise, message):
    X, y, _ = make_regression(30)
    with pytest.raises(ValueError, match=message):
        VBJFARegressor(query="noiseless", input_noise=noise).fit(X, y)


def test_semidefinite_covariance_is_allowed():
    # One source of noise in all inputs: rank one, three eigenvalues zero to rounding.
    X, y, _ = make_regression(33)
    direction = np.array([0.1, -0.2, 0.3, 0.05])
    psi = np.outer(direction, direction)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = VBJFARegressor(
            query="noiseless", latent="correlated", input_noise=psi
        ).fit(X, y)
    assert_allclose(model.input_noise_, psi, rtol=0, atol=1e-12)
    assert np.isfinite(model.coef_).all()


def test_covariance_beyond_the_data_names_the_columns():
    X, y, _ = make_regression(34)
    factor = np.array([0.5, 1.5, 0.5, 2.0])
    psi = np.cov(X, rowvar=False) * np.outer(factor, factor)
    with pytest.warns(UserWarning, match=r"of 2 input\(s\) \(1, 3\): no signal.*units"):
        model = VBJFARegressor(
            query="noiseless", latent="correlated", input_noise=psi
        ).fit(X, y)
    assert np.isfinite(model.coef_).all()
    assert np.isfinite(model.output_noise_)
