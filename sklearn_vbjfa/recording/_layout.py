"""Which columns of a file are which channels: by names, a mapping or a preset."""

import functools
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike

import numpy as np

from sklearn_vbjfa.recording._drives import Drive
from sklearn_vbjfa.recording._presets import PRESETS, KnownLog
from sklearn_vbjfa.recording._table import Loss, RecordingRefused, Table, listed
from sklearn_vbjfa.recording._units import (
    EXPECTED,
    KINDS,
    MEASURED,
    Unit,
    split_last_part,
    split_unit,
    unit_of,
)

# Commands of joints, and further names that logs have for them. qd is in neither list:
# some mean a desired position, others a velocity.
_COMMANDS = {
    "q_desired": ("q_des", "q_cmd", "q_target", "q_ref")
    + ("target_position", "goal_position", "position_command"),
    "v_desired": ("v_des", "dq_des", "dq_cmd", "target_velocity"),
    "tau_ff": ("tau_feedforward",),
    "kp": (),
    "kd": (),
    "supply": (),
}
# A motor's own estimate of its torque, where there is no other.
ESTIMATES, _ESTIMATED = ("tau_est", "tauest"), "estimate"
_KEY = re.compile(
    rf"({'|'.join((*_COMMANDS, *KINDS))})(\d+|[_.\[(].+)?|t|segment", re.IGNORECASE
)
# Columns that can only be time, where none is called t.
_TIMES = {"t", "time", "timestamp", "stamp", "__time", "%time"}
# How the parts of a ROS stamp are called.
_CLOCK_PARTS = (("secs", "nsecs"), ("sec", "nsec"), ("sec", "nanosec"))
# What stands for others in patterns, as regular expressions escape it.
_MARKS = (
    (r"\{i\}", "i", r"\d{1,6}"),
    (r"\{joint\}", "joint", ".+?"),
    (r"\*", "any", ".*"),
)
# Numbers have so many digits.
_NUMBER = re.compile(r"0*(\d{1,6})", re.ASCII)


@dataclass(frozen=True, kw_only=True)
class Role:
    """A column of a channel."""

    column: str  # its name
    unit: str = ""  # empty if nothing tells
    nanoseconds: str = ""  # column of those within the seconds of this one

    @property
    def columns(self):
        """Names of all its columns, tuple of str."""
        return (self.column, self.nanoseconds) if self.nanoseconds else (self.column,)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """The channels of a file and their columns."""

    # by kind, such as q, then by number (int) or joint (str), lists of `Role`
    channels: dict
    times: tuple[Role, ...] = ()  # the best first
    segments: tuple[str, ...] = ()  # columns of labels
    # columns that are known not to be conditions of the robot
    no_signals: frozenset = frozenset()
    what: str = ""  # the kind of log that was recognised
    # whether a mapping, a preset or the format says which columns are channels
    certain: bool = False

    def roles(self, kind):
        """Return all columns of a kind, list of `Role`."""
        return [
            role for roles in self.channels.get(kind, {}).values() for role in roles
        ]

    @property
    def joints(self):
        """Joints that the columns are called after, tuple of str."""
        found = self.channels.get("q", {}) if self.certain else ()
        return tuple(key for key in found if isinstance(key, str))


@dataclass(frozen=True, kw_only=True)
class Robot:
    """The joints that columns are looked for of."""

    names: tuple[str, ...] = ()  # in the order of the columns
    chosen: bool = False  # whether the user, or the file, names them
    in_model: tuple[str, ...] = ()  # those of the description, in its order
    slides: tuple[bool, ...] = ()  # which of these are prismatic


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """The checked arguments of `read_recording`."""

    mapping: dict
    preset: str | None
    dt: float | None
    urdf: str | PathLike | None
    joint_names: tuple[str, ...] | None
    topic: str | None
    gains: tuple[float, ...] | str | None
    time_unit: str | None
    drive: Drive | None  # its channels stand in place of torques

    @functools.cached_property
    def _movable(self):
        if self.urdf is None:
            return ()
        from sklearn_vbjfa.model import movable_joints

        return movable_joints(self.urdf)

    @functools.cached_property
    def joints(self):
        """Joints of the robot as far as they are known, tuple of str."""
        return _distinct(self.joint_names) or self._movable

    def robot(self, table):
        """Return the robot of a file, which may name its joints."""
        names = _distinct(self.joint_names)
        if self.joint_names is None and "joint_names" in table.scalars:
            known = np.atleast_1d(table.scalars["joint_names"])
            names = _distinct([str(x) for x in known])
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
        return ("tau" if drive.spelled else drive.told, *drive.beside)

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
    names = tuple(str(x) for x in joint_names or ())
    if len(set(names)) < len(names):
        raise ValueError(f"joint_names must differ from one another, got {names}.")
    return names


