"""Recordings on a uniform time grid: cut where rows are missing, interpolated between.

Two kinds of recordings come here. The logs of measured sets, which the loaders know,
go through `join`: their period is given, their stamps are those of the sampling. A
user's file goes through `on_grid`, which asks the stamps first what they are; several
of them then go through `on_one_grid`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from sklearn_vbjfa.recording._stamps import (
    GAP_PERIODS,
    STEADY,
    inspect_time_stamps,
    prediction_errors,
)
from sklearn_vbjfa.recording._table import Loss, Table

# Fewer samples than this between two gaps cannot be differentiated.
_MIN_SAMPLES = 10
# A log is uniform already up to this part of dt: a steady clock with six decimals.
_UNIFORM_RTOL = 1e-3
# A step of a log above this many periods ends a part and starts another one.
_LOG_GAP_PERIODS = 10.0
# Relative difference between the periods of segments that is refused, and below which
# they count as one.
_DT_TOLERANCE, _SAME_DT = 0.05, 1e-3
# The lower quartile of the size of a normal variable, in standard deviations.
_QUARTILE = 0.3186


@dataclass(frozen=True)
class _Piece:
    """A part of a recording on a time axis of its own: name, stamps [s], channels."""

    name: str
    t: np.ndarray
    channels: Mapping[str, np.ndarray]


def _fields(pieces: Sequence[_Piece], dt: float) -> dict:
    """Concatenate pieces into the array fields of a `Recording`."""
    columns = {
        key: np.concatenate([piece.channels[key] for piece in pieces])
        for key in pieces[0].channels
    }
    return {
        "q": columns.pop("q"),
        "tau": columns.pop("tau"),
        "v": columns.pop("v", None),
        "t": np.concatenate([piece.t for piece in pieces]),
        "dt": dt,
        "groups": np.repeat(np.arange(len(pieces)), [len(x.t) for x in pieces]),
        "group_names": tuple(piece.name for piece in pieces),
        "signals": columns,
    }


def _numbered(name: str, number: int, count: int) -> str:
    """Name the parts of a recording that was cut: "name [1]", "name [2]", ..."""
    return name if count == 1 else f"{name} [{number}]"


# -- interpolation ---------------------------------------------------------------------


def local_cubic(t: np.ndarray, rows: np.ndarray) -> Callable:
    """Cubics with the slopes of parabolas, which no far-off sample can disturb."""
    slope = np.gradient(rows, t, axis=0, edge_order=2)
    return CubicHermiteSpline(t, rows, slope, axis=0)


def interpolate(
    t: np.ndarray,
    channels: Mapping[str, np.ndarray],
    dt: float,
    cubic: Callable = local_cubic,
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Interpolate channels (n, ...) at t (n,) [s], from 0 on, on multiples of dt."""
    # Positions "q" follow the cubic that `cubic` builds from stamps and rows; all else,
    # being noisier, follows straight lines.

    # Rounding of t must not cost the last point.
    grid = dt * np.arange(int(np.floor(t[-1] / dt + STEADY)) + 1)
    query = np.minimum(grid, t[-1])
    resampled = {}
    for key, values in channels.items():
        rows = values.reshape(t.size, -1).astype(float)
        if key == "q" and t.size > 2:
            rows = cubic(t, rows)(query)
        else:
            rows = np.column_stack([np.interp(query, t, x) for x in rows.T])
        resampled[key] = rows.reshape(query.size, *values.shape[1:])
    return grid, resampled


def _repeats(channels: Mapping[str, np.ndarray], n: int) -> np.ndarray:
    """Whether each of n - 1 rows equals the one before it in every channel."""
    same = np.ones(n - 1, dtype=bool)
    for values in channels.values():
        rows = values.reshape(n, -1)
        same &= (rows[1:] == rows[:-1]).all(axis=1)
    return same


