"""Which columns of a file are which channels: by their names, a mapping or a preset."""

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.recording._presets import PRESETS, KnownLog
from sklearn_vbjfa.recording._table import RecordingRefused, Table, listed
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
_AIMS = ("desired", "target", "goal", "commanded", "ref")
_COMMANDS = {
    "q_desired": ("q_des", "q_cmd", "q_command", "q_target", "q_goal", "q_ref")
    + ("qdes", "target_q", "q_setpoint", "desired_q")
    + tuple(f"{one}_position" for one in _AIMS)
    + tuple(f"position_{one}" for one in ("desired", "target", "command", "cmd")),
    "v_desired": ("v_des", "v_cmd", "v_target", "v_goal", "v_ref", "target_v")
    + tuple(f"dq_{one}" for one in ("desired", "des", "cmd", "target", "goal", "ref"))
    + tuple(f"{one}_velocity" for one in _AIMS[:-1])
    + tuple(f"velocity_{one}" for one in ("desired", "target", "command", "cmd")),
    "tau_ff": ("tau_feedforward", "torque_ff", "torque_feedforward"),
    "kp": ("p_gain",),
    "kd": ("d_gain",),
    "supply": (),
}
# A motor's own estimate of its torque, where there is no other.
ESTIMATES, _ESTIMATED = ("tau_est", "tauest"), "estimate"
# Further names that a velocity has in logs of commands.
_SPEEDS = ("dq", "qdot")
_KEY = re.compile(
    rf"({'|'.join((*_COMMANDS, *KINDS))})(\d+|[_.\[(].+)?|t|segment", re.IGNORECASE
)
# Columns that can only be time, where none is called t.
TIME_NAMES = (
    ("t", "time", "timestamp", "time_stamp", "timestamps", "stamp", "__time", "ts")
    + ("%time", "time_s", "seconds", "secs", "datetime", "elapsed")
    + ("zeit", "zeitstempel")
)
# How the parts of a ROS stamp are called.
_CLOCK_PARTS = (("secs", "nsecs"), ("sec", "nsec"), ("sec", "nanosec"))
_EVERY = re.compile(r"\\\{(i|joint)\\\}|\\\*")
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
    # what a user must know of positions that are not radians, and a mapping for it
    question: str = ""
    answer: str = ""

    def roles(self, kind):
        """Return all columns of a kind, list of `Role`."""
        return [role for own in self.channels.get(kind, {}).values() for role in own]

    @property
    def own_joints(self):
        """Joints that the columns are called after, tuple of str."""
        found = self.channels.get("q", {}) if self.certain else ()
        return tuple(key for key in found if isinstance(key, str))


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
        begins += [(one, "v") for one in _SPEEDS] + [(x, "tau") for x in drive.spelled]
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
        if bare.lower() in TIME_NAMES:
            times.append(Role(column=name, unit=unit))
        elif last and not unit and stem.lower() in TIME_NAMES:
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
    exact = [x for x in times if name_and_unit(table, x.column)[0].lower() == "t"]
    if not times and len(clocks) == 1:
        times = clocks
    return Layout(
        channels=channels, times=tuple(exact or times), segments=tuple(segments)
    )


def _channel(name, bare, unit, begins, joints):
    """Return the kind of a column, its number or joint, and unit; "" for no kind."""
    for begin, kind in begins:
        if not name.lower().startswith(begin):
            continue
        measured = "tau" if kind == _ESTIMATED else kind
        stem, last = (bare, unit) if unit else split_last_part(bare, measured)
        # The whole name may end with a joint that is called like a unit.
        for text, own in ((name, ""), (bare, unit), (stem, last)):
            match = re.fullmatch(
                rf"{begin}[_.\[(]?(.*?)[\])]?", text, re.IGNORECASE | re.DOTALL
            )
            key = match[1] if match else ""
            if key and key in joints:
                return kind, key, unit if text == bare else own
            number = _NUMBER.fullmatch(key)
            if number:
                return kind, int(number[1]), own or unit
            if text.lower() == begin and (not own or unit_of(measured, own)):
                return kind, 1, own or unit
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
    if not role.unit:
        return None
    unit = unit_of(kind, role.unit)
    if unit is None:
        expected = EXPECTED[MEASURED.get(kind, kind)]
        raise ValueError(
            f"{table.path}: column {role.column!r} is in {role.unit!r}, which is not a "
            f"known unit of {kind}; expected {expected}. Convert it, or correct the "
            "name."
        )
    return unit


