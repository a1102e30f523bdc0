"""Several files: parts of one recording side by side, or recordings of one robot."""

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median_low

import numpy as np

from sklearn_vbjfa.recording import _names
from sklearn_vbjfa.recording._layout import Role, by_names, channel_unit
from sklearn_vbjfa.recording._recording import Recording
from sklearn_vbjfa.recording._sampling import (
    GAP_PERIODS,
    STEADY,
    distinct,
    on_one_grid,
)
from sklearn_vbjfa.recording._table import Loss, Table, listed, pandas_of
from sklearn_vbjfa.recording.formats import expanded

# Words in the names of files, and what such a file holds.
_WORDS = {
    "t": {"t", "time", "times", "timestamp", "timestamps", "stamp", "stamps"},
    "q": {"q", "pos", "position", "positions", "angle", "angles", "theta"},
    "v": {"v", "dq", "qd", "qdot", "vel", "velocity", "velocities", "speed", "speeds"},
    "a": {"a", "ddq", "qdd", "qddot", "acc", "accel", "acceleration", "accelerations"},
    "tau": {"tau", "torque", "torques", "effort", "efforts", "trq", "moment", "moments"}
    | {"current", "currents", "curr", "amp", "amps", "ampere", "amperes", "i"},
}
# What holds commands; of these only the ones of the motion are of use.
_COMMANDS = {"q": "q_desired", "v": "v_desired"}
# Relative difference between the periods of two files that is refused: accelerations
# go with its square.
_DT_TOLERANCE = 0.01
# Files that a note names; more are counted.
_NAMED = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class _Part:
    """A file that is joined with others."""

    table: Table
    time: Role | None = None  # of its stamps
    kind: str = ""  # of its columns, by the name of the file

    @property
    def name(self):
        """Name of the file."""
        return self.table.path.name

    @property
    def kinds(self):
        """Kinds of the channels in it, a set."""
        return set(by_names(self.table).channels) | {self.kind} - {"", "t"}


def joined(tables, joints, path) -> Table:
    """Put tables of one recording side by side."""
    # joints: names of the robot's, empty if unknown; path: as messages name the whole.
    parts, left_out = _parts(tables, joints, path)
    stamped = [x for x in parts if x.time is not None]
    base = next((x for x in stamped if "q" in x.kinds), (stamped or parts)[0])
    others = [x for x in parts if x is not base]
    keep = np.ones(base.table.n_rows, dtype=bool)
    rows, notes = [], []
    for part in others:
        at, said = _rows(part, base)
        rows.append(at)
        notes += said
        keep &= np.isfinite(at)
    keep = np.flatnonzero(keep)
    if not keep.size:
        raise ValueError(f"{path}: the files have no time in common.")
    lost = base.table.n_rows - keep.size
    if lost:
        text = f"{lost} row(s) of {base.name} are not in all files: left out."
        notes.append(Loss(text) if np.ptp(keep) + 1 > keep.size else text)
    frame = base.table.frame.iloc[keep]
    columns, of = {x: frame[x] for x in frame}, dict.fromkeys(frame, base.name)
    for part, at in zip(others, rows):
        for name in part.table.names:
            if part.time is not None and name in part.time.columns:
                continue
            values = _at(part.table.values(name), at[keep])
            if name in columns and not np.array_equal(columns[name], values):
                one = replace(part.table, frame=part.table.frame[[name]])
                if by_names(one, joints).channels:
                    raise ValueError(
                        f"{path}: column {name!r} is in {of[name]} and in {part.name}, "
                        "with other values; leave one of the files out, or rename the "
                        "column."
                    )
                name = f"{part.table.path.stem}.{name}"
            columns[name], of[name] = values, part.name
    how = f"at the stamps of {base.name}" if notes else "row by row"
    what = sorted(x.name + (f" ({x.kind})" if x.kind else "") for x in parts)
    notes.insert(0, f"{len(parts)} files of one recording, {how}: {listed(what)}.")
    if left_out:
        notes.insert(1, f"{listed(left_out)}: not needed, left out.")
    tables = [part.table for part in (base, *others)]
    return Table(
        path=path,
        frame=pandas_of(path).DataFrame(columns, index=frame.index),
        place=f"{base.table.place} of {base.name}",
        scalars={key: x for one in tables for key, x in one.scalars.items()},
        units={key: x for one in tables for key, x in one.units.items()},
        joints=next((x.joints for x in tables if x.joints), ()),
        notes=(*_with_names([(x.path.name, x.notes) for x in tables]), *notes),
    )


# -- the content of a file -------------------------------------------------------------


