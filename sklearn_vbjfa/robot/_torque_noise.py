"""White noise of torque channels, measured where no motion is."""

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
    if dt is None or not np.isfinite(cutoff) or 2 * cutoff > 0.4 / dt:
        return np.full(nv, np.nan)
    edges = np.linspace(2 * cutoff, 0.48 / dt, _BANDS + 1)
    power, weight = np.zeros((_BANDS, nv)), 0.0
    for x in segments:
        n = x.shape[0]
        if n < 64:
            continue
        taper = np.hanning(n + 2)[1:-1, None]
        # First differences keep the slow torque from leaking through the taper.
        d = np.diff(x, axis=0)
        spectrum = np.abs(np.fft.rfft((d - d.mean(axis=0)) * taper[1:], axis=0)) ** 2
        frequency = np.fft.rfftfreq(n - 1, dt)
        spectrum /= np.maximum(4 * np.sin(np.pi * frequency * dt) ** 2, 1e-12)[:, None]
        for k in range(_BANDS):
            inside = (frequency >= edges[k]) & (frequency < edges[k + 1])
            if inside.any():
                power[k] += n * spectrum[inside].mean(axis=0) / (taper[1:] ** 2).sum()
        weight += n
    if weight == 0.0:
        return np.full(nv, np.nan)
    variance = np.quantile(power / weight, 0.25, axis=0)
    between = _between_jumps(segments)
    variance = np.where(between < _CLEARLY_LESS**2 * variance, between, variance)
    taps = _lowpass.design(dt, cutoff).taps
    return np.sqrt(variance * (taps @ taps))


def _between_jumps(segments):
    """Variance of white noise from the small among differences of high order."""
    d = np.concatenate([np.diff(x, n=_ORDER, axis=0) for x in segments])
    # The lower quartile of abs(x) is 0.3186 standard deviations of a normal variable.
    deviation = np.quantile(np.abs(d), 0.25, axis=0) / 0.3186
    return deviation**2 / comb(2 * _ORDER, _ORDER)
