"""Columns of unit length and least squares: units, offsets, constant columns."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa._core._linear_systems import scaled_lstsq, unit_columns


def make_columns(unit, offset, n_samples=200):
    """Make columns with any unit and offset, and weights."""
    rng = np.random.default_rng(0)
    weight = rng.uniform(0.5, 2.0, size=n_samples)
    return unit * (rng.normal(size=(n_samples, 3)) + offset), weight


@pytest.mark.parametrize("center", [True, False])
@pytest.mark.parametrize("offset", [0.0, 1e3, 1e8])
@pytest.mark.parametrize("unit", [1e-200, 1e-6, 1.0, 1e200])
def test_moments(unit, offset, center):
    X, weight = make_columns(unit, offset)
    result = unit_columns(X, weight, center=center)
    mean = np.average(X / unit, axis=0, weights=weight) * unit * center
    assert_allclose(result.mean, mean, rtol=1e-13, atol=1e-14 * unit)
    root = np.sqrt(weight)[:, np.newaxis]
    assert_allclose(np.sum(result.values**2, axis=0), 1.0, rtol=1e-13)
    assert_allclose(result.values / root * result.scale + result.mean, X, rtol=1e-11)
    if center:
        # The second pass of the mean removes the offset completely.
        assert_allclose(root[:, 0] @ result.values, 0.0, atol=1e-13)


def test_constant_columns_become_zero():
    rng = np.random.default_rng(0)
    angle = rng.normal(size=500)
    X = np.column_stack(
        [
            np.full(500, 0.1),
            np.full(500, -1e300),
            np.zeros(500),
            np.sin(angle) ** 2 + np.cos(angle) ** 2,
        ]
    )
    assert np.ptp(X[:, 3]) > 0
    weight = rng.uniform(0.5, 2.0, size=500)
    result = unit_columns(X, weight, center=True)
    assert_array_equal(result.values, np.zeros(X.shape))
    assert_array_equal(result.scale, np.ones(4))
    assert_allclose(result.mean, X[0], rtol=1e-14)
    varying = unit_columns(1.0 + 1e-13 * X[:, 3:] * angle[:, None], weight, center=True)
    assert_allclose(np.sum(varying.values**2), 1.0)


@pytest.fixture
def failing_svd(monkeypatch):
    """Let the default decomposition fail, as for some matrices with zeros."""

    def fail(*arguments, **keywords):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", fail)


def test_least_squares_if_the_svd_does_not_converge(failing_svd):
    rng = np.random.default_rng(1)
    matrix = np.column_stack([rng.normal(size=(20, 3)), np.zeros(20)])
    found = scaled_lstsq(matrix, matrix @ [1.0, -2.0, 3.0, 4.0])
    assert_allclose(found.coef, [1.0, -2.0, 3.0, 0.0], atol=1e-12)
    assert found.rank == 3
