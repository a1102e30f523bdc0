"""Arguments of the reader, and assignment of a file's columns to channels."""

import functools
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
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
    NAMES_TITLE,
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

# Key of a mapping: a channel, optionally with the number or name of one joint.
_KEY = re.compile(
    rf"({'|'.join((*COMMAND_NAMES, *KINDS))}|t$|segment$)(\d+|[_.\[(].+)?",
    re.IGNORECASE,
)


@dataclass(frozen=True, kw_only=True)
class Robot:
    """The joints whose columns are searched for."""

    names: tuple[str, ...] = ()  # in the order of the columns
    explicit: bool = False  # True if the user or the file names the joints
    # joints of the URDF or MJCF in its order, True for prismatic ones
    in_model: Mapping[str, bool] = field(default_factory=dict)


@dataclass
class ReadOptions:
    """Validated arguments of `read_recording`."""

    columns: Any  # a dict of patterns by channel after validation
    preset: str | None
    dt: float | None
    joint_names: Any
    gains: Any
    time_unit: str | None
    drive: Any  # a `Drive`, whose channels replace the torques
    urdf: str | PathLike | None
    topic: str | None

    def __post_init__(self):
        if self.dt is not None:
            check_dt(self.dt)
        for name, allowed in (("time_unit", TIME_UNITS), ("preset", PRESETS)):
            value = getattr(self, name)
            if value is not None and value not in allowed:
                raise ValueError(
                    f"{name} must be one of {', '.join(allowed)}; got {value!r}."
                )
        if self.preset is not None and self.columns:
            raise ValueError("give columns or a preset, not both: both map columns.")
        if self.drive is not None and self.gains is not None:
            raise ValueError(
                "gains are factors of columns of torques, and a drive has its own: "
                "leave gains out (command line: --gain), or the drive."
            )
        is_empty = self.columns in (None, {})
        self.columns = {} if is_empty else _parse_mapping(self.columns)
        self.joint_names = _unique_names(self.joint_names)
        self.gains = _check_gains(self.gains)
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
        """Names of the robot's joints, empty if unknown, tuple of str."""
        return self.joint_names or self._movable

    def robot(self, table):
        """Return the `Robot` of a table, which may contain joint names."""
        file_names = np.atleast_1d(table.scalars.get("joint_names", ()))
        names = self.joint_names or _unique_names(file_names)
        if self.urdf is None:
            return Robot(names=names, explicit=bool(names))
        from sklearn_vbjfa import model as models

        load = models.load_reduced if names else models.load_model
        model = load(self.urdf, *[names] * bool(names))
        slides = map(bool, models.is_prismatic(model))
        in_model = dict(zip(models.joint_names(model), slides))
        # Numbered columns follow the order of joints in the description file, where a
        # child joint may precede its parent.
        file_names = tuple(name for name in self._movable if name in in_model)
        names, explicit = names or file_names, bool(names)
        return Robot(names=names, explicit=explicit, in_model=in_model)

    @property
    def recorded(self):
        """Channels of torques or of the drive, the required one first."""
        drive = self.drive
        if drive is None:
            return ("tau",)
        return ("tau" if drive.aliases else drive.channel, *drive.extra_channels)

    @property
    def kinds(self):
        """All kinds of channels, in order; the first two are required."""
        return "q", *self.recorded, "v", "a"


def _unique_names(joint_names):
    """Return joint names as a tuple of str, empty for None."""
    if isinstance(joint_names, str):
        raise ValueError(
            f"joint_names must be several names, one per column, got {joint_names!r}."
        )
    names = tuple(str(x) for x in (() if joint_names is None else joint_names))
    if len(set(names)) < len(names):
        raise ValueError(f"joint_names must differ from one another, got {names}.")
    return names


def _check_gains(gains):
    """Validate gains; return a tuple of float, "unknown" or None."""
    if gains is None or (isinstance(gains, str) and gains == "unknown"):
        return gains
    values = np.atleast_1d(gains)
    if values.dtype.kind not in "iuf" or not np.isfinite(values).all() or 0 in values:
        raise ValueError(
            f"gains must be a factor for each joint, finite and not 0, or 'unknown'; "
            f"got {gains!r}."
        )
    return tuple(map(float, values))


def _parse_mapping(text) -> dict[str, str]:
    """Parse "q=actual_q_{i},t=timestamp" into patterns by channel name."""
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


