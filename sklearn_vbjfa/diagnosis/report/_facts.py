"""Groups and table rows of an outcome, for the page and the terminal."""

import math

import numpy as np

from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.effects import OfRobot

# Factor from a SI unit to the unit of display.
_DISPLAY = {"rad": (180.0 / math.pi, "degrees"), "m": (1e3, "mm")}
# Smallest ratio of two masses that agree.
_MASS_RATIO = 0.5
# Speeds below this share of the fastest occur at reversals; a limit below this share of
# the other one is written as zero.
_SLOW, _ZERO = 0.1, 1e-3
_UNITS = {"position": ("rad", "m"), "speed": ("rad/s", "m/s"), "load": ("N m", "N")}
# Recommended duration of a motion [s], and its slowest speed over the fastest.
SECONDS, _SLOWEST = 60, 0.1
# Most joints in a table of the terminal; of more, so many of the worst and of the best.
_ROWS, _FIRST, _LAST = 8, 3, 2


def grouped(items, key):
    """Group items by a key, a list of (key, items) in order."""
    groups = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return list(groups.items())


def value_cells(effect):
    """Format the parameters of an effect of the robot model, a list."""
    # In degrees, mm, and per cent by which a gain is too high or too low.
    texts = []
    for name, value in effect.parameters.items():
        ends = effect.intervals.get(name)
        if name == "gain":
            sign = 1.0 if value >= 1.0 else -1.0
            excess = [100 * sign * (float(x) - 1.0) for x in (value, *(ends or ()))]
            size = words.with_error(excess[0], tuple(sorted(excess[1:])) or None, "%")
            texts.append(f"{size} too {'much' if sign > 0 else 'little'}")
        elif effect.units.get(name) in _DISPLAY:
            scale, unit = _DISPLAY[effect.units[name]]
            ends = ends and tuple(scale * float(end) for end in ends)
            text = words.with_error(scale * float(value), ends, unit)
            texts.append(f"{name.replace('_', ' ')} {text}")
    return texts


def remedies(outcome, status):
    """Return corrections of the robot model, (name, joint) -> correction."""
    # Declared corrections are included; insignificant ones, those that lower no error,
    # those that may belong to another joint, and those of a faulty log are not.
    fell = np.nansum(outcome.column("before") - outcome.column("after")) > 0
    doubtful = {
        (x.name, x.joint)
        for x in outcome.findings["possible"] + outcome.findings["effects"]
        if x.warning or not fell or any(y["name"] == x.name for y in x.trials)
    }
    corrections = {}
    for e in () if status == "faulty" else outcome.robot["corrections"]:
        prefix = f"{outcome.robot['joints'][e.joint]}:{e.name}:", f"{e.name}:"
        values = [x for x in outcome.facts_of("parameter") if x.name.startswith(prefix)]
        # Significant if its interval excludes the nominal value: 1 for gains, else 0.
        excluded = [
            not x.interval[0] <= x.name.endswith(":gain") <= x.interval[1]
            for x in values
        ]
        if (e.name, e.joint) not in doubtful and (any(excluded) or not excluded):
            corrections[e.name, e.joint] = e
    return corrections


def range_text(outcome, joint, quantity, pair):
    """Format a range with its unit, "-1.2 to 1.3 rad"."""
    unit = _UNITS[quantity][int(outcome.errors[joint].position_unit == "m")]
    width = max(map(abs, pair))
    low, high = (words.number(0.0 if abs(x) < _ZERO * width else x) for x in pair)
    if quantity == "speed" and pair[0] < _SLOW * pair[1]:
        return f"up to {high} {unit}"
    return f"{low} to {high} {unit}"


def motion_plan(outcome, joints):
    """Return table rows of a motion: joint, range, speeds and duration."""
    limits, motion = outcome.robot.get("limits"), outcome.robot["motion"]
    rows = []
    for j in sorted(set(joints)) if motion and limits is not None else ():
        recorded, (*ends, fastest) = motion[j], limits[j]
        if not np.isfinite(ends).all():
            ends = recorded.lowest, recorded.highest
        fastest = fastest if math.isfinite(fastest) else recorded.fastest
        ranges = {"position": ends, "speed": (_SLOWEST * fastest, fastest)}
        texts = (range_text(outcome, j, *pair) for pair in ranges.items())
        label = words.joint_label(outcome.robot["joints"], j)
        rows.append((label, *texts, f"{SECONDS} s"))
    return rows


