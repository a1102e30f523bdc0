"""Recordings on a uniform time grid: gaps, interpolation, several files."""

import itertools
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline

from sklearn_vbjfa.recording._clock import (
    DT_TOLERANCE,
    GAP_PERIODS,
    SAME_DT,
    STEADY,
    inspect_time_stamps,
    prediction_errors,
)
from sklearn_vbjfa.recording._drives import COMMANDS
from sklearn_vbjfa.recording._recording import contiguous_groups, labels_of
from sklearn_vbjfa.recording._table import Loss, Table

# Fewer samples than this between two gaps cannot be differentiated and held out from.
_MIN_SAMPLES = 16
# The lower quartile of the size of a normal variable, in standard deviations.
_QUARTILE = 0.3186
# More rows than this share with one stamp twice are refused.
_REPEATED = 0.1


# -- interpolation ---------------------------------------------------------------------


def interpolate(t, channels, dt: float):
    """Interpolate channels (n, ...) at t (n,) [s], from 0 on, on multiples of dt."""
    # Positions "q" follow a cubic spline; commands hold the value that came last; all
    # else, being noisier, follows straight lines.

    # Rounding of t must not cost the last point.
    grid = dt * np.arange(int(np.floor(t[-1] / dt + STEADY)) + 1)
    query = np.minimum(grid, t[-1])
    resampled = {}
    for key, values in channels.items():
        rows = values.reshape(t.size, -1).astype(float)
        if key == "q" and t.size > 2:
            # A joint that stands does not move by rounding.
            still, first = np.ptp(rows, axis=0) == 0, rows[0]
            rows = np.where(still, first, CubicSpline(t, rows)(query))
        elif key in COMMANDS:
            # Stamps that rounding moves past the grid point count.
            rows = rows[np.searchsorted(t, query + STEADY * dt, side="right") - 1]
        else:
            rows = np.column_stack([np.interp(query, t, x) for x in rows.T])
        resampled[key] = rows.reshape(query.size, *values.shape[1:])
    return grid, resampled


def _white_noise(rows):
    """Return the standard deviation (nv,) of white noise of (t, torques), or None."""
    # The lower quartile passes over jumps, such as those of friction.
    errors = np.abs(np.concatenate([prediction_errors(*one) for one in rows]))
    return np.quantile(errors, 0.25, axis=0) / _QUARTILE if errors.size else None


# -- pieces of recordings --------------------------------------------------------------


def _channels_of(one):
    """Return the values of each row of a log or a recording, by name."""
    found = {"q": one.q, "tau": one.tau, **one.signals}
    return found if one.v is None else found | {"v": one.v}


def _rows_of(channels, rows):
    """Return rows of all channels; all of them without a copy."""
    whole = isinstance(rows, np.ndarray) and rows.size == len(channels["q"])
    return channels if whole else {key: x[rows] for key, x in channels.items()}


def _pieces(name, t, channels, dt, ends=()):
    """Put rows at t (n,) [s] on multiples of dt; pieces, and (t, torques) off it."""
    # ends: rows at which the next piece begins; t rises in each. A piece is a tuple
    # (name, t, channels); one of too few rows is left out.
    parts, off_grid = [], []
    for first, stop in itertools.pairwise([0, *ends, t.size]):
        if stop - first < min(_MIN_SAMPLES, t.size):
            continue
        at, values = t[first:stop] - t[first], _rows_of(channels, slice(first, stop))
        grid = dt * np.arange(at.size)
        if np.abs(at - grid).max() >= SAME_DT * dt:
            off_grid.append((at, values["tau"]))
            grid, values = interpolate(at, values, dt)
        parts.append((grid, values))
    names = [f"{name} [{k}]" for k in range(1, len(parts) + 1)]
    names = names if len(parts) > 1 else [name]
    return [(x, *part) for x, part in zip(names, parts)], off_grid


