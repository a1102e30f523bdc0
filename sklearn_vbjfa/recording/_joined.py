"""Files of one recording, side by side in one table."""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.recording._clock import GAP_PERIODS, STEADY
from sklearn_vbjfa.recording._layout import Role, by_names, channel_unit
from sklearn_vbjfa.recording._table import Loss, Table, listed, pandas_of
from sklearn_vbjfa.recording._units import is_clock, is_current, kinds_in

# What holds commands; of these only the ones of the motion are of use.
_COMMANDS = {"q": "q_desired", "v": "v_desired"}


@dataclass(frozen=True, kw_only=True, eq=False)
class _Part:
    """A file that is joined with others."""

    table: Table
    time: Role | None  # of its stamps
    kind: str = ""  # of its columns, by the name of the file

    @property
    def name(self):
        """Name of the file."""
        return self.table.path.name

    @property
    def has_positions(self):
        """Whether its columns are positions, by their names or that of the file."""
        return self.kind == "q" or "q" in by_names(self.table).kinds


def joined(tables, joints, path) -> Table:
    """Put tables of one recording side by side."""
    # joints: names of the robot's, empty if unknown; path: as messages name the whole.
    base, others, left_out = _parts(tables, joints, path)
    rows = [_rows(part, base) for part in others]
    notes = list(filter(None, map(_how, others, rows, [base] * len(rows))))
    keep = np.flatnonzero(np.isfinite(rows).all(axis=0))
    if not keep.size:
        raise ValueError(
            f"{path}: the files have no time in common; expected one clock in one unit."
        )
    lost = base.table.n_rows - keep.size
    if lost:
        text = f"{lost} row(s) of {base.name} are not in all files: left out."
        notes.append(Loss(text) if np.ptp(keep) + 1 > keep.size else text)
    frame = base.table.frame.iloc[keep]
    columns, of = {x: frame[x] for x in frame}, dict.fromkeys(frame, base.name)
    for part, at in zip(others, rows):
        stamps = () if part.time is None else part.time.columns
        for name in (x for x in part.table.names if x not in stamps):
            values = _at(part.table.values(name), at[keep])
            if name in columns and not np.array_equal(columns[name], values):
                one = replace(part.table, frame=part.table.frame[[name]])
                if by_names(one, joints).kinds - {"t", "segment"}:
                    raise ValueError(
                        f"{path}: column {name!r} is in {of[name]} and in {part.name}, "
                        "with other values; leave one of the files out, or rename the "
                        "column."
                    )
                name = f"{part.table.path.stem}.{name}"
            columns[name], of[name] = values, part.name
    how = f"at the stamps of {base.name}" if notes else "row by row"
    parts = [base, *others]
    what = sorted(x.name + (f" ({x.kind})" if x.kind else "") for x in parts)
    notes.insert(0, f"{len(parts)} files of one recording, {how}: {listed(what)}.")
    if left_out:
        notes.insert(1, f"{listed(left_out)}: not needed, left out.")
    tables = [part.table for part in parts]
    return Table(
        path=path,
        frame=pandas_of(path).DataFrame(columns, index=frame.index),
        place=f"{base.table.place} of {base.name}",
        scalars={key: x for one in tables for key, x in one.scalars.items()},
        units={key: x for one in tables for key, x in one.units.items()},
        joints=next((x.joints for x in tables if x.joints), ()),
        notes=(*(f"{x.path.name}: {y}" for x in tables for y in x.notes), *notes),
    )


# -- the content of a file -------------------------------------------------------------


def _parts(tables, joints, path):
    """Return the file at whose rows others stand, these, and names of those left."""
    parts, left_out = [], []
    for table in tables:
        kind = _kind_of_file(table)
        if kind is None or (table.nameless and not kind):
            left_out.append(table.path.name)
        else:
            parts.append(_part(table, kind, joints))
    if any(x.time is not None and x.kind != "t" for x in parts):
        # The others have stamps.
        left_out += [x.name for x in parts if x.kind == "t"]
        parts = [x for x in parts if x.kind != "t"]
    if len(parts) < 2:
        raise ValueError(
            f"{path}: holds {listed([x.path.name for x in tables])}, of which less "
            "than two can stand side by side; expected files called after what they "
            "hold: positions, velocities, torques, currents or time."
        )
    stamped = [x for x in parts if x.time is not None] or parts[:1]
    base = next((x for x in stamped if x.time and x.has_positions), stamped[0])
    return base, [x for x in parts if x is not base], left_out


