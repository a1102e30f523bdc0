"""Inputs that generate exactly dependent inputs."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sklearn_vbjfa.regression._correlated import find_dependencies


def correlation(X):
    return np.corrcoef(X, rowvar=False)


def make_inputs(seed, n_generators=6, n_combined=12, n_free=3):
    """Return shuffled generators, convex combinations of them and other columns."""
    rng = np.random.default_rng(seed)
    t = rng.normal(size=(500, n_generators)) @ rng.normal(
        size=(n_generators, n_generators)
    )
    weights = rng.dirichlet(np.ones(n_generators), size=n_combined)
    X = np.hstack([t, t @ weights.T, rng.normal(size=(500, n_free))])
    order = rng.permutation(X.shape[1])
    free = np.arange(n_generators + n_combined, X.shape[1])
    expected = np.concatenate([np.arange(n_generators), free])
    return X[:, order], np.sort(np.flatnonzero(np.isin(order, expected)))


@pytest.mark.parametrize(("seed", "n_combined"), [*((k, 12) for k in range(5)), (0, 0)])
def test_generators_of_convex_combinations_are_found(seed, n_combined):
    X, expected = make_inputs(seed, n_combined=n_combined)
    found = find_dependencies(correlation(X))
    assert_array_equal(found.basis, expected)


def test_combinations_with_both_signs_have_a_basis():
    rng = np.random.default_rng(1)
    t = rng.normal(size=(400, 3))
    # Both signs: more extreme rays than dimensions.
    X = np.hstack([t, t @ rng.normal(size=(3, 6))])
    X -= X.mean(axis=0)
    found = find_dependencies(correlation(X))
    assert found.basis.size == 3
    residual = X - X[:, found.basis] @ np.linalg.lstsq(X[:, found.basis], X)[0]
    assert np.abs(residual).max() < 1e-9


def test_copies_are_grouped():
    rng = np.random.default_rng(2)
    t = rng.normal(size=(300, 3))
    X = np.column_stack([t[:, 0], t[:, 1], -2 * t[:, 0], t[:, 2], 5 * t[:, 0]])
    found = find_dependencies(correlation(X))
    assert found.basis.size == 3
    together = [group for group in found.copies if group.size > 1]
    assert len(together) == 1
    assert_array_equal(together[0], [0, 2, 4])
