"""The columns of a file as channels of the robot's joints, in their order."""

import re
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.recording._drives import COMMANDS
from sklearn_vbjfa.recording._layout import (
    ESTIMATES,
    TIME_NAMES,
    TIME_UNITS,
    TURNS,
    Layout,
    MappingRefused,
    by_mapping,
    by_names,
    by_preset,
    kind_of,
    spellings,
    split_last_part,
    split_unit,
    unit_of,
)
from sklearn_vbjfa.recording._presets import PRESETS
from sklearn_vbjfa.recording._table import Loss, RecordingRefused, Table, listed


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What the user says of the columns, and whether of the period and the gains."""

    mapping: dict
    preset: str | None
    timed: bool
    gained: bool
    drive: object = None  # `Drive` whose channels stand in place of torques

    @property
    def told(self):
        """Channels of torques or of the drive, the one that must be there first."""
        drive = self.drive
        if drive is None:
            return ("tau",)
        return ("tau" if drive.spelled else drive.told, *drive.beside)

    @property
    def needed(self):
        """Kinds without which there is no recording."""
        return "q", self.told[0]

    @property
    def kinds(self):
        """All kinds of channels, in order."""
        return "q", *self.told, "v", "a"


@dataclass(frozen=True, kw_only=True)
class Joints:
    """The joints that columns are looked for of, and whether the user chose them."""

    names: tuple = ()
    chosen: bool = False


def laid_out(table: Table, asked, robot) -> Layout:
    """Say which columns are which channels; refuse what does not fit."""
    mapping, preset, names = asked.mapping, asked.preset, robot.names
    known = names, asked.told, robot.chosen
    if preset is not None and mapping:
        raise RecordingRefused(
            "give columns or a preset, not both: a preset is a mapping.",
            {"preset": None},
        )
    if mapping:
        rest = by_preset(table, None, *known) if asked.drive is not None else {}
        rest = next(iter(rest.values())) if len(rest) == 1 else None
        try:
            return _named(by_mapping(table, mapping, names, rest))
        except MappingRefused as error:
            raise RecordingRefused(
                f"{table.path}: {error}.", otherwise(table, asked, names)
            ) from None
    if table.nameless:
        raise _without_names(table, names)
    plain = by_names(table, names)
    if table.joints:
        return replace(plain, certain=True)
    if preset is None and any(
        _matched(plain, kind, names, asked.drive) for kind in asked.needed
    ):
        return plain
    fitted = by_preset(table, preset, *known)
    if len(fitted) > 1:
        raise RecordingRefused(
            f"{table.path}: could be {' or '.join(x.what for x in fitted.values())}; "
            f"give preset={' or '.join(repr(x) for x in fitted)}.",
            {"preset": next(iter(fitted))},
        )
    if fitted:
        (layout,) = fitted.values()
        return _named(layout)
    if preset is not None:
        expected = " or ".join(
            f"{x.q} and {x.commands.get(asked.told[0], x.tau)}" for x in PRESETS[preset]
        )
        raise RecordingRefused(
            f"{table.path}: does not fit the preset {preset!r}, which expects columns "
            f"{expected}; found {listed(table.columns)}.",
            otherwise(table, asked, names),
        )
    return plain


def _without_names(table, names):
    """Return the refusal of a table without names of columns."""
    n = len(names) or 6
    return RecordingRefused(
        f"{table.path}: has no names of columns; give the places of its "
        f"{len(table.columns)} columns (command line: --columns), such as "
        f'columns="t=1,q={_range(2, n)},tau={_range(2 + n, n)}".'
    )


def _range(first, n):
    """Write places as a mapping has them."""
    return str(first) if n == 1 else f"{first}-{first + n - 1}"


def otherwise(table: Table, asked, names):
    """Return the options that would read a file, had the user said nothing of it."""
    if table.nameless:
        return {}
    said = {"columns": asked.mapping, "preset": asked.preset}
    nothing = {key: None for key, value in said.items() if value}
    plain = by_names(table, names)
    if all(_matched(plain, kind, names, asked.drive) for kind in asked.needed):
        return nothing
    if len(by_preset(table, None, names, asked.told)) == 1:
        return nothing
    found = _suggestion(
        table, names, (*asked.needed, "t"), {}, timed=asked.timed, gained=asked.gained
    )
    return nothing | found if found else {}


def _named(layout: Layout) -> Layout:
    """Put the joints' names, if there are any, into those of numbered channels."""
    # Numbers count from 0 or 1, as elsewhere.
    if not layout.joints:
        return layout
    roles = {}
    first = 0 if "q0" in layout.roles else 1
    for name, role in layout.roles.items():
        match = re.fullmatch(r"([a-z_]*[a-z])(\d+)", name)
        if match and kind_of(match[1]) == match[1]:
            j = int(match[2]) - first
            if 0 <= j < len(layout.joints):
                name = f"{match[1]}_{layout.joints[j]}"
        roles[name] = role
    return replace(layout, roles=roles)


