"""Several files: parts of one recording side by side, or recordings of one robot."""

import functools
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median_low

import numpy as np

from sklearn_vbjfa.recording import _channels, _layout
from sklearn_vbjfa.recording._channels import clock_of
from sklearn_vbjfa.recording._recording import Recording
from sklearn_vbjfa.recording._sampling import (
    GAP_PERIODS,
    STEADY,
    distinct,
    on_one_grid,
)
from sklearn_vbjfa.recording._table import Loss, Table, listed
from sklearn_vbjfa.recording.formats import expanded

# Words in the names of files, and what such a file holds.
_WORDS = {
    "t": {"t", "time", "times", "timestamp", "timestamps", "stamp", "stamps", "zeit"},
    "q": {"q", "pos", "position", "positions", "angle", "angles", "theta", "winkel"},
    "v": {"v", "dq", "qd", "qdot", "vel", "velocity", "velocities", "speed", "speeds"},
    "a": {"a", "ddq", "qdd", "qddot", "acc", "accel", "acceleration", "accelerations"},
    "tau": {"tau", "torque", "torques", "effort", "efforts", "trq", "moment", "moments"}
    | {"m", "drehmoment", *_channels._CURRENT},
}
# Relative difference between the periods of two files that is refused: accelerations
# go with its square.
_DT_TOLERANCE = 0.01
# Files of which a note is told that are named; more are counted.
_NAMED = 3
_NAMES = "positions, velocities, torques, currents or time"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Part:
    """A file that is to stand beside others."""

    table: Table
    time: object = None  # `Role` of its stamps
    kind: str = ""  # what the name of the file says that it holds
    flat: bool = False  # whether all joints are in one column, one after the other


def joined(tables, joints, path) -> Table:
    """Put tables of one recording side by side."""
    # joints: names of the robot's, empty if unknown; path: as messages name the whole.
    parts, left_out, told_of = [], [], {}
    for table in tables:
        for note in table.notes:
            told_of.setdefault(note, []).append(table.path.name)
    notes = [type(x)(f"{listed(names)}: {x}") for x, names in told_of.items()]
    for table in tables:
        part = _part(table, joints)
        (left_out if part is None else parts).append(part or table.path.name)
    kinds = {_layout.kind_of(x) for part in parts for x in part.table.columns}
    if left_out and not {"q", "tau"} <= kinds:
        raise ValueError(
            f"{path}: the columns of {listed(left_out)} have no names, and the name(s) "
            f"of the file(s) do not say what they hold; name them after that: {_NAMES}."
        )
    stamped = [x for x in parts if x.time is not None and x.kind != "t"]
    for part in [x for x in parts if x.kind == "t" and stamped]:
        # The others have stamps of their own.
        parts.remove(part)
        left_out.append(part.table.path.name)
    if len(parts) < 2:
        raise ValueError(
            f"{path}: holds {listed([x.path.name for x in tables])}, of which less "
            "than two can stand side by side; expected files of one recording, such "
            "as positions.csv and torques.csv."
        )
    parts = _upright(parts, len(joints))
    base = next((x for x in stamped if _has_positions(x)), (stamped or [None])[0])
    base = base or next((x for x in parts if x.time is not None), parts[0])
    others = [x for x in parts if x is not base]
    keep = np.arange(base.table.n_rows)
    taken, told = {}, []
    for part in others:
        rows, said = _rows(part, base)
        taken[part.table.path] = rows
        keep = keep[np.isfinite(rows[keep])]
        told += said
    if not keep.size:
        raise ValueError(f"{path}: the files have no time in common.")
    told += _lost(keep, base)
    columns, units, scalars = {}, dict(base.table.units), dict(base.table.scalars)
    of = {}
    for part in [base, *others]:
        at = taken.get(part.table.path, keep)
        at = at if part is base else at[keep]
        for name, values in part.table.columns.items():
            if part is not base and part.time and name in part.time.columns:
                continue
            values = _at(values, at)
            if name in columns and not np.array_equal(columns[name], values):
                if _layout.kind_of(name) in (*_layout.KINDS, "segment"):
                    raise ValueError(
                        f"{path}: column {name!r} is in {of[name].name} and in "
                        f"{part.table.path.name}, with other values; leave one of the "
                        "files out, or rename the column."
                    )
                name = f"{part.table.path.stem}.{name}"
            columns[name], of[name] = values, part.table.path
        units |= part.table.units
        scalars |= part.table.scalars
    what = [x.table.path.name + (f" ({x.kind})" if x.kind else "") for x in parts]
    how = "row by row" if not told else f"at the stamps of {base.table.path.name}"
    notes.append(f"{len(parts)} files of one recording, {how}: {listed(what)}.")
    if left_out:
        notes.append(f"{listed(left_out)}: not needed beside the others, left out.")
    where = base.table.where
    return Table(
        path=path,
        columns=columns,
        scalars=scalars,
        units=units,
        where=lambda row: f"{where(keep[row])} of {base.table.path.name}",
        joints=next((x.joints for x in tables if x.joints), ()),
        notes=(*notes, *told),
    )


