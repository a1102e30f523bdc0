"""Which columns of a file are which channels: by their names, a mapping or a preset."""

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from sklearn_vbjfa.recording._presets import PRESETS, KnownLog
from sklearn_vbjfa.recording._table import Table, listed, pandas_of, quoted
from sklearn_vbjfa.recording._units import (
    EXPECTED,
    KINDS,
    MEASURED,
    SHARE,
    Unit,
    split_last_part,
    split_unit,
    unit_of,
)

# Commands of joints, and further names that logs have for them. qd is in neither list:
# some mean a desired position, others a velocity.
_COMMANDS = {
    "q_desired": ("q_des", "q_cmd", "q_command", "q_target", "q_goal", "q_ref")
    + ("qdes", "target_q", "q_setpoint", "desired_q")
    + tuple(
        f"{one}_position" for one in ("desired", "target", "goal", "commanded", "ref")
    )
    + tuple(f"position_{one}" for one in ("desired", "target", "command", "cmd")),
    "v_desired": ("v_des", "v_cmd", "v_target", "v_goal", "v_ref", "target_v")
    + tuple(f"dq_{one}" for one in ("desired", "des", "cmd", "target", "goal", "ref"))
    + tuple(f"{one}_velocity" for one in ("desired", "target", "goal", "commanded"))
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
_DAY = 86400.0
_EVERY = re.compile(r"\\\{(i|joint)\\\}|\\\*")


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


@dataclass
class Channel:
    """The columns of one kind of channel, by joints and by numbers."""

    by_joint: dict[str, list[Role]] = field(default_factory=dict)
    by_number: dict[str, list[Role]] = field(default_factory=dict)

    def add(self, key, role, *, is_number):
        """Take a column."""
        if is_number:
            # int() would choke on thousands of digits.
            self.by_number.setdefault(key.lstrip("0").rjust(1, "0"), []).append(role)
        else:
            self.by_joint.setdefault(key, []).append(role)

    @property
    def roles(self):
        """All columns, list of `Role`."""
        found = (*self.by_joint.values(), *self.by_number.values())
        return [role for own in found for role in own]


@dataclass(frozen=True, kw_only=True)
class Layout:
    """The channels of a file and their columns."""

    channels: dict[str, Channel]  # by kind, such as q or q_desired
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

    @property
    def own_joints(self):
        """Joints that the columns are called after, tuple of str."""
        if not self.certain or "q" not in self.channels:
            return ()
        return tuple(self.channels["q"].by_joint)


# -- by names --------------------------------------------------------------------------


def spellings(kind, drive):
    """Return the names of a kind of channel; drive: what is recorded, None: torques."""
    own = (kind, *_COMMANDS.get(kind, ()))
    if drive is None:
        return own
    return own + {"v": _SPEEDS, "tau": drive.spelled}.get(kind, ())


def name_and_unit(table: Table, column: str) -> tuple[str, str]:
    """Return a column's name without the unit that stands with it, and that unit."""
    bare, unit = split_unit(column)
    return (bare, unit) if unit else (column, table.units.get(column, ""))


def by_names(table: Table, joints=(), kinds=KINDS, drive=None) -> Layout:
    """Lay out columns by their own names, units in them removed."""
    begins = [(one, kind) for kind in kinds for one in spellings(kind, drive)]
    if drive is None:
        begins += [(one, _ESTIMATED) for one in ESTIMATES]
    # The longest first: q_desired is no q.
    begins.sort(key=lambda x: -len(x[0]))
    clocks = _clocks_of_two(table)
    parts = {name for clock in clocks for name in clock.columns}
    channels: dict[str, Channel] = {}
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
            found = _channel(name, bare, unit, begins, joints)
            if found is not None:
                kind, key, is_number, unit = found
                channel = channels.setdefault(kind, Channel())
                channel.add(key, Role(column=name, unit=unit), is_number=is_number)
    estimates = channels.pop(_ESTIMATED, None)
    if estimates is not None and "tau" not in channels:
        channels["tau"] = estimates
    exact = [x for x in times if name_and_unit(table, x.column)[0].lower() == "t"]
    if not times and len(clocks) == 1:
        times = clocks
    return Layout(
        channels=channels, times=tuple(exact or times), segments=tuple(segments)
    )


def _channel(name, bare, unit, begins, joints):
    """Return kind, joint or number, whether it is a number, and unit; None for none."""
    for begin, kind in begins:
        if not _in_letters(name).lower().startswith(begin):
            continue
        stem, last = (bare, unit) if unit else split_last_part(bare, _kind(kind))
        # The whole name may end with a joint that is called like a unit.
        for text, own in ((_in_letters(name), ""), (bare, unit), (stem, last)):
            match = re.fullmatch(
                rf"{begin}[_.\[(]?(.*?)[\])]?", text, re.IGNORECASE | re.DOTALL
            )
            key = match[1] if match else ""
            if key and key in joints:
                return kind, key, False, unit if text == bare else own
            if key.isdecimal() and key.isascii():
                return kind, key, True, own or unit
            if text.lower() == begin and (not own or unit_of(_kind(kind), own)):
                return kind, "1", True, own or unit
    return None


def _kind(kind):
    """Return the kind of which a column has the unit."""
    return "tau" if kind == _ESTIMATED else kind


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


# -- by a mapping ----------------------------------------------------------------------


class MappingRefused(ValueError):
    """A mapping does not fit the columns of a file, and why."""


def parse_mapping(text) -> dict[str, str]:
    """Return patterns by names of channels, out of "q=actual_q_{i},t=timestamp"."""
    # A mapping or pairs in a text; refuses what is no channel or comes twice.
    if isinstance(text, Mapping):
        pairs = [(str(key), str(value)) for key, value in text.items()]
    else:
        pairs = []
        for part in str(text).split(","):
            key, equals, value = (x.strip() for x in part.partition("="))
            if not equals or not key or not value:
                raise ValueError(
                    f"columns has {part.strip()!r}; expected pairs CHANNEL=NAME with "
                    'commas between them, such as "q=position_{i},tau=effort_{i},'
                    't=time".'
                )
            pairs.append((key, value))
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
    """A column that fits a pattern: the texts for * and {i} or {joint}, its unit."""

    prefix: str
    key: str
    column: str
    unit: str
    is_number: bool = True


def matches(pattern: str, table: Table, kind="") -> list[Match]:
    """Return the columns that fit a pattern."""
    # {i} is a number, {joint} and * are anything. A unit at the end of the name counts
    # with it or without, one before the number where a kind is given.
    bare, unit = split_unit(pattern)
    if table.nameless:
        return _in_places(bare, unit, table)
    if kind and not unit and bare.endswith("{i}"):
        unit = split_last_part(bare.removesuffix("{i}").rstrip("_"), kind)[1]
    expression, without = _expression(pattern), _expression(bare)
    found = []
    for name in table.names:
        stripped, own = name_and_unit(table, name)
        match = expression.fullmatch(name) or without.fullmatch(stripped)
        if match is None or (own and unit and own != unit):
            continue
        groups = match.groupdict()
        key = groups.get("i", groups.get("joint", ""))
        if "i" in groups:
            key = key.lstrip("0").rjust(1, "0")
        is_number = "joint" not in groups
        prefix = groups.get("any", "")
        found.append(Match(prefix, key, name, own or unit, is_number))
    return found


def _in_places(places, unit, table):
    """Return the columns of a table without names that are in places such as 2-7."""
    match = re.fullmatch(r"0*(\d{1,6})(?:-0*(\d{1,6}))?", places.strip())
    if match is None:
        return []
    first, last = int(match[1]), int(match[2] or match[1])
    columns = [str(place) for place in range(first, last + 1)]
    if not columns or not all(x in table.frame for x in columns):
        return []
    if match[2] is None:
        return [Match("", "", columns[0], unit)]
    return [Match("", str(k), x, unit) for k, x in enumerate(columns, start=1)]


def _expression(pattern):
    """Turn a pattern into a regular expression."""
    seen = set()

    def stand_in(match):
        name = match[1] or "any"
        if name in seen:
            return f"(?P={name})"
        seen.add(name)
        anything = {"i": r"\d+", "joint": ".+?", "any": ".*"}
        return f"(?P<{name}>{anything[name]})"

    return re.compile(_EVERY.sub(stand_in, re.escape(pattern)))


def _kind_of_key(key):
    """Return the kind of channel of a key of a mapping."""
    match = _KEY.fullmatch(key)
    return (match[1] or key).lower() if match else key


def by_mapping(table: Table, mapping: dict, plain: Layout) -> Layout:
    """Lay out the columns by a mapping, and the other kinds as in another layout."""
    kinds = {key: _kind_of_key(key) for key in mapping}
    found = {
        key: matches(pattern, table, kinds[key]) for key, pattern in mapping.items()
    }
    missing = [mapping[key] for key, own in found.items() if not own]
    if missing:
        raise MappingRefused(
            f"has no column {', '.join(missing)}, which columns asks for; found "
            f"{listed(table.names)}"
        )
    claimed = _claimed(mapping, found)
    channels: dict[str, Channel] = {}
    times, segments = plain.times, plain.segments
    for key, own in found.items():
        own = [match for match in own if claimed[match.column] == key]
        roles = tuple(Role(column=match.column, unit=match.unit) for match in own)
        if kinds[key] == "t":
            times = roles
            continue
        if kinds[key] == "segment":
            segments = tuple(role.column for role in roles)
            continue
        channel = channels.setdefault(kinds[key], Channel())
        suffix = key[len(kinds[key]) :].strip("_.[]()")
        for match, role in zip(own, roles):
            name = suffix or match.key or "1"
            is_number = name.isdecimal() if suffix else match.is_number
            known = channel.by_number if is_number else channel.by_joint
            if name in known:
                raise MappingRefused(
                    f"columns {known[name][0].column!r} and {role.column!r} both fit "
                    f"{key}={mapping[key]}; say which one"
                )
            channel.add(name, role, is_number=is_number)
    others = {} if table.nameless else plain.channels
    for kind, other in others.items():
        if kind not in channels and not any(x.column in claimed for x in other.roles):
            channels[kind] = other
    return replace(
        plain,
        channels=channels,
        times=tuple(x for x in times if "t" in mapping or x.column not in claimed),
        segments=segments,
        # What nobody has named is no signal.
        no_signals=frozenset(table.names if table.nameless else plain.no_signals),
        certain=True,
    )


def _claimed(mapping, found):
    """Return the key of a mapping for each column that fits one."""
    # Of patterns that fit the same column, the one counts that spells out more of it.
    spelled = {key: len(_EVERY.sub("", re.escape(x))) for key, x in mapping.items()}
    claimed: dict[str, str] = {}
    for key, own in found.items():
        for match in own:
            other = claimed.setdefault(match.column, key)
            if other != key and spelled[other] == spelled[key]:
                raise MappingRefused(
                    f"columns names {match.column!r} twice, for {other} and {key}; "
                    "each column is one channel"
                )
            if spelled[key] > spelled[other]:
                claimed[match.column] = key
    return claimed


# -- by a preset -----------------------------------------------------------------------


def by_preset(table: Table, name: str | None, joints=(), kinds=("tau",), chosen=False):
    """Return the layouts of known logs that the columns fit, one for each preset."""
    # name: a preset or None for any; joints: of the robot, if known, and `chosen` if
    # the user says that they are those of the columns, in order; kinds: of torques or
    # of a drive, the one that must be there first.
    found = {}
    for preset, logs in PRESETS.items():
        if name in (None, preset):
            fitted = (_fitted(table, log, joints, kinds, chosen) for log in logs)
            layout = next((x for x in fitted if x is not None), None)
            if layout is not None:
                found[preset] = layout
    return found


def _fitted(table, log: KnownLog, joints, kinds, chosen):
    """Lay out columns as in a known log; None if they are not those."""
    patterns = {"q": log.q, "tau": log.tau, "v": log.v, **log.commands}
    found = {
        kind: matches(patterns[kind], table)
        for kind in ("q", "v", *kinds)
        if patterns.get(kind)
    }
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
    times = _times(table, log, prefix)
    if not times and not log.commands:
        return None
    # Numbers count from 0 or 1; the file may have the names of the joints.
    names = _names_in(table, log) or (() if chosen else _motors(log, joints))
    first = int("0" not in {x.key for own in found.values() for x in own})
    channels: dict[str, Channel] = {}
    for kind, own in found.items():
        if kind not in ("q", kinds[0]) and not pairs[kind] >= shared:
            continue
        for match in own:
            if match.prefix != prefix:
                continue
            unit = match.unit or (log.motor_unit if kind == "tau" else "")
            place = int(match.key) - first if match.is_number else -1
            known = 0 <= place < len(names)
            channels.setdefault(kind, Channel()).add(
                names[place] if known else match.key,
                Role(column=match.column, unit=unit),
                is_number=match.is_number and not known,
            )
    beside = {
        name
        for name in table.names
        if any(re.fullmatch(pattern, name) for pattern in log.no_signals)
    }
    return Layout(
        channels=channels,
        times=tuple(times),
        segments=(log.segment,) if log.segment in table.frame else (),
        no_signals=frozenset(beside),
        what=log.what,
        certain=True,
        question=log.question if kinds[0] in log.commands else "",
        answer=f"q={log.q} [{SHARE[0] if table.shares else 'deg'}]",
    )


def _with_prefix_of_state(found, log):
    """Give commands, in messages of a different name, the prefix of the only state."""
    states = {match.prefix for match in found["q"]}
    if len(states) != 1:
        return found
    (prefix,) = states
    return {
        kind: [replace(match, prefix=prefix) for match in own]
        if kind in log.commands and len({match.prefix for match in own}) == 1
        else own
        for kind, own in found.items()
    }


def _moving(table, found, count):
    """Leave out numbered motors beyond those of the robot, which never move."""
    # A message has a place for more motors than most robots have.
    numbers = sorted({int(x.key) for x in found["q"] if x.key.isdecimal()})
    still = {x.key for x in found["q"] if not np.any(table.values(x.column))}
    while numbers and str(numbers[-1]) in still and len(numbers) > max(count, 1):
        numbers.pop()
    kept = {str(x) for x in numbers}
    return {
        kind: [x for x in own if x.key in kept or not x.key.isdecimal()]
        for kind, own in found.items()
    }


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
            unit = "s" if len(parts) == 2 else own or log.time_unit
            found.append(
                Role(column=parts[0], unit=unit, nanoseconds="".join(parts[1:]))
            )
    return found


def _names_in(table, log):
    """Return the names of the joints that stand in the rows, in order."""
    if not log.joints:
        return ()
    found = sorted((int(x.key or 0), x.column) for x in matches(log.joints, table))
    names = table.frame[[column for _, column in found]].astype(str)
    if names.empty:
        return ()
    first = list(names.iloc[0])
    if (names != first).any(axis=None):
        raise ValueError(
            f"{table.path}: the names of the joints change from row to row, so that a "
            "column is not one joint; read the bag itself, or write one column for "
            "each joint."
        )
    # A list in one cell is as Python writes it.
    one = "{i}" not in log.joints
    return tuple(re.findall(r"[^\s\[\](),'\"]+", first[0]) if one else first)


# -- units and times -------------------------------------------------------------------


def channel_unit(table: Table, kind: str, role: Role) -> Unit | None:
    """Return the unit of a channel, None if nothing tells; refuse one not known."""
    if not role.unit:
        return None
    measured = MEASURED.get(kind, kind)
    if measured == "q" and role.unit in SHARE:
        if role.column not in table.shares:
            raise ValueError(
                f"{table.path}: column {role.column!r} is a share of a calibrated "
                "range, which is not known: put the robot's calibration file "
                "(range_min and range_max of each motor) into the data set as "
                "meta/calibration.json, or turn the columns into radians."
            )
        return Unit("rad", table.shares[role.column])
    unit = unit_of(kind, role.unit)
    if unit is None:
        raise ValueError(
            f"{table.path}: column {role.column!r} is in {role.unit!r}, which is not a "
            f"known unit of {kind}; expected {EXPECTED[measured]}. Convert it, or "
            "correct the name."
        )
    return unit


def seconds_of_dates(table: Table, column: str):
    """Return dates with times of day as seconds from the first, None for others."""
    pandas = pandas_of(table.path)
    values = table.frame[column]
    if values.dtype.kind != "M":
        if values.dtype.kind in "biuf" or not isinstance(values.iloc[0], str):
            return None
        text = values.astype(str).str.replace(",", ".")
        dates = pandas.to_datetime(text, format="ISO8601", utc=True, errors="coerce")
        if pandas.isna(dates.iloc[0]):
            return _seconds_of_day(pandas, text)
        wrong = np.flatnonzero(dates.isna())
        if wrong.size:
            raise ValueError(
                f"{table.path}: {quoted(values.iloc[wrong[0]])} in "
                f"{table.where(wrong[0])}, column {column!r}, is not a date and time "
                "like the others; correct or remove that row."
            )
        values = dates
    return (values - values.iloc[0]).dt.total_seconds().to_numpy()


def _seconds_of_day(pandas, text):
    """Return times of day as seconds from the first, past midnight; None for others."""
    if not text.str.fullmatch(r"\d{1,2}:\d\d:\d\d(\.\d*)?").all():
        return None
    seconds = pandas.to_timedelta(text).dt.total_seconds().to_numpy()
    midnights = np.cumsum(np.diff(seconds, prepend=seconds[0]) < -_DAY / 2)
    return seconds + _DAY * midnights - seconds[0]