# Channels without a joint, by column name; "t" is preferred among columns of time.
_JOINTLESS = dict.fromkeys(("t", "time", "timestamp", "stamp", "__time", "%time"), "t")
_JOINTLESS["segment"] = "segment"
# Placeholders of patterns, and the regular expressions that they match.
_MARKS = (("i", r"\d{1,6}"), ("joint", ".+?"))


@dataclass(frozen=True, kw_only=True)
class Role:
    """A column and the channel to which it is assigned."""

    kind: str  # q, tau, t, segment, ...
    key: int | str = 1  # number or name of the joint
    column: str
    unit: str = ""  # empty if unknown


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Assignment of a file's columns to channels."""

    roles: tuple[Role, ...] = ()
    # columns that cannot be signals, such as counters and references
    no_signals: frozenset = frozenset()
    what: str = ""  # type of log that was recognised
    # True if identified by a mapping, a preset or the format, not by names alone
    certain: bool = False

    def select(self, *kinds):
        """Return the roles of some kinds, tuple of Role; the preferred time first."""
        return tuple(role for role in self.roles if role.kind in kinds)

    @property
    def kinds(self):
        """Kinds of all assigned columns, a set of str."""
        return {role.kind for role in self.roles}

    @property
    def stamps(self):
        """Name of the preferred time column, list of at most one str."""
        return [role.column for role in self.select("t")[:1]]

    @property
    def joints(self):
        """Joint names in the columns of positions, tuple of str."""
        keys = dict.fromkeys(role.key for role in self.select("q") if self.certain)
        return tuple(key for key in keys if isinstance(key, str))


def find_layout(table: Table, options, robot) -> Layout:
    """Assign columns to channels; name numbered joints by a list in the file."""
    layout = _assign_columns(table, options, robot)
    keys = {x.key for x in layout.select(*options.kinds) if isinstance(x.key, int)}
    names = _listed_joint_names(table, robot.names, len(keys)) if keys else ()
    roles = _with_joint_names(layout.roles, names, options.kinds)
    return replace(layout, roles=tuple(roles), certain=layout.certain or bool(names))


def _with_joint_names(roles, names, kinds):
    """Replace joint numbers of roles of some kinds by joint names."""
    from_zero = any(x.key == 0 for x in roles if x.kind in kinds)
    names = dict(enumerate(names, start=0 if from_zero else 1))
    keys = [names.get(x.key, x.key) if x.kind in kinds else x.key for x in roles]
    return [replace(x, key=key) for x, key in zip(roles, keys)]


def _listed_joint_names(table, joints, n):
    """Return at least n joint names listed as text in a file, in its order, or []."""
    # joints: of the robot; if unknown, the title of the list must contain "name".
    texts = {x: table.values(x) for x in table.frame} | table.scalars
    texts = {x: np.ravel(y) for x, y in texts.items() if y.dtype.kind in "OU"}
    groups = {}
    for name in sorted(texts, key=lambda x: [int(k) for k in re.findall(r"\d+", x)]):
        groups.setdefault(re.sub(r"\d", "", name), []).append(name)
    for title, columns in groups.items():
        lists = [texts[x] if x in table.scalars else texts[x][:1] for x in columns]
        names = [str(name) for entries in lists for name in entries]
        if len(names) == 1:
            # A single cell holds a list as printed by Python.
            names = re.findall(r"[^\s\[\](),;|'\"]+", names[0])
        is_list = {*joints} & {*names} if joints else NAMES_TITLE.fullmatch(title)
        if not is_list or not len({*names}) == len(names) >= n:
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


def _assign_columns(table, options, robot):
    """Assign columns to channels by a mapping, by names or by a preset."""
    joints = *robot.names, *table.joints
    named = assign_by_name(table, joints, options.kinds, options.drive)
    if options.columns:
        if options.drive is not None:
            named = _match_preset(table, options, robot, named) or named
        return _apply_mapping(table, options.columns, named)
    if table.nameless:
        n = len(robot.names) or 6
        q, tau = (f"{k}-{k + n - 1}" if n > 1 else str(k) for k in (2, 2 + n))
        width = table.frame.shape[1]
        if width < 2 * len(robot.names):
            remedy = (
                f"its {width} columns are too few for positions and torques of {n} "
                "joints: write all that was measured at one time into one row"
            )
        else:
            remedy = (
                f"give the places of its {width} columns, such as "
                f'columns="t=1,q={q},tau={tau}"'
            )
        raise RecordingRefused(f"{table.path}: has no names of columns; {remedy}.")
    if table.joints:
        return replace(named, certain=True)
    if options.preset is None and named.kinds & set(options.kinds[:2]):
        return named
    fitted = _match_preset(table, options, robot, named)
    if fitted is None and options.preset is not None:
        expected = [f"{x['q']} and {x['tau']}" for x in PRESETS[options.preset]]
        raise RecordingRefused(
            f"{table.path}: does not fit the preset {options.preset!r}, which expects "
            f"columns {' or '.join(expected)}; found {listed(table.frame)}."
        )
    return fitted or named


