"""Reading of recordings from files and folders, separately or joined."""

import itertools
import re
import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from os import PathLike, fspath

import numpy as np

from sklearn_vbjfa._core._runtime import counted
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.recording._clock import GAP_PERIODS, STEADY, nanoseconds
from sklearn_vbjfa.recording._conversion import is_recording, read_rows
from sklearn_vbjfa.recording._drives import Drive
from sklearn_vbjfa.recording._grid import resample_files
from sklearn_vbjfa.recording._layout import ReadOptions, assign_by_name, channel_unit
from sklearn_vbjfa.recording._recording import Recording
from sklearn_vbjfa.recording._table import (
    Loss,
    NotATable,
    RecordingRefused,
    Table,
    channels_in,
    imported,
    is_current,
    listed,
    split_unit,
)
from sklearn_vbjfa.recording.formats import expand, read_table, tables_in


def join_tables(tables, joints) -> Table:
    """Join the tables of one recording at the time stamps of the positions."""
    # joints: joint names of the robot, empty if unknown.
    if len(tables) == 1:
        # Leave no reference in the list, which would keep the table in memory.
        return tables.pop()
    path = tables[0].path.parent
    if len(tables) == 2:
        path /= "+".join(table.path.name for table in tables)
    named = [x for x in (_name_by_file(x, joints) for x in tables) if x is not None]
    if len(named) < 2:
        raise ValueError(
            f"{path}: fewer than two of {listed([x.path.name for x in tables])} can be "
            "joined; name them after what they hold, such as positions or torques."
        )
    # Tables with time stamps first, among these the table of positions.
    layouts = [(x, assign_by_name(x, joints)) for x in named]
    layouts.sort(key=lambda x: (not x[1].select("t"), "q" not in x[1].kinds))
    (base, base_layout), *others = layouts
    t = _seconds(base, base_layout)
    rows = np.array(
        [_row_indices(part, base, _seconds(part, layout), t) for part, layout in others]
    )
    keep = np.flatnonzero(np.isfinite(rows).all(axis=0))
    if not keep.size:
        raise ValueError(
            f"{path}: the files have no time in common; expected one clock in one unit."
        )
    notes = [f"{x.path.name}: {y}" for x in named for y in x.notes]
    kinds = {x.path.name: ", ".join(sorted(y.kinds)) or "signals" for x, y in layouts}
    notes.append(
        f"{len(named)} files joined to one recording, by the rows of {base.path.name}: "
        f"{listed(f'{name} ({kinds[name]})' for name in sorted(kinds))}."
    )
    lost = len(base.frame) - keep.size
    if lost:
        notes.append(
            f"{lost} row(s) of {base.path.name} are not in all files: left out."
        )
    unused = {x.path.name for x in tables} - {x.path.name for x in named}
    if unused:
        notes.append(f"{listed(sorted(unused))}: not needed, left out.")
    frame = base.frame.iloc[keep]
    columns = {x: frame[x] for x in frame}
    for (part, layout), indices in zip(others, rows[:, keep]):
        part = replace(part, frame=part.frame.drop(columns=layout.stamps))
        columns |= _align_columns(path, columns, part, indices, layout)
    return Table(
        path=path,
        name=common_folder([table.path for table in tables]),
        frame=imported(path, "pandas").DataFrame(columns, index=frame.index),
        place=f"{base.place} of {base.path.name}",
        scalars={key: x for table in named for key, x in table.scalars.items()},
        joints=next((x.joints for x in named if x.joints), ()),
        notes=tuple(notes),
    )


def _align_columns(path, columns, part, indices, layout):
    """Return the columns of a file at fractional row indices, by interpolation."""
    aligned = {}
    for name in part.frame:
        values = part.values(name)
        if values.dtype.kind in "iuf" and (indices % 1).any():
            values = np.interp(indices, np.arange(len(values)), values)
        else:
            values = values[indices.astype(int)]
        if name in columns and not np.array_equal(columns[name], values):
            channels = (x for x in layout.roles if x.kind not in ("t", "segment"))
            if name in {x.column for x in channels}:
                raise ValueError(
                    f"{path}: column {name!r} is in {part.path.name} and in another "
                    "file, with other values; leave one of the files out, or rename "
                    "the column."
                )
            name = f"{part.path.stem}.{name}"
        aligned[name] = values
    return aligned


