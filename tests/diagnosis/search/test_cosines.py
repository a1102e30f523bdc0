"""Discrete cosines of a recording's rows, and the spectrum of a residual."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import lfilter

from sklearn_vbjfa.diagnosis.search import Cosines, Spectrum

STEP = 0.02


def view(m=200, starts=(0,), missing=(), cutoff=np.inf, nv=2):
    """Rows of two joints, of which the first lacks some."""
    root = np.ones((m, nv))
    root[list(missing), 0] = 0.0
    return SimpleNamespace(
        index=np.arange(m),
        starts=np.array(starts),
        root=root,
        step=STEP,
        robot=SimpleNamespace(cutoff_=cutoff),
    )


# -- cosines


@pytest.mark.parametrize("starts", [(0,), (0, 80), (0, 1, 120)])
def test_they_are_orthonormal_and_invertible(starts):
    cosines = Cosines(view(starts=starts))
    basis = cosines(np.eye(200)[None], [0])[0]
    assert_allclose(basis @ basis.T, np.eye(200), atol=1e-12)
    x = np.random.default_rng(0).normal(size=(2, 200, 3))
    assert_allclose(cosines.rows(cosines(x, [0, 1])), x, atol=1e-12)


def test_what_lies_above_the_low_pass_is_left_out():
    nyquist = 0.5 / STEP
    cosines = Cosines(view(cutoff=nyquist / 4))
    slow, fast = (
        np.cos(np.pi * k * (np.arange(200) + 0.5) / 200)[None] for k in (10, 60)
    )
    assert cosines.band.size == pytest.approx(200 / 4, abs=1)
    assert_allclose(cosines.rows(cosines(slow, [0])), slow, atol=1e-12)
    assert_allclose(cosines(fast, [0]), 0.0, atol=1e-12)


def test_gaps_are_bridged_by_straight_lines():
    rows = np.arange(200)
    gap = [*range(40, 60), 100, *range(190, 200)]
    cosines = Cosines(view(missing=gap))
    line = 3.0 + 0.1 * rows
    broken = line.copy()
    broken[gap] = 0.0
    both = cosines.rows(cosines(np.array([broken, broken]), [0, 1]))
    expected = line.copy()
    # Beyond the last row that counts nothing is known.
    expected[190:] = line[189]
    assert_allclose(both[0], expected, atol=1e-10)
    # The other joint lacks nothing.
    assert_allclose(both[1], broken, atol=1e-10)
    assert_allclose(cosines.fill, [1 - len(gap) / 200, 1.0])


def test_bands_are_half_octaves_from_the_slowest():
    cosines = Cosines(view(m=4000))
    frequency = np.arange(4000) / (2 * 4000 * STEP)
    assert (np.diff(cosines.band) >= 0).all()
    assert_array_equal(np.unique(cosines.band), np.arange(cosines.octave.size))
    assert np.bincount(cosines.band).min() >= 2
    assert (np.diff(cosines.octave) > 0).all()
    top = frequency[cosines.band == cosines.octave.size - 2]
    assert top.max() / top.min() == pytest.approx(np.sqrt(2), rel=0.01)


# -- spectrum


def made(x, smoothness=1.0):
    """Spectrum of a series that nothing was fitted to, at each cosine."""
    cosines = Cosines(view(m=x.size, nv=1))
    own = cosines(x[None], [0])
    bands = cosines.octave.size
    power = np.bincount(cosines.band, own[0] ** 2, bands)[None]
    freedom = np.bincount(cosines.band, minlength=bands)[None].astype(float)
    spectrum = Spectrum.of(power, freedom, cosines.octave, smoothness)
    return cosines, 1.0 / spectrum.weights(cosines)[0][cosines.band]


def assert_known(cosines, ratio):
    """Compare with the truth, by the scatter that so many cosines leave."""
    deviation = np.sqrt(2.0 / np.bincount(cosines.band))[cosines.band]
    assert (np.abs(np.log(ratio)) < 3.0 * deviation + 0.02).all()


def test_a_white_spectrum_is_flat():
    x = 0.3 * np.random.default_rng(0).normal(size=20000)
    cosines, variance = made(x)
    assert_known(cosines, variance / 0.09)


@pytest.mark.parametrize("keep", [0.5, 0.95])
def test_the_spectrum_of_an_autoregression_is_found(keep):
    x = lfilter([1.0], [1.0, -keep], np.random.default_rng(1).normal(size=20000))
    cosines, variance = made(x)
    angle = np.pi * np.arange(x.size) / x.size
    truth = 1.0 / np.abs(1 - keep * np.exp(-1j * angle)) ** 2
    band_mean = np.bincount(cosines.band, truth) / np.bincount(cosines.band)
    assert_known(cosines, variance / band_mean[cosines.band])


def test_a_crooked_spectrum_is_less_probable():
    octave, freedom = np.arange(9.0), np.full((1, 9), 50.0)
    straight, crooked = np.full((1, 9), 50.0), np.full((1, 9), 50.0)
    crooked[0, 4] *= 100.0
    found = [
        Spectrum.of(power, freedom, octave, 1.0).log_prior
        for power in (straight, crooked)
    ]
    assert found[0] == pytest.approx(0.0, abs=1e-6)
    assert found[1] < -1.0


@pytest.mark.parametrize("share", [1.0, 0.5, 0.0])
def test_weights_follow_a_power_of_it_and_are_as_large_together(share):
    """Of a joint of which half is missing they are half, of an unheard one none."""
    cosines = Cosines(view(nv=3, missing=range(0, 200, 2)))
    count = np.diff(cosines.edges)
    variance = np.random.default_rng(0).uniform(0.1, 9.0, size=(3, count.size))
    variance[2] = np.inf
    weights = Spectrum(variance=variance, log_prior=0.0).weights(cosines, share)
    assert not weights[2].any()
    follows = weights[:2] * variance[:2] ** share
    assert_allclose(follows, follows[:, :1] * np.ones(count.size), rtol=1e-12)
    # What they say of noise with that spectrum, in the mean of all cosines.
    mean = (weights[:2] * variance[:2]) @ count / count.sum()
    assert_allclose(mean, [0.5, 1.0], rtol=1e-12)