def assign_by_name(table: Table, joints=(), kinds=KINDS, drive=None) -> Layout:
    """Assign columns to channels by their names, without units."""
    # drive: control law whose channels replace the torques, or None.
    kinds = dict.fromkeys((*kinds, *KINDS))
    prefixes = {x: kind for kind in kinds for x in (kind, *COMMAND_NAMES.get(kind, ()))}
    if drive is not None:
        prefixes |= {"dq": "v", **dict.fromkeys(drive.aliases, "tau")}
    joint = "|".join(map(re.escape, joints)) or "$."
    # The longest first: q_desired must not match q.
    prefix = "|".join(sorted(prefixes, key=len, reverse=True))
    expression = re.compile(
        rf"(?i:({prefix}))(?:[_.\[(]?(?:(?P<joint>{joint})|0*(?P<i>\d{{1,6}}))[\])]?)?",
        re.ASCII,
    )
    candidates = [_match_name(x, expression, prefixes) for x in table.frame]
    roles = [role for role in candidates if role is not None]
    exact = [role for role in roles if role.kind == "t" and is_exact(role)]
    dates = table.frame.select_dtypes(["datetime", "datetimetz"])
    if exact:
        roles = [role for role in roles if role.kind != "t" or role in exact]
    elif dates.shape[1] == 1 and all(role.kind != "t" for role in roles):
        roles.append(Role(kind="t", column=dates.columns[0]))
    return Layout(roles=tuple(roles))


def is_exact(role):
    """Return whether the name of a column of time is t, without its unit."""
    return split_unit(role.column)[0].lower() == "t"


def _match_name(column, expression, prefixes):
    """Return the role that a column's name implies, or None."""
    # prefixes: kinds by prefix of a name. NFKC turns subscripts into digits.
    name = unicodedata.normalize("NFKC", column).replace("τ", "tau")
    bare, unit = split_unit(name)
    # The complete name first: it may end with a joint that is spelled like a unit.
    last = LAST_PART.fullmatch(bare)
    for text, in_text in ((name, ""), (bare, unit), *([last.groups()] if last else ())):
        match = expression.fullmatch(text)
        kind = prefixes[match[1].lower()] if match else _JOINTLESS.get(text.lower())
        if kind and (in_text in ("", unit) or unit_of(kind, in_text)):
            return Role(kind=kind, key=_key(match), column=column, unit=in_text)
    return None


def _key(match):
    """Return the joint's name or number in a match, 1 if it has neither."""
    groups = match.groupdict() if match else {}
    return groups.get("joint") or int(groups.get("i") or 1)


def channel_unit(table: Table, role: Role) -> Unit | None:
    """Return the unit of a channel, None if not stated; refuse an unknown unit."""
    unit = unit_of(role.kind, role.unit) if role.unit else None
    if role.unit and unit is None:
        raise ValueError(
            f"{table.path}: column {role.column!r} is in {role.unit!r}, which is not a "
            f"known unit of {role.kind}; expected "
            f"{EXPECTED.get(MEASURED.get(role.kind, role.kind), 'none')}. Convert it, "
            "or correct the name."
        )
    return unit


def match_pattern(pattern: str, table: Table, kind: str) -> list[Role]:
    """Return the roles of columns that match a pattern."""
    # {i} matches a number, {joint} and * any text; the unit may be missing.
    bare, unit = split_unit(pattern)
    if table.nameless:
        return _columns_at(bare, unit, table, kind)
    # A repeated placeholder must match the same text.
    text, roles = re.escape(bare).replace(r"\*", ".*").replace(r"\?", "."), []
    for name, anything in _MARKS:
        mark = re.escape(f"{{{name}}}")
        text = text.replace(mark, f"(?P<{name}>{anything})", 1)
        text = text.replace(mark, f"(?P={name})")
    expression = re.compile(text, re.ASCII)
    for name in table.frame:
        for text, end in (split_unit(name), (name, "")):
            match = expression.fullmatch(text)
            if match and ("" in (end, unit) or end == unit):
                role = Role(kind=kind, key=_key(match), column=name, unit=end or unit)
                roles.append(role)
                break
    return roles


