"""The table of a file as a recording: order, units, signs of time, one time grid."""

import re
from dataclasses import replace
from os import fspath

import numpy as np

from sklearn_vbjfa.recording._clock import (
    SAME_DT,
    check_given,
    on_grid,
    sorted_by_time,
)
from sklearn_vbjfa.recording._columns import as_numbers
from sklearn_vbjfa.recording._layout import (
    ESTIMATES,
    ReadOptions,
    channel_unit,
    in_order,
    is_exact,
    known_channels,
    laid_out,
    refuse_two,
)
from sklearn_vbjfa.recording._missing import is_current, refusal
from sklearn_vbjfa.recording._recording import Recording, contiguous_groups
from sklearn_vbjfa.recording._table import (
    RecordingRefused,
    Table,
    listed,
    pandas_of,
    quoted,
)
from sklearn_vbjfa.recording._units import (
    KINDS,
    MEASURED,
    TIME_UNITS,
    is_of_a_robot,
    split_unit,
    unit_of,
    unit_of_steps,
    usual_step,
)

# No robot has positions [rad or m], speeds or torques [N m or N] beyond this.
_LARGEST = 1e12
# Rows that lack a number are left out up to this share of all.
_LACKING = 0.1
# Steps of angles above the first share of a turn are wraps if all of them, and no less,
# are above the second; a wrapped angle stays within a turn.
_JUMP, _WRAP = 0.5, 0.8
_DAY = 86400.0


def is_recording(table: Table, options: ReadOptions):
    """Whether a table has all channels, or would have with other options."""
    try:
        robot = options.robot(table)
        # Without time it is one, too, and refused for that.
        options = replace(options, dt=1.0)
        _roles(table, laid_out(table, options, robot), options, robot, [])
    except RecordingRefused as error:
        return bool(error.options)
    except ValueError:
        return False
    return True


def _roles(table, layout, options, robot, notes):
    """Return the columns of each kind in the order of the joints, and these."""
    _, missing = known_channels(layout, options, robot)
    if missing:
        raise refusal(table, layout, options, robot, missing)
    return in_order(table, layout, options, robot, notes)


def recording_of(table: Table, options: ReadOptions):
    """Return the recording in a table, complete, and what a user should know of it."""
    notes = list(table.notes)
    robot = options.robot(table)
    options = replace(options, dt=_given_period(table, options.dt))
    layout = laid_out(table, options, robot)
    table, rows = _without_odd_rows(table, layout, options, notes)
    found, robot = _roles(table, layout, options, robot, notes)
    names = _check_joints(table, found, robot)
    channels, units = _in_units(table, found, options, notes)
    slides = _check_units(table, found, units, names, robot)
    of_joints = ["N" if slide else "N m" for slide in slides]
    torque_units = [x or y for x, y in zip(units.get("tau", of_joints), of_joints)]
    if isinstance(options.gains, tuple):
        torque_units = of_joints
        _check_gains(table, options.gains, names)
        channels["tau"] = channels["tau"] * np.array(options.gains)
    # Of a drive the torques are made when all files are read.
    channels.setdefault("tau", np.zeros(channels["q"].shape))
    if robot.in_model:
        # The order of the model, whatever that of the file.
        order = sorted(range(len(names)), key=lambda j: robot.in_model.index(names[j]))
        names, slides, torque_units = (
            [x[j] for j in order] for x in (names, slides, torque_units)
        )
        channels = {kind: values[:, order] for kind, values in channels.items()}
    t, time = _time(table, layout, options)
    labels, segment = _segments(table, layout)
    _unwrap(channels, names, slides, labels, notes)
    taken = {role.column for kind in layout.channels for role in layout.roles(kind)}
    taken |= {segment, *(() if time is None else time.columns), *layout.no_signals}
    taken |= {x for role in layout.times if layout.what for x in role.columns}
    signals, left_out = _signals(table, taken, notes)
    said = _what_was_taken(table, layout, options, found, time)
    notes = [*said, *notes]
    motor = [unit for unit in torque_units if unit not in ("N m", "N")]
    if motor and options.gains is None and options.drive is None:
        notes.append(
            f"the torques are recorded in {motor[0]}: give the gains, factors to N m, "
            "or identify them (gains='unknown'; command line: --gain unknown)."
        )
    if t is None and rows is not None:
        # Without stamps the places of the rows that are left are their times.
        t = options.dt * rows
    # What was read is held no longer than needed.
    table = replace(table, frame=table.frame.iloc[:, :0])
    channels |= signals
    if t is not None and labels is None:
        t, channels, table = sorted_by_time(table, t, channels, notes)
    fields = on_grid(table, t, labels, options.dt, channels, notes)
    recording = Recording(
        name=_stem(table.path),
        joint_names=tuple(names),
        position_units=tuple("m" if slide else "rad" for slide in slides),
        torque_units=tuple(torque_units),
        urdf=None if options.urdf is None else fspath(options.urdf),
        description=f"Read from {table.path.name}.",
        left_out=left_out,
        **fields,
    )
    return recording, notes


