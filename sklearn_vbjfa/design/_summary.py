"""Summary of a designed motion, for the templates of the command line."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa.design._design import MARGIN, SAME_COLUMNS
from sklearn_vbjfa.design._optimise import ROOM
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.effects import resolve

# Margins and their names in tables.
_QUANTITIES = {
    "position": "range",
    "velocity": "speed",
    "acceleration": "acceleration",
    "torque": "torque",
}


def facts(motion, report):
    """Return distinguishable effects and used limits of a motion, by template names."""
    # report: the report that the motion was designed for, as a dict.
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
    for effect in motion.shows:
        torques.setdefault(effect.joint, []).append(effect.least)
    decided, open_pairs = _pairs(motion)
    why = motion.no_clearance.rstrip(".")
    return {
        # Without geometry links may collide.
        "unchecked": why and f"SELF-COLLISION WAS NOT CHECKED. {why}.",
        "shares": shares,
        "decided": decided,
        "open_pairs": open_pairs,
        "shown": [
            f"{labels[j]}: {words.plural(len(some), 'effect')}, median "
            f"{_newtons(motion, float(np.median(some)), j)}"
            for j, some in torques.items()
        ],
        "hidden": _hidden(motion, report),
        "nearest": words.number(1e3 * motion.margins.get("clearance", np.nan)),
        "room": f"{1e3 * ROOM:g}",
        "most": max(float(np.max(1.0 - motion.margins[name])) for name in _QUANTITIES),
    }


def doubts(motion, facts, effects):
    """List the warnings of a motion: clearance, rivals, effects not identifiable."""
    texts = [text for text in (facts["unchecked"], *facts["open_pairs"]) if text]
    for effect in motion.invisible:
        if effect.name in effects:
            joint = words.joint_label(motion.joint_names, effect.joint)
            texts.append(
                f"{_label(effect.name)} on {joint} is not identifiable by any motion "
                f"({effect.reason})"
            )
    return texts


def exceeded(motion):
    """Describe the smallest margin to a limit, and the clearance of bodies."""
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
    """Rivals in a report, each pair once: distinguished, and not distinguished."""
    pairs = {}
    for shown in motion.shows:
        if shown.is_asked and shown.rival:
            pair = shown.joint, frozenset((shown.name, shown.rival))
            first = pairs.setdefault(pair, shown)
            pairs[pair] = replace(first, least=max(first.least, shown.least))
    decided, left = [], []
    for shown in sorted(pairs.values(), key=lambda x: (x.joint, x.least)):
        largest = motion.limits.torque[shown.joint]
        if not np.isfinite(largest):
            largest = np.abs(motion.tau[:, shown.joint]).max()
        joint = words.joint_label(motion.joint_names, shown.joint)
        torque = _newtons(motion, shown.least, shown.joint)
        causes = f"{_label(shown.name)} or {_label(shown.rival)}"
        if shown.least <= largest:
            decided.append(f"{joint}, from {torque}: {causes}")
        else:
            left.append(
                f"not distinguishable on {joint}: {causes} (needs {torque}, above the "
                "torque limit)"
            )
    return decided, left


def _hidden(motion, report):
    """Effects that are not identifiable by any motion, with their joints, by reason."""
    by_reason = {}
    hidden = [(x.reason, x.name, x.joint) for x in motion.invisible]
    for effect in report.get("not_identifiable") or ():
        if effect["reason"] == "span":
            hidden.append((SAME_COLUMNS, effect["name"], effect["joint"]))
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
    """Name of an effect of the library in plain English; other names unchanged."""
    try:
        (effect,) = resolve((name,))
    except ValueError:
        return name.replace("_", " ")
    return effect.describe({}, lambda joint: f"joint {joint + 1}")


def _newtons(motion, value, joint):
    return f"{words.number(value, 2)} {'N' if motion.slides[joint] else 'N m'}"