def _name_by_file(table: Table, joints):
    """Return a table, with columns named by its file name if they have no channel."""
    stem, n = table.path.stem, table.frame.shape[1]
    kinds = channels_in(stem)
    kind = kinds.pop() if len(kinds) == 1 else ""
    if kind in ("command", "other") or (table.nameless and not kind):
        return None
    # Without column names, an additional first column holds the time.
    has_time = n != len(joints) > 0 and n in (2, len(joints) + 1)
    if table.nameless and (kind == "t" or has_time):
        table = replace(table, frame=table.frame.rename(columns={"1": "t"}))
    assigned = assign_by_name(table, joints)
    if kind in ("", "t") or assigned.kinds - {"t", "segment"}:
        return table
    columns = [x for x in table.frame if x not in assigned.stamps]
    names = _joint_columns(columns, kind, joints, stem)
    for old, new in names.items():
        unit = split_unit(old)[1] or ("A" if is_current(stem) else "")
        names[old] = f"{new} [{unit}]" if unit else new
    return replace(table, frame=table.frame.rename(columns=names))


def _joint_columns(columns, kind, joints, stem):
    """Return new names of columns, by joint names if all have one, else by numbers."""
    # The file name of a single column may contain its joint's name or number.
    single = len(columns) == 1 < len(joints)
    number = re.search(r"\d+$", stem)
    # If several joint names occur in a column's name, the longest applies.
    texts = [stem] if single else columns
    joint_of = [max((j for j in joints if j in x), key=len, default="") for x in texts]
    if all(joint_of) and len(set(joint_of)) == len(joint_of):
        return {x: f"{kind}_{joint}" for x, joint in zip(columns, joint_of)}
    first = int(number[0]) if single and number else 1
    return {x: f"{kind}{k}" for k, x in enumerate(columns, start=first)}


def _seconds(table, layout):
    """Return the stamps of a file [s], None if it has none."""
    for role in layout.select("t")[:1]:
        dates, values = nanoseconds(table, role.column), table.values(role.column)
        if dates is not None:
            return 1e-9 * dates
        unit = channel_unit(table, role)
        values = values if values.dtype.kind in "iuf" else table.numbers(role.column)
        return values if unit is None else unit.factor * values
    return None


def _row_indices(part, base, t, base_t):
    """Return fractional row indices in a file of the base's rows, nan if outside."""
    # t, base_t: time stamps of the file and of the base [s].
    n, name = len(part.frame), base.path.name
    if t is None or base_t is None:
        if n != len(base.frame):
            raise ValueError(
                f"{part.path}: has {n} rows and {name} has {len(base.frame)}: cut both "
                "to the same rows, or give each a column t."
            )
        return np.arange(float(n))
    if np.array_equal(t, base_t):
        return np.arange(float(n))
    step = np.diff(t)
    if (step <= 0).any():
        raise ValueError(
            f"{part.path}: time must increase from row to row to join it with {name}; "
            "sort it, and remove duplicates."
        )
    if not 0.01 < np.ptp(t) / max(np.ptp(base_t), 1e-300) < 100.0:
        raise ValueError(
            f"{part.path}: the times span {np.ptp(t):.4g} and those of {name} "
            f"{np.ptp(base_t):.4g}; write both in one unit, or the unit into the name "
            "of the column (t_ms)."
        )
    period = np.median(step)
    rows = np.interp(base_t, t, np.arange(n))
    # Time stamps that differ by rounding are equal.
    nearest = np.rint(rows).astype(int)
    rows = np.where(np.abs(t[nearest] - base_t) <= STEADY * period, nearest, rows)
    outside = (base_t < t[0] - STEADY * period) | (base_t > t[-1] + STEADY * period)
    # Do not interpolate across gaps.
    in_gap = step[np.minimum(rows.astype(int), n - 2)] > GAP_PERIODS * period
    rows[outside | (in_gap & (rows % 1 != 0))] = np.nan
    return rows


# Interval within which the size of a file that is being written changes [s].
_WRITE_INTERVAL = 0.05
# Maximum number of files named in a note.
_MAX_NAMES = 3


