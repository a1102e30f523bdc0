"""A user's recording out of a file, with its time stamps checked."""

import re
import warnings
from os import PathLike, fspath

import numpy as np

from sklearn_vbjfa.recording._recording import Recording, _check_dt
from sklearn_vbjfa.recording._resample import on_grid
from sklearn_vbjfa.recording._signals import as_numbers
from sklearn_vbjfa.recording._table import Table, read_table

# No robot has positions [rad or m], speeds or torques [N m or N] beyond this.
_LARGEST = 1e12


def read_recording(
    path: str | PathLike,
    *,
    dt: float | None = None,
    urdf: str | PathLike | None = None,
    joint_names: tuple[str, ...] | None = None,
    name: str | None = None,
) -> Recording:
    r"""Read a recording of your own robot from CSV, npz or parquet.

    Parameters
    ----------
    path : str or os.PathLike
        File with one row per sample. Columns: positions q1 ... qn [rad or m] and
        torques tau1 ... taun [N m or N]; optionally v1 ... vn [rad/s or m/s],
        a1 ... an [rad/s^2 or m/s^2], t [s] and segment, the label of separate
        recordings (contiguous rows). Names may also be q_1 or q[1], count from 0, or
        use the joint's name, such as q_shoulder. An npz file may hold matrices q, tau,
        ... and a number dt. Text is separated by comma, semicolon, tab or blanks; #
        begins a comment.
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
        On a uniform time grid. Other numeric columns are in its `signals` by their
        names, as are accelerations ("a"); what is wrong with others is in `left_out`.
        Where rows were interpolated, `torque_noise` is the white
        noise that the torques had before.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ImportError
        If a parquet file is to be read without pyarrow, or `urdf` without Pinocchio.
    ValueError
        If the file is damaged or not what its ending says, the number of columns is
        wrong, two columns could be meant, a value is not finite or beyond 1e12, time
        runs backwards, is not in seconds or does not reveal the period, or there is
        neither t nor `dt`. The message names the file, what was expected and what to
        do.

    Warns
    -----
    UserWarning
        If time stamps are irregular: where positions follow the stamps, samples are
        interpolated on a uniform grid from their neighbours; otherwise the rows are
        taken as equidistant. If up to five consecutive rows are missing: they are
        interpolated and the others kept. If more are missing: the recording is split
        there, and pieces of fewer than ten rows are dropped. If rows occur twice, or
        stamps repeat.

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
    channels, used = {}, {}
    for kind in ("q", "tau", "v", "a"):
        values, found = _channel(table, kind, names)
        if found:
            channels[kind], used[kind] = values, found
    names = _check_joints(table, used, names)
    taken = {column for found in used.values() for column in found}
    if model_names:
        # The order of the model, whatever that of the file.
        order = sorted(range(len(names)), key=lambda j: model_names.index(names[j]))
        names = tuple(names[j] for j in order)
        channels = {kind: values[:, order] for kind, values in channels.items()}
    t, labels, special = _time_and_segments(table)
    taken |= special
    notes = []
    signals, left_out = _signals(table, taken, notes)
    dt = _given_period(table, dt, t)
    fields = on_grid(table, t, labels, dt, {**channels, **signals}, notes)
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
        left_out=left_out,
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
    """Return joint names and which are prismatic, empty without a description."""
    # Of the description's joints only those with `names` count, if there are any.
    if urdf is None:
        return (), ()
    from sklearn_vbjfa.model import _loading

    model = _loading.load_reduced(urdf, names) if names else _loading.load_model(urdf)
    return _loading.joint_names(model), _loading.is_prismatic(model)


def _channel(table: Table, kind: str, names):
    """Return the columns of one kind (n_rows, nv) or None, and their names."""
    by_joint, by_number = {}, {}
    for column in table.columns:
        match = re.fullmatch(rf"{kind}[_.\[(]?(.*?)[\])]?", column, re.IGNORECASE)
        if match is None:
            continue
        suffix = match.group(1)
        if suffix in names:
            found, key = by_joint, names.index(suffix)
        elif suffix.isdecimal() and suffix.isascii():
            # int() would choke on thousands of digits.
            found, key = by_number, suffix.lstrip("0").rjust(1, "0")
        elif not suffix and column.lower() == kind:
            found, key = by_number, "1"
        else:
            continue
        _refuse_two(table, found.setdefault(key, column), column)
    if by_joint and by_number:
        j, named = next(iter(by_joint.items()))
        numbered = by_number.get(str(j + 1), next(iter(by_number.values())))
        _refuse_two(table, named, numbered)
    found = by_joint or by_number
    if not found:
        return None, []
    first = 0 if by_joint or "0" in found else 1
    count = len(names if by_joint else found)
    columns = []
    for k in range(count):
        key = k if by_joint else str(first + k)
        if key not in found:
            missing = f"{kind}_{names[k]}" if by_joint else f"{kind}{key}"
            raise ValueError(
                f"{table.path}: column {missing!r} is missing beside "
                f"{_listed(found.values())}; every joint needs one, in order."
            )
        values = _numbers(table, found[key])
        far = np.flatnonzero(np.abs(values) > _LARGEST)
        if far.size:
            raise ValueError(
                f"{table.path}: {values[far[0]]:.3g} in {table.where(far[0])}, column "
                f"{found[key]!r}, is beyond all robots; correct or remove that row."
            )
        columns.append(values)
    return np.column_stack(columns), list(found.values())


def _refuse_two(table, one, other):
    """Refuse two columns that could both be meant."""
    if one != other:
        raise ValueError(
            f"{table.path}: columns {one!r} and {other!r} could both be meant; rename "
            "or remove the one that is not."
        )


def _listed(names):
    """Name columns, some of many."""
    names = [name if len(name) < 40 else f"{name[:37]}..." for name in names]
    return ", ".join(names if len(names) <= 20 else [*names[:19], "..."])


def _numbers(table: Table, column: str):
    """Return a column as finite floats, or say which cell is none."""
    values = table.columns[column]
    if values.dtype.kind not in "biuf":
        raise ValueError(
            f"{table.path}: column {column!r} holds {str(values[0])[:40]!r} and not "
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


def _check_joints(table: Table, used, names):
    """Check the number of joints by the columns of each kind, return their names."""
    for kind, what in (("q", "positions"), ("tau", "torques")):
        if kind not in used:
            raise ValueError(
                f"{table.path}: no {what}: expected columns {kind}1, {kind}2, ..., "
                f"found {_listed(table.columns)}; rename them in the header."
            )
    nv = len(used["q"])
    for kind, columns in used.items():
        if len(columns) != nv:
            raise ValueError(
                f"{table.path}: {nv} column(s) q ({_listed(used['q'])}) and "
                f"{len(columns)} column(s) {kind} ({_listed(columns)}); every joint "
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
        raise ValueError(
            f"{table.path}: {nv} column(s) q for {len(names)} joint(s) "
            f"({_listed(names)}); {remedy}."
        )
    return names


def _time_and_segments(table: Table):
    """Return stamps [s] or None, segment labels or None, and the columns' names."""
    lower = {}
    for column in table.columns:
        name = column.lower()
        if name in ("t", "segment"):
            _refuse_two(table, lower.setdefault(name, column), column)
    t = labels = None
    if "t" in lower:
        values = table.columns[lower["t"]]
        if values.dtype.kind == "M" and not np.isnat(values).any():
            t = (values - values[0]) / np.timedelta64(1, "s")
        else:
            t = _numbers(table, lower["t"])
    if "segment" in lower:
        labels = table.columns[lower["segment"]]
        if labels.dtype.kind == "f":
            labels = _numbers(table, lower["segment"])
    return t, labels, set(lower.values())


def _signals(table: Table, taken, notes):
    """Return the other columns, and what is wrong with those that are no numbers."""
    signals, left_out = {}, {}
    for column, values in table.columns.items():
        if column in taken:
            continue
        numbers, reason = as_numbers(values, table.n_rows)
        if reason:
            left_out[column] = reason
        else:
            signals[column] = numbers
    if left_out:
        notes.append(
            f"column(s) {_listed(left_out)} hold no finite numbers and are left out."
        )
    return signals, left_out


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
