"""Units and words in the names of columns and files."""

import difflib
import re
from dataclasses import dataclass

import numpy as np

# Channels of joints, and which of them a command has the unit of.
KINDS = ("q", "tau", "v", "a")
MEASURED = {"q_desired": "q", "v_desired": "v", "tau_ff": "tau"}
# What one may write for a time, where a unit is asked for, in seconds.
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# A clock steps by this many seconds, and is this near to a straight line, as a share of
# what it rises.
_FASTEST, _SLOWEST, _STRAIGHT = 2e-5, 1.0, 0.02
# Units of channels that are neither motion nor torque, for a row of units.
_OTHERS = ("1", "-", "°C", "C", "K", "degC", "bar", "Pa", "kPa", "Hz", "kg", "W", "Ohm")
_DEGREE, _TURN = np.pi / 180, 2 * np.pi


@dataclass(frozen=True)
class Unit:
    """A unit: its base and its size in it."""

    base: str
    factor: float


def _sizes(text):
    """Return sizes by spelling, out of "a b=1 c=2"; those without follow the next."""
    found, waiting = {}, []
    for word in text.split():
        name, _, size = word.partition("=")
        waiting.append(name)
        if size:
            found |= dict.fromkeys(waiting, float(size))
            waiting = []
    return found


_ANGLE = _sizes("rad radian radians=1 mrad=1e-3")
_ANGLE |= dict.fromkeys(("deg", "degs", "degree", "degrees", "°"), _DEGREE)
_ANGLE |= dict.fromkeys(("rev", "revs", "turn", "turns", "revolutions"), _TURN)
_LENGTH = _sizes("m metre metres meter meters=1 cm=1e-2 mm=1e-3 um µm μm=1e-6")


def _derived(endings, **more):
    """Return units of derivatives of positions, by their base."""
    return {
        base: {f"{unit}{end}": x for unit, x in own.items() for end in endings}
        | more.get(base, {})
        for base, own in (("rad", _ANGLE), ("m", _LENGTH))
    }


_BY_BASE = {
    "q": {"rad": _ANGLE, "m": _LENGTH},
    "v": _derived(("/s", "/sec", "ps"), rad={"rpm": _TURN / 60, "1/min": _TURN / 60}),
    "a": _derived(("/s^2", "/s2", "/s²", "/s/s", "ps2")),
    "tau": {
        "N m": _sizes("Nm newtonmeter newtonmetre=1 Ncm=1e-2 mNm=1e-3 kNm=1e3")
        | _sizes("kgfcm kgcm=0.0980665 lbfin=0.1129848290276167"),
        "N": _sizes("N=1 mN=1e-3 kN=1e3"),
        "A": _sizes("A amp amps ampere amperes Arms=1 mA=1e-3"),
        "V": _sizes("V volt volts=1 mV=1e-3"),
        "count": _sizes("count counts=1"),
        "%": _sizes("% percent=1 ‰ permille=0.1"),
    },
    "t": {
        "s": _sizes("s sec secs second seconds=1 ms msec millisecond milliseconds=1e-3")
        | _sizes("us µs μs usec microseconds=1e-6 min minutes=60")
        | _sizes("ns nsec nanosecond nanoseconds=1e-9")
    },
    "supply": {"V": _sizes("V volt volts=1 mV=1e-3")},
    "kp": {"N m/rad": {"Nm/rad": 1.0, "Nm/deg": 1 / _DEGREE}, "N/m": {"N/m": 1.0}},
    "kd": {
        "N m s/rad": {"Nms/rad": 1.0, "Nm/(rad/s)": 1.0, "Nms/deg": 1 / _DEGREE},
        "N s/m": {"Ns/m": 1.0},
    },
}
_UNITS = {
    kind: {
        spelling: Unit(base, size)
        for base, sizes in bases.items()
        for spelling, size in sizes.items()
    }
    for kind, bases in _BY_BASE.items()
}
# What refusals expect.
EXPECTED = {
    "q": "rad, deg, m or mm",
    "v": "rad/s, deg/s, m/s or mm/s",
    "a": "rad/s^2, deg/s^2 or m/s^2",
    "tau": "Nm, N, A, V or %",
    "t": "s, ms, us or ns",
    "supply": "V or mV",
    "kp": "Nm/rad or N/m",
    "kd": "Nms/rad or Ns/m",
}
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
    text = text.strip("[]() ")
    return any(unit_of(kind, text) for kind in (*KINDS, "t")) or text in _OTHERS


