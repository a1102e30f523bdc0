"""Sufficient statistics: splits, weights, units and offsets."""

import functools
import itertools
import operator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa._core import _moments


def make_rows(seed, n_samples=300, n_features=4, offset=3.0):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n_samples, n_features)) @ rng.normal(size=(n_features,) * 2)
    X += offset * rng.normal(size=n_features)
    y = X @ rng.normal(size=n_features) + rng.normal(size=n_samples)
    return X, y, rng.uniform(0.1, 3.0, n_samples)


def scatter_of(moments):
    R = moments.factor_about(centred=True)
    return R.T @ R


def assert_same(found, expected, rtol=1e-12):
    """Equal up to rounding; scatter entries in units of their diagonal."""
    assert_allclose(found.n_samples, expected.n_samples, rtol=rtol)
    unit = np.sqrt(np.diagonal(scatter_of(expected)))
    shift = (found.mean - expected.mean) * np.sqrt(expected.n_samples) / unit
    assert_allclose(shift, 0.0, atol=rtol * np.sqrt(expected.n_samples))
    difference = (scatter_of(found) - scatter_of(expected)) / np.outer(unit, unit)
    assert_allclose(difference, 0.0, atol=rtol)


@settings(max_examples=25, derandomize=True, deadline=None)
@given(
    seed=st.integers(0, 2**20),
    cuts=st.lists(st.integers(1, 99), min_size=1, max_size=6, unique=True),
    order=st.randoms(use_true_random=False),
    weighted=st.booleans(),
)
def test_merge_in_any_chunks_and_order(seed, cuts, order, weighted):
    X, y, weight = make_rows(seed, 100)
    w = weight if weighted else None
    bounds = [0, *sorted(cuts), 100]
    pieces = [
        _moments.from_data(X[a:b], y[a:b], None if w is None else w[a:b])
        for a, b in itertools.pairwise(bounds)
    ]
    # A few rows are not expanded.
    for piece, (a, b) in zip(pieces, itertools.pairwise(bounds)):
        assert piece.factor.shape == (min(b - a, 6), 6)
    order.shuffle(pieces)
    total = functools.reduce(operator.add, pieces)
    assert_same(total, _moments.from_data(X, y, w))


@pytest.mark.parametrize("split", [1, 7])
def test_large_offset_only_adds_rounding(split):
    # Integers are exact: any difference is due to the accumulation.
    rng = np.random.default_rng(3)
    X = rng.integers(-1000, 1000, (500, 3)).astype(float)
    y = rng.integers(-1000, 1000, 500).astype(float)
    near = _moments.from_data(X, y)
    far = functools.reduce(
        operator.add,
        [
            _moments.from_data(X[rows] + 1e11, y[rows] + 1e11)
            for rows in np.array_split(np.arange(500), split)
        ],
    )
    # The mean is rounded by 1e11 eps = 2e-5, the standard deviation is 600, and the
    # scatter contains its square; raw second moments would have lost all digits.
    assert_allclose(far.mean - 1e11, near.mean, atol=1e-4)
    unit = np.sqrt(np.diagonal(scatter_of(near)))
    difference = (scatter_of(far) - scatter_of(near)) / np.outer(unit, unit)
    assert_allclose(difference, 0.0, atol=1e-7)


def test_a_scatter_gives_the_same_moments():
    X, y, _ = make_rows(5, offset=0.0)
    rows = np.column_stack([X, 1e6 * y])
    sums = rows.T @ rows
    scatter = _moments.Scatter(
        n_samples=300.0, S_xx=sums[:-1, :-1], S_xy=sums[:-1, -1], S_yy=sums[-1, -1]
    )
    found = _moments.from_scatter(scatter)
    assert_allclose(scatter_of(found), sums, rtol=1e-10)
    assert_array_equal(found.mean, 0.0)
    assert found.n_samples == 300.0


@pytest.mark.parametrize("weighted", [True, False])
@pytest.mark.parametrize("centred", [True, False])
@pytest.mark.parametrize("shape", [(200, 5), (6, 9)])
def test_standardised_moments_equal_those_of_the_rows(shape, centred, weighted):
    X, y, weight = make_rows(4, *shape)
    X[:, 1] = 0.1  # constant, which does not matter for moments about zero
    w = weight if weighted else np.ones(shape[0])
    found = _moments.standardise(
        _moments.from_data(X, y, weight if weighted else None), centred=centred
    )
    kept = (np.arange(shape[1]) != 1) | (not centred)
    assert_array_equal(found.active, kept)
    rows = np.column_stack([X[:, kept], y])
    mean = np.average(rows, axis=0, weights=w) * centred
    unit = np.sqrt(np.average((rows - mean) ** 2, axis=0, weights=w))
    assert_allclose(np.append(found.x_scale, found.y_scale), unit, rtol=1e-12)
    assert_allclose(found.x_offset[kept], mean[:-1], rtol=1e-12)
    rows = (rows - mean) / unit * np.sqrt(w)[:, None]
    n = found.moments.n
    assert_allclose(found.moments.S, rows[:, :-1].T @ rows[:, :-1], atol=1e-11 * n)
    assert_allclose(found.moments.xy, rows[:, :-1].T @ rows[:, -1], atol=1e-11 * n)
    assert_allclose([found.moments.xx.max(), found.moments.yy], n, rtol=1e-12)


@pytest.mark.parametrize("value", [0.0, -1e12 / 3, 1e-9])
@pytest.mark.parametrize("weighted", [True, False])
def test_constant_columns_are_not_active(value, weighted):
    X, y, weight = make_rows(6, 20_000)
    X[:, 2] = value
    w = weight if weighted else None
    data = _moments.standardise(_moments.from_data(X, y, w), centred=True)
    assert_array_equal(data.active, [True, True, False, True])
    assert_array_equal(data.expand([1.0, 2.0, 3.0]), [1.0, 2.0, 0.0, 3.0])
    expected = [1.0, 2.0, np.inf, 3.0]
    assert_array_equal(data.expand([1.0, 2.0, 3.0], fill=np.inf), expected)
