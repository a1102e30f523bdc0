"""A designed motion in words, for a terminal."""

import textwrap
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.design._design import MARGIN, ROOM, SAME_COLUMNS
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.effects import resolve

# Characters of a line.
_WIDTH = 88
# Margins and what tables call them.
_QUANTITIES = {
    "position": "range",
    "velocity": "speed",
    "acceleration": "acceleration",
    "torque": "torque",
}


def summary(motion, robot, measured, found=None):
    """Say what a motion is, which limits it uses, and what it decides, lines of str."""
    # measured (nv,): joints of which the torque noise was measured; found: the report
    # that the motion was designed for, as a dict.
    decided, open_pairs = _pairs(motion)
    if decided:
        texts = ["Effects that it distinguishes if they exceed these torques", *decided]
    else:
        texts = _shown(motion)
    texts += [f"{words.capital(one)}." for one in open_pairs]
    texts += _never(motion, found or {})
    if not measured.all():
        texts.append(
            "The noise was not measured: torques of effects assume 1 % of the torque "
            "limits."
        )
    apart = _unchecked(motion)
    if not apart:
        nearest = words.number(1e3 * motion.margins["clearance"])
        apart = (
            f"Bodies stay {nearest} mm apart (at least {1e3 * ROOM:g} mm are kept); "
            "the surroundings of the robot are unknown."
        )
    return [
        f"Motion of {robot}: {words.plural(len(motion.joint_names), 'joint')}, "
        f"{motion.duration:g} s at {1 / motion.dt:.4g} Hz",
        f"condition number {words.number(motion.condition_number)}, before the "
        f"optimisation {words.number(motion.start_condition_number)} (columns of unit "
        "size at random states)",
        "",
        *_shares(motion),
        *wrapped(apart, ""),
        "",
        *(line for text in texts for line in wrapped(text)),
    ]


def doubts(motion, effects=()):
    """List what a motion leaves open: clearance, rivals, effects that were named."""
    unchecked = _unchecked(motion)
    found = [unchecked] * bool(unchecked) + _pairs(motion)[1]
    for one in motion.invisible:
        if one.name in effects:
            joint = words.joint_label(motion.joint_names, one.joint)
            found.append(
                f"{_label(one.name)} on {joint} is not identifiable by any motion "
                f"({one.reason})"
            )
    return found


def _unchecked(motion):
    """Warn that links may meet; empty where their distances are kept."""
    if "clearance" in motion.margins:
        return ""
    return f"SELF-COLLISION WAS NOT CHECKED. {motion.no_clearance.rstrip('.')}."


def wrapped(text, indent="  "):
    """Break a text into lines of a terminal, the further ones indented."""
    return textwrap.wrap(text, _WIDTH, subsequent_indent=indent, break_on_hyphens=False)


def before(motion):
    """Say what to do before a motion that may make the robot hit itself."""
    if "clearance" in motion.margins:
        return []
    most = max(float(np.max(1.0 - motion.margins[name])) for name in _QUANTITIES)
    return [
        "BEFORE IT RUNS: the robot may hit itself, at up to "
        f"{words.whole_percent(most)} of its limits. Watch all of the motion in a "
        "simulator, then run it slowly with a hand on the emergency stop."
    ]


def exceeded(motion):
    """Name the limit that a motion comes nearest to, and how near bodies come."""
    worst = min(_QUANTITIES, key=lambda name: motion.margins[name].min())
    j = int(np.argmin(motion.margins[worst]))
    margin = words.percent(float(motion.margins[worst][j]))
    label = words.joint_label(motion.joint_names, j)
    text = (
        f"{_QUANTITIES[worst]} of {label} leaves {margin} of its limit (at least "
        f"{MARGIN:.0%} are kept)"
    )
    if "clearance" in motion.margins:
        text += f", bodies are {1e3 * motion.margins['clearance']:.3g} mm apart"
    return text


def _shares(motion):
    """Tabulate the shares of the limits that each joint uses."""
    from tabulate import tabulate

    rows = []
    for j in range(len(motion.joint_names)):
        shares = [
            words.whole_percent(1.0 - motion.margins[name][j])
            if np.isfinite(getattr(motion.limits, name)[j]).all()
            else "-"
            for name in _QUANTITIES
        ]
        rows.append([words.joint_label(motion.joint_names, j), *shares])
    table = tabulate(
        rows,
        headers=["share of limits", *_QUANTITIES.values()],
        tablefmt="plain",
        disable_numparse=True,
        colalign=("left", *4 * ["right"]),
    )
    return table.splitlines()


def _pairs(motion):
    """Rivals that a report names, each pair once: distinguished, and not."""
    pairs = {}
    for one in motion.shows:
        if one.is_asked and one.rival:
            pair = one.joint, frozenset((one.name, one.rival))
            first = pairs.setdefault(pair, one)
            pairs[pair] = replace(first, least=max(first.least, one.least))
    decided, left = [], []
    for one in sorted(pairs.values(), key=lambda one: (one.joint, one.least)):
        largest = motion.limits.torque[one.joint]
        if not np.isfinite(largest):
            largest = np.abs(motion.tau[:, one.joint]).max()
        joint = words.joint_label(motion.joint_names, one.joint)
        torque = _newtons(motion, one.least, one.joint)
        causes = f"{_label(one.name)} or {_label(one.rival)}"
        if one.least <= largest:
            decided.append(f"- {joint}, from {torque}: {causes}")
        else:
            left.append(
                f"not distinguishable on {joint}: {causes} (needs {torque}, above the "
                "torque limit)"
            )
    return decided, left


def _shown(motion):
    """List the torques from which on effects show, joint by joint."""
    if not motion.shows:
        return [
            "It determines the model; --effects names effects that it should excite"
        ]
    by_joint = {}
    for one in motion.shows:
        by_joint.setdefault(one.joint, []).append(one.least)
    lines = [
        f"- {words.joint_label(motion.joint_names, j)}: "
        f"{words.plural(len(torques), 'effect')}, median "
        f"{_newtons(motion, float(np.median(torques)), j)}"
        for j, torques in by_joint.items()
    ]
    return ["Smallest torques of the effects that it excites", *lines]


def _never(motion, found):
    """Say what no motion shows, effects with the same reason together; one or none."""
    by_reason = {}
    hidden = [(one.reason, one.name, one.joint) for one in motion.invisible]
    for one in found.get("not_identifiable") or ():
        if one["reason"] == "span":
            hidden.append((SAME_COLUMNS, one["name"], one["joint"]))
    for reason, name, joint in dict.fromkeys(hidden):
        by_reason.setdefault(reason, {}).setdefault(name, []).append(joint)
    texts = []
    for reason, effects in by_reason.items():
        parts = [
            f"{_label(name)} ({words.joint_list(motion.joint_names, joints)})"
            for name, joints in effects.items()
        ]
        texts.append(f"{words.join(parts, len(parts))} ({reason})")
    return [f"Not identifiable by any motion: {'; '.join(texts)}."] if texts else []


def _label(name):
    """Plain English for an effect of the library; other names as they are."""
    try:
        (effect,) = resolve((name,))
    except ValueError:
        return name.replace("_", " ")
    return effect.describe({}, lambda joint: f"joint {joint + 1}")


def _newtons(motion, value, joint):
    """Write a torque or force with its unit."""
    slides = motion.slides[joint]
    return f"{words.number(value, 2)} {'N' if slides else 'N m'}"