def _stem(path):
    """Return the name of a recording, without any of its endings."""
    return re.sub(r"(?<=.)\.[^.]*(\.(gz|bz2|xz))?$", "", path.name) or path.name


# -- rows ------------------------------------------------------------------------------

# Rows of a second source are this share of all, ...
_LEAST_SHARE, _MOST_SHARE = 0.02, 0.9
# ... come in this many places and in runs no longer than this in the median.
_PLACES, _RUN = 10, 3


def _without_odd_rows(table, layout, options, notes):
    """Leave out rows without numbers and of a second source; places of those left."""
    n, q, tau = table.n_rows, layout.roles("q"), layout.roles("tau")
    if options.drive is not None:
        table, tau = _with_commands_held(table, layout, options, notes), []
    others = [*layout.roles("v"), *layout.roles("a")]
    values, more = _matrix(table, [*q, *tau]), _matrix(table, others)
    keep = ~np.isnan(values).all(axis=1)
    if not keep.any():
        return table, None
    if not keep.all():
        notes.append(
            f"{(~keep).sum()} row(s) without any position or torque are left out."
        )
    holes = np.isnan(np.column_stack([values, more]))
    lacking = holes.any(axis=1) & keep
    if 0 < lacking.sum() <= _LACKING * keep.sum():
        row = int(np.argmax(lacking))
        column = [*q, *tau, *others][int(np.argmax(holes[row]))].column
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
    known = table.frame[[x.column for kind in kinds for x in layout.roles(kind)]]
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


# -- numbers and units -----------------------------------------------------------------


def _in_units(table, found, options, notes):
    """Return channels in the package's units, and the bases of the units they had."""
    for kind, measured in MEASURED.items():
        roles, of = found.get(kind, []), found.get(measured, [])
        if kind in options.recorded and len(roles) == len(of):
            # Commands without a unit have that of what they command.
            found[kind] = [
                role if role.unit else replace(role, unit=other.unit)
                for role, other in zip(roles, of)
            ]
    if len(found.get("supply", ())) == 1:
        # One for all joints.
        found["supply"] = found["supply"] * len(found["q"])
    channels, units = {}, {}
    for kind, roles in found.items():
        if roles:
            columns, units[kind] = zip(*(_values(table, kind, role) for role in roles))
            channels[kind] = np.column_stack(columns)
    if options.drive is not None:
        channels |= _constant_channels(table, options, channels, notes)
    return channels, units


def _values(table: Table, kind, role):
    """Return a column (n_rows,) in the package's units, and the base of its unit."""
    values, unit = _numbers(table, role.column), channel_unit(table, kind, role)
    if kind == "tau":
        _refuse_codes(table, role.column, values)
        if unit is None and is_current(role.column):
            unit = unit_of("tau", "A")
    if unit is not None:
        values = values * unit.factor
    far = np.flatnonzero(np.abs(values) > _LARGEST)
    if far.size:
        raise ValueError(
            f"{table.path}: {values[far[0]]:.3g} in {table.where(far[0])}, column "
            f"{role.column!r}, is beyond all robots; correct or remove that row."
        )
    return values, None if unit is None else unit.base


def _numbers(table: Table, column: str):
    """Return a column as finite floats; an error names the wrong cell."""
    values = table.values(column)
    if values.dtype.kind not in "biuf":
        raise ValueError(
            f"{table.path}: column {column!r} holds {quoted(str(values[0]))} and not "
            "numbers; correct or rename it."
        )
    with np.errstate(over="ignore"):
        values = values.astype(float)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise ValueError(
            f"{table.path}: {values[bad[0]]} or nothing in {table.where(bad[0])}, "
            f"column {column!r} ({bad.size} such cells in it); interpolate them or "
            "remove those rows."
        )
    return values


# Integers whose sign was lost: half of what a register holds, or the bit that is the
# sign, and whether it is two's complement. Values of either sign fill no more than the
# share of their range.
_CODES = [(2.0**bits, True) for bits in (7, 15, 31)]
_CODES += [(2.0**bit, False) for bit in (10, 11, 15)]
_FILLED = 0.45


