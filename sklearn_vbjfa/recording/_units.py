"""Units in the names of columns, and what they are in those of this package.

A unit stands in brackets behind a name (``q1 [deg]``, ``tau1 (Nm)``, ``t / ms``) or is
its last part (``q1_deg``, ``t_ns``).
"""

import re
from dataclasses import dataclass

import numpy as np

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


_UNITS = _table()
# What one may write for a time, where a unit is asked for.
TIME_UNITS = ("s", "ms", "us", "ns")
_IN_BRACKETS = re.compile(r"(.*?)\s*(?:\[([^][]*)\]|\(([^()]*)\)|\s/\s*(\S+))")
_LAST_PART = re.compile(r"(.*?)[_ .]([A-Za-z°µμ%][A-Za-z0-9^/²]*)")


def unit_of(kind: str, text: str) -> Unit | None:
    """Return the unit of a channel of a kind (q, v, a, tau, t), None if unknown."""
    plain = re.sub(r"[\s*·.⋅]|(?<=N)-(?=m)", "", text.strip())
    known = _UNITS[kind]
    if plain in known:
        return known[plain]
    # Capitals matter for milli and mega, ampere and atto; words may have any.
    if len(plain) > 2 and plain.lower() in known:
        return known[plain.lower()]
    return known["Nm"] if kind == "tau" and plain.lower() == "nm" else None


def is_unit(text: str) -> bool:
    """Whether a text is some unit, with or without brackets."""
    text = text.strip().strip("[]()").strip()
    return any(unit_of(kind, text) for kind in _UNITS) or text in _OTHERS


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
