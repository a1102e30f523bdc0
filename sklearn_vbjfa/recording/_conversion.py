"""The table of a file as a recording: order, units, signs of time, one time grid."""

from dataclasses import replace
from os import fspath

import numpy as np

from sklearn_vbjfa.recording._columns import as_numbers
from sklearn_vbjfa.recording._layout import (
    ESTIMATES,
    channel_unit,
    name_and_unit,
    seconds_of_dates,
)
from sklearn_vbjfa.recording._names import (
    Joints,
    ReadOptions,
    channels_of,
    checked_names,
    is_current,
    laid_out,
    names_and_slides,
    refuse_two,
    unit_is_wrong,
    unit_of_steps,
    usual_step,
)
from sklearn_vbjfa.recording._presets import currents_as_efforts
from sklearn_vbjfa.recording._recording import Recording
from sklearn_vbjfa.recording._rows import (
    refuse_codes,
    with_commands_held,
    without_blank_rows,
    without_second_source,
)
from sklearn_vbjfa.recording._sampling import (
    SAME_DT,
    check_given,
    in_order,
    on_grid,
)
from sklearn_vbjfa.recording._several import ReadFile
from sklearn_vbjfa.recording._table import RecordingRefused, Table, listed, quoted
from sklearn_vbjfa.recording._units import (
    MEASURED,
    TIME_UNITS,
    TURNS,
    split_unit,
    unit_of,
)

# No robot has positions [rad or m], speeds or torques [N m or N] beyond this.
_LARGEST = 1e12
# Units of torque; a motor is recorded in others.
_TORQUES = ("N m", "N")


def _of_robot(table, options):
    """Return joints in the order of the columns, those of the model, and slides."""
    names, model = options.names, options.model
    if options.joint_names is None and "joint_names" in table.scalars:
        own = np.atleast_1d(table.scalars["joint_names"])
        names = checked_names([str(x) for x in own])
        model = names_and_slides(options.urdf, names)
    model_names, prismatic = model
    # Columns with numbers are in the order of the file, which may name what a joint
    # carries before the joint.
    in_file = tuple(name for name in options.movable if name in model_names)
    return Joints(names=names or in_file, chosen=bool(names)), model_names, prismatic


def is_recording(table: Table, options: ReadOptions):
    """Whether a table has all channels, or would have with other options."""
    try:
        robot, _, _ = _of_robot(table, options)
        layout = laid_out(table, options, robot)
        # Without time it is one, too, and refused for that.
        channels_of(table, layout, replace(options, dt=1.0), robot, [])
    except RecordingRefused as error:
        return bool(error.options)
    except ValueError:
        return False
    return True


def recording_of(table: Table, options: ReadOptions) -> ReadFile:
    """Return the recording in a table, complete, and what a user should know of it."""
    notes = list(table.notes)
    robot, model_names, prismatic = _of_robot(table, options)
    dt = _given_period(table, options.dt)
    options = replace(options, dt=dt)
    layout = laid_out(table, options, robot)
    table = _without_odd_rows(table, layout, options, notes)
    found, robot = channels_of(table, layout, options, robot, notes)
    names = _check_joints(table, found, robot)
    channels, units = _in_units(table, layout, found, options, notes)
    slides = _check_units(table, found, units, names, model_names, prismatic)
    own_units = ["N" if slide else "N m" for slide in slides]
    recorded = [x or y for x, y in zip(units.get("tau", own_units), own_units)]
    torque_units = recorded
    if isinstance(options.gains, tuple):
        torque_units = own_units
        channels["tau"] = channels["tau"] * _factors(table, options.gains, names)
    # Of a drive the torques are made when all files are read.
    channels.setdefault("tau", np.zeros(channels["q"].shape))
    if model_names:
        # The order of the model, whatever that of the file.
        order = sorted(range(len(names)), key=lambda j: model_names.index(names[j]))
        names, slides, torque_units, recorded = (
            [x[j] for j in order] for x in (names, slides, torque_units, recorded)
        )
        channels = {kind: values[:, order] for kind, values in channels.items()}
    t, time = _time(table, layout, options)
    labels, segment = _segments(table, layout)
    taken = {role.column for own in layout.channels.values() for role in own.roles}
    taken |= {segment, *(() if time is None else time.columns), *layout.no_signals}
    taken |= {x for role in layout.times if layout.what for x in role.columns}
    signals, left_out = _signals(table, taken, notes)
    said = _what_was_taken(table, layout, options, found, time, torque_units)
    notes = [*said, *notes, *_unit_notes(table, layout, options, names, torque_units)]
    channels |= signals
    # What was read is held no longer than needed.
    table = replace(table, frame=table.frame.iloc[:, :0])
    if t is not None and labels is None:
        t, channels, table = in_order(table, t, channels, notes)
    fields = on_grid(table, t, labels, dt, channels, notes)
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
    return ReadFile(
        path=table.path,
        recording=recording,
        notes=tuple(notes),
        stamped=t is not None,
        torque_units=tuple(recorded),
    )


