"""Conversion of a table to rows of a recording, or an error that suggests options."""

import re
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._clock import SAME_DT, read_time, remove_odd_rows
from sklearn_vbjfa.recording._drives import PDDrive
from sklearn_vbjfa.recording._grid import RATE_RATIO, FileRows, merge_sources
from sklearn_vbjfa.recording._layout import (
    channel_unit,
    find_layout,
    match_pattern,
    refuse_ambiguous,
)
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

_CHANNELS = {"q": "positions", "tau": "torques", "q_desired": "desired positions"}


def _refusal(table, layout, options, robot, missing):
    """Return the error that lists all missing channels and suggests options."""
    _refuse_rows_by_joint(table, layout)
    candidates = {kind: _near_patterns(table, kind, robot.names) for kind in missing}
    parts = []
    if layout.joints and layout.joints != robot.names:
        joints = f"{listed(layout.joints)} are not those of the robot"
        parts.append(f"its joints {joints}, {listed(robot.names)}")
    for kind, names in candidates.items():
        text = f"no {_CHANNELS.get(kind, kind)}: expected columns {kind}1, {kind}2, ..."
        if kind == "t":
            text = "no time: expected a column t [s], or the period dt [s] (--dt 0.002)"
        parts.append(f"{text}{f' (nearest: {listed(names)})' if names else ''}")
    suggested = _suggestion(table, options, candidates)
    if missing[0] == "tau" and not candidates["tau"]:
        parts.append(
            "if the motors follow commands, give the drive, drive=... (command line: "
            '--drive "pd kp=... kd=...")'
        )
        trial = find_layout(table, replace(options, drive=PDDrive(), gains=None), robot)
        if trial.kinds | {*table.scalars} >= {"q_desired", "kp", "kd"}:
            suggested = {"drive": "pd"}
    parts.append(f"found {listed(table.frame)}")
    if not suggested and missing != ["t"]:
        parts.append(
            "rename them in the header, or give "
            f'columns="q=NAME{{i}},{options.kinds[1]}=NAME{{i}},t=NAME"; files of one '
            "recording need join=True"
        )
    return RecordingRefused(f"{table.path}: {'; '.join(parts)}.", suggested)


def _refuse_rows_by_joint(table, layout):
    """Refuse tables whose rows name their joint in a column, in turn."""
    # Such tables have one column of positions and one of torques.
    if len(layout.select("q")) > 1 or len(layout.select("tau")) > 1:
        return
    for name in table.frame:
        values = table.values(name)
        n = len(set(values))
        # Joints are numbered in steps of one, but fractions of a second are not.
        numbered = values.dtype.kind not in "iuf" or np.ptp(values) == n - 1
        if not numbered or not 1 < n < min(len(values) / 2, _MOST_JOINTS):
            continue
        if (values[n:] == values[:-n]).all():
            raise RecordingRefused(
                f"{table.path}: each row is of one joint (column {name!r}): write one "
                "row per sample, with the columns q1, ..., tau1, ... instead."
            )


def _suggestion(table, options, near):
    """Return options with which the file can be read, by the nearest columns, or {}."""
    # near: nearest patterns by kind; the choice must be unique.
    if any(len(patterns) != 1 for patterns in near.values()):
        return {}
    mapping = options.columns | {kind: pattern for kind, (pattern,) in near.items()}
    columns = ",".join(f"{key}={pattern}" for key, pattern in mapping.items())
    return _try_columns(table, options, columns)


def _try_columns(table, options, columns, **more):
    """Return a column mapping and further options that read a table, or {}."""
    try:
        rows = read_rows(table, replace(options, columns=columns, preset=None, **more))
    except ValueError as error:
        suggested = getattr(error, "options", {})
        unit = not more and {*suggested} == {"time_unit"}
        return _try_columns(table, options, columns, **suggested) if unit else {}
    if options.gains is options.drive is None:
        if not {*rows.robot["torque_units"]} <= {"N m", "N"}:
            more["gains"] = "unknown"
    return {"columns": columns, **more}