def _has_positions(part):
    return any(_layout.kind_of(x) == "q" for x in part.table.columns)


# -- what a file holds -----------------------------------------------------------------


def _part(table: Table, joints):
    """Name the columns of a file by its own name, where they need it; None: unused."""
    words = set(_channels._words(table.path.stem))
    kinds = [kind for kind, known in _WORDS.items() if words & known]
    kind = kinds[0] if len(kinds) == 1 else ""
    if kind and words & _channels._COMMAND:
        # Of references only those of the motion are of use.
        commanded = {"q": "q_desired", "v": "v_desired"}
        if kind not in commanded:
            return None
        kind = commanded[kind]
    if table.nameless:
        return _by_file(table, kind, joints)
    plain = _layout.by_names(table, joints)
    time = plain.times[0] if plain.times else None
    if any(_channels._matched(plain, x, joints) for x in _layout.KINDS) or not kind:
        return _Part(table=table, time=time)
    own = [x for x in table.columns if time is None or x not in time.columns]
    held = {x: [one for one in joints if _holds(x, one, joints)] for x in own}
    found = [one for x in held.values() for one in x]
    if len(own) == len(found) == len({*found}) and all(held.values()):
        names = {x: f"{kind}_{joint}" for x, (joint,) in held.items()}
    elif kind != "t" and len(own) in (len(joints) or len(own),):
        names = {x: f"{kind}{k}" for k, x in enumerate(own, start=1)}
    else:
        return _Part(table=table, time=time)
    return _Part(table=_renamed(table, names, words), time=time, kind=kind)


def _holds(column, joint, joints):
    """Whether a column is of a joint, and of none with a longer name."""
    return joint in column and not any(
        joint in x and len(x) > len(joint) and x in column for x in joints
    )


def _by_file(table: Table, kind, joints):
    """Name the columns of a table without names by its file."""
    count, n, path = len(table.columns), len(joints), table.path
    words = set(_channels._words(path.stem))
    if kind == "t" and count == 1:
        table = _renamed(table, {"1": "t"}, words)
        return _Part(table=table, time=_layout.Role(column="t"), kind=kind)
    if not kind or kind == "t":
        return None
    stamped = count > 1 and count != n and clock_of(table) == "1"
    rest = count - stamped
    if n > 1 and count == 1:
        names, flat = {"1": kind}, True
    elif n in (0, rest):
        names, flat = (
            {str(k + stamped): f"{kind}{k}" for k in range(1, rest + 1)},
            False,
        )
    else:
        raise ValueError(
            f"{path}: has {count} columns without names; expected {n} of {kind}, one "
            f"for each joint of the robot, or {n + 1} with time before them."
        )
    time = None
    if stamped:
        names, time = {"1": "t", **names}, _layout.Role(column="t")
    return _Part(table=_renamed(table, names, words), time=time, kind=kind, flat=flat)


def _renamed(table, names, words):
    """Return a table with other names of columns, and currents as such."""
    columns = {names.get(key, key): x for key, x in table.columns.items()}
    units = {names.get(key, key): x for key, x in table.units.items()}
    if words & _channels._CURRENT:
        units |= {x: "A" for x in names.values() if x not in units and x != "t"}
    return replace(table, columns=columns, units=units, nameless=False)


def _upright(parts, n):
    """Give each joint its column, where a file has all of them in one."""
    if not any(part.flat for part in parts):
        return parts
    known = {x.table.n_rows for x in parts if not x.flat}
    n_rows = known.pop() if len(known) == 1 else 0
    found = []
    for part in parts:
        if part.flat:
            ((kind, values),) = part.table.columns.items()
            # As many as there are for each row; whether the robot has so many joints
            # is seen when they are laid out.
            count = values.size // n_rows if n_rows else n
            if not count or values.size % count or (n_rows and values.size % n_rows):
                raise ValueError(
                    f"{part.table.path}: has {values.size} numbers, one a line, which "
                    f"is not a multiple of {n_rows or n}; expected one for each joint "
                    f"in each {'of as many rows' if n_rows else 'row'}."
                )
            matrix = values.reshape(-1, count)
            columns = {f"{kind}{k + 1}": x for k, x in enumerate(matrix.T)}
            unit = part.table.units.get(kind)
            units = dict.fromkeys(columns, unit) if unit else {}
            own = part.table.where
            where = functools.partial(_nth, own, count)
            table = replace(part.table, columns=columns, units=units, where=where)
            part = replace(part, table=table)
        found.append(part)
    return found


