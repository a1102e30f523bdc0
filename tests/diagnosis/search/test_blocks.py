"""Time blocks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from sklearn_vbjfa.diagnosis.search._blocks import FEWEST, make_blocks


def blocks_of(lengths, correlation=0.05, filter_length=0.1, step=0.05):
    """Make blocks of recordings with the given numbers of rows."""
    time = np.arange(sum(lengths)) * step
    starts = np.r_[0, np.cumsum(lengths)[:-1]].astype(int)
    return make_blocks(time, starts, correlation, filter_length, range(len(lengths)))


@settings(deadline=None, max_examples=100)
@given(
    lengths=st.lists(st.integers(30, 900), min_size=1, max_size=4),
    correlation=st.floats(0.0, 3.0),
)
def test_blocks_and_folds_partition_the_rows(lengths, correlation):
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


def test_long_correlation_reduces_the_number_of_blocks():
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


def test_too_short_recordings_are_rejected():
    with pytest.raises(ValueError, match=r"4\.95 s .* 12 blocks.* at least 12 s"):
        blocks_of([100], filter_length=1.0)
