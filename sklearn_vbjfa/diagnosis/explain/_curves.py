"""Decimated curves for the figures of a report."""

from types import SimpleNamespace

import numpy as np

# Maximum number of intervals of a time series, of which the extremes are drawn, and of
# points of a scatter plot; number of lags of an autocorrelation.
_INTERVALS, _POINTS, _LAGS = 120, 200, 40
# Minimum number of rows for a scatter plot.
_MIN_ROWS = 8
# A step longer than this multiple of the median step is a gap between stretches.
_GAP = 2.5


def residual_curves(after, dt, joints):
    """Return scatter plot and autocorrelation of held-out residuals, by joint."""
    # after: residuals of the completed model. Each namespace has joint, from zero;
    # predicted reading and residual (k,) [unit of y]; lags (l,) [s], correlation (l,);
    # chance, the 90 % bound of the latter for white noise.
    index = after.index - after.index[0]
    step = int(np.median(np.diff(index))) if index.size > 1 else 1
    curves = []
    for j in joints:
        rows = np.flatnonzero(after.weight[:, j] > 0)
        if rows.size < _MIN_ROWS:
            continue
        residual, drawn = after.residual[:, j], rows[:: -(-rows.size // _POINTS)]
        # Uniform grid, zero in missing rows and in rows of zero weight.
        series = np.zeros(index[-1] // step + 1)
        series[index[rows] // step] = residual[rows]
        lags = np.arange(min(_LAGS, rows.size))
        covariance = np.array([series[: series.size - k] @ series[k:] for k in lags])
        curves.append(
            SimpleNamespace(
                joint=j,
                predicted=after.predicted[drawn, j],
                residual=residual[drawn],
                lags=lags * step * dt,
                correlation=covariance / (covariance[0] or 1.0),
                chance=1.645 / np.sqrt(rows.size),
            )
        )
    return tuple(curves)


def torque_curves(before, after, clock, joints):
    """Return measured and predicted torques over held-out time, by joint."""
    # before, after: residuals of the declared and the completed model. Each namespace
    # has joint, from zero; seconds (k,); the filtered readings and their predictions
    # before and after (k,) [unit of y], nan in gaps; counts (k,): rows with positive
    # weight. Held-out stretches are concatenated, with one nan row between them.
    steps = np.diff(clock[before.index])
    step = float(np.median(steps)) if steps.size else 1.0
    gaps = np.flatnonzero(steps > _GAP * step) + 1
    seconds = step * np.arange(before.index.size + gaps.size)
    curves_by_joint = []
    columns = before.torque, before.predicted, after.predicted, before.weight
    for j in joints:
        of_joint = (np.insert(values[:, j], gaps, np.nan) for values in columns)
        curves = dict(zip(("measured", "before", "after", "counts"), of_joint))
        curves |= {"seconds": seconds, "counts": curves["counts"] > 0}
        residual = np.where(curves["counts"], curves["measured"] - curves["after"], 0.0)
        rows = np.union1d(_extremes(curves["measured"]), _extremes(residual))
        thinned = {name: values[rows] for name, values in curves.items()}
        curves_by_joint.append(SimpleNamespace(joint=j, **thinned))
    return tuple(curves_by_joint)


def _extremes(values):
    """Return the rows of the extremes of each interval of a curve (n,)."""
    # Rows that are nan are kept, to interrupt the line.
    if values.size <= 2 * _INTERVALS:
        return np.arange(values.size)
    rows = np.flatnonzero(np.isnan(values)).tolist()
    for interval in np.array_split(np.arange(values.size), _INTERVALS):
        valid = interval[~np.isnan(values[interval])]
        if valid.size:
            rows += [valid[np.argmin(values[valid])], valid[np.argmax(values[valid])]]
    return np.unique(rows)
