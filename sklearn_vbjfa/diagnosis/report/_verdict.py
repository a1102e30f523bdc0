"""Verdicts on a robot and its joints, and allowed uses of the result, as data."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.explain import ABOVE_FLOOR, NO_INFORMATION, WORSE, rises
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.effects import TorqueGain
from sklearn_vbjfa.recording import PDDrive
from sklearn_vbjfa.robot._exports import UNSTABLE

# Relative error of predicting the mean of the held-out torque, and errors above which
# uses are forbidden and qualified.
_MEAN_TORQUE, _LARGE, _FIFTH = 1.0, 0.5, 0.2
# Status of a robot from that of a joint, worst first: with effects, without.
_STATUS = {
    "failed": ("failed", "failed"),
    "worse": ("worse", "worse"),
    "unexplained": ("partial", "exhausted"),
    "above": ("unsettled", "unsettled"),
    "unknown": ("unknown", "unknown"),
}
# Status of joints whose predicted torque is unreliable, and of joints whose residual
# exceeds the noise or cannot be compared with it.
_UNTRUSTED = ("failed", "worse", "few", "no data", "unsearched")
_ABOVE_NOISE = ("unexplained", "above", "unknown")
# Fault of a log whose estimated delay of the commands is below minus one row.
_EARLY = (
    "The commands would act more than a sample period before they are logged: the law "
    "of the drive has other terms (v_desired, integral part), or another clock."
)
# Joint statuses that give a warning.
NO_ANSWER = ("no data", "few", "unknown", "failed", "worse")


@dataclass(frozen=True, kw_only=True)
class JointVerdict:
    """The verdict on a joint."""

    # status: "floor" (residual at the noise floor), "unexplained", "above" (above the
    # floor on the held-out part only), "unknown" (no floor), "worse", "failed" (an
    # error of 100 % or more), "few" (too little motion in the held-out part),
    # "unsearched" (its channels carry too little information) and "no data".

    joint: int  # from zero
    label: str
    status: str
    # "near" the floor, "far" from it but not significantly, "large", within "chance",
    # worse than "declared"
    detail: str = ""
    text: str = ""  # the same in words


@dataclass(frozen=True, kw_only=True)
class Use:
    """A use of the identified robot."""

    name: str
    allowed: bool
    # reasons against it, or qualifications: pairs of a code and the affected joints
    causes: tuple = ()
    reason: str = ""  # the same in words


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The verdict on a robot."""

    status: str
    joints: tuple[JointVerdict, ...]
    # means over the judged joints: "before", "plain", "after" and "floor"; nan if
    # unknown, the floor if that of any joint is
    errors: dict
    uses: tuple[Use, ...]
    faults: tuple = ()  # messages on faulty channels
    fell: bool = True  # whether effects lowered the mean error
    rose: tuple = ()  # joints on which they raised the error, also by chance

    def having(self, *status):
        """Return the joints of a status, a list."""
        return [v.joint for v in self.joints if v.status in status]


def judge(outcome):
    findings, names = outcome.findings, outcome.robot["joints"]
    labels = (words.joint_label(names, j) for j in range(len(outcome.errors)))
    joints = tuple(
        JointVerdict(joint=j, label=label, **_joint_status(outcome, j))
        for j, label in enumerate(labels)
    )
    faults = tuple(
        channel.message
        for channel in findings["channels"]
        if channel.severity == "warning" and channel.kind not in NO_INFORMATION
    )
    for fact in outcome.facts_of("parameter"):
        latest = fact.interval[1] * outcome.provenance["rate"]  # in rows
        if fact.name == "drive:delay" and latest < -1.0:
            faults += (_EARLY,)
    columns = {x: outcome.column(x) for x in ("before", "plain", "after", "floor")}
    used = np.isfinite(columns["before"] + columns["after"]) & outcome.column("enough")
    errors = {
        k: x[used].mean().item() if used.any() else np.nan for k, x in columns.items()
    }
    before, plain, after, floor = columns.values()
    # No increase is tolerated on joints with effects.
    factor = np.full(len(joints), WORSE)
    factor[[*_joints_with(outcome, "effects", "possible")]] = 1.0
    rose = np.flatnonzero(rises(after, np.fmin(before, plain), floor, factor)).tolist()
    fell = errors["after"] < min(errors["before"], errors["plain"])
    return Verdict(
        status=_status(outcome, joints, faults),
        joints=joints,
        errors=errors,
        uses=_uses(outcome, faults, joints, rose),
        faults=faults,
        fell=not findings["effects"] or fell,
        rose=tuple(rose),
    )


def _joint_status(outcome, j):
    """Return the status of a joint, with its detail if any, as keywords."""
    joint = outcome.errors[j]
    after, floor = joint.after, joint.floor
    if not np.isfinite(after):
        return {"status": "no data"}
    if not joint.enough:
        return {"status": "few"}
    if after >= _MEAN_TORQUE:
        return {"status": "failed"}
    if _is_worse(joint, "before", "difference"):
        return {"status": "worse", "detail": "declared"}
    if _is_worse(joint, "plain", "added"):
        return {"status": "worse"}
    if not joint.searched:
        return {"status": "unsearched"}
    large = {"detail": "large" * (after > _LARGE)}
    if not np.isfinite(floor):
        return {"status": "unknown"} | large
    if any(u.joint == j for u in outcome.findings["unexplained"]):
        return {"status": "unexplained"} | large
    least = np.nan_to_num(joint.intervals["after"][0], nan=np.inf)
    lower, upper = (factor * floor for factor in ABOVE_FLOOR)
    # Held-out errors also contain the error of the parameters, which the floor lacks.
    if after > upper and least > lower:
        return {"status": "above"} | large
    if after > (lower if least > floor else upper):
        return {"status": "floor", "detail": "far" if after > upper else "near"}
    high = joint.intervals["added"][1]
    chance = j in _joints_with(outcome, "effects") and 0 <= high < np.inf
    return {"status": "floor", "detail": "chance" if chance else ""}


