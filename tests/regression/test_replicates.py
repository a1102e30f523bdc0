"""Input noise from repeated measurements: estimate, use and invalid input."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import VBJFARegressor, replicate_noise

COEF = np.array([1.0, -2.0, 0.5])


def make_replicates(seed, n_units, noise=0.5):
    """Measurements (2, n_units, 3), outputs, labels, and the true covariance.

    Noise is correlated between the columns, and so are the units.
    """
    rng = np.random.default_rng(seed)
    t = rng.normal(size=(n_units, 1)) + rng.normal(size=(n_units, 3))
    root = noise * np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 0.5]])
    X = t + rng.normal(size=(2, n_units, 3)) @ root.T
    y = t @ COEF + 0.3 * rng.normal(size=n_units)
    labels = np.tile(np.arange(n_units), 2)
    return X, y, labels, root @ root.T


def literal(X, groups):
    """Pooled covariance within groups, group by group."""
    total, dof = np.zeros((X.shape[1], X.shape[1])), 0
    for label in set(groups):
        rows = np.array([x for x, g in zip(X, groups) if g == label])
        for row in rows - rows.mean(axis=0):
            total += np.outer(row, row)
        dof += len(rows) - 1
    return total / dof, dof


@pytest.mark.parametrize("labels", [int, str])
def test_noise_equals_the_literal_estimate_with_unequal_groups(labels):
    rng = np.random.default_rng(0)
    groups = rng.integers(0, 12, 40)
    X = rng.normal(size=(40, 3)) + 1e3 * rng.normal(size=12)[groups][:, None]
    noise = replicate_noise(X, [labels(g) for g in groups])
    covariance, dof = literal(X, groups.tolist())
    assert_allclose(noise.covariance, covariance, rtol=1e-9)
    assert noise.dof == dof


def test_bias_of_least_squares_is_corrected():
    X, y, labels, _ = make_replicates(4, 2000)
    noise = replicate_noise(X.reshape(-1, 3), labels)
    model = VBJFARegressor(input_noise=noise, query="noiseless").fit(X[0], y)
    plain = LinearRegression().fit(X[0], y)
    assert np.abs(plain.coef_ - COEF).max() > 0.2
    assert np.all(np.abs(model.coef_ - COEF) < 4 * model.coef_std_)
    assert model.coef_std_.max() < 0.06


def test_intervals_cover_with_estimated_noise():
    # 60 degrees of freedom; 100 data sets of three coefficients; nominal coverage 90 %,
    # with three binomial standard deviations of the (dependent) 300 values.
    inside = []
    for seed in range(100):
        X, y, labels, _ = make_replicates(seed, 60)
        noise = replicate_noise(X.reshape(-1, 3), labels)
        model = VBJFARegressor(input_noise=noise, query="noiseless").fit(X[0], y)
        inside.append(np.abs(model.coef_ - COEF) < 1.645 * model.coef_std_)
    assert 0.83 < np.mean(inside) < 0.97


def test_invalid_input_is_refused():
    with pytest.raises(ValueError, match=r"some unit more than once.*got 4 units"):
        replicate_noise(np.eye(4), [1, 2, 3, 4])
    with pytest.raises(ValueError, match="must not contain None"):
        replicate_noise(np.eye(4), [None] * 4)
    with pytest.raises(ValueError, match="inconsistent numbers of samples"):
        replicate_noise(np.eye(4), [1, 1])
    with pytest.raises(ValueError, match="NaN"):
        replicate_noise([[np.nan], [1.0]], [1, 1])
