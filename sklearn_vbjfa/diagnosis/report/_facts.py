"""Groups and rows of an outcome, as the page and the terminal show them."""

import math

import numpy as np

from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.effects import OfRobot
from sklearn_vbjfa.robot._channels import HALF_WIDTH

# One of a SI unit in the unit that is read off an instrument.
_FINE = {"rad": (180.0 / math.pi, "degrees"), "m": (1e3, "mm")}
# Masses of which one is less than this share of the other do not agree.
_OTHER_MASS = 0.5
# A speed below this share of the fastest is that of a reversal; an end that is this
# small a share of the other is zero.
_SLOW, _ZERO = 0.1, 1e-3
_UNITS = {"position": ("rad", "m"), "speed": ("rad/s", "m/s"), "load": ("N m", "N")}
# Time that decides most questions [s], and the slowest of its speeds over the fastest.
SECONDS, _SLOWEST = 60, 0.1
# Joints that a terminal has room for; of more, so many of the worst and of the best.
_ROWS, _FIRST, _LAST = 8, 3, 2


def grouped(items, key):
    """Group items by a key, a list of (key, items) in order."""
    found = {}
    for one in items:
        found.setdefault(key(one), []).append(one)
    return list(found.items())


# -- effects of the robot model --------------------------------------------------------


def value_cells(effect):
    """Write each parameter of an effect in the model in its plain unit, a list."""
    # In degrees, mm, and per cent that a gain is too much or too little.
    found = []
    for name, value in effect.parameters.items():
        ends = effect.intervals.get(name)
        if name == "gain":
            sign = 1.0 if value >= 1.0 else -1.0
            excess = [100 * sign * (float(x) - 1.0) for x in (value, *(ends or ()))]
            size = words.with_error(excess[0], tuple(sorted(excess[1:])) or None, "%")
            found.append(f"{size} too {'much' if sign > 0 else 'little'}")
        elif effect.units.get(name) in _FINE:
            scale, unit = _FINE[effect.units[name]]
            ends = ends and tuple(scale * float(end) for end in ends)
            text = words.with_error(scale * float(value), ends, unit)
            found.append(f"{name.replace('_', ' ')} {text}")
    return found


def remedies(outcome):
    """Return corrections of the robot model, (name, joint) -> correction."""
    # Those that were declared are among them; insignificant ones are not.
    possible = {(one.name, one.joint) for one in outcome.findings["possible"]}
    found = {}
    for one in outcome.robot["corrections"]:
        begins = f"{outcome.robot['joints'][one.joint]}:{one.name}:", f"{one.name}:"
        values = [x for x in outcome.facts_of("parameter") if x.name.startswith(begins)]
        # Whether no value may be that of no fault, one of a gain and else zero.
        beyond = [
            not x.interval[0] <= x.name.endswith(":gain") <= x.interval[1]
            for x in values
        ]
        if (one.name, one.joint) not in possible and (any(beyond) or not beyond):
            found[one.name, one.joint] = one
    return found


# -- ranges ----------------------------------------------------------------------------


def range_text(outcome, joint, quantity, pair):
    """Write a range with its unit, "-1.2 to 1.3 rad"."""
    unit = _UNITS[quantity][int(outcome.errors[joint].unit == "N")]
    width = max(map(abs, pair))
    low, high = (words.number(0.0 if abs(x) < _ZERO * width else x) for x in pair)
    if quantity == "speed" and pair[0] < _SLOW * pair[1]:
        return f"up to {high} {unit}"
    return f"{low} to {high} {unit}"


def motion_plan(outcome, joints):
    """Rows of joints that are to move: range, speeds and seconds."""
    limits, motion = outcome.robot.get("limits"), outcome.robot["motion"]
    rows = []
    for j in sorted(set(joints)) if motion and limits is not None else ():
        one, (low, high, fastest) = motion[j], limits[j]
        ends = low, high
        if not np.isfinite(ends).all():
            ends = one.lowest, one.highest
        fastest = fastest if math.isfinite(fastest) else one.fastest
        rows.append(
            (
                words.joint_label(outcome.robot["joints"], j),
                range_text(outcome, j, "position", ends),
                range_text(outcome, j, "speed", (_SLOWEST * fastest, fastest)),
                f"{SECONDS} s",
            )
        )
    return rows


