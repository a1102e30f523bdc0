"""The verdict on a robot and on each joint, and the uses of the result, as data."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.explain import ABOVE_FLOOR, NO_INFORMATION
from sklearn_vbjfa.diagnosis.report import _words as words

# A refit moves the errors of all joints; a rise below this factor is no harm.
_WORSE = 1.05
# The error of predicting the mean of the held-out torque, and one that is stated
# beside the uses.
_MEAN_TORQUE, _LARGE = 1.0, 0.5
# Status of a robot with a joint of a status, the worst first: with effects, without.
_STATUS = {
    "failed": ("failed", "failed"),
    "worse": ("worse", "worse"),
    "unexplained": ("partial", "exhausted"),
    "above": ("unsettled", "unsettled"),
    "unknown": ("unknown", "unknown"),
}
# Verdicts on a joint whose predicted torque cannot be trusted, and those whose residual
# is larger than noise, or cannot be compared with it.
_UNTRUSTED = ("failed", "worse", "few", "no data", "unsearched")
_ABOVE_NOISE = ("unexplained", "above", "unknown")
# Verdicts on a joint that forbid a use.
NO_ANSWER = ("no data", "few", "unknown", "failed", "worse")


@dataclass(frozen=True, kw_only=True)
class JointVerdict:
    """The verdict on a joint."""

    # status: "floor" (only noise is left), "unexplained", "above" (above the floor on
    # the held-out part only), "unknown" (no floor), "worse", "failed" (an error of 100
    # % or more), "few" (moves too little in the held-out part for a verdict),
    # "unsearched" (its channels show too little) and "no data".

    joint: int  # from zero
    label: str
    status: str
    detail: str = ""  # "near" floor, "large", within "chance", worse than "declared"
    text: str = ""  # the same in words


@dataclass(frozen=True, kw_only=True)
class Use:
    """A use of the identified robot."""

    name: str
    allowed: bool
    # why not, or what qualifies it: pairs of a code and the joints that it is true of
    causes: tuple = ()
    reason: str = ""  # the same in words


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The verdict on a robot."""

    status: str
    joints: tuple[JointVerdict, ...]
    # means of the joints that are judged: "before", "plain" and "after"; nan if
    # unknown, and so is "floor" if that of a joint is
    errors: dict
    uses: tuple[Use, ...]
    faults: tuple = ()  # messages on faulty channels
    fell: bool = True  # whether effects lowered the mean error

    def having(self, *status):
        """Return the joints of a status, a list."""
        return [one.joint for one in self.joints if one.status in status]


def judge(outcome):
    """Judge an outcome, as a `Verdict`."""
    findings, names = outcome.findings, outcome.robot["joints"]
    joints = tuple(
        JointVerdict(
            joint=j, label=words.joint_label(names, j), **_of_joint(outcome, j)
        )
        for j in range(len(outcome.errors))
    )
    faults = tuple(
        one.message
        for one in findings["channels"]
        if one.severity == "warning" and one.kind not in NO_INFORMATION
    )
    status, errors = _status(outcome, joints, faults), _mean_errors(outcome)
    fell = errors["after"] < min(errors["before"], errors["plain"])
    return Verdict(
        status=status,
        joints=joints,
        errors=errors,
        uses=_uses(outcome, status, joints),
        faults=faults,
        fell=not findings["effects"] or fell,
    )


def _of_joint(outcome, j):
    """Status of a joint, and its detail if there is one."""
    own = outcome.errors[j]
    after, floor = own.after, own.floor
    if not np.isfinite(after):
        return {"status": "no data"}
    if not own.enough:
        return {"status": "few"}
    if after >= _MEAN_TORQUE:
        return {"status": "failed"}
    if _is_worse(own, "before", "difference"):
        return {"status": "worse", "detail": "declared"}
    if _is_worse(own, "plain", "added"):
        return {"status": "worse"}
    if not own.searched:
        return {"status": "unsearched"}
    if not np.isfinite(floor):
        return {"status": "unknown"}
    if any(rest.joint == j for rest in outcome.findings["unexplained"]):
        return {"status": "unexplained"}
    least = np.nan_to_num(own.intervals["after"][0], nan=np.inf)
    near, far = (factor * floor for factor in ABOVE_FLOOR)
    # The floor does not know the error of the parameters, which held-out data shows.
    if after > far and least > near:
        return {"status": "above", "detail": "large" * (after > _LARGE)}
    if after > (near if least > floor else far):
        return {"status": "floor", "detail": "near"}
    high = own.intervals["added"][1]
    chance = j in _with_effects(outcome, "effects") and 0 <= high < np.inf
    return {"status": "floor", "detail": "chance" if chance else ""}


