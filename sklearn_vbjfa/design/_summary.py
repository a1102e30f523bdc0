"""A designed motion in words, for a terminal."""

import math
import textwrap

import numpy as np

from sklearn_vbjfa.design._criterion import SAME_COLUMNS
from sklearn_vbjfa.design._design import MARGIN, ROOM
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.effects import resolve

# Characters of a line.
_WIDTH = 88
_QUANTITIES = ("position", "velocity", "acceleration", "torque")
_BARE = {"position": "range", "velocity": "speed"}


def summary(motion, robot, measured, found=None):
    """Say what a motion is, which limits it uses, and what it decides, lines of str."""
    # measured (nv,): joints of which the torque noise was measured; found: the report
    # that the motion was designed for, as a dict.
    texts = [
        *_decides(motion, found),
        *(f"{words.capital(one)}." for one in undecided(motion)),
        *_never(motion, found),
        *_repeated(motion, found),
    ]
    if not measured.all():
        texts.append(
            "Noise was not measured: 1 % of the torque limits is assumed, and what "
            "depends on it is as uncertain."
        )
    return [
        f"Motion of {robot}: {words.plural(len(motion.joint_names), 'joint')}, "
        f"{motion.duration:g} s at {1 / motion.dt:.4g} Hz",
        f"condition number {words.number(motion.condition_number)}, at first "
        f"{words.number(motion.start_condition_number)} (columns over their sizes at "
        "random states)",
        "",
        *_shares(motion),
        *wrapped(_clearance(motion), ""),
        "",
        *(line for text in texts for line in wrapped(text)),
    ]


def wrapped(text, indent="  "):
    """Break a text into lines of a terminal, the further ones indented."""
    return textwrap.wrap(text, _WIDTH, subsequent_indent=indent, break_on_hyphens=False)


# -- limits ----------------------------------------------------------------------------


def _shares(motion):
    """Tabulate the shares of the limits that each joint uses."""
    from tabulate import tabulate

    rows = [
        [words.joint_label(motion.joint_names, j)]
        + [
            words.whole_percent(1.0 - motion.margins[name][j])
            if np.isfinite(getattr(motion.limits, name)[j]).all()
            else "-"
            for name in _QUANTITIES
        ]
        for j in range(len(motion.joint_names))
    ]
    table = tabulate(
        rows,
        headers=["of the limits", *(_BARE.get(name, name) for name in _QUANTITIES)],
        tablefmt="plain",
        disable_numparse=True,
        colalign=("left", *4 * ["right"]),
    )
    return table.splitlines()


def _clearance(motion):
    """Say how near bodies come, or why that is not known."""
    if "clearance" not in motion.margins:
        return unchecked(motion)[0]
    nearest = words.number(1e3 * motion.margins["clearance"])
    return (
        f"Bodies stay {nearest} mm apart (at least {1e3 * ROOM:g} mm are kept); "
        "the surroundings of the robot are not known."
    )


def unchecked(motion):
    """Warn that links may meet, a list of str; empty where their distances are kept."""
    if "clearance" in motion.margins:
        return []
    reason = motion.no_clearance.rstrip(".")
    return [f"SELF-COLLISION WAS NOT CHECKED. {reason}."]


def before(motion):
    """Say what to do before a motion that may make the robot hit itself."""
    if not unchecked(motion):
        return []
    most = max(float(np.max(1.0 - motion.margins[name])) for name in _QUANTITIES)
    return [
        "BEFORE IT RUNS: the robot may hit itself, at up to "
        f"{words.whole_percent(most)} of its limits. Watch all of the motion in a "
        "simulator, then run it slowly with a hand on the emergency stop; or give a "
        "robot description with collision geometry, and design keeps the links apart."
    ]


def exceeded(motion):
    """Name the limit that a motion exceeds the most, or with too small a margin."""
    worst = min(_QUANTITIES, key=lambda name: motion.margins[name].min())
    j = int(np.argmin(motion.margins[worst]))
    label = words.joint_label(motion.joint_names, j)
    margin = float(motion.margins[worst][j])
    nearest = motion.margins.get("clearance", math.inf)
    if margin >= MARGIN - 1e-6:
        return (
            f"bodies come as near as {1e3 * nearest:.3g} mm, where {1e3 * ROOM:g} mm "
            "are kept"
        )
    limit = f"the limit of {_BARE.get(worst, worst)} of {label}"
    if margin < 0:
        return f"{limit} is exceeded by {words.percent(-margin)}"
    return f"{limit} is kept with {words.percent(margin)} to spare, not {MARGIN:.0%}"


