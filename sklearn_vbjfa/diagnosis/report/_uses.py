"""What a result can be used for, and what it cannot be used for."""

from dataclasses import dataclass

from sklearn_vbjfa.diagnosis.report import _words as words

# Verdicts on a joint whose predicted torque cannot be trusted, with the reason, and
# those whose residual is larger than noise, or cannot be compared with it.
_UNTRUSTED = {
    "failed": "error of 100 % or more",
    "worse": "held-out error rose",
    "few": "too little motion",
    "no data": "no data",
    "unsearched": "channels show too little",
}
_ABOVE_NOISE = {
    "unexplained": "residual above the noise floor",
    "above": "residual above the noise floor",
    "unknown": "noise floor unknown",
}


@dataclass(frozen=True, kw_only=True)
class Use:
    """A use of the identified robot."""

    name: str
    allowed: bool
    reason: str = ""  # why not, or for what not


def uses(outcome, verdict):
    """Judge the uses of an outcome, a tuple of `Use`."""
    return (
        _of_joints("feedforward", outcome, verdict, _UNTRUSTED),
        _of_joints("simulation", outcome, verdict, _UNTRUSTED),
        _of_joints("collision detection", outcome, verdict, _UNTRUSTED | _ABOVE_NOISE),
        *_masses(outcome, verdict),
    )


def _whole(outcome, verdict):
    """Say why no use is allowed at all; empty if some are."""
    if verdict.status == "faulty":
        return "faulty channels"
    return "recordings disagree" if outcome.contradictions.found else ""


def _of_joints(name, outcome, verdict, reasons):
    """Judge a use that takes the torques of all joints."""
    whole = _whole(outcome, verdict)
    if whole:
        return Use(name=name, allowed=False, reason=whole)
    found = {}
    for one in verdict.joints:
        if one.status in reasons:
            found.setdefault(reasons[one.status], []).append(one.joint)
    parts = [
        f"{words.joint_list(outcome.joint_names, own)}: {reason}"
        for reason, own in found.items()
    ]
    return Use(name=name, allowed=not parts, reason="; ".join(parts))


def _masses(outcome, verdict):
    """Judge the link masses, those that are identified apart from the others."""
    name, bodies = "link masses", outcome.bodies
    if not bodies:
        return ()
    whole = _whole(outcome, verdict)
    if outcome.gains is not None and not outcome.gains.absolute:
        whole = whole or "torques in units of one channel"
    if whole:
        return (Use(name=name, allowed=False, reason=whole),)
    known = [b.name for b in bodies if b.known == "yes"]
    others = [b.name for b in bodies if b.known != "yes"]
    if not others:
        return (Use(name=name, allowed=True),)
    why = "not identifiable from this motion"
    if not known:
        return (Use(name=name, allowed=False, reason=why),)
    return (
        Use(name=f"{name} of {words.join(known, 3)}", allowed=True),
        Use(name=f"{name} of {words.join(others, 3)}", allowed=False, reason=why),
    )


def use_lines(found):
    """Write what a result can and cannot be used for, in at most two lines."""
    can = [one.name for one in found if one.allowed]
    cannot = {}
    for one in found:
        if not one.allowed:
            cannot.setdefault(one.reason, []).append(one.name)
    lines = []
    if can:
        lines.append(f"Use for: {', '.join(can)}.")
    if cannot:
        parts = [f"{', '.join(own)} ({reason})" for reason, own in cannot.items()]
        lines.append(f"Do not use for: {'; '.join(parts)}.")
    return tuple(lines)