def _columns_at(pattern, unit, table, kind):
    """Return the roles of columns without names, from a range such as 2-7."""
    match = re.fullmatch(r"0*(\d{1,6})(?:-0*(\d{1,6}))?", pattern.strip())
    if match is None:
        return []
    columns = [str(k) for k in range(int(match[1]), int(match[2] or match[1]) + 1)]
    if not {*columns} <= {*table.frame}:
        return []
    numbered = enumerate(columns, start=1)
    return [Role(kind=kind, key=k, column=x, unit=unit) for k, x in numbered]


def _apply_mapping(table: Table, mapping: dict, named: Layout) -> Layout:
    """Assign columns by a mapping, and the remaining channels by their names."""
    roles, unmatched = [], []
    for key, pattern in mapping.items():
        ((kind, suffix),) = _KEY.findall(key)
        joint = suffix.strip("_.[]()")
        joint = int(joint) if joint.isdecimal() else joint
        matched = match_pattern(pattern, table, kind.lower())
        unmatched += [] if matched else [pattern]
        roles += [replace(role, key=joint or role.key) for role in matched]
    if unmatched:
        raise RecordingRefused(
            f"{table.path}: has no column {', '.join(unmatched)}, which columns asks "
            f"for; found {listed(table.frame)}"
        )
    mapped = [role.column for role in roles]
    check_names(table.path, mapped, "columns names")
    # A channel that lost a column to the mapping is discarded, except for time.
    taken = {role.kind for role in named.roles if role.column in mapped} - {"t"}
    taken |= {role.kind for role in roles}
    roles += [x for x in named.roles if x.kind not in taken and x.column not in mapped]
    # Columns without names are not used as signals.
    others = frozenset(table.frame) if table.nameless else named.no_signals
    return replace(named, roles=tuple(roles), no_signals=others, certain=True)


def _match_preset(table: Table, options, robot, named):
    """Return the layout of the first preset log that matches the columns, or None."""
    names = PRESETS if options.preset is None else [options.preset]
    logs = [log for name in names for log in PRESETS[name]]
    fitted = (_match_log(table, x, named, robot, options.recorded) for x in logs)
    return next((x for x in fitted if x is not None), None)


def _match_log(table, log, named, robot, recorded):
    """Assign columns as in a known log; return None if they do not match it."""
    patterns = log | log.get("commands", {})
    kinds = [kind for kind in ("q", "v", *recorded) if kind in patterns]
    hits = {kind: match_pattern(patterns[kind], table, kind) for kind in kinds}
    first = recorded[0]
    parts = log.get("motors", ())
    if parts and robot.names:
        # Messages have entries for more motors than most robots use.
        n = len(robot.names)
        hits = {kind: [x for x in roles if x.key < n] for kind, roles in hits.items()}
    keys = {kind: {x.key for x in roles} for kind, roles in hits.items()}
    shared = keys["q"] & keys.get(first, set())
    by_name = "{joint}" in log["q"] and robot.names
    if not shared or (by_name and not shared & {*robot.names}):
        return None
    motors = [[x for x in robot.names if part in x] for part in parts]
    has_motors = len(motors) == len(robot.names) and all(len(x) == 1 for x in motors)
    names = [x for (x,) in motors] if has_motors and not robot.explicit else ()
    kept = [
        x for kind, x in hits.items() if kind in ("q", first) or shared <= keys[kind]
    ]
    roles = _with_joint_names([role for x in kept for role in x], names, hits)
    if log.get("segment") in table.frame:
        roles.append(Role(kind="segment", column=log["segment"]))
    times = [match_pattern(name, table, "t") for name in log["times"]]
    times = [replace(x[0], unit=x[0].unit or "s") for x in times if len(x) == 1]
    roles = *roles, *(times or named.select("t"))
    no_signals = re.compile("|".join(log["no_signals"]))
    unused = frozenset(filter(no_signals.fullmatch, table.frame))
    return Layout(roles=roles, no_signals=unused, what=log["what"], certain=True)


def refuse_ambiguous(table, first, other):
    """Raise an error if two different columns fit the same role."""
    if first != other:
        raise ValueError(
            f"{table.path}: columns {first!r} and {other!r} could both be meant; "
            "rename or remove the one that is not."
        )
