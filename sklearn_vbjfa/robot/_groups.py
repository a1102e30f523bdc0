"""Recordings and their borders."""

import numpy as np


def contiguous_groups(groups, n_samples):
    """Return slices of the recordings, one for each run of equal labels.

    Parameters
    ----------
    groups : array-like of shape (n_samples,) or None
        Labels of separate recordings; None is one recording.
    n_samples : int
        Number of rows.
    """
    if groups is None:
        return [slice(0, n_samples)]
    labels = np.asarray(groups)
    if labels.shape != (n_samples,):
        raise ValueError(
            f"groups must hold one label per row, shape ({n_samples},); got shape "
            f"{labels.shape}."
        )
    borders = np.flatnonzero(labels[1:] != labels[:-1]) + 1
    starts = np.r_[0, borders]
    stops = np.r_[borders, n_samples]
    return [slice(int(a), int(b)) for a, b in zip(starts, stops)]


def check_dt(dt):
    """Return the sample period as a positive finite float."""
    try:
        value = float(dt)
    except (TypeError, ValueError):
        value = np.nan
    if dt is None or not np.isfinite(value) or value <= 0:
        raise ValueError(
            f"dt must be the sample period in seconds, positive and finite; got {dt!r}."
        )
    return value


def check_clock(t, n_samples, dt):
    """Return the time of each row [s]; counted in `dt` where none is given."""
    if t is None:
        return None if dt is None else np.arange(n_samples) * check_dt(dt)
    time = np.asarray(t, dtype=float)
    if time.shape != (n_samples,):
        raise ValueError(
            f"t must hold one time per row, shape ({n_samples},); got {time.shape}."
        )
    bad = np.flatnonzero(~(np.diff(time) > 0))
    if bad.size:
        raise ValueError(
            f"t must rise from row to row, over all recordings; it does not at row "
            f"{bad[0] + 1} ({time[bad[0]]:.6g} s, then {time[bad[0] + 1]:.6g} s)."
        )
    return time


def check_cutoff(cutoff, dt, name):
    """Return a cut-off in Hz as a float; infinity for None."""
    if cutoff is None:
        return np.inf
    try:
        value = float(cutoff)
    except (TypeError, ValueError):
        value = np.nan
    if not value > 0:
        raise ValueError(
            f"{name} must be a positive frequency in Hz, 'auto', or None for no "
            f"low-pass; got {cutoff!r}."
        )
    if np.isfinite(value) and value >= 0.5 / dt:
        raise ValueError(
            f"{name} must lie below the Nyquist frequency {0.5 / dt:.6g} Hz of "
            f"dt={dt:.6g} s; got {value:.6g} Hz. Give None for no low-pass."
        )
    return value
