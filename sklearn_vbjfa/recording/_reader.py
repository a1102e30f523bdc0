"""A user's recording out of a file, with its time stamps checked."""

import re
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from os import PathLike, fspath

import numpy as np

from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.recording import _layout
from sklearn_vbjfa.recording._concatenate import (
    RecordedFile,
    concatenate,
    said,
    without_repeats,
)
from sklearn_vbjfa.recording._files import read_table
from sklearn_vbjfa.recording._layout import Layout, MappingRefused
from sklearn_vbjfa.recording._presets import PRESETS, currents_as_efforts
from sklearn_vbjfa.recording._quoting import listed, quoted
from sklearn_vbjfa.recording._recording import Recording, _check_dt
from sklearn_vbjfa.recording._refusal import (
    RecordingRefused,
    nearest,
    suggestion,
    unit_is_wrong,
    unit_of_steps,
    usual_step,
)
from sklearn_vbjfa.recording._resample import on_grid
from sklearn_vbjfa.recording._signals import as_numbers
from sklearn_vbjfa.recording._table import Loss, Table
from sklearn_vbjfa.recording._units import TIME_UNITS, split_unit, unit_of

# No robot has positions [rad or m], speeds or torques [N m or N] beyond this.
_LARGEST = 1e12
# Units of torque; a motor is recorded in others.
_TORQUES = ("N m", "N")


