"""Splines of unpenalised motions and of joints at rest."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa._core import _smoothing


@pytest.mark.parametrize(("dt", "cutoff"), [(0.002, 15.0), (0.01, 4.0), (0.004, 6.1)])
@pytest.mark.parametrize("n", [101, 618])
@pytest.mark.parametrize("shift", [0, 1])
def test_every_second_row_gives_all_samples(n, dt, cutoff, shift):
    # Half of the rows are between the samples, up to one row beyond each end.
    u = np.linspace(-1.0, 1.0, n)
    powers = np.array([0.5, -0.3, 1.0, 0.2])
    samples = np.polyval(powers, u)[shift::2]
    spline = _smoothing.fit(samples, 2 * dt, cutoff, every=2, shift=shift)
    unit = 2.0 / ((n - 1) * dt)
    for order in range(3):
        expected = np.polyval(np.polyder(powers, order), u)
        found = spline(0, n, order) / unit**order
        assert_allclose(found, expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("dt", "cutoff"), [(0.008, 8.0), (0.002, 3.0), (0.008, np.inf)]
)
def test_unpenalised_motions_keep_all_digits(dt, cutoff):
    # For degree four, the fifth differences of the coefficients and the residuals are
    # zero for any cut-off.
    n = 2000
    u = np.linspace(-1.0, 1.0, n)
    powers = np.array([0.3, -0.8, 0.5, 1.0, -0.7])
    spline = _smoothing.fit(np.polyval(powers, u), dt, cutoff)
    unit = 2.0 / ((n - 1) * dt)
    size = np.abs(spline.coef).max()
    for order in range(3):
        expected = np.polyval(np.polyder(powers, order), u) * unit**order
        # Rounding of a coefficient, differentiated: a few eps over the powers of h.
        # At free ends the penalty of interpolation is 1e-9, with an effect of its root.
        atol = 16 * np.finfo(float).eps * size * (2 / spline.h) ** order
        inner = slice(40, -40) if np.isinf(cutoff) else slice(None)
        assert_allclose(spline(0, n, order)[inner], expected[inner], rtol=0, atol=atol)


@pytest.mark.parametrize("cutoff", [8.0, 20.0, np.inf])
@pytest.mark.parametrize("seed", range(3))
def test_signs_of_velocities_do_not_depend_on_rounding(cutoff, seed):
    # The encoder reading is constant for seconds between motions.
    t = 0.008 * np.arange(5000)
    q = 2.0 + np.sin(np.pi * np.clip(t % 8.0 - 3.0, 0.0, 2.0)) ** 3
    q = np.round(q / 1e-4) * 1e-4
    other = q * (
        1 + np.finfo(float).eps * np.random.default_rng(seed).normal(size=5000)
    )
    signs = [np.sign(_smoothing.fit(x, 0.008, cutoff)(0, 5000, 1)) for x in (q, other)]
    assert (signs[0] == 0).sum() > 1000
    assert (signs[0] != 0).sum() > 1000
    assert np.array_equal(*signs)
