"""Time stamps [s] out of a table: its column, their unit, dates."""

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
