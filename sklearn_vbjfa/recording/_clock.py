"""Sample times: each stamp against its place on a regular grid."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from sklearn_vbjfa.recording._layout import channel_unit, is_exact, refuse_ambiguous
from sklearn_vbjfa.recording._recording import check_dt, contiguous_groups
from sklearn_vbjfa.recording._table import (
    SLOWEST,
    TIME_UNITS,
    RecordingRefused,
    imported,
    listed,
    quoted,
    unit_of_steps,
    usual_step,
)

# Stamps within this share of a period of the grid are those of a steady clock that was
# written with few digits.
STEADY = 0.02
# A step longer than this many periods is a gap, not bridged by interpolation.
GAP_PERIODS = 5.0
# Relative difference that is refused between `dt` as given and as stamped.
DT_TOLERANCE = 0.05
# Relative difference below which periods count as one.
SAME_DT = 1e-3
# Late stamps average out over so many rows. Those that scatter about such means by less
# than a share of a period show how many rows are missing; means that scatter by more
# than a share show that rows are missing, or that the period changes.
_LONG, _NEAR, _FAR = 64, 0.25, 0.5
# Steps that do not show it, of which more than this share are gaps, are refused.
_MANY_GAPS = 0.02
# Positions must fit the stamps better by this much, in the sum over the joints of the
# logarithms of their squared errors, than they fit the grid.
_CLEARLY = 0.2


@dataclass(frozen=True, kw_only=True)
class TimeStamps:
    """Sample times of one recording, as its stamps and positions show them."""

    dt: float  # sample period [s]
    # "" for regular stamps; "sampled" at irregular ones, or steadily but stamped "late"
    irregular: str
    # period in which each row was sampled, from 0 on in each piece between gaps;
    # without meaning if "sampled"
    slots: np.ndarray
    steps: np.ndarray  # between stamps, gaps left out [s]
    gaps: np.ndarray  # rows after which more than five periods are missing


def inspect_time_stamps(
    t, dt=None, where="row {}".format, positions=None, tolerance=DT_TOLERANCE
):
    """Return the `TimeStamps` of one recording with the stamps t (n_samples,) [s]."""
    # dt [s] is the period if it is known, up to a tolerance; `where` names a row (from
    # 0) in messages; positions (n_samples, nv) show whether irregular stamps are the
    # times of sampling, without them a steady sampling is assumed.
    t = np.asarray(t, dtype=float)
    if t.ndim != 1 or t.size < 2:
        raise ValueError(f"t must hold two time stamps or more, got shape {t.shape}.")
    _check_rise(t, where)
    step = np.diff(t)
    period, counts = _periods(step)
    is_gap = step > GAP_PERIODS * period
    pieces = contiguous_groups(np.r_[0, np.cumsum(is_gap)], t.size)
    slots = np.r_[0, np.cumsum(counts)]
    for piece in pieces:
        slots[piece] -= slots[piece.start]
    found = float(step[~is_gap].sum() / counts[~is_gap].sum())
    irregular, grid = "", found * slots
    if max(np.ptp((t - grid)[x]) for x in pieces) > 2 * STEADY * found:
        irregular = _kind_of_irregularity(t, grid, pieces, positions, found)
    if dt is not None and abs(found - dt) > tolerance * dt:
        raise ValueError(
            f"time steps by {found:.6g} s but dt = {dt:.6g} s; correct one of them, or "
            "leave out dt (a period in s, not in ms or Hz)."
        )
    return TimeStamps(
        dt=float(f"{found:.7g}") if dt is None else float(dt),
        irregular=irregular,
        slots=slots,
        steps=step[~is_gap],
        gaps=np.flatnonzero(is_gap),
    )


def _check_rise(t, where):
    step = np.diff(t)
    for wrong, what in ((step < 0, "runs backwards to"), (step == 0, "repeats")):
        if wrong.any():
            row = int(np.argmax(wrong)) + 1
            raise ValueError(
                f"time {what} {t[row]:.9g} s in {where(row)} ({wrong.sum()} of "
                f"{t.size} rows): sort the rows, write the stamps with more digits, "
                "mark separate recordings in a column segment, or leave the stamps out "
                "and give dt."
            )


def _periods(step):
    """Return the period of steps [s], and how many of it each of them takes."""
    ones, usual = np.ones(step.size, dtype=int), float(np.median(step))
    plain = _lateness(step, usual, ones)
    # Without the rows of a second source, steps of two sizes may be equally frequent.
    for share in (0.5, 0.25):
        period = float(np.quantile(step, share, method="lower"))
        counts = np.maximum(np.rint(step / period).astype(int), 1)
        if _lateness(step, period, counts) < min(_NEAR, plain):
            return period, counts
    # Nothing shows which rows are missing, if any.
    if plain > _NEAR and np.mean(step > GAP_PERIODS * usual) > _MANY_GAPS:
        raise ValueError(
            f"time steps by {step.min():.4g} to {step.max():.4g} s, without a period; "
            "correct t, or leave it out and give dt if rows are equidistant."
        )
    return usual, ones


def _lateness(step, period, counts):
    """Return the standard deviation of stamps about their means, in periods."""
    gap = step > GAP_PERIODS * period
    found = step[~gap].sum() / counts[~gap].sum()
    away = np.cumsum(np.where(gap, 0.0, step - found * counts))
    return np.std(away - uniform_filter1d(away, _LONG)) / found


def _kind_of_irregularity(t, grid, pieces, positions, period):
    """Return whether rows were "sampled" at their stamps, or stamped "late"."""
    if positions is not None:
        # Positions are smoother over times of sampling.
        stamped, steady = (
            sum(
                (prediction_errors(x[y], positions[y]) ** 2).sum(axis=0) for y in pieces
            )
            for x in (t, grid)
        )
        moves = (np.ptp(positions, axis=0) > 0) & (stamped > 0) & (steady > 0)
        if np.log(stamped[moves] / steady[moves]).sum() < -_CLEARLY:
            return "sampled"
    for piece in pieces:
        away = t[piece] - grid[piece]
        # A clock may drift.
        trend = np.polynomial.Polynomial.fit(grid[piece], away, min(3, away.size - 1))
        wander = np.std(uniform_filter1d(away - trend(grid[piece]), _LONG))
        if wander > _FAR * period:
            raise ValueError(
                f"time wanders by {wander:.4g} s about steps of {period:.4g} s, and "
                "positions do not follow it: rows are missing, or the period changes. "
                "Correct t, mark recordings of other periods in a column segment, or "
                "leave t out and give dt if rows are equidistant."
            )
    return "late"


def prediction_errors(t, values):
    """Return how far values (n, k) are from cubics through their neighbours, (m, k)."""
    # In units of their standard deviation for unit white noise; t (n,) [s] must rise.
    n = t.size - 4
    if n < 1:
        return np.empty((0, values.shape[1]))
    near = [slice(k, k + n) for k in (0, 1, 3, 4)]
    at = [t[x] - t[2:-2] for x in near]
    predicted, gain = 0.0, 1.0
    for i, rows in enumerate(near):
        others = at[:i] + at[i + 1 :]
        weight = np.prod([x / (x - at[i]) for x in others], axis=0)
        predicted = predicted + weight[:, None] * values[rows]
        gain = gain + weight**2
    return (values[2:-2] - predicted) / np.sqrt(gain)[:, None]


# -- stamps of arrays ------------------------------------------------------------------

# Accelerations go with the square of a wrong period: this share of it, and no less than
# a row over a recording, is refused. Steps are irregular beyond the second share.
_WRONG_PERIOD, _JITTER = 0.002, 0.1


def check_time_stamps(t, dt, parts):
    """Refuse stamps t (n,) [s] that contradict dt [s], warn of irregular ones."""
    # Nothing is asked of the step from one of the slices `parts` to the next; without
    # dt (rows need not be equidistant) only that the stamps rise.
    for part in parts if t is not None else ():
        stamps, first = np.asarray(t[part], dtype=float), part.start
        _check_rise(stamps, lambda k, first=first: f"row {first + k}")
        if dt is None or stamps.size < 2:
            continue
        tolerance = max(_WRONG_PERIOD, 1 / stamps.size)
        found = inspect_time_stamps(stamps, check_dt(dt), tolerance=tolerance)
        missing = first + np.flatnonzero(np.diff(found.slots) != 1)
        if missing.size:
            raise ValueError(
                f"t lacks samples after row {listed(missing)}: steps are at most "
                f"{np.diff(stamps).max():.6g} s, but dt={dt:.6g} s. Resample, or begin "
                "another recording after each gap (groups)."
            )
        if np.abs(found.steps / dt - 1).max() > _JITTER:
            warnings.warn(
                f"steps between time stamps from row {first} on vary from "
                f"{found.steps.min():.6g} to {found.steps.max():.6g} s, dt={dt:.6g} s; "
                "rows count as equidistant. Resample, unless only the stamps are "
                "irregular.",
                UserWarning,
                stacklevel=3,
            )


# -- rows that are no samples ----------------------------------------------------------

# Rows that lack a number are left out up to this share of all.
_LACKING = 0.1
# Rows of a second source are more than this share of all, come in this many places, and
# in runs no longer than this in the median.
_LEAST_SHARE, _PLACES, _RUN = 0.02, 10, 3
# A value but zero that comes so often, and is this many ranges of the others away from
# them, means that none was measured; a channel has more values than the last number.
_OFTEN, _AWAY, _LEVELS = 3, 3.0, 16


def without_odd_rows(table, layout, options, notes):
    """Leave out rows without numbers and of a second source.

    Returns the table, and the places of its rows on a regular clock.
    """
    q, tau = layout.select("q"), layout.select("tau") if options.drive is None else ()
    columns, n = [x.column for x in (*q, *tau, *layout.select("v", "a"))], len(q + tau)
    values = [table.values(column) for column in columns]
    every = np.arange(len(table.frame))
    if not values or any(x.dtype.kind not in "iuf" for x in values):
        return table, every
    values = np.column_stack(values).astype(float)
    fillers = [
        f"{x:g} in column {column!r}"
        for column, own in zip(columns, values.T)
        for x in _without_fillers(own)
    ]
    holes = np.isnan(values)
    empty = holes[:, :n].all(axis=1)
    lacking = holes.any(axis=1) & ~empty
    few = lacking.sum() <= _LACKING * (~empty).sum()
    # Rows of other topics have neither positions nor torques.
    out = empty | lacking if few else empty
    if empty.all():
        return table, every
    if out.any():
        row = int(np.argmax(out))
        notes.append(
            f"{out.sum()} row(s) lack a number, the first in {table.where(row)}, "
            f"column {columns[int(np.argmax(holes[row]))]!r}: left out."
        )
    if fillers:
        found = f"{listed(fillers)} is far from all other values, as where nothing was "
        if not few:
            raise ValueError(
                f"{table.path}: {found}measured ({lacking.sum()} rows); remove these "
                "rows, or write nan."
            )
        notes.append(f"{found}measured: taken as missing.")
    rows = np.flatnonzero(~out)
    second = _second_source(values[rows, : len(q)], values[rows, len(q) : n])
    if second.any():
        notes.append(
            f"{second.sum()} row(s) ({100 * second.mean():.0f} %) in which all torques "
            "are exactly zero while joints move are left out: a second source writes "
            "to the same log."
        )
        rows = rows[~second]
    if rows.size == len(table.frame):
        return table, every
    # Rows of other topics, and of a second source, are no samples that are missing.
    lost = not second.any() and rows.size >= (1 - _LACKING) * len(table.frame)
    table = replace(table, frame=table.frame.iloc[rows])
    return table, rows if lost else every[: rows.size]


def _without_fillers(x):
    """Yield the values of a column that mean a missing one, replaced by nan."""
    known = x[~np.isnan(x)]
    ends = known.min(initial=np.inf), known.max(initial=-np.inf)
    others = known[(known > ends[0]) & (known < ends[1])]
    if others.size <= _LEVELS:
        return
    low, high = others.min(), others.max()
    for level in ends:
        away = max(low - level, level - high)
        if not level or away <= _AWAY * (high - low) or (x == level).sum() < _OFTEN:
            continue
        # Sorting a long channel takes time: only where it matters.
        if np.unique(others).size > _LEVELS:
            x[x == level] = np.nan
            yield level


def _second_source(q, tau):
    """Return rows whose torques are all zero amid others while joints move."""
    still = (tau == 0).all(axis=1)
    none = np.zeros(still.size, dtype=bool)
    if not tau.size or still.mean() <= _LEAST_SHARE:
        return none
    runs = contiguous_groups(still, still.size)[1:-1]
    ends = np.array([(x.start, x.stop) for x in runs if still[x.start]])
    if len(ends) < _PLACES or np.median(np.ptp(ends, axis=1)) > _RUN:
        return none
    moves = (q[ends[:, 1]] != q[ends[:, 0] - 1]).any(axis=1)
    return still if moves.mean() >= 0.5 else none


# -- the column of time ----------------------------------------------------------------

_DAY = 86400 * 10**9  # [ns]
# The rows are poses if their mean squared step is this share of the variance.
_APART = 0.1


def time_of(table, layout, options, q):
    """Return stamps (n_rows,) [s] or None, and the role of their column."""
    times = layout.select("t")
    exact = any(is_exact(x) for x in times)
    if options.dt is not None and not (layout.certain or exact):
        # What else is called time may be anything; the period is given.
        return None, None
    if len(times) > 1 and not layout.what:
        if exact:
            refuse_ambiguous(table, times[0].column, times[1].column)
        raise RecordingRefused(
            f"{table.path}: columns {listed([x.column for x in times])} could all be "
            f"time; give columns='t={times[0].column}', or another of them.",
            {"columns": f"t={times[0].column}"},
        )
    for role in times:
        t = _stamps(table, role, options, q)
        # A known log may have stamps that stand still.
        if np.ptp(t) > 0 or role is times[-1]:
            return t, role
    return None, None


def _stamps(table, role, options, q):
    """Return the stamps of a column [s]."""
    dates = nanoseconds(table, role.column)
    if dates is not None:
        return 1e-9 * (dates - dates[0])
    values, unit = table.values(role.column), channel_unit(table, role)
    if values.dtype.kind == "O":
        raise ValueError(
            f"{table.path}: column {role.column!r} holds {quoted(str(values[0]))}; "
            "expected seconds, dates (2024-03-30T23:59:50.125) or times of day "
            "(23:59:50.125)."
        )
    seconds = table.numbers(role.column)
    factor = TIME_UNITS.get(options.time_unit, 1.0 if unit is None else unit.factor)
    step = usual_step(seconds)
    used = options.time_unit or role.unit
    # What goes up by one counts rows.
    if options.dt is not None and step == 1.0 and not used:
        return options.dt * seconds
    period, likely, used = factor * step, unit_of_steps(step), used or "s"
    size = q.var(axis=0).mean()
    if period > SLOWEST and (np.diff(q, axis=0) ** 2).mean() > _APART * size:
        # The time between poses does not matter.
        return (options.dt or period) * np.arange(len(q))
    known = step in (0.0, 1.0) or unit_of_steps(period) == "s"
    if not known and likely not in ("", used):
        raise RecordingRefused(
            f"{table.path}: time steps by {period:.4g} s at the median, too "
            f"{'slow for a motion' if period > 1 else 'fast for a robot'}; column "
            f"{role.column!r} cannot be in {used}, in {likely} this would be a period "
            f"of {step * TIME_UNITS[likely]:.4g} s.",
            {"time_unit": likely},
        )
    # Without a unit stamps stay as they are, for messages that quote them.
    return seconds if factor == 1.0 else factor * (seconds - seconds[0])


def nanoseconds(table, column):
    """Return dates, or times of day, as integers [ns], None for others."""
    pandas, values = imported(table.path, "pandas"), table.frame[column]
    if values.dtype.kind != "M":
        if values.dtype.kind in "biuf" or not isinstance(values.iloc[0], str):
            return None
        text = values.astype(str).str.replace(",", ".")
        if text.str.fullmatch(r"\d{1,2}:\d\d:\d\d(\.\d*)?").all():
            times = (
                pandas.to_timedelta(text).to_numpy().astype("m8[ns]").astype("int64")
            )
            days = np.cumsum(np.diff(times, prepend=times[0]) < -_DAY // 2)
            return times + _DAY * days
        values = pandas.to_datetime(text, format="ISO8601", utc=True, errors="coerce")
    if values.isna().any():
        return None
    return values.dt.as_unit("ns").astype("int64").to_numpy()
