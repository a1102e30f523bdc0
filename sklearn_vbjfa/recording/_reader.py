"""A user's recording out of a file, with its time stamps checked."""

import contextlib
import warnings
from collections.abc import Sequence
from dataclasses import replace
from os import PathLike, fspath
from pathlib import Path

import numpy as np

from sklearn_vbjfa._core._progress import counted
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.recording import formats
from sklearn_vbjfa.recording._columns import as_numbers
from sklearn_vbjfa.recording._drives import Drive, parse_drive
from sklearn_vbjfa.recording._layout import (
    ESTIMATES,
    channel_unit,
    name_and_unit,
    parse_mapping,
    seconds_of_dates,
)
from sklearn_vbjfa.recording._names import (
    Joints,
    ReadOptions,
    channels_of,
    is_current,
    laid_out,
    refuse_two,
    unit_is_wrong,
    unit_of_steps,
    usual_step,
)
from sklearn_vbjfa.recording._presets import PRESETS, currents_as_efforts
from sklearn_vbjfa.recording._recording import Recording, check_dt
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
from sklearn_vbjfa.recording._several import (
    ReadFile,
    common_folder,
    concatenated,
    joined,
    listed_paths,
    notes_of,
)
from sklearn_vbjfa.recording._table import Loss, RecordingRefused, Table, listed, quoted
from sklearn_vbjfa.recording._units import (
    MEASURED,
    TIME_UNITS,
    TURNS,
    split_unit,
    unit_of,
)
from sklearn_vbjfa.recording.formats import expanded, read_table, tables_in

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
    drive: str | Drive | None = None,
    join: bool = False,
) -> Recording:
    r"""Read a recording of your own robot: a table, a bag, arrays, or several of them.

    Parameters
    ----------
    path : str, os.PathLike or sequence of these
        One row per sample, as
        TABLES;
        a bag of ROS 1 or 2 or an MCAP file with JointState, with or without its folder;
        the folder of a LeRobot data set; "-" for standard input. Columns: positions q1
        ... qn [rad or m] and torques tau1 ... taun [N m or N]; optionally v1 ... vn
        [rad/s or m/s], a1 ... an [rad/s^2 or m/s^2], t [s or dates] and segment, the
        label of separate recordings (contiguous rows). Names may also be q_1 or q[1],
        count from 0, or use the joint's name, such as q_shoulder; a unit may follow (q1
        [deg], t_ms), or stand in a row below the names. Names that the presets know are
        recognised. An npz or JSON file may hold matrices q, tau, ... and a number dt;
        JSON may also be a list of records, or one record a line. Text is separated by
        comma, semicolon, tab or blanks; # begins a comment. Of several files of one
        robot the recordings stand one after the other, called after their files, with
        their own names behind where a file has several. A folder of tables stands for
        them: one recording each if a file can be read on its own, and with `join`
        otherwise. Columns without names are called by their places, from 1.
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
        "q=pos_{i} [deg]". Single joints are q1=..., tau_elbow=.... Of a table without
        names "t=1,q=2-7,tau=8-13" says the places.
    preset : {"ros", "ur", "franka", "lerobot", "unitree"}, default=None
        Take names as these tools write them; None recognises them.
    topic : str, default=None
        Topic of a bag; None takes the only one of joint states.
    gains : sequence of float or "unknown", default=None
        Torques are these factors [N m or N per unit] times what was recorded, for each
        joint in the order of `joint_names` or else of `urdf`. "unknown" leaves them in
        the unit of a motor current without a word.
    time_unit : {"s", "ms", "us", "ns"}, default=None
        Unit of time; None takes what the names say, or seconds.
    drive : Drive or str, default=None
        What the robot follows, where no torque was measured: a `PDDrive`, or a text
        such as ``"pd kp=20,20,40 kd=1,1,2"`` (``docs/drives.rst``). The columns of its
        channels, such as q_desired1 ... or q_desired_shoulder, ``kp_...`` and
        ``kd_...``, are then needed and those of torques are not; names such as
        q_des, q_cmd, target_position and goal_position are recognised, and in an npz
        file gains may be one number for each joint.
    join : bool, default=False
        Whether several files are one recording, side by side: positions in one, torques
        in another. Each column comes from one file. Rows go by the time stamps of the
        file with the positions, others being interpolated by straight lines where they
        have none there, or one by one where files have as many rows and no stamps. The
        name of a file (positions.csv, tau.txt, t.txt) says what its columns are where
        their names do not, or where there are none.

    Returns
    -------
    recording : Recording
        On a uniform time grid. Other numeric columns are in its `signals` by their
        names, as are accelerations ("a"); what is wrong with others is in `left_out`.
        Where rows were interpolated, `torque_noise` is the white noise that the torques
        had before. Of several files, `signals` has the columns that all of them have.
        With a `drive`, `signals` has its channels (n_samples, nv), and `tau` is what
        the drive makes of them. Where rows are interpolated, commands hold the value
        that came last.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ImportError
        If a package is missing that the format needs (PACKAGES),
        or `urdf` without Pinocchio.
    OSError
        If the file cannot be read.
    ValueError
        If the file is damaged, not what its ending says, or written to while it is
        read, the number of columns is wrong, two columns could be meant, a value is not
        finite or beyond 1e12, time runs backwards, is not in seconds or does not reveal
        the period, or there is neither time nor `dt`; if one of several files is a copy
        of another, or has other joints or channels, a sample period that differs by
        more than 1 %, or no time stamps while others have some. The message names the
        file, what was expected and what to do; where other options would read the file,
        the attribute ``options`` of the error has them.

    Warns
    -----
    UserWarning
        If names other than those above were recognised: what was taken for what; if
        torques are in the unit of a motor current. If time stamps are irregular: where
        positions follow the stamps, samples are
        interpolated on a uniform grid from their neighbours; otherwise the rows are
        taken as equidistant. If up to five consecutive rows are missing: they are
        interpolated and the others kept. If more are missing: the recording is split
        there, and pieces of fewer than 16 rows are dropped. If rows occur twice, or
        stamps repeat.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from sklearn_vbjfa.datasets import read_recording
    >>> rows = [f"{0.01 * k:.2f},{0.1 * k},{1.0}" for k in range(20)]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder) / "hinge.csv"
    ...     _ = file.write_text("clock,angle,torque\n" + "\n".join(rows))
    ...     read_recording(file, columns="q=angle,tau=torque,t=clock")
    Recording 'hinge': 20 samples, 1 joint, dt = 0.01 s

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
        check_dt(dt)
    options = ReadOptions(
        mapping={} if columns is None else parse_mapping(columns),
        preset=_checked_preset(preset),
        timed=dt is not None,
        gained=gains is not None,
        drive=parse_drive(drive) if isinstance(drive, str) else drive,
    )
    if options.drive is not None and gains is not None:
        raise RecordingRefused(
            "gains are factors of columns of torques, and a drive has its own: leave "
            "gains out (command line: --gain), or the drive.",
            {"gains": None},
        )
    gains = _checked_gains(gains)
    if time_unit is not None and time_unit not in TIME_UNITS:
        raise ValueError(
            f"time_unit must be one of {', '.join(TIME_UNITS)}; got {time_unit!r}."
        )
    given_paths = [path] if isinstance(path, (str, PathLike)) else map(Path, path)
    given = dt, urdf, joint_names, options, topic, gains, time_unit
    paths, unfolded = _without_folders(dict.fromkeys(given_paths), join, given)
    if not paths:
        raise ValueError("path must name one file or more, got none.")
    is_one = len(paths) == 1 and (join or isinstance(path, (str, PathLike)))
    files = _read_files(paths, given)
    files[0] = replace(files[0], notes=(*unfolded, *files[0].notes))
    if is_one:
        recording, notes = files[0].recording, notes_of(files)
        if name:
            recording = replace(recording, name=name)
    else:
        recording, notes = concatenated(files, name)
    if options.drive is not None:
        recording = _driven(recording, options.drive, files)
    for note in notes:
        category = DoubtWarning if isinstance(note, Loss) else UserWarning
        warnings.warn(note, category, stacklevel=2)
    return recording


if read_recording.__doc__:  # not if Python leaves docstrings out
    read_recording.__doc__ = read_recording.__doc__.replace(
        "TABLES", formats.TABLES
    ).replace("PACKAGES", formats.PACKAGES)


def _read_files(paths, given):
    """Read files one by one."""
    files = []
    for path in counted(paths, "reading", "files"):
        try:
            files.append(_read_file(path, *given))
        except RecordingRefused as error:
            if not files:
                raise
            # The files before it were read without the options that it offers.
            raise RecordingRefused(error.reason) from error
    return files


def _without_folders(paths, join, given):
    """Return files, those that are one recording in a tuple, and what to say of it."""
    found, notes = [], []
    for path in paths:
        files = tables_in(path)
        if join or len(files) < 2:
            found += files or [path]
        elif any(_is_whole(one, given) for one in files):
            notes.append(
                f"{path} is taken as a folder of {len(files)} recordings, one a file."
            )
            found += files
        else:
            found.append(tuple(files))
    if join and len(found) > 1:
        found = [tuple(map(Path, found))]
    return found, notes


def _is_whole(path, given):
    """Whether a file is a recording on its own, or would be with other options."""
    try:
        _read_file(path, *given)
    except RecordingRefused as error:
        return bool(error.options)
    except (ValueError, OSError):
        return False
    return True


def _table_of(path, topic, joints, commanded=False):
    """Read the table of a file, or those of one recording in several files."""
    if not isinstance(path, tuple):
        with _finished(path):
            return read_table(path, topic, joints, commanded)
    tables = [_table_of(one, topic, joints, commanded) for one in path]
    shown = path[0].parent / "+".join([x.name for x in path[:2]])
    if len(path) > 2:
        shown = path[0].parent / f"{path[0].name} and {len(path) - 1} more"
    return joined(tables, joints(), shown)


def _read_file(path, dt, urdf, joint_names, options, topic, gains, time_unit):
    """Read one file, by checked arguments of `read_recording`."""
    names = _strings(joint_names)
    commanded = "q_desired" in options.told
    table = _table_of(path, topic, lambda: names or _movable(urdf), commanded)
    if joint_names is None and "joint_names" in table.scalars:
        names = _strings([str(x) for x in np.atleast_1d(table.scalars["joint_names"])])
    model_names, prismatic = _robot(urdf, names)
    # Columns with numbers are in the order of the file, which may name what a joint
    # carries before the joint.
    listed_first = tuple(name for name in _movable(urdf) if name in model_names)
    robot = Joints(names=names or listed_first, chosen=bool(names))
    notes = list(table.notes)
    dt = _given_period(table, dt)
    options = replace(options, timed=dt is not None)
    layout = laid_out(table, options, robot)
    table = _without_odd_rows(table, layout, options, notes)
    found, robot = channels_of(table, layout, options, robot, notes)
    names = _check_joints(table, found, robot)
    channels, units = _in_units(table, layout, found, options, notes)
    slides = _check_units(table, found, units, names, model_names, prismatic)
    given = units.get("tau", [None] * len(names))
    recorded = _gained(table, channels, given, None, names, slides)
    torque_units = _gained(table, channels, given, gains, names, slides)
    # Without torques `_driven` has them when all files are read.
    channels.setdefault("tau", np.zeros(channels["q"].shape))
    if model_names:
        # The order of the model, whatever that of the file.
        order = sorted(range(len(names)), key=lambda j: model_names.index(names[j]))
        names, slides, torque_units, recorded = (
            [x[j] for j in order] for x in (names, slides, torque_units, recorded)
        )
        channels = {kind: values[:, order] for kind, values in channels.items()}
    t, time = _time(table, layout, dt, time_unit)
    labels, segment = _segments(table, layout)
    taken = {role.column for own in layout.channels.values() for role in own.roles}
    taken |= {segment, *(() if time is None else time.columns), *layout.beside}
    taken |= {x for role in layout.times if layout.what for x in role.columns}
    signals, left_out = _signals(table, taken, notes)
    own = torque_units[0] if len(set(torque_units)) == 1 else ""
    _say_what_was_taken(table, layout, options, found, time, time_unit, own, notes)
    notes += _unit_notes(table, layout, options, names, torque_units, gains)
    channels |= signals
    if t is not None and labels is None:
        t, channels, table = in_order(table, t, channels, notes)
    fields = on_grid(table, t, labels, dt, channels, notes)
    recording = Recording(
        name=_name_of(path, table),
        joint_names=tuple(names),
        position_units=tuple("m" if slide else "rad" for slide in slides),
        torque_units=tuple(torque_units),
        urdf=None if urdf is None else fspath(urdf),
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


def _without_odd_rows(table, layout, options, notes):
    """Hold commands, leave out blank rows and those of a second source."""
    roles = {kind: own.roles for kind, own in layout.channels.items()}
    q, tau = roles.get("q", []), roles.get("tau", [])
    if options.drive is None:
        table = without_blank_rows(table, [*q, *tau], notes)
        return without_second_source(table, q, tau, notes)
    told = [x for kind in options.told if kind != "tau" for x in roles.get(kind, [])]
    table = with_commands_held(table, told, notes)
    return without_blank_rows(table, q, notes)


def _in_units(table, layout, found, options, notes):
    """Return channels in the package's units, and the bases of the units they had."""
    for kind, measured in MEASURED.items():
        own, of = found.get(kind, []), found.get(measured, [])
        if kind in options.told and len(own) == len(of):
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