def laid_out(table: Table, options: ReadOptions, robot: Robot) -> Layout:
    """Assign columns to channels: by a mapping, by names, else by a preset."""
    if options.preset is not None and options.mapping:
        raise RecordingRefused(
            "give columns or a preset, not both: a preset is a mapping.",
            {"preset": None},
        )
    names = (*robot.names, *table.joints)
    kinds = dict.fromkeys((*options.kinds, *KINDS))
    plain = by_names(table, names, kinds, options.drive)
    if options.mapping:
        if options.drive is not None:
            rest = list(_by_preset(table, options, robot, plain).values())
            plain = rest[0] if len(rest) == 1 else plain
        return _by_mapping(table, options.mapping, plain)
    if table.nameless:
        n = len(robot.names) or 6
        ends = [f"{k}-{k + n - 1}" if n > 1 else str(k) for k in (2, 2 + n)]
        raise RecordingRefused(
            f"{table.path}: has no names of columns; give the places of its "
            f"{len(table.names)} columns (command line: --columns), such as "
            f'columns="t=1,q={ends[0]},tau={ends[1]}".'
        )
    if table.joints:
        return replace(plain, certain=True)
    by_name = any(kind in plain.channels for kind in options.kinds[:2])
    if by_name and options.preset is None:
        return plain
    fitted = _by_preset(table, options, robot, plain)
    if len(fitted) > 1:
        raise RecordingRefused(
            f"{table.path}: could be {' or '.join(x.what for x in fitted.values())}; "
            f"give preset={' or '.join(map(repr, fitted))}.",
            {"preset": next(iter(fitted))},
        )
    if not fitted and options.preset is not None:
        expected = [f"{x.q} and {x.tau}" for x in PRESETS[options.preset]]
        raise RecordingRefused(
            f"{table.path}: does not fit the preset {options.preset!r}, which expects "
            f"columns {' or '.join(expected)}; found {listed(table.names)}."
        )
    return next(iter(fitted.values()), plain)


def _add(channels, kind, key, role):
    channels.setdefault(kind, {}).setdefault(key, []).append(role)


# -- by names --------------------------------------------------------------------------


def name_and_unit(table: Table, column: str) -> tuple[str, str]:
    """Return a column's name without the unit that stands with it, and that unit."""
    bare, unit = split_unit(column)
    return (bare, unit) if unit else (column, table.units.get(column, ""))


def by_names(table: Table, joints=(), kinds=KINDS, drive=None) -> Layout:
    """Lay out columns by their own names, units in them removed."""
    # drive: what is recorded in place of torques.
    begins = [(one, kind) for kind in kinds for one in (kind, *_COMMANDS.get(kind, ()))]
    if drive is None:
        begins += [(one, _ESTIMATED) for one in ESTIMATES]
    else:
        begins += [("dq", "v")] + [(x, "tau") for x in drive.spelled]
    # The longest first: q_desired is no q.
    begins.sort(key=lambda x: -len(x[0]))
    clocks = _clocks_of_two(table)
    parts = {name for clock in clocks for name in clock.columns}
    channels: dict[str, dict] = {}
    times, segments = [], []
    for name in table.names:
        if name in parts:
            continue
        bare, unit = (_in_letters(x) for x in name_and_unit(table, name))
        stem, last = split_last_part(bare, "t")
        if bare.lower() in _TIMES:
            times.append(Role(column=name, unit=unit))
        elif last and not unit and stem.lower() in _TIMES:
            times.append(Role(column=name, unit=last))
        elif bare.lower() == "segment":
            segments.append(name)
        else:
            kind, key, unit = _channel(_in_letters(name), bare, unit, begins, joints)
            if kind:
                _add(channels, kind, key, Role(column=name, unit=unit))
    estimates = channels.pop(_ESTIMATED, None)
    if estimates is not None:
        channels.setdefault("tau", estimates)
    exact = [x for x in times if is_exact(table, x)]
    if not times and len(clocks) == 1:
        times = clocks
    return Layout(
        channels=channels, times=tuple(exact or times), segments=tuple(segments)
    )


