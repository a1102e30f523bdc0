"""Recordings on a uniform time grid: segments, gaps, interpolation, several files."""

import itertools
from collections import Counter, namedtuple
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

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
from sklearn_vbjfa.recording._recording import contiguous_groups
from sklearn_vbjfa.recording._table import Loss

# Fewer samples than this between two gaps cannot be differentiated and held out from.
_MIN_SAMPLES = 16
# The lower quartile of the size of a normal variable, in standard deviations.
_QUARTILE = 0.3186
# More rows than this share with the stamp of the one before are refused.
_REPEATED = 0.1


@dataclass(frozen=True, eq=False)
class Log:
    """Rows of one recording: its name, times (n,) [s], and channels, n rows each."""

    name: str
    t: np.ndarray
    channels: dict[str, np.ndarray]
    noise: np.ndarray | None = None  # of torques (nv,), if they were interpolated


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


# -- recordings without gaps -----------------------------------------------------------


def _pieces(log, dt, ends=()):
    """Cut a log before some rows, put what is between on multiples of dt."""
    # Times rise in each piece; one of too few rows is left out.
    bounds = [
        (first, stop)
        for first, stop in itertools.pairwise([0, *ends, log.t.size])
        if stop - first >= min(_MIN_SAMPLES, log.t.size)
    ]
    made = []
    for k, (first, stop) in enumerate(bounds, start=1):
        t = log.t[first:stop] - log.t[first]
        rows = {key: x[first:stop] for key, x in log.channels.items()}
        grid, noise = dt * np.arange(t.size), None
        if np.abs(t - grid).max() >= SAME_DT * dt:
            errors = np.abs(prediction_errors(t, rows["tau"]))
            if errors.size:
                # The lower quartile passes over jumps, such as those of friction.
                noise = np.quantile(errors, 0.25, axis=0) / _QUARTILE
            grid, rows = interpolate(t, rows, dt)
        name = f"{log.name} [{k}]" if len(bounds) > 1 else log.name
        made.append(Log(name, grid, rows, noise))
    return made


def _fields(pieces, dt: float) -> dict:
    """Concatenate pieces into the array fields of a `Recording`."""
    signals = {
        key: np.concatenate([one.channels[key] for one in pieces])
        for key in pieces[0].channels
    }
    return {
        **{key: signals.pop(key, None) for key in ("q", "tau", "v")},
        "t": np.concatenate([one.t for one in pieces]),
        "dt": dt,
        "groups": np.repeat(np.arange(len(pieces)), [one.t.size for one in pieces]),
        "group_names": distinct(one.name for one in pieces),
        "signals": signals,
    }


def distinct(names):
    """Return names as a tuple, repeated ones with a number."""
    seen, found = Counter(), []
    for name in names:
        seen[name] += 1
        found.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return tuple(found)


# A step of a log of a measured set above this many periods begins another piece.
_LOG_GAP_PERIODS = 10.0


def join(logs, *, dt: float, resample=True) -> dict:
    """Concatenate logs into the array fields of a `Recording`."""
    # With `resample` each log is put on multiples of dt; one with long gaps becomes
    # several recordings, "name [1]", "name [2]", ...
    if resample:
        gaps = [np.flatnonzero(np.diff(x.t) > _LOG_GAP_PERIODS * dt) for x in logs]
        logs = [one for x, gap in zip(logs, gaps) for one in _pieces(x, dt, gap + 1)]
    return _fields(logs, dt)


# -- files of a user -------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class FileRows:
    """The rows of a file, in the units and joint order of the package."""

    path: Path  # as messages name it
    name: str  # without endings
    where: Callable[[int], str]  # a row in words
    t: np.ndarray  # stamps (n,) [s]
    dt: float | None  # sample period as given [s]
    labels: np.ndarray | None  # of recordings
    channels: dict[str, np.ndarray]  # "q", "tau", and maybe "v" and others
    robot: dict  # joints and units, as fields of a `Recording`
    notes: list


# A segment of `FileRows`: its name, rows and `TimeStamps`.
_Run = namedtuple("_Run", "file name rows stamps")