def _matched(layout: Layout, kind, names, drive=None):
    """Return the columns of a kind by joint and by number, two dicts of roles."""
    found = _matched_as(layout, spellings(kind, drive), names)
    if not found and kind == "tau" and drive is None:
        found = _matched_as(layout, ESTIMATES, names)
    return found


def _matched_as(layout, spelled, names):
    """Return the columns with one of some names by joint and by number, or ()."""
    by_joint, by_number = {}, {}
    begin = "|".join(spelled)
    for name, role in layout.roles.items():
        match = re.fullmatch(rf"(?:{begin})[_.\[(]?(.*?)[\])]?", name, re.IGNORECASE)
        if match is None:
            continue
        suffix = match.group(1)
        if suffix in names:
            found, key = by_joint, suffix
        elif suffix.isdecimal() and suffix.isascii():
            # int() would choke on thousands of digits.
            found, key = by_number, suffix.lstrip("0").rjust(1, "0")
        elif not suffix and name.lower() in spelled:
            found, key = by_number, "1"
        else:
            continue
        found.setdefault(key, []).append(role)
    return (by_joint, by_number) if by_joint or by_number else ()


def channels_of(table: Table, layout, asked, robot, notes):
    """Return the roles of each kind, listed in the order of the joints, and those."""
    # Refuses, all at once, what is missing.
    names = robot.names or _own_joints(layout)
    robot = replace(robot, names=names)
    matched = {kind: _matched(layout, kind, names, asked.drive) for kind in asked.kinds}
    missing = [kind for kind in asked.needed if not matched[kind]]
    no_time = not (asked.timed or layout.times)
    if missing or no_time:
        raise _all_missing(table, layout, asked, names, missing, no_time)
    for by_joint, by_number in filter(None, matched.values()):
        _refuse_both(table, by_joint, by_number, names)
    by_joint = {kind: pair[0] for kind, pair in matched.items() if pair}
    if any(by_joint.values()):
        robot = _held(table, layout, robot, by_joint, notes)
    return {
        kind: _in_order(table, kind, pair, robot.names) if pair else []
        for kind, pair in matched.items()
    }, robot


def _own_joints(layout: Layout):
    """Return the joints that the columns of a recognised log are called after."""
    found = {}
    if layout.certain:
        for name in layout.roles:
            match = re.fullmatch(r"q_(.+)", name)
            if match and kind_of(name) == "q" and not match[1].isdecimal():
                found[match[1]] = None
    return tuple(found)


def _held(table, layout, robot, by_joint, notes):
    """Leave out the robot's joints without any column, unless the user chose them."""
    having = set().union(*by_joint.values())
    names = tuple(x for x in robot.names if x in having)
    if layout.certain:
        others = [x for x in _own_joints(layout) if x not in robot.names]
        if others:
            notes.append(
                f"joint(s) {listed(others)} are not joints of the robot and are left "
                "out."
            )
    if robot.chosen or len(names) == len(robot.names):
        return robot
    held = [x for x in robot.names if x not in having]
    notes.append(Loss(f"no columns of joint(s) {listed(held)}: held at zero."))
    return replace(robot, names=names)


def _refuse_both(table, by_joint, by_number, names):
    """Refuse several columns for one channel, and numbers beside names."""
    for found in (by_joint, by_number):
        for roles in found.values():
            for other in roles[1:]:
                refuse_two(table, roles[0].column, other.column)
    if by_joint and by_number:
        name, (named, *_) = next(iter(by_joint.items()))
        j = names.index(name)
        (numbered, *_) = by_number.get(str(j + 1), next(iter(by_number.values())))
        refuse_two(table, named.column, numbered.column)