def split_unit(name: str) -> tuple[str, str]:
    """Return a name without the unit in brackets at its end, and that unit."""
    match = _IN_BRACKETS.fullmatch(name)
    if match is None:
        return name, ""
    unit = next(x for x in match.groups()[1:] if x is not None).strip()
    # Of q[1] and pos(elbow) these are the joints.
    if not match[1] or unit.isdecimal() or "{" in unit:
        return name, ""
    return match[1], unit


def split_last_part(name: str, kind: str) -> tuple[str, str]:
    """Return a name without a last part that is a unit of a kind, and that unit."""
    match = _LAST_PART.fullmatch(name)
    if match is None or unit_of(kind, match[2]) is None:
        return name, ""
    return match[1], match[2]


# -- units of time ---------------------------------------------------------------------


def is_clock(values):
    """Whether a column rises steadily, at steps that are those of a robot."""
    if values.dtype.kind not in "iuf" or values.size < 3:
        return False
    values = values.astype(float)
    step = np.diff(values)
    rises = (step >= 0).all() and step.sum() > 0
    if not rises or not unit_of_steps(usual_step(values)):
        return False
    line = np.linspace(values[0], values[-1], values.size)
    return bool(np.abs(values - line).max() <= _STRAIGHT * (values[-1] - values[0]))


def usual_step(t):
    """Return the middle one of the steps by which a clock rises, 0 without any."""
    # Of rows that are out of order as if they were sorted.
    step = np.diff(np.sort(t))
    step = step[step > 0]
    return float(np.median(step)) if step.size else 0.0


def unit_of_steps(step):
    """Return the unit of time in which steps are those of a robot, "" for none."""
    known = (unit for unit, size in TIME_UNITS.items() if is_of_a_robot(step * size))
    return next(known, "")


def is_of_a_robot(period):
    """Whether a period [s] is one of a robot that moves."""
    return _FASTEST < period < _SLOWEST


# -- words -----------------------------------------------------------------------------

# Words and the kinds of channels that they mean.
_WORDS = {
    "t": "t ts time timestamp stamp clock",
    "q": "q pos position angle theta encoder",
    "v": "v dq qd qdot vel velocity velocities speed",
    "a": "ddq qdd qddot acc accel acceleration",
    "torque": "tau torque trq effort eff moment force load",
    "current": "current curr cur amp ampere i",
    "command": "target cmd command desired des ref reference goal setpoint sp action",
    "other": "error temperature temp voltage external ext limit cartesian tcp enable "
    "mode window model friction fric gravity grav control con feedforward ff",
}
_KIND_OF = {word: kind for kind, words in _WORDS.items() for word in words.split()}
_MEASURED = {"measured", "meas", "actual", "act"}
# The least similarity of a word to one of these, and the shortest word that has any.
_SIMILAR, _LONG = 0.85, 4


def kinds_in(name):
    """Return the kinds that the words of a name mean, also misspelled, a set of str."""
    kinds = set()
    for word in _words(name):
        near = [x for x in (word, word.removesuffix("s")) if x in _KIND_OF][:1]
        if not near and len(word) >= _LONG:
            near = difflib.get_close_matches(word, _KIND_OF, 1, _SIMILAR)
        kinds |= {_KIND_OF[x] for x in near}
    return kinds


def is_measured(name):
    """Return whether a name says that it is a measurement."""
    return bool(_MEASURED & set(_words(name)))


def is_current(name):
    """Return whether a name says that it is a motor's current, and no torque."""
    kinds = kinds_in(name)
    return "current" in kinds and "torque" not in kinds


def _words(name):
    """Return the words in a name or pattern, in small letters."""
    text = re.sub(r"\{\w+\}", " ", split_unit(name)[0])
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    return [x.lower() for x in re.findall(r"[^\W\d_]+", text)]