def read_recording(
    path: str | PathLike | Sequence[str | PathLike],
    *,
    dt: float | None = None,
    urdf: str | PathLike | None = None,
    joint_names: tuple[str, ...] | None = None,
    name: str | None = None,
    columns: str | dict[str, str] | None = None,
    preset: str | None = None,
    topic: str | None = None,
    gains: str | tuple[float, ...] | None = None,
    time_unit: str | None = None,
) -> Recording:
    r"""Read a recording of your own robot: a table, a bag, arrays, or several of them.

    Parameters
    ----------
    path : str, os.PathLike or sequence of these
        One row per sample, as CSV (also .gz, .bz2, .xz), Excel, parquet, npz, npy with
        named fields or MATLAB (to version 7.2); a bag of ROS 1 or 2 or an MCAP file
        with JointState, with or without its folder; the folder of a LeRobot data set;
        "-" for standard input. Columns: positions q1 ... qn [rad or m] and torques
        tau1 ... taun [N m or N]; optionally v1 ... vn [rad/s or m/s], a1 ... an
        [rad/s^2 or m/s^2], t [s or dates] and segment, the label of separate
        recordings (contiguous rows). Names may also be q_1 or q[1], count from 0, or
        use the joint's name, such as q_shoulder; a unit may follow (q1 [deg], t_ms),
        or stand in a row below the names. Names that the presets know are recognised.
        An npz file may hold matrices q, tau, ... and a number dt. Text is separated by
        comma, semicolon, tab or blanks; # begins a comment. Of several files of one
        robot the recordings stand one after the other, called after their files, with
        their own names behind where a file has several.
    dt : float, default=None
        Sample period [s]; needed if there is no time.
    urdf : str or os.PathLike, default=None
        URDF or MJCF file of the robot: gives the joints' names and order, which must
        agree with the columns. Where columns have joints' names, its joints without any
        are held at zero.
    joint_names : sequence of str, default=None
        Joints in the order of the columns; with `urdf` some of its joints (the others,
        such as wheels and fingers, are then held at zero). None takes all of `urdf`,
        or joint_1, ...
    name : str, default=None
        Name of the recording; None is that of the file, or of the folder of several.
    columns : str or dict of str to str, default=None
        Which columns are which channels, such as
        "q=actual_q_{i},tau=actual_current_{i},t=timestamp": {i} stands for the number
        of a joint, from 0 or 1, and {joint} for its name. A unit may follow, as in
        "q=pos_{i} [deg]". Single joints are q1=..., tau_elbow=....
    preset : {"ros", "ur", "franka", "lerobot"}, default=None
        Take names as these tools write them; None recognises them.
    topic : str, default=None
        Topic of a bag; None takes the only one of joint states.
    gains : sequence of float or "unknown", default=None
        Torques are these factors [N m or N per unit] times what was recorded, for each
        joint in the order of `joint_names` or else of `urdf`. "unknown" leaves them in
        the unit of a motor current without a word.
    time_unit : {"s", "ms", "us", "ns"}, default=None
        Unit of time; None takes what the names say, or seconds.

    Returns
    -------
    recording : Recording
        On a uniform time grid. Other numeric columns are in its `signals` by their
        names, as are accelerations ("a"); what is wrong with others is in `left_out`.
        Where rows were interpolated, `torque_noise` is the white noise that the torques
        had before. Of several files, `signals` has the columns that all of them have.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ImportError
        If a package is missing that the format needs (pyarrow, rosbags,
        python-calamine), or `urdf` without Pinocchio.
    ValueError
        If the file is damaged or not what its ending says, the number of columns is
        wrong, two columns could be meant, a value is not finite or beyond 1e12, time
        runs backwards, is not in seconds or does not reveal the period, or there is
        neither time nor `dt`; if one of several files has other joints or channels, a
        sample period that differs by more than 1 %, or no time stamps while others
        have some. The message names the file, what was expected and what to do; where
        other options would read the file, the attribute ``options`` of the error has
        them.

    Warns
    -----
    UserWarning
        If names other than those above were recognised: what was taken for what; if
        torques are in the unit of a motor current. If time stamps are irregular: where
        positions follow the stamps, samples are
        interpolated on a uniform grid from their neighbours; otherwise the rows are
        taken as equidistant. If up to five consecutive rows are missing: they are
        interpolated and the others kept. If more are missing: the recording is split
        there, and pieces of fewer than ten rows are dropped. If rows occur twice, or
        stamps repeat. If one of several files is a copy of another: it is taken once.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from sklearn_vbjfa.datasets import read_recording
    >>> rows = [f"{0.01 * k:.2f},{0.1 * k},{1.0}" for k in range(20)]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder) / "hinge.csv"
    ...     _ = file.write_text("clock,angle,torque\n" + "\n".join(rows))
    ...     read_recording(file, columns="q=angle,tau=torque,t=clock")
    Recording 'hinge': 20 samples, 1 joint, dt = 0.01 s, 1 recording

    Several files:

    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = [pathlib.Path(folder) / f"{name}.csv" for name in ("slow", "fast")]
    ...     for rate, file in zip((0.1, 0.3), files):
    ...         rows = [f"{0.01 * k:.2f},{rate * k},{1.0}" for k in range(20)]
    ...         _ = file.write_text("t,q1,tau1\n" + "\n".join(rows))
    ...     read_recording(files).group_names
    ('slow', 'fast')
    """
    if dt is not None:
        _check_dt(dt)
    asked = _Asked(
        mapping={} if columns is None else _layout.parse_mapping(columns),
        preset=_layout.checked_preset(preset),
        timed=dt is not None,
        gained=gains is not None,
    )
    gains = _checked_gains(gains)
    if time_unit is not None and time_unit not in TIME_UNITS:
        raise ValueError(
            f"time_unit must be one of {', '.join(TIME_UNITS)}; got {time_unit!r}."
        )
    is_one = isinstance(path, (str, bytes, PathLike)) or not isinstance(path, Iterable)
    paths, again = ([path], []) if is_one else without_repeats(path)
    if not paths:
        raise ValueError("path must name one file or more, got none.")
    files = []
    for one in paths:
        try:
            file = _read_file(
                one, dt, urdf, joint_names, asked, topic, gains, time_unit
            )
        except RecordingRefused as error:
            if not files:
                raise
            # The files before it were read without the options that it offers.
            raise RecordingRefused(error.reason) from error
        files.append(file)
    if is_one:
        recording, notes = files[0].recording, said(files)
        if name:
            recording = replace(recording, name=name)
    else:
        recording, notes = concatenate(files, again, name)
    for note in notes:
        category = DoubtWarning if isinstance(note, Loss) else UserWarning
        warnings.warn(note, category, stacklevel=2)
    return recording