def _in_order(table: Table, kind, pair, names):
    """Return the roles of one kind in the order of the joints."""
    by_joint, by_number = pair
    found = by_joint or by_number
    first = 0 if by_joint or "0" in found else 1
    count = len(names if by_joint else found)
    roles = []
    for k in range(count):
        key = names[k] if by_joint else str(first + k)
        if key not in found:
            missing = f"{kind}_{names[k]}" if by_joint else f"{kind}{key}"
            beside = listed([role.column for (role, *_) in found.values()])
            raise ValueError(
                f"{table.path}: column {missing!r} is missing beside {beside}; every "
                "joint needs one, in order."
            )
        roles.append(found[key][0])
    return roles


def _all_missing(table, layout, asked, names, missing, no_time):
    """Return the refusal that lists everything that is missing."""
    parts = []
    if missing and asked.drive is None:
        _refuse_commands(table, layout, asked, names, missing)
    strangers = _own_joints(layout)
    if missing and strangers and names:
        parts.append(
            f"its joints {listed(strangers)} are not those of the robot, "
            f"{listed(names)}"
        )
    for kind, what in _WHAT.items():
        if kind in missing:
            near = _nearest(table, kind, names)
            near = f" (nearest: {near})" if near else ""
            parts.append(f"no {what}: expected columns {kind}1, {kind}2, ...{near}")
    if no_time:
        near = _nearest(table, "t", names)
        near = f" (nearest: {near})" if near else ""
        parts.append(
            f"no column t and no dt{near}; add time stamps [s] as column t, or give "
            "the sample period dt in seconds (command line: --dt 0.002)"
            if not missing
            else f"no time: expected a column t, or dt{near}"
        )
    needed = [*missing, *(["t"] if no_time else [])]
    options = _suggestion(
        table, names, needed, asked.mapping, timed=not no_time, gained=asked.gained
    )
    found = f"; found {listed(table.columns)}" if missing else ""
    if missing and not options and names and not asked.mapping:
        options = _by_place(table, asked, names)
        if options:
            parts.insert(0, "its joints are not those of the robot")
            found += "; if both have the same order"
    second = asked.needed[1]
    offer = (
        "; rename them in the header, or give "
        f'columns="q=NAME{{i}},{second}=NAME{{i}},t=NAME"'
        if missing and not options
        else ""
    )
    return RecordingRefused(f"{table.path}: {'; '.join(parts)}{found}{offer}.", options)


def _by_place(table, asked, names):
    """Return the mapping of a known log whose joints have other names, or {}."""
    fitted = by_preset(table, asked.preset, (), asked.told)
    if len(fitted) != 1:
        return {}
    (layout,) = fitted.values()
    mapping = {}
    for kind in asked.needed:
        own = [x.column for name, x in layout.roles.items() if kind_of(name) == kind]
        if len(own) != len(names):
            return {}
        unit = _unit_to_add(table, _Family("", (), tuple(own)), kind)
        mapping |= {f"{kind}{j + 1}": f"{x}{unit}" for j, x in enumerate(own)}
    if "segment" in layout.roles:
        mapping["segment"] = layout.roles["segment"].column
    if layout.times:
        mapping["t"] = layout.times[0].column
    if any("," in x or "=" in x for x in mapping.values()):
        return {}
    return {"columns": ",".join(f"{key}={x}" for key, x in mapping.items())}


# What is missing, by the kinds that may be needed.
_WHAT = {"q": "positions", "tau": "torques", "q_desired": "desired positions"}


def _refuse_commands(table, layout, asked, names, missing):
    """Refuse a file that has commands in place of torques: a drive is missing."""
    if missing == ["tau"] and _nearest(table, "tau", names):
        return
    found = {} if "q" in missing else _commands(layout, names)
    known = {} if found else by_preset(table, None, names, COMMANDS)
    for one in known.values():
        found = _commands(_named(one), names or _own_joints(_named(one)))
    options = {}
    if not found and "tau" in missing and not _nearest(table, "tau", names):
        needed = [*missing[:-1], "q_desired"]
        options = _suggestion(
            table, names, needed, asked.mapping, timed=asked.timed, gained=True
        )
        found = {"q_desired": _nearest(table, "q_desired", names)} if options else {}
    if not found:
        return
    gains = [x for x in ("kp", "kd") if x not in found and x not in table.scalars]
    drive = " ".join(["pd", *(f"{kind}=..." for kind in gains)])
    more = "".join(f", {key}={value!r}" for key, value in options.items())
    needs = f" with {' and '.join(gains)}, a number for each joint" if gains else ""
    raise RecordingRefused(
        f"{table.path}: no torques, but commands: "
        f"{', '.join(f'{kind} ({columns})' for kind, columns in found.items())}; give "
        f'the drive that follows them{needs}: drive="{drive}"{more} (command line: '
        f'--drive "{drive}")',
        {} if gains or options else {"drive": "pd"},
    )