def _near_patterns(table, kind, joints):
    """Return patterns of columns that may be a channel, complete ones if there are."""
    if kind == "t":
        numbers = table.frame.select_dtypes("number")
        is_time = {x: unit_of("t", split_unit(x)[1] or x) for x in numbers}
        times = [x for x in numbers if is_time[x] or "t" in kinds_in(x)]
        steps = {x: usual_step(table.values(x)) for x in times}
        # A column that increases by one counts rows.
        return [x for x in times if steps[x] != 1 and unit_of_steps(steps[x])]
    wanted = {"q_desired": {"q", "command"}}.get(kind, {kind})
    near = {}
    for pattern in dict.fromkeys(_patterns(table, joints)):
        roles = match_pattern(pattern, table, kind)
        keys = {role.key for role in roles}
        keys = keys & {*joints} if "{joint}" in pattern else keys
        # Numbers must be consecutive from 0 or 1; a single one requires a single joint.
        count = len(keys)
        fits = keys <= {*joints} or keys in ({*range(count)}, {*range(1, count + 1)})
        fits = fits and (count > 1 or len(joints) == 1 or "{i}" not in pattern)
        by_unit = {x for x in KINDS if all(unit_of(x, role.unit) for role in roles)}
        if fits and (channels_in(pattern) or by_unit) == wanted:
            last = LAST_PART.fullmatch(re.sub(r"[_ .]?\{\w+\}", "", pattern))
            has_unit = is_current(pattern) or any(role.unit for role in roles)
            if last and unit_of(kind, last[2]) and not has_unit:
                pattern += f" [{last[2]}]"
            # Keep the first of several patterns that match the same columns.
            columns = frozenset(role.column for role in roles)
            near.setdefault(columns, (pattern, count == (len(joints) or count)))
    matches = list(near.values())
    return [x for x, complete in matches if complete] or [x for x, _ in matches]


def _patterns(table, joints):
    """Yield numeric columns' names with a placeholder for the joint or its number."""
    for column in table.frame.select_dtypes("number"):
        name = split_unit(column)[0]
        joint = max((x for x in joints if x in name), key=len, default="")
        if joint:
            yield name.replace(joint, "{joint}", 1)
        for match in re.finditer(r"\d{1,6}", name):
            yield f"{name[: match.start()]}{{i}}{name[match.end() :]}"
        if len(joints) == 1:
            # The column of a single joint needs no number.
            yield name


# Maximum number of joints of a robot.
_MOST_JOINTS = 100
# Largest plausible position [rad or m], velocity or torque [N m or N].
_LARGEST = 1e12


def is_recording(table, options):
    """Return whether a table has all channels, possibly with other options."""
    # A missing time is ignored here: reading the rows raises an error for it.
    options, robot = replace(options, dt=1.0), options.robot(table)
    try:
        layout = find_layout(table, options, robot)
    except RecordingRefused:
        return False
    missing = [kind for kind in options.kinds[:2] if kind not in layout.kinds]
    return not missing or _refusal(table, layout, options, robot, missing).options != {}


