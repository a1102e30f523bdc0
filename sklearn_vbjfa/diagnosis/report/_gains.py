"""What a report says of the gains of torque channels."""

import numpy as np

from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.robot._gains import PAYLOAD

_PAYLOAD = (
    "; a known payload that is picked up or put down in the recording, or between two "
    "of them, can (--known-mass payload=KG)"
)
_NOT_SHOWN = (
    "This recording does not show the gains of the torque channels relative to one "
    "another: no two of them feel enough of the same bodies."
)


def gain_sentences(outcome):
    """Say what the gains are relative to, which are hidden, and what fixes the rest."""
    gains = outcome.gains
    if gains is None:
        return ()
    if not gains.references:
        return gain_doubts(outcome)
    return (_unit(outcome, gains), *gain_doubts(outcome))


def gain_doubts(outcome):
    """Say which gains are unknown or hardly credible, and which masses do not help."""
    gains = outcome.gains
    if gains is None:
        return ()
    told = [] if gains.references else [_NOT_SHOWN]
    told += [_hidden(outcome, gains), _far(outcome, gains)]
    told += [_unused(gains, known) for known in gains.common.masses]
    told.append(_contradiction(gains.common))
    return tuple(filter(None, told))


def gain_rows(outcome):
    """Cells of each joint: its name, the gain with its interval, and its unit."""
    gains, names = outcome.gains, outcome.joint_names
    rows = []
    for j, gain in enumerate(gains.gain):
        value = words.with_error(gain, tuple(gains.intervals[:, j]))
        relative = words.joint_label(names, gains.reference[j])
        if j in gains.hidden:
            cells = ("not shown", "")
        elif gains.absolute:
            cells = (value, f"per {outcome.torque_units[j]}")
        elif j in gains.references:
            cells = ("1", "the unit")
        else:
            cells = (value, f"relative to {relative}")
        rows.append((words.joint_label(names, j), *cells))
    return tuple(rows)


def _unit(outcome, gains):
    """Say in which unit everything is, and on what that rests."""
    channel = words.joint_list(outcome.joint_names, gains.references)
    common = gains.common
    if gains.absolute:
        masses = [
            f"{_called(known)} of {words.number(known.mass)} kg"
            for known in common.masses
            if known.used
        ]
        share = words.percent(1.645 * common.std / common.factor)
        return (
            f"The common gain rests on {words.join(masses, 4)} (to {share}, 90 %): "
            "masses are in kg, and torques and friction in N m or N. A channel reads "
            "its gain times the torque."
        )
    several = len(gains.references) > 1
    return (
        f"Gains are relative to the channel{'s' * several} of {channel}, from which "
        "those of the other joints that move the same bodies are known best. The gain "
        "that all have in common is in every parameter and in no recording without a "
        "known mass: torques, masses and friction are in units of "
        f"{'these channels' if several else 'that channel'}."
    )


def _called(known):
    return "the payload" if known.name == PAYLOAD else f"the mass of {known.name}"


def _hidden(outcome, gains):
    """Name the joints whose gain is not shown."""
    if not gains.hidden or not gains.references:
        return ""
    several = len(gains.hidden) > 1
    joints = words.joint_list(outcome.joint_names, gains.hidden)
    return (
        f"The gain{'s' * several} of {joints} "
        f"{'are' if several else 'is'} not shown relative to the others: too little of "
        f"what {'they move' if several else 'it moves'} is felt by another joint. "
        f"{'Each counts' if several else 'It counts'} as 1."
    )


def _far(outcome, gains):
    """Name the joints whose gain would take another kind of drive."""
    if not gains.doubtful:
        return ""
    joints = words.joint_list(outcome.joint_names, gains.doubtful)
    return (
        f"The gain of {joints} is more than five times from the others': where the "
        "drives are alike, something that the model lacks (rotor inertia, friction) "
        "has taken its place."
    )


def _unused(gains, known):
    """Say why a known mass does not fix the common gain."""
    what = f"{_called(known)} ({words.number(known.mass)} kg)"
    what = f"{what[0].upper()}{what[1:]}"
    if known.used:
        return ""
    if len(gains.references) > 1:
        return (
            f"{what} cannot fix the gain of channels that share no body with it: "
            "identify the branches of the robot one by one."
        )
    if known.name == PAYLOAD and np.isnan(known.found):
        return (
            f"{what} cannot fix the common gain: no change of payload was found. "
            "Record motion against gravity with and without it."
        )
    if known.shown:
        return (
            f"{what} cannot fix the common gain: the recording shows it too poorly; "
            "slow motion against gravity in several poses shows it better."
        )
    return (
        f"{what} cannot fix the common gain: torques show it only together with "
        f"moments and masses of other bodies{'' if gains.absolute else _PAYLOAD}."
    )


def _contradiction(common):
    """Say that known masses disagree."""
    if common.agree:
        return ""
    each = [
        f"{_called(known)} asks for {words.number(known.found / known.mass)}"
        + (
            f" +- {words.number(1.645 * known.std / known.mass, 2)}"
            if np.isfinite(known.std)
            else ""
        )
        for known in common.masses
        if np.isfinite(known.found)
    ]
    return (
        "The known masses disagree by more than chance "
        f"({words.p_text(common.p_value)}): for the gain of the reference channel, "
        f"{words.join(each, 4)}. One of them is wrong."
    )