def _commands(layout, names):
    """Return the columns of commands by their channels, in words."""
    found = {}
    for kind in COMMANDS:
        for own in _matched(layout, kind, names) or ():
            columns = [role.column for (role, *_) in own.values()]
            if columns:
                more = f" ... {columns[-1]}" if len(columns) > 1 else ""
                found[kind] = f"{columns[0]}{more}"
    return found if "q_desired" in found else {}


def refuse_two(table, one, other):
    """Refuse two columns that could both be meant."""
    if one != other:
        raise ValueError(
            f"{table.path}: columns {one!r} and {other!r} could both be meant; rename "
            "or remove the one that is not."
        )


# -- what would be taken, by the words of names ----------------------------------------

# Words in names, and how well they say what a column is.
_WORDS = {
    "q": {"q": 3, "position": 3, "positions": 3, "pos": 3, "angle": 3, "angles": 3}
    | {"theta": 2, "phi": 2, "joint": 1, "joints": 1, "actual": 1}
    | {"measured": 1, "meas": 1, "act": 1, "state": 1, "encoder": 1, "axis": 1},
    "tau": {"tau": 3, "torque": 3, "torques": 3, "effort": 3, "efforts": 3, "trq": 3}
    | {"moment": 2, "moments": 2, "current": 2, "currents": 2}
    | {"amp": 2, "amps": 2, "ampere": 2, "amperes": 2, "i": 2, "curr": 2}
    | {"load": 2, "force": 2, "actual": 1, "measured": 1, "m": 1}
    | {"meas": 1, "act": 1, "motor": 1, "mom": 2},
}
# Words of what is asked for, or of something else.
_OTHER = {"target", "cmd", "command", "commanded", "desired", "des", "ref", "goal"}
_OTHER |= {"reference", "setpoint", "sp", "error", "err", "tcp", "cartesian", "ext"}
_OTHER |= {"velocity", "vel", "speed", "qd", "dq", "acc", "acceleration", "d", "ff"}
_OTHER |= {"temperature", "temp", "voltage", "stamp", "external", "soll", "window"}
_OTHER |= {"enable", "enabled", "limit", "limits", "mode"}
# Words of what is asked for, and of what they do not ask a position.
_COMMAND = {"target", "cmd", "command", "commanded", "desired", "des", "ref", "goal"}
_COMMAND |= {"reference", "setpoint", "sp", "soll", "action"}
_WORDS["q_desired"] = _WORDS["q"] | dict.fromkeys(_COMMAND, 2)
_NO_POSITION = (_OTHER - _COMMAND) | {"tau", "torque", "effort", "current", "force"}
_NO_POSITION |= {"kp", "kd"}
# Words of a motor's current.
_CURRENT = {"current", "currents", "curr", "strom", "i"}
_CURRENT |= {"amp", "amps", "ampere", "amperes"}
# What to give where currents have no signs, as `parse_drive` reads it.
UNSIGNED = "current signed=no"
# Words of a torque, whatever it was made of.
_TORQUE = {"tau", "torque", "torques", "effort", "efforts", "trq", "moment", "force"}
# A name must have a word that says it by itself.
_ENOUGH = 2
# Positions beyond two turns, but not beyond these, are degrees and no counts.
_MANY_DEGREES = 720.0
# A clock that steps by this or more [s] is in another unit.
_SLOWEST, _FASTEST = 1.0, 2e-5
# A clock is this near to a straight line, as a share of what it rises.
_STRAIGHT = 0.02


@dataclass(frozen=True)
class _Family:
    """Columns that differ in a number or a joint's name."""

    pattern: str
    keys: tuple
    columns: tuple