def read_recording(
    path: str | PathLike | Sequence[str | PathLike],
    *,
    dt: float | None = None,
    urdf: str | PathLike | None = None,
    joint_names: tuple[str, ...] | None = None,
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
        One row per sample, in a format of ``docs/log_formats.rst``; "-" for standard
        input. Columns: positions q1 ... qn [rad or m], torques tau1 ... taun [N m or
        N]; optionally v1 ... vn, a1 ... an, t [s or dates] and segment. Numbers may be
        joint names (q_shoulder), and a unit may follow (q1 [deg], t_ms). Several files,
        or a folder of them, are several recordings of one robot.
    dt : float, default=None
        Sample period [s]; required if there is no time.
    urdf : str or os.PathLike, default=None
        URDF or MJCF file of the robot, for the names and order of its joints. Joints
        without columns of their names are held at zero.
    joint_names : sequence of str, default=None
        Joints in the order of the columns; the others of `urdf`, such as wheels and
        fingers, are held at zero. None takes all of `urdf`, or joint_1, ...
    columns : str or dict of str to str, default=None
        Columns by channel, such as
        "q=actual_q_{i},tau=actual_current_{i},t=timestamp": {i} is the number of a
        joint and {joint} its name; a unit may follow ("q=pos_{i} [deg]"). Single joints
        are q1=..., tau_elbow=.... For a table without names, "t=1,q=2-7,tau=8-13" gives
        the places of the columns, from 1.
    preset : {"ros", "ur", "franka", "lerobot", "unitree"}, default=None
        Take names as these tools write them; None recognises them.
    topic : str, default=None
        Topic of a bag; None takes the only one of joint states.
    gains : sequence of float or "unknown", default=None
        Factors [N m or N per unit] of the recorded torques, one for each joint in the
        order of `joint_names` or else of `urdf`. "unknown" keeps the unit.
    time_unit : {"s", "ms", "us", "ns", "days"}, default=None
        Unit of time; None takes that in the name of the column, or seconds.
    drive : Drive or str, default=None
        Control law of the motors if no torque was measured: a `PDDrive`, or a text such
        as ``"pd kp=20,20,40 kd=1,1,2"`` (``docs/drives.rst``). The columns of its
        channels, such as q_desired1 ..., replace those of the torques.
    join : bool, default=False
        Whether files are one recording, such as positions.csv and torques.csv, at the
        stamps of the positions; default for a folder with less than two full files.

    Returns
    -------
    recording : Recording
        On a uniform time grid, in the units and joint order of the package. Other
        numeric columns are in `signals`, accelerations as "a", and the channels of a
        `drive`.

    Raises
    ------
    OSError
        If a file does not exist or cannot be read.
    ImportError
        If pandas, or a package that the format needs, is missing.
    ValueError
        If a file is damaged or changes while it is read, channels are missing or
        ambiguous, a value is not finite, or time, `dt` and files contradict each
        other. Its attribute ``options`` has options that would read the file.

    Warns
    -----
    UserWarning
        If names were recognised as those of a tool, torques are motor currents, time
        stamps are irregular, or rows are missing or repeated.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from sklearn_vbjfa.datasets import read_recording
    >>> rows = [f"{0.01 * k:.2f},{0.1 * k},{1.0}\n" for k in range(20)]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder) / "hinge.csv"
    ...     _ = file.write_text("clock,angle,torque\n" + "".join(rows))
    ...     read_recording(file, columns="q=angle,tau=torque,t=clock")
    Recording 'hinge': 20 samples, 1 joint, dt = 0.01 s
    """
    arguments = columns, preset, dt, joint_names, gains, time_unit, drive, urdf, topic
    options = ReadOptions(*arguments)
    paths = [path] if isinstance(path, (str, PathLike)) else [*path]
    paths = list(dict.fromkeys(map(expand, paths)))
    if not paths:
        raise ValueError("path must name one file or more, got none.")
    notes: list[str] = []
    try:
        files = _read_files(paths, join, options, notes)
    except RecordingRefused as error:
        if len(paths) > 1 and error.options and not join:
            # Options suggested for one file must be able to read the others, too.
            try:
                _read_files(paths, join, replace(options, **error.options), [])
            except RecordingRefused as other:
                # An error that no option corrects is reported first.
                if not other.options:
                    raise
                reason = f"{error.reason}; other files are not so: convert those"
                raise RecordingRefused(f"{reason} that differ.") from other
        raise
    several = len(files) > 1 or not (join or isinstance(path, (str, PathLike)))
    recording = _combine(files, several, options.urdf, notes)
    if options.drive is not None:
        recording = _apply_drive(recording, options.drive, files)
    for note in [*notes, *_merge_notes(files)]:
        category = DoubtWarning if isinstance(note, Loss) else UserWarning
        warnings.warn(note, category, stacklevel=2)
    return recording


def _apply_drive(recording, drive, files):
    """Return a recording with the torques that a drive computes from its channels."""
    units, signals = recording.torque_units, recording.signals
    if drive.gains is None:
        units = tuple("N" if x == "m" else "N m" for x in recording.position_units)
    if drive.aliases:
        signals = {**signals, drive.channel: recording.tau}
    # The noise of these torques results from the noise of the positions.
    recording = replace(
        recording, torque_units=units, signals=signals, torque_noise=None
    )
    try:
        return drive.driven(recording)
    except ValueError as error:
        raise ValueError(f"{_shorten(x.path for x in files)}: {error}") from error


def _read_tables(path, options, notes):
    """Read the table of a file, or the tables of a folder that contain numbers."""
    files = tables_in(path)
    if len(files) < 2:
        return [_read_settled(files[0] if files else path, options)]
    others = [x.name for x in sorted(path.iterdir()) if x.is_file()]
    others = [x for x in others if not x.startswith(".") and path / x not in files]
    tables = []
    for file in files:
        try:
            tables.append(_read_settled(file, options))
            if not tables[-1].frame.select_dtypes("number").size:
                raise NotATable(f"{tables.pop().path}: has no column of numbers.")
        except NotATable as error:
            others.append(file.name)
            reason = error
    if not tables:
        raise reason
    if others:
        notes.append(f"{path}: no tables of numbers in {listed(others)}: left out.")
    return tables


def _read_files(paths, join, options, notes):
    """Return the rows of each recording; incomplete files of a folder are joined."""
    files, groups = [], [paths] if join else [[path] for path in paths]
    for group in counted(groups, "reading file", len(groups)):
        tables = [x for path in group for x in _read_tables(path, options, notes)]
        complete = (x for x in tables if len(tables) > 1 and is_recording(x, options))
        if join or len([*itertools.islice(complete, 2)]) < 2:
            tables = [join_tables(tables, options.joints)]
        else:
            what = f"a folder of {len(tables)} recordings, one a file"
            notes.append(f"{group[0]} is taken as {what}.")
        files += [read_rows(tables.pop(0), options) for _ in range(len(tables))]
    return files


def _read_settled(path, options):
    """Read the table of a file; refuse one that changes while it is read."""
    before = _file_versions(path)
    try:
        return read_table(path, options.topic)
    except ValueError:
        # Wait until a file that is still being written has changed.
        time.sleep(_WRITE_INTERVAL)
        raise
    finally:
        if _file_versions(path) != before:
            raise ValueError(
                f"{path} was written to while it was read; wait until the recording "
                "has ended, then read it again."
            )


def _file_versions(path):
    """Return size and modification time of a file, or of all files of a folder."""
    files = [path] if path.is_file() else path.rglob("*") if path.is_dir() else []
    stats = [file.stat() for file in files if file.is_file()]
    return sorted((stat.st_size, stat.st_mtime_ns) for stat in stats)


def common_folder(paths):
    """Return the name of the common parent folder of files, "" if they differ."""
    folders = {expand(path).parent.resolve() for path in paths}
    return folders.pop().name if len(folders) == 1 else ""


def _merge_notes(files):
    """Yield each distinct note once, with the paths of its files."""
    names: dict[tuple, dict] = {}
    for file in files:
        for note in file.notes:
            names.setdefault((type(note), str(note)), {})[str(file.path)] = None
    for (kind, note), paths in names.items():
        yield kind(f"{_shorten(paths)}: {note}")


def _shorten(paths):
    """List paths of files, shortened after the first few."""
    shown = [str(path) for path in paths]
    more = len(shown) - _MAX_NAMES
    return ", ".join(shown[:_MAX_NAMES]) + f" and {more} more" * (more > 0)


def _combine(files, several, urdf, notes):
    first = files[0]
    for file, field in itertools.product(files, first.robot):
        value, other = first.robot[field], file.robot[field]
        if value != other and field != "joints_named":
            raise ValueError(
                f"{first.path} has the {field.replace('_', ' ')} {listed(value)} and "
                f"{file.path} {listed(other)}; expected files with the same joints and "
                "channels: correct one of them, or process them separately."
            )
    channels = dict.fromkeys(x for file in files for x in file.channels)
    lost = [x for x in channels if any(x not in file.channels for file in files)]
    for file, name in itertools.product(files, lost):
        file.channels.pop(name, None)
    # Recordings are named after their files, by complete paths if names are equal.
    names = [file.name for file in files]
    names = [x if names.count(x) == 1 else str(y.path) for x, y in zip(names, files)]
    fields = resample_files(files, names if several else [""])
    if lost:
        notes.append(f"column(s) {listed(lost)} are not in all files and are left out.")
    return Recording(
        name=(several and common_folder([x.path for x in files])) or first.name,
        urdf=None if urdf is None else fspath(urdf),
        description=f"Read from {listed([x.path.name for x in files])}.",
        **first.robot,
        **fields,
    )
