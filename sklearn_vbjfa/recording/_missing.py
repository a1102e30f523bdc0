"""The refusal of a file that lacks channels: the nearest names, options that work."""

import itertools
import re
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._drives import UNSIGNED, PDDrive
from sklearn_vbjfa.recording._layout import (
    channels_of,
    in_order,
    laid_out,
    matches,
    name_and_unit,
)
from sklearn_vbjfa.recording._table import RecordingRefused, listed
from sklearn_vbjfa.recording._units import (
    KINDS,
    is_clock,
    is_current,
    is_measured,
    kinds_in,
    split_unit,
    unit_of,
    unit_of_steps,
    usual_step,
)

_MOST_TRIED = 20
# Channels by the kinds of words.
_KIND = {"torque": "tau", "current": "tau"}
_WHAT = {"q": "positions", "tau": "torques", "q_desired": "desired positions"}


def refusal(table, layout, options, robot, missing):
    """Return the refusal that lists everything that is missing."""
    near = {kind: _nearest(table, kind, robot.names) for kind in missing}
    nearest = {k: f" (nearest: {listed(x)})" if x else "" for k, x in near.items()}
    kinds = [kind for kind in missing if kind != "t"]
    parts = [
        f"no {_WHAT.get(kind, kind)}: expected columns {kind}1, {kind}2, ..."
        f"{nearest[kind]}"
        for kind in kinds
    ]
    if kinds and layout.joints and layout.joints != robot.names:
        joints = f"its joints {listed(layout.joints)} are not those of the robot"
        parts.insert(0, f"{joints}, {listed(robot.names)}")
    if "t" in missing:
        parts.append(
            f"no column t and no dt{nearest['t']}; add time stamps [s] as column t, or "
            "give the sample period dt in seconds (command line: --dt 0.002)"
        )
    offered = _offered(table, options, robot, near)
    if kinds == ["tau"] and not near["tau"]:
        parts.append(
            "if the motors follow commands, give the drive, drive=... (command line: "
            '--drive "pd kp=... kd=...")'
        )
        driven = laid_out(table, replace(options, drive=PDDrive()), robot)
        if driven.kinds | {*table.scalars} >= {"q_desired", "kp", "kd"}:
            offered = {"drive": "pd"}
    if kinds:
        parts.append(f"found {listed(table.names)}")
    if kinds and not offered:
        parts.append(
            "rename them in the header, or give "
            f'columns="q=NAME{{i}},{options.kinds[1]}=NAME{{i}},t=NAME"'
        )
    return RecordingRefused(f"{table.path}: {'; '.join(parts)}.", offered)


def _offered(table, options, robot, near):
    """Return options that read the file, tried, by the nearest columns; or {}."""
    # near: the nearest patterns by kind; of several nobody knows which is meant.
    products = itertools.islice(itertools.product(*near.values()), _MOST_TRIED)
    found = [options.mapping | dict(zip(near, patterns)) for patterns in products]
    found = [
        mapping
        for mapping in found
        if _works(table, replace(options, mapping=mapping, preset=None), robot)
    ]
    if len(found) != 1:
        return {}
    (mapping,) = found
    offered = {"columns": ",".join(f"{key}={x}" for key, x in mapping.items())}
    columns = matches(mapping["q"], table, "q") if "q" in mapping else []
    numbered = columns and all(isinstance(x.key, int) for x in columns)
    if numbered and len(columns) < len(robot.names) and not robot.chosen:
        offered["joint_names"] = robot.names[: len(columns)]
    if "t" in near and not split_unit(mapping["t"])[1]:
        unit = unit_of_steps(usual_step(table.values(mapping["t"]).astype(float)))
        offered |= {} if unit in ("", "s") else {"time_unit": unit}
    if "tau" in near and options.gains is None:
        offered |= _gains_for(table, mapping["tau"])
    return offered


def _gains_for(table, pattern):
    """Return the option that takes columns of currents or the like, {} for torques."""
    columns = matches(pattern, table, "tau")
    bases = {unit.base for x in columns if (unit := unit_of("tau", x.unit))}
    if not bases and is_current(pattern):
        signed = any((table.values(x.column) < 0).any() for x in columns)
        return {"gains": "unknown"} if signed else {"drive": UNSIGNED}
    return {"gains": "unknown"} if bases - {"N m", "N"} else {}


def _works(table, options, robot):
    """Return whether columns are found for all that is needed, with some options."""
    if any("," in x or "=" in x for x in options.mapping.values()):
        return False
    try:
        layout = laid_out(table, options, robot)
        if channels_of(layout, options, robot)[1]:
            return False
        found, robot = in_order(table, layout, options, robot, [])
    except ValueError:
        return False
    counts = {len(found[kind]) for kind in options.kinds[:2]}
    return len(counts) == 1 and max(counts) <= (len(robot.names) or max(counts))


# -- the nearest names -----------------------------------------------------------------


def _nearest(table, kind, joints):
    """Return the patterns of columns nearest to a kind."""
    if kind == "t":
        return _clocks(table)
    wanted = {"q_desired": {"q", "command"}}.get(kind, {kind})
    found: dict[tuple, list] = {}
    for pattern, columns in _families(table, joints).items():
        kinds = {_KIND.get(x, x) for x in kinds_in(pattern)}
        # A unit tells the kind of what has words of another language.
        unit = name_and_unit(table, next(iter(columns.values())))[1]
        if (kinds or {x for x in KINDS if unit and unit_of(x, unit)}) == wanted:
            others = len(columns) != (len(joints) or len(columns))
            rank = others, not is_measured(pattern)
            found.setdefault(rank, []).append(pattern)
    return found[min(found)] if found else []


def _families(table, joints):
    """Return columns of numbers by their names without a number or a joint."""
    groups: dict[str, dict] = {}
    for column in table.frame.select_dtypes("number"):
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
    """Return whether numbers count from 0 or 1 without a hole."""
    alone = len(numbers) > 1 or len(joints) == 1
    return alone and min(numbers) in (0, 1) and np.ptp([*numbers]) == len(numbers) - 1


def _clocks(table):
    """Return the column whose name has to do with time and that rises like a clock."""
    # A column that goes up by one counts rows.
    found = [
        name
        for name in table.names
        if ("t" in kinds_in(name) or unit_of("t", split_unit(name)[1] or name))
        and is_clock(table.values(name))
        and usual_step(table.values(name)) != 1
    ]
    first = next((table.values(x) for x in found), None)
    same = all(np.allclose(table.values(x), first, rtol=0, atol=1e-6) for x in found)
    return found[:1] if same else []