def _read_file(path, dt, urdf, joint_names, asked, topic, gains, time_unit):
    """Read one file, by checked arguments of `read_recording`."""
    names = _strings(joint_names)
    table = read_table(path, topic, lambda: names or _movable(urdf))
    if joint_names is None and "joint_names" in table.scalars:
        names = _strings([str(x) for x in np.atleast_1d(table.scalars["joint_names"])])
    model_names, prismatic = _robot(urdf, names)
    robot = _Joints(names=names or model_names, chosen=bool(names))
    notes = list(table.notes)
    dt = _given_period(table, dt)
    asked = replace(asked, timed=dt is not None)
    layout = _laid_out(table, asked, robot.names)
    table = _without_blank_rows(table, layout, notes)
    found, robot = _channels(table, layout, asked, robot, notes)
    names = robot.names
    channels, units = {}, {}
    for kind, columns_of in found.items():
        if columns_of:
            channels[kind], units[kind] = _values(table, kind, columns_of)
    names = _check_joints(table, found, asked, robot)
    slides = _check_units(table, found, units, names, model_names, prismatic)
    recorded = _gained(table, channels, units["tau"], None, names, slides)
    torque_units = _gained(table, channels, units["tau"], gains, names, slides)
    taken = {role.column for roles in found.values() for role in roles}
    if model_names:
        # The order of the model, whatever that of the file.
        order = sorted(range(len(names)), key=lambda j: model_names.index(names[j]))
        names = tuple(names[j] for j in order)
        slides = [slides[j] for j in order]
        torque_units = [torque_units[j] for j in order]
        recorded = [recorded[j] for j in order]
        channels = {kind: values[:, order] for kind, values in channels.items()}
    t, time = _time(table, layout, dt, time_unit)
    labels, segment = _segments(table, layout)
    taken |= {segment, *(() if time is None else time.column.split("+"))}
    signals, left_out = _signals(table, layout, taken, notes)
    own = torque_units[0] if len(set(torque_units)) == 1 else ""
    _say_what_was_taken(
        table, layout, asked.mapping, found, time, time_unit, own, notes
    )
    maker = currents_as_efforts(names) if _is_effort(table, layout) else ""
    if maker and gains is None:
        notes.append(
            f"efforts are taken as N m; many drivers of {maker} publish motor currents "
            "[A] under this name: if this one did, give gains (command line: --gain "
            "unknown, or the factors)."
        )
    motor = [unit for unit in torque_units if unit not in _TORQUES]
    if motor and gains is None:
        notes.append(
            f"the torques are recorded in {motor[0]}: give the gains, factors to N m, "
            "or identify them (gains='unknown'; command line: --gain unknown)."
        )
    fields = on_grid(table, t, labels, dt, {**channels, **signals}, notes)
    recording = Recording(
        name=_stem(table.path),
        joint_names=names,
        position_units=tuple("m" if slide else "rad" for slide in slides),
        torque_units=tuple(torque_units),
        urdf=None if urdf is None else fspath(urdf),
        description=f"Read from {table.path.name}.",
        left_out=left_out,
        **fields,
    )
    return RecordedFile(
        path=table.path,
        recording=recording,
        notes=tuple(notes),
        stamped=t is not None,
        torque_units=tuple(recorded),
    )


def _is_effort(table, layout):
    """Whether torques are efforts of ROS, of whatever unit the driver publishes."""
    return bool(table.joints) or layout.what.startswith("/joint_states")


def _stem(path):
    """Return the name of a recording, without any of its endings."""
    stem = path.stem
    return (
        stem.rpartition(".")[0] or stem
        if path.suffix in (".gz", ".bz2", ".xz")
        else stem
    )


# -- columns ---------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Asked:
    """What the user says of the columns, and whether of the period and the gains."""

    mapping: dict
    preset: str | None
    timed: bool
    gained: bool


@dataclass(frozen=True, kw_only=True)
class _Joints:
    """The joints that columns are looked for of, and whether the user chose them."""

    names: tuple = ()
    chosen: bool = False


def _strings(joint_names):
    """Return joint names as a tuple of str, empty for None."""
    if joint_names is None:
        return ()
    if isinstance(joint_names, str):
        raise ValueError(
            f"joint_names must be several names, one per column, got {joint_names!r}."
        )
    names = tuple(str(x) for x in joint_names)
    if len(set(names)) < len(names):
        raise ValueError(f"joint_names must differ from one another, got {names}.")
    return names


def _robot(urdf, names):
    """Return joint names and which are prismatic, empty without a description."""
    # Of the description's joints only those with `names` count, if there are any.
    if urdf is None:
        return (), ()
    from sklearn_vbjfa.model import is_prismatic, joint_names, load_model, load_reduced

    model = load_reduced(urdf, names) if names else load_model(urdf)
    return joint_names(model), is_prismatic(model)


def _movable(urdf):
    """Return the joints of a description that can move, empty without one."""
    if urdf is None:
        return ()
    from sklearn_vbjfa.model import movable_joints

    return movable_joints(urdf)