def is_exact(table, role):
    """Whether a column of time is called t."""
    return name_and_unit(table, role.column)[0].lower() == "t"


def _channel(name, bare, unit, begins, joints):
    """Return the kind of a column, its number or joint, and unit; "" for no kind."""
    for begin, kind in begins:
        if not name.lower().startswith(begin):
            continue
        measured = "tau" if kind == _ESTIMATED else kind
        stem, last = (bare, unit) if unit else split_last_part(bare, measured)
        # The whole name may end with a joint that is called like a unit.
        for text, in_text in ((name, ""), (bare, unit), (stem, last)):
            match = re.fullmatch(
                rf"{begin}[_.\[(]?(.*?)[\])]?", text, re.IGNORECASE | re.DOTALL
            )
            key = match[1] if match else ""
            if key and key in joints:
                return kind, key, unit if text == bare else in_text
            number = _NUMBER.fullmatch(key)
            if number:
                return kind, int(number[1]), in_text or unit
            if text.lower() == begin and (not in_text or unit_of(measured, in_text)):
                return kind, 1, in_text or unit
    return "", "", ""


def _clocks_of_two(table):
    """Return the clocks that have a column of seconds and one of nanoseconds."""
    return [
        Role(column=name, unit="s", nanoseconds=other)
        for name in table.names
        for seconds, nanoseconds in _CLOCK_PARTS
        if name.lower().endswith(seconds)
        and (other := name[: -len(seconds)] + nanoseconds) in table.frame
    ]


def _in_letters(name):
    """Return a name with plain digits for subscripts, and tau for the Greek letter."""
    return unicodedata.normalize("NFKC", name).replace("τ", "tau")


def channel_unit(table: Table, kind: str, role: Role) -> Unit | None:
    """Return the unit of a channel, None if nothing tells; refuse one not known."""
    unit = unit_of(kind, role.unit) if role.unit else None
    if role.unit and unit is None:
        raise ValueError(
            f"{table.path}: column {role.column!r} is in {role.unit!r}, which is not a "
            f"known unit of {kind}; expected {EXPECTED[MEASURED.get(kind, kind)]}. "
            "Convert it, or correct the name."
        )
    return unit


# -- by a mapping ----------------------------------------------------------------------


def parse_mapping(text) -> dict[str, str]:
    """Return patterns by names of channels, out of "q=actual_q_{i},t=timestamp"."""
    if isinstance(text, Mapping):
        pairs = [(str(key), str(value)) for key, value in text.items()]
    else:
        parts = [part.partition("=") for part in str(text).split(",")]
        pairs = [(key.strip(), value.strip()) for key, _, value in parts]
    found: dict[str, str] = {}
    for key, value in pairs:
        if not key or not value:
            raise ValueError(
                f"columns has {key or value!r}; expected "
                "pairs CHANNEL=NAME with commas between them, such as "
                '"q=position_{i},tau=effort_{i},t=time".'
            )
        if _KEY.fullmatch(key) is None:
            raise ValueError(
                f"columns does not know the channel {key!r}; expected q, tau, v, a, t "
                "or segment (or one joint's: q1, tau_elbow), with a drive also "
                f"{', '.join(_COMMANDS)}, then = and a name in the file, in which "
                "{i} stands for the joint's number and {joint} for its name."
            )
        if key in found:
            raise ValueError(
                f"columns has the channel {key!r} twice ({found[key]!r} and "
                f"{value!r}); keep one."
            )
        found[key] = value
    if not found:
        raise ValueError('columns is empty; expected e.g. "q=position_{i},t=time".')
    return found