def _sort_roles(table, layout, used, options, robot, notes):
    """Return the roles of each kind in the order of joints, and the joint names."""
    # used: the layout without joints that are left out.
    names, by_key = robot.names or used.joints, {}
    for role in used.select(*options.kinds):
        other = by_key.setdefault(role.kind, {}).setdefault(role.key, role)
        refuse_ambiguous(table, other.column, role.column)
    missing = [kind for kind in options.kinds[:2] if kind not in by_key]
    missing += [] if options.dt or layout.select("t") else ["t"]
    if missing:
        raise _refusal(table, layout, options, robot, missing)
    recorded = {x for roles in by_key.values() for x in roles if isinstance(x, str)}
    others = [x for x in layout.joints if robot.names and x not in names]
    if others:
        notes.append(
            f"joint(s) {listed(others)} are not joints of the robot and are left out."
        )
    fixed = [x for x in names if recorded and x not in recorded]
    if fixed and not robot.explicit:
        where = "held at zero; if they stand elsewhere, lock them there in the model"
        texts = {x: x.lower() for x in table.frame if not any(j in x for j in fixed)}
        other = [x for x in texts if any(j.lower() in texts[x] for j in fixed)]
        hint = f" (upper and lower case differ in {listed(other)})" if other else ""
        notes.append(Loss(f"no columns of joint(s) {listed(fixed)}{hint}: {where}."))
        names = tuple(x for x in names if x in recorded)
    ordered, count = {}, max(map(len, by_key.values()))
    for kind in filter(by_key.get, options.kinds):
        roles = by_key[kind]
        named, first = any(isinstance(x, str) for x in roles), 0 if 0 in roles else 1
        keys = names if named else range(first, first + count)
        if kind == "supply" and len(roles) == 1:
            # One supply voltage feeds all joints.
            keys = count * [*roles]
        if kind in ("v", "a") and not {*keys} <= {*roles}:
            notes.append(f"column(s) {kind} of some joints only are left out.")
            continue
        for key in keys:
            if key not in roles:
                raise ValueError(
                    f"{table.path}: column '{kind}{'_' * named}{key}' is missing "
                    f"beside {listed([role.column for role in roles.values()])}; every "
                    "joint needs one, in order."
                )
        ordered[kind] = [roles[key] for key in keys]
    names = names or tuple(f"joint_{k + 1}" for k in range(count))
    if len(names) != count:
        _refuse_rows_by_joint(table, layout)
        fewer = count < len(names) and not robot.explicit
        raise RecordingRefused(
            f"{table.path}: {count} column(s) q for {len(names)} joint(s) "
            f"({listed(names)}); leave out surplus columns, or name the joints "
            "recorded, in the order of the columns, in joint_names (command line: "
            "--joints): the others are held at zero.",
            {"joint_names": names[:count]} if fewer else {},
        )
    return ordered, names


def _used_joints(table, layout, robot, notes):
    """Return the layout without joints that the robot lacks or that few rows hold."""
    names, counts = robot.names or layout.joints, {}
    roles = [x for x in layout.roles if isinstance(x.key, int) or x.key in names]
    for role in roles:
        if isinstance(role.key, str):
            n = table.frame[role.column].count()
            counts[role.key] = max(n, counts.get(role.key, 0))
    slow = [key for key, n in counts.items() if n < RATE_RATIO * max(counts.values())]
    if slow:
        few = "have values in less than a fifth of the rows of others: left out."
        notes.append(Loss(f"joint(s) {listed(slow)} {few}"))
    return replace(layout, roles=tuple(x for x in roles if x.key not in slow))


