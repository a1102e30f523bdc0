"""The low-pass in blocks against SciPy's polyphase filter."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa._core._lowpass import BlockFilter, block_length, decimate

FILTERS = [
    _lowpass.design(0.01, 5.0),
    _lowpass.design(0.01, 5.0, 1),
    _lowpass.design(0.01, 30.0),
    _lowpass.design(0.01, 1.0, 7),
    _lowpass.design(0.01, np.inf),
    _lowpass.design(0.01, np.inf, 3),
]


@pytest.mark.parametrize("lowpass", FILTERS)
@pytest.mark.parametrize("shape", [(), (3,), (2, 4)])
@pytest.mark.parametrize("n", [1, 40, 400, 1001])
def test_equal_to_the_polyphase_filter(lowpass, shape, n):
    x = np.random.default_rng(0).normal(size=(n, *shape))
    ours = decimate(lowpass, x)
    assert ours.shape[0] == lowpass.centres(n).size
    assert_allclose(ours, lowpass(x), rtol=0, atol=1e-13)


@settings(max_examples=40, derandomize=True, deadline=None)
@given(
    lowpass=st.sampled_from(FILTERS),
    steps=st.integers(1, 30),
    n=st.integers(300, 900),
)
def test_length_of_the_blocks_does_not_matter(lowpass, steps, n):
    x = np.random.default_rng(1).normal(size=(n, 6))
    result = BlockFilter(lowpass, lowpass.centres(n).size, 6)
    length = steps * lowpass.step
    for first in range(0, n, length):
        result.add(first, x[first : first + length])
    assert_allclose(result.outputs, lowpass(x), rtol=0, atol=1e-13)


@pytest.mark.parametrize("lowpass", FILTERS)
@pytest.mark.parametrize("row_bytes", [8, 8800, 1 << 24])
def test_blocks_begin_at_outputs(lowpass, row_bytes):
    length = block_length(lowpass, row_bytes)
    assert length > 0
    assert length % lowpass.step == 0
    limit = max(_lowpass._MIN_ROWS, 2 * lowpass.half) + lowpass.step
    assert length <= limit or not lowpass.half