def _stem(path):
    """Return the name of a recording, without any of its endings."""
    stem = path.stem
    return (
        stem.rpartition(".")[0] or stem
        if path.suffix in (".gz", ".bz2", ".xz")
        else stem
    )


def _without_odd_rows(table, layout, options, notes):
    """Hold commands, leave out blank rows and those of a second source."""
    roles = {kind: own.roles for kind, own in layout.channels.items()}
    q, tau = roles.get("q", []), roles.get("tau", [])
    if options.drive is None:
        table = without_blank_rows(table, [*q, *tau], notes)
        return without_second_source(table, q, tau, notes)
    commands = [
        x for kind in options.recorded if kind != "tau" for x in roles.get(kind, [])
    ]
    table = with_commands_held(table, commands, notes)
    return without_blank_rows(table, q, notes)


def _in_units(table, layout, found, options, notes):
    """Return channels in the package's units, and the bases of the units they had."""
    for kind, measured in MEASURED.items():
        own, of = found.get(kind, []), found.get(measured, [])
        if kind in options.recorded and len(own) == len(of):
            # Commands without a unit have that of what they command.
            found[kind] = [
                role if role.unit else replace(role, unit=other.unit)
                for role, other in zip(own, of)
            ]
    channels, units = {}, {}
    for kind, roles in found.items():
        if kind == "supply" and len(roles) == 1:
            # One for all joints.
            roles = found[kind] = roles * len(found["q"])
        if roles:
            channels[kind], units[kind] = _values(table, kind, roles)
    if options.drive is not None:
        most = float(np.abs(channels["q"]).max())
        if layout.question and most > TURNS and not any(units["q"]):
            raise RecordingRefused(
                f"{table.path}: positions go up to {most:.4g}, which are not radians: "
                f"{layout.question}",
                {"columns": layout.answer},
            )
        channels |= _constant_channels(table, options, channels, notes)
    return channels, units


def _unit_notes(table, layout, options, names, torque_units):
    """Yield what a user should know of the unit of the torques."""
    if options.gains is not None or options.drive is not None:
        return
    is_effort = bool(table.joints) or layout.what.startswith("/joint_states")
    maker = currents_as_efforts(names) if is_effort else ""
    if maker:
        yield (
            f"efforts are taken as N m; many drivers of {maker} publish motor currents "
            "[A] under this name: if this one did, give gains (command line: --gain "
            "unknown, or the factors)."
        )
    motor = [unit for unit in torque_units if unit not in _TORQUES]
    if motor:
        yield (
            f"the torques are recorded in {motor[0]}: give the gains, factors to N m, "
            "or identify them (gains='unknown'; command line: --gain unknown)."
        )


def _values(table: Table, kind, roles):
    """Return the columns of one kind (n_rows, nv) in the package's units, and these."""
    # The second is the base of the unit of each column, None where nothing tells.
    columns, bases = [], []
    for role in roles:
        unit = channel_unit(table, kind, role)
        if unit is None and kind == "tau" and is_current(role.column):
            unit = unit_of("tau", "A")
        values = _numbers(table, role.column)
        if kind == "tau":
            refuse_codes(table, role.column, values)
        if unit is not None:
            values = values * unit.factor
        far = np.flatnonzero(np.abs(values) > _LARGEST)
        if far.size:
            raise ValueError(
                f"{table.path}: {values[far[0]]:.3g} in {table.where(far[0])}, column "
                f"{role.column!r}, is beyond all robots; correct or remove that row."
            )
        columns.append(values)
        bases.append(None if unit is None else unit.base)
    return np.column_stack(columns), bases


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
        remedy = (
            "leave out surplus columns, or name one joint per column in joint_names"
            if nv > len(names)
            else "name those recorded, in the order of the columns, in joint_names "
            f"(command line: --joints {','.join(names[: min(nv, 8)])}), the others are "
            "then held at zero"
        )
        fewer = nv < len(names) and not robot.chosen
        raise RecordingRefused(
            f"{table.path}: {nv} column(s) q for {len(names)} joint(s) "
            f"({listed(names)}); {remedy}.",
            {"joint_names": names[:nv]} if fewer else {},
        )
    return names


def _check_units(table: Table, found, units, names, model_names, prismatic):
    """Return which joints slide, list of bool; refuse units that deny it."""
    slides = []
    for j, joint in enumerate(names):
        slide = units["q"][j] == "m"
        if model_names:
            slide = bool(prismatic[model_names.index(joint)])
        elif units["q"][j] is None:
            slide = "tau" in units and units["tau"][j] == "N"
        slides.append(slide)
        for kind, roles in found.items():
            measured = MEASURED.get(kind, kind)
            wrong = {"tau": ("N", "N m")}.get(measured, ("m", "rad"))[slide]
            if roles and measured in _EXPECTED and units[kind][j] == wrong:
                raise ValueError(
                    f"{table.path}: column {roles[j].column!r} is in {roles[j].unit}, "
                    f"but {joint} {'slides' if slide else 'turns'}; expected "
                    f"{_EXPECTED[measured][slide]}. Correct the unit, or the order of "
                    "the joints."
                )
    return slides


