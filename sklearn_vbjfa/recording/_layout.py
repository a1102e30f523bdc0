"""Arguments of the reader, and which columns of a file are which channels."""

import functools
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import numpy as np

from sklearn_vbjfa.recording._drives import parse_drive
from sklearn_vbjfa.recording._recording import check_dt
from sklearn_vbjfa.recording._table import (
    COMMAND_NAMES,
    EXPECTED,
    KINDS,
    LAST_PART,
    MEASURED,
    PRESETS,
    TIME_UNITS,
    RecordingRefused,
    Table,
    Unit,
    check_names,
    listed,
    split_unit,
    unit_of,
)

# A channel of a mapping, with the number or the name of one joint.
_KEY = re.compile(
    rf"({'|'.join((*COMMAND_NAMES, *KINDS))}|t$|segment$)(\d+|[_.\[(].+)?",
    re.IGNORECASE,
)


@dataclass(frozen=True, kw_only=True)
class Robot:
    """The joints whose columns are looked for."""

    names: tuple[str, ...] = ()  # in the order of the columns
    chosen: bool = False  # True if the user, or the file, names them
    in_model: tuple[str, ...] = ()  # those of the description, in its order
    slides: tuple[bool, ...] = ()  # which of these are prismatic


@dataclass
class ReadOptions:
    """The arguments of `read_recording`, see there; they are checked."""

    mapping: Any  # a dict when it is checked, as are the others of their kinds
    preset: str | None
    dt: float | None
    joint_names: Any
    gains: Any
    time_unit: str | None
    drive: Any  # its channels stand in place of torques
    urdf: str | PathLike | None
    topic: str | None

    def __post_init__(self):
        if self.dt is not None:
            check_dt(self.dt)
        for name, known in (("time_unit", TIME_UNITS), ("preset", PRESETS)):
            value = getattr(self, name)
            if value is not None and value not in known:
                raise ValueError(
                    f"{name} must be one of {', '.join(known)}; got {value!r}."
                )
        if self.preset is not None and self.mapping:
            raise ValueError(
                "give columns or a preset, not both: a preset is a mapping."
            )
        if self.drive is not None and self.gains is not None:
            raise ValueError(
                "gains are factors of columns of torques, and a drive has its own: "
                "leave gains out (command line: --gain), or the drive."
            )
        none = self.mapping in (None, {})
        self.mapping = {} if none else _parsed_mapping(self.mapping)
        self.joint_names = _distinct(self.joint_names)
        self.gains = _checked_gains(self.gains)
        if isinstance(self.drive, str):
            self.drive = parse_drive(self.drive)

    @functools.cached_property
    def _movable(self):
        if self.urdf is None:
            return ()
        from sklearn_vbjfa.model import movable_joints

        return movable_joints(self.urdf)

    @property
    def joints(self):
        """Joints of the robot as far as they are known, tuple of str."""
        return self.joint_names or self._movable

    def robot(self, table):
        """Return the robot of a file, which may name its joints."""
        in_file = np.atleast_1d(table.scalars.get("joint_names", ()))
        names = self.joint_names or _distinct(in_file)
        if self.urdf is None:
            return Robot(names=names, chosen=bool(names))
        from sklearn_vbjfa import model as models

        robot = models.load_reduced if names else models.load_model
        model = robot(self.urdf, *[names] * bool(names))
        in_model = models.joint_names(model)
        # Columns with numbers are in the order of the file, which may name what a joint
        # carries before the joint.
        in_file = tuple(name for name in self._movable if name in in_model)
        return Robot(
            names=names or in_file,
            chosen=bool(names),
            in_model=in_model,
            slides=models.is_prismatic(model),
        )

    @property
    def recorded(self):
        """Channels of torques or of the drive, the one that must be there first."""
        drive = self.drive
        if drive is None:
            return ("tau",)
        return ("tau" if drive.aliases else drive.channel, *drive.extra_channels)

    @property
    def kinds(self):
        """All kinds of channels, in order; the first two must be there."""
        return "q", *self.recorded, "v", "a"