@dataclass(frozen=True)
class Match:
    """A column that fits a pattern: text of *, number or joint, and its unit."""

    prefix: str
    key: int | str
    column: str
    unit: str


def matches(pattern: str, table: Table, kind="") -> list[Match]:
    """Return the columns that fit a pattern."""
    # {i} is a number, {joint} and * are anything. A unit at the end of the name counts
    # with it or without, one before the number where a kind is given.
    bare, unit = split_unit(pattern)
    if table.nameless:
        return _in_places(bare, unit, table)
    written = unit
    if kind and not unit and bare.endswith("_{i}"):
        unit = split_last_part(bare.removesuffix("_{i}"), kind)[1]
    expression, without = _expression(pattern), _expression(bare)
    found = []
    for name in table.names:
        stripped, in_name = name_and_unit(table, name)
        match = expression.fullmatch(name) or without.fullmatch(stripped)
        if match is None or (in_name and written and in_name != written):
            continue
        groups = match.groupdict()
        key = groups.get("joint") or int(groups.get("i", 1))
        found.append(Match(groups.get("any", ""), key, name, in_name or unit))
    return found


def _in_places(places, unit, table):
    """Return the columns of a table without names that are in places such as 2-7."""
    match = re.fullmatch(r"0*(\d{1,6})(?:-0*(\d{1,6}))?", places.strip())
    if match is None:
        return []
    columns = [str(k) for k in range(int(match[1]), int(match[2] or match[1]) + 1)]
    if not all(x in table.frame for x in columns):
        return []
    return [Match("", k, x, unit) for k, x in enumerate(columns, start=1)]


@functools.cache
def _expression(pattern):
    """Turn a pattern into a regular expression; what comes twice is the same."""
    text = re.escape(pattern)
    for mark, name, anything in _MARKS:
        text = text.replace(mark, f"(?P<{name}>{anything})", 1)
        text = text.replace(mark, f"(?P={name})")
    return re.compile(text, re.ASCII)


def _by_mapping(table: Table, mapping: dict, plain: Layout) -> Layout:
    """Lay out the columns by a mapping, and the other kinds as in another layout."""
    known = {key: _KEY.fullmatch(key) for key in mapping}
    kinds = {key: (x[1] if x and x[1] else key).lower() for key, x in known.items()}
    found = {x: matches(mapping[x], table, kinds[x]) for x in mapping}
    missing = [mapping[key] for key, matched in found.items() if not matched]
    if missing:
        raise RecordingRefused(
            f"{table.path}: has no column {', '.join(missing)}, which columns asks "
            f"for; found {listed(table.names)}"
        )
    owner = _owners(table, mapping, found)
    channels: dict[str, dict] = {}
    for key, matched in found.items():
        kind = kinds[key]
        own = channels.setdefault(kind, {})
        suffix = key[len(kind) :].strip("_.[]()")
        for match in matched:
            name = int(suffix) if suffix.isdecimal() else suffix or match.key
            if owner[match.column] != key:
                continue
            if name in own and kind not in ("t", "segment"):
                raise RecordingRefused(
                    f"{table.path}: columns {own[name][0].column!r} and "
                    f"{match.column!r} both fit {key}={mapping[key]}; say which one"
                )
            _add(channels, kind, name, Role(column=match.column, unit=match.unit))
    given = Layout(channels=channels)
    times, segments = given.roles("t"), given.roles("segment")
    channels = {k: x for k, x in channels.items() if k not in ("t", "segment")}
    for kind in () if table.nameless else plain.channels:
        if kind not in channels and not any(
            x.column in owner for x in plain.roles(kind)
        ):
            channels[kind] = plain.channels[kind]
    return replace(
        plain,
        channels=channels,
        times=tuple(times) or tuple(x for x in plain.times if x.column not in owner),
        segments=tuple(x.column for x in segments) or plain.segments,
        # What nobody has named is no signal.
        no_signals=frozenset(table.names if table.nameless else plain.no_signals),
        certain=True,
    )


