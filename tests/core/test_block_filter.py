"""The blockwise low-pass filter against SciPy's polyphase filter."""

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose

from sklearn_vbjfa._core import _lowpass

FILTERS = [
    _lowpass.design(0.01, 5.0),
    _lowpass.design(0.01, 5.0, 1),
    _lowpass.design(0.01, 30.0),
    _lowpass.design(0.01, 1.0, 7),
    _lowpass.design(0.01, np.inf),
    _lowpass.design(0.01, np.inf, 3),
]


def polyphase(lowpass, x):
    """SciPy's filter, at samples where the whole filter lies in the recording."""
    output = scipy.signal.upfirdn(lowpass.taps, x, axis=0)
    return output[2 * lowpass.half : x.shape[0] : lowpass.step]


@pytest.mark.parametrize("lowpass", FILTERS)
@pytest.mark.parametrize("shape", [(), (3,), (2, 4)])
@pytest.mark.parametrize("n", [1, 400])
def test_equal_to_the_polyphase_filter(lowpass, shape, n):
    x = np.random.default_rng(0).normal(size=(n, *shape))
    found = lowpass(x)
    assert found.shape[0] == lowpass.centres(n).size
    assert_allclose(found, polyphase(lowpass, x), rtol=0, atol=1e-13)
