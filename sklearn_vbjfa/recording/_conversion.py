"""The table of a file as a recording, or the refusal that names the missing columns."""

import itertools
import re
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._clock import SAME_DT, time_of, without_odd_rows
from sklearn_vbjfa.recording._drives import PDDrive
from sklearn_vbjfa.recording._grid import FileRows
from sklearn_vbjfa.recording._layout import channel_unit, laid_out, matches, refuse_two
from sklearn_vbjfa.recording._recording import check_dt
from sklearn_vbjfa.recording._signals import as_numbers
from sklearn_vbjfa.recording._table import (
    KINDS,
    LAST_PART,
    MEASURED,
    Loss,
    RecordingRefused,
    channels_in,
    is_current,
    kinds_in,
    listed,
    split_unit,
    unit_of,
    unit_of_steps,
    usual_step,
)

_MOST_TRIED = 20
_WHAT = {"q": "positions", "tau": "torques", "q_desired": "desired positions"}


def _refusal(table, layout, options, robot, missing):
    """Return the refusal that lists everything that is missing."""
    near = {kind: _nearest(table, kind, robot.names) for kind in missing}
    parts = []
    if layout.joints and layout.joints != robot.names:
        joints = f"{listed(layout.joints)} are not those of the robot"
        parts.append(f"its joints {joints}, {listed(robot.names)}")
    for kind, names in near.items():
        what = f"no {_WHAT.get(kind, kind)}: expected columns {kind}1, {kind}2, ..."
        if kind == "t":
            what = "no time: expected a column t [s], or the period dt [s] (--dt 0.002)"
        parts.append(f"{what}{f' (nearest: {listed(names)})' if names else ''}")
    offered = _offered(table, options, near)
    if missing[0] == "tau" and not near["tau"]:
        parts.append(
            "if the motors follow commands, give the drive, drive=... (command line: "
            '--drive "pd kp=... kd=...")'
        )
        driven = laid_out(table, replace(options, drive=PDDrive(), gains=None), robot)
        if driven.kinds | {*table.scalars} >= {"q_desired", "kp", "kd"}:
            offered = {"drive": "pd"}
    parts.append(f"found {listed(table.frame)}")
    if not offered and missing != ["t"]:
        parts.append(
            "rename them in the header, or give "
            f'columns="q=NAME{{i}},{options.kinds[1]}=NAME{{i}},t=NAME"; files of one '
            "recording need join=True"
        )
    return RecordingRefused(f"{table.path}: {'; '.join(parts)}.", offered)


def _offered(table, options, near):
    """Return options that read the file, tried, by the nearest columns; or {}."""
    # near: the nearest patterns by kind; of several nobody knows which is meant.
    found = []
    for patterns in itertools.islice(itertools.product(*near.values()), _MOST_TRIED):
        mapping = options.mapping | dict(zip(near, patterns))
        columns = ",".join(f"{key}={x}" for key, x in mapping.items())
        found.append(_tried(table, options, columns))
    found = [offered for offered in found if offered]
    return found[0] if len(found) == 1 else {}


def _tried(table, options, columns, **more):
    """Return a mapping that reads a file, with other options that it needs; or {}."""
    try:
        rows = rows_of(table, replace(options, mapping=columns, preset=None, **more))
    except ValueError as error:
        offered = getattr(error, "options", {})
        unit = not more and {*offered} == {"time_unit"}
        return _tried(table, options, columns, **offered) if unit else {}
    if options.gains is options.drive is None:
        if not {*rows.robot["torque_units"]} <= {"N m", "N"}:
            more["gains"] = "unknown"
    return {"columns": columns, **more}


# -- the nearest names -----------------------------------------------------------------


def _nearest(table, kind, joints):
    """Return the patterns of columns nearest to a kind, those of all joints first."""
    if kind == "t":
        numbers = table.frame.select_dtypes("number")
        is_time = {x: unit_of("t", split_unit(x)[1] or x) for x in numbers}
        times = [x for x in numbers if is_time[x] or "t" in kinds_in(x)]
        steps = {x: usual_step(table.values(x)) for x in times}
        # A column that goes up by one counts rows.
        return [x for x in times if steps[x] != 1 and unit_of_steps(steps[x])]
    wanted = {"q_desired": {"q", "command"}}.get(kind, {kind})
    near = {}
    for pattern in dict.fromkeys(_patterns(table, joints)):
        roles = matches(pattern, table, kind)
        keys = {role.key for role in roles}
        keys = keys & {*joints} if "{joint}" in pattern else keys
        # Numbers count from 0 or 1 without a hole; one alone is that of the only joint.
        count = len(keys)
        fits = keys <= {*joints} or keys in ({*range(count)}, {*range(1, count + 1)})
        fits = fits and (count > 1 or len(joints) == 1 or "{i}" not in pattern)
        by_unit = {x for x in KINDS if all(unit_of(x, role.unit) for role in roles)}
        if fits and (channels_in(pattern) or by_unit) == wanted:
            last = LAST_PART.fullmatch(re.sub(r"[_ .]?\{\w+\}", "", pattern))
            known = is_current(pattern) or any(role.unit for role in roles)
            if last and unit_of(kind, last[2]) and not known:
                pattern += f" [{last[2]}]"
            # Of patterns of the same columns the first will do.
            columns = frozenset(role.column for role in roles)
            near.setdefault(columns, (pattern, count == (len(joints) or count)))
    found = list(near.values())
    return [x for x, whole in found if whole] or [x for x, _ in found]