def _parts(tables, joints, path):
    """Return the files that can stand side by side, and names of those left out."""
    parts, left_out = [], []
    for table in tables:
        kind = _kind_of_file(table)
        if kind is None or (table.nameless and not kind):
            left_out.append(table.path.name)
        else:
            parts.append(_part(table, kind, joints))
    kinds = {kind for part in parts for kind in part.kinds}
    if left_out and not {"q", "tau"} <= kinds:
        raise ValueError(
            f"{path}: the columns of {listed(left_out)} have no names, and the name(s) "
            "of the file(s) do not say what they hold; name them after that: "
            "positions, velocities, torques, currents or time."
        )
    if any(x.time is not None and x.kind != "t" for x in parts):
        # The others have stamps.
        left_out += [x.name for x in parts if x.kind == "t"]
        parts = [x for x in parts if x.kind != "t"]
    if len(parts) < 2:
        raise ValueError(
            f"{path}: holds {listed([x.path.name for x in tables])}, of which less "
            "than two can stand side by side; expected files of one recording, such "
            "as positions.csv and torques.csv."
        )
    return parts, left_out


def _kind_of_file(table):
    """Return the kind that a file is called after, "" for none; None: of no use."""
    words = set(_names.words(table.path.stem))
    kinds = [kind for kind, known in _WORDS.items() if words & known]
    kind = kinds[0] if len(kinds) == 1 else ""
    if kind and words & {*_names.COMMAND_WORDS}:
        return _COMMANDS.get(kind)
    return kind


def _part(table: Table, kind, joints):
    """Return a file with the channels that its columns are, by its own name."""
    plain = by_names(table, joints)
    time = plain.times[0] if plain.times else None
    if table.nameless:
        names = _names_of_places(table, kind, joints)
        time = Role(column="t") if "t" in names.values() else None
    elif plain.channels or not kind or kind == "t":
        return _Part(table=table, time=time)
    else:
        stamps = () if time is None else time.columns
        own = [x for x in table.names if x not in stamps]
        names = _names_of_joints(own, kind, joints)
    units = {names.get(key, key): x for key, x in table.units.items()}
    if _names.is_current(table.path.stem):
        units |= {x: "A" for x in names.values() if x not in units and x != "t"}
    frame = table.frame.rename(columns=names)
    table = replace(table, frame=frame, units=units, nameless=False)
    return _Part(table=table, time=time, kind=kind if names else "")


def _names_of_joints(columns, kind, joints):
    """Return names of columns that are called after joints, or are as many; or {}."""
    # The longest name in a column is that of its joint.
    found = [max((j for j in joints if j in x), key=len, default="") for x in columns]
    if all(found) and len(set(found)) == len(found):
        return {x: f"{kind}_{joint}" for x, joint in zip(columns, found)}
    if len(columns) == (len(joints) or len(columns)):
        return {x: f"{kind}{k}" for k, x in enumerate(columns, start=1)}
    return {}


def _names_of_places(table: Table, kind, joints):
    """Return names of the columns of a table without names, by its file."""
    count, n = len(table.names), len(joints)
    if kind == "t" and count == 1:
        return {"1": "t"}
    stamped = count > 1 and count != n and _names.is_clock(table.values("1"))
    if n not in (0, count - stamped):
        raise ValueError(
            f"{table.path}: has {count} column(s) without names; expected {n} of "
            f"{kind}, one for each joint, or {n + 1} with time before them."
        )
    names = {str(k + stamped): f"{kind}{k}" for k in range(1, count - stamped + 1)}
    return {"1": "t"} | names if stamped else names


# -- which rows go together ------------------------------------------------------------


def _rows(part, base):
    """Return where the rows of the base lie in a file, nan for nowhere; and notes."""
    n, n_base = part.table.n_rows, base.table.n_rows
    same = np.arange(float(n)), []
    if part.time is None or base.time is None:
        if n != n_base:
            raise ValueError(
                f"{part.table.path}: has {n} rows and {base.name} has {n_base}; files "
                "without time stamps are joined row by row: cut "
                "both to the same rows, or give each a column t."
            )
        return same
    if np.array_equal(*(x.table.values(x.time.column) for x in (part, base))) and not (
        part.time.nanoseconds
    ):
        return same
    t, at = _seconds(part), _seconds(base)
    if t is None or at is None:
        raise ValueError(
            f"{part.table.path}: has other dates than {base.name}; write the time of "
            "both in seconds."
        )
    if (np.diff(t) <= 0).any():
        raise ValueError(
            f"{part.table.path}: time does not rise in each row, so that its rows "
            f"cannot be joined with those of {base.name}; sort it, and leave out what "
            "is there twice."
        )
    period = np.median(np.diff(t))
    if n == n_base and np.abs(t - at).max() <= STEADY * period:
        return same
    return _interpolated_rows(part, base, t, at, period)


def _interpolated_rows(part, base, t, at, period):
    """Return where times lie between those of a file, nan for nowhere; and notes."""
    n = t.size
    rows = np.interp(at, t, np.arange(n), left=np.nan, right=np.nan)
    # Stamps that differ by rounding are the same.
    nearest = np.clip(np.searchsorted(t, at - period / 2), 0, n - 1)
    same = np.abs(t[nearest] - at) <= STEADY * period
    rows[same] = nearest[same]
    if np.isnan(rows).all():
        raise ValueError(
            f"{part.table.path}: its time goes from {t[0]:.9g} to {t[-1]:.9g} s and "
            f"that of {base.name} from {at[0]:.9g} to {at[-1]:.9g} s, with nothing in "
            "common; expected one clock in one unit."
        )
    # Nothing is put between samples that are far from each other.
    inside = np.flatnonzero(~same & np.isfinite(rows))
    low = rows[inside].astype(int)
    rows[inside[t[np.minimum(low + 1, n - 1)] - t[low] > GAP_PERIODS * period]] = np.nan
    between = int((np.isfinite(rows) & (rows % 1 != 0)).sum())
    how = "rows taken by their stamps."
    if between:
        how = (
            f"interpolated by straight lines at {between} of the {at.size} stamps of "
            f"{base.name}."
        )
    return rows, [f"{part.name}: {how}"]