def _distinct(joint_names):
    """Return joint names as a tuple of str, empty for None."""
    if isinstance(joint_names, str):
        raise ValueError(
            f"joint_names must be several names, one per column, got {joint_names!r}."
        )
    names = tuple(str(x) for x in (() if joint_names is None else joint_names))
    if len(set(names)) < len(names):
        raise ValueError(f"joint_names must differ from one another, got {names}.")
    return names


def _checked_gains(gains):
    """Return gains as a tuple of float, "unknown" or None."""
    if gains is None or (isinstance(gains, str) and gains == "unknown"):
        return gains
    found = np.atleast_1d(gains)
    if found.dtype.kind not in "iuf" or not np.isfinite(found).all() or 0 in found:
        raise ValueError(
            f"gains must be a factor for each joint, finite and not 0, or 'unknown'; "
            f"got {gains!r}."
        )
    return tuple(map(float, found))


def _parsed_mapping(text) -> dict[str, str]:
    """Return patterns by names of channels, out of "q=actual_q_{i},t=timestamp"."""
    if isinstance(text, Mapping):
        parts = list(text.items())
    else:
        parts = [part.partition("=")[::2] for part in str(text).split(",")]
    pairs = [(str(key).strip(), str(value).strip()) for key, value in parts]
    keys = [key for key, _ in pairs]
    wrong = [
        f"{key}={value}"
        for key, value in pairs
        if not value or keys.count(key) > 1 or _KEY.fullmatch(key) is None
    ]
    if wrong:
        raise ValueError(
            f"columns has {wrong[-1]!r}; expected "
            "CHANNEL=NAME, each channel once, with commas between them, such as "
            '"q=position_{i},tau=effort_{i},t=time". Channels are q, tau, v, a, t, '
            "segment (of one joint: q1, tau_elbow), with a drive also "
            f"{', '.join(COMMAND_NAMES)}; {{i}} stands for the joint's number and "
            "{joint} for its name."
        )
    return dict(pairs)


