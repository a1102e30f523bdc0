"""The refusal of a file whose columns are not recognised, and what would be taken."""

import re
from collections import Counter
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.recording._layout import TIME_NAMES
from sklearn_vbjfa.recording._table import Table
from sklearn_vbjfa.recording._units import (
    TIME_UNITS,
    split_last_part,
    split_unit,
    unit_of,
)

# Words in names, and how well they say what a column is.
_WORDS = {
    "q": {"q": 3, "position": 3, "positions": 3, "pos": 3, "angle": 3, "angles": 3}
    | {"theta": 2, "phi": 2, "winkel": 3, "joint": 1, "joints": 1, "actual": 1}
    | {"measured": 1, "meas": 1, "act": 1, "state": 1, "encoder": 1, "axis": 1},
    "tau": {"tau": 3, "torque": 3, "torques": 3, "effort": 3, "efforts": 3, "trq": 3}
    | {"moment": 2, "moments": 2, "drehmoment": 3, "current": 2, "currents": 2}
    | {"strom": 2, "i": 1, "load": 1, "force": 2, "actual": 1, "measured": 1, "m": 1}
    | {"meas": 1, "act": 1, "motor": 1, "mom": 2},
}
# Words of what is asked for, or of something else.
_OTHER = {"target", "cmd", "command", "commanded", "desired", "des", "ref", "goal"}
_OTHER |= {"reference", "setpoint", "sp", "error", "err", "tcp", "cartesian", "ext"}
_OTHER |= {"velocity", "vel", "speed", "qd", "dq", "acc", "acceleration", "d", "ff"}
_OTHER |= {"temperature", "temp", "voltage", "stamp", "external", "soll", "window"}
# Words of a motor's current.
_CURRENT = {"current", "currents", "strom", "i"}
# A name must have a word that says it by itself.
_ENOUGH = 2
# A clock that steps by this or more [s] is in another unit.
_SLOWEST, _FASTEST = 1.0, 2e-5


class RecordingRefused(ValueError):
    """A file that would be read with other options.

    Attributes
    ----------
    reason : str
        What is wrong, without the options.
    options : dict of str to str, tuple or None
        The options, by the names of `read_recording`; None for one to leave out. Empty
        if none would do.
    """

    def __init__(self, reason, options=None):
        self.reason = reason.removesuffix(".")
        self.options = dict(options or {})
        offers = [f"{key}={value!r}" for key, value in self.options.items()]
        offer = f"; try {', '.join(offers)}" if offers else ""
        super().__init__(f"{self.reason}{offer}.")


@dataclass(frozen=True)
class _Family:
    """Columns that differ in a number or a joint's name."""

    pattern: str
    keys: tuple
    columns: tuple


def suggestion(table: Table, joints, needed, given, *, timed, gained):
    """Return the options that would read a file, {} if they cannot be told."""
    # joints: names of the robot's joints, empty if unknown; needed: kinds without a
    # column ("q", "tau", "t"); given: mapping as far as it stands; timed: whether a
    # period is known; gained: whether gains are.
    mapping, numbered = dict(given), None
    families = _families(table, joints)
    best = _best_pair(table, families, joints, needed)
    for kind in ("q", "tau"):
        if kind in needed:
            if best.get(kind) is None:
                return {}
            mapping[kind] = best[kind].pattern
            numbered = best[kind].keys if "{i}" in best[kind].pattern else None
    options = {}
    if "tau" in needed and not gained and len(best["tau"].keys) > 1:
        units = {split_unit(column)[1] for column in best["tau"].columns} - {""}
        bases = {x.base for x in (unit_of("tau", unit) for unit in units) if x}
        if not units and _CURRENT & set(_words(best["tau"].pattern)):
            mapping["tau"] += " [A]"
            options["gains"] = "unknown"
        elif bases - {"N m", "N"}:
            options["gains"] = "unknown"
    if "t" in needed and not timed:
        column = _clock(table)
        if column is None:
            return {}
        mapping["t"] = column
        unit = _clock_unit(table, column)
        if unit not in ("", "s"):
            options["time_unit"] = unit
    if any("," in x or "=" in x for x in mapping.values()):
        return {}
    chosen = _joints_of(numbered, joints)
    if chosen:
        options["joint_names"] = chosen
    columns = ",".join(f"{kind}={pattern}" for kind, pattern in mapping.items())
    return {"columns": columns, **options}


def nearest(table: Table, kind, joints):
    """Return the pattern of the columns nearest to a kind, "" for none."""
    if kind == "t":
        return _clock(table) or ""
    found = _ranked(_families(table, joints), kind, joints)
    return found[0].pattern if found else ""