def on_grid(files, names) -> dict:
    """Cut files at segments and gaps, return the array fields of a `Recording`."""
    # names: of the files, "" for one alone.
    runs = [list(_runs(file, name)) for file, name in zip(files, names)]
    ordered = sorted(itertools.chain(*runs), key=lambda run: run.stamps.dt)
    slow, fast = ordered[-1], ordered[0]
    if slow.stamps.dt > (1 + 2 * DT_TOLERANCE) * fast.stamps.dt:
        raise ValueError(
            f"{fast.file.path} has a sample period of {fast.stamps.dt:.6g} s and "
            f"{slow.file.path} one of {slow.stamps.dt:.6g} s: resample one of them, or "
            "process them separately."
        )
    # The median.
    dt = ordered[(len(ordered) - 1) // 2].stamps.dt
    pieces = [piece for own in runs for piece in _of_file(own, dt)]
    fields = _fields(pieces, dt)
    noisy = [one for one in pieces if one.noise is not None]
    if noisy:
        squares, sizes = zip(*((one.noise**2, one.t.size) for one in noisy))
        fields["torque_noise"] = np.sqrt(np.average(squares, axis=0, weights=sizes))
    return fields


def _runs(file, name):
    """Yield the segments of a file with what their stamps show."""
    parts = contiguous_groups(file.labels, file.t.size)
    names = [name or "recording"]
    if file.labels is not None:
        labels = (str(file.labels[part.start]).removesuffix(".0") for part in parts)
        names = [f"{name} {x}".strip() for x in distinct(labels)]
    again = np.r_[False, np.diff(file.t) == 0]
    again[[part.start for part in parts]] = False
    if again.mean() > _REPEATED:
        again[:] = False
    if again.any():
        file.notes.append(
            f"{again.sum()} row(s) have the stamp of the one before: left out."
        )
    for own, part in zip(names, parts):
        rows = np.arange(part.start, part.stop)[~again[part]]
        t, positions = file.t[rows], file.channels["q"][rows]
        try:
            found = inspect_time_stamps(
                t, file.dt, lambda k, rows=rows: file.where(rows[k]), positions
            )
        except ValueError as error:
            raise ValueError(f"{file.path}: {error}") from None
        yield _Run(file, own, rows, found)


def _of_file(runs, dt):
    """Return the pieces of a file on the grid; note what they lack."""
    file, pieces, short = runs[0].file, [], 0
    for _, name, rows, found in runs:
        # Late stamps alone do not make another period.
        unsure = max(SAME_DT * dt, 3 * np.std(found.steps) / rows.size)
        period = dt if abs(found.dt - dt) < unsure else found.dt
        t = file.t[rows] if found.irregular == "sampled" else period * found.slots
        channels = file.channels
        if rows.size < file.t.size:
            channels = {key: x[rows] for key, x in channels.items()}
        made = _pieces(Log(name, t, channels), dt, found.gaps + 1)
        short += found.gaps.size + 1 - len(made)
        pieces += made
    file.notes.extend(_irregularities(file, runs, dt, short))
    if not pieces:
        raise ValueError(
            f"{file.path}: no {_MIN_SAMPLES} samples follow one another without a gap "
            f"of more than {GAP_PERIODS:g} periods of {dt:.4g} s; check column t."
        )
    return pieces


# What irregular stamps mean, by their kind.
_IRREGULAR = {
    "sampled": "the positions say that the robot was sampled at these times; all is "
    "interpolated on a uniform grid",
    "late": "the sampling was regular by the positions; rows are taken as equidistant",
}


def _irregularities(file, runs, dt, short):
    """Yield notes on irregular stamps, gaps and missing rows."""
    for what, meaning in _IRREGULAR.items():
        odd = [run.stamps.steps for run in runs if run.stamps.irregular == what]
        if odd:
            steps = np.concatenate(odd)
            yield (
                f"time stamps are irregular (steps of {steps.min():.4g} to "
                f"{steps.max():.4g} s, a period of {dt:.4g} s): {meaning}."
            )
    gaps = np.concatenate([run.rows[run.stamps.gaps] for run in runs])
    if gaps.size:
        yield Loss(
            f"{gaps.size} gap(s) of {GAP_PERIODS:g} periods or more in time, the first "
            f"after {file.where(gaps[0])}: the recording is split there."
        )
    if short:
        yield Loss(
            f"{short} piece(s) of fewer than {_MIN_SAMPLES} samples between gaps are "
            "left out."
        )
    slots = [run.stamps.slots for run in runs if run.stamps.irregular != "sampled"]
    missing = sum(int((np.diff(x).clip(1) - 1).sum()) for x in slots)
    if missing:
        yield f"{missing} single sample(s) are missing and were interpolated."
