"""The zero-phase low-pass filter: frequency response, edges and decimation."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa._core import _lowpass

# Sample period and cut-off from a tenth to a third of the Nyquist frequency.
DESIGNS = [(0.01, 5.0), (0.002, 20.0), (1e-3, 150.0), (1.0, 0.05)]


def response(filt, frequency, dt):
    """Amplitude at given frequencies; real, because the taps are symmetric."""
    k = np.arange(-filt.half, filt.half + 1)
    return np.cos(2 * np.pi * np.outer(frequency, k) * dt) @ filt.taps


@pytest.mark.parametrize(("dt", "cutoff"), DESIGNS)
def test_frequency_response(dt, cutoff):
    filt = _lowpass.design(dt, cutoff)
    assert_allclose(response(filt, [0.0], dt), 1.0, rtol=1e-14)
    # Half amplitude within 5 % of the cut-off; below -55 dB from 1.5 times it on.
    low, high = response(filt, np.array([0.95, 1.05]) * cutoff, dt)
    assert low > 0.5 > high
    stop = response(filt, np.linspace(1.5 * cutoff, 0.5 / dt, 2000), dt)
    assert 20 * np.log10(np.abs(stop).max()) < -55
    # The transition band is symmetric.
    passband = response(filt, np.linspace(0.0, 0.5 * cutoff, 500), dt)
    assert_allclose(passband, 1.0, atol=2e-3)


def test_a_short_recording_gives_no_output():
    filt = _lowpass.design(0.01, 5.0)
    assert filt(np.ones((2 * filt.half, 3))).shape == (0, 3)
    assert filt.centres(2 * filt.half).size == 0
    assert_allclose(filt(np.ones((2 * filt.half + 1, 3))), np.ones((1, 3)), rtol=1e-14)


@pytest.mark.parametrize("cutoff", [np.inf, 50.0, 200.0])
def test_nothing_is_filtered_at_or_above_the_nyquist_frequency(cutoff):
    x = np.random.default_rng(1).normal(size=(20, 2))
    assert_array_equal(_lowpass.design(0.01, cutoff)(x), x)
    assert_array_equal(_lowpass.design(0.01, cutoff, step=3)(x), x[::3])