def _is_worse(joint, error, difference):
    """Whether a joint is significantly worse than with another model."""
    low = joint.intervals[difference][0]
    # Without an interval, the errors alone are compared.
    significant = not np.isfinite(low) or low > 0
    return significant and rises(joint.after, getattr(joint, error), joint.floor)


def _status(outcome, joints, faults):
    """Return the status of the robot, from the worst of its joints."""
    kinds = {v.status for v in joints} - {"no data", "few"}
    if faults:
        return "faulty"
    if kinds <= {"unsearched"}:
        return "unsearched" if kinds else "no data"
    nothing = not outcome.findings["effects"]
    for kind, names in _STATUS.items():
        if kind in kinds:
            return names[nothing]
    return "nothing" if nothing else "complete"


# Joint statuses that forbid a use.
_FORBIDDEN = {
    "feedforward": _UNTRUSTED,
    "simulation": _UNTRUSTED,
    "collision detection": _UNTRUSTED + _ABOVE_NOISE,
}


def _uses(outcome, faults, joints, rose):
    """Decide on the uses of an outcome, a tuple of `Use`; reasons are codes."""
    overall = "faulty" if faults else ""
    overall = overall or ("contradiction" if outcome.findings["contradictions"] else "")
    effects = (*outcome.findings["effects"], *outcome.findings["possible"])
    library, motion = outcome.robot["library"], enumerate(outcome.robot["motion"])
    # Without a torque sensor, a wrong gain is an error of the control law itself.
    gains = [x.joint for x in effects if x.name == TorqueGain.name and not x.warning]
    wrong = {"gain": gains} if gains and outcome.robot["drive"] else {}
    export, drive = outcome.provenance.get("export", ()), outcome.robot["drive"] or {}
    unstable = any(text.startswith(UNSTABLE) for text in export)
    # A wrong law leaves a residual, and errors of the torque that are larger.
    followed = drive.get("kind") == PDDrive.__name__
    doubtful = [x.joint for x in joints if followed and x.status in _ABOVE_NOISE]
    excess = outcome.column("after") ** 2 - np.nan_to_num(outcome.column("floor")) ** 2
    poor = [j for j in doubtful if excess[j] > _FIFTH**2]
    # Qualifications of all allowed uses, and of single ones: joints by code.
    noted = {
        "large": [x.joint for x in outcome.errors if x.after > _LARGE],
        "fifth": [x.joint for x in outcome.errors if _FIFTH < x.after <= _LARGE],
        "rose": rose,
        "one way": [j for j, x in motion if x.resting < 1 and not x.reversals],
        "unconfirmed": doubtful,
    }
    hidden = {e.joint for e in effects if library[e.name].files.simulation}
    hidden = sorted(hidden.union(outcome.robot["unsimulated"]))
    far = [x.joint for x in joints if x.detail == "far"]
    noted_for = {"simulation": {"left out": hidden}}
    noted_for["collision detection"] = {"far": far}
    uses = []
    for name, forbidden in _FORBIDDEN.items():
        causes = {overall: []} if overall else dict(wrong)
        if name == "feedforward" and poor and not overall:
            causes["law"] = poor
        for verdict in joints if not overall else ():
            # A joint with a large held-out error does not reproduce its fit.
            code = verdict.status if verdict.status in forbidden else verdict.detail
            if code in (*forbidden, "large"):
                causes.setdefault(code, []).append(verdict.joint)
        if name == "simulation" and unstable and not (overall or followed):
            causes["unstable"] = []
        if allowed := not causes:
            qualified = noted | noted_for.get(name, {})
            causes |= {code: x for code, x in qualified.items() if x}
            if followed:
                causes["followed" if name == "simulation" else "by law"] = []
            if name == "simulation" and export and not unstable:
                causes["approximate"] = []
        uses.append(Use(name=name, allowed=allowed, causes=tuple(causes.items())))
    return (*uses, *_masses(outcome, overall, "by law" if followed else ""))


def _joints_with(outcome, *kinds):
    """Return the joints with effects that act on a single joint, a set."""
    effects = (e for kind in kinds for e in outcome.findings[kind])
    return {e.joint for e in effects if e.scope == "joint"}


def _masses(outcome, overall, condition):
    """Return uses for the link masses: identified ones, and the others."""
    # overall: cause against all uses, or ""; condition: qualification of allowed ones.
    bodies, gains = outcome.facts_of("mass"), outcome.robot["gains"]
    if gains is not None and not gains.absolute:
        overall = overall or "relative"
    identified = [b.name for b in bodies if b.source == "yes" and not overall]
    others = [b.name for b in bodies if b.name not in identified]
    uses = []
    for names, reason in ((identified, ""), (others, overall or "masses")):
        if names:
            some = f" of {words.join(names, 3)}" if identified and others else ""
            cause, name = reason or condition, f"link masses{some}"
            causes = ((cause, []),) if cause else ()
            uses.append(Use(name=name, allowed=not reason, causes=causes))
    return tuple(uses)