def _unit_notes(table, layout, options, names, torque_units, gains):
    """Yield what a user should know of the unit of the torques."""
    if gains is not None or options.drive is not None:
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


@contextlib.contextmanager
def _finished(path):
    """Refuse a file that is written to while it is read."""
    before = _version(path)
    try:
        yield
    except ValueError as error:
        if _version(path) == before:
            raise
        raise _unfinished(path) from error
    if _version(path) != before:
        raise _unfinished(path)


def _version(path):
    """Return size and time of a file, or of all in a folder; None for what is none."""
    path = expanded(path)
    if path.is_file():
        found = [path.stat()]
    elif path.is_dir():
        found = [file.stat() for file in path.rglob("*") if file.is_file()]
    else:
        return None
    size = sum(one.st_size for one in found)
    return len(found), size, max((one.st_mtime_ns for one in found), default=0)


def _unfinished(path):
    return ValueError(
        f"{path} was written to while it was read; wait until the recording has ended, "
        "then read it again."
    )


def _name_of(path, table):
    """Return the name of a recording: of its file, or of the folder of several."""
    folder = common_folder(path) if isinstance(path, tuple) else ""
    return folder or _stem(table.path)


def _stem(path):
    """Return the name of a recording, without any of its endings."""
    stem = path.stem
    return (
        stem.rpartition(".")[0] or stem
        if path.suffix in (".gz", ".bz2", ".xz")
        else stem
    )