def _suggestion(table: Table, joints, needed, given, *, timed, gained):
    """Return the options that would read a file, {} if they cannot be told."""
    # joints: names of the robot's joints, empty if unknown; needed: kinds without a
    # column ("q", "tau", "t"); given: mapping as far as it stands; timed: whether a
    # period is known; gained: whether gains are.
    mapping, numbered = dict(given), None
    families = _families(table, joints)
    best = _best_pair(table, families, joints, needed)
    for kind in needed:
        if kind != "t":
            if best.get(kind) is None:
                return {}
            mapping[kind] = best[kind].pattern + _unit_to_add(table, best[kind], kind)
            numbered = best[kind].keys if "{i}" in best[kind].pattern else None
    options = {}
    if "tau" in needed:
        units = {split_unit(column)[1] for column in best["tau"].columns}
        units = (units | {split_unit(mapping["tau"])[1]}) - {""}
        bases = {x.base for x in (unit_of("tau", unit) for unit in units) if x}
        if not units and is_current(best["tau"].pattern):
            bases = {"A"}
        if bases - {"N m", "N"} and not gained and len(best["tau"].keys) > 1:
            options["gains"] = "unknown"
    if "tau" in needed and is_current(best["tau"].pattern):
        values = [table.columns[column] for column in best["tau"].columns]
        if not any((own < 0).any() for own in values):
            # A drive has gains of its own.
            options = {"drive": UNSIGNED}
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


def _unit_to_add(table, family, kind):
    """Return the unit of columns that is not read from their names, " [deg]"."""
    found = _unit_before_number(family, kind)
    if found or kind != "q":
        return found
    own = [table.columns[x] for x in family.columns]
    named = [split_last_part(split_unit(x)[0], kind)[1] for x in family.columns]
    named += [split_unit(x)[1] for x in family.columns]
    most = max(float(np.abs(x).max()) for x in own)
    return " [deg]" if not any(named) and TURNS < most <= _MANY_DEGREES else ""


def _unit_before_number(family, kind):
    """Return the unit that names such as pos_deg3 have before the number, to add."""
    unit = split_last_part(family.pattern.removesuffix("{i}").rstrip("_"), kind)[1]
    # What is named like a current is one.
    own = family.pattern.endswith("{i}") and not is_current(family.pattern)
    return f" [{unit}]" if unit and own else ""


def _nearest(table: Table, kind, joints):
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
        if len(joints) == 1:
            # Of one joint nothing needs a number.
            groups.setdefault(name, {})[joints[0]] = column
    return [
        _Family(pattern, tuple(sorted(found, key=str)), tuple(found.values()))
        for pattern, found in groups.items()
        if _is_row(pattern, found, joints)
    ]


def _is_row(pattern, found, joints):
    """Whether a group counts from 0 or 1 without a hole, or has joints' names."""
    if "{joint}" in pattern or "{i}" not in pattern:
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


def is_current(name):
    """Whether a column's name says that it is a motor's current, and no torque."""
    words = set(_words(name))
    return bool(_CURRENT & words) and not _TORQUE & words


def _score(pattern, kind):
    """How well the words of a pattern say that it is of a kind."""
    words = _words(pattern)
    points = [_WORDS.get(kind, {}).get(word, 0) for word in words]
    others = _NO_POSITION if kind == "q_desired" else _OTHER
    if not points or max(points) < _ENOUGH or others & set(words):
        return 0
    if kind == "q_desired" and not _COMMAND & set(words):
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
    kinds = [kind for kind in needed if kind != "t"]
    ranked = {kind: _ranked(families, kind, joints) for kind in kinds}
    if len(kinds) == 2:
        for first in ranked[kinds[0]]:
            for second in ranked[kinds[1]]:
                if first.keys == second.keys and first.columns != second.columns:
                    return {kinds[0]: first, kinds[1]: second}
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
    if not named:
        clocks = {x: y for x, y in table.columns.items() if "time" in _words(x)}
        # What goes up by one counts rows.
        clocks = {x: y for x, y in clocks.items() if is_clock(y) and usual_step(y) != 1}
        first = next(iter(clocks.values()), None)
        if all(np.allclose(x, first, rtol=0, atol=1e-6) for x in clocks.values()):
            named = list(clocks)[:1]
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


def clock_of(table: Table):
    """Return the column that rises like time, None for none."""
    found = [x for x, values in table.columns.items() if is_clock(values)]
    # What goes up by one counts rows.
    found.sort(key=lambda x: np.median(np.diff(table.columns[x])) == 1.0)
    return found[0] if found else None


def unit_of_clock(values):
    """Return the unit in which the steps of a clock are those of a robot."""
    return unit_of_steps(usual_step(values))