def merge_doubled(t, channels):
    """Average rows of one stamp: t (n,) [s] that does not fall, channels (n, ...)."""
    starts = np.flatnonzero(np.r_[True, np.diff(t) > 0])
    if starts.size == t.size:
        return t, dict(channels)
    count = np.diff(starts, append=t.size)
    return t[starts], {
        key: np.add.reduceat(values.astype(float), starts, axis=0)
        / count.reshape(-1, *[1] * (values.ndim - 1))
        for key, values in channels.items()
    }


# -- logs of measured sets -------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Log:
    """One recording as read: stamps [s] and channels, first axis time."""

    name: str
    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    v: np.ndarray | None = None
    signals: Mapping[str, np.ndarray] = field(default_factory=dict)


def median_period(logs: Iterable[Log]) -> float:
    """Median step between stamps over all logs [s], rounded to 0.1 us."""
    return round(float(np.median(np.concatenate([np.diff(x.t) for x in logs]))), 7)


def join(
    logs: Sequence[Log],
    *,
    dt: float,
    resample: bool = True,
    drop_repeated: bool = False,
) -> dict:
    """Concatenate logs into the array fields of a `Recording`."""
    # With `resample` each log is put on multiples of dt; one with long gaps becomes
    # several recordings, "name [1]", "name [2]", ...
    pieces = []
    for log in logs:
        channels = {"q": log.q, "tau": log.tau, **log.signals}
        if log.v is not None:
            channels["v"] = log.v
        parts = [(log.t, channels)]
        if resample:
            parts = resample_uniform(
                log.t, channels, dt=dt, drop_repeated=drop_repeated
            )
        for number, (t, part) in enumerate(parts, start=1):
            pieces.append(_Piece(_numbered(log.name, number, len(parts)), t, part))
    return _fields(pieces, dt)


