"""The scaled eigen-decomposition: invariance to units, and results against NumPy."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa._core._linear_systems import scaled_eigen

UNITS = 10.0 ** np.array([-6.0, 0.0, 3.0, 6.0, -3.0])


def make_gram(seed, *, dependent=False):
    """Gram matrix of 50 rows in five columns of very different units, and the rows."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(50, 5))
    if dependent:
        rows[:, 4] = rows[:, 0] - 2 * rows[:, 2]
    rows = rows * UNITS
    return rows.T @ rows, rows


@pytest.mark.parametrize("dependent", [True, False])
def test_rank_does_not_depend_on_units(dependent):
    A, _ = make_gram(0, dependent=dependent)
    assert scaled_eigen(A).rank == 5 - dependent
    assert scaled_eigen(A / np.outer(UNITS, UNITS)).rank == 5 - dependent
    # Without scaling, columns that are small in their unit count as zero.
    assert scaled_eigen(A, scale=1.0).rank < 4


def test_singular_systems_have_the_least_norm_in_scaled_columns():
    A, rows = make_gram(2, dependent=True)
    eigen = scaled_eigen(A)
    scaled = rows / eigen.scale
    y = np.sin(np.arange(50.0))
    expected = np.linalg.lstsq(scaled, y, rcond=1e-12)[0] / eigen.scale
    assert_allclose(eigen.solve(rows.T @ y), expected, rtol=1e-7)
    inverse = np.linalg.pinv(scaled, rcond=1e-12)
    assert_allclose(
        eigen.inverse() * np.outer(eigen.scale, eigen.scale),
        inverse @ inverse.T,
        atol=1e-9,
    )
    unit = np.outer(UNITS, UNITS)
    assert_allclose(eigen.matrix() / unit, A / unit, atol=1e-10)
    # The dependency, in scaled coordinates: columns 0, 2 and 4 only.
    assert eigen.null_space.shape == (5, 1)
    assert_allclose(scaled @ eigen.null_space, 0.0, atol=1e-7)
    assert_array_equal(eigen.lost(1e-6), [True, False, True, False, True])
