"""A user's recording out of files and folders."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from sklearn_vbjfa._core._progress import counted
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.recording import formats
from sklearn_vbjfa.recording._conversion import is_recording, recording_of
from sklearn_vbjfa.recording._drives import Drive, parse_drive
from sklearn_vbjfa.recording._layout import parse_mapping
from sklearn_vbjfa.recording._names import ReadOptions
from sklearn_vbjfa.recording._presets import PRESETS
from sklearn_vbjfa.recording._recording import Recording, check_dt
from sklearn_vbjfa.recording._several import (
    common_folder,
    concatenated,
    joined,
    listed_paths,
    notes_of,
)
from sklearn_vbjfa.recording._table import Loss, NotATable, RecordingRefused, listed
from sklearn_vbjfa.recording._units import TIME_UNITS
from sklearn_vbjfa.recording.formats import expanded, read_table, tables_in


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
        a bag of ROS 1 or 2 or an MCAP file with JointState; the folder of a LeRobot
        data set; "-" for standard input. Columns: positions q1 ... qn [rad or m],
        torques tau1 ... taun [N m or N]; optionally v1 ... vn [rad/s or m/s], a1 ... an
        [rad/s^2 or m/s^2], t [s or dates] and segment, the label of separate
        recordings. Numbers may count from 0 or be joint names (q_shoulder), and a unit
        may follow (q1 [deg], t_ms) or stand in a row below the names. Several files, or
        a folder of them, are several recordings of one robot, or with `join` one.
    dt : float, default=None
        Sample period [s]; required if there is no time.
    urdf : str or os.PathLike, default=None
        URDF or MJCF file of the robot, for the names and order of its joints. Joints
        without columns of their names are held at zero.
    joint_names : sequence of str, default=None
        Joints in the order of the columns; the others of `urdf`, such as wheels and
        fingers, are held at zero. None takes all of `urdf`, or joint_1, ...
    name : str, default=None
        Name of the recording; None is that of the file, or of the folder of several.
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
    time_unit : {"s", "ms", "us", "ns"}, default=None
        Unit of time; None takes that in the name of the column, or seconds.
    drive : Drive or str, default=None
        Control law of the motors if no torque was measured: a `PDDrive`, or a text such
        as ``"pd kp=20,20,40 kd=1,1,2"`` (``docs/drives.rst``). The columns of its
        channels, such as q_desired1 ..., replace those of the torques; in an npz file
        gains may be one number for each joint.
    join : bool, default=False
        Whether several files are one recording, such as positions.csv and torques.csv.
        The rows are those of the file with the positions; other files are interpolated
        linearly at its time stamps, or without stamps taken row by row. Where columns
        do not tell the channel, the name of the file does. A folder is joined if fewer
        than two of its files can be read alone.

    Returns
    -------
    recording : Recording
        On a uniform time grid, in the units and joint order of the package. Other
        numeric columns are in `signals`, accelerations as "a", and the channels of a
        `drive`; `left_out` says what is wrong with other columns. Where rows were
        interpolated, `torque_noise` is the white noise of the torques before, and
        commands hold their last value.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ImportError
        If pandas or a package that the format needs is missing (PACKAGES), or Pinocchio
        for `urdf`.
    OSError
        If the file cannot be read.
    ValueError
        If the file is damaged or written to while it is read, channels are missing or
        ambiguous, a value is not finite or beyond 1e12, time is missing or contradicts
        `dt`; if several files have other joints, channels or periods, or are copies.
        Where other options would read the file, the attribute ``options`` has them.

    Warns
    -----
    UserWarning
        If names were recognised as those of a tool, torques are motor currents, time
        stamps are irregular (rows are interpolated if positions follow the stamps, else
        taken as equidistant), rows are missing (up to five are interpolated, the
        recording is split at more), or rows or stamps are repeated.

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
    if time_unit is not None and time_unit not in TIME_UNITS:
        raise ValueError(
            f"time_unit must be one of {', '.join(TIME_UNITS)}; got {time_unit!r}."
        )
    options = ReadOptions(
        mapping={} if columns is None else parse_mapping(columns),
        preset=_checked_preset(preset),
        dt=dt,
        urdf=urdf,
        joint_names=joint_names,
        topic=topic,
        gains=_checked_gains(gains),
        time_unit=time_unit,
        drive=parse_drive(drive) if isinstance(drive, str) else drive,
    )
    if options.drive is not None and gains is not None:
        raise RecordingRefused(
            "gains are factors of columns of torques, and a drive has its own: leave "
            "gains out (command line: --gain), or the drive.",
            {"gains": None},
        )
    is_one = isinstance(path, (str, PathLike))
    given = [path] if isinstance(path, (str, PathLike)) else [Path(x) for x in path]
    paths = list(dict.fromkeys(given))
    if not paths:
        raise ValueError("path must name one file or more, got none.")
    notes: list[str] = []
    if join:
        tables = [one for path in paths for one in tables_in(path) or [Path(path)]]
        files = [_joined([_table(one, options) for one in tables], options)]
    else:
        files = _read(paths, options, notes)
    if len(files) == 1 and (join or is_one):
        recording, more = files[0].recording, notes_of(files)
        recording = replace(recording, name=name) if name else recording
    else:
        recording, more = concatenated(files, name)
    if options.drive is not None:
        recording = _driven(recording, options.drive, files)
    for note in (*notes, *more):
        category = DoubtWarning if isinstance(note, Loss) else UserWarning
        warnings.warn(note, category, stacklevel=2)
    return recording


if read_recording.__doc__:  # not if Python leaves docstrings out
    read_recording.__doc__ = read_recording.__doc__.replace(
        "TABLES", formats.TABLES
    ).replace("PACKAGES", formats.PACKAGES)


def _read(paths, options, notes):
    """Read files and folders, each a recording or several."""
    files = []
    for path in counted(paths, "reading", "files"):
        try:
            inside = tables_in(path)
            if len(inside) > 1:
                files += _of_folder(expanded(path), inside, options, notes)
            else:
                (path,) = inside or [path]
                files.append(recording_of(_table(path, options), options))
        except RecordingRefused as error:
            if not files:
                raise
            # The files before it were read without the options that it offers.
            raise RecordingRefused(error.reason) from error
    return files


def _of_folder(folder, paths, options, notes):
    """Read the tables of a folder: one recording each, or one in all."""
    others = [x.name for x in sorted(folder.iterdir()) if x.is_file()]
    others = [x for x in others if not x.startswith(".") and folder / x not in paths]
    files, parts, whole = [], [], 0
    for path in paths:
        try:
            table = _table(path, options)
            if not table.has_numbers:
                raise NotATable(f"{path}: has no column of numbers.")
        except NotATable as error:
            others.append(path.name)
            reason = error
            continue
        parts.append(table)
        whole += is_recording(table, options)
        if whole > 1:
            files += [recording_of(one, options) for one in parts]
            parts = []
    if not (files or parts):
        raise reason
    if others:
        notes.append(f"{folder}: no tables of numbers in {listed(others)}: left out.")
    if files:
        notes.append(
            f"{folder} is taken as a folder of {len(files)} recordings, one a file."
        )
    return files or [_joined(parts, options)]


def _joined(tables, options):
    """Return the recording of tables side by side."""
    if len(tables) == 1:
        return recording_of(tables[0], options)
    first, *others = [table.path for table in tables]
    more = others[0].name if len(others) == 1 else f" {len(others)} more"
    shown = f"{first.name}{'+' if len(others) == 1 else ' and'}{more}"
    read = recording_of(joined(tables, options.joints, first.parent / shown), options)
    name = common_folder([one.path for one in tables]) or read.recording.name
    return replace(read, recording=replace(read.recording, name=name))


def _table(path, options):
    """Read the table of a file that nobody writes to meanwhile."""
    before, broken, table = _version(path), None, None
    try:
        commanded = "q_desired" in options.recorded
        table = read_table(path, options.topic, lambda: options.joints, commanded)
    except ValueError as error:
        broken = error
    if _version(path) != before:
        raise ValueError(
            f"{path} was written to while it was read; wait until the recording has "
            "ended, then read it again."
        ) from broken
    if broken is not None:
        raise broken
    return table


def _version(path):
    """Return size and time of a file, or of all in a folder; None for what is none."""
    path = expanded(path)
    found = [path] if path.is_file() else path.rglob("*") if path.is_dir() else []
    stats = [file.stat() for file in found if file.is_file()]
    size = sum(one.st_size for one in stats)
    return len(stats), size, max((one.st_mtime_ns for one in stats), default=0)


def _checked_preset(name):
    """Return the spelling of a preset, None for None; refuse unknown ones."""
    found = None if name is None else str(name).lower()
    if found is not None and found not in PRESETS:
        raise ValueError(
            f"preset must be one of {', '.join(PRESETS)}; got {name!r}. For other "
            'names give columns, such as "q=position_{i},tau=effort_{i},t=time".'
        )
    return found


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