# -- what it decides -------------------------------------------------------------------


def _decides(motion, found):
    """List the effects that are distinguished, or from which torques on."""
    pairs = [one for one in motion.parts if one.least <= _has(motion, one.joint)]
    if pairs:
        named = _rivals(found or {})
        # What the report names as rivals comes first.
        pairs.sort(key=lambda one: (frozenset(one.names), one.joint) not in named)
        return [
            "It tells apart causes that exceed these torques",
            *(
                f"- {words.joint_label(motion.joint_names, one.joint)}, from "
                f"{_newtons(motion, one.least, one.joint)}: {_causes(one)}"
                for one in pairs
            ),
        ]
    if not motion.shows:
        return ["It determines the model; name effects that it shall show by --effects"]
    by_joint = {}
    for one in motion.shows:
        by_joint.setdefault(one.joint, []).append(one.least)
    return [
        "It shows effects that exceed these torques",
        *(
            f"- {words.joint_label(motion.joint_names, j)}: "
            f"{words.plural(len(torques), 'effect')}, the clearest from "
            f"{_newtons(motion, min(torques), j)}, half of them from "
            f"{_newtons(motion, float(np.median(torques)), j)}"
            for j, torques in by_joint.items()
        ),
    ]


def _rivals(found):
    """Return pairs that a report could not tell apart, ({name, name}, joint)."""
    return {
        (frozenset((one["name"], trial["name"])), one["joint"])
        for one in found.get("effects") or ()
        for trial in one.get("trials") or ()
    }


def _has(motion, j):
    """Largest torque of a joint: its limit, or without one that in the motion."""
    limit = motion.limits.torque[j]
    return limit if np.isfinite(limit) else np.abs(motion.tau[:, j]).max()


def undecided(motion):
    """Name the effects that a motion does not distinguish, a list of str."""
    return [
        f"not told apart on {words.joint_label(motion.joint_names, one.joint)}, except "
        f"by {_newtons(motion, one.least, one.joint)}, more than it has: {_causes(one)}"
        for one in motion.parts
        if one.least > _has(motion, one.joint)
    ]


def unseen(motion, names):
    """Name the effects that a motion does not excite, a list of str."""
    return [
        f"{effect_label(one.name)} on "
        f"{words.joint_label(motion.joint_names, one.joint)} is not identifiable by "
        f"any motion ({one.reason})"
        for one in motion.invisible
        if one.name in names
    ]


def _never(motion, found):
    """Say what no motion shows, effects with the same reason together; one or none."""
    hidden = [(one.reason, one.name, one.joint) for one in motion.invisible]
    for one in (found or {}).get("hidden") or ():
        if one["reason"] == "span":
            hidden.append((SAME_COLUMNS, one["name"], one["joint"]))
        elif one["reason"] == "together":
            why = f"only together with {effect_label(one['remedy'])}"
            hidden.append((why, one["name"], one["joint"]))
    by_reason = {}
    for reason, name, joint in dict.fromkeys(hidden):
        by_reason.setdefault(reason, {}).setdefault(name, []).append(joint)
    texts = []
    for reason, effects in by_reason.items():
        parts = [
            f"{effect_label(name)} ({words.joint_list(motion.joint_names, joints)})"
            for name, joints in effects.items()
        ]
        texts.append(f"{words.join(parts, len(parts))} ({reason})")
    return [f"Not identifiable by any motion: {'; '.join(texts)}."] if texts else []


def _repeated(motion, found):
    """Say why to record another motion, once, where the recorded one repeats."""
    periods = [
        f"{one['count']:.3g} times {words.number(one['seconds'])} s"
        for one in (found or {}).get("repeated") or ()
    ]
    if not periods:
        return []
    return [
        f"The motion so far repeats ({words.join(periods, 2)}), and what the model "
        f"lacks repeats with it. This one does not within its {motion.duration:g} s: "
        "record it once, and others by another --seed."
    ]


# -- words -----------------------------------------------------------------------------


def effect_label(name):
    """Plain English for an effect of the library; other names as they are."""
    try:
        (effect,) = resolve((name,))
    except ValueError:
        return name.replace("_", " ")
    return effect.describe({}, lambda joint: f"joint {joint + 1}")


def _causes(pair):
    return " or ".join(effect_label(name) for name in pair.names)


def _newtons(motion, value, joint):
    """Write a torque or force with its unit."""
    unit = "N" if motion.slides[joint] else "N m"
    return f"{words.number(value, 2)} {unit}"