# -- by a mapping ----------------------------------------------------------------------


def parse_mapping(text) -> dict[str, str]:
    """Return patterns by names of channels, out of "q=actual_q_{i},t=timestamp"."""
    # A mapping or pairs in a text; refuses what is no channel or comes twice.
    if isinstance(text, Mapping):
        pairs = [(str(key), str(value)) for key, value in text.items()]
    else:
        pairs = []
        for part in str(text).split(","):
            key, _, value = (x.strip() for x in part.partition("="))
            pairs.append((key, value))
            if not key or not value:
                raise ValueError(
                    f"columns has {part.strip()!r}; expected pairs CHANNEL=NAME with "
                    'commas between them, such as "q=position_{i},tau=effort_{i},'
                    't=time".'
                )
    found: dict[str, str] = {}
    for key, value in pairs:
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
        stripped, own = name_and_unit(table, name)
        match = expression.fullmatch(name) or without.fullmatch(stripped)
        if match is None or (own and written and own != written):
            continue
        groups = match.groupdict()
        key = groups.get("joint") or int(groups.get("i", 1))
        found.append(Match(groups.get("any", ""), key, name, own or unit))
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


def _expression(pattern):
    """Turn a pattern into a regular expression."""
    seen = set()

    def stand_in(match):
        name = match[1] or "any"
        if name in seen:
            return f"(?P={name})"
        seen.add(name)
        anything = {"i": r"\d{1,6}", "joint": ".+?", "any": ".*"}
        return f"(?P<{name}>{anything[name]})"

    return re.compile(_EVERY.sub(stand_in, re.escape(pattern)), re.ASCII)


def by_mapping(table: Table, mapping: dict, plain: Layout) -> Layout:
    """Lay out the columns by a mapping, and the other kinds as in another layout."""
    known = {key: _KEY.fullmatch(key) for key in mapping}
    kinds = {key: (x[1] if x and x[1] else key).lower() for key, x in known.items()}
    found = {x: matches(mapping[x], table, kinds[x]) for x in mapping}
    missing = [mapping[key] for key, own in found.items() if not own]
    if missing:
        raise RecordingRefused(
            f"{table.path}: has no column {', '.join(missing)}, which columns asks "
            f"for; found {listed(table.names)}"
        )
    claimed = _claimed(table, mapping, found)
    channels: dict[str, dict] = {}
    for key, own in found.items():
        channels.setdefault(kinds[key], {})
        suffix = key[len(kinds[key]) :].strip("_.[]()")
        for match in own:
            if claimed[match.column] != key:
                continue
            name = int(suffix) if suffix.isdecimal() else suffix or match.key
            role = Role(column=match.column, unit=match.unit)
            before = channels[kinds[key]].get(name)
            if before and kinds[key] not in ("t", "segment"):
                raise RecordingRefused(
                    f"{table.path}: columns {before[0].column!r} and {role.column!r} "
                    f"both fit {key}={mapping[key]}; say which one"
                )
            _add(channels, kinds[key], name, role)
    given = Layout(channels=channels)
    times, segments = given.roles("t"), given.roles("segment")
    channels = {k: x for k, x in channels.items() if k not in ("t", "segment")}
    for kind in () if table.nameless else plain.channels:
        if kind not in channels and not any(
            role.column in claimed for role in plain.roles(kind)
        ):
            channels[kind] = plain.channels[kind]
    unclaimed = tuple(x for x in plain.times if x.column not in claimed)
    return replace(
        plain,
        channels=channels,
        times=tuple(times) or unclaimed,
        segments=tuple(x.column for x in segments) or plain.segments,
        # What nobody has named is no signal.
        no_signals=frozenset(table.names if table.nameless else plain.no_signals),
        certain=True,
    )


def _claimed(table, mapping, found):
    """Return the key of a mapping for each column that fits one."""
    # Of patterns that fit the same column, the one counts that spells out more of it.
    spelled = {key: len(_EVERY.sub("", re.escape(x))) for key, x in mapping.items()}
    claimed: dict[str, str] = {}
    for key, own in found.items():
        for match in own:
            other = claimed.setdefault(match.column, key)
            if other != key and spelled[other] == spelled[key]:
                raise RecordingRefused(
                    f"{table.path}: columns names {match.column!r} twice, for {other} "
                    f"and {key}; each column is one channel"
                )
            if spelled[key] > spelled[other]:
                claimed[match.column] = key
    return claimed