def read_rows(table, options) -> FileRows:
    """Convert a table to complete rows, with notes on how it was read."""
    notes = list(table.notes)
    robot = options.robot(table)
    file_dt = table.scalars.get("dt")
    if file_dt is not None and file_dt.size == 1:
        dt = check_dt(file_dt.item())
        if options.dt is not None and abs(dt - options.dt) > SAME_DT * dt:
            raise ValueError(
                f"{table.path}: its dt is {dt} s but dt = {options.dt} s; correct one "
                "of them."
            )
        options = replace(options, dt=options.dt or dt)
    layout = find_layout(table, options, robot)
    used = _used_joints(table, layout, robot, notes)
    table = merge_sources(table, used, notes)
    table, rows = remove_odd_rows(table, used, options, notes)
    roles, names = _sort_roles(table, layout, used, options, robot, notes)
    role = roles["q"][0]
    # The name of a joint is no evidence.
    if "command" in kinds_in(role.column.replace(f"{role.key}", "")):
        what = "seems to be commanded; measured positions are needed."
        notes.append(Loss(f"column {role.column!r} {what}"))
    channels, units = _convert_units(table, roles, options, notes)
    prismatic = _check_units(table, roles, units, names, robot)
    si_units = ["N" if slide else "N m" for slide in prismatic]
    torque_units = [x or y for x, y in zip(units.get("tau", si_units), si_units)]
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
        torque_units = si_units
        channels["tau"] = channels["tau"] * np.array(gains)
    # The torques of a drive are computed after all files have been read.
    channels.setdefault("tau", np.zeros(channels["q"].shape))
    if robot.in_model:
        in_model = [*robot.in_model]
        order = sorted(range(len(names)), key=lambda j: in_model.index(names[j]))
        names, prismatic, torque_units = (
            [x[j] for j in order] for x in (names, prismatic, torque_units)
        )
        channels = {kind: values[:, order] for kind, values in channels.items()}
    t, time = read_time(table, layout, options, channels["q"])
    columns, labels = [role.column for role in layout.select("segment")], None
    for column in columns:
        refuse_ambiguous(table, columns[0], column)
        labels = table.values(column)
        labels = table.numbers(column) if labels.dtype.kind == "f" else labels
    signals = _signals(table, layout, time, notes)
    motor_units = [unit for unit in torque_units if unit not in ("N m", "N")]
    if motor_units and options.gains is None and options.drive is None:
        notes.append(
            f"the torques are recorded in {motor_units[0]}: give the gains, factors to "
            "N m, or identify them (gains='unknown'; command line: --gain unknown)."
        )
    if t is None and options.dt:
        # Without time stamps, row numbers before the removal of rows give the times.
        t = options.dt * rows
    column_notes = _describe_columns(table, layout, options, roles, time)
    # Release the memory of the data frame.
    table = replace(table, frame=table.frame.iloc[:, :0])
    return FileRows(
        path=table.path,
        name=table.name
        or re.sub(r"(?<=.)\.[^.]*(\.(gz|bz2|xz))?$", "", table.path.name),
        where=table.where,
        t=t,
        dt=options.dt,
        labels=labels,
        channels=channels | signals,
        robot={
            "joint_names": tuple(names),
            "position_units": tuple("m" if slide else "rad" for slide in prismatic),
            "torque_units": tuple(torque_units),
            "joints_named": robot.explicit
            or all(isinstance(role.key, str) for role in layout.select("q")),
        },
        notes=[*column_notes, *notes],
    )


def _convert_units(table, by_kind, options, notes):
    """Convert channels to the package's units; also return their base units."""
    for kind, measured in MEASURED.items():
        roles, targets = by_kind.get(kind, []), by_kind.get(measured, [])
        if roles and kind in options.recorded and len(roles) == len(targets):
            # Commands without a unit have the unit of the commanded quantity.
            by_kind[kind] = [
                role if role.unit else replace(role, unit=other.unit)
                for role, other in zip(roles, targets)
            ]
    channels, units = {}, {}
    for kind, roles in by_kind.items():
        columns, units[kind] = zip(*(_convert_column(table, role) for role in roles))
        channels[kind] = np.column_stack(columns)
    for kind in options.recorded if options.drive is not None else ():
        value = table.scalars.get(kind)
        if kind not in channels and value is not None and value.dtype.kind in "iuf":
            shape = channels["q"].shape
            if value.shape not in {(), (1,), shape[1:]}:
                raise ValueError(
                    f"{table.path}: {kind} has the shape {value.shape}; expected one "
                    f"number for each of {shape[1]} joints, or one in every row."
                )
            channels[kind] = np.broadcast_to(value.astype(float), shape).copy()
    if "v_desired" in options.recorded and "v_desired" not in channels:
        notes.append(
            "no desired velocities (v_desired): taken as zero, so that kd damps all "
            "motion."
        )
    return channels, units