def _laid_out(table: Table, asked, names) -> Layout:
    """Say which columns are which channels; refuse what does not fit."""
    mapping, preset = asked.mapping, asked.preset
    if preset is not None and mapping:
        raise RecordingRefused(
            "give columns or a preset, not both: a preset is a mapping.",
            {"preset": None},
        )
    if mapping:
        try:
            return _layout.by_mapping(table, mapping, names)
        except MappingRefused as error:
            raise RecordingRefused(
                f"{table.path}: {error}.", _otherwise(table, asked, names)
            ) from None
    plain = _layout.by_names(table, names)
    if table.joints:
        return replace(plain, certain=True)
    if preset is None and any(_matched(plain, kind, names) for kind in ("q", "tau")):
        return plain
    fitted = _layout.by_preset(table, preset, names)
    if len(fitted) > 1:
        raise RecordingRefused(
            f"{table.path}: could be {' or '.join(x.what for x in fitted.values())}; "
            f"give preset={' or '.join(repr(x) for x in fitted)}.",
            {"preset": next(iter(fitted))},
        )
    if fitted:
        (layout,) = fitted.values()
        return _named(layout)
    if preset is not None:
        expected = " or ".join(f"{x.q} and {x.tau}" for x in PRESETS[preset])
        raise RecordingRefused(
            f"{table.path}: does not fit the preset {preset!r}, which expects columns "
            f"{expected}; found {listed(table.columns)}.",
            _otherwise(table, asked, names),
        )
    return plain


def _otherwise(table: Table, asked, names):
    """Return the options that would read a file, had the user said nothing of it."""
    said = {"columns": asked.mapping, "preset": asked.preset}
    nothing = {key: None for key, value in said.items() if value}
    plain = _layout.by_names(table, names)
    if all(_matched(plain, kind, names) for kind in ("q", "tau")):
        return nothing
    if len(_layout.by_preset(table, None, names)) == 1:
        return nothing
    found = suggestion(
        table, names, ("q", "tau", "t"), {}, timed=asked.timed, gained=asked.gained
    )
    return nothing | found if found else {}


def _named(layout: Layout) -> Layout:
    """Put the joints' names, if there are any, into those of numbered channels."""
    # Numbers count from 0 or 1, as elsewhere.
    if not layout.joints:
        return layout
    roles = {}
    first = 0 if "q0" in layout.roles else 1
    for name, role in layout.roles.items():
        match = re.fullmatch(r"(q|tau|v)(\d+)", name)
        j = int(match[2]) - first if match else -1
        if match and 0 <= j < len(layout.joints):
            name = f"{match[1]}_{layout.joints[j]}"
        roles[name] = role
    return replace(layout, roles=roles)


def _matched(layout: Layout, kind, names):
    """Return the columns of a kind by joint and by number, two dicts of roles."""
    by_joint, by_number = {}, {}
    for name, role in layout.roles.items():
        match = re.fullmatch(rf"{kind}[_.\[(]?(.*?)[\])]?", name, re.IGNORECASE)
        if match is None:
            continue
        suffix = match.group(1)
        if suffix in names:
            found, key = by_joint, suffix
        elif suffix.isdecimal() and suffix.isascii():
            # int() would choke on thousands of digits.
            found, key = by_number, suffix.lstrip("0").rjust(1, "0")
        elif not suffix and name.lower() == kind:
            found, key = by_number, "1"
        else:
            continue
        found.setdefault(key, []).append(role)
    return (by_joint, by_number) if by_joint or by_number else ()


def _channels(table: Table, layout, asked, robot, notes):
    """Return the roles of each kind, listed in the order of the joints, and those."""
    # Refuses, all at once, what is missing.
    names = robot.names or _own_joints(layout)
    robot = replace(robot, names=names)
    matched = {kind: _matched(layout, kind, names) for kind in _layout.KINDS}
    missing = [kind for kind in ("q", "tau") if not matched[kind]]
    no_time = not (asked.timed or layout.times)
    if missing or no_time:
        raise _all_missing(table, layout, asked, names, missing, no_time)
    for pair in filter(None, matched.values()):
        _refuse_both(table, *pair, names)
    by_joint = {kind: pair[0] for kind, pair in matched.items() if pair}
    if any(by_joint.values()):
        robot = _held(table, layout, robot, by_joint, notes)
    return {
        kind: _in_order(table, kind, pair, robot.names) if pair else []
        for kind, pair in matched.items()
    }, robot