def _families(table, joints):
    """Group the columns of numbers by their names without a number or joint."""
    groups = {}
    bare = Counter(split_unit(name)[0] for name in table.columns)
    for column, values in table.columns.items():
        if values.dtype.kind not in "biuf":
            continue
        # Joints that turn and joints that slide have units of their own.
        name = split_unit(column)[0]
        if bare[name] > 1:
            name = column
        for joint in sorted(joints, key=len, reverse=True):
            at = name.find(joint)
            if at >= 0:
                pattern = f"{name[:at]}{{joint}}{name[at + len(joint) :]}"
                groups.setdefault(pattern, {})[joint] = column
                break
        # Any of its numbers may be the joint's.
        for match in re.finditer(r"\d+", split_unit(name)[0]):
            pattern = f"{name[: match.start()]}{{i}}{name[match.end() :]}"
            groups.setdefault(pattern, {})[int(match[0])] = column
    return [
        _Family(pattern, tuple(sorted(found, key=str)), tuple(found.values()))
        for pattern, found in groups.items()
        if _is_row(pattern, found, joints)
    ]


def _is_row(pattern, found, joints):
    """Whether a group counts from 0 or 1 without a hole, or has joints' names."""
    if "{joint}" in pattern:
        return True
    numbers = sorted(found)
    alone = len(numbers) > 1 or len(joints) == 1
    return (
        alone and numbers[0] in (0, 1) and numbers[-1] - numbers[0] == len(numbers) - 1
    )


def _words(pattern):
    """Return the words in a pattern, in small letters."""
    text = re.sub(r"\{\w+\}", " ", pattern)
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    return [x.lower() for x in re.findall(r"[^\W\d_]+", text)]


def _score(pattern, kind):
    """How well the words of a pattern say that it is of a kind."""
    words = _words(pattern)
    points = [_WORDS[kind].get(word, 0) for word in words]
    if not points or max(points) < _ENOUGH or _OTHER & set(words):
        return 0
    return sum(points)


def _ranked(families, kind, joints):
    """Return families of a kind, the best first."""
    scored = [(x, _score(x.pattern, kind)) for x in families]

    def order(pair):
        family, score = pair
        by_number = "{joint}" not in family.pattern
        return (len(family.keys) != len(joints), -score, by_number, family.pattern)

    return [x for x, score in sorted(scored, key=order) if score]


def _best_pair(table, families, joints, needed):
    """Return a family for each kind needed, both of the same joints."""
    ranked = {kind: _ranked(families, kind, joints) for kind in ("q", "tau")}
    if {"q", "tau"} <= set(needed):
        for first in ranked["q"]:
            for second in ranked["tau"]:
                if first.keys == second.keys and first.columns != second.columns:
                    return {"q": first, "tau": second}
        return {}
    return {kind: found[0] for kind, found in ranked.items() if found}


def _joints_of(numbers, joints):
    """Return the joints that numbered columns are of, if the robot has others, too."""
    if numbers is None or len(numbers) == len(joints) or not joints:
        return ()
    groups = {}
    for joint in joints:
        match = re.search(r"\d+(?=\D*$)", joint)
        if match:
            rest = joint[: match.start()] + "\0" + joint[match.end() :]
            groups.setdefault(rest, {})[int(match[0])] = joint
    fitting = [
        x for x in groups.values() if sorted(x) == sorted(int(k) for k in numbers)
    ]
    if len(fitting) != 1:
        return ()
    return tuple(fitting[0][k] for k in sorted(fitting[0]))


def _clock(table):
    """Return the column that is time, None if none or several could be."""
    named = []
    for name, values in table.columns.items():
        bare = split_unit(name)[0]
        stem = split_last_part(bare, "t")[0]
        last = re.split(r"[/. ]", bare)[-1].lower()
        if {bare.lower(), stem.lower(), last} & set(TIME_NAMES) and _rises(values):
            named.append(name)
    return named[0] if len(named) == 1 else None


def _rises(values):
    if values.dtype.kind not in "iuf" or values.size < 2:
        return values.dtype.kind in "MU"
    return bool((np.diff(values.astype(float)) >= 0).all() and values[-1] > values[0])


def _clock_unit(table, column):
    """Return the unit in which a clock must be if its steps are those of a robot."""
    values = table.columns[column]
    if values.dtype.kind not in "iuf" or split_unit(column)[1]:
        return ""
    return unit_of_steps(usual_step(values.astype(float)))


def usual_step(t):
    """Return the middle one of the steps by which a clock rises, 0 without any."""
    step = np.diff(t)
    step = step[step > 0]
    return float(np.median(step)) if step.size else 0.0


def unit_of_steps(step):
    """Return the unit of time in which steps are those of a robot, "" for none."""
    fitting = [
        unit
        for unit, factor in zip(TIME_UNITS, (1.0, 1e-3, 1e-6, 1e-9))
        if _FASTEST < step * factor < _SLOWEST
    ]
    return fitting[0] if fitting else ""


def unit_is_wrong(period):
    """Whether a period [s] is none of a robot that moves."""
    return not _FASTEST < period < _SLOWEST