def _patterns(table, joints):
    """Yield names of columns of numbers, with a mark for the joint or its number."""
    for column in table.frame.select_dtypes("number"):
        name = split_unit(column)[0]
        joint = max((x for x in joints if x in name), key=len, default="")
        if joint:
            yield name.replace(joint, "{joint}", 1)
        for match in re.finditer(r"\d{1,6}", name):
            yield f"{name[: match.start()]}{{i}}{name[match.end() :]}"
        if len(joints) == 1:
            # Of one joint nothing needs a number.
            yield name


# No robot has positions [rad or m], speeds or torques [N m or N] beyond this.
_LARGEST = 1e12


def is_recording(table, options):
    """Return whether a table has all channels, or would have with other options."""
    # Without time it is one, too, and refused for that.
    options, robot = replace(options, dt=1.0), options.robot(table)
    try:
        layout = laid_out(table, options, robot)
    except RecordingRefused:
        return False
    missing = [kind for kind in options.kinds[:2] if kind not in layout.kinds]
    return not missing or _refusal(table, layout, options, robot, missing).options != {}


def _in_order(table, layout, options, robot, notes):
    """Return the roles of each kind in the order of the joints, and their names."""
    # Certain names of joints that the robot lacks are no channels of it.
    names, by_key = robot.names or layout.joints, {}
    for role in layout.of(*options.kinds):
        if isinstance(role.key, int) or role.key in names:
            other = by_key.setdefault(role.kind, {}).setdefault(role.key, role)
            refuse_two(table, other.column, role.column)
    missing = [kind for kind in options.kinds[:2] if kind not in by_key]
    missing += [] if options.dt or layout.of("t") else ["t"]
    if missing:
        raise _refusal(table, layout, options, robot, missing)
    having = {key for own in by_key.values() for key in own if isinstance(key, str)}
    others = [x for x in layout.joints if having and x not in names]
    if others:
        notes.append(
            f"joint(s) {listed(others)} are not joints of the robot and are left out."
        )
    held = [x for x in names if having and x not in having]
    if held and not robot.chosen:
        where = "held at zero; if they stand elsewhere, lock them there in the model"
        notes.append(Loss(f"no columns of joint(s) {listed(held)}: {where}."))
        names = tuple(x for x in names if x in having)
    found, count = {}, max(map(len, by_key.values()))
    for kind in filter(by_key.get, options.kinds):
        own = by_key[kind]
        named, first = any(isinstance(key, str) for key in own), 0 if 0 in own else 1
        keys = names if named else range(first, first + count)
        if kind == "supply" and len(own) == 1:
            # One for all joints.
            keys = count * [*own]
        for key in keys:
            if key not in own:
                raise ValueError(
                    f"{table.path}: column '{kind}{'_' * named}{key}' is missing "
                    f"beside {listed([role.column for role in own.values()])}; every "
                    "joint needs one, in order."
                )
        found[kind] = [own[key] for key in keys]
    names = names or tuple(f"joint_{k + 1}" for k in range(count))
    if len(names) != count:
        fewer = count < len(names) and not robot.chosen
        raise RecordingRefused(
            f"{table.path}: {count} column(s) q for {len(names)} joint(s) "
            f"({listed(names)}); leave out surplus columns, or name the joints "
            "recorded, in the order of the columns, in joint_names (command line: "
            "--joints): the others are held at zero.",
            {"joint_names": names[:count]} if fewer else {},
        )
    return found, names