def _nth(where, count, row):
    return where(count * row)


# -- which rows go together ------------------------------------------------------------


def _rows(part, base):
    """Return where the rows of the base lie in a file, nan for nowhere; and notes."""
    own, other = part.table.path.name, base.table.path.name
    n, n_base = part.table.n_rows, base.table.n_rows
    if part.time is None or base.time is None:
        if n != n_base:
            raise ValueError(
                f"{part.table.path}: has {n} rows and {other} has {n_base}; files "
                "without time stamps of their own stand side by side row by row: cut "
                "both to the same rows, or give each a column t."
            )
        return np.arange(float(n)), []
    t, at = _seconds(part), _seconds(base)
    if t is None or at is None:
        if np.array_equal(_stamps(part), _stamps(base)):
            return np.arange(float(n)), []
        raise ValueError(
            f"{part.table.path}: has other dates than {other}; write the time of both "
            "in seconds."
        )
    if (np.diff(t) <= 0).any():
        raise ValueError(
            f"{part.table.path}: time does not rise in each row, so that its rows "
            f"cannot be put beside those of {other}; sort it, and leave out what is "
            "there twice."
        )
    if n == n_base and np.abs(t - at).max() <= STEADY * np.median(np.diff(t)):
        return np.arange(float(n)), []
    period = np.median(np.diff(t))
    rows = np.interp(at, t, np.arange(n), left=np.nan, right=np.nan)
    near = np.abs(at[:, None] - t[[0, -1]]) <= STEADY * period
    rows[near[:, 0]], rows[near[:, 1]] = 0, n - 1
    if np.isnan(rows).all():
        raise ValueError(
            f"{part.table.path}: its time goes from {t[0]:.9g} to {t[-1]:.9g} s and "
            f"that of {other} from {at[0]:.9g} to {at[-1]:.9g} s, with nothing in "
            "common; expected one clock in one unit."
        )
    whole = np.round(rows)
    same = np.isfinite(rows) & (
        np.abs(t[np.nan_to_num(whole).astype(int)] - at) <= STEADY * period
    )
    rows[same] = whole[same]
    # Nothing is put between samples that are far from each other.
    inside = np.flatnonzero(~same & np.isfinite(rows))
    low = rows[inside].astype(int)
    steps = t[np.minimum(low + 1, n - 1)] - t[low]
    rows[inside[steps > GAP_PERIODS * period]] = np.nan
    between = int((np.isfinite(rows) & (rows % 1 != 0)).sum())
    if not between:
        return rows, [f"{own}: rows taken by their stamps."]
    return rows, [
        f"{own}: interpolated by straight lines at {between} of the {n_base} stamps of "
        f"{other}."
    ]


def _stamps(part):
    return part.table.columns[part.time.column]


def _seconds(part):
    """Return the stamps of a file [s], None for dates."""
    stamps = _stamps(part)
    if stamps.dtype.kind not in "biuf":
        return None
    unit = _layout.channel_unit(part.table, "t", part.time)
    seconds = stamps.astype(float) * (1.0 if unit is None else unit.factor)
    if part.time.nanoseconds:
        seconds += 1e-9 * part.table.columns[part.time.nanoseconds]
    return seconds


def _lost(keep, base):
    """Say how many rows of the base the other files do not have."""
    lost = base.table.n_rows - keep.size
    if not lost:
        return []
    inside = keep[-1] - keep[0] + 1 - keep.size
    text = f"{lost} row(s) of {base.table.path.name} are not in all files: left out."
    return [Loss(text) if inside else text]


def _at(values, rows):
    """Return a column at rows, numbers on straight lines between them."""
    whole = rows.astype(int)
    if values.dtype.kind not in "iuf" or not (rows % 1).any():
        return values[whole]
    share = rows - whole
    after = values[np.minimum(whole + 1, len(values) - 1)]
    return np.where(
        share > 0, (1 - share) * values[whole] + share * after, values[whole]
    )


# -- several files of one robot --------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadFile:
    """A file as it was read, with what its recording no longer tells."""

    path: Path  # as messages name it
    recording: Recording  # what it holds
    notes: tuple[str, ...]  # what a user should know of it
    stamped: bool  # whether it has time stamps
    torque_units: tuple[str, ...]  # before they were multiplied by gains


def common_folder(paths):
    """Return the name of the folder that holds all files, "" if there is none."""
    folders = {expanded(path).parent.resolve() for path in paths}
    return folders.pop().name if len(folders) == 1 else ""