def _kind_of_file(table):
    """Return the kind that a file is called after, "" for none; None: of no use."""
    named = kinds_in(table.path.stem)
    kinds = {"tau" if x in ("torque", "current") else x for x in named}
    kinds -= {"command", "other"}
    kind = kinds.pop() if len(kinds) == 1 else ""
    return _COMMANDS.get(kind) if kind and "command" in named else kind


def _part(table: Table, kind, joints):
    """Return a file, its columns called after the file if they have no other names."""
    plain = by_names(table, joints)
    time = next(iter(plain.of("t")), None)
    stamps = () if time is None else time.columns
    if table.nameless:
        names = _names_of_places(table, kind, joints)
        time = Role(kind="t", column="t") if "t" in names.values() else None
    elif kind in ("", "t") or plain.kinds - {"t", "segment"}:
        return _Part(table=table, time=time)
    else:
        names = _names([x for x in table.names if x not in stamps], kind, joints)
    units = {names.get(key, key): x for key, x in table.units.items()}
    if is_current(table.path.stem):
        units |= {x: "A" for x in names.values() if x not in units and x != "t"}
    frame = table.frame.rename(columns=names)
    table = replace(table, frame=frame, units=units, nameless=False)
    return _Part(table=table, time=time, kind=kind if names else "")


def _names(columns, kind, joints):
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
    stamped = count > 1 and count != n and is_clock(table.values("1"))
    if n not in (0, count - stamped):
        raise ValueError(
            f"{table.path}: has {count} column(s) without names; expected {n} of "
            f"{kind}, one for each joint, or {n + 1} with time before them."
        )
    names = {str(k + stamped): f"{kind}{k}" for k in range(1, count - stamped + 1)}
    return {"1": "t"} | names if stamped else names


# -- which rows go together ------------------------------------------------------------


def _rows(part, base):
    """Return where the rows of the base lie in a file, nan for nowhere."""
    n, n_base = part.table.n_rows, base.table.n_rows
    if part.time is None or base.time is None:
        if n != n_base:
            raise ValueError(
                f"{part.table.path}: has {n} rows and {base.name} has {n_base}; files "
                "without time stamps are joined row by row: cut "
                "both to the same rows, or give each a column t."
            )
        return np.arange(float(n))
    same_column = (x.table.values(x.time.column) for x in (part, base))
    if np.array_equal(*same_column) and not part.time.nanoseconds:
        return np.arange(float(n))
    t, at = _seconds(part), _seconds(base)
    if (np.diff(t) <= 0).any():
        raise ValueError(
            f"{part.table.path}: time does not rise in each row, so that its rows "
            f"cannot be joined with those of {base.name}; sort it, and leave out what "
            "is there twice."
        )
    period = np.median(np.diff(t))
    if n == n_base and np.abs(t - at).max() <= STEADY * period:
        return np.arange(float(n))
    rows = np.interp(at, t, np.arange(n), left=np.nan, right=np.nan)
    # Stamps that differ by rounding are the same.
    nearest = np.clip(np.searchsorted(t, at - period / 2), 0, n - 1)
    same = np.abs(t[nearest] - at) <= STEADY * period
    rows[same] = nearest[same]
    # Nothing is put between samples that are far from each other.
    inside = np.flatnonzero(~same & np.isfinite(rows))
    low = rows[inside].astype(int)
    rows[inside[t[np.minimum(low + 1, n - 1)] - t[low] > GAP_PERIODS * period]] = np.nan
    return rows


def _seconds(part):
    """Return the stamps of a file [s]."""
    stamps = part.table.values(part.time.column)
    if stamps.dtype.kind not in "biuf":
        raise ValueError(
            f"{part.table.path}: has other dates than the other files; write the time "
            "of all in seconds."
        )
    unit = channel_unit(part.table, part.time)
    seconds = stamps.astype(float) * (1.0 if unit is None else unit.factor)
    if part.time.nanoseconds:
        seconds += 1e-9 * part.table.values(part.time.nanoseconds)
    return seconds


def _how(part, rows, base):
    """Return a note on how a file was joined, "" if it was row by row."""
    if np.array_equal(rows, np.arange(part.table.n_rows)):
        return ""
    between = int((np.isfinite(rows) & (rows % 1 != 0)).sum())
    if not between:
        return f"{part.name}: rows taken by their stamps."
    return (
        f"{part.name}: interpolated by straight lines at {between} of the {rows.size} "
        f"stamps of {base.name}."
    )


def _at(values, rows):
    """Return a column at rows, numbers on straight lines between them."""
    if values.dtype.kind in "iuf" and (rows % 1).any():
        return np.interp(rows, np.arange(len(values)), values)
    return values[rows.astype(int)]