# Names without a joint, by kind; of those of time one called t is preferred.
_ALONE = dict.fromkeys(("t", "time", "timestamp", "stamp", "__time", "%time"), "t")
_ALONE["segment"] = "segment"
# Marks in patterns, and what they stand for.
_MARKS = (("i", r"\d{1,6}"), ("joint", ".+?"))
# Titles of names of joints, without numbers.
_TITLE = re.compile(r"(.*[^a-z])?names?[^a-z]*", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class Role:
    """A column of a channel."""

    kind: str  # q, tau, t, segment, ...
    key: int | str = 1  # number or name of the joint
    column: str  # its name
    unit: str = ""  # empty if nothing tells


@dataclass(frozen=True, kw_only=True)
class Layout:
    """The channels of a file and their columns."""

    roles: tuple[Role, ...] = ()
    # columns that are known not to be conditions of the robot
    no_signals: frozenset = frozenset()
    what: str = ""  # the kind of log that was recognised
    # whether a mapping, a preset or the format says which columns are channels
    certain: bool = False

    def of(self, *kinds):
        """Return the roles of some kinds, tuple of Role; of time the best first."""
        return tuple(role for role in self.roles if role.kind in kinds)

    @property
    def kinds(self):
        """All kinds that there are, a set."""
        return {role.kind for role in self.roles}

    @property
    def stamps(self):
        """Name of the column of the best time, list of str."""
        return [role.column for role in self.of("t")[:1]]

    @property
    def joints(self):
        """Joints that the columns are called after, tuple of str."""
        keys = dict.fromkeys(role.key for role in self.of("q") if self.certain)
        return tuple(key for key in keys if isinstance(key, str))


def laid_out(table: Table, options, robot) -> Layout:
    """Assign columns to channels, of numbered joints by the names in the file."""
    layout = _assigned(table, options, robot)
    keys = {x.key for x in layout.of(*options.kinds) if isinstance(x.key, int)}
    names = _joints_in(table, robot.names, len(keys)) if keys else ()
    roles = _by_joint(layout.roles, names, options.kinds)
    return replace(layout, roles=tuple(roles), certain=layout.certain or bool(names))


def _by_joint(roles, names, kinds):
    """Return roles, those of channels with the names of joints for their numbers."""
    from_zero = any(x.key == 0 for x in roles if x.kind in kinds)
    names = dict(enumerate(names, start=0 if from_zero else 1))
    return [
        replace(x, key=names.get(x.key, x.key)) if x.kind in kinds else x for x in roles
    ]


def _joints_in(table, joints, n):
    """Return the joints, at least n, that text in a file lists, in its order."""
    # joints: of the robot; if they are not known, only what is called names lists them.
    texts = {x: table.values(x) for x in table.frame} | table.scalars
    texts = {x: np.ravel(y) for x, y in texts.items() if y.dtype.kind in "OU"}
    alike = {}
    for name in sorted(texts, key=lambda x: [int(k) for k in re.findall(r"\d+", x)]):
        alike.setdefault(re.sub(r"\d", "", name), []).append(name)
    for title, columns in alike.items():
        lists = [texts[x] if x in table.scalars else texts[x][:1] for x in columns]
        names = [str(name) for own in lists for name in own]
        if len(names) == 1:
            # A list in one cell is as Python writes it.
            names = re.findall(r"[^\s\[\](),'\"]+", names[0])
        known = {*joints} & {*names} if joints else _TITLE.fullmatch(title)
        if not known or not len({*names}) == len(names) >= n:
            continue
        rows = [texts[x].astype(str) for x in columns if x not in table.scalars]
        if any((x != x[0]).any() for x in rows):
            raise ValueError(
                f"{table.path}: the names of the joints change from row to row, so "
                "that a column is not one joint; read the bag itself, or write one "
                "column for each joint."
            )
        return names
    return []


def _assigned(table, options, robot):
    """Assign columns to channels: by a mapping, by names, else by a preset."""
    plain = by_names(table, (*robot.names, *table.joints), options.kinds, options.drive)
    if options.mapping:
        if options.drive is not None:
            plain = _by_preset(table, options, robot, plain) or plain
        return _by_mapping(table, options.mapping, plain)
    if table.nameless:
        n = len(robot.names) or 6
        q, tau = (f"{k}-{k + n - 1}" if n > 1 else str(k) for k in (2, 2 + n))
        raise RecordingRefused(
            f"{table.path}: has no names of columns; give the places of its "
            f'{table.frame.shape[1]} columns, such as columns="t=1,q={q},tau={tau}".'
        )
    if table.joints:
        return replace(plain, certain=True)
    if options.preset is None and plain.kinds & set(options.kinds[:2]):
        return plain
    fitted = _by_preset(table, options, robot, plain)
    if fitted is None and options.preset is not None:
        expected = [f"{x.q} and {x.tau}" for x in PRESETS[options.preset]]
        raise RecordingRefused(
            f"{table.path}: does not fit the preset {options.preset!r}, which expects "
            f"columns {' or '.join(expected)}; found {listed(table.frame)}."
        )
    return fitted or plain


# -- by names --------------------------------------------------------------------------


def by_names(table: Table, joints=(), kinds=KINDS, drive=None) -> Layout:
    """Lay out columns by their own names, units in them removed."""
    # drive: what is recorded in place of torques.
    kinds = dict.fromkeys((*kinds, *KINDS))
    begins = {x: kind for kind in kinds for x in (kind, *COMMAND_NAMES.get(kind, ()))}
    if drive is not None:
        begins |= {"dq": "v", **dict.fromkeys(drive.aliases, "tau")}
    joint = "|".join(map(re.escape, joints)) or "$."
    # The longest first: q_desired is no q.
    begin = "|".join(sorted(begins, key=len, reverse=True))
    name = re.compile(
        rf"(?i:({begin}))(?:[_.\[(]?(?:(?P<joint>{joint})|0*(?P<i>\d{{1,6}}))[\])]?)?",
        re.ASCII,
    )
    found = [_named(x, name, begins) for x in table.frame]
    roles = [role for role in found if role is not None]
    exact = [role for role in roles if role.kind == "t" and is_exact(role)]
    dates = table.frame.select_dtypes(["datetime", "datetimetz"])
    if exact:
        roles = [role for role in roles if role.kind != "t" or role in exact]
    elif dates.shape[1] == 1 and all(role.kind != "t" for role in roles):
        roles.append(Role(kind="t", column=dates.columns[0]))
    return Layout(roles=tuple(roles))


def is_exact(role):
    """Return whether a column of time is called t."""
    return split_unit(role.column)[0].lower() == "t"


def _named(column, expression, begins):
    """Return the role that the name of a column says, None for none."""
    # begins: kinds by the beginning of a name.
    # Subscripts are digits, and Greek letters are spelled.
    name = unicodedata.normalize("NFKC", column).replace("τ", "tau")
    bare, unit = split_unit(name)
    # The whole name may end with a joint that is called like a unit.
    last = LAST_PART.fullmatch(bare)
    for text, in_text in ((name, ""), (bare, unit), *([last.groups()] if last else ())):
        match = expression.fullmatch(text)
        kind = begins[match[1].lower()] if match else _ALONE.get(text.lower())
        if kind and (in_text in ("", unit) or unit_of(kind, in_text)):
            return Role(kind=kind, key=_key(match), column=column, unit=in_text)
    return None


def _key(match):
    """Return the joint or its number in a name or pattern, 1 without."""
    found = match.groupdict() if match else {}
    return found.get("joint") or int(found.get("i") or 1)


def channel_unit(table: Table, role: Role) -> Unit | None:
    """Return the unit of a channel, None if nothing tells; refuse one not known."""
    unit = unit_of(role.kind, role.unit) if role.unit else None
    if role.unit and unit is None:
        raise ValueError(
            f"{table.path}: column {role.column!r} is in {role.unit!r}, which is not a "
            f"known unit of {role.kind}; expected "
            f"{EXPECTED.get(MEASURED.get(role.kind, role.kind), 'none')}. Convert it, "
            "or correct the name."
        )
    return unit


# -- by patterns -----------------------------------------------------------------------


def matches(pattern: str, table: Table, kind: str) -> list[Role]:
    """Return the columns that fit a pattern."""
    # {i} is a number, {joint} and * are anything. A unit at the end of the name counts
    # with it or without.
    bare, unit = split_unit(pattern)
    if table.nameless:
        return _in_places(bare, unit, table, kind)
    # Equal marks match equal texts.
    text, found = re.escape(bare).replace(r"\*", ".*").replace(r"\?", "."), []
    for name, anything in _MARKS:
        mark = re.escape(f"{{{name}}}")
        text = text.replace(mark, f"(?P<{name}>{anything})", 1)
        text = text.replace(mark, f"(?P={name})")
    expression = re.compile(text, re.ASCII)
    for name in table.frame:
        for text, own in (split_unit(name), (name, "")):
            match = expression.fullmatch(text)
            if match and ("" in (own, unit) or own == unit):
                role = Role(kind=kind, key=_key(match), column=name, unit=own or unit)
                found.append(role)
                break
    return found


def _in_places(places, unit, table, kind):
    """Return the columns of a table without names that are in places such as 2-7."""
    match = re.fullmatch(r"0*(\d{1,6})(?:-0*(\d{1,6}))?", places.strip())
    if match is None:
        return []
    columns = [str(k) for k in range(int(match[1]), int(match[2] or match[1]) + 1)]
    if not {*columns} <= {*table.frame}:
        return []
    return [
        Role(kind=kind, key=k, column=x, unit=unit)
        for k, x in enumerate(columns, start=1)
    ]


def _by_mapping(table: Table, mapping: dict, plain: Layout) -> Layout:
    """Lay out the columns by a mapping, and the other kinds as in another layout."""
    roles, missing = [], []
    for key, pattern in mapping.items():
        ((kind, suffix),) = _KEY.findall(key)
        joint = suffix.strip("_.[]()")
        joint = int(joint) if joint.isdecimal() else joint
        matched = matches(pattern, table, kind.lower())
        missing += [] if matched else [pattern]
        roles += [replace(role, key=joint or role.key) for role in matched]
    if missing:
        raise RecordingRefused(
            f"{table.path}: has no column {', '.join(missing)}, which columns asks "
            f"for; found {listed(table.frame)}"
        )
    mapped = [role.column for role in roles]
    check_names(table.path, mapped, "columns names")
    # Of a channel some of whose columns are another's nothing is left, of times some.
    taken = {role.kind for role in plain.roles if role.column in mapped} - {"t"}
    taken |= {role.kind for role in roles}
    roles += [x for x in plain.roles if x.kind not in taken and x.column not in mapped]
    # What nobody has named is no signal.
    others = frozenset(table.frame) if table.nameless else plain.no_signals
    return replace(plain, roles=tuple(roles), no_signals=others, certain=True)


# -- by a preset -----------------------------------------------------------------------


def _by_preset(table: Table, options, robot, plain):
    """Return the layout of the first known log that the columns fit, or None."""
    names = PRESETS if options.preset is None else [options.preset]
    logs = [log for name in names for log in PRESETS[name]]
    fitted = (_fitted(table, x, plain, robot, options.recorded) for x in logs)
    return next((x for x in fitted if x is not None), None)


def _fitted(table, log, plain, robot, recorded):
    """Lay out columns as in a known log; None if they are not those."""
    patterns = {"q": log.q, "tau": log.tau, "v": log.v, **log.commands}
    patterns = {kind: patterns.get(kind) for kind in ("q", "v", *recorded)}
    found = {kind: matches(x, table, kind) for kind, x in patterns.items() if x}
    first = recorded[0]
    if log.motors and robot.names:
        # A message has a place for more motors than most robots have.
        n = len(robot.names)
        found = {kind: [x for x in own if x.key < n] for kind, own in found.items()}
    keys = {kind: {x.key for x in roles} for kind, roles in found.items()}
    shared = keys["q"] & keys.get(first, set())
    others = "{joint}" in log.q and robot.names and not shared & set(robot.names)
    if not shared or others:
        return None
    motors = [[x for x in robot.names if part in x] for part in log.motors]
    known = len(motors) == len(robot.names) and all(len(x) == 1 for x in motors)
    names = [x for (x,) in motors] if known and not robot.chosen else ()
    roles = [
        role
        for kind, matched in found.items()
        if kind in ("q", first) or shared <= keys[kind]
        for role in matched
    ]
    roles = _by_joint(roles, names, found)
    if log.segment in table.frame:
        roles.append(Role(kind="segment", column=log.segment))
    times = [matches(name, table, "t") for name in log.times]
    times = [replace(x[0], unit=x[0].unit or "s") for x in times if len(x) == 1]
    no_signals = re.compile("|".join(log.no_signals) or "$.")
    return Layout(
        roles=(*roles, *(times or plain.of("t"))),
        no_signals=frozenset(filter(no_signals.fullmatch, table.frame)),
        what=log.what,
        certain=True,
    )


def refuse_two(table, one, other):
    """Refuse two columns that could both be meant."""
    if one != other:
        raise ValueError(
            f"{table.path}: columns {one!r} and {other!r} could both be meant; rename "
            "or remove the one that is not."
        )
