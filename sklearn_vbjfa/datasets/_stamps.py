"""Time stamps of a recording: are they equidistant, and if not, a grid that is."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

# Stamps within this share of a period of equidistant times are a steady clock that was
# written with few digits: the samples are taken as they are.
_STEADY = 0.02
# The median of rounded steps may be wrong by this share of a period.
_ROUNDED = 0.2
# A step longer than this many periods is a gap, not bridged by interpolation.
GAP_PERIODS = 5.0
# A slower clock [s] records no motion: stamps in ms or ns come out like that.
_SLOWEST = 1.0
# Relative difference between `dt` as given and as stamped.
_DT_TOLERANCE = 0.05


@dataclass(frozen=True, kw_only=True)
class TimeStamps:
    """What the time stamps of one recording tell.

    Attributes
    ----------
    dt : float
        Sample period [s].
    uniform : bool
        Whether the stamps are those of a steady clock, but for rounding and gaps.
    jitter : float
        Standard deviation of the steps from the period, gaps left out [s].
    shortest, longest : float
        Shortest and longest step, gaps left out [s].
    gaps : ndarray of int
        Rows after which more than five periods are missing.
    """

    dt: float
    uniform: bool
    jitter: float
    shortest: float
    longest: float
    gaps: np.ndarray


def inspect_time_stamps(t, dt=None, where=None) -> TimeStamps:
    """Check the time stamps of one recording.

    Parameters
    ----------
    t : array-like of shape (n_samples,)
        Time stamps [s].
    dt : float, default=None
        Sample period [s], if it is known; None estimates it.
    where : callable, default=None
        Turns a row (from 0) into words, for messages; None counts from 0.

    Returns
    -------
    TimeStamps
        Period and regularity.

    Raises
    ------
    ValueError
        If time stands still or runs backwards, is not in seconds, or contradicts
        `dt`.
    """
    t = np.asarray(t, dtype=float)
    where = where or (lambda row: f"row {row}")
    if t.ndim != 1 or t.size < 2:
        raise ValueError(f"t must hold two time stamps or more, got shape {t.shape}.")
    step = np.diff(t)
    bad = np.flatnonzero(~(step > 0))
    if bad.size:
        row = bad[0] + 1
        problem = "repeats" if step[bad[0]] == 0 else "runs backwards to"
        raise ValueError(
            f"time {problem} {t[row]:.9g} s in {where(row)} ({bad.size} such row(s)); "
            "remove doubled rows and sort the others, or mark separate recordings in "
            "a column segment."
        )
    period = float(np.median(step))
    if period >= _SLOWEST:
        raise ValueError(
            f"time steps by {period:.6g} s at the median, too slow for a motion; t "
            "must be in seconds (not ms or ns)."
        )
    gaps = np.flatnonzero(step > GAP_PERIODS * period)
    inside = np.delete(step, gaps)
    # The mean averages rounding out; missing samples count as the periods that they
    # are.
    mean = float(inside.sum() / np.maximum(np.round(inside / period), 1.0).sum())
    own = mean if abs(mean - period) < _ROUNDED * period else period
    if dt is None:
        dt = float(f"{own:.7g}")
    if abs(own - dt) > _DT_TOLERANCE * dt:
        raise ValueError(
            f"time steps by {own:.6g} s but dt = {dt:.6g} s; correct one of them, or "
            "leave out dt."
        )
    steady = max(2 * _STEADY * dt, 1.01 * _resolution(t, dt))
    uniform = True
    for piece in np.split(t, gaps + 1):
        late = piece - piece[0] - dt * np.arange(piece.size)
        uniform &= bool(np.ptp(late) <= steady)
    return TimeStamps(
        dt=float(dt),
        uniform=uniform,
        jitter=float(np.sqrt(np.mean((inside - dt) ** 2))),
        shortest=float(inside.min()),
        longest=float(inside.max()),
        gaps=gaps,
    )


def _resolution(t, dt):
    """Return the decimal step to which stamps were rounded [s], 0 for a fine one."""
    for digits in range(7):
        step = 10.0**-digits
        if step < 0.5 * dt:
            if np.abs(t - np.round(t, digits)).max() < 1e-6 * step:
                return step
            if step < _STEADY * dt:
                break
    return 0.0


def interpolate(t, channels, dt):
    """Interpolate from the neighbouring samples, positions with a smooth slope.

    Parameters
    ----------
    t : ndarray of shape (n_samples,)
        Time stamps from 0 on [s], increasing.
    channels : mapping of str to ndarray of shape (n_samples, ...)
        Values at the stamps; the one called "q" is interpolated by cubics, the others
        (noisier) by straight lines.
    dt : float
        Period of the grid [s].

    Returns
    -------
    grid : ndarray of shape (n_grid,)
        Multiples of `dt` [s].
    resampled : dict
        Values on the grid.
    """
    # Rounding of t must not cost the last point.
    grid = dt * np.arange(int(np.floor(t[-1] / dt + _STEADY)) + 1)
    query = np.minimum(grid, t[-1])
    resampled = {}
    for key, values in channels.items():
        rows = values.reshape(t.size, -1).astype(float)
        if key == "q" and t.size > 2:
            # Slopes of the parabolas through three samples: cubics, of third order,
            # that no far-off sample can disturb.
            slope = np.gradient(rows, t, axis=0, edge_order=2)
            rows = CubicHermiteSpline(t, rows, slope, axis=0)(query)
        else:
            rows = np.column_stack([np.interp(query, t, x) for x in rows.T])
        resampled[key] = rows.reshape(query.size, *values.shape[1:])
    return grid, resampled