def _refuse_codes(table: Table, column, values):
    if not values.size or values.min() < 0 or (values != np.round(values)).any():
        return
    for half, is_register in _CODES:
        high, low = values[values >= half], values[values < half]
        if not (high.size and low.size and high.max() < 2 * half):
            continue
        largest, jumps = max(low.max(), high.max() - half), 0 < low.max()
        remedy = f"replace those from {half:.0f} on by {half:.0f} - x"
        if is_register:
            # Values step from near zero to near the end of the register.
            largest = max(low.max(), 2 * half - high.min()) / 2
            jumps = (np.abs(np.diff(values)) > half).any()
            remedy = f"subtract {2 * half:.0f} from those above {half - 1:.0f}"
        if jumps and largest < _FILLED * half:
            raise ValueError(
                f"{table.path}: the values of column {column!r} lie from 0 to "
                f"{low.max():.0f} and from {high.min():.0f} to {high.max():.0f}: "
                f"integers whose sign was lost; {remedy}."
            )


def _constant_channels(table: Table, options, channels, notes):
    """Return gains without a column, and note what a drive lacks."""
    found, shape = {}, channels["q"].shape
    for kind in options.recorded:
        once = table.scalars.get(kind)
        if kind not in channels and once is not None and once.dtype.kind in "iuf":
            if once.shape not in {(), (1,), shape[1:]}:
                raise ValueError(
                    f"{table.path}: {kind} has the shape {once.shape}; expected one "
                    f"number for each of {shape[1]} joints, or one in every row."
                )
            found[kind] = np.broadcast_to(once.astype(float), shape).copy()
    rate = "v_desired" in options.recorded and "v_desired" not in channels
    if rate and not getattr(options.drive, "feedforward", False):
        notes.append(
            "no desired velocities (v_desired): taken as zero, so that kd damps all "
            "motion."
        )
    return found


def _check_joints(table: Table, found, robot):
    """Check the number of joints by the columns of each kind, return their names."""
    names, nv = robot.names, len(found["q"])
    for kind, roles in found.items():
        if len(roles) not in (0, nv, nv if kind != "supply" else 1):
            q, other = ([x.column for x in own] for own in (found["q"], roles))
            raise ValueError(
                f"{table.path}: {nv} column(s) q ({listed(q)}) and {len(roles)} "
                f"column(s) {kind} ({listed(other)}); every joint needs one of each."
            )
    if not names:
        return tuple(f"joint_{k + 1}" for k in range(nv))
    if len(names) != nv:
        fewer = nv < len(names) and not robot.chosen
        raise RecordingRefused(
            f"{table.path}: {nv} column(s) q for {len(names)} joint(s) "
            f"({listed(names)}); leave out surplus columns, or name the joints "
            "recorded, in the order of the columns, in joint_names (command line: "
            "--joints): the others are held at zero.",
            {"joint_names": names[:nv]} if fewer else {},
        )
    return names


def _check_units(table: Table, found, units, names, robot):
    """Return which joints slide, list of bool; refuse units that deny it."""
    slides = []
    for j, joint in enumerate(names):
        slide = units["q"][j] == "m"
        if robot.in_model:
            slide = bool(robot.slides[robot.in_model.index(joint)])
        elif units["q"][j] is None:
            slide = "tau" in units and units["tau"][j] == "N"
        slides.append(slide)
        for kind, roles in found.items():
            measured = MEASURED.get(kind, kind)
            bases = ("N m", "N") if measured == "tau" else ("rad", "m")
            if roles and measured in KINDS and units[kind][j] == bases[not slide]:
                order = {"v": "/s", "a": "/s^2"}.get(measured, "")
                raise ValueError(
                    f"{table.path}: column {roles[j].column!r} is in {roles[j].unit}, "
                    f"but {joint} {'slides' if slide else 'turns'}; expected "
                    f"{bases[slide]}{order}. Correct the unit, or the order of the "
                    "joints."
                )
    return slides


def _unwrap(channels, names, slides, labels, notes):
    """Continue angles that jump by a whole turn, and their commands, beyond it."""
    q, turn, found = channels["q"], 2 * np.pi, []
    parts = contiguous_groups(labels, len(q))
    for j in np.flatnonzero(~np.array(slides)):
        steps = [np.abs(np.diff(q[rows, j])) for rows in parts]
        jumps = [(x > _JUMP * turn).sum() for x in steps]
        wraps = [(np.abs(x - turn) < (1 - _WRAP) * turn).sum() for x in steps]
        if not sum(jumps) or jumps != wraps or np.ptp(q[:, j]) > 1.01 * turn:
            continue
        found.append(names[j])
        before = q[:, j].copy()
        for rows in parts:
            whole = np.unwrap(q[rows, j])
            q[rows, j] = whole - turn * np.round(whole.mean() / turn)
        if "q_desired" in channels:
            ahead = channels["q_desired"][:, j] - before
            channels["q_desired"][:, j] = q[:, j] + (ahead + np.pi) % turn - np.pi
    if found:
        notes.append(
            f"the angle(s) of {listed(found)} jump by whole turns: they are continued "
            "beyond them."
        )


