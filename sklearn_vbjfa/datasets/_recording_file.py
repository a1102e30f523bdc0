"""A user's recording out of a file, with its time stamps checked."""

import re
import warnings
from os import PathLike, fspath

import numpy as np

from sklearn_vbjfa.datasets._recording import Recording, _check_dt
from sklearn_vbjfa.datasets._stamps import (
    GAP_PERIODS,
    inspect_time_stamps,
    interpolate,
)
from sklearn_vbjfa.datasets._table_file import Table, read_table

# Fewer samples than this between two gaps cannot be differentiated.
_MIN_SAMPLES = 10
# Relative difference between the periods of segments.
_DT_TOLERANCE = 0.05


def read_recording(
    path: str | PathLike,
    *,
    dt: float | None = None,
    urdf: str | PathLike | None = None,
    joint_names: tuple[str, ...] | None = None,
    name: str | None = None,
) -> Recording:
    r"""Read a recording of one's own robot from CSV, npz or parquet.

    Parameters
    ----------
    path : str or os.PathLike
        File with one row per sample. Columns: positions q1 ... qn [rad or m] and
        torques tau1 ... taun [N m or N]; where they exist v1 ... vn [rad/s or m/s],
        a1 ... an [rad/s^2 or m/s^2], t [s] and segment, the label of separate
        recordings (contiguous rows). Also q_1, q[1], counted from 0, or with the
        joint's name, such as q_shoulder. In an npz file also matrices q, tau, ... and
        a number dt. Text is separated by comma, semicolon, tab or blanks, # begins a
        comment.
    dt : float, default=None
        Sample period [s]; needed if there is no column t.
    urdf : str or os.PathLike, default=None
        Description of the robot: gives the joints' names and order, which must agree
        with the columns.
    joint_names : sequence of str, default=None
        Joints in the order of the columns; with `urdf` some of its joints (the others,
        such as wheels and fingers, are then held at zero). None takes all of `urdf`,
        or joint_1, ...
    name : str, default=None
        Name of the recording; None is that of the file.

    Returns
    -------
    recording : Recording
        On a uniform time grid. Other numeric columns are in its `signals`, as are the
        accelerations ("a").

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ImportError
        If a parquet file is to be read without pyarrow, or `urdf` without Pinocchio.
    ValueError
        If the file is damaged or not what its ending says, columns are missing or of
        the wrong number, a value is no finite number, time stands still or runs
        backwards, or there is neither t nor `dt`. The message names the file, what
        was expected and what to do.

    Warns
    -----
    UserWarning
        If time stamps are irregular: the samples are then interpolated on a uniform
        grid, from the neighbouring ones only. If stamps leave out more than five
        periods: the recording is split there.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from sklearn_vbjfa.datasets import read_recording
    >>> rows = [f"{0.01 * k:.2f},{0.1 * k},{1.0}" for k in range(20)]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder) / "hinge.csv"
    ...     _ = file.write_text("t,q1,tau1\n" + "\n".join(rows))
    ...     read_recording(file)
    Recording 'hinge': 20 samples, 1 joint, dt = 0.01 s, 1 recording
    """
    if dt is not None:
        _check_dt(dt)
    table = read_table(path)
    if joint_names is None and "joint_names" in table.scalars:
        joint_names = [str(x) for x in np.atleast_1d(table.scalars["joint_names"])]
    names = _strings(joint_names)
    model_names, prismatic = _robot(urdf, names)
    names = names or model_names
    channels, taken = {}, set()
    for kind in ("q", "tau", "v", "a"):
        values, used = _channel(table, kind, names)
        taken |= used
        if values is not None:
            channels[kind] = values
    names = _check_joints(table, channels, names)
    if model_names:
        # The order of the model, whatever that of the file.
        order = sorted(range(len(names)), key=lambda j: model_names.index(names[j]))
        names = tuple(names[j] for j in order)
        channels = {kind: values[:, order] for kind, values in channels.items()}
    t, labels, special = _time_and_segments(table)
    taken |= special
    notes = []
    signals = _signals(table, taken, notes)
    dt = _given_period(table, dt, t)
    fields = _on_grid(table, t, labels, dt, {**channels, **signals}, notes)
    for note in notes:
        warnings.warn(f"{table.path}: {note}", UserWarning, stacklevel=2)
    slides = [model_names and prismatic[model_names.index(x)] for x in names]
    return Recording(
        name=name or table.path.stem,
        joint_names=names,
        position_units=tuple("m" if slide else "rad" for slide in slides),
        torque_units=tuple("N" if slide else "N m" for slide in slides),
        urdf=None if urdf is None else fspath(urdf),
        description=f"Read from {table.path.name}.",
        **fields,
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
    """Return joint names and which are prismatic, empty without a description.

    Of the description's joints only those with `names` count, if there are any.
    """
    if urdf is None:
        return (), ()
    from sklearn_vbjfa.robot import _model

    model = _model.load_reduced(urdf, names) if names else _model.load_model(urdf)
    return _model.joint_names(model), _model.is_prismatic(model)


def _channel(table: Table, kind: str, names):
    """Return the columns of one kind (n_rows, nv) or None, and their names."""
    by_joint, by_number = {}, {}
    for column in table.columns:
        match = re.fullmatch(rf"{kind}[_.\[(]?(.*?)[\])]?", column, re.IGNORECASE)
        if match is None:
            continue
        suffix = match.group(1)
        if suffix in names:
            by_joint[names.index(suffix)] = column
        elif suffix.isdecimal():
            by_number[int(suffix)] = column
        elif not suffix and column.lower() == kind:
            by_number[1] = column
    found = by_joint or by_number
    if not found:
        return None, set()
    first = 0 if by_joint or 0 in found else 1
    count = len(names) if by_joint else max(found) + 1 - first
    columns = []
    for k in range(count):
        if first + k not in found:
            missing = f"{kind}_{names[k]}" if by_joint else f"{kind}{first + k}"
            raise ValueError(
                f"{table.path}: column {missing!r} is missing beside "
                f"{', '.join(found.values())}; every joint needs one, in order."
            )
        columns.append(_numbers(table, found[first + k]))
    return np.column_stack(columns), set(found.values())


def _numbers(table: Table, column: str):
    """Return a column as finite floats, or say which cell is none."""
    values = table.columns[column]
    if values.dtype.kind not in "biuf":
        raise ValueError(
            f"{table.path}: column {column!r} holds {values[0]!r} and not numbers; "
            "correct or rename it."
        )
    values = values.astype(float)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise ValueError(
            f"{table.path}: {values[bad[0]]} or nothing in {table.where(bad[0])}, "
            f"column {column!r} ({bad.size} such cells in it); interpolate them or "
            "remove those rows."
        )
    return values


def _check_joints(table: Table, channels, names):
    """Check the number of joints, return their names."""
    for kind, what in (("q", "positions"), ("tau", "torques")):
        if kind not in channels:
            raise ValueError(
                f"{table.path}: no {what}: expected columns {kind}1, {kind}2, ..., "
                f"found {', '.join(table.columns)}; rename them in the header."
            )
    nv = channels["q"].shape[1]
    for kind, values in channels.items():
        if values.shape[1] != nv:
            raise ValueError(
                f"{table.path}: {nv} column(s) q and {values.shape[1]} column(s) "
                f"{kind}; every joint needs one of each."
            )
    if not names:
        return tuple(f"joint_{k + 1}" for k in range(nv))
    if len(names) != nv:
        remedy = (
            "leave out surplus columns, or name one joint per column in joint_names"
            if nv > len(names)
            else "name those recorded, in the order of the columns, in joint_names "
            f"(command line: --joints {','.join(names[:nv])}), the others are then "
            "held at zero"
        )
        raise ValueError(
            f"{table.path}: {nv} column(s) q for {len(names)} joint(s) "
            f"({', '.join(names)}); {remedy}."
        )
    return names


def _time_and_segments(table: Table):
    """Return stamps [s] or None, segment labels or None, and the columns' names."""
    lower = {column.lower(): column for column in table.columns}
    t = labels = None
    if "t" in lower:
        values = table.columns[lower["t"]]
        if values.dtype.kind == "M":
            t = (values - values[0]) / np.timedelta64(1, "s")
        else:
            t = _numbers(table, lower["t"])
    if "segment" in lower:
        labels = table.columns[lower["segment"]]
        if labels.dtype.kind == "f":
            labels = _numbers(table, lower["segment"])
    return t, labels, {lower[x] for x in ("t", "segment") if x in lower}


def _signals(table: Table, taken, notes):
    """Return the other columns; name those that are no numbers."""
    signals, left_out = {}, []
    for column, values in table.columns.items():
        if column in taken:
            continue
        if values.dtype.kind in "biuf" and np.isfinite(values).all():
            signals[column] = values
        else:
            left_out.append(column)
    if left_out:
        notes.append(
            f"column(s) {', '.join(left_out)} hold no finite numbers and are left out."
        )
    return signals


# -- time ------------------------------------------------------------------------------


def _given_period(table: Table, dt, t):
    """Return the period given by the caller or the file; refuse to go without."""
    if dt is None and "dt" in table.scalars:
        entry = table.scalars["dt"]
        dt = entry.item() if entry.size == 1 and entry.dtype.kind in "iuf" else None
        if dt is None or not 0 < dt < np.inf:
            raise ValueError(
                f"{table.path}: dt must be a positive number of seconds, got {entry}; "
                "correct it in the file."
            )
        dt = float(dt)
    if dt is None and t is None:
        raise ValueError(
            f"{table.path}: no column t and no dt; add time stamps [s] as column t, "
            "or give the sample period dt in seconds."
        )
    return dt


def _on_grid(table: Table, t, labels, dt, channels, notes):
    """Cut at segments and gaps, put on a uniform grid; fields of a Recording."""
    segments = _segments(labels, table.n_rows)
    if t is None:
        parts = [
            (name, dt * np.arange(rows.size), {k: x[rows] for k, x in channels.items()})
            for name, rows in segments
        ]
        return _join(parts, dt)
    stamps = []
    for _, rows in segments:
        if rows.size < 2:
            raise ValueError(
                f"{table.path}: the segment at {table.where(rows[0])} has one row "
                "only; give it another label, or remove it."
            )
        try:
            stamps.append(
                inspect_time_stamps(
                    t[rows], dt, lambda k, rows=rows: table.where(rows[k])
                )
            )
        except ValueError as error:
            raise ValueError(f"{table.path}: {error}") from None
    if dt is None:
        periods = [x.dt for x in stamps]
        dt = float(np.median(periods))
        stamps = [
            inspect_time_stamps(t[rows], dt)
            if abs(x.dt - dt) < _DT_TOLERANCE * dt
            else x
            for x, (_, rows) in zip(stamps, segments)
        ]
        if max(periods) - min(periods) > 2 * _DT_TOLERANCE * dt:
            raise ValueError(
                f"{table.path}: segments have periods of {min(periods):.6g} to "
                f"{max(periods):.6g} s; put those of one period into one file."
            )
    _describe(table, stamps, segments, dt, notes)
    parts, short = [], 0
    for (name, rows), checked in zip(segments, stamps):
        pieces = np.split(rows, checked.gaps + 1)
        long = [x for x in pieces if x.size >= min(_MIN_SAMPLES, rows.size)]
        short += len(pieces) - len(long)
        for number, piece in enumerate(long, start=1):
            values = {k: x[piece] for k, x in channels.items()}
            label = name if len(long) == 1 else f"{name} [{number}]"
            if not checked.uniform:
                grid, values = interpolate(t[piece] - t[piece[0]], values, dt)
            else:
                grid = dt * np.arange(piece.size)
            parts.append((label, grid, values))
    if short:
        notes.append(
            f"{short} piece(s) of fewer than {_MIN_SAMPLES} samples between gaps are "
            "left out."
        )
    if not parts:
        raise ValueError(
            f"{table.path}: no {_MIN_SAMPLES} samples follow one another without a gap "
            f"of more than {GAP_PERIODS:g} periods of {dt:.4g} s; check column t."
        )
    return _join(parts, dt)


def _describe(table, stamps, segments, dt, notes):
    """Say in words what is irregular."""
    irregular = [x for x in stamps if not x.uniform]
    if irregular:
        jitter = max(x.jitter for x in irregular)
        shortest = min(x.shortest for x in irregular)
        longest = max(x.longest for x in irregular)
        notes.append(
            f"time stamps are irregular (steps of {shortest:.4g} to {longest:.4g} s, "
            "standard deviation "
            f"{100 * jitter / dt:.2g} % of the period of {dt:.4g} s): samples are "
            "interpolated on a uniform grid."
        )
    count = sum(x.gaps.size for x in stamps)
    if count:
        k = next(k for k, x in enumerate(stamps) if x.gaps.size)
        row = segments[k][1][stamps[k].gaps[0]]
        notes.append(
            f"{count} gap(s) of more than {GAP_PERIODS:g} periods in time, the first "
            f"after {table.where(row)}: the recording is split there."
        )


def _segments(labels, n_rows):
    """Return (name, rows) of each run of equal labels, names made unique."""
    if labels is None:
        return [("recording", np.arange(n_rows))]
    borders = np.flatnonzero(labels[1:] != labels[:-1]) + 1
    runs, seen = [], {}
    for rows in np.split(np.arange(n_rows), borders):
        label = labels[rows[0]]
        is_whole = labels.dtype.kind == "f" and float(label).is_integer()
        text = str(int(label) if is_whole else label)
        seen[text] = seen.get(text, 0) + 1
        runs.append((text if seen[text] == 1 else f"{text} ({seen[text]})", rows))
    return runs


def _join(parts, dt):
    """Concatenate (name, t, channels) into the array fields of a Recording."""
    tables = [channels for _, _, channels in parts]
    columns = {key: np.concatenate([x[key] for x in tables]) for key in tables[0]}
    return {
        "q": columns.pop("q"),
        "tau": columns.pop("tau"),
        "v": columns.pop("v", None),
        "t": np.concatenate([t for _, t, _ in parts]),
        "dt": dt,
        "groups": np.repeat(np.arange(len(parts)), [len(t) for _, t, _ in parts]),
        "group_names": tuple(name for name, _, _ in parts),
        "signals": columns,
    }
