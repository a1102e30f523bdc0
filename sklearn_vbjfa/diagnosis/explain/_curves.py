"""Curves for the pictures of a finished search, thinned."""

import itertools
from dataclasses import dataclass

import numpy as np

# Joints that are drawn, those with the largest errors.
_WORST = 3
# Most points of a curve over time, and of a cloud; rows of an autocorrelation.
_CURVE, _DOTS, _LAGS = 2000, 400, 40
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
    """Measured and predicted torque of a joint over time."""

    joint: int  # from zero
    seconds: np.ndarray  # (k,): or numbers of rows
    # (k,): filtered; predicted by the declared and by the completed model, both fitted
    # to the search part [N m or N]; nan where rows are missing
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray
    counts: np.ndarray  # (k,): whether the joint moves, so that errors count there


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeLine:
    """The recording from its beginning to its end."""

    torques: tuple  # of the joints that are drawn
    borders: tuple  # where recordings after the first begin [s]
    held_out: tuple  # stretches that the search did not look at [s]
    in_seconds: bool  # whether times are known; else they count rows


# -- residuals -------------------------------------------------------------------------


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


# -- torques over time -----------------------------------------------------------------


def time_line(searched, held_out, clock, begins, joints):
    """Torques over time of two models before and after, `TimeLine`."""
    # searched, held_out: pairs of their residuals on the two parts of the recording
    index = np.concatenate([searched[0].index, held_out[0].index])
    order = np.argsort(index, kind="stable")
    fresh = np.repeat([False, True], [x[0].index.size for x in (searched, held_out)])
    index, fresh = index[order], fresh[order]
    seconds = np.arange(index[-1] + 1) if clock is None else clock
    seconds = seconds[index].astype(float)

    def series(which, name):
        pair = searched[which], held_out[which]
        return np.concatenate([getattr(part, name) for part in pair])[order]

    step = float(np.median(np.diff(seconds))) if seconds.size > 1 else 1.0
    starts = np.searchsorted(index, np.asarray(begins)[1:])
    starts = starts[starts < index.size]
    # Nothing is known between recordings, and between search and held-out part.
    gaps = np.union1d(np.flatnonzero(np.diff(seconds) > _GAP * step) + 1, starts)
    change = np.diff(np.r_[False, fresh, False].astype(int))
    ends = zip(np.flatnonzero(change > 0), np.flatnonzero(change < 0))
    named = {"measured": (0, "torque"), "before": (0, "predicted")}
    named |= {"after": (1, "predicted"), "counts": (0, "weight")}
    shown = {
        k: np.insert(series(*own)[:, joints], gaps, np.nan, axis=0)
        for k, own in named.items()
    }
    shown["counts"] = shown["counts"] > 0
    at = np.insert(seconds, gaps, seconds[gaps] - 0.5 * step)
    return TimeLine(
        torques=tuple(
            _thinned(j, at, **{name: x[:, k] for name, x in shown.items()})
            for k, j in enumerate(joints)
        ),
        borders=tuple(seconds[starts].tolist()),
        held_out=tuple(
            (float(seconds[a]), float(seconds[b - 1] + step)) for a, b in ends
        ),
        in_seconds=clock is not None,
    )


def _thinned(joint, seconds, **curves):
    """Thin the curves (n,) of a joint, half of the points for its residual."""
    left = np.where(curves["counts"], curves["measured"] - curves["after"], 0.0)
    rows = np.union1d(
        extremes(curves["measured"], _CURVE // 2), extremes(left, _CURVE // 2)
    )
    thin = {name: x[rows] for name, x in curves.items()}
    return TorqueCurves(joint=joint, seconds=seconds[rows], **thin)


def extremes(values, most):
    """Rows of the lowest and highest value of each interval of a curve (n,)."""
    # Rows that are nan, which interrupt it, are among them; `most` are there otherwise.
    n = values.size
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