# -- findings --------------------------------------------------------------------------


def unexplained_groups(outcome):
    """Group residuals above the floor, those with signals joint by joint."""
    order = sorted(
        outcome.findings["unexplained"], key=lambda u: (not u.floor > 0, -u.of_torque)
    )
    groups = grouped(order, lambda u: (u.floor > 0, u.joint if u.signals else None))
    return [own for _, own in groups]


def to_record(outcome, status, signal_advice, no_period):
    """Return what to record next, the most important first, advice -> joints."""
    findings, wanted = outcome.findings, {}
    library = outcome.robot["library"]
    if status == "faulty" or not outcome.searched or findings["contradictions"]:
        return {}  # what no search looked for needs no other motion

    def add(advice, joint, name=None):
        joints = wanted.setdefault(advice, []) if advice else []
        if name is None or not isinstance(library[name], OfRobot):
            joints.append(joint)

    if findings["repeated"]:
        wanted[no_period] = []
    for rest in findings["unexplained"]:
        for name in [one.signal.split(" of ")[0] for one in rest.signals] or [""]:
            add(signal_advice.get(name, ""), rest.joint)
    for effect in findings["effects"]:
        rivals = [one["name"] for one in effect.trials]
        for name in (effect.name, *rivals) if rivals else ():
            add(library[name].record, effect.joint, effect.name)
    for one in findings["not_identifiable"]:
        if one.reason == "excitation":
            add(library[one.name].record, one.joint, one.name)
    return wanted


# -- masses and parameters -------------------------------------------------------------


def agrees(mass, nominal, least=_OTHER_MASS):
    """Whether a mass may pass for that of the robot description."""
    return min(mass, nominal) >= least * max(mass, nominal)


def with_half(value, std):
    """Write a value with half its 90 % interval."""
    return words.with_error(value, (value - HALF_WIDTH * std, value + HALF_WIDTH * std))


# -- errors ----------------------------------------------------------------------------


def error_rows(outcome, left_out=()):
    """Cells of the errors of each joint, the largest error first, a list of dict."""
    percent, rows = words.bare_percent, []
    left_out = [*left_out, *([] if outcome.robot["added"] else ["four terms"])]
    for one in sorted(outcome.errors, key=lambda x: -np.nan_to_num(x.after, nan=-1)):
        ends = one.intervals["after"]
        known = np.isfinite(ends).all()
        reach = f" [{percent(ends[0])}, {percent(ends[1])}]" if known else ""
        cells = {
            "before": percent(one.before),
            "four terms": percent(one.plain),
            "after [90 %]": f"{percent(one.after)}{reach}",
            # Without the sign of a zero.
            "reduction": percent(np.round(one.before - one.after, 3) + 0.0),
            "size": words.number(one.after * one.spread, 2),
            "noise": percent(one.floor),
        }
        cells = {key: text for key, text in cells.items() if key not in left_out}
        rows.append({"joint": one.joint, "cells": cells})
    return rows


def short_errors(outcome, verdicts):
    """Heads and rows of the errors for a terminal, without the middle of many."""
    # A line has room for the size in N m, or for a third error.
    left_out = ["reduction", *(["size"] if outcome.robot["added"] else [])]
    if not np.isfinite(outcome.column("floor")).any():
        left_out.append("noise")
    heads, rows = [], []
    for row in error_rows(outcome, left_out):
        cells, verdict = row["cells"], verdicts[row["joint"]]
        heads = ["error, %", *cells, ""]
        rows.append([verdict.label, *cells.values(), verdict.text])
    units = "/".join(dict.fromkeys(one.unit for one in outcome.errors))
    heads = [units if head == "size" else head for head in heads]
    if len(rows) > _ROWS:
        more = f"{len(rows) - _FIRST - _LAST} more (page)"
        middle = [more, *[""] * (len(heads) - 1)]
        rows = [*rows[:_FIRST], middle, *rows[-_LAST:]]
    return heads, rows


def longest_error(outcome):
    """Return the scale of the bars of the errors, one if there is none."""
    sizes = [outcome.column(name) for name in ("before", "after", "floor")]
    sizes = np.concatenate([*sizes, *(x.intervals["after"] for x in outcome.errors)])
    return float(np.max(sizes, where=np.isfinite(sizes), initial=0.0)) or 1.0