# -- columns ---------------------------------------------------------------------------


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
    """Return a column as finite floats, or say which cell is none."""
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
    """Return gains that stand beside the columns, and note what a drive lacks."""
    found, shape = {}, channels["q"].shape
    for kind in options.told:
        once = table.scalars.get(kind)
        if kind not in channels and once is not None and once.dtype.kind in "iuf":
            if once.shape not in {(), (1,), shape[1:]}:
                raise ValueError(
                    f"{table.path}: {kind} has the shape {once.shape}; expected one "
                    f"number for each of {shape[1]} joints, or one in every row."
                )
            found[kind] = np.broadcast_to(once.astype(float), shape).copy()
    rate = "v_desired" in options.told and "v_desired" not in channels
    if rate and not getattr(options.drive, "feedforward", False):
        notes.append(
            "no desired velocities (v_desired): taken as zero, so that kd damps all "
            "motion."
        )
    return found


def _driven(recording, drive, files):
    """Return a recording with the torques that a drive makes of its channels."""
    # The noise of a torque is that of the positions that it is made of.
    if drive.gains is None:
        own = ["N" if unit == "m" else "N m" for unit in recording.position_units]
        recording = replace(recording, torque_units=tuple(own))
    recording = replace(recording, torque_noise=None)
    if drive.spelled:
        channels = {**recording.signals, drive.told: recording.tau}
        recording = replace(recording, signals=channels)
    try:
        return drive.driven(recording)
    except ValueError as error:
        raise ValueError(f"{listed_paths([x.path for x in files])}: {error}") from error


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


