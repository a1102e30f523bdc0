"""Resampling on a uniform time grid: segments, gaps, interpolation, several files."""

import itertools
from collections import Counter, namedtuple
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from sklearn_vbjfa.recording._clock import (
    DT_TOLERANCE,
    GAP_PERIODS,
    SAME_DT,
    STEADY,
    filled_gaps,
    inspect_time_stamps,
    nanoseconds,
    prediction_errors,
    source_samples,
)
from sklearn_vbjfa.recording._drives import COMMANDS
from sklearn_vbjfa.recording._recording import contiguous_groups
from sklearn_vbjfa.recording._table import Loss

# Minimum number of samples between gaps, for differentiation and held-out data.
_MIN_SAMPLES = 16
# Lower quartile of the absolute value of a standard normal variable.
_QUARTILE = 0.3186
# Minimum ratio of the sample rates of sources that are merged.
RATE_RATIO = 0.2
# Largest share of rows that repeat a time stamp, or that sources have in common.
_MAX_REPEATED = 0.1


@dataclass(frozen=True, eq=False)
class Log:
    """One recording: name, times (n,) [s], and channels with n rows each."""

    name: str
    t: np.ndarray
    channels: dict[str, np.ndarray]
    noise: np.ndarray | None = None  # std of torque noise (nv,), if interpolated


def interpolate(t, channels, dt: float, grid=None):
    """Interpolate channels (n, ...) from times t (n,) [s] on a grid."""
    # Positions "q" by a cubic spline, commands by a zero-order hold, and all others,
    # which are noisier, linearly; by default at multiples of dt [s].
    if grid is None:
        # The tolerance keeps the last grid point despite rounding of t.
        grid = dt * np.arange(int(np.floor(t[-1] / dt + STEADY)) + 1)
    query = np.minimum(grid, t[-1])
    resampled = {}
    for key, values in channels.items():
        rows = values.reshape(t.size, -1).astype(float)
        if key == "q" and t.size > 2:
            # Rounding of the spline must not move a joint at rest.
            constant, first = np.ptp(rows, axis=0) == 0, rows[0]
            rows = np.where(constant, first, CubicSpline(t, rows)(query))
        elif key in COMMANDS:
            # The tolerance includes stamps that rounding moved past the grid point.
            rows = rows[np.searchsorted(t, query + STEADY * dt, side="right") - 1]
        else:
            rows = np.column_stack([np.interp(query, t, x) for x in rows.T])
        resampled[key] = rows.reshape(query.size, *values.shape[1:])
    return grid, resampled


def merge_sources(table, layout, notes):
    """Merge sources that write rows in turn, at the stamps of the slowest."""
    roles = [x for x in layout.roles if x.kind not in ("t", "segment")]
    values = {x.column: table.values(x.column) for x in roles}
    finite = np.array([table.frame[x].notna() for x in values])
    if finite.all() or not layout.stamps:
        return table
    sources, owner = np.unique(finite, axis=0, return_inverse=True)
    sizes = sources.sum(axis=1)
    dates = nanoseconds(table, layout.stamps[0])
    t = table.values(layout.stamps[0]) if dates is None else 1e-9 * (dates - dates[0])
    if (
        sizes.min() < max(_MIN_SAMPLES, RATE_RATIO * sizes.max())
        or finite.all(axis=0).sum() > _MAX_REPEATED * sizes.min()
        or any(x.dtype.kind not in "iuf" for x in (t, *values.values()))
        or any((np.diff(t[x]) <= 0).any() for x in sources)
    ):
        return table
    base = sources[np.argmin(sizes)]
    frame, grid = table.frame[base].copy(), t[base]
    for role, rows in zip(roles, sources[owner.ravel()]):
        x, dt = t[rows], np.median(np.diff(t[rows]))
        # A spline attenuates the noise of torques less than straight lines do.
        kind = role.kind if role.kind in COMMANDS else "q"
        _, new = interpolate(x, {kind: values[role.column][rows]}, dt, grid)
        # Do not interpolate across gaps.
        after = np.searchsorted(x, grid).clip(1, x.size - 1)
        apart = (x[after] - x[after - 1] > GAP_PERIODS * dt) & ~np.isin(grid, x)
        apart |= (grid < x[0]) | (grid > x[-1])
        frame[role.column] = np.where(apart, np.nan, new[kind])
    frame = frame.dropna(subset=[*values])
    notes.append(
        f"{len(sources)} sources write rows in turn: merged at the {len(frame)} common "
        "times of the slowest."
    )
    return replace(table, frame=frame)