def _owners(table, mapping, found):
    """Return the key of a mapping for each column that fits one."""
    # Of patterns that fit the same column, the one counts that spells out more of it.
    marks = re.compile(r"\{i\}|\{joint\}|\*")
    spelled = {key: len(marks.sub("", x)) for key, x in mapping.items()}
    owner: dict[str, str] = {}
    for key, matched in found.items():
        for match in matched:
            other = owner.setdefault(match.column, key)
            if other != key and spelled[other] == spelled[key]:
                raise RecordingRefused(
                    f"{table.path}: columns names {match.column!r} twice, for {other} "
                    f"and {key}; each column is one channel"
                )
            owner[match.column] = max(other, key, key=spelled.get)
    return owner


# -- by a preset -----------------------------------------------------------------------


def _by_preset(table: Table, options, robot, plain):
    """Return the layouts of known logs that the columns fit, by preset."""
    found = {}
    for preset, logs in PRESETS.items():
        if options.preset in (None, preset):
            fitted = (_fitted(table, x, plain, robot, options.recorded) for x in logs)
            layout = next((x for x in fitted if x is not None), None)
            if layout is not None:
                found[preset] = layout
    return found


def _fitted(table, log: KnownLog, plain, robot, kinds):
    """Lay out columns as in a known log; None if they are not those."""
    patterns = {"q": log.q, "tau": log.tau, "v": log.v, **log.commands}
    used = [kind for kind in ("q", "v", *kinds) if patterns.get(kind)]
    found = {kind: matches(patterns[kind], table) for kind in used}
    if kinds[0] not in found:
        return None
    states = {match.prefix for match in found["q"]}
    for kind in log.commands.keys() & found.keys():
        # Commands are messages of a different name.
        if len(states) == 1 == len({match.prefix for match in found[kind]}):
            found[kind] = [replace(x, prefix=min(states)) for x in found[kind]]
    if log.motors:
        found = _moving(table, found, len(robot.names))
    pairs = {kind: {(x.prefix, x.key) for x in own} for kind, own in found.items()}
    shared = pairs["q"] & pairs[kinds[0]]
    if len({prefix for prefix, _ in shared}) != 1:
        return None
    keys, prefix = {key for _, key in shared}, min(shared)[0]
    if "{joint}" in log.q and robot.names and not keys & set(robot.names):
        return None
    times = _times(table, log, prefix) or plain.times
    if not times and not log.commands:
        return None
    # Numbers count from 0 or 1; the file may have the names of the joints.
    names = _names_in(table, log)
    motors = [[x for x in robot.names if part in x] for part in log.motors]
    known = len(motors) == len(robot.names) and all(len(x) == 1 for x in motors)
    if not names and known and not robot.chosen:
        names = [x for (x,) in motors]
    first = int(not any(x.key == 0 for own in found.values() for x in own))
    names = dict(enumerate(names, start=first))
    channels: dict[str, dict] = {}
    for kind, own in found.items():
        for match in own if kind in ("q", kinds[0]) or pairs[kind] >= shared else ():
            if match.prefix == prefix:
                unit = match.unit or (log.motor_unit if kind == "tau" else "")
                role = Role(column=match.column, unit=unit)
                _add(channels, kind, names.get(match.key, match.key), role)
    others = re.compile("|".join(log.no_signals) or "$.")
    return Layout(
        channels=channels,
        times=tuple(times),
        segments=(log.segment,) if log.segment in table.frame else (),
        no_signals=frozenset(filter(others.fullmatch, table.names)),
        what=log.what,
        certain=True,
    )


def _moving(table, found, count):
    """Leave out numbered motors beyond those of the robot, which never move."""
    # A message has a place for more motors than most robots have.
    numbers = sorted({x.key for x in found["q"]})
    still = {x.key for x in found["q"] if not np.any(table.values(x.column))}
    while numbers and numbers[-1] in still and len(numbers) > max(count, 1):
        numbers.pop()
    return {kind: [x for x in own if x.key in numbers] for kind, own in found.items()}


