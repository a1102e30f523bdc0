"""Recordings on a uniform time grid: gaps, interpolation, several files."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

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

# Rows are sorted by their stamps if the sum of second differences falls below this
# share.
_SMOOTHER = 0.99
# Fewer samples than this between two gaps cannot be differentiated and held out from.
_MIN_SAMPLES = 16
# The lower quartile of the size of a normal variable, in standard deviations.
_QUARTILE = 0.3186


# -- interpolation ---------------------------------------------------------------------


def _local_cubic(t, rows):
    """Cubics with the slopes of parabolas, which no far-off sample can disturb."""
    slope = np.gradient(rows, t, axis=0, edge_order=2)
    return CubicHermiteSpline(t, rows, slope, axis=0)


def interpolate(t, channels, dt: float, cubic=_local_cubic):
    """Interpolate channels (n, ...) at t (n,) [s], from 0 on, on multiples of dt."""
    # Positions "q" follow the cubic that `cubic` builds from stamps and rows; commands
    # hold the value that came last; all else, being noisier, follows straight lines.

    # Rounding of t must not cost the last point.
    grid = dt * np.arange(int(np.floor(t[-1] / dt + STEADY)) + 1)
    query = np.minimum(grid, t[-1])
    resampled = {}
    for key, values in channels.items():
        rows = values.reshape(t.size, -1).astype(float)
        if key == "q" and t.size > 2:
            # A joint that stands does not move by rounding.
            still, first = np.ptp(rows, axis=0) == 0, rows[0]
            rows = np.where(still, first, cubic(t, rows)(query))
        elif key in COMMANDS:
            # Stamps that rounding moves past the grid point count.
            rows = rows[np.searchsorted(t, query + STEADY * dt, side="right") - 1]
        else:
            rows = np.column_stack([np.interp(query, t, x) for x in rows.T])
        resampled[key] = rows.reshape(query.size, *values.shape[1:])
    return grid, resampled


def _merge_doubled(t, channels):
    """Average rows of one stamp: t (n,) [s] that does not fall, channels (n, ...)."""
    # Of commands the last one counts.
    starts = np.flatnonzero(np.r_[True, np.diff(t) > 0])
    count = np.diff(starts, append=t.size)
    merged = {}
    for key, values in channels.items():
        if key in COMMANDS:
            merged[key] = values[starts + count - 1]
            continue
        sums = np.add.reduceat(values.astype(float), starts, axis=0)
        merged[key] = sums / count.reshape(-1, *[1] * (values.ndim - 1))
    return t[starts], merged


def _repeats(channels, n):
    """Return whether each of n - 1 rows equals the one before it in every channel."""
    same = np.ones(n - 1, dtype=bool)
    for values in channels.values():
        rows = values.reshape(n, -1)
        same &= (rows[1:] == rows[:-1]).all(axis=1)
    return same


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


def _named(name, parts):
    """Name the parts (t, channels) of a recording, "name [1]", ... if it was cut."""
    several = len(parts) > 1
    return [
        (f"{name} [{k}]" if several else name, *part)
        for k, part in enumerate(parts, start=1)
    ]


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

# Fewer samples cannot be differentiated.
_MIN_LOG = 10
# A log is uniform already up to this part of dt: a steady clock with six decimals.
_UNIFORM_RTOL = 1e-3
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


def join(logs, *, dt: float, resample=True, drop_repeated=False) -> dict:
    """Concatenate logs into the array fields of a `Recording`."""
    # With `resample` each log is put on multiples of dt; one with long gaps becomes
    # several recordings, "name [1]", "name [2]", ... With `drop_repeated` also rows
    # equal to the one before in every channel go, which the logger wrote twice.
    pieces = []
    for log in logs:
        parts = [(log.t, _channels_of(log))]
        if resample:
            parts = _uniform_parts(*parts[0], dt, drop_repeated)
        pieces += _named(log.name, parts)
    return _fields(pieces, dt)


def _uniform_parts(t, channels, dt, drop_repeated):
    """Return grid (n_part,) [s] and channels of a log's parts between long gaps."""
    keep = np.r_[True, np.diff(t) > 0]
    if drop_repeated:
        keep[1:] &= ~_repeats(channels, len(t))
    t = t[keep]
    channels = {key: values[keep] for key, values in channels.items()}
    parts = []
    ends = np.flatnonzero(np.diff(t) > _LOG_GAP_PERIODS * dt) + 1
    for rows in np.split(np.arange(len(t)), ends):
        if len(rows) < _MIN_LOG:
            continue
        part = {key: values[rows] for key, values in channels.items()}
        at, grid = t[rows] - t[rows[0]], dt * np.arange(len(rows))
        if np.max(np.abs(at - grid)) >= _UNIFORM_RTOL * dt:
            grid, part = interpolate(at, part, dt, CubicSpline)
        parts.append((grid, part))
    if not parts:
        raise ValueError(
            f"No {_MIN_LOG} samples follow one another with steps below "
            f"{_LOG_GAP_PERIODS * dt:.3g} s; dt = {dt:.3g} s does not suit these "
            "stamps."
        )
    return parts


# -- a user's file ---------------------------------------------------------------------