def _split(log, dt, starts):
    """Split a log at `starts` and resample each piece on multiples of dt."""
    # Times must increase within a piece; pieces with too few rows are dropped.
    bounds = [
        (first, stop)
        for first, stop in itertools.pairwise([0, *starts, log.t.size])
        if stop - first >= min(_MIN_SAMPLES, log.t.size)
    ]
    logs = []
    for k, (first, stop) in enumerate(bounds, start=1):
        t = log.t[first:stop] - log.t[first]
        rows = {key: x[first:stop] for key, x in log.channels.items()}
        grid, noise = dt * np.arange(t.size), None
        if np.abs(t - grid).max() >= SAME_DT * dt:
            errors = np.abs(prediction_errors(t, rows["tau"]))
            if errors.size:
                # The lower quartile is robust to jumps, such as those of friction.
                noise = np.quantile(errors, 0.25, axis=0) / _QUARTILE
            grid, rows = interpolate(t, rows, dt)
        name = f"{log.name} [{k}]" if len(bounds) > 1 else log.name
        logs.append(Log(name, grid, rows, noise))
    return logs


def _to_fields(logs, dt: float) -> dict:
    """Concatenate logs into the array fields of a `Recording`."""
    signals = {
        key: np.concatenate([log.channels[key] for log in logs])
        for key in logs[0].channels
    }
    return {
        **{key: signals.pop(key, None) for key in ("q", "tau", "v")},
        "t": np.concatenate([log.t for log in logs]),
        "dt": dt,
        "groups": np.repeat(np.arange(len(logs)), [log.t.size for log in logs]),
        "group_names": unique_names(log.name for log in logs),
        "signals": signals,
    }


def unique_names(names):
    """Return names as a tuple, with numbers appended to repeated names."""
    counts, unique = Counter(), []
    for name in names:
        counts[name] += 1
        unique.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return tuple(unique)


# A log of a measured data set is split at steps of more than this many periods.
_LOG_GAP_PERIODS = 10.0


def join(logs, *, dt: float, resample=True) -> dict:
    """Concatenate logs into the array fields of a `Recording`."""
    # resample: interpolate on multiples of dt, and split at gaps ("name [1]", ...).
    if resample:
        gaps = [np.flatnonzero(np.diff(x.t) > _LOG_GAP_PERIODS * dt) for x in logs]
        logs = [log for x, gap in zip(logs, gaps) for log in _split(x, dt, gap + 1)]
    return _to_fields(logs, dt)


@dataclass(frozen=True, kw_only=True, eq=False)
class FileRows:
    """The rows of a file, in the units and joint order of the package."""

    path: Path  # as shown in messages
    name: str  # file name without suffixes
    where: Callable[[int], str]  # location of a row for messages
    t: np.ndarray  # time stamps (n,) [s]
    dt: float | None  # sample period given by the user or the file [s]
    labels: np.ndarray | None  # of recordings
    channels: dict[str, np.ndarray]  # "q", "tau", and further ones
    robot: dict  # joints and units, as fields of a `Recording`
    notes: list


# A segment of `FileRows`: its name, rows and `TimeStamps`.
_Segment = namedtuple("_Segment", "file name rows stamps")


