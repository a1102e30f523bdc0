"""Recordings on a uniform time grid: gaps, interpolation, several files."""

import itertools
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from sklearn_vbjfa.recording._clock import (
    DT_TOLERANCE,
    GAP_PERIODS,
    SAME_DT,
    STEADY,
    TimeStamps,
    inspect_time_stamps,
    prediction_errors,
)
from sklearn_vbjfa.recording._drives import COMMANDS
from sklearn_vbjfa.recording._recording import contiguous_groups, labels_of
from sklearn_vbjfa.recording._table import Loss

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
        t, channels = log.t, {"q": log.q, "tau": log.tau, **log.signals}
        if log.v is not None:
            channels["v"] = log.v
        if resample:
            ends = np.flatnonzero(np.diff(t) > _LOG_GAP_PERIODS * dt) + 1
            pieces += _pieces(log.name, t, channels, dt, ends)[0]
        else:
            pieces.append((log.name, t, channels))
    return _fields(pieces, dt)


# -- files of a user -------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class FileRows:
    """The rows of a file, in the units and joint order of the package."""

    path: Path  # as messages name it
    name: str  # without endings
    where: Callable[[int], str]  # a row in words
    t: np.ndarray | None  # stamps (n,) [s]
    dt: float | None  # sample period as given [s]
    labels: np.ndarray | None  # of recordings
    channels: dict[str, np.ndarray]  # "q", "tau", and maybe "v" and others
    signals: tuple[str, ...]  # channels that are columns of other names
    joint_names: tuple[str, ...]
    position_units: tuple[str, ...]
    torque_units: tuple[str, ...]
    joints_named: bool
    notes: list


@dataclass(frozen=True, kw_only=True, eq=False)
class _Run:
    """Rows of a file that follow one another."""

    name: str
    rows: np.ndarray
    dt: float
    stamps: TimeStamps | None


def on_grid(files, names) -> dict:
    """Cut files at segments and gaps, return the array fields of a `Recording`."""
    # names: of the files, "" for one alone.
    runs = [_runs(file, name) for file, name in zip(files, names)]
    dt = _common_period(files, runs)
    pieces, powers, weights = [], [], []
    for file, own in zip(files, runs):
        made, off_grid = _on_period(file, own, dt)
        pieces += made
        noise = _white_noise(off_grid) if off_grid else None
        if noise is not None:
            powers.append(noise**2)
            weights.append(sum(t.size for _, t, _ in made))
    names = distinct(name for name, *_ in pieces)
    fields = _fields([(x, *rest) for x, (_, *rest) in zip(names, pieces)], dt)
    if powers:
        noise = np.sqrt(np.average(powers, axis=0, weights=weights))
        fields["torque_noise"] = noise
    return fields


def _runs(file, name):
    """Return the segments of a file and what their stamps show."""
    n = len(file.channels["q"])
    runs = [np.arange(n)[x] for x in contiguous_groups(file.labels, n)]
    names = [name or "recording"]
    if file.labels is not None:
        labels = (str(file.labels[rows[0]]).removesuffix(".0") for rows in runs)
        names = [f"{name} {x}".strip() for x in distinct(labels)]
    if file.t is None:
        return [
            _Run(name=x, rows=rows, dt=file.dt, stamps=None)
            for x, rows in zip(names, runs)
        ]
    runs = _without_repeats(file, runs)
    stamps = [_inspected(file, rows) for rows in runs]
    return [
        _Run(name=x, rows=rows, dt=one.dt, stamps=one)
        for x, rows, one in zip(names, runs, stamps)
    ]


def _without_repeats(file, runs):
    """Leave out rows with the stamp of the one before, if they are few."""
    again = np.r_[False, np.diff(file.t) == 0]
    again[[rows[0] for rows in runs]] = False
    if not 0 < again.sum() <= _REPEATED * again.size:
        return runs
    file.notes.append(
        f"{again.sum()} row(s) have the stamp of the one before: left out."
    )
    return [rows[~again[rows]] for rows in runs]


def _inspected(file, rows):
    """Return what the stamps of a segment show."""
    try:
        return inspect_time_stamps(
            file.t[rows],
            file.dt,
            lambda k: file.where(rows[k]),
            file.channels["q"][rows],
        )
    except ValueError as error:
        raise ValueError(f"{file.path}: {error}") from None


def _common_period(files, runs):
    """Return the median period [s]; refuse periods that differ much."""
    periods = [(run.dt, x.path) for x, own in zip(files, runs) for run in own]
    periods.sort(key=lambda period: period[0])
    (low, fast), (high, slow) = periods[0], periods[-1]
    if high > (1 + 2 * DT_TOLERANCE) * low:
        raise ValueError(
            f"{fast} has a sample period of {low:.6g} s and {slow} one of {high:.6g} "
            f"s, which differ by more than {200 * DT_TOLERANCE:g} %: resample one of "
            "them, or process them separately."
        )
    return periods[(len(periods) - 1) // 2][0]


def _on_period(file, runs, dt):
    """Return the pieces of a file at multiples of dt, and (t, torques) off these."""
    pieces, off_grid, short, missing = [], [], 0, 0
    for run in runs:
        found, ends = run.stamps, ()
        if found is None:
            at = run.dt * np.arange(run.rows.size)
        else:
            at, ends = file.t[run.rows], found.gaps + 1
            if not found.sampled:
                # Late stamps alone do not make another period.
                unsure = 3 * np.std(found.steps) / run.rows.size
                same = abs(found.dt - dt) < max(SAME_DT * dt, unsure)
                at = (dt if same else found.dt) * found.slots
                missing += int((np.diff(found.slots).clip(1) - 1).sum())
        made, off = _pieces(run.name, at, _rows_of(file.channels, run.rows), dt, ends)
        short += len(ends) + 1 - len(made)
        pieces += made
        off_grid += off
    file.notes.extend(_irregularities(file, runs, dt))
    if short:
        file.notes.append(
            Loss(
                f"{short} piece(s) of fewer than {_MIN_SAMPLES} samples between gaps "
                "are left out."
            )
        )
    if missing:
        file.notes.append(
            f"{missing} single sample(s) are missing and were interpolated."
        )
    if not pieces:
        raise ValueError(
            f"{file.path}: no {_MIN_SAMPLES} samples follow one another without a gap "
            f"of more than {GAP_PERIODS:g} periods of {dt:.4g} s; check column t."
        )
    return pieces, off_grid


# What irregular stamps mean, by the attribute of `TimeStamps`.
_IRREGULAR = {
    "sampled": "the positions say that the robot was sampled at these times; all is "
    "interpolated on a uniform grid",
    "late": "the sampling was regular by the positions; rows are taken as equidistant",
}


def _irregularities(file, runs, dt):
    """Yield notes on irregular stamps and gaps."""
    runs = [run for run in runs if run.stamps is not None]
    for what, meaning in _IRREGULAR.items():
        odd = [run.stamps.steps for run in runs if getattr(run.stamps, what)]
        if odd:
            steps = np.concatenate(odd)
            yield (
                f"time stamps are irregular (steps of {steps.min():.4g} to "
                f"{steps.max():.4g} s, a period of {dt:.4g} s): {meaning}."
            )
    gaps = [run.rows[run.stamps.gaps] for run in runs if run.stamps.gaps.size]
    if gaps:
        yield Loss(
            f"{sum(x.size for x in gaps)} gap(s) of {GAP_PERIODS:g} periods or more "
            f"in time, the first after {file.where(gaps[0][0])}: the recording is "
            "split there."
        )