def resample_uniform(
    t: np.ndarray,
    channels: Mapping[str, np.ndarray],
    *,
    dt: float,
    drop_repeated: bool = False,
) -> list[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Return grid (n_part,) [s] and channels of a log's parts between long gaps."""
    # A log that is uniform already is left as it is; `drop_repeated` also drops rows
    # equal to the one before in every channel, readings that the logger wrote twice.
    step = np.diff(t)
    if np.any(step < 0):
        raise ValueError(
            "Time stamps must not decrease, they do after row "
            f"{np.flatnonzero(step < 0)[0]}; sort the rows or split the log there."
        )
    keep = np.r_[True, step > 0]
    if drop_repeated:
        keep[1:] &= ~_repeats(channels, len(t))
    t = t[keep]
    channels = {key: values[keep] for key, values in channels.items()}
    parts = []
    ends = np.flatnonzero(np.diff(t) > _LOG_GAP_PERIODS * dt) + 1
    for rows in np.split(np.arange(len(t)), ends):
        if len(rows) < _MIN_SAMPLES:
            continue
        part = {key: values[rows] for key, values in channels.items()}
        at, grid = t[rows] - t[rows[0]], dt * np.arange(len(rows))
        if np.max(np.abs(at - grid)) >= _UNIFORM_RTOL * dt:
            grid, part = interpolate(at, part, dt, CubicSpline)
        parts.append((grid, part))
    if not parts:
        raise ValueError(
            f"No {_MIN_SAMPLES} samples follow one another with steps below "
            f"{_LOG_GAP_PERIODS * dt:.3g} s; dt = {dt:.3g} s does not suit these "
            "stamps."
        )
    return parts


# -- a user's file ---------------------------------------------------------------------


@dataclass
class _Tally:
    """What was left out, put in or joined, and what was measured before that."""

    short: int = 0
    single: int = 0
    merged: int = 0
    off_grid: list = field(default_factory=list)

    def notes(self):
        """Say it in words."""
        if self.short:
            yield Loss(
                f"{self.short} piece(s) of fewer than {_MIN_SAMPLES} samples between "
                "gaps are left out."
            )
        if self.single:
            yield f"{self.single} single sample(s) are missing and were interpolated."
        if self.merged:
            yield f"{self.merged} row(s) repeat a stamp and were averaged with it."

    def white_noise(self):
        """Return the standard deviation (nv,) of white noise off the grid."""
        # The lower quartile passes over what jumps, as friction does.
        errors = [prediction_errors(t, torques) for t, torques in self.off_grid]
        errors = np.abs(np.concatenate(errors))
        return np.quantile(errors, 0.25, axis=0) / _QUARTILE if errors.size else None


def on_grid(table: Table, t, labels, dt, channels, notes):
    """Cut a file at segments and gaps, return the array fields of a `Recording`."""
    # Stamps t [s] and labels of segments, (n_rows,) or None; dt [s] or None for that of
    # the stamps; channels (n_rows, ...), "q" and "tau" among them. What was found goes
    # to `notes`.
    segments = _segments(labels, table.n_rows)
    if t is None:
        pieces = [
            _Piece(name, dt * np.arange(rows.size), _rows_of(channels, rows))
            for name, rows in segments
        ]
        return _fields(pieces, dt)
    segments = _without_doubles(t, segments, channels, notes)
    stamps = _inspected(table, t, segments, dt, channels["q"])
    if dt is None:
        dt = _common_period(table, stamps)
    notes += _irregularities(table, stamps, segments, dt)
    pieces, tally = [], _Tally()
    for (name, rows), checked in zip(segments, stamps):
        parts = np.split(np.arange(rows.size), checked.gaps + 1)
        long = [x for x in parts if x.size >= min(_MIN_SAMPLES, rows.size)]
        tally.short += len(parts) - len(long)
        for number, part in enumerate(long, start=1):
            label = _numbered(name, number, len(long))
            values = _rows_of(channels, rows[part])
            grid, values = _put(t[rows[part]], values, checked, part, dt, tally)
            pieces.append(_Piece(label, grid, values))
    notes += tally.notes()
    if not pieces:
        raise ValueError(
            f"{table.path}: no {_MIN_SAMPLES} samples follow one another without a gap "
            f"of more than {GAP_PERIODS:g} periods of {dt:.4g} s; check column t."
        )
    fields = _fields(pieces, dt)
    if tally.off_grid:
        fields["torque_noise"] = tally.white_noise()
    return fields


def on_one_grid(recordings, names, dt):
    """Concatenate files whose periods are nearly dt [s], and say which have another."""
    # names: of the recordings in them, one after the other. Returns the array fields of
    # a `Recording`, and the positions of the files that were interpolated.
    pieces, names, moved, noise = [], iter(names), [], []
    for k, one in enumerate(recordings):
        channels = {"q": one.q, "tau": one.tau, **one.signals}
        if one.v is not None:
            channels["v"] = one.v
        tally = _Tally()
        for rows in one.segments:
            values = _rows_of(channels, rows)
            t = dt * np.arange(rows.stop - rows.start)
            if abs(one.dt - dt) >= _SAME_DT * dt:
                own = one.dt * np.arange(t.size)
                tally.off_grid.append((own, values["tau"]))
                t, values = interpolate(own, values, dt)
            pieces.append(_Piece(next(names), t, values))
        if tally.off_grid:
            moved.append(k)
        # That of the torques as they came, where they were interpolated before.
        own = one.torque_noise
        if own is None and tally.off_grid:
            own = tally.white_noise()
        if own is not None:
            noise.append((one.n_samples, own))
    fields = _fields(pieces, dt)
    if noise:
        share, power = zip(*((n, own**2) for n, own in noise))
        fields["torque_noise"] = np.sqrt(np.average(power, axis=0, weights=share))
    return fields, moved


def _rows_of(channels, rows):
    return {key: values[rows] for key, values in channels.items()}


def _put(t, values, checked, part, dt, tally):
    """Put rows `part` of a segment on the grid: as they are, if they lie on it."""
    if checked.sampled:
        at, values = merge_doubled(t, values)
        tally.merged += t.size - at.size
        at = at - at[0]
    else:
        slots = checked.slots[part]
        # Late stamps alone do not make another period.
        unsure = 3 * checked.jitter / checked.slots.size
        same = abs(checked.dt - dt) < max(_SAME_DT * dt, unsure)
        at = (dt if same else checked.dt) * (slots - slots[0])
        missing = int(slots[-1] - slots[0]) + 1 - part.size
        tally.single += missing
        if same and at.size == round(at[-1] / dt) + 1:
            return dt * np.arange(at.size), values
    tally.off_grid.append((at, values["tau"]))
    return interpolate(at, values, dt)


def _segments(labels, n_rows):
    """Return (name, rows) of each run of equal labels, names made unique."""
    if labels is None:
        return [("recording", np.arange(n_rows))]
    borders = np.flatnonzero(labels[1:] != labels[:-1]) + 1
    runs = np.split(np.arange(n_rows), borders)
    texts = []
    for label in labels[[rows[0] for rows in runs]]:
        is_whole = labels.dtype.kind == "f" and float(label).is_integer()
        texts.append(str(int(label) if is_whole else label))
    return list(zip(distinct(texts), runs))


def distinct(names):
    """Return names of which those that are there already have a number behind them."""
    found, seen = [], {}
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        found.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return found


def _without_doubles(t, segments, channels, notes):
    """Leave out rows that repeat the one before in every channel and in time."""
    again = np.diff(t) == 0
    if again.any():
        again &= _repeats(channels, t.size)
    again = np.r_[False, again]
    kept, count = [], 0
    for name, rows in segments:
        own = again[rows]
        own[0] = False
        count += int(own.sum())
        kept.append((name, rows[~own]))
    if count:
        notes.append(f"{count} row(s) are there twice and were left out once.")
    return kept


def _inspected(table, t, segments, dt, positions):
    """Return what the stamps of each segment tell."""
    stamps = []
    for _, rows in segments:
        if rows.size < 2:
            raise ValueError(
                f"{table.path}: the segment at {table.where(rows[0])} has one row "
                "only; give it another label, or remove it."
            )
        try:
            stamps.append(
                inspect_time_stamps(
                    t[rows],
                    dt,
                    lambda k, rows=rows: table.where(rows[k]),
                    positions[rows],
                )
            )
        except ValueError as error:
            raise ValueError(f"{table.path}: {error}") from None
    return stamps


def _common_period(table, stamps):
    """Return the period of all segments [s]."""
    periods = [x.dt for x in stamps]
    dt = float(np.median(periods))
    if max(periods) - min(periods) > 2 * _DT_TOLERANCE * dt:
        raise ValueError(
            f"{table.path}: segments have periods of {min(periods):.6g} to "
            f"{max(periods):.6g} s; put those of one period into one file."
        )
    return dt


def _irregularities(table, stamps, segments, dt):
    """Say in words what is irregular."""
    for what, said in (
        (
            [x for x in stamps if x.sampled],
            "the positions say that the robot was sampled at these times; all is "
            "interpolated on a uniform grid",
        ),
        (
            [x for x in stamps if x.late],
            "the positions do not follow them, so that only the stamps are irregular "
            "and not the sampling; rows are taken as equidistant",
        ),
    ):
        if what:
            jitter = max(x.jitter for x in what)
            shortest = min(x.shortest for x in what)
            longest = max(x.longest for x in what)
            yield (
                f"time stamps are irregular (steps of {shortest:.4g} to {longest:.4g} "
                f"s, standard deviation {100 * jitter / dt:.2g} % of the period of "
                f"{dt:.4g} s): {said}."
            )
    count = sum(x.doubled for x in stamps if not x.sampled)
    if count:
        yield (
            f"{count} stamp(s) repeat the one before; the rows are taken as "
            "equidistant."
        )
    count = sum(x.gaps.size for x in stamps)
    if count:
        k = next(k for k, x in enumerate(stamps) if x.gaps.size)
        row = segments[k][1][stamps[k].gaps[0]]
        yield Loss(
            f"{count} gap(s) of more than {GAP_PERIODS:g} periods in time, the first "
            f"after {table.where(row)}: the recording is split there."
        )
