"""Blocks of time and the correlation that they must outlast."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa.diagnosis.search._blocks import FEWEST, correlation_time, make_blocks


def blocks_of(lengths, correlation=0.05, filter_length=0.1, step=0.05):
    """Blocks of recordings with so many rows."""
    time = np.arange(sum(lengths)) * step
    starts = np.r_[0, np.cumsum(lengths)[:-1]].astype(int)
    return make_blocks(time, starts, correlation, filter_length)


def autoregression(rho, n, seed=0):
    rng = np.random.default_rng(seed)
    x = np.zeros(n)
    for i in range(1, n):
        x[i] = rho * x[i - 1] + rng.normal()
    return x


# -- blocks


@settings(deadline=None, max_examples=100)
@given(
    lengths=st.lists(st.integers(30, 900), min_size=1, max_size=4),
    correlation=st.floats(0.0, 3.0),
)
def test_blocks_and_folds_divide_the_rows(lengths, correlation):
    total = sum((n - 1) * 0.05 for n in lengths)
    if total / FEWEST < 0.1:
        return
    blocks = blocks_of(lengths, correlation)
    label = blocks.label
    assert label[0] == 0
    assert set(np.diff(label)) <= {0, 1}
    assert blocks.n_blocks == label[-1] + 1 == np.unique(label).size
    assert_array_equal(blocks.fold, label % blocks.n_folds)
    borders = np.cumsum(lengths)[:-1]
    assert np.all(label[borders] == label[borders - 1] + 1)
    assert blocks.length == pytest.approx(total / blocks.n_blocks)


def test_blocks_are_of_like_length():
    blocks = blocks_of([1000, 500])
    count = np.bincount(blocks.label)
    assert count.max() - count.min() <= 2
    assert 40 <= blocks.n_blocks <= 61
    assert np.bincount(blocks.label[:1000]).size == pytest.approx(
        2 * np.unique(blocks.label[1000:]).size, abs=1
    )


def test_long_correlation_makes_fewer_blocks_but_not_too_few():
    many, some, few = (
        blocks_of([4000], correlation).n_blocks for correlation in (0.01, 0.4, 1e3)
    )
    assert many == 60
    assert some == 49
    assert few == 40


def test_no_block_is_shorter_than_the_filter():
    blocks = blocks_of([600], filter_length=2.0)
    assert blocks.length >= 2.0
    assert FEWEST <= blocks.n_blocks <= 15


def test_every_fold_has_blocks_from_all_over():
    blocks = blocks_of([1200])
    assert blocks.n_folds == 8
    for k in range(8):
        of_fold = np.unique(blocks.label[blocks.fold == k])
        assert_array_equal(np.diff(of_fold), 8)


def test_sums_are_over_each_block():
    blocks = blocks_of([300, 200])
    values = np.random.default_rng(0).normal(size=(500, 2))
    expected = [values[blocks.label == b].sum(axis=0) for b in range(blocks.n_blocks)]
    assert_allclose(blocks.sums(values), expected)
    assert_allclose(blocks.sums(values[:, 0]), np.array(expected)[:, 0])


def test_too_short_recordings_are_refused():
    with pytest.raises(ValueError, match=r"hold 4\.95 s .* too little for 12 blocks"):
        blocks_of([100], filter_length=1.0)
    with pytest.raises(ValueError, match="record at least 12 s"):
        blocks_of([100], filter_length=1.0)


# -- correlation


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
def test_correlation_time_of_an_autoregression(rho):
    """Sum of rho^k over both sides: (1 + rho) / (1 - rho) steps."""
    x = autoregression(rho, 20000)[:, None]
    found = correlation_time(x, np.ones_like(x), 0.1, np.array([0]))
    assert found == pytest.approx(0.1 * (1 + rho) / (1 - rho), rel=0.25)


def test_correlation_time_is_the_longest_of_the_joints():
    x = np.column_stack([autoregression(0.2, 5000), autoregression(0.9, 5000, 1)])
    both = correlation_time(x, np.ones_like(x), 0.1, np.array([0]))
    slow = correlation_time(x[:, 1:], np.ones((5000, 1)), 0.1, np.array([0]))
    assert both == slow
    masked = correlation_time(x, np.array([1.0, 0.0]) * np.ones_like(x), 0.1, [0])
    assert masked < 0.3 * both


def test_correlation_does_not_reach_across_recordings():
    """Recordings that begin at other levels than those on which the last ended."""
    lengths = np.full(30, 60)
    x = np.concatenate([autoregression(0.8, 60, seed) for seed in range(30)])
    starts = np.r_[0, np.cumsum(lengths)[:-1]]
    x = x[:, None]
    apart = correlation_time(x, np.ones_like(x), 1.0, starts)
    assert apart == pytest.approx(1.8 / 0.2, rel=0.25)
    jumping = x + np.repeat(np.tile([40.0, -40.0], 15), lengths)[:, None]
    inside = correlation_time(jumping, np.ones_like(x), 1.0, starts)
    across = correlation_time(jumping, np.ones_like(x), 1.0, np.array([0]))
    assert across < 0.5 * inside


def test_nothing_left_is_not_correlated():
    assert correlation_time(np.zeros((50, 2)), np.ones((50, 2)), 1.0, [0]) == 0.0