def rows_of(table, options) -> FileRows:
    """Return the rows of a table, complete, and notes on how they were read."""
    notes = list(table.notes)
    robot = options.robot(table)
    entry = table.scalars.get("dt")
    if entry is not None and entry.size == 1:
        dt = check_dt(entry.item())
        if options.dt is not None and abs(dt - options.dt) > SAME_DT * dt:
            raise ValueError(
                f"{table.path}: its dt is {dt} s but dt = {options.dt} s; correct one "
                "of them."
            )
        options = replace(options, dt=options.dt or dt)
    layout = laid_out(table, options, robot)
    table, rows = without_odd_rows(table, layout, options, notes)
    found, names = _in_order(table, layout, options, robot, notes)
    channels, units = _in_units(table, found, options, notes)
    slides = _check_units(table, found, units, names, robot)
    of_joints = ["N" if slide else "N m" for slide in slides]
    torque_units = [x or y for x, y in zip(units.get("tau", of_joints), of_joints)]
    gains, n = options.gains, len(names)
    if isinstance(gains, tuple):
        gains = gains * n if len(gains) == 1 else gains
        if len(gains) != n:
            raise RecordingRefused(
                f"{table.path}: {len(gains)} gain(s) for {n} joint(s) "
                f"({listed(names)}); expected one for each, in this order, or unknown, "
                "to have them identified.",
                {"gains": "unknown"},
            )
        torque_units = of_joints
        channels["tau"] = channels["tau"] * np.array(gains)
    # Of a drive the torques are made when all files are read.
    channels.setdefault("tau", np.zeros(channels["q"].shape))
    if robot.in_model:
        # The order of the model, whatever that of the file.
        order = sorted(range(len(names)), key=lambda j: robot.in_model.index(names[j]))
        names, slides, torque_units = (
            [x[j] for j in order] for x in (names, slides, torque_units)
        )
        channels = {kind: values[:, order] for kind, values in channels.items()}
    t, time = time_of(table, layout, options, channels["q"])
    labels = _labels(table, layout)
    signals = _signals(table, layout, time, notes)
    motor = [unit for unit in torque_units if unit not in ("N m", "N")]
    if motor and options.gains is None and options.drive is None:
        notes.append(
            f"the torques are recorded in {motor[0]}: give the gains, factors to N m, "
            "or identify them (gains='unknown'; command line: --gain unknown)."
        )
    if t is None and options.dt:
        # Without stamps the places of the rows that are left are their times.
        t = options.dt * rows
    taken = _columns_taken(table, layout, options, found, time)
    # What was read is held no longer than needed.
    table = replace(table, frame=table.frame.iloc[:, :0])
    return FileRows(
        path=table.path,
        # Without any of its endings.
        name=table.name
        or re.sub(r"(?<=.)\.[^.]*(\.(gz|bz2|xz))?$", "", table.path.name)
        or table.path.name,
        where=table.where,
        t=t,
        dt=options.dt,
        labels=labels,
        channels=channels | signals,
        robot={
            "joint_names": tuple(names),
            "position_units": tuple("m" if slide else "rad" for slide in slides),
            "torque_units": tuple(torque_units),
            "joints_named": robot.chosen
            or all(isinstance(role.key, str) for role in layout.of("q")),
        },
        notes=[*taken, *notes],
    )


# -- numbers and units -----------------------------------------------------------------


def _in_units(table, found, options, notes):
    """Return channels in the package's units, and the bases of the units they had."""
    for kind, measured in MEASURED.items():
        roles, of = found.get(kind, []), found.get(measured, [])
        if roles and kind in options.recorded and len(roles) == len(of):
            # Commands without a unit have that of what they command.
            found[kind] = [
                role if role.unit else replace(role, unit=other.unit)
                for role, other in zip(roles, of)
            ]
    channels, units = {}, {}
    for kind, roles in found.items():
        columns, units[kind] = zip(*(_values(table, role) for role in roles))
        channels[kind] = np.column_stack(columns)
    for kind in options.recorded if options.drive is not None else ():
        once = table.scalars.get(kind)
        if kind not in channels and once is not None and once.dtype.kind in "iuf":
            shape = channels["q"].shape
            if once.shape not in {(), (1,), shape[1:]}:
                raise ValueError(
                    f"{table.path}: {kind} has the shape {once.shape}; expected one "
                    f"number for each of {shape[1]} joints, or one in every row."
                )
            channels[kind] = np.broadcast_to(once.astype(float), shape).copy()
    if "v_desired" in options.recorded and "v_desired" not in channels:
        notes.append(
            "no desired velocities (v_desired): taken as zero, so that kd damps all "
            "motion."
        )
    return channels, units


