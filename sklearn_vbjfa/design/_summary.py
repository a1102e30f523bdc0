"""A designed motion in words, for a terminal."""

import math
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
    found = found or {}
    texts = [
        *_decides(motion),
        *(f"{words.capital(one)}." for one in undecided(motion)),
        *_never(motion, found),
        *_repeated(motion, found),
    ]
    if not measured.all():
        texts.append(
            "Noise was not measured: 1 % of the torque limits is assumed, and what "
            "depends on it is as uncertain."
        )
    apart = unchecked(motion) or [
        f"Bodies stay {words.number(1e3 * motion.margins['clearance'])} mm apart (at "
        f"least {1e3 * ROOM:g} mm are kept); the surroundings of the robot are not "
        "known."
    ]
    return [
        f"Motion of {robot}: {words.plural(len(motion.joint_names), 'joint')}, "
        f"{motion.duration:g} s at {1 / motion.dt:.4g} Hz",
        f"condition number {words.number(motion.condition_number)}, at first "
        f"{words.number(motion.start_condition_number)} (columns over their sizes at "
        "random states)",
        "",
        *_shares(motion),
        *wrapped(apart[0], ""),
        "",
        *(line for text in texts for line in wrapped(text)),
    ]


def wrapped(text, indent="  "):
    """Break a text into lines of a terminal, the further ones indented."""
    return textwrap.wrap(text, _WIDTH, subsequent_indent=indent, break_on_hyphens=False)


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
        headers=["of the limits", *_QUANTITIES.values()],
        tablefmt="plain",
        disable_numparse=True,
        colalign=("left", *4 * ["right"]),
    )
    return table.splitlines()


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
    margin = float(motion.margins[worst][j])
    if margin >= MARGIN - 1e-6:
        nearest = motion.margins.get("clearance", math.inf)
        return (
            f"bodies come as near as {1e3 * nearest:.3g} mm, where {1e3 * ROOM:g} mm "
            "are kept"
        )
    label = words.joint_label(motion.joint_names, j)
    limit = f"the limit of {_QUANTITIES[worst]} of {label}"
    if margin < 0:
        return f"{limit} is exceeded by {words.percent(-margin)}"
    return f"{limit} is kept with {words.percent(margin)} to spare, not {MARGIN:.0%}"


# -- what it decides -------------------------------------------------------------------


def _decides(motion):
    """List the effects that are distinguished, or from which torques on."""
    parted = _pairs(motion, decided=True)
    if parted:
        return ["It tells apart causes that exceed these torques", *parted]
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


def _pairs(motion, *, decided):
    """Rivals of the report that a motion distinguishes, or does not, each pair once."""
    pairs = {}
    for one in motion.shows:
        if one.is_asked and one.rival:
            pair = one.joint, frozenset((one.name, one.rival))
            first = pairs.setdefault(pair, one)
            pairs[pair] = replace(first, least=max(first.least, one.least))
    texts = []
    for one in sorted(pairs.values(), key=lambda one: (one.joint, one.least)):
        limit = motion.limits.torque[one.joint]
        largest = np.abs(motion.tau[:, one.joint]).max()
        if (one.least <= (limit if np.isfinite(limit) else largest)) != decided:
            continue
        joint = words.joint_label(motion.joint_names, one.joint)
        torque = _newtons(motion, one.least, one.joint)
        causes = f"{effect_label(one.name)} or {effect_label(one.rival)}"
        texts.append(
            f"- {joint}, from {torque}: {causes}"
            if decided
            else f"not told apart on {joint}, except by {torque}, more than it has: "
            f"{causes}"
        )
    return texts


def undecided(motion):
    """Name the effects that a motion does not distinguish, a list of str."""
    return _pairs(motion, decided=False)


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
    for one in found.get("hidden") or ():
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
        for one in found.get("repeated") or ()
    ]
    if not periods:
        return []
    return [
        f"The motion so far repeats ({words.join(periods, 2)}), and what the model "
        f"lacks repeats with it. This one does not within its {motion.duration:g} s: "
        "record it once, and others by another --seed."
    ]


def effect_label(name):
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