def unexplained_groups(outcome):
    """Group unexplained residuals, those that depend on signals by joint."""
    order = sorted(
        outcome.findings["unexplained"], key=lambda u: (not u.floor > 0, -u.of_torque)
    )
    groups = grouped(order, lambda u: (u.floor > 0, u.joint if u.signals else None))
    return [group for _, group in groups]


def to_record(outcome, status, signal_advice, no_period):
    """Return what to record next, most important first, a dict advice -> joints."""
    findings, wanted, library = outcome.findings, {}, outcome.robot["library"]
    if status == "faulty" or not outcome.searched or findings["contradictions"]:
        return {}  # no open questions that another motion would answer

    def add(advice, joint, name=None):
        joints = wanted.setdefault(advice, []) if advice else []
        if name is None or not isinstance(library[name], OfRobot):
            joints.append(joint)

    if findings["repeated"]:
        wanted[no_period] = []
    for residual in findings["unexplained"]:
        for name in [x.signal.split(" of ")[0] for x in residual.signals] or [""]:
            add(signal_advice.get(name, ""), residual.joint)
    for effect in findings["effects"]:
        rivals = [rival["name"] for rival in effect.trials]
        for name in (effect.name, *rivals) if rivals else ():
            add(library[name].record, effect.joint, effect.name)
    for hidden in findings["not_identifiable"]:
        if hidden.reason == "excitation":
            add(library[hidden.name].record, hidden.joint, hidden.name)
    return wanted


def agrees(mass, nominal, least=_MASS_RATIO):
    return min(mass, nominal) >= least * max(mass, nominal)


def error_rows(outcome, left_out=()):
    """Return the table cells of the errors of each joint, largest error first."""
    percent, rows = words.bare_percent, []
    left_out = [*left_out, *([] if outcome.robot["added"] else ["four terms"])]
    for joint in sorted(outcome.errors, key=lambda x: -np.nan_to_num(x.after, nan=-1)):
        ends = joint.intervals["after"]
        finite = np.isfinite(ends).all()
        interval = f" [{percent(ends[0])}, {percent(ends[1])}]" if finite else ""
        cells = {
            "before": percent(joint.before),
            "four terms": percent(joint.plain),
            "after [90 %]": f"{percent(joint.after)}{interval}",
            # Adding zero removes the sign of a negative zero.
            "reduction": percent(np.round(joint.before - joint.after, 3) + 0.0),
            "size": words.number(joint.after * joint.spread, 2),
            "noise": percent(joint.floor),
        }
        cells = {key: text for key, text in cells.items() if key not in left_out}
        rows.append({"joint": joint.joint, "cells": cells})
    return rows


def short_errors(outcome, verdicts):
    """Return heads and rows of the errors for a terminal; many rows are elided."""
    # A line has room for the error in N m or for a third relative error.
    left_out = ["reduction", *(["size"] if outcome.robot["added"] else [])]
    if not np.isfinite(outcome.column("floor")).any():
        left_out.append("noise")
    heads, rows = [], []
    for row in error_rows(outcome, left_out):
        cells, verdict = row["cells"], verdicts[row["joint"]]
        heads = ["error, %", *cells, ""]
        rows.append([verdict.label, *cells.values(), verdict.text])
    units = "/".join(dict.fromkeys(joint.unit for joint in outcome.errors))
    heads = [units if head == "size" else head for head in heads]
    if len(rows) > _ROWS:
        more = f"{len(rows) - _FIRST - _LAST} more (page)"
        middle = [more, *[""] * (len(heads) - 1)]
        rows = [*rows[:_FIRST], middle, *rows[-_LAST:]]
    return heads, rows


def longest_error(outcome):
    """Return the scale of the error bars, 1 if no error is known."""
    sizes = [outcome.column(name) for name in ("before", "after", "floor")]
    sizes = np.concatenate([*sizes, *(x.intervals["after"] for x in outcome.errors)])
    return float(np.max(sizes, where=np.isfinite(sizes), initial=0.0)) or 1.0