def _check_gains(table: Table, gains, names):
    if len(gains) != len(names):
        raise RecordingRefused(
            f"{table.path}: {len(gains)} gain(s) for {len(names)} joint(s) "
            f"({listed(names)}); expected one for each, in this order, or unknown, to "
            "have them identified.",
            {"gains": gains * len(names) if len(gains) == 1 else "unknown"},
        )


def _segments(table: Table, layout):
    """Return segment labels or None, and the name of their column."""
    if not layout.segments:
        return None, ""
    first, *others = layout.segments
    for other in others:
        refuse_two(table, first, other)
    labels = table.values(first)
    return _numbers(table, first) if labels.dtype.kind == "f" else labels, first


def _signals(table: Table, taken, notes):
    """Return the other columns, and what is wrong with those that are not numbers."""
    signals, left_out = {}, {}
    for column in table.names:
        if column not in taken:
            numbers, reason = as_numbers(table.values(column), table.n_rows)
            if reason:
                left_out[column] = reason
            else:
                signals[column] = numbers
    if left_out:
        notes.append(
            f"column(s) {listed(left_out)} hold no finite numbers and are left out."
        )
    return signals, left_out


def _what_was_taken(table, layout, options, found, time):
    """Yield which columns were taken where their names do not tell it, in one line."""
    said, converted = [], set()
    for kind, roles in [*found.items(), ("t", [] if time is None else [time])]:
        converted |= {
            role.unit
            for role in roles
            if kind != "t" and role.unit and channel_unit(table, kind, role).factor != 1
        }
        names = ["+".join(role.columns) for role in roles]
        estimated = any(x.lower().startswith(ESTIMATES) for x in names)
        named = [x.lower().replace("τ", "tau").startswith(kind) for x in names]
        if options.mapping or (all(named) and not estimated):
            continue
        ends = names[0] if len(names) == 1 else f"{names[0]} ... {names[-1]}"
        is_said = not roles[0].unit or split_unit(names[0])[1]
        unit = "" if is_said else f" [{roles[0].unit}]"
        said.append(f"{kind} = {ends}{unit}{', a motor estimate' * estimated}")
    if layout.what:
        yield f"taken as {layout.what}: {', '.join(said)}."
    elif said or converted:
        said += [f"converted from {', '.join(sorted(converted))}"] * bool(converted)
        yield f"{'; '.join(said)}."


# -- time ------------------------------------------------------------------------------


def _time(table: Table, layout, options):
    """Return stamps [s] or None, and the role of their column."""
    times = layout.times
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
        dates = None if role.nanoseconds else _seconds_of_dates(table, role.column)
        if dates is not None:
            return dates, replace(role, unit="s")
        seconds = _numbers(table, role.column)
        unit = channel_unit(table, "t", role)
        factor = 1.0 if unit is None else unit.factor
        if options.time_unit is not None and not role.nanoseconds:
            factor = TIME_UNITS[options.time_unit]
        # Without a unit stamps stay as they are, for messages that quote them.
        t = seconds if factor == 1.0 else factor * (seconds - seconds[0])
        if role.nanoseconds:
            rest = _numbers(table, role.nanoseconds)
            t = seconds - seconds[0] + 1e-9 * (rest - rest[0])
        if np.ptp(t) > 0 or role is times[-1]:
            said = options.time_unit or role.unit or "s"
            _check_time_unit(table, role, usual_step(seconds), usual_step(t), said)
            return t, role
    return None, None


def _check_time_unit(table: Table, role, step, period, said):
    """Refuse a unit of time in which the period [s] is none of a robot that moves."""
    unit = unit_of_steps(step)
    # What goes up by one counts rows.
    if step in (0.0, 1.0) or is_of_a_robot(period) or unit in ("", said):
        return
    raise RecordingRefused(
        f"{table.path}: time steps by {period:.4g} s at the median, too "
        f"{'slow for a motion' if period > 1 else 'fast for a robot'}; column "
        f"{role.column!r} cannot be in {said}, in {unit} this would be a period of "
        f"{step * TIME_UNITS[unit]:.4g} s.",
        {"time_unit": unit},
    )


def _given_period(table: Table, dt):
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