def _checked_preset(name):
    """Return a preset as it is spelled here, None for None; refuse unknown ones."""
    found = None if name is None else str(name).lower()
    if found is not None and found not in PRESETS:
        raise ValueError(
            f"preset must be one of {', '.join(PRESETS)}; got {name!r}. For other "
            'names give columns, such as "q=position_{i},tau=effort_{i},t=time".'
        )
    return found


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


def _say_what_was_taken(
    table, layout, options, found, time, time_unit, torque_unit, notes
):
    """Note, in one line, which columns were taken where the names do not say it."""
    stamped = ""
    if time is not None:
        unit = time_unit or time.unit or "s"
        stamped = f"t = {_with_unit('+'.join(time.columns), unit)}"
    if layout.what:
        said = []
        for kind in [x for x in ("q", *options.told) if found[x]]:
            unit = found[kind][0].unit or (torque_unit if kind == "tau" else "")
            said.append(f"{kind} = {_with_unit(_ends(found[kind]), unit)}")
        said = ", ".join(x for x in (*said, stamped) if x)
        notes.insert(0, f"taken as {layout.what}: {said}.")
        return
    said = []
    if not options.mapping:
        if time is not None and time.column not in ("t", "T"):
            said.append(stamped)
        kinds = () if options.drive is None else (*options.told, "v")
        said += [
            f"{kind} = {_ends(found[kind])}"
            for kind in kinds
            if found[kind] and not found[kind][0].column.lower().startswith(kind)
        ]
        own = found["tau"] if options.drive is None else []
        if own and own[0].column.lower().startswith(ESTIMATES):
            said.append(f"tau = {_ends(own)}, which the motors estimate")
    converted = {
        role.unit
        for kind, roles in found.items()
        for role in roles
        if role.unit and channel_unit(table, kind, role).factor != 1
    }
    if converted:
        said.append(f"converted from {', '.join(sorted(converted))}")
    if said:
        notes.insert(0, f"{'; '.join(said)}.")