def _seconds(part):
    """Return the stamps of a file [s], None for dates."""
    stamps = part.table.values(part.time.column)
    if stamps.dtype.kind not in "biuf":
        return None
    unit = channel_unit(part.table, "t", part.time)
    seconds = stamps.astype(float) * (1.0 if unit is None else unit.factor)
    if part.time.nanoseconds:
        seconds += 1e-9 * part.table.values(part.time.nanoseconds)
    return seconds


def _at(values, rows):
    """Return a column at rows, numbers on straight lines between them."""
    if values.dtype.kind in "iuf" and (rows % 1).any():
        return np.interp(rows, np.arange(len(values)), values)
    return values[rows.astype(int)]


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
    notes = notes_of(files)
    left_out, missing = _signals_left_out(files)
    if missing:
        notes.append(
            f"column(s) {listed(missing)} are not in all files and are left out."
        )
    recordings = [_without_signals(x.recording, left_out) for x in files]
    dt = median_low([x.dt for x in recordings])
    fields, moved = on_one_grid(recordings, _group_names(files), dt)
    if moved:
        paths = [files[k].path for k in moved]
        notes.append(
            f"{listed_paths(paths)}: interpolated to the sample period of the others, "
            f"{dt:.6g} s."
        )
    whole = replace(
        recordings[0],
        name=name or common_folder([x.path for x in files]) or recordings[0].name,
        left_out=left_out,
        description=f"Read from {listed([x.path.name for x in files])}.",
        **fields,
    )
    return whole, notes


def notes_of(files):
    """Return the notes of files with their paths before them, equal ones in one."""
    return list(_with_names([(str(file.path), file.notes) for file in files]))


def _with_names(notes):
    """Yield the notes of files, (name, notes) each, with names; equal ones once."""
    names: dict[tuple, dict] = {}
    for name, own in notes:
        for note in own:
            names.setdefault((type(note), str(note)), {})[name] = None
    for (kind, note), of in names.items():
        yield kind(f"{listed_paths(of)}: {note}")


def listed_paths(paths):
    """Name files; of many the first."""
    shown = [str(path) for path in paths]
    more = len(shown) - _NAMED
    return ", ".join(shown[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def _check_agreement(files):
    """Refuse files of other robots, that were not recorded alike, or are copies."""
    first, *others = files
    for other in others:
        for one, two in zip(_traits(first), _traits(other)):
            if one != two:
                raise ValueError(
                    f"{first.path} has {one} and {other.path} has {two}; expected "
                    "files with the same joints and channels: correct one of them, or "
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
    for k, file in enumerate(files):
        for other in files[:k]:
            # Their evidence would count twice.
            a, b = file.recording, other.recording
            if np.array_equal(a.q, b.q) and np.array_equal(a.tau, b.tau):
                raise ValueError(
                    f"{file.path} is a copy of {other.path}; leave one of them out."
                )


def _traits(file):
    """Yield what must be the same in all files, in words."""
    recording = file.recording
    yield f"the joints {listed(recording.joint_names)}"
    for what, units in (
        ("positions", recording.position_units),
        ("torques", file.torque_units),
    ):
        yield f"{what} in {listed(units[:1] if len(set(units)) == 1 else units)}"
    for what, there in (
        ("velocities", recording.v is not None),
        ("accelerations", "a" in recording.signals),
        ("time stamps", file.stamped),
    ):
        yield what if there else f"no {what}"


def _group_names(files):
    """Call recordings after their files, and their own names where there are more."""
    stems = Counter(x.recording.name for x in files)
    names = []
    for file in files:
        stem, own = file.recording.name, file.recording.group_names
        label = stem if stems[stem] == 1 else str(file.path)
        # What a file calls "recording" has no name.
        suffixes = [x.removeprefix("recording").strip() for x in own]
        names += [f"{label} {x}".strip() if len(own) > 1 else label for x in suffixes]
    return distinct(names)


def _signals_left_out(files):
    """Return what is wrong with signals, by name, and which are missing somewhere."""
    left_out, missing = {}, []
    for file in files:
        for key, reason in file.recording.left_out.items():
            left_out.setdefault(key, f"{reason} ({file.path})")
    for key in dict.fromkeys(key for x in files for key in x.recording.signals):
        without = [x.path for x in files if key not in x.recording.signals]
        if without and key not in left_out:
            missing.append(key)
            left_out[key] = f"is missing in {listed_paths(without)}"
    return left_out, missing


def _without_signals(recording, names):
    signals = {key: x for key, x in recording.signals.items() if key not in names}
    return replace(recording, signals=signals)