def concatenated(files, name=None):
    """Return the recording of all files, and what to say of it."""
    _check_agreement(files)
    _refuse_copies(files)
    notes = notes_of(files)
    common, left_out, missing = _shared_signals(files)
    if missing:
        notes.append(
            f"column(s) {listed(missing)} are not in all files and are left out."
        )
    recordings = [
        replace(x.recording, signals={key: x.recording.signals[key] for key in common})
        for x in files
    ]
    dt = median_low([x.dt for x in recordings])
    fields, moved = on_one_grid(recordings, _group_names(files), dt)
    if moved:
        paths = [files[k].path for k in moved]
        notes.append(
            f"{listed_paths(paths)}: interpolated to the sample period of the others, "
            f"{dt:.6g} s."
        )
    first = recordings[0]
    whole = replace(
        first,
        name=name or common_folder([x.path for x in files]) or first.name,
        left_out=left_out,
        description=f"Read from {listed([x.path.name for x in files])}.",
        **fields,
    )
    return whole, notes


def notes_of(files):
    """Return the notes of files with their paths before them, equal ones in one."""
    paths = {}
    for file in files:
        for note in file.notes:
            paths.setdefault((type(note), str(note)), {})[str(file.path)] = None
    return [kind(f"{listed_paths(of)}: {note}") for (kind, note), of in paths.items()]


def listed_paths(paths):
    """Name files; of many the first."""
    shown = [str(path) for path in paths][:_NAMED]
    more = len(paths) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more else "")


# -- what must agree -------------------------------------------------------------------


def _check_agreement(files):
    """Refuse files that cannot be of one robot, or were not recorded alike."""
    first, *others = files
    for other in others:
        for one, two in zip(_traits(first), _traits(other)):
            if one != two:
                raise ValueError(
                    f"{first.path} has {one} and {other.path} has {two}; expected "
                    "files with the same joints and channels: mend one of them, or "
                    "take them one by one."
                )
    fast = min(files, key=lambda x: x.recording.dt)
    slow = max(files, key=lambda x: x.recording.dt)
    if slow.recording.dt > (1 + _DT_TOLERANCE) * fast.recording.dt:
        raise ValueError(
            f"{fast.path} has a sample period of {fast.recording.dt:.6g} s and "
            f"{slow.path} one of {slow.recording.dt:.6g} s; expected periods that "
            f"differ by {100 * _DT_TOLERANCE:g} % at most: resample one of the files, "
            "or take them one by one."
        )


def _refuse_copies(files):
    """Refuse files with the same motion: their evidence would count twice."""
    for k, file in enumerate(files):
        for other in files[:k]:
            if np.array_equal(file.recording.q, other.recording.q) and np.array_equal(
                file.recording.tau, other.recording.tau
            ):
                raise ValueError(
                    f"{file.path} is a copy of {other.path}; leave one of them out."
                )


def _traits(file):
    """Yield what must be the same in all files, in words."""
    recording = file.recording
    yield f"the joints {listed(recording.joint_names)}"
    yield f"positions in {_units(recording.position_units)}"
    yield f"torques in {_units(file.torque_units)}"
    for what, there in (
        ("velocities", recording.v is not None),
        ("accelerations", "a" in recording.signals),
        ("time stamps", file.stamped),
    ):
        yield what if there else f"no {what}"


def _units(units):
    return listed(units[:1] if len(set(units)) == 1 else units)


# -- names and signals -----------------------------------------------------------------


def _group_names(files):
    """Call recordings after their files, and their own names where there are more."""
    stems = Counter(x.recording.name for x in files)
    names = []
    for file in files:
        stem = file.recording.name
        label = stem if stems[stem] == 1 else str(file.path)
        own = file.recording.group_names
        # What a file calls "recording" has no name of its own.
        suffixes = [x.removeprefix("recording").strip() for x in own]
        names += (
            [label] if len(own) == 1 else [f"{label} {x}".strip() for x in suffixes]
        )
    return distinct(names)


def _shared_signals(files):
    """Return names of the signals in all files, and what is wrong with the others."""
    # The third are the names of those that are missing somewhere.
    left_out, missing = {}, []
    for file in files:
        for key, reason in file.recording.left_out.items():
            left_out.setdefault(key, f"{reason} ({file.path})")
    names = dict.fromkeys(key for x in files for key in x.recording.signals)
    for key in [key for key in names if key not in left_out]:
        without = [x.path for x in files if key not in x.recording.signals]
        if without:
            missing.append(key)
            left_out[key] = f"is missing in {listed_paths(without)}"
    return [key for key in names if key not in left_out], left_out, missing
