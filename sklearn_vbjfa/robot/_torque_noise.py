"""White noise of torque channels, measured where no motion is."""

import itertools
from math import comb

import numpy as np

from sklearn_vbjfa._core import _lowpass

# Number of bands above the fit's one; the quietest quarter counts, since vibrations
# and the drive's own ripple stand out of the noise, never below it.
_BANDS = 16
# Jumps of dry friction fill the whole spectrum; the lower quartile of high differences
# passes them over. It counts where it says that little less than the spectrum does.
_ORDER = 5
_CLEARLY_LESS = 0.7


def given_noise(given, nv, dt, cutoff):
    """Return the white torque noise (nv,) that passes the low-pass, from that given.

    Parameters
    ----------
    given : float or array-like of shape (nv,)
        Standard deviation of the white noise of a sample [N m or N].
    nv : int
        Number of joints.
    dt, cutoff : float
        Sample period [s], cut-off [Hz].
    """
    noise = np.asarray(given, dtype=float)
    if noise.shape not in {(), (nv,)} or not ((noise >= 0) & np.isfinite(noise)).all():
        raise ValueError(
            "torque_noise must be a non-negative standard deviation of one torque "
            f"sample [N m or N], or {nv} of them, or None; got {given!r}."
        )
    noise = np.broadcast_to(noise, (nv,))
    if not np.isfinite(cutoff):
        return noise.copy()
    taps = _lowpass.design(dt, cutoff).taps
    return noise * np.sqrt(taps @ taps)


def torque_noise(segments, dt, cutoff):
    """Measure the white torque noise that passes the low-pass.

    Parameters
    ----------
    segments : list of ndarray of shape (n_i, nv)
        Torques of separate recordings.
    dt : float or None
        Sample period [s].
    cutoff : float
        Cut-off of the low-pass [Hz].

    Returns
    -------
    ndarray of shape (nv,)
        Standard deviations [N m or N]; nan without a low-pass, or with one too close
        to the Nyquist frequency to see anything above it.
    """
    nv = segments[0].shape[1]
    if not seen(dt, cutoff):
        return np.full(nv, np.nan)
    power, weight = np.zeros((_BANDS, nv)), 0
    for x in segments:
        more = band_power(x, dt, cutoff)
        power, weight = power + more[0], weight + more[1]
    quartile = np.nan
    if weight:
        d = np.concatenate([high_differences(x) for x in segments])
        quartile = np.quantile(d, 0.25, axis=0, overwrite_input=True)
    return filtered_noise(power, weight, quartile, dt, cutoff)


def seen(dt, cutoff):
    """Whether anything lies between the low-pass and the Nyquist frequency."""
    return dt is not None and np.isfinite(cutoff) and 2 * cutoff <= 0.4 / dt


def band_power(x, dt, cutoff):
    """Power of one recording in bands above the fit's, to be summed over several.

    Parameters
    ----------
    x : ndarray of shape (n, nv)
        Torques.
    dt : float
        Sample period [s].
    cutoff : float
        Cut-off of the low-pass [Hz].

    Returns
    -------
    power : ndarray of shape (n_bands, nv)
        Power times the number of samples.
    n : int
        Number of samples that count.
    """
    n, nv = x.shape
    power = np.zeros((_BANDS, nv))
    if n < 64:
        return power, 0
    edges = np.linspace(2 * cutoff, 0.48 / dt, _BANDS + 1)
    taper = np.hanning(n + 2)[1:-1]
    # First differences keep the slow torque from leaking through the taper.
    d = np.diff(np.ascontiguousarray(x.T), axis=1)
    d -= d.mean(axis=1, keepdims=True)
    spectrum = np.abs(np.fft.rfft(d * taper[1:])) ** 2
    frequency = np.fft.rfftfreq(n - 1, dt)
    spectrum /= np.maximum(4 * np.sin(np.pi * frequency * dt) ** 2, 1e-12)
    borders = np.searchsorted(frequency, edges)
    for k, (low, high) in enumerate(itertools.pairwise(borders)):
        if high > low:
            mean = spectrum[:, low:high].mean(axis=1)
            power[k] = n * mean / (taper[1:] ** 2).sum()
    return power, n


def filtered_noise(power, weight, quartile, dt, cutoff):
    """Return the standard deviations of the noise that passes the low-pass.

    Parameters
    ----------
    power, weight
        Sums of `band_power`.
    quartile : ndarray of shape (nv,)
        Lower quartile of `high_differences` of all recordings.
    dt, cutoff : float
        Sample period [s], cut-off [Hz].
    """
    if not weight:
        return np.full(power.shape[1], np.nan)
    variance = np.quantile(power / weight, 0.25, axis=0)
    # The lower quartile of abs(x) is 0.3186 standard deviations of a normal variable.
    between = (quartile / 0.3186) ** 2 / comb(2 * _ORDER, _ORDER)
    variance = np.where(between < _CLEARLY_LESS**2 * variance, between, variance)
    taps = _lowpass.design(dt, cutoff).taps
    return np.sqrt(variance * (taps @ taps))


def high_differences(x):
    """Size of the differences of high order of one recording, (n, nv)."""
    return np.abs(np.diff(x, n=_ORDER, axis=0))