_EXPECTED = {
    "q": ("rad or deg", "m or mm"),
    "v": ("rad/s or deg/s", "m/s or mm/s"),
    "a": ("rad/s^2 or deg/s^2", "m/s^2 or mm/s^2"),
    "tau": ("N m", "N"),
}


def _factors(table: Table, gains, names):
    """Return the gains, one for each joint."""
    if len(gains) == len(names):
        return np.array(gains)
    same = len(gains) == 1
    raise RecordingRefused(
        f"{table.path}: {len(gains)} gain(s) for {len(names)} joint(s) "
        f"({listed(names)}); expected one for each, in this order"
        f"{'' if same else ', or unknown, to have them identified'}.",
        {"gains": gains * len(names) if same else "unknown"},
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


def _what_was_taken(table, layout, options, found, time, torque_units):
    """Yield which columns were taken where their names do not tell it, in one line."""

    def columns(kind, unit=""):
        first, last = found[kind][0].column, found[kind][-1].column
        ends = first if first == last else f"{first} ... {last}"
        return f"{kind} = {_with_unit(ends, unit)}"

    stamps = []
    if time is not None:
        unit = options.time_unit or time.unit or "s"
        stamps.append(f"t = {_with_unit('+'.join(time.columns), unit)}")
    if layout.what:
        units = {"tau": torque_units[0]} if len(set(torque_units)) == 1 else {}
        kinds = [kind for kind in ("q", *options.recorded) if found[kind]]
        said = [columns(x, found[x][0].unit or units.get(x, "")) for x in kinds]
        yield f"taken as {layout.what}: {', '.join([*said, *stamps])}."
        return
    said = []
    if not options.mapping:
        said += stamps if time is not None and time.column not in ("t", "T") else []
        first = {kind: x[0].column.lower() for kind, x in found.items() if x}
        if options.drive is not None:
            kinds = [kind for kind in (*options.recorded, "v") if kind in first]
            said += [columns(x) for x in kinds if not first[x].startswith(x)]
        elif first["tau"].startswith(ESTIMATES):
            said.append(f"{columns('tau')}, which the motors estimate")
    converted = {
        role.unit
        for kind, roles in found.items()
        for role in roles
        if role.unit and channel_unit(table, kind, role).factor != 1
    }
    if converted:
        said.append(f"converted from {', '.join(sorted(converted))}")
    if said:
        yield f"{'; '.join(said)}."


def _with_unit(columns, unit):
    """Return columns with the unit, unless their names end with it."""
    if not unit or split_unit(columns)[1] == unit:
        return columns
    return f"{columns} [{unit}]"


# -- time ------------------------------------------------------------------------------


def _time(table: Table, layout, options):
    """Return stamps [s] or None, and the role of their column."""
    times = layout.times
    own = [x for x in times if name_and_unit(table, x.column)[0].lower() == "t"]
    if options.dt is not None and not (layout.certain or own):
        # What else is called time may be anything; the period is given.
        return None, None
    if len(times) > 1 and not layout.what:
        if own:
            refuse_two(table, times[0].column, times[1].column)
        raise RecordingRefused(
            f"{table.path}: columns {listed([x.column for x in times])} could all be "
            f"time; give columns='t={times[0].column}', or another of them.",
            {"columns": f"t={times[0].column}"},
        )
    for role in times:
        dates = None if role.nanoseconds else seconds_of_dates(table, role.column)
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
            _check_unit(table, role, seconds, usual_step(t), options.time_unit)
            return t, role
    return None, None


def _check_unit(table: Table, role, values, period, time_unit):
    """Refuse a unit of time in which the period [s] is none of a robot that moves."""
    step = usual_step(values)
    # What goes up by one counts rows.
    if step in (0.0, 1.0) or not unit_is_wrong(period):
        return
    unit = unit_of_steps(step)
    said = time_unit or role.unit or "s"
    if not unit or unit == said:
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
    if entry is None:
        return dt
    own = entry.item() if entry.size == 1 and entry.dtype.kind in "iuf" else None
    if own is None or not 0 < own < np.inf:
        if dt is not None:
            return dt
        raise ValueError(
            f"{table.path}: dt must be a positive number of seconds, got {entry}; "
            "correct it in the file."
        )
    try:
        check_given(own, dt, "its dt is", SAME_DT)
    except ValueError as error:
        raise ValueError(f"{table.path}: {error}") from None
    return float(own) if dt is None else dt
