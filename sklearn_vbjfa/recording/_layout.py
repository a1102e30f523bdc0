"""Which columns of a file are which channels, and in which units they are."""

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.recording._presets import PRESETS, KnownLog
from sklearn_vbjfa.recording._table import Table, listed, quoted

_DEGREE = np.pi / 180
_TURN = 2 * np.pi


@dataclass(frozen=True)
class Unit:
    """A unit: what it is a multiple of, and by which factor."""

    base: str
    factor: float


def _table():
    """Return units by their spelling, for each kind of channel."""
    angle = {"rad": 1.0, "radian": 1.0, "radians": 1.0, "mrad": 1e-3}
    angle |= {x: _DEGREE for x in ("deg", "degs", "degree", "degrees", "°")}
    angle |= {x: _TURN for x in ("rev", "revs", "turn", "turns", "revolutions")}
    length = {"m": 1.0, "metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0}
    length |= {"cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6}
    seconds = {x: 1.0 for x in ("s", "sec", "secs", "second", "seconds")}
    seconds |= {x: 1e-3 for x in ("ms", "msec", "millisecond", "milliseconds")}
    seconds |= {x: 1e-6 for x in ("us", "µs", "μs", "usec", "microseconds")}
    seconds |= {x: 1e-9 for x in ("ns", "nsec", "nanosecond", "nanoseconds")}
    seconds |= {"min": 60.0, "minutes": 60.0}
    torque = {f"{scale}Nm": factor for scale, factor in _SCALES.items()}
    torque |= {"Ncm": 1e-2, "newtonmeter": 1.0, "newtonmetre": 1.0}
    force = {f"{scale}N": factor for scale, factor in _SCALES.items()}
    current = {"A": 1.0, "mA": 1e-3, "amp": 1.0, "amps": 1.0, "ampere": 1.0}
    current |= {"Arms": 1.0, "amperes": 1.0}
    volts = {"V": 1.0, "mV": 1e-3, "volt": 1.0, "volts": 1.0}
    counts = {x: 1.0 for x in ("count", "counts")}
    percent = {x: 1.0 for x in ("%", "percent")} | {x: 0.1 for x in ("‰", "permille")}
    per = {"speed": ("/s", "/sec", "ps"), "rate": ("/s^2", "/s2", "/s²", "/s/s", "ps2")}
    kinds = {
        "q": {"rad": angle, "m": length},
        "v": _derived(angle, length, per["speed"]),
        "a": _derived(angle, length, per["rate"]),
        "tau": {"N m": torque, "N": force, "A": current, "V": volts}
        | {"count": counts, "%": percent},
        "t": {"s": seconds},
        "kp": {"N m/rad": {"Nm/rad": 1.0, "Nm/deg": 1 / _DEGREE}, "N/m": {"N/m": 1.0}},
        "kd": {
            "N m s/rad": {"Nms/rad": 1.0, "Nm/(rad/s)": 1.0, "Nms/deg": 1 / _DEGREE},
            "N s/m": {"Ns/m": 1.0},
        },
    }
    kinds["v"]["rad"] |= {"rpm": _TURN / 60, "1/min": _TURN / 60}
    return {
        kind: {
            spelling: Unit(base, factor)
            for base, spellings in bases.items()
            for spelling, factor in spellings.items()
        }
        for kind, bases in kinds.items()
    }


_SCALES = {"": 1.0, "m": 1e-3, "k": 1e3}


def _derived(angle, length, endings):
    """Return units of the derivatives of positions, by their base."""
    return {
        base: {f"{unit}{end}": x for unit, x in units.items() for end in endings}
        for base, units in (("rad", angle), ("m", length))
    }


# How shares of a motor's range are written.
SHARE = ("%", "percent")
_UNITS = _table()
# What one may write for a time, where a unit is asked for, in seconds.
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_IN_BRACKETS = re.compile(r"(.*?)\s*(?:\[([^][]*)\]|\(([^()]*)\)|\s/\s*(\S+))")
_LAST_PART = re.compile(r"(.*?)[_ .]([A-Za-z°µμ%][A-Za-z0-9^/²]*)")


def unit_of(kind: str, text: str) -> Unit | None:
    """Return the unit of a channel of a kind (q, v, a, tau, t), None if unknown."""
    plain = re.sub(r"[\s*·.⋅]|(?<=N)-(?=m)", "", text.strip())
    known = _UNITS[MEASURED.get(kind, kind)]
    if plain in known:
        return known[plain]
    # Capitals matter for milli and mega, ampere and atto; words may have any.
    if len(plain) > 2 and plain.lower() in known:
        return known[plain.lower()]
    return known["Nm"] if kind == "tau" and plain.lower() == "nm" else None


def is_unit(text: str) -> bool:
    """Whether a text is some unit, with or without brackets."""
    text = text.strip().strip("[]()").strip()
    return any(unit_of(kind, text) for kind in (*KINDS, "t")) or text in _OTHERS


# Units of channels that are neither motion nor torque, for a row of units.
_OTHERS = ("1", "-", "°C", "C", "K", "degC", "bar", "Pa", "kPa", "Hz", "kg", "W", "Ohm")


def split_unit(name: str) -> tuple[str, str]:
    """Return a name without the unit in brackets behind it, and that unit."""
    match = _IN_BRACKETS.fullmatch(name)
    if match is None:
        return name, ""
    unit = next(x for x in match.groups()[1:] if x is not None)
    # Of q[1] and pos(elbow) these are the joints.
    if not match[1] or unit.strip().isdecimal() or "{" in unit:
        return name, ""
    return match[1], unit.strip()


def split_last_part(name: str, kind: str) -> tuple[str, str]:
    """Return a name without a last part that is a unit of a kind, and that unit."""
    match = _LAST_PART.fullmatch(name)
    if match is None or unit_of(kind, match[2]) is None:
        return name, ""
    return match[1], match[2]


# Positions beyond two turns are hardly those of a robot in radians.
TURNS = 4 * np.pi


# -- mappings --------------------------------------------------------------------------

KINDS = ("q", "tau", "v", "a")
# Channels of joints that a drive is told, and further names that logs have for them.
# qd is in neither list: some mean a desired position, others a velocity.
_TOLD = {
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
}
# A motor's own estimate of its torque, where there is no other.
ESTIMATES = ("tau_est", "tauest")
# Names beside its own that a velocity has in logs of commands.
_SPEEDS = ("dq", "qdot")
# What a command has the unit of.
MEASURED = {"q_desired": "q", "v_desired": "v", "tau_ff": "tau"}
_SPELLINGS = {kind: (kind, *others) for kind, others in _TOLD.items()}
_SPELLINGS |= {kind: (kind,) for kind in KINDS}
_KEY = re.compile(
    rf"({'|'.join((*_TOLD, *KINDS))})(\d+|[_.\[(].+)?|t|segment", re.IGNORECASE
)
# The longest first: q_desired is no q.
_KIND_OF = {one: kind for kind, own in _SPELLINGS.items() for one in own}
_KIND_OF |= {one: one for one in ("segment", "t")}
_BEGIN = re.compile("|".join(sorted(_KIND_OF, key=len, reverse=True)), re.IGNORECASE)
# Columns that can only be time, where none is called t.
TIME_NAMES = (
    "t",
    "time",
    "timestamp",
    "time_stamp",
    "timestamps",
    "stamp",
    "zeit",
    "__time",
    "ts",
) + ("%time", "time_s", "seconds", "secs", "datetime", "zeitstempel", "elapsed")
# How the parts of a ROS stamp are called.
_CLOCK_PARTS = (("secs", "nsecs"), ("sec", "nsec"), ("sec", "nanosec"))
_EVERY = re.compile(r"\\\{(i|joint)\\\}|\\\*")


@dataclass(frozen=True, kw_only=True)
class Role:
    """What a column of a file is."""

    column: str  # its name
    unit: str = ""  # empty if nothing tells
    nanoseconds: str = ""  # column of those within the seconds of this one

    @property
    def columns(self):
        """Names of all its columns, tuple of str."""
        return (self.column, self.nanoseconds) if self.nanoseconds else (self.column,)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """What the columns of a file are."""

    roles: dict  # columns by the names that this package would give them
    # columns that are known not to be conditions of the robot
    beside: frozenset = frozenset()
    times: tuple = ()  # the best first
    # names of the numbered joints, in the order of the numbers, if the file has any
    joints: tuple = ()
    what: str = ""  # log as which the file was recognised, or whose names were given
    # whether what has a channel's name is one: a mapping or a preset says so
    certain: bool = False
    # what a user must know of positions that are not radians, and a mapping that
    # says it
    question: str = ""
    answer: str = ""


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
            key, equals, value = part.partition("=")
            if not equals or not key.strip() or not value.strip():
                raise ValueError(
                    f"columns has {part.strip()!r}; expected pairs CHANNEL=NAME with "
                    'commas between them, such as "q=position_{i},tau=effort_{i},'
                    't=time".'
                )
            pairs.append((key.strip(), value.strip()))
    found = {}
    for key, value in pairs:
        if _KEY.fullmatch(key) is None:
            raise ValueError(
                f"columns does not know the channel {key!r}; expected q, tau, v, a, t "
                "or segment (or one joint's: q1, tau_elbow), with a drive also "
                f"{', '.join(_TOLD)}, then = and a name in the "
                "file, in which {i} stands for the joint's number and {joint} for its "
                "name."
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
    """A column that fits a pattern: what stands for * and {i} or {joint}, its unit."""

    prefix: str
    key: str
    column: str
    unit: str


def name_and_unit(table: Table, column: str) -> tuple[str, str]:
    """Return a column's name without the unit that stands with it, and that unit."""
    bare, unit = split_unit(column)
    return (bare, unit) if unit else (column, table.units.get(column, ""))


def matches(pattern: str, table: Table) -> list[Match]:
    """Return the columns that fit a pattern."""
    # {i} is a number, {joint} and * are anything. A unit behind the name counts with it
    # or without.
    bare, unit = split_unit(pattern)
    if table.nameless:
        return _in_places(bare, unit, table)
    expression, without = _expression(pattern), _expression(bare)
    found = []
    for name in table.columns:
        match = expression.fullmatch(name)
        stripped, own = name_and_unit(table, name)
        if match is None:
            match = without.fullmatch(stripped)
        if match is None or (own and unit and own != unit):
            continue
        groups = match.groupdict()
        key = groups.get("i", groups.get("joint", ""))
        if "i" in groups:
            key = key.lstrip("0").rjust(1, "0")
        found.append(Match(groups.get("any", ""), key, name, own or unit))
    return found


def _in_places(places, unit, table):
    """Return the columns of a table without names that are in places such as 2-7."""
    match = re.fullmatch(r"0*(\d{1,6})(?:-0*(\d{1,6}))?", places.strip())
    if match is None:
        return []
    first, last = int(match[1]), int(match[2] or match[1])
    columns = [str(place) for place in range(first, last + 1)]
    if not columns or not all(x in table.columns for x in columns):
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


# -- layouts ---------------------------------------------------------------------------


def by_mapping(table: Table, mapping: dict, joints=(), rest=None) -> Layout:
    """Lay out the columns by a mapping, and the rest by their own names."""
    # rest: layout of a known log, which says it better than the names
    found = {key: matches(pattern, table) for key, pattern in mapping.items()}
    missing = [mapping[key] for key, own in found.items() if not own]
    if missing:
        raise MappingRefused(
            f"has no column {', '.join(missing)}, which columns asks for; found "
            f"{listed(table.columns)}"
        )
    taken = _claimed(mapping, found)
    roles = {}
    for key, own in found.items():
        for match in own:
            role = _role(key, match.key)
            if taken[match.column] != key:
                continue
            if role in roles:
                raise MappingRefused(
                    f"columns {roles[role].column!r} and {match.column!r} both fit "
                    f"{key}={mapping[key]}; say which one"
                )
            roles[role] = Role(column=match.column, unit=match.unit)
    kinds = {kind_of(key) for key in mapping}
    plain = rest or by_names(table, joints)
    for role, own in plain.roles.items():
        if own.column not in taken:
            kept = role if kind_of(role) not in kinds else own.column
            roles.setdefault(kept, own)
    if table.nameless:
        # What nobody has named is no signal.
        rest = frozenset(table.columns) - set(taken)
        roles = {name: own for name, own in roles.items() if own.column in taken}
        told = tuple(roles.pop(name) for name in ("t", "T") if name in roles)
        return Layout(roles=roles, times=told, beside=rest, certain=True)
    times = tuple(x for x in plain.times if x.column not in taken)
    if "t" in kinds:
        # What else might be time is a column like others.
        roles |= {x.column: x for x in times}
        times = tuple(roles.pop(x) for x in ("t", "T") if x in roles and x in mapping)
    if rest is not None:
        return replace(rest, roles=roles, times=times)
    return Layout(roles=roles, times=times, certain=True)


def _claimed(mapping, found):
    """Return the key of a mapping for each column that fits one."""
    # Of patterns that fit the same column, the one counts that spells out more of it.
    spelled = {key: len(_EVERY.sub("", re.escape(x))) for key, x in mapping.items()}
    taken = {}
    for key, own in found.items():
        for match in own:
            other = taken.setdefault(match.column, key)
            if other != key and spelled[other] == spelled[key]:
                raise MappingRefused(
                    f"columns names {match.column!r} twice, for {other} and {key}; "
                    "each column is one channel"
                )
            if spelled[key] > spelled[other]:
                taken[match.column] = key
    return taken


def _role(key, suffix):
    """Name a channel of one joint as this package does."""
    if not suffix:
        return key
    return f"{key}{suffix}" if suffix.isdecimal() else f"{key}_{suffix}"


def spellings(kind, drive):
    """Return the names of a kind of channel; drive: what is recorded, None: torques."""
    own = _SPELLINGS.get(kind, (kind,))
    if drive is None:
        return own
    return own + {"v": _SPEEDS, "tau": drive.spelled}.get(kind, ())


def kind_of(role):
    """Return the kind, such as q or q_desired, that a name begins with."""
    return _KIND_OF[_begin(role)] if _begin(role) else ""


def _begin(role):
    match = _BEGIN.match(role)
    return match[0].lower() if match else ""


def by_names(table: Table, joints=()) -> Layout:
    """Lay out columns by their own names, units in them taken off."""
    roles, times = {}, []
    clocks = _clocks_of_two(table)
    parts = {name for clock in clocks for name in clock.columns}
    for name in table.columns:
        if name in parts:
            roles[name] = Role(column=name)
            continue
        bare, unit = name_and_unit(table, name)
        bare, plain = _in_letters(bare), _in_letters(name)
        if bare.lower() in TIME_NAMES:
            times.append(Role(column=name, unit=unit))
            continue
        stem, last = split_last_part(bare, "t")
        if last and not unit and stem.lower() in TIME_NAMES:
            times.append(Role(column=name, unit=last))
            continue
        if unit and unit not in joints and _is_channel(bare, unit):
            roles.setdefault(bare, Role(column=name, unit=unit))
            continue
        kind, stem, last = kind_of(plain), plain, ""
        if kind in _SPELLINGS:
            stem, last = split_last_part(plain, kind)
        if last and last not in joints and _is_channel(stem, last, joints):
            roles.setdefault(stem, Role(column=name, unit=last))
            continue
        roles.setdefault(plain, Role(column=name))
    exact = [x for x in times if name_and_unit(table, x.column)[0].lower() == "t"]
    if exact:
        roles |= {x.column: x for x in times if x not in exact}
    if not times and len(clocks) == 1:
        times = clocks
        roles = {name: role for name, role in roles.items() if name not in parts}
    return Layout(roles=roles, times=tuple(exact or times))


def _clocks_of_two(table):
    """Return the clocks that have a column of seconds and one of nanoseconds."""
    return [
        Role(column=name, unit="s", nanoseconds=other)
        for name in table.columns
        for seconds, nanoseconds in _CLOCK_PARTS
        if name.lower().endswith(seconds)
        and (other := name[: -len(seconds)] + nanoseconds) in table.columns
    ]


def _in_letters(name):
    """Return a name with plain digits for subscripts, and tau for the Greek letter."""
    return unicodedata.normalize("NFKC", name).replace("τ", "tau")


def _is_channel(bare, unit, joints=None):
    """Whether a name is that of a channel, so that a unit may follow it."""
    # With `joints`, it must be followed by a number or one of them.
    kind = kind_of(bare)
    if kind not in _SPELLINGS:
        return False
    rest = bare[len(_begin(bare)) :]
    if not rest:
        return unit_of(kind, unit) is not None
    suffix = rest.strip("_.[]()")
    if suffix.isdecimal():
        return True
    return rest[0] in "_.[(" and (joints is None or suffix in joints)


def by_preset(table: Table, name: str | None, joints=(), told=("tau",), chosen=False):
    """Return the layouts of known logs that the columns fit, one for each preset."""
    # `name` is a preset or None for any; `joints` are those of the robot, if it is
    # known, and `chosen` if the user says that they are those of the columns, in order;
    # `told` are the channels of torques or of a drive, the one that must be there
    # first.
    found = {}
    for preset, logs in PRESETS.items():
        if name in (None, preset):
            for log in logs:
                layout = _fitted(table, log, joints, told, chosen)
                if layout is not None:
                    found[preset] = layout
                    break
    return found


def checked_preset(name):
    """Return a preset as it is spelled here, None for None; refuse unknown ones."""
    found = None if name is None else str(name).lower()
    if found is not None and found not in PRESETS:
        raise ValueError(
            f"preset must be one of {', '.join(PRESETS)}; got {name!r}. For other "
            'names give columns, such as "q=position_{i},tau=effort_{i},t=time".'
        )
    return found


def _fitted(table, log: KnownLog, joints, told, chosen):
    """Lay out columns as in a known log; None if they are not those."""
    patterns = {"q": log.q, "tau": log.tau, "v": log.v, **log.commands}
    channels = {
        kind: matches(patterns[kind], table)
        for kind in ("q", "v", *told)
        if patterns.get(kind)
    }
    if told[0] not in channels:
        return None
    if told[0] in log.commands:
        channels = _beside_state(channels, log)
    if log.motors:
        channels = _moving(table, channels, len(joints))
    pairs = {
        kind: {(x.prefix, x.key) for x in found} for kind, found in channels.items()
    }
    shared = pairs["q"] & pairs[told[0]]
    prefixes = {prefix for prefix, _ in shared}
    if len(prefixes) != 1:
        return None
    (prefix,) = prefixes
    if "{joint}" in log.q and joints and not any((prefix, x) in shared for x in joints):
        return None
    roles = {}
    for kind, found in channels.items():
        for match in found:
            needed = kind in ("q", told[0])
            if match.prefix == prefix and (needed or pairs[kind] >= shared):
                unit = match.unit or (log.motor_unit if kind == "tau" else "")
                roles[_role(kind, match.key)] = Role(column=match.column, unit=unit)
    times = _times(table, log, prefix)
    if not times and not log.commands:
        return None
    beside = {
        name
        for name in table.columns
        if any(re.fullmatch(pattern, name) for pattern in log.beside)
    }
    used = {role.column for role in roles.values()}
    used |= {part for time in times for part in time.columns}
    for name in table.columns:
        if name not in beside and name not in used:
            roles.setdefault(name, Role(column=name))
    if log.segment in table.columns:
        roles.pop(log.segment, None)
        roles["segment"] = Role(column=log.segment)
    return Layout(
        roles=roles,
        beside=frozenset(beside - used - {log.segment}),
        times=tuple(times),
        joints=_names_in(table, log) or (() if chosen else _motors(log, joints)),
        what=log.what,
        certain=True,
        question=log.question if told[0] in log.commands else "",
        answer=f"q={log.q} [{SHARE[0] if table.shares else 'deg'}]",
    )


def _beside_state(channels, log):
    """Give commands the prefix of the state that they stand beside."""
    # Commands are a message of their own, of another name.
    states = {match.prefix for match in channels["q"]}
    if len(states) != 1:
        return channels
    (prefix,) = states
    found = {}
    for kind, own in channels.items():
        if kind in log.commands and len({match.prefix for match in own}) == 1:
            own = [replace(match, prefix=prefix) for match in own]
        found[kind] = own
    return found


def _moving(table, channels, count):
    """Leave out numbered motors beyond those of the robot, which never move."""
    # A message has a place for more motors than most robots have.
    numbers = sorted({int(x.key) for x in channels["q"] if x.key.isdecimal()})
    still = {x.key for x in channels["q"] if not np.any(table.columns[x.column])}
    while numbers and str(numbers[-1]) in still and len(numbers) > max(count, 1):
        numbers.pop()
    kept = {str(x) for x in numbers}
    return {
        kind: [x for x in own if x.key in kept or not x.key.isdecimal()]
        for kind, own in channels.items()
    }


def _motors(log, joints):
    """Return the robot's joints in the order of the motors of a log, if it says it."""
    found = [[one for one in joints if part in one] for part in log.motors]
    known = len(found) == len(joints) and all(len(own) == 1 for own in found)
    return tuple(own[0] for own in found) if known else ()


def _times(table, log, prefix):
    """Return the columns of time that a known log has here."""
    found = []
    for name in log.times:
        bare, own = split_unit(name)
        parts = [part.replace("*", prefix) for part in bare.split("+")]
        if all(part in table.columns for part in parts):
            unit = "s" if len(parts) == 2 else own or log.time_unit
            found.append(
                Role(column=parts[0], unit=unit, nanoseconds="".join(parts[1:]))
            )
    return found


def _names_in(table, log):
    """Return the names of the joints that stand in the rows, in order."""
    if not log.joints:
        return ()
    found = matches(log.joints, table)
    found = sorted((int(x.key or 0), x.column) for x in matches(log.joints, table))
    cells = [table.columns[column] for _, column in found]
    if not cells:
        return ()
    first = [str(values[0]) for values in cells]
    changing = any((values != values[0]).any() for values in cells)
    if "{i}" in log.joints:
        names = tuple(first)
    else:
        # A list in one cell, as Python writes it.
        names = tuple(re.findall(r"[^\s\[\](),'\"]+", first[0]))
    if changing:
        raise ValueError(
            f"{table.path}: the names of the joints change from row to row, so that a "
            "column is not one joint; read the bag itself, or write one column for "
            "each joint."
        )
    return names


# -- units and times -------------------------------------------------------------------


def channel_unit(table: Table, kind: str, role: Role) -> Unit | None:
    """Return the unit of a channel, None if nothing tells; refuse one not known."""
    if not role.unit:
        return None
    if MEASURED.get(kind, kind) == "q" and role.unit in SHARE:
        return _share(table, role)
    unit = unit_of(kind, role.unit)
    if unit is None:
        expected = {
            "q": "rad, deg, m or mm",
            "v": "rad/s, deg/s, m/s or mm/s",
            "a": "rad/s^2, deg/s^2 or m/s^2",
            "tau": "Nm, N, A, V or %",
            "t": "s, ms, us or ns",
            "kp": "Nm/rad or N/m",
            "kd": "Nms/rad or Ns/m",
        }[MEASURED.get(kind, kind)]
        raise ValueError(
            f"{table.path}: column {role.column!r} is in {role.unit!r}, which is not a "
            f"known unit of {kind}; expected {expected}. Convert it, or correct the "
            "name."
        )
    return unit


def _share(table: Table, role: Role) -> Unit:
    """Return the unit of a position that is a share of a motor's calibrated range."""
    if role.column not in table.shares:
        raise ValueError(
            f"{table.path}: column {role.column!r} is a share of a calibrated range, "
            "which is not known: put the robot's calibration file (range_min and "
            "range_max of each motor) into the data set as meta/calibration.json, or "
            "turn the columns into radians."
        )
    return Unit("rad", table.shares[role.column])


_STAMP = re.compile(
    r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d)(:\d\d)?([.,]\d+)?\s*(Z|[+-]\d\d:?\d\d)?"
)


def seconds_of_dates(table: Table, column: str):
    """Return dates with times of day as seconds from the first, None for others."""
    values = table.columns[column]
    if values.dtype.kind == "M" and not np.isnat(values).any():
        return (values - values[0]) / np.timedelta64(1, "s")
    if values.dtype.kind != "U" or not _STAMP.fullmatch(values[0]):
        return None
    stamps, zones = [], set()
    for row, text in enumerate(values):
        match = _STAMP.fullmatch(text)
        if match is None:
            raise ValueError(
                f"{table.path}: {quoted(text)} in {table.where(row)}, column "
                f"{column!r}, is not a date and time like the others; correct or "
                "remove that row."
            )
        day, minute, second, fraction, zone = match.groups()
        zones.add(zone or "")
        fraction = (fraction or "").replace(",", ".")
        stamps.append(f"{day}T{minute}{second or ':00'}{fraction[:10]}")
    if len(zones) > 1:
        raise ValueError(
            f"{table.path}: column {column!r} has times of several zones "
            f"({', '.join(sorted(zones))}); write all in one."
        )
    try:
        instants = np.array(stamps, dtype="datetime64[ns]")
    except ValueError as error:
        raise ValueError(f"{table.path}: column {column!r}: {error}.") from None
    return (instants - instants[0]) / np.timedelta64(1, "s")
