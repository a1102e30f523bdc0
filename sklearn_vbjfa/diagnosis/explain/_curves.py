"""Curves for the pictures of a finished search, thinned."""

from types import SimpleNamespace

import numpy as np

# Most intervals of a curve over time, whose extremes are drawn; most points of a cloud;
# lags of an autocorrelation.
_INTERVALS, _DOTS, _LAGS = 120, 200, 40
# Fewest rows of a cloud.
_FEWEST = 8
# Rows that are farther apart than this many usual steps have something between them.
_GAP = 2.5


def residual_curves(after, dt, joints):
    """Held-out residuals over predictions and over lags, a tuple of namespaces."""
    # joint, from zero; predicted by the completed model and residual, (k,) [N m or N];
    # lags (l,) [s] and autocorrelation there; chance: that of white noise (90 %).
    index = after.index - after.index[0]
    step = int(np.median(np.diff(index))) if index.size > 1 else 1
    found = []
    for j in joints:
        rows = np.flatnonzero(after.weight[:, j] > 0)
        if rows.size < _FEWEST:
            continue
        residual, shown = after.residual[:, j], rows[:: -(-rows.size // _DOTS)]
        # On an even grid, with zeros where nothing counts.
        line = np.zeros(index[-1] // step + 1)
        line[index[rows] // step] = residual[rows]
        lags = np.arange(min(_LAGS, rows.size))
        power = np.array([line[: line.size - k] @ line[k:] for k in lags])
        found.append(
            SimpleNamespace(
                joint=j,
                predicted=after.predicted[shown, j],
                residual=residual[shown],
                lags=lags * step * dt,
                correlation=power / (power[0] or 1.0),
                chance=1.645 / np.sqrt(rows.size),
            )
        )
    return tuple(found)


def torque_curves(before, after, clock, joints):
    """Held-out torques over time, from residuals of two models; namespaces, a tuple."""
    # joint, from zero; seconds (k,); measured, filtered, and predicted by the declared
    # model before and the completed one after, (k,) [N m or N], nan where rows are
    # missing; counts (k,): whether the joint moves, so that errors count there.
    # Held-out stretches follow one another, with a gap between them.
    steps = np.diff(clock[before.index])
    step = float(np.median(steps)) if steps.size else 1.0
    gaps = np.flatnonzero(steps > _GAP * step) + 1
    seconds = step * np.arange(before.index.size + gaps.size)
    found = []
    columns = before.torque, before.predicted, after.predicted, before.weight
    for j in joints:
        own = (np.insert(values[:, j], gaps, np.nan) for values in columns)
        curves = dict(zip(("measured", "before", "after", "counts"), own))
        curves |= {"seconds": seconds, "counts": curves["counts"] > 0}
        left = np.where(curves["counts"], curves["measured"] - curves["after"], 0.0)
        rows = np.union1d(_extremes(curves["measured"]), _extremes(left))
        thinned = {name: values[rows] for name, values in curves.items()}
        found.append(SimpleNamespace(joint=j, **thinned))
    return tuple(found)


def _extremes(values):
    """Rows of the lowest and highest value of each interval of a curve (n,)."""
    # Rows that are nan, which interrupt it, are among them.
    if values.size <= 2 * _INTERVALS:
        return np.arange(values.size)
    rows = np.flatnonzero(np.isnan(values)).tolist()
    for own in np.array_split(np.arange(values.size), _INTERVALS):
        known = own[~np.isnan(values[own])]
        if known.size:
            rows += [known[np.argmin(values[known])], known[np.argmax(values[known])]]
    return np.unique(rows)
