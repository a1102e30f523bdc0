"""The columns of a file as channels of the robot's joints, in their order; offers."""

import difflib
import functools
import itertools
import re
from dataclasses import dataclass, replace
from os import PathLike

import numpy as np

from sklearn_vbjfa.recording._drives import COMMANDS, Drive
from sklearn_vbjfa.recording._layout import (
    Layout,
    by_mapping,
    by_names,
    by_preset,
    matches,
    name_and_unit,
)
from sklearn_vbjfa.recording._presets import PRESETS
from sklearn_vbjfa.recording._table import Loss, RecordingRefused, Table, listed
from sklearn_vbjfa.recording._units import KINDS, TIME_UNITS, split_unit, unit_of

# A clock steps by this many seconds.
_FASTEST, _SLOWEST = 2e-5, 1.0
# A clock is this near to a straight line, as a share of what it rises.
_STRAIGHT = 0.02
# Words in names that are not recognised, for the offer of a refusal alone.
_CURRENT = ("current", "curr", "cur", "amp", "ampere", "i")
COMMAND_WORDS: tuple[str, ...] = ("target", "cmd", "command", "desired", "des")
COMMAND_WORDS += ("ref", "reference", "goal", "setpoint", "sp", "action")
_WORDS = {
    "q": ("q", "pos", "position", "angle", "theta", "encoder"),
    "tau": ("tau", "torque", "trq", "effort", "eff", "moment", "force", "load")
    + _CURRENT,
    "command": COMMAND_WORDS,
    "other": ("velocity", "vel", "speed", "qd", "dq", "acceleration", "acc", "error")
    + ("temperature", "temp", "voltage", "external", "ext", "limit", "cartesian", "tcp")
    + ("enable", "mode", "window", "model", "friction", "fric", "gravity", "grav")
    + ("control", "con", "feedforward", "ff"),
}
# Words of a name that is preferred to others of its kind.
_MEASURED = {"measured", "meas", "actual", "act"}
_KIND_OF = {word: kind for kind, words in _WORDS.items() for word in words}
_MOST_TRIED = 20
# The least similarity of a word to one of these, and the shortest word that has any.
_SIMILAR, _LONG = 0.85, 4
# What to give where currents have no signs, as `parse_drive` reads it.
UNSIGNED = "current signed=no"


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
        """Joints of the description that can move, empty without one."""
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
            own = np.atleast_1d(table.scalars["joint_names"])
            names = _distinct([str(x) for x in own])
        if self.urdf is None:
            return Robot(names=names, chosen=bool(names))
        from sklearn_vbjfa.model import (
            is_prismatic,
            joint_names,
            load_model,
            load_reduced,
        )

        model = load_reduced(self.urdf, names) if names else load_model(self.urdf)
        in_model = joint_names(model)
        # Columns with numbers are in the order of the file, which may name what a joint
        # carries before the joint.
        in_file = tuple(name for name in self._movable if name in in_model)
        return Robot(
            names=names or in_file,
            chosen=bool(names),
            in_model=in_model,
            slides=is_prismatic(model),
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
    """Assign columns to channels; refuse what does not fit, with an offer."""
    try:
        return _laid_out(table, options, robot)
    except RecordingRefused as error:
        if error.options or not (options.mapping or options.preset):
            raise
        # Without what the user says the file may be read.
        offer = _without_mapping(table, options, robot)
        raise RecordingRefused(error.reason, offer) from None


def _laid_out(table, options, robot):
    preset, names = options.preset, (*robot.names, *table.joints)
    if preset is not None and options.mapping:
        raise RecordingRefused(
            "give columns or a preset, not both: a preset is a mapping.",
            {"preset": None},
        )
    kinds = dict.fromkeys((*options.kinds, *KINDS))
    plain = by_names(table, names, kinds, options.drive)
    known = plain, robot.names, options.recorded, robot.chosen
    if options.mapping:
        if options.drive is not None:
            rest = list(by_preset(table, None, *known).values())
            plain = rest[0] if len(rest) == 1 else plain
        return by_mapping(table, options.mapping, plain)
    if table.nameless:
        raise _without_names(table, robot.names)
    if table.joints:
        return replace(plain, certain=True)
    if preset is None and any(kind in plain.channels for kind in options.kinds[:2]):
        return plain
    fitted = by_preset(table, preset, *known)
    if len(fitted) > 1:
        raise RecordingRefused(
            f"{table.path}: could be {' or '.join(x.what for x in fitted.values())}; "
            f"give preset={' or '.join(repr(x) for x in fitted)}.",
            {"preset": next(iter(fitted))},
        )
    if fitted or preset is None:
        return next(iter(fitted.values()), plain)
    first = options.recorded[0]
    expected = [f"{x.q} and {x.commands.get(first, x.tau)}" for x in PRESETS[preset]]
    raise RecordingRefused(
        f"{table.path}: does not fit the preset {preset!r}, which expects columns "
        f"{' or '.join(expected)}; found {listed(table.names)}."
    )


def _without_names(table, names):
    """Return the refusal of a table without names of columns."""
    n = len(names) or 6
    ends = [f"{k}-{k + n - 1}" if n > 1 else str(k) for k in (2, 2 + n)]
    return RecordingRefused(
        f"{table.path}: has no names of columns; give the places of its "
        f"{len(table.names)} columns (command line: --columns), such as "
        f'columns="t=1,q={ends[0]},tau={ends[1]}".'
    )


def channels_of(table: Table, layout, options, robot, notes):
    """Return the roles of each kind, listed in the order of the joints, and those."""
    # Refuses, all at once, what is missing.
    robot = replace(robot, names=robot.names or layout.own_joints)
    channels, missing = _known(layout, options, robot)
    if missing:
        raise _all_missing(table, layout, options, robot, missing)
    for own in channels.values():
        _refuse_both(table, own, robot.names)
    if any(isinstance(key, str) for own in channels.values() for key in own):
        robot = _held(layout, robot, channels, notes)
    found = {kind: [] for kind in options.kinds}
    for kind, own in channels.items():
        if own:
            found[kind] = _in_order(table, kind, own, robot.names)
    return found, robot


def _known(layout, options, robot):
    """Return the channels of the robot's joints, and what is missing, with "t"."""
    # Certain names of joints that the robot lacks are no channels of it.
    channels = {
        kind: {
            key: roles
            for key, roles in layout.channels[kind].items()
            if isinstance(key, int) or key in robot.names
        }
        for kind in options.kinds
        if kind in layout.channels
    }
    missing = [kind for kind in options.kinds[:2] if not channels.get(kind)]
    return channels, missing + ["t"] * (not (options.dt or layout.times))


def _held(layout, robot, channels, notes):
    """Leave out the robot's joints without any column, unless the user chose them."""
    others = [x for x in layout.own_joints if x not in robot.names]
    if others:
        notes.append(
            f"joint(s) {listed(others)} are not joints of the robot and are left out."
        )
    having = {key for own in channels.values() for key in own}
    held = [x for x in robot.names if x not in having]
    if robot.chosen or not held:
        return robot
    notes.append(Loss(f"no columns of joint(s) {listed(held)}: held at zero."))
    return replace(robot, names=tuple(x for x in robot.names if x in having))


def _refuse_both(table, channel, names):
    """Refuse several columns for one joint, or numbers and names."""
    for roles in channel.values():
        for other in roles[1:]:
            refuse_two(table, roles[0].column, other.column)
    named = [key for key in channel if isinstance(key, str)]
    numbers = [key for key in channel if isinstance(key, int)]
    if named and numbers:
        number = names.index(named[0]) + 1
        other = channel.get(number, channel[numbers[0]])[0]
        refuse_two(table, channel[named[0]][0].column, other.column)


def _in_order(table: Table, kind, found, names):
    """Return the roles of one kind in the order of the joints."""
    named = any(isinstance(key, str) for key in found)
    first = 0 if 0 in found else 1
    keys = names if named else range(first, first + len(found))
    missing = [key for key in keys if key not in found]
    if missing:
        others = listed([role.column for (role, *_) in found.values()])
        name = f"{kind}_{missing[0]}" if named else f"{kind}{missing[0]}"
        raise ValueError(
            f"{table.path}: column {name!r} is missing beside {others}; every joint "
            "needs one, in order."
        )
    return [found[key][0] for key in keys]


def refuse_two(table, one, other):
    """Refuse two columns that could both be meant."""
    if one != other:
        raise ValueError(
            f"{table.path}: columns {one!r} and {other!r} could both be meant; rename "
            "or remove the one that is not."
        )


# -- what is missing, and options that were tried --------------------------------------

# What is missing, by the kinds that may be needed.
_WHAT = {"q": "positions", "tau": "torques", "q_desired": "desired positions"}


def _all_missing(table, layout, options, robot, missing):
    """Return the refusal that lists everything that is missing."""
    near = {kind: _nearest(table, kind, robot.names) for kind in missing}
    kinds = [kind for kind in missing if kind != "t"]
    if kinds == ["tau"] and options.drive is None and not near["tau"]:
        _refuse_commands(table, layout, options, robot)
    known = by_preset(table, options.preset, layout, (), options.recorded)
    own = next(iter(known.values()), layout)
    parts = []
    if kinds and own.own_joints and own.own_joints != robot.names:
        parts.append(
            f"its joints {listed(own.own_joints)} are not those of the robot, "
            f"{listed(robot.names)}"
        )
    nearest = {k: f" (nearest: {listed(x)})" if x else "" for k, x in near.items()}
    for kind in kinds:
        what = f"no {_WHAT.get(kind, kind)}: expected columns {kind}1, {kind}2, ..."
        parts.append(what + nearest[kind])
    if "t" in missing:
        parts.append(
            f"no column t and no dt{nearest['t']}; add time stamps [s] as column t, or "
            "give the sample period dt in seconds (command line: --dt 0.002)"
        )
    offered = _offered(table, options, robot, near) or _by_place(
        table, own, options, robot
    )
    if kinds:
        parts.append(f"found {listed(table.names)}")
    if kinds and not offered:
        parts.append(
            "rename them in the header, or give "
            f'columns="q=NAME{{i}},{options.kinds[1]}=NAME{{i}},t=NAME"'
        )
    return RecordingRefused(f"{table.path}: {'; '.join(parts)}.", offered)


def _works(table, options, robot):
    """Whether columns are found for all that is needed, with some options."""
    if any("," in x or "=" in x for x in options.mapping.values()):
        return False
    try:
        layout = _laid_out(table, options, robot)
        known = replace(robot, names=robot.names or layout.own_joints)
        if _known(layout, options, known)[1]:
            return False
        found, own = channels_of(table, layout, options, robot, [])
    except ValueError:
        return False
    counts = {len(found[kind]) for kind in options.kinds[:2]}
    return len(counts) == 1 and counts <= {len(own.names) or max(counts)}


def _text_of(mapping):
    return ",".join(f"{key}={pattern}" for key, pattern in mapping.items())


def _offered(table, options, robot, near):
    """Return options that read the file, tried, by the nearest columns; or {}."""
    # near: the nearest patterns by kind; of several nobody knows which is meant.
    products = itertools.islice(itertools.product(*near.values()), _MOST_TRIED)
    found = [options.mapping | dict(zip(near, patterns)) for patterns in products]
    tried = (replace(options, mapping=mapping, preset=None) for mapping in found)
    found = [x.mapping for x in tried if _works(table, x, robot)]
    if len(found) != 1:
        return {}
    (mapping,), more = found, {}
    if "t" in near and not split_unit(mapping["t"])[1]:
        unit = unit_of_steps(usual_step(table.values(mapping["t"]).astype(float)))
        more = {} if unit in ("", "s") else {"time_unit": unit}
    if "tau" in near and options.gains is None:
        more |= _of_currents(table, mapping["tau"])
    return {"columns": _text_of(mapping), **more}


def _by_place(table, layout, options, robot):
    """Return the mapping of a known log whose joints have other names, tried, or {}."""
    mapping = {
        f"{kind}{j + 1}": role.column
        for kind in options.kinds[:2]
        for j, role in enumerate(layout.roles(kind))
    }
    if layout.times:
        mapping["t"] = layout.times[0].column
    tried = replace(options, mapping=mapping, preset=None)
    works = layout.own_joints and _works(table, tried, robot)
    return {"columns": _text_of(mapping)} if works else {}


def _without_mapping(table, options, robot):
    """Return options that read a file without the mapping or preset given, or {}."""
    free = replace(options, mapping={}, preset=None)
    nothing = {"columns": None} if options.mapping else {"preset": None}
    try:
        channels_of(table, laid_out(table, free, robot), free, robot, [])
    except RecordingRefused as error:
        return nothing | error.options if error.options else {}
    except ValueError:
        return {}
    return nothing


def _of_currents(table, pattern):
    """Return the options that currents need: gains, or a drive without their signs."""
    found = matches(pattern, table, "tau")
    bases = {unit.base for x in found if (unit := unit_of("tau", x.unit))}
    if not bases and is_current(pattern):
        bases = {"A"}
        if not any((table.values(x.column) < 0).any() for x in found):
            return {"drive": UNSIGNED}
    motor = bases - {"N m", "N"} and len(found) > 1
    return {"gains": "unknown"} if motor else {}


def _refuse_commands(table, layout, options, robot):
    """Refuse a file that has commands in place of torques: a drive is missing."""
    own = by_names(table, robot.names, (*KINDS, *COMMANDS))
    known = by_preset(table, None, layout, robot.names, COMMANDS)
    having = [x for x in (own, *known.values()) if "q_desired" in x.channels]
    found, offered = {}, {}
    for kind in COMMANDS if having else ():
        columns = [role.column for role in having[0].roles(kind)]
        if columns:
            more = f" ... {columns[-1]}" if len(columns) > 1 else ""
            found[kind] = f"{columns[0]}{more}"
    if not found:
        near = _nearest(table, "q_desired", robot.names)
        if not near:
            return
        found = {"q_desired": near[0]}
        offered = {"columns": f"q_desired={near[0]}"}
    gains = [x for x in ("kp", "kd") if x not in found and x not in table.scalars]
    drive = " ".join(["pd", *(f"{kind}=..." for kind in gains)])
    more = "".join(f", {key}={value!r}" for key, value in offered.items())
    needs = f" with {' and '.join(gains)}, a number for each joint" if gains else ""
    raise RecordingRefused(
        f"{table.path}: no torques, but commands: "
        f"{', '.join(f'{kind} ({columns})' for kind, columns in found.items())}; give "
        f'the drive that follows them{needs}: drive="{drive}"{more} (command line: '
        f'--drive "{drive}")',
        {} if gains or offered else {"drive": "pd"},
    )


# -- the nearest names -----------------------------------------------------------------


def words(pattern):
    """Return the words in a pattern, in small letters."""
    text = re.sub(r"\{\w+\}", " ", split_unit(pattern)[0])
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    return [x.lower() for x in re.findall(r"[^\W\d_]+", text)]


def _kinds_of_words(pattern):
    """Return the kinds that the words of a pattern are nearest to, a set."""
    found = set()
    for word in words(pattern):
        near = [word] if word in _KIND_OF else []
        if not near and len(word) >= _LONG:
            near = difflib.get_close_matches(word, _KIND_OF, 1, _SIMILAR)
        found |= {_KIND_OF[x] for x in near}
    return found


def is_current(name):
    """Whether a column's name says that it is a motor's current, and no torque."""
    found = {word.rstrip("s") for word in words(name)}
    torques = set(_WORDS["tau"]) - {"load", *_CURRENT}
    return bool({*_CURRENT} & found) and not torques & found


def _nearest(table, kind, joints):
    """Return the patterns of columns nearest to a kind."""
    if kind == "t":
        return _clocks(table)
    wanted = {"q_desired": {"q", "command"}}.get(kind, {kind})
    found: dict[tuple, list] = {}
    for pattern, columns in _families(table, joints).items():
        unit = name_and_unit(table, next(iter(columns.values())))[1]
        # A unit tells the kind of what has words of another language.
        by_unit = {x for x in KINDS if unit and unit_of(x, unit)}
        if (_kinds_of_words(pattern) or by_unit) == wanted:
            others = len(columns) != (len(joints) or len(columns))
            rank = others, not _MEASURED & set(words(pattern))
            found.setdefault(rank, []).append(pattern)
    return found[min(found)] if found else []


def _families(table, joints):
    """Return columns of numbers by their names without a number or a joint."""
    groups: dict[str, dict] = {}
    for column in table.names:
        if table.frame[column].dtype.kind not in "iuf":
            continue
        name = split_unit(column)[0]
        joint = max((x for x in joints if x in name), key=len, default=None)
        if joint is not None:
            groups.setdefault(name.replace(joint, "{joint}", 1), {})[joint] = column
        # Any of its numbers may be the joint's.
        for match in re.finditer(r"\d{1,6}", name):
            pattern = f"{name[: match.start()]}{{i}}{name[match.end() :]}"
            groups.setdefault(pattern, {})[int(match[0])] = column
        if len(joints) == 1:
            # Of one joint nothing needs a number.
            groups.setdefault(name, {})[joints[0]] = column
    return {
        pattern: found
        for pattern, found in groups.items()
        if "{i}" not in pattern or _counts(found, joints)
    }


def _counts(numbers, joints):
    """Whether numbers count from 0 or 1 without a hole."""
    alone = len(numbers) > 1 or len(joints) == 1
    return alone and min(numbers) in (0, 1) and np.ptp([*numbers]) == len(numbers) - 1


# -- clocks ----------------------------------------------------------------------------


def _clocks(table):
    """Return the column whose name has to do with time and that rises like a clock."""
    # What goes up by one counts rows.
    found = [
        name
        for name in table.names
        for unit in [unit_of("t", split_unit(name)[1] or name)]
        if ({"time", "stamp", "timestamp", "clock", "t"} & set(words(name)) or unit)
        and is_clock(table.values(name))
        and usual_step(table.values(name)) != 1
    ]
    first = next((table.values(x) for x in found), None)
    same = all(np.allclose(table.values(x), first, rtol=0, atol=1e-6) for x in found)
    return found[:1] if same else []


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
    return next(
        (unit for unit, size in TIME_UNITS.items() if not unit_is_wrong(step * size)),
        "",
    )


def unit_is_wrong(period):
    """Whether a period [s] is none of a robot that moves."""
    return not _FASTEST < period < _SLOWEST