def resample_files(files, names) -> dict:
    """Split files at segments and gaps; return the array fields of a `Recording`."""
    # names: names of the files, "" for a single one.
    if len(files) > 1 or files[0].labels is not None:
        _check_distinct(files)
    by_file = [list(_segments(file, name)) for file, name in zip(files, names)]
    by_period = sorted(itertools.chain(*by_file), key=lambda x: x.stamps.dt)
    slow, fast = by_period[-1], by_period[0]
    if slow.stamps.dt > (1 + 2 * DT_TOLERANCE) * fast.stamps.dt:
        raise ValueError(
            f"{fast.file.path} has a sample period of {fast.stamps.dt:.6g} s and "
            f"{slow.file.path} one of {slow.stamps.dt:.6g} s: resample one of them."
        )
    # Median of the sample periods.
    dt = by_period[(len(by_period) - 1) // 2].stamps.dt
    pieces = [piece for segments in by_file for piece in _resample_file(segments, dt)]
    fields = _to_fields(pieces, dt)
    interpolated = [log for log in pieces if log.noise is not None]
    if interpolated:
        squares, sizes = zip(*((log.noise**2, log.t.size) for log in interpolated))
        fields["torque_noise"] = np.sqrt(np.average(squares, axis=0, weights=sizes))
    return fields


def _check_distinct(files):
    """Refuse recordings of which one repeats samples of another."""
    parts = [(x, p) for x in files for p in contiguous_groups(x.labels, x.t.size)]
    owner = np.repeat(np.arange(len(parts)), [p.stop - p.start for _, p in parts])
    row = np.concatenate([np.arange(x.t.size) for x in files])
    samples = [np.hstack([x.channels["q"], x.channels["tau"]]) for x in files]
    samples = np.ascontiguousarray(np.concatenate(samples))
    samples = samples.view(f"V{samples[0].nbytes}").ravel()
    _, first, inverse = np.unique(samples, return_index=True, return_inverse=True)
    origin = first[inverse]
    # Joints at rest repeat samples, but not sequences of them.
    copies = np.flatnonzero(np.diff(origin, prepend=-1) * (owner[origin] < owner))
    for run in contiguous_groups(copies - origin[copies], copies.size):
        if run.stop - run.start >= _MIN_SAMPLES:
            places = []
            for begin, *_, end in (copies[run], origin[copies[run]]):
                file = parts[owner[begin]][0]
                ends = file.where(row[begin]), file.where(row[end])
                places.append(f"{file.path}, {' to '.join(ends)}")
            at = ": the same samples as ".join(places)
            raise ValueError(f"{at}; delete them in one file, or leave that file out.")


def _segments(file, name):
    """Yield the segments of a file with an analysis of their time stamps."""
    parts = contiguous_groups(file.labels, file.t.size)
    names = [name or "recording"]
    if file.labels is not None:
        labels = (str(file.labels[part.start]).removesuffix(".0") for part in parts)
        names = [f"{name} {x}".strip() for x in unique_names(labels)]
    repeated = np.r_[False, np.diff(file.t) == 0]
    repeated[[part.start for part in parts]] = False
    if repeated.mean() > _MAX_REPEATED:
        repeated[:] = False
    if repeated.any():
        file.notes.append(
            f"{repeated.sum()} row(s) have the stamp of the one before: left out."
        )
    for label, part in zip(names, parts):
        rows = np.arange(part.start, part.stop)[~repeated[part]]
        t, dt, positions = file.t[rows], file.dt, file.channels["q"]
        if source := source_samples(t, positions[rows]):
            first, t, period = source
            file.notes.append(
                f"{rows.size - first.size} row(s) repeat samples of a source with a "
                f"period of {period:.4g} s: left out."
            )
            rows, dt = rows[first], None
        if gaps := filled_gaps(positions[rows], file.channels["tau"][rows]):
            filled = np.concatenate([np.arange(a, b + 1) for a, b in gaps])
            file.notes.append(
                f"{filled.size} row(s), first {file.where(rows[filled[0]])}, are on "
                "straight lines in all channels: filled gaps, left out."
            )
            rows, t = np.delete(rows, filled), np.delete(t, filled)
        try:
            stamps = inspect_time_stamps(
                t, dt, lambda k, rows=rows: file.where(rows[k]), positions[rows]
            )
        except ValueError as error:
            raise ValueError(f"{file.path}: {error}") from None
        yield _Segment(file, label, rows, stamps)


def _resample_file(segments, dt):
    """Return the resampled pieces of a file; append notes on gaps to it."""
    file, pieces, n_short = segments[0].file, [], 0
    for _, name, rows, stamps in segments:
        # A difference within the standard error of jittering stamps is no other period.
        tolerance = max(SAME_DT * dt, 3 * np.std(stamps.steps) / rows.size)
        period = dt if abs(stamps.dt - dt) < tolerance else stamps.dt
        t = file.t[rows] if stamps.irregular == "sampled" else period * stamps.slots
        channels = {key: x[rows] for key, x in file.channels.items()}
        resampled = _split(Log(name, t, channels), dt, stamps.gaps + 1)
        n_short += stamps.gaps.size + 1 - len(resampled)
        pieces += resampled
    file.notes.extend(_timing_notes(file, segments, dt, n_short))
    if not pieces:
        mean = np.ptp(file.t) / max(file.t.size - 1, 1)
        raise ValueError(
            f"{file.path}: stamps come in bursts: no {_MIN_SAMPLES} of them without a "
            f"gap; if rows are equidistant, leave t out and give dt ({mean:.4g} s)."
        )
    return pieces


# Interpretation of irregular time stamps, by kind.
_EXPLANATIONS = {
    "sampled": "the positions say that the robot was sampled at these times; all is "
    "interpolated on a uniform grid",
    "late": "the sampling was regular by the positions; rows are taken as equidistant",
}


def _timing_notes(file, segments, dt, n_short):
    """Yield notes on irregular stamps, gaps and missing rows."""
    for kind, meaning in _EXPLANATIONS.items():
        irregular = [x.stamps.steps for x in segments if x.stamps.irregular == kind]
        if irregular:
            steps = np.concatenate(irregular)
            yield (
                f"time stamps are irregular (steps of {steps.min():.4g} to "
                f"{steps.max():.4g} s, a period of {dt:.4g} s): {meaning}."
            )
    gaps = np.concatenate([x.rows[x.stamps.gaps] for x in segments])
    if gaps.size:
        yield Loss(
            f"{gaps.size} gap(s) of {GAP_PERIODS:g} periods or more in time, the first "
            f"after {file.where(gaps[0])}: the recording is split there."
        )
    if n_short:
        yield Loss(
            f"{n_short} piece(s) of fewer than {_MIN_SAMPLES} samples between gaps are "
            "left out."
        )
    slots = [x.stamps.slots for x in segments if x.stamps.irregular != "sampled"]
    missing = sum(int((np.diff(x).clip(1) - 1).sum()) for x in slots)
    if missing:
        yield f"{missing} single sample(s) are missing and were interpolated."