def _fields(pieces, dt: float) -> dict:
    """Concatenate pieces (name, t, channels) into the array fields of a `Recording`."""

    def together(arrays):
        # A single one is not copied.
        return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)

    names, times, channels = zip(*pieces)
    columns = {key: together([one[key] for one in channels]) for key in channels[0]}
    return {
        "q": columns.pop("q"),
        "tau": columns.pop("tau"),
        "v": columns.pop("v", None),
        "t": together(times),
        "dt": dt,
        "groups": labels_of([t.size for t in times]),
        "group_names": names,
        "signals": columns,
    }


def distinct(names):
    """Return names, repeated ones with a number."""
    seen = Counter()
    found = []
    for name in names:
        seen[name] += 1
        found.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return found


# -- logs of measured sets -------------------------------------------------------------

# A step of a log above this many periods ends a part and starts another one.
_LOG_GAP_PERIODS = 10.0


@dataclass(frozen=True, kw_only=True)
class Log:
    """One recording as read: stamps [s] and channels, first axis time."""

    name: str
    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    v: np.ndarray | None = None
    signals: Mapping[str, np.ndarray] = field(default_factory=dict)


def median_period(logs) -> float:
    """Return the median step between stamps of all logs [s], rounded to 0.1 us."""
    return round(float(np.median(np.concatenate([np.diff(x.t) for x in logs]))), 7)


def join(logs, *, dt: float, resample=True) -> dict:
    """Concatenate logs into the array fields of a `Recording`."""
    # With `resample` each log is put on multiples of dt; one with long gaps becomes
    # several recordings, "name [1]", "name [2]", ...
    pieces = []
    for log in logs:
        t, channels = log.t, _channels_of(log)
        if resample:
            ends = np.flatnonzero(np.diff(t) > _LOG_GAP_PERIODS * dt) + 1
            pieces += _pieces(log.name, t, channels, dt, ends)[0]
        else:
            pieces.append((log.name, t, channels))
    return _fields(pieces, dt)


# -- a user's file ---------------------------------------------------------------------


def on_grid(table: Table, t, labels, dt, channels, notes):
    """Cut a file at segments and gaps, return the array fields of a `Recording`."""
    # Stamps t [s] and labels of segments, (n_rows,) or None; dt [s] or None for that of
    # the stamps; channels (n_rows, ...), "q" and "tau" among them.
    runs = [np.arange(table.n_rows)[x] for x in contiguous_groups(labels, table.n_rows)]
    names = ["recording"]
    if labels is not None:
        names = distinct(str(labels[rows[0]]).removesuffix(".0") for rows in runs)
    if t is None:
        times = [dt * np.arange(rows.size) for rows in runs]
        parts = [_rows_of(channels, rows) for rows in runs]
        return _fields(list(zip(names, times, parts)), dt)
    runs = _without_repeats(t, runs, notes)
    stamps = [_inspected(table, t, rows, dt, channels["q"]) for rows in runs]
    dt = _common_period(table, stamps) if dt is None else dt
    notes += _irregularities(table, stamps, runs, dt)
    pieces, off_grid, counts = [], [], Counter()
    for name, rows, found in zip(names, runs, stamps):
        at, ends = t[rows], found.gaps + 1
        if not found.sampled:
            # Late stamps alone do not make another period.
            unsure = 3 * np.std(found.steps) / rows.size
            same = abs(found.dt - dt) < max(SAME_DT * dt, unsure)
            at = (dt if same else found.dt) * found.slots
            counts["missing"] += int((np.diff(found.slots).clip(1) - 1).sum())
        made, off = _pieces(name, at, _rows_of(channels, rows), dt, ends)
        counts["short"] += len(ends) + 1 - len(made)
        pieces += made
        off_grid += off
    notes += _losses(counts)
    if not pieces:
        raise ValueError(
            f"{table.path}: no {_MIN_SAMPLES} samples follow one another without a gap "
            f"of more than {GAP_PERIODS:g} periods of {dt:.4g} s; check column t."
        )
    fields = _fields(pieces, dt)
    if off_grid:
        fields["torque_noise"] = _white_noise(off_grid)
    return fields