def _own_joints(layout: Layout):
    """Return the joints that the columns of a recognised log are called after."""
    found = {}
    if layout.certain:
        for name in layout.roles:
            match = re.fullmatch(r"q_(.+)", name)
            if match and not match[1].isdecimal():
                found[match[1]] = None
    return tuple(found)


def _held(table, layout, robot, by_joint, notes):
    """Leave out the robot's joints without any column, unless the user chose them."""
    having = set().union(*by_joint.values())
    names = tuple(x for x in robot.names if x in having)
    if layout.certain:
        others = [x for x in _own_joints(layout) if x not in robot.names]
        if others:
            notes.append(
                f"joint(s) {listed(others)} are none of the robot's and are left out."
            )
    if robot.chosen or len(names) == len(robot.names):
        return robot
    held = [x for x in robot.names if x not in having]
    notes.append(Loss(f"no columns of joint(s) {listed(held)}: held at zero."))
    return replace(robot, names=names)


def _refuse_both(table, by_joint, by_number, names):
    """Refuse several columns for one channel, and numbers beside names."""
    for found in (by_joint, by_number):
        for roles in found.values():
            for other in roles[1:]:
                _refuse_two(table, roles[0].column, other.column)
    if by_joint and by_number:
        name, (named, *_) = next(iter(by_joint.items()))
        j = names.index(name)
        (numbered, *_) = by_number.get(str(j + 1), next(iter(by_number.values())))
        _refuse_two(table, named.column, numbered.column)


def _in_order(table: Table, kind, pair, names):
    """Return the roles of one kind in the order of the joints."""
    by_joint, by_number = pair
    found = by_joint or by_number
    first = 0 if by_joint or "0" in found else 1
    count = len(names if by_joint else found)
    roles = []
    for k in range(count):
        key = names[k] if by_joint else str(first + k)
        if key not in found:
            missing = f"{kind}_{names[k]}" if by_joint else f"{kind}{key}"
            beside = listed([role.column for (role, *_) in found.values()])
            raise ValueError(
                f"{table.path}: column {missing!r} is missing beside {beside}; every "
                "joint needs one, in order."
            )
        roles.append(found[key][0])
    return roles


def _all_missing(table, layout, asked, names, missing, no_time):
    """Return the refusal that lists everything that is missing."""
    parts = []
    strangers = _own_joints(layout)
    if missing and strangers and names:
        parts.append(
            f"its joints {listed(strangers)} are none of the robot's, {listed(names)}"
        )
    for kind, what in (("q", "positions"), ("tau", "torques")):
        if kind in missing:
            near = nearest(table, kind, names)
            near = f" (nearest: {near})" if near else ""
            parts.append(f"no {what}: expected columns {kind}1, {kind}2, ...{near}")
    if no_time:
        near = nearest(table, "t", names)
        near = f" (nearest: {near})" if near else ""
        parts.append(
            f"no column t and no dt{near}; add time stamps [s] as column t, or give "
            "the sample period dt in seconds"
            if not missing
            else f"no time: expected a column t, or dt{near}"
        )
    needed = [*missing, *(["t"] if no_time else [])]
    options = suggestion(
        table, names, needed, asked.mapping, timed=not no_time, gained=asked.gained
    )
    found = f"; found {listed(table.columns)}" if missing else ""
    offer = (
        '; rename them in the header, or give columns="q=NAME{i},tau=NAME{i},t=NAME"'
        if missing and not options
        else ""
    )
    return RecordingRefused(f"{table.path}: {'; '.join(parts)}{found}{offer}.", options)


def _refuse_two(table, one, other):
    """Refuse two columns that could both be meant."""
    if one != other:
        raise ValueError(
            f"{table.path}: columns {one!r} and {other!r} could both be meant; rename "
            "or remove the one that is not."
        )


def _values(table: Table, kind, roles):
    """Return the columns of one kind (n_rows, nv) in the package's units, and these."""
    # The second is the base of the unit of each column, None where nothing tells.
    columns, bases = [], []
    for role in roles:
        unit = _layout.channel_unit(table, kind, role)
        values = _numbers(table, role.column)
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
    """Return a column as finite floats, or say which cell is none."""
    values = table.columns[column]
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