# -- by a preset -----------------------------------------------------------------------


def by_preset(table: Table, name, plain, joints=(), kinds=("tau",), chosen=False):
    """Return the layouts of known logs that the columns fit, one for each preset."""
    # name: a preset or None for any; plain: the layout by names, for times; joints: of
    # the robot, if known, and `chosen` if the user says that they are those of the
    # columns, in order; kinds: of torques or of a drive, the one that must be there
    # first.
    found = {}
    for preset, logs in PRESETS.items():
        if name in (None, preset):
            fitted = (_fitted(table, x, plain, joints, kinds, chosen) for x in logs)
            layout = next((x for x in fitted if x is not None), None)
            if layout is not None:
                found[preset] = layout
    return found


def _fitted(table, log: KnownLog, plain, joints, kinds, chosen):
    """Lay out columns as in a known log; None if they are not those."""
    patterns = {"q": log.q, "tau": log.tau, "v": log.v, **log.commands}
    used = [kind for kind in ("q", "v", *kinds) if patterns.get(kind)]
    found = {kind: matches(patterns[kind], table) for kind in used}
    if kinds[0] not in found:
        return None
    if kinds[0] in log.commands:
        found = _with_prefix_of_state(found, log)
    if log.motors:
        found = _moving(table, found, len(joints))
    pairs = {kind: {(x.prefix, x.key) for x in own} for kind, own in found.items()}
    shared = pairs["q"] & pairs[kinds[0]]
    prefixes = {prefix for prefix, _ in shared}
    if len(prefixes) != 1:
        return None
    (prefix,) = prefixes
    if "{joint}" in log.q and joints and not any((prefix, x) in shared for x in joints):
        return None
    times = _times(table, log, prefix) or plain.times
    if not times and not log.commands:
        return None
    # Numbers count from 0 or 1; the file may have the names of the joints.
    names = _names_in(table, log) or (() if chosen else _motors(log, joints))
    first = int(not any(x.key == 0 for own in found.values() for x in own))
    names = dict(enumerate(names, start=first))
    channels: dict[str, dict] = {}
    for kind, own in found.items():
        if kind not in ("q", kinds[0]) and not pairs[kind] >= shared:
            continue
        for match in own:
            if match.prefix == prefix:
                unit = match.unit or (log.motor_unit if kind == "tau" else "")
                role = Role(column=match.column, unit=unit)
                _add(channels, kind, names.get(match.key, match.key), role)
    beside = re.compile("|".join(log.no_signals) or "$.")
    return Layout(
        channels=channels,
        times=tuple(times),
        segments=(log.segment,) if log.segment in table.frame else (),
        no_signals=frozenset(filter(beside.fullmatch, table.names)),
        what=log.what,
        certain=True,
        question=log.question if kinds[0] in log.commands else "",
        answer=f"q={log.q} [deg]",
    )


def _with_prefix_of_state(found, log):
    """Give commands, in messages of a different name, the prefix of the only state."""
    states = {match.prefix for match in found["q"]}
    for kind in log.commands.keys() & found.keys():
        if len(states) == 1 == len({match.prefix for match in found[kind]}):
            found[kind] = [replace(x, prefix=min(states)) for x in found[kind]]
    return found


def _moving(table, found, count):
    """Leave out numbered motors beyond those of the robot, which never move."""
    # A message has a place for more motors than most robots have.
    numbers = sorted({x.key for x in found["q"]})
    still = {x.key for x in found["q"] if not np.any(table.values(x.column))}
    while numbers and numbers[-1] in still and len(numbers) > max(count, 1):
        numbers.pop()
    return {kind: [x for x in own if x.key in numbers] for kind, own in found.items()}


def _motors(log, joints):
    """Return the robot's joints in the order of the motors of a log, if known."""
    found = [[one for one in joints if part in one] for part in log.motors]
    known = len(found) == len(joints) and all(len(own) == 1 for own in found)
    return tuple(own[0] for own in found) if known else ()


def _times(table, log, prefix):
    """Return the columns of time that a known log has here."""
    found = []
    for name in log.times:
        bare, own = split_unit(name)
        parts = [part.replace("*", prefix) for part in bare.split("+")]
        if all(part in table.frame for part in parts):
            rest = "".join(parts[1:])
            found.append(Role(column=parts[0], unit=own or "s", nanoseconds=rest))
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
    one = not columns[0][1]
    return tuple(re.findall(r"[^\s\[\](),'\"]+", first[0]) if one else first)