def _without_repeats(t, runs, notes):
    """Leave out rows with the stamp of the one before, if they are few."""
    again = np.r_[False, np.diff(t) == 0]
    again[[rows[0] for rows in runs]] = False
    if not 0 < again.sum() <= _REPEATED * t.size:
        return runs
    notes.append(f"{again.sum()} row(s) have the stamp of the one before: left out.")
    return [rows[~again[rows]] for rows in runs]


def _inspected(table, t, rows, dt, positions):
    """Return what the stamps of a segment show."""
    try:
        return inspect_time_stamps(
            t[rows], dt, lambda k: table.where(rows[k]), positions[rows]
        )
    except ValueError as error:
        raise ValueError(f"{table.path}: {error}") from None


def _common_period(table, stamps):
    periods = [x.dt for x in stamps]
    low, dt, high = min(periods), float(np.median(periods)), max(periods)
    if high - low > 2 * DT_TOLERANCE * dt:
        raise ValueError(
            f"{table.path}: segments have periods of {low:.6g} to {high:.6g} s; "
            "put those of one period into one file."
        )
    return dt


def _losses(counts):
    """Yield notes on pieces that are left out and rows that were put in."""
    if counts["short"]:
        yield Loss(
            f"{counts['short']} piece(s) of fewer than {_MIN_SAMPLES} samples between "
            "gaps are left out."
        )
    if counts["missing"]:
        yield (
            f"{counts['missing']} single sample(s) are missing and were interpolated."
        )


# What irregular stamps mean, by the attribute of `TimeStamps`.
_IRREGULAR = {
    "sampled": "the positions say that the robot was sampled at these times; all is "
    "interpolated on a uniform grid",
    "late": "the sampling was regular by the positions; rows are taken as equidistant",
}


def _irregularities(table, stamps, runs, dt):
    """Yield notes on irregular stamps and gaps."""
    for what, meaning in _IRREGULAR.items():
        odd = [x.steps for x in stamps if getattr(x, what)]
        if odd:
            steps = np.concatenate(odd)
            yield (
                f"time stamps are irregular (steps of {steps.min():.4g} to "
                f"{steps.max():.4g} s, a period of {dt:.4g} s): {meaning}."
            )
    gaps = [rows[x.gaps] for rows, x in zip(runs, stamps) if x.gaps.size]
    if gaps:
        yield Loss(
            f"{sum(x.size for x in gaps)} gap(s) of {GAP_PERIODS:g} periods or more "
            f"in time, the first after {table.where(gaps[0][0])}: the recording is "
            "split there."
        )


# -- several files ---------------------------------------------------------------------


def on_one_grid(recordings, names, dt):
    """Concatenate files whose periods are nearly dt [s]; fields of a `Recording`."""
    # names: of the recordings in them, one after the other.
    pieces, names, powers, weights = [], iter(names), [], []
    for one in recordings:
        channels, off_grid = _channels_of(one), []
        period = dt if abs(one.dt - dt) < SAME_DT * dt else one.dt
        for rows in one.segments:
            t = period * np.arange(rows.stop - rows.start)
            made, off = _pieces(next(names), t, _rows_of(channels, rows), dt)
            pieces += made
            off_grid += off
        # That of the torques as they came, where they were interpolated before.
        noise = one.torque_noise
        if noise is None and off_grid:
            noise = _white_noise(off_grid)
        if noise is not None:
            powers.append(noise**2)
            weights.append(one.n_samples)
    fields = _fields(pieces, dt)
    if powers:
        noise = np.sqrt(np.average(powers, axis=0, weights=weights))
        fields["torque_noise"] = noise
    return fields
