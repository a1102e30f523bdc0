"""Curves for the pictures of a finished search, thinned."""

import itertools
from dataclasses import dataclass

import numpy as np

# Joints that are drawn, those with the largest errors.
_WORST = 3
# Most points of a curve over time, and of a cloud; rows of an autocorrelation.
_CURVE, _DOTS, _LAGS = 480, 200, 40
# Fewest rows of a cloud.
_FEWEST = 8
# Rows that are farther apart than this many usual steps have something between them.
_GAP = 2.5


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualCurves:
    """Residual of a joint on the held-out part, over its torque and its own past."""

    joint: int  # from zero
    # (k,): torque predicted by the completed model, and the residual [N m or N]
    predicted: np.ndarray
    residual: np.ndarray
    lags: np.ndarray  # (l,): [s], or rows
    correlation: np.ndarray  # (l,): autocorrelation
    chance: float  # that of white noise, with a probability of 90 %


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueCurves:
    """Measured and predicted torque of a joint on the held-out part, over time."""

    joint: int  # from zero
    seconds: np.ndarray  # (k,): held-out time, or rows, the stretches joined
    # (k,): filtered; predicted by the declared and by the completed model, both fitted
    # to the search part [N m or N]; nan where rows are missing
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray
    counts: np.ndarray  # (k,): whether the joint moves, so that errors count there


def worst_joints(errors):
    """Joints with the largest errors (nv,), the worst first."""
    order = np.argsort(-np.nan_to_num(errors, nan=-1.0), kind="stable")
    return order[:_WORST].tolist()


def residual_curves(after, dt, joints):
    """Residuals over predictions and over lags, a tuple of `ResidualCurves`."""
    index = after.index - after.index[0]
    step = int(np.median(np.diff(index))) if index.size > 1 else 1
    grid, found = index // step, []
    for j in joints:
        rows = np.flatnonzero(after.weight[:, j] > 0)
        if rows.size < _FEWEST:
            continue
        line = np.zeros(2 ** int(np.ceil(np.log2(2 * (grid[-1] + 1)))))
        line[grid[rows]] = after.residual[rows, j]
        power = np.fft.irfft(np.abs(np.fft.rfft(line)) ** 2)
        lags, shown = np.arange(min(_LAGS, rows.size)), rows[:: -(-rows.size // _DOTS)]
        found.append(
            ResidualCurves(
                joint=j,
                predicted=after.predicted[shown, j],
                residual=after.residual[shown, j],
                lags=lags * step * (1.0 if dt is None else dt),
                correlation=power[lags] / (power[0] or 1.0),
                chance=1.645 / np.sqrt(rows.size),
            )
        )
    return tuple(found)


def torque_curves(before, after, clock, joints):
    """Torques over time of two models, from residuals; a tuple of `TorqueCurves`."""
    # Held-out stretches follow one another, with a gap between them.
    seconds = before.index if clock is None else clock[before.index]
    step = float(np.median(np.diff(seconds))) if seconds.size > 1 else 1.0
    gaps = np.flatnonzero(np.diff(seconds) > _GAP * step) + 1
    at = step * np.arange(seconds.size + gaps.size)
    found = []
    for j in joints:
        columns = before.torque, before.predicted, after.predicted, before.weight
        measured, *predicted, weight = (
            np.insert(x[:, j], gaps, np.nan) for x in columns
        )
        counts = weight > 0
        left = np.where(counts, measured - predicted[1], 0.0)
        rows = np.union1d(_extremes(measured), _extremes(left))
        found.append(
            TorqueCurves(
                joint=j,
                seconds=at[rows],
                measured=measured[rows],
                before=predicted[0][rows],
                after=predicted[1][rows],
                counts=counts[rows],
            )
        )
    return tuple(found)


def _extremes(values):
    """Rows of the lowest and highest value of each interval of a curve (n,)."""
    # Rows that are nan, which interrupt it, are among them.
    n, most = values.size, _CURVE // 2
    if n <= most:
        return np.arange(n)
    known = np.isfinite(values)
    low, high = np.where(known, values, np.inf), np.where(known, values, -np.inf)
    edges = np.linspace(0, n, most // 2 + 1).astype(int)
    rows = [
        at
        for a, b in itertools.pairwise(edges)
        for at in (a + np.argmin(low[a:b]), a + np.argmax(high[a:b]))
    ]
    return np.union1d(rows, np.flatnonzero(~known))
