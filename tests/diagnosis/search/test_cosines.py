"""Discrete cosine transform of the rows, and the residual spectrum."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import lfilter

from sklearn_vbjfa.diagnosis.search._cosines import Cosines, Spectrum

STEP = 0.02


def view(m=200, starts=(0,), missing=(), cutoff=np.inf, nv=2):
    """Rows of two joints; `missing` rows of the first joint have no weight."""
    root = np.ones((m, nv))
    root[list(missing), 0] = 0.0
    return SimpleNamespace(
        index=np.arange(m),
        starts=np.array(starts),
        root=root,
        step=STEP,
        robot=SimpleNamespace(cutoff_=cutoff),
    )


@pytest.mark.parametrize("starts", [(0,), (0, 80), (0, 1, 101)])
def test_cosines_are_orthonormal_and_invertible(starts):
    cosines = Cosines(view(starts=starts))
    basis = cosines(np.eye(200)[None], [0])[0]
    assert_allclose(basis @ basis.T, np.eye(200), atol=1e-12)
    x = np.random.default_rng(0).normal(size=(2, 200, 3))
    assert_allclose(cosines.rows(cosines(x, [0, 1])), x, atol=1e-12)


def test_lengths_with_large_prime_factors_are_extended():
    cosines = Cosines(view(m=199 + 97, starts=(0, 199)))
    assert_allclose(cosines.fill, (199 + 97) / (200 + 98))
    x = np.random.default_rng(0).normal(size=(2, 199 + 97, 3))
    assert_allclose(cosines.rows(cosines(x, [0, 1])), x, atol=1e-12)
    # The last value is repeated.
    held = cosines(np.ones((1, 199 + 97)), [0])[0]
    assert_allclose(np.sort(held)[-2:], np.sqrt([98, 200]))
    assert_allclose(np.sort(held)[:-2], 0.0, atol=1e-12)


def test_frequencies_above_the_cutoff_are_omitted():
    nyquist = 0.5 / STEP
    cosines = Cosines(view(cutoff=nyquist / 4))
    slow, fast = (
        np.cos(np.pi * k * (np.arange(200) + 0.5) / 200)[None] for k in (10, 60)
    )
    assert cosines.band.size == pytest.approx(200 / 4, abs=1)
    assert_allclose(cosines.rows(cosines(slow, [0])), slow, atol=1e-12)
    assert_allclose(cosines(fast, [0]), 0.0, atol=1e-12)


def test_gaps_are_interpolated_linearly():
    rows = np.arange(200)
    gap = [*range(40, 60), 100, *range(190, 200)]
    cosines = Cosines(view(missing=gap))
    line = 3.0 + 0.1 * rows
    broken = line.copy()
    broken[gap] = 0.0
    filled = cosines.rows(cosines(np.array([broken, broken]), [0, 1]))
    expected = line.copy()
    # The last valid value is held up to the end.
    expected[190:] = line[189]
    assert_allclose(filled[0], expected, atol=1e-10)
    # The other joint has no gaps.
    assert_allclose(filled[1], broken, atol=1e-10)
    assert_allclose(cosines.fill, [1 - len(gap) / 200, 1.0])


def test_bands_are_half_octaves():
    cosines = Cosines(view(m=4000))
    frequency = np.arange(4000) / (2 * 4000 * STEP)
    assert (np.diff(cosines.band) >= 0).all()
    assert_array_equal(np.unique(cosines.band), np.arange(cosines.octave.size))
    assert np.bincount(cosines.band).min() >= 2
    assert (np.diff(cosines.octave) > 0).all()
    top = frequency[cosines.band == cosines.octave.size - 2]
    assert top.max() / top.min() == pytest.approx(np.sqrt(2), rel=0.01)


def estimate_spectrum(x, smoothness=1.0):
    """Estimate the spectrum of a series at each cosine."""
    cosines = Cosines(view(m=x.size, nv=1))
    values = cosines(x[None], [0])
    bands = cosines.octave.size
    power = np.bincount(cosines.band, values[0] ** 2, bands)[None]
    freedom = np.bincount(cosines.band, minlength=bands)[None].astype(float)
    spectrum = Spectrum.of(power, freedom, cosines.octave, smoothness)
    return cosines, 1.0 / spectrum.weights(cosines)[0][cosines.band]


def assert_known(cosines, ratio):
    """Compare with the truth, within the sampling error of each band."""
    deviation = np.sqrt(2.0 / np.bincount(cosines.band))[cosines.band]
    assert (np.abs(np.log(ratio)) < 3.0 * deviation + 0.02).all()


def test_a_white_spectrum_is_flat():
    x = 0.3 * np.random.default_rng(0).normal(size=20000)
    cosines, variance = estimate_spectrum(x)
    assert_known(cosines, variance / 0.09)


@pytest.mark.parametrize("keep", [0.5, 0.95])
def test_spectrum_of_an_autoregression(keep):
    x = lfilter([1.0], [1.0, -keep], np.random.default_rng(1).normal(size=20000))
    cosines, variance = estimate_spectrum(x)
    angle = np.pi * np.arange(x.size) / x.size
    truth = 1.0 / np.abs(1 - keep * np.exp(-1j * angle)) ** 2
    band_mean = np.bincount(cosines.band, truth) / np.bincount(cosines.band)
    assert_known(cosines, variance / band_mean[cosines.band])


def test_the_prior_prefers_smooth_spectra():
    octave, freedom = np.arange(9.0), np.full((1, 9), 50.0)
    smooth, rough = np.full((1, 9), 50.0), np.full((1, 9), 50.0)
    rough[0, 4] *= 100.0
    priors = [
        Spectrum.of(power, freedom, octave, 1.0).log_prior for power in (smooth, rough)
    ]
    assert priors[0] == pytest.approx(0.0, abs=1e-6)
    assert priors[1] < -1.0


@pytest.mark.parametrize("share", [1.0, 0.5, 0.0])
def test_weights_are_a_normalised_power_of_the_spectrum(share):
    """Half the weight if half of the rows are missing, none for an unused joint."""
    cosines = Cosines(view(nv=3, missing=range(0, 200, 2)))
    count = np.diff(cosines.edges)
    variance = np.random.default_rng(0).uniform(0.1, 9.0, size=(3, count.size))
    variance[2] = np.inf
    weights = Spectrum(variance=variance, log_prior=0.0).weights(cosines, share)
    assert not weights[2].any()
    follows = weights[:2] * variance[:2] ** share
    assert_allclose(follows, follows[:, :1] * np.ones(count.size), rtol=1e-12)
    # Weighted noise power with that spectrum, in the mean of all cosines.
    mean = (weights[:2] * variance[:2]) @ count / count.sum()
    assert_allclose(mean, [0.5, 1.0], rtol=1e-12)
