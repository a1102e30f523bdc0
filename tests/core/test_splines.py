"""Splines by their coefficients against SciPy's, whole and in pieces."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from sklearn_vbjfa._core import _smoothing, _splines

CASES = [(0.002, 15.0), (0.01, 4.0), (0.01, np.inf), (0.002, 100.0), (0.004, 6.1)]


def wave(n, seed=0):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(size=n)) + 3.0


def tolerance(cutoff):
    """Without smoothing a penalty of 1e-9 alone holds the ends: rounding over that."""
    return 1e-9 if np.isfinite(cutoff) else 1e-7


@pytest.mark.parametrize(("dt", "cutoff"), CASES)
@pytest.mark.parametrize("n", [100, 101, 617])
def test_equal_to_scipy_on_the_samples(n, dt, cutoff):
    x = wave(n)
    spline = _splines.fit(x, dt, cutoff)
    for order, expected in enumerate(_smoothing.smooth(x, dt, cutoff)):
        size = np.abs(expected).max()
        atol = tolerance(cutoff) * size
        assert_allclose(spline(0, n, order), expected, rtol=0, atol=atol)


@pytest.mark.parametrize(("dt", "cutoff"), CASES)
@pytest.mark.parametrize("n", [100, 101, 618])
@pytest.mark.parametrize("shift", [0, 1])
def test_halves_at_all_samples_are_scipys(n, dt, cutoff, shift):
    # Half of the rows lie between the samples, up to one beyond either end.
    samples = wave(n)[shift::2]
    spline = _splines.fit(samples, 2 * dt, cutoff, every=2, shift=shift)
    at = (np.arange(n) - shift) * dt
    expected = _smoothing.smooth(samples, 2 * dt, cutoff, at=at)
    for order in range(3):
        size = np.abs(expected[order]).max()
        atol = 10 * tolerance(cutoff) * size
        assert_allclose(spline(0, n, order), expected[order], rtol=0, atol=atol)


@settings(max_examples=30, derandomize=True, deadline=None)
@given(
    n=st.integers(20, 300),
    cut=st.tuples(st.floats(0, 1), st.floats(0, 1)),
    case=st.sampled_from(CASES),
    half=st.sampled_from([(1, 0), (2, 0), (2, 1)]),
)
def test_any_stretch_is_that_of_the_whole(n, cut, case, half):
    every, shift = half
    dt, cutoff = case
    spline = _splines.fit(
        wave(n)[shift::every], every * dt, cutoff, every=every, shift=shift
    )
    start, stop = sorted(int(c * n) for c in cut)
    stop = max(stop, start + 1)
    for order in range(3):
        whole = spline(0, n + 1, order)
        size = np.abs(whole).max()
        assert_allclose(
            spline(start, stop, order), whole[start:stop], rtol=0, atol=1e-13 * size
        )