def _without_blank_rows(table: Table, layout, notes):
    """Leave out rows in which no joint has a position or torque: of other topics."""
    used = [
        table.columns[role.column]
        for name, role in layout.roles.items()
        if re.fullmatch(r"(q|tau)([_.\[(]?\d.*|_.+)?", name, re.IGNORECASE)
    ]
    if not used or any(values.dtype.kind != "f" for values in used):
        return table
    blank = np.isnan(used[0])
    for values in used[1:]:
        if not blank.any():
            return table
        blank &= np.isnan(values)
    if not blank.any() or blank.all():
        return table
    rows = np.flatnonzero(~blank)
    notes.append(f"{blank.sum()} row(s) without any position or torque are left out.")
    return replace(
        table,
        columns={name: values[rows] for name, values in table.columns.items()},
        where=lambda row: table.where(rows[row]),
    )


def _check_joints(table: Table, found, asked, robot):
    """Check the number of joints by the columns of each kind, return their names."""
    names = robot.names
    used = {kind: [x.column for x in roles] for kind, roles in found.items() if roles}
    nv = len(used["q"])
    for kind, columns in used.items():
        if len(columns) != nv:
            raise ValueError(
                f"{table.path}: {nv} column(s) q ({listed(used['q'])}) and "
                f"{len(columns)} column(s) {kind} ({listed(columns)}); every joint "
                "needs one of each."
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
        options = {}
        if nv < len(names) and not robot.chosen:
            options = {"joint_names": names[:nv]}
        if nv == 1 and "q" in asked.mapping:
            # A pattern without {i} is the name of a single column.
            options = _otherwise(table, asked, names) or options
        raise RecordingRefused(
            f"{table.path}: {nv} column(s) q for {len(names)} joint(s) "
            f"({listed(names)}); {remedy}.",
            options,
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
            slide = units["tau"][j] == "N"
        slides.append(slide)
        wrong = {"q": "rad", "v": "rad", "a": "rad", "tau": "N m"}
        if not slide:
            wrong = {"q": "m", "v": "m", "a": "m", "tau": "N"}
        for kind, base in wrong.items():
            if found[kind] and units[kind][j] == base:
                role = found[kind][j]
                raise ValueError(
                    f"{table.path}: column {role.column!r} is in {role.unit}, but "
                    f"{joint} {'slides' if slide else 'turns'}; expected "
                    f"{_EXPECTED[kind][slide]}. Correct the unit, or the order of the "
                    "joints."
                )
    return slides


_EXPECTED = {
    "q": ("rad or deg", "m or mm"),
    "v": ("rad/s or deg/s", "m/s or mm/s"),
    "a": ("rad/s^2 or deg/s^2", "m/s^2 or mm/s^2"),
    "tau": ("N m", "N"),
}


def _gained(table: Table, channels, bases, gains, names, slides):
    """Return the unit of each torque, list of str, after multiplying by the gains."""
    own = ["N" if slide else "N m" for slide in slides]
    if gains is None or isinstance(gains, str):
        return [base or unit for base, unit in zip(bases, own)]
    if len(gains) != len(names):
        same = len(gains) == 1
        raise RecordingRefused(
            f"{table.path}: {len(gains)} gain(s) for {len(names)} joint(s) "
            f"({listed(names)}); expected one for each, in this order"
            f"{'' if same else ', or unknown, to have them identified'}.",
            {"gains": gains * len(names) if same else "unknown"},
        )
    channels["tau"] = channels["tau"] * np.array(gains)
    return own


def _checked_gains(gains):
    """Return gains as a tuple of float, "unknown" or None."""
    if gains is None or (isinstance(gains, str) and gains == "unknown"):
        return gains
    try:
        found = tuple(float(x) for x in np.atleast_1d(gains))
    except (TypeError, ValueError):
        found = (0.0,)
    if isinstance(gains, str) or not all(np.isfinite(x) and x != 0 for x in found):
        raise ValueError(
            f"gains must be a factor for each joint, finite and not 0, or 'unknown'; "
            f"got {gains!r}."
        )
    return found


def _segments(table: Table, layout):
    """Return segment labels or None, and the name of their column."""
    columns = [
        role.column for name, role in layout.roles.items() if name.lower() == "segment"
    ]
    if not columns:
        return None, ""
    for other in columns[1:]:
        _refuse_two(table, columns[0], other)
    labels = table.columns[columns[0]]
    if labels.dtype.kind == "f":
        labels = _numbers(table, columns[0])
    return labels, columns[0]


def _signals(table: Table, layout, taken, notes):
    """Return the other columns, and what is wrong with those that are no numbers."""
    signals, left_out = {}, {}
    known = {role.column: name for name, role in layout.roles.items()}
    clocks = {role.column for role in layout.times if layout.what}
    for column, values in table.columns.items():
        if column in taken or column in layout.beside or column in clocks:
            continue
        if layout.certain and re.fullmatch(r"(q|tau|v|a)_.+", known.get(column, "")):
            # Of joints that the robot lacks.
            continue
        numbers, reason = as_numbers(values, table.n_rows)
        if reason:
            left_out[column] = reason
        else:
            signals[column] = numbers
    if left_out:
        notes.append(
            f"column(s) {listed(left_out)} hold no finite numbers and are left out."
        )
    return signals, left_out


def _say_what_was_taken(
    table, layout, mapping, found, time, time_unit, torque_unit, notes
):
    """Note, in one line, what was taken for what where the names do not say it."""
    said = []
    converted = {
        role.unit
        for kind, roles in found.items()
        for role in roles
        if role.unit and unit_of(kind, role.unit).factor != 1
    }
    stamped = ""
    if time is not None:
        unit = time_unit or time.unit or "s"
        stamped = f"t = {_with_unit(time.column, unit)}"
    if layout.what:
        for kind in ("q", "tau"):
            columns = [role.column for role in found[kind]]
            ends = (
                columns[0] if len(columns) == 1 else f"{columns[0]} ... {columns[-1]}"
            )
            unit = found[kind][0].unit or (torque_unit if kind == "tau" else "")
            said.append(f"{kind} = {_with_unit(ends, unit)}")
        said.append(stamped)
        notes.insert(0, f"taken as {layout.what}: {', '.join(x for x in said if x)}.")
    elif time is not None and not mapping and time.column not in ("t", "T"):
        said.append(stamped)
    if not layout.what and converted:
        said.append(f"converted from {', '.join(sorted(converted))}")
    if said and not layout.what:
        notes.insert(0, f"{'; '.join(said)}.")


def _with_unit(columns, unit):
    """Return columns with the unit behind them, unless their names have it there."""
    if not unit or split_unit(columns)[1] == unit:
        return columns
    return f"{columns} [{unit}]"


# -- time ------------------------------------------------------------------------------


def _time(table: Table, layout, dt, time_unit):
    """Return stamps [s] or None, and the role of their column."""
    times = layout.times
    own = [x for x in times if _layout.name_and_unit(table, x.column)[0].lower() == "t"]
    if dt is not None and not (layout.certain or own):
        # What else is called time may be anything; the period is given.
        return None, None
    if len(times) > 1 and not layout.what:
        if own:
            _refuse_two(table, times[0].column, times[1].column)
        raise RecordingRefused(
            f"{table.path}: columns {listed([x.column for x in times])} could all be "
            f"time; give columns='t={times[0].column}', or another of them.",
            {"columns": f"t={times[0].column}"},
        )
    for role in times:
        parts = role.column.split("+") if layout.what else [role.column]
        t = _layout.seconds_of_dates(table, parts[0]) if len(parts) == 1 else None
        if t is not None:
            return t, replace(role, unit="s")
        values = [_numbers(table, part) for part in parts]
        t = values[0] - values[0][0]
        unit = _layout.channel_unit(table, "t", role)
        factor = 1.0 if unit is None else unit.factor
        if time_unit is not None and len(parts) == 1:
            factor = unit_of("t", time_unit).factor
        t = t * factor
        if len(parts) == 2:
            t = t + 1e-9 * (values[1] - values[1][0])
        if np.ptp(t) > 0 or role is times[-1]:
            _check_unit(table, role, values[0], usual_step(t), time_unit)
            # Without a unit stamps stay as they are, for messages that quote them.
            exact = values[0] if factor == 1.0 and len(parts) == 1 else t
            return exact, role
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
        f"{step * unit_of('t', unit).factor:.4g} s.",
        {"time_unit": unit},
    )


def _given_period(table: Table, dt):
    """Return the period given by the caller or the file; None for neither."""
    if dt is None and "dt" in table.scalars:
        entry = table.scalars["dt"]
        dt = entry.item() if entry.size == 1 and entry.dtype.kind in "iuf" else None
        if dt is None or not 0 < dt < np.inf:
            raise ValueError(
                f"{table.path}: dt must be a positive number of seconds, got {entry}; "
                "correct it in the file."
            )
        dt = float(dt)
    return dt