def sorted_by_time(table: Table, t, channels, notes):
    """Sort rows that are out of order in time, where that makes one smooth motion."""
    # Two recordings, one after the other, would be mixed: they stay as they are, to be
    # refused.
    back = int((np.diff(t) < 0).sum())
    if not back:
        return t, channels, table
    order = np.argsort(t, kind="stable")
    step, q = np.diff(t[order]), channels["q"]
    rough = [np.abs(np.diff(x, n=2, axis=0)).sum() for x in (q, q[order])]
    # A motion that is reversed is as smooth.
    smoother = rough[1] < _SMOOTHER * rough[0]
    if not (step.all() and step.max() <= GAP_PERIODS * np.median(step) and smoother):
        return t, channels, table
    notes.append(
        f"rows are not in the order of time (in {back} places of {t.size} it goes "
        "back): they were sorted by it."
    )
    channels = {key: x[order] for key, x in channels.items()}
    return t[order], channels, table.take(order)


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
    runs = _without_doubles(t, runs, channels, notes)
    stamps = [_inspected(table, t, rows, dt, channels["q"]) for rows in runs]
    dt = _common_period(table, stamps) if dt is None else dt
    notes += _irregularities(table, stamps, runs, dt)
    pieces, off_grid, counts = [], [], Counter()
    for name, rows, checked in zip(names, runs, stamps):
        put = []
        for part in _long_pieces(rows, checked, counts):
            values = _rows_of(channels, rows[part])
            at, values, same = _placed(t[rows[part]], values, checked, part, dt, counts)
            if not same:
                off_grid.append((at, values["tau"]))
                at, values = interpolate(at, values, dt)
            put.append((at, values))
        pieces += _named(name, put)
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


def _without_doubles(t, runs, channels, notes):
    """Leave out rows that repeat the one before in every channel and in time."""
    again = np.r_[False, np.diff(t) == 0]
    if again.any():
        again[1:] &= _repeats(channels, t.size)
    again[[rows[0] for rows in runs]] = False
    if again.any():
        notes.append(f"{again.sum()} row(s) are there twice and were left out once.")
    return [rows[~again[rows]] for rows in runs]


def _inspected(table, t, rows, dt, positions):
    """Return what the stamps of a segment show."""
    if rows.size < 2:
        raise ValueError(
            f"{table.path}: the segment at {table.where(rows[0])} has one row "
            "only; give it another label, or remove it."
        )
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


def _long_pieces(rows, checked, counts):
    """Return the rows of a segment between gaps, without pieces that are too short."""
    parts = np.split(np.arange(rows.size), checked.gaps + 1)
    long = [x for x in parts if x.size >= min(_MIN_SAMPLES, rows.size)]
    counts["short"] += len(parts) - len(long)
    return long


def _placed(t, values, checked, part, dt, counts):
    """Return times of the rows `part` of a segment, rows, and whether they fit."""
    if checked.sampled:
        at, values = _merge_doubled(t, values)
        counts["merged"] += t.size - at.size
        return at - at[0], values, False
    slots = checked.slots[part] - checked.slots[part[0]]
    counts["missing"] += int(slots[-1]) + 1 - part.size
    # Late stamps alone do not make another period.
    unsure = 3 * checked.jitter / checked.slots.size
    same = abs(checked.dt - dt) < max(SAME_DT * dt, unsure)
    at = (dt if same else checked.dt) * slots
    return at, values, same and slots[-1] + 1 == slots.size


def _losses(counts):
    """Yield notes on pieces that are left out and rows that were put in or averaged."""
    if counts["short"]:
        yield Loss(
            f"{counts['short']} piece(s) of fewer than {_MIN_SAMPLES} samples between "
            "gaps are left out."
        )
    if counts["missing"]:
        yield (
            f"{counts['missing']} single sample(s) are missing and were interpolated."
        )
    if counts["merged"]:
        yield f"{counts['merged']} row(s) repeat a stamp and were averaged with it."


# What irregular stamps mean, by the attribute of `TimeStamps`.
_IRREGULAR = {
    "sampled": "the positions say that the robot was sampled at these times; all is "
    "interpolated on a uniform grid",
    "late": "the sampling was regular by the positions; rows are taken as equidistant",
}


def _irregularities(table, stamps, runs, dt):
    """Yield notes on irregular stamps and gaps."""
    for what, meaning in _IRREGULAR.items():
        odd = [x for x in stamps if getattr(x, what)]
        if odd:
            jitter = max(x.jitter for x in odd)
            steps = np.concatenate([x.steps for x in odd])
            yield (
                f"time stamps are irregular (steps of {steps.min():.4g} to "
                f"{steps.max():.4g} s, standard deviation {100 * jitter / dt:.2g} % of "
                f"the period of {dt:.4g} s): {meaning}."
            )
    count = sum(int((x.steps == 0).sum()) for x in stamps if not x.sampled)
    if count:
        yield (
            f"{count} stamp(s) repeat the one before; the rows are taken as "
            "equidistant."
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
    """Concatenate files whose periods are nearly dt [s], and name the others."""
    # names: of the recordings in them, one after the other. Returns the array fields of
    # a `Recording`, and the positions of the files that were interpolated.
    pieces, names, moved, noise = [], iter(names), [], []
    for k, one in enumerate(recordings):
        channels, off_grid = _channels_of(one), []
        for rows in one.segments:
            values, t = _rows_of(channels, rows), np.arange(rows.stop - rows.start)
            if abs(one.dt - dt) >= SAME_DT * dt:
                off_grid.append((one.dt * t, values["tau"]))
                t, values = interpolate(one.dt * t, values, dt)
            else:
                t = dt * t
            pieces.append((next(names), t, values))
        moved += [k] * bool(off_grid)
        # That of the torques as they came, where they were interpolated before.
        size = one.torque_noise
        if size is None and off_grid:
            size = _white_noise(off_grid)
        if size is not None:
            noise.append((one.n_samples, size))
    fields = _fields(pieces, dt)
    if noise:
        weights, sizes = zip(*noise)
        power = np.square(sizes)
        fields["torque_noise"] = np.sqrt(np.average(power, axis=0, weights=weights))
    return fields, moved