def _values(table, role):
    """Return a column (n_rows,) in the package's units, and the base of its unit."""
    values, unit = table.numbers(role.column), channel_unit(table, role)
    if role.kind == "tau":
        _refuse_codes(table, role.column, values)
        if unit is None and is_current(role.column):
            unit = unit_of("tau", "A")
    if unit is not None:
        values = values * unit.factor
    far = np.flatnonzero(np.abs(values) > _LARGEST)
    if far.size:
        raise ValueError(
            f"{table.path}: {values[far[0]]:.3g} in {table.where(far[0])}, column "
            f"{role.column!r}, is implausible; correct or remove that row."
        )
    return values, None if unit is None else unit.base


# Sizes of registers, and of those with a bit for the sign. With their signs, values
# step by less than this share of the largest step without.
_BITS, _WITH_BIT, _SMOOTHER = range(8, 33), (11, 12, 16), 0.45


def _refuse_codes(table, column, values):
    """Refuse integers whose sign was lost, in a unit that all are multiples of."""
    levels = np.unique(values)
    if levels.size < 2 or levels[0] < 0:
        return
    unit = 1.0 if (levels == np.round(levels)).all() else np.diff(levels).min()
    with np.errstate(over="ignore"):
        codes = values / unit
    bits = int(np.frexp(codes.max())[1])
    if bits not in _BITS or np.abs(codes - np.round(codes)).max() > 0.1:
        return
    half = 2.0 ** (bits - 1)
    remedy = f"subtract {2 * half * unit:.10g} from those from {half * unit:.10g} on"
    signed = {remedy: np.where(codes < half, codes, codes - 2 * half)}
    if bits in _WITH_BIT and unit == 1:
        remedy = f"replace those from {half:.0f} on by {half:.0f} - x"
        signed[remedy] = np.where(codes < half, codes, half - codes)
    most = np.abs(np.diff(codes)).max()
    for remedy, x in signed.items():
        if x.min() < 0 < x.max() and np.abs(np.diff(x)).max() < _SMOOTHER * most:
            raise ValueError(
                f"{table.path}: the values of column {column!r} are integers whose "
                f"sign was lost; {remedy}."
            )


# -- joints ----------------------------------------------------------------------------


def _check_units(table, found, units, names, robot):
    """Return which joints slide, list of bool; refuse units that deny it."""
    slides = []
    for j, joint in enumerate(names):
        slide = units["q"][j] == "m"
        if robot.in_model:
            slide = bool(robot.slides[robot.in_model.index(joint)])
        elif units["q"][j] is None:
            slide = "tau" in units and units["tau"][j] == "N"
        slides.append(slide)
        for kind, bases in (("q", ("rad", "m")), ("tau", ("N m", "N"))):
            if kind in units and units[kind][j] == bases[not slide]:
                role = found[kind][j]
                raise ValueError(
                    f"{table.path}: column {role.column!r} is in {role.unit}, but "
                    f"{joint} {'slides' if slide else 'turns'}; expected "
                    f"{bases[slide]}. Correct the unit, or the order of the joints."
                )
    return slides


# -- other columns ---------------------------------------------------------------------


def _labels(table, layout):
    columns = [role.column for role in layout.of("segment")]
    if not columns:
        return None
    for other in columns[1:]:
        refuse_two(table, columns[0], other)
    labels = table.values(columns[0])
    return table.numbers(columns[0]) if labels.dtype.kind == "f" else labels


def _signals(table, layout, time, notes):
    """Return the other columns that are finite numbers."""
    # Of a known log all times are known.
    roles = [x for x in layout.roles if x.kind != "t" or layout.what or x is time]
    taken = {role.column for role in roles} | layout.no_signals
    others = [x for x in table.frame if x not in taken]
    read = {x: as_numbers(table.values(x), len(table.frame))[0] for x in others}
    left = [x for x, values in read.items() if values is None]
    if left:
        notes.append(
            f"column(s) {listed(left)} hold no finite numbers and are left out."
        )
    return {x: values for x, values in read.items() if values is not None}


def _columns_taken(table, layout, options, found, time):
    """Return which columns were taken where their names do not show it, in one line."""
    parts, units = [], [x for roles in found.values() for x in roles if x.unit]
    for kind, roles in [*found.items(), ("t", [] if time is None else [time])]:
        names = [role.column for role in roles]
        named = all(x.lower().replace("τ", "tau").startswith(kind) for x in names)
        if not (options.mapping or named):
            ends = [names[0], names[-1]] if len(names) > 1 else names
            parts.append(f"{kind} = {' ... '.join(ends)}")
    converted = {x.unit for x in units if channel_unit(table, x).factor != 1}
    if converted:
        parts.append(f"converted from {', '.join(sorted(converted))}")
    if layout.what:
        return [f"taken as {layout.what}: {', '.join(parts)}."]
    return [f"{'; '.join(parts)}."] if parts else []