def _ends(roles):
    """Return the first and the last of some columns."""
    first, last = roles[0].column, roles[-1].column
    return first if len(roles) == 1 else f"{first} ... {last}"


def _with_unit(columns, unit):
    """Return columns with the unit behind them, unless their names have it there."""
    if not unit or split_unit(columns)[1] == unit:
        return columns
    return f"{columns} [{unit}]"


# -- time ------------------------------------------------------------------------------


def _time(table: Table, layout, dt, time_unit):
    """Return stamps [s] or None, and the role of their column."""
    times = layout.times
    own = [x for x in times if name_and_unit(table, x.column)[0].lower() == "t"]
    if dt is not None and not (layout.certain or own):
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
        t = None
        if not role.nanoseconds:
            t = seconds_of_dates(table, role.column)
        if t is not None:
            return t, replace(role, unit="s")
        values = [_numbers(table, part) for part in role.columns]
        t = values[0] - values[0][0]
        unit = channel_unit(table, "t", role)
        factor = 1.0 if unit is None else unit.factor
        if time_unit is not None and not role.nanoseconds:
            factor = TIME_UNITS[time_unit]
        t = t * factor
        if role.nanoseconds:
            t = t + 1e-9 * (values[1] - values[1][0])
        if np.ptp(t) > 0 or role is times[-1]:
            _check_unit(table, role, values[0], usual_step(t), time_unit)
            # Without a unit stamps stay as they are, for messages that quote them.
            exact = values[0] if factor == 1.0 and not role.nanoseconds else t
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
