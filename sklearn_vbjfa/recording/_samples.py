"""Which rows of a table are samples, and when they were taken."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._clock import check_given
from sklearn_vbjfa.recording._grid import SAME_DT
from sklearn_vbjfa.recording._layout import channel_unit, is_exact, refuse_two
from sklearn_vbjfa.recording._table import (
    RecordingRefused,
    Table,
    listed,
    pandas_of,
    quoted,
)
from sklearn_vbjfa.recording._units import (
    TIME_UNITS,
    is_of_a_robot,
    unit_of_steps,
    usual_step,
)

_DAY = 86400.0
# Rows that lack a number are left out up to this share of all.
_LACKING = 0.1
# Rows of a second source are this share of all, ...
_LEAST_SHARE, _MOST_SHARE = 0.02, 0.9
# ... come in this many places and in runs no longer than this in the median.
_PLACES, _RUN = 10, 3


# -- rows ------------------------------------------------------------------------------


def without_odd_rows(table, layout, options, notes):
    """Leave out rows without numbers and of a second source.

    Returns the table, and the places of its rows if those between them are samples that
    are missing.
    """
    n, q, tau = table.n_rows, layout.of("q"), layout.of("tau")
    if options.drive is not None:
        table, tau = _with_commands_held(table, layout, options, notes), ()
    roles = [*q, *tau, *layout.of("v"), *layout.of("a")]
    values = _matrix(table, [*q, *tau])
    keep = ~np.isnan(values).all(axis=1)
    if not keep.any():
        return table, None
    if not keep.all():
        notes.append(
            f"{(~keep).sum()} row(s) without any position or torque are left out."
        )
    holes = np.isnan(np.column_stack([values, _matrix(table, roles[len(q + tau) :])]))
    lacking = holes.any(axis=1) & keep
    if 0 < lacking.sum() <= _LACKING * keep.sum():
        row = int(np.argmax(lacking))
        column = roles[int(np.argmax(holes[row]))].column
        notes.append(
            f"{lacking.sum()} row(s) lack a number, the first in {table.where(row)}, "
            f"column {column!r}: left out."
        )
        keep &= ~lacking
    second = _second_source(values[:, : len(q)], values[:, len(q) :], keep)
    if second.any():
        notes.append(
            f"{second.sum()} row(s) ({100 * second.sum() / keep.sum():.0f} %) in which "
            "all torques are exactly zero while joints move are left out: a second "
            "source writes to the same log."
        )
        keep &= ~second
    if keep.all():
        return table, None
    rows = np.flatnonzero(keep)
    # Rows of other topics, and of a second source, are no samples that are missing.
    lost = table.n_rows == n and not second.any() and rows.size >= (1 - _LACKING) * n
    return table.take(rows), rows if lost else None


def _matrix(table, roles):
    """Return columns as a matrix, without numbers (n_rows, 0)."""
    values = [table.values(role.column) for role in roles]
    if not values or any(x.dtype.kind not in "iuf" for x in values):
        return np.zeros((table.n_rows, 0))
    return np.column_stack(values).astype(float)


def _with_commands_held(table, layout, options, notes):
    """Hold commands that have separate rows until the next one comes."""
    kinds = [kind for kind in options.recorded if kind != "tau"]
    known = table.frame[[role.column for role in layout.of(*kinds)]]
    known = known.select_dtypes("number").dropna(axis=1, how="all")
    known = known.loc[:, known.isna().any()]
    if known.empty:
        return table
    rows = int(known.notna().sum().max())
    begin = int(known.notna().to_numpy().argmax(axis=0).max())
    notes.append(
        f"commands stand in {rows} of {table.n_rows} rows: each holds until the next "
        f"one comes{f'; {begin} row(s) before the first are left out' * (begin > 0)}."
    )
    return replace(table, frame=table.frame.assign(**known.ffill()).iloc[begin:])


def _second_source(q, tau, keep):
    """Return rows whose torques are all zero amid others while joints move."""
    empty = (tau == 0).all(axis=1)[keep]
    none = np.zeros(keep.size, dtype=bool)
    if not tau.size or not _LEAST_SHARE < empty.mean() < _MOST_SHARE:
        return none
    edges = np.flatnonzero(np.diff(np.r_[0, empty.astype(int), 0]))
    first, last = edges[::2], edges[1::2]
    inside = (first > 0) & (last < empty.size)
    if inside.sum() < _PLACES or np.median((last - first)[inside]) > _RUN:
        return none
    q = q[keep]
    moves = (q[last[inside]] != q[first[inside] - 1]).any(axis=1)
    if moves.mean() >= 0.5:
        none[keep] = empty
    return none


# -- time ------------------------------------------------------------------------------


def time_of(table: Table, layout, options):
    """Return stamps (n_rows,) [s] or None, and the role of their column."""
    times = layout.of("t")
    exact = any(is_exact(table, x) for x in times)
    if options.dt is not None and not (layout.certain or exact):
        # What else is called time may be anything; the period is given.
        return None, None
    if len(times) > 1 and not layout.what:
        if exact:
            refuse_two(table, times[0].column, times[1].column)
        raise RecordingRefused(
            f"{table.path}: columns {listed([x.column for x in times])} could all be "
            f"time; give columns='t={times[0].column}', or another of them.",
            {"columns": f"t={times[0].column}"},
        )
    for role in times:
        t, role = _stamps(table, role, options.time_unit)
        # A known log may have stamps that stand still.
        if np.ptp(t) > 0 or role is times[-1]:
            return t, role
    return None, None


def _stamps(table, role, time_unit):
    """Return the stamps of a column [s], and its role."""
    if role.nanoseconds:
        seconds, rest = (table.numbers(x) for x in role.columns)
        return seconds - seconds[0] + 1e-9 * (rest - rest[0]), role
    dates = _seconds_of_dates(table, role.column)
    if dates is not None:
        return dates, replace(role, unit="s")
    seconds, unit = table.numbers(role.column), channel_unit(table, role)
    factor = 1.0 if unit is None else unit.factor
    if time_unit is not None:
        factor = TIME_UNITS[time_unit]
    # Without a unit stamps stay as they are, for messages that quote them.
    t = seconds if factor == 1.0 else factor * (seconds - seconds[0])
    _check_unit(table, role, usual_step(seconds), usual_step(t), time_unit)
    return t, role


def _check_unit(table: Table, role, step, period, time_unit):
    """Refuse a unit of time in which the period [s] is none of a robot that moves."""
    used, unit = time_unit or role.unit or "s", unit_of_steps(step)
    # What goes up by one counts rows.
    if step in (0.0, 1.0) or is_of_a_robot(period) or unit in ("", used):
        return
    raise RecordingRefused(
        f"{table.path}: time steps by {period:.4g} s at the median, too "
        f"{'slow for a motion' if period > 1 else 'fast for a robot'}; column "
        f"{role.column!r} cannot be in {used}, in {unit} this would be a period of "
        f"{step * TIME_UNITS[unit]:.4g} s.",
        {"time_unit": unit},
    )


def given_period(table: Table, dt):
    """Return the period given by the caller or the file; None for neither."""
    entry = table.scalars.get("dt")
    if entry is None or entry.size != 1 or entry.dtype.kind not in "iuf":
        return dt
    in_file = float(entry.item())
    try:
        if not 0 < in_file < np.inf:
            raise ValueError(f"dt must be a positive number of seconds, got {in_file}.")
        check_given(in_file, dt, "its dt is", SAME_DT)
    except ValueError as error:
        raise ValueError(f"{table.path}: {error}") from None
    return in_file if dt is None else dt


def _seconds_of_dates(table: Table, column: str):
    """Return dates, or times of day, as seconds from the first, None for others."""
    pandas = pandas_of(table.path)
    values = table.frame[column]
    if values.dtype.kind != "M":
        if values.dtype.kind in "biuf" or not isinstance(values.iloc[0], str):
            return None
        text = values.astype(str).str.replace(",", ".")
        if text.str.fullmatch(r"\d{1,2}:\d\d:\d\d(\.\d*)?").all():
            seconds = pandas.to_timedelta(text).dt.total_seconds().to_numpy()
            days = np.cumsum(np.diff(seconds, prepend=seconds[0]) < -_DAY / 2)
            return seconds + _DAY * days - seconds[0]
        dates = pandas.to_datetime(text, format="ISO8601", utc=True, errors="coerce")
        if pandas.isna(dates.iloc[0]):
            return None
        wrong = np.flatnonzero(dates.isna())
        if wrong.size:
            raise ValueError(
                f"{table.path}: {quoted(values.iloc[wrong[0]])} in "
                f"{table.where(wrong[0])}, column {column!r}, is not a date and time "
                "like the others; correct or remove that row."
            )
        values = dates
    return (values - values.iloc[0]).dt.total_seconds().to_numpy()