def is_clock(values):
    """Whether a column rises steadily, at steps that are those of a robot."""
    if values.dtype.kind not in "iuf" or values.size < 3:
        return False
    step = np.diff(values.astype(float))
    if not ((step >= 0).all() and step.sum() > 0) or not unit_of_clock(values):
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
    fitting = [
        unit
        for unit, factor in TIME_UNITS.items()
        if _FASTEST < step * factor < _SLOWEST
    ]
    return fitting[0] if fitting else ""


def unit_is_wrong(period):
    """Whether a period [s] is none of a robot that moves."""
    return not _FASTEST < period < _SLOWEST


# -- rows and registers that are something else ----------------------------------------

# Rows of a second source are this share of all, ...
_LEAST_SHARE, _MOST_SHARE = 0.02, 0.9
# ... come in this many places and in runs no longer than this in the median.
_PLACES, _RUN = 10, 3
# Highest values of integers with a sign that were read without, and of the magnitude
# beside a bit that is the sign.
_REGISTERS = {8: "int8", 16: "int16", 32: "int32"}
_SIGN_BITS = (10, 11, 15)
# Values of either sign fill no more than this share of what a register holds.
_FILLED = 0.45


def without_second_source(table, layout, notes):
    """Leave out rows whose torques are all zero amid others while joints move."""
    columns = {
        kind: [
            table.columns[role.column]
            for name, role in layout.roles.items()
            if kind_of(name) == kind
        ]
        for kind in ("q", "tau")
    }
    if not all(columns.values()) or any(
        x.dtype.kind not in "iuf" for values in columns.values() for x in values
    ):
        return table
    empty = np.all([x == 0 for x in columns["tau"]], axis=0)
    share = empty.mean() if empty.size else 0.0
    if not _LEAST_SHARE < share < _MOST_SHARE:
        return table
    edges = np.flatnonzero(np.diff(np.r_[0, empty.astype(int), 0]))
    first, last = edges[::2], edges[1::2]
    inside = (first > 0) & (last < empty.size)
    if inside.sum() < _PLACES or np.median((last - first)[inside]) > _RUN:
        return table
    before, after = first[inside] - 1, last[inside]
    moves = np.any([x[after] != x[before] for x in columns["q"]], axis=0)
    if moves.mean() < 0.5:
        return table
    rows = np.flatnonzero(~empty)
    notes.append(
        f"{empty.sum()} row(s) ({100 * share:.0f} %) in which all torques are exactly "
        "zero while joints move are left out: a second source writes to the same log."
    )
    return replace(
        table,
        columns={name: values[rows] for name, values in table.columns.items()},
        where=lambda row: table.where(rows[row]),
    )


def refuse_codes(table, column, values):
    """Refuse integers whose sign was lost: two's complement, or a bit for the sign."""
    if not values.size or values.min() < 0 or (values != np.round(values)).any():
        return
    for bits, name in _REGISTERS.items():
        half, whole = 2.0 ** (bits - 1), 2.0**bits
        high = values[values >= half]
        low = values[values < half]
        if not (high.size and low.size and high.max() < whole):
            continue
        if max(low.max(), whole - high.min()) < 2 * _FILLED * half and _crosses(
            values, whole, half
        ):
            raise ValueError(
                f"{table.path}: the values of column {column!r} lie from 0 to "
                f"{low.max():.0f} and from {high.min():.0f} to {high.max():.0f}: "
                f"integers of {bits} bits whose sign was lost. Subtract {whole:.0f} "
                f'from those above {half - 1:.0f} (NumPy: x.astype("{name}")).'
            )
    for bit in _SIGN_BITS:
        sign = 2.0**bit
        high, low = values[values >= sign], values[values < sign]
        if not (high.size and low.size and high.max() < 2 * sign):
            continue
        if max(low.max(), high.max() - sign) < _FILLED * sign and low.max() > 0:
            raise ValueError(
                f"{table.path}: the values of column {column!r} lie from 0 to "
                f"{low.max():.0f} and from {high.min():.0f} to {high.max():.0f}: bit "
                f"{bit} is their sign. Replace those from {sign:.0f} on by "
                f"{sign:.0f} - x."
            )


def _crosses(values, whole, half):
    """Whether values step from near zero to near the end of the register."""
    step = np.abs(np.diff(values))
    return bool((step > half).any()) and values.max() > whole - half