def _convert_column(table, role):
    """Return a column (n_rows,) in the package's units, and its base unit or None."""
    values, unit = table.numbers(role.column), channel_unit(table, role)
    if role.kind == "tau":
        _check_integer_codes(table, role.column, values)
        if unit is None and is_current(role.column):
            unit = unit_of("tau", "A")
    if unit is not None:
        values = values * unit.factor
    bad = np.flatnonzero(np.abs(values) > _LARGEST)
    if bad.size:
        raise ValueError(
            f"{table.path}: {values[bad[0]]:.3g} in {table.where(bad[0])}, column "
            f"{role.column!r}, is implausible; correct or remove that row."
        )
    return values, None if unit is None else unit.base


# Word lengths [bit] of two's complement and of sign-magnitude integers. Decoding the
# sign must reduce the largest step between samples below this share.
_BITS, _SIGN_BIT, _STEP_RATIO = range(8, 33), (11, 12, 16), 0.45


def _check_integer_codes(table, column, values):
    """Refuse signed integers that were logged as unsigned, in any resolution."""
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
    if bits in _SIGN_BIT and unit == 1:
        remedy = f"replace those from {half:.0f} on by {half:.0f} - x"
        signed[remedy] = np.where(codes < half, codes, half - codes)
    largest = np.abs(np.diff(codes)).max()
    for remedy, x in signed.items():
        if x.min() < 0 < x.max() and np.abs(np.diff(x)).max() < _STEP_RATIO * largest:
            raise ValueError(
                f"{table.path}: the values of column {column!r} are integers whose "
                f"sign was lost; {remedy}."
            )


def _check_units(table, roles, units, names, robot):
    """Return whether joints are prismatic, list of bool; refuse contradicting units."""
    prismatic = []
    for j, joint in enumerate(names):
        slides = units["q"][j] == "m"
        if robot.in_model:
            slides = robot.in_model[joint]
        elif units["q"][j] is None:
            slides = "tau" in units and units["tau"][j] == "N"
        prismatic.append(slides)
        for kind, bases in (("q", ("rad", "m")), ("tau", ("N m", "N"))):
            if kind in units and units[kind][j] == bases[not slides]:
                role = roles[kind][j]
                raise ValueError(
                    f"{table.path}: column {role.column!r} is in {role.unit}, but "
                    f"{joint} {'slides' if slides else 'turns'}; expected "
                    f"{bases[slides]}. Correct the unit, or the order of the joints."
                )
    return prismatic


def _signals(table, layout, time, notes):
    """Return the remaining columns of finite numbers, a dict of arrays."""
    # Other columns of time are signals, unless a preset identifies them as time.
    roles = [x for x in layout.roles if x.kind != "t" or layout.what or x is time]
    excluded = {role.column for role in roles} | layout.no_signals
    others = table.frame.select_dtypes(exclude=["datetime", "datetimetz"])
    others = [x for x in others if x not in excluded]
    numbers = {x: as_numbers(table.values(x), len(table.frame))[0] for x in others}
    rejected = [x for x, values in numbers.items() if values is None]
    if rejected:
        notes.append(
            f"column(s) {listed(rejected)} hold no finite numbers and are left out."
        )
    return {x: values for x, values in numbers.items() if values is not None}


def _describe_columns(table, layout, options, by_kind, time):
    """Return a note on columns whose names differ from their channels, list of str."""
    parts, units = [], [x for roles in by_kind.values() for x in roles if x.unit]
    for kind, roles in [*by_kind.items(), ("t", [] if time is None else [time])]:
        names = [role.column for role in roles]
        named = all(x.lower().replace("τ", "tau").startswith(kind) for x in names)
        if not (options.columns or named):
            ends = [names[0], names[-1]] if len(names) > 1 else names
            parts.append(f"{kind} = {' ... '.join(ends)}")
    converted = {x.unit for x in units if channel_unit(table, x).factor != 1}
    if converted:
        parts.append(f"converted from {', '.join(sorted(converted))}")
    if layout.what:
        return [f"taken as {layout.what}: {', '.join(parts)}."]
    return [f"{'; '.join(parts)}."] if parts else []