def _is_worse(own, error, difference):
    """Whether a joint is worse than with another model, beyond chance."""
    low = own.intervals[difference][0]
    # Without an interval the errors themselves decide.
    surely = not np.isfinite(low) or low > 0
    return surely and _rose(own, error)


def _rose(own, error, factor=_WORSE):
    """Whether the error of a joint is larger than with another model."""
    # At its noise floor no joint is worse; an unknown floor excuses nothing.
    return own.after > factor * getattr(own, error) and not own.after <= own.floor


def _status(outcome, joints, faults):
    """Name the outcome in one word, the worst that is true of any joint."""
    kinds = {v.status for v in joints} - {"no data", "few"}
    if faults:
        return "faulty"
    if kinds <= {"unsearched"}:
        return "unsearched" if kinds else "no data"
    nothing = not outcome.findings["effects"]
    for kind, both in _STATUS.items():
        if kind in kinds:
            return both[nothing]
    return "nothing" if nothing else "complete"


def _mean_errors(outcome):
    """Return the mean errors of the joints that move enough, a dict."""
    columns = {x: outcome.column(x) for x in ("before", "plain", "after", "floor")}
    used = np.isfinite(columns["before"] + columns["after"]) & outcome.column("enough")
    return {
        name: float(values[used].mean()) if used.any() else np.nan
        for name, values in columns.items()
    }


# -- uses ------------------------------------------------------------------------------


def _uses(outcome, status, joints):
    """Judge the uses of an outcome, a tuple of `Use`; reasons are codes."""
    whole = "faulty" if status == "faulty" else ""
    whole = whole or ("contradiction" if outcome.findings["contradictions"] else "")
    # An effect must not raise the error of its joint at all.
    strict = _with_effects(outcome, "effects", "possible")
    rose = []
    for own in outcome.errors:
        factor = 1.0 if own.joint in strict else _WORSE
        if _rose(own, "before", factor) or _rose(own, "plain", factor):
            rose.append(own.joint)
    large = [own.joint for own in outcome.errors if own.after > _LARGE]
    effects = (*outcome.findings["effects"], *outcome.findings["possible"])
    library = outcome.robot["library"]
    hidden = {e.joint for e in effects if library[e.name].files.simulation}
    hidden = sorted(hidden.union(outcome.robot["unsimulated"]))
    found = []
    for name, forbidden in (
        ("feedforward", _UNTRUSTED),
        ("simulation", _UNTRUSTED),
        ("collision detection", _UNTRUSTED + _ABOVE_NOISE),
    ):
        causes = {whole: []} if whole else {}
        for one in joints if not whole else ():
            # What misses half of another torque does not repeat its fit.
            why = one.status if one.status in forbidden else one.detail
            if why in (*forbidden, "large"):
                causes.setdefault(why, []).append(one.joint)
        allowed = not causes
        if allowed:
            qualified = {"large": large, "rose": rose}
            if name == "simulation":
                qualified["left out"] = hidden
            causes |= {why: own for why, own in qualified.items() if own}
            if name == "simulation" and outcome.provenance.get("export"):
                causes["approximate"] = []
        found.append(Use(name=name, allowed=allowed, causes=tuple(causes.items())))
    return (*found, *_masses(outcome, whole))


def _with_effects(outcome, *kinds):
    """Joints with effects of their own, a set."""
    effects = (one for kind in kinds for one in outcome.findings[kind])
    return {one.joint for one in effects if one.scope == "joint"}


def _masses(outcome, whole):
    """Judge the link masses, those that are identified apart from the others."""
    bodies, gains = outcome.facts_of("mass"), outcome.robot["gains"]
    if gains is not None and not gains.absolute:
        whole = whole or "relative"
    known = [b.name for b in bodies if b.source == "yes" and not whole]
    others = [b.name for b in bodies if b.name not in known]
    found = []
    for names, reason in ((known, ""), (others, whole or "masses")):
        if names:
            name = (
                f"link masses of {words.join(names, 3)}"
                if known and others
                else "link masses"
            )
            causes = ((reason, []),) if reason else ()
            found.append(Use(name=name, allowed=not reason, causes=causes))
    return tuple(found)