def _times(table, log, prefix):
    """Return the columns of time that a known log has here."""
    found = []
    for name in log.times:
        bare, unit = split_unit(name)
        parts = [part.replace("*", prefix) for part in bare.split("+")]
        if all(part in table.frame for part in parts):
            rest = "".join(parts[1:])
            found.append(Role(column=parts[0], unit=unit or "s", nanoseconds=rest))
    return found


def _names_in(table, log):
    """Return the names of the joints that stand in the rows, in order."""
    columns = [x for x in map(re.compile(log.joints).fullmatch, table.names) if x]
    if not log.joints or not columns:
        return ()
    columns.sort(key=lambda match: int(match[1] or 0))
    names = table.frame[[match[0] for match in columns]].astype(str)
    first = list(names.iloc[0])
    if (names != first).any(axis=None):
        raise ValueError(
            f"{table.path}: the names of the joints change from row to row, so that a "
            "column is not one joint; read the bag itself, or write one column for "
            "each joint."
        )
    # A list in one cell is as Python writes it.
    is_list = not columns[0][1]
    return tuple(re.findall(r"[^\s\[\](),'\"]+", first[0]) if is_list else first)


# -- in the order of the joints --------------------------------------------------------


def known_channels(layout, options, robot):
    """Return the channels of the robot's joints, and what is missing, with "t"."""
    # Certain names of joints that the robot lacks are no channels of it.
    names = robot.names or layout.joints
    channels = {
        kind: {
            key: roles
            for key, roles in layout.channels[kind].items()
            if isinstance(key, int) or key in names
        }
        for kind in options.kinds
        if kind in layout.channels
    }
    missing = [kind for kind in options.kinds[:2] if not channels.get(kind)]
    return channels, missing + ["t"] * (not (options.dt or layout.times))


def in_order(table: Table, layout, options, robot, notes):
    """Return the roles of each kind in the order of the joints, and these."""
    robot = replace(robot, names=robot.names or layout.joints)
    channels, _ = known_channels(layout, options, robot)
    having = {key for own in channels.values() for key in own}
    for own in channels.values():
        _refuse_both(table, own, robot.names)
    if any(isinstance(key, str) for key in having):
        others = [x for x in layout.joints if x not in robot.names]
        if others:
            notes.append(
                f"joint(s) {listed(others)} are not joints of the robot and are left "
                "out."
            )
        held = [x for x in robot.names if x not in having]
        if held and not robot.chosen:
            notes.append(Loss(f"no columns of joint(s) {listed(held)}: held at zero."))
            names = tuple(x for x in robot.names if x in having)
            robot = replace(robot, names=names)
    found = {kind: [] for kind in options.kinds}
    for kind, own in channels.items():
        named = any(isinstance(key, str) for key in own)
        first = 0 if 0 in own else 1
        for key in robot.names if named else range(first, first + len(own)):
            if key not in own:
                others = listed([role.column for (role, *_) in own.values()])
                raise ValueError(
                    f"{table.path}: column '{kind}{'_' * named}{key}' is missing "
                    f"beside {others}; every joint needs one, in order."
                )
            found[kind].append(own[key][0])
    return found, robot


def _refuse_both(table, channel, names):
    """Refuse several columns for one joint, or numbers and names."""
    for first, *others in channel.values():
        for other in others:
            refuse_two(table, first.column, other.column)
    named = [key for key in channel if isinstance(key, str)]
    numbers = [key for key in channel if isinstance(key, int)]
    if named and numbers:
        number = names.index(named[0]) + 1
        other = channel.get(number, channel[numbers[0]])[0]
        refuse_two(table, channel[named[0]][0].column, other.column)


def refuse_two(table, one, other):
    """Refuse two columns that could both be meant."""
    if one != other:
        raise ValueError(
            f"{table.path}: columns {one!r} and {other!r} could both be meant; rename "
            "or remove the one that is not."
        )
