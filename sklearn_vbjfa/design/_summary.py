"""What a designed motion decides, for the templates of the command line."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa.design._design import MARGIN, SAME_COLUMNS
from sklearn_vbjfa.design._optimise import ROOM
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.effects import resolve

# Margins and what tables call them.
_QUANTITIES = {
    "position": "range",
    "velocity": "speed",
    "acceleration": "acceleration",
    "torque": "torque",
}


def facts(motion, found):
    """Return what a motion decides and which limits it uses, by template names."""
    # found: the report that the motion was designed for, as a dict.
    labels = [
        words.joint_label(motion.joint_names, j) for j in range(len(motion.joint_names))
    ]
    shares = {"share of limits": labels}
    for name, head in _QUANTITIES.items():
        limits = zip(motion.margins[name], getattr(motion.limits, name))
        shares[head] = [
            words.whole_percent(1.0 - margin) if np.isfinite(limit).all() else "-"
            for margin, limit in limits
        ]
    torques = {}
    for one in motion.shows:
        torques.setdefault(one.joint, []).append(one.least)
    decided, open_pairs = _pairs(motion)
    why = motion.no_clearance.rstrip(".")
    return {
        # Links may meet where their distances are not known.
        "unchecked": why and f"SELF-COLLISION WAS NOT CHECKED. {why}.",
        "shares": shares,
        "decided": decided,
        "open_pairs": open_pairs,
        "shown": [
            f"{labels[j]}: {words.plural(len(some), 'effect')}, median "
            f"{_newtons(motion, float(np.median(some)), j)}"
            for j, some in torques.items()
        ],
        "hidden": _hidden(motion, found),
        "nearest": words.number(1e3 * motion.margins.get("clearance", np.nan)),
        "room": f"{1e3 * ROOM:g}",
        "most": max(float(np.max(1.0 - motion.margins[name])) for name in _QUANTITIES),
    }


def doubts(motion, facts, effects):
    """List what a motion leaves open: clearance, rivals, effects that were named."""
    found = [text for text in (facts["unchecked"], *facts["open_pairs"]) if text]
    for one in motion.invisible:
        if one.name in effects:
            joint = words.joint_label(motion.joint_names, one.joint)
            found.append(
                f"{_label(one.name)} on {joint} is not identifiable by any motion "
                f"({one.reason})"
            )
    return found


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
            decided.append(f"{joint}, from {torque}: {causes}")
        else:
            left.append(
                f"not distinguishable on {joint}: {causes} (needs {torque}, above the "
                "torque limit)"
            )
    return decided, left


def _hidden(motion, found):
    """Effects that no motion shows, with their joints, by the reason."""
    by_reason = {}
    hidden = [(one.reason, one.name, one.joint) for one in motion.invisible]
    for one in found.get("not_identifiable") or ():
        if one["reason"] == "span":
            hidden.append((SAME_COLUMNS, one["name"], one["joint"]))
    for reason, name, joint in dict.fromkeys(hidden):
        by_reason.setdefault(reason, {}).setdefault(name, []).append(joint)
    return {
        reason: [
            f"{_label(name)} ({words.joint_list(motion.joint_names, joints)})"
            for name, joints in effects.items()
        ]
        for reason, effects in by_reason.items()
    }


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
