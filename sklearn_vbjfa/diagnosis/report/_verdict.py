"""The verdict on a robot and on each joint, and the uses of the result, as data."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.explain import ABOVE_FLOOR
from sklearn_vbjfa.diagnosis.report import _words as words

# A refit moves the errors of all joints; a rise below this factor is no harm.
_WORSE = 1.05
# The error of predicting the mean of the held-out torque.
_MEAN_TORQUE = 1.0
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
    n_effects: int  # accepted ones
    detail: str = ""  # "near" the floor, or gain within "chance"
    text: str = ""  # the same in words


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Mean errors of the joints that are judged, over the spread; nan if unknown."""

    before: float
    plain: float
    after: float
    wide: float  # after, in the wider band
    floor: float  # known only if that of every such joint is


@dataclass(frozen=True, kw_only=True)
class Use:
    """A use of the identified robot."""

    name: str
    allowed: bool
    reason: str = ""  # why not, or for what not
    joints: tuple = ()  # pairs of a status of joints and these joints


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The verdict on a robot."""

    status: str
    joints: tuple[JointVerdict, ...]
    errors: Errors
    uses: tuple[Use, ...]
    faults: tuple = ()  # messages on faulty channels
    fell: bool = True  # whether effects lowered the mean error
    # whether a joint got worse than declared, not only than with the friction terms
    than_declared: bool = False

    def having(self, *status):
        """Return the joints of a status, a list."""
        return [one.joint for one in self.joints if one.status in status]


def judge(outcome, label):
    """Judge an outcome, as a `Verdict`; label: joint -> its name in a sentence."""
    joints = tuple(
        JointVerdict(
            joint=j,
            label=label(j),
            n_effects=sum(_belongs(e, j) for e in outcome.effects),
            **dict(zip(("status", "detail"), _of_joint(outcome, j))),
        )
        for j in range(len(outcome.joint_names))
    )
    faults = tuple(c.message for c in outcome.channels if c.severity == "doubt")
    status, errors = _status(outcome, joints, faults), mean_errors(outcome)
    worse = [one.joint for one in joints if one.status == "worse"]
    return Verdict(
        status=status,
        joints=joints,
        errors=errors,
        uses=_uses(outcome, status, joints),
        faults=faults,
        fell=not outcome.effects or errors.after < min(errors.before, errors.plain),
        than_declared=any(next(_is_worse(outcome, j)) for j in worse),
    )


def interval(outcome, key, joint):
    """Interval of a joint's error, (low, high); nan where there is none."""
    values = outcome.intervals.get(key)
    if values is None:
        return np.nan, np.nan
    return tuple(float(x) for x in np.asarray(values, dtype=float)[:, joint])


def _belongs(effect, j):
    """Whether an effect is one of a joint."""
    return effect.joint == j and effect.scope == "joint"


def _of_joint(outcome, j):
    """Status of a joint, and its detail if there is one."""
    after, floor = outcome.error_after[j], outcome.floor[j]
    if not np.isfinite(after):
        return ("no data",)
    if not outcome.enough[j]:
        return ("few",)
    if after >= _MEAN_TORQUE:
        return ("failed",)
    if any(_is_worse(outcome, j)):
        return ("worse",)
    if j in outcome.unsearched:
        return ("unsearched",)
    for rest in outcome.unexplained:
        if rest.joint == j:
            return ("unexplained" if np.isfinite(rest.floor) else "unknown",)
    if not np.isfinite(floor):
        return ("unknown",)
    least = np.nan_to_num(interval(outcome, "after", j)[0], nan=np.inf)
    near, far = (factor * floor for factor in ABOVE_FLOOR)
    # The floor does not know the error of the parameters, which held-out data shows.
    if after > far and least > near:
        return ("above",)
    if after > near and least > floor:
        return "floor", "near"
    high = interval(outcome, "added", j)[1]
    chance = any(_belongs(e, j) for e in outcome.effects) and 0 <= high < np.inf
    return "floor", "chance" if chance else ""


def _is_worse(outcome, j):
    """Yield whether a joint is worse than declared, and than with the plain terms."""
    after = outcome.error_after[j]
    # At its noise floor no joint is worse; an unknown floor excuses nothing.
    harmless = after <= outcome.floor[j]
    for error, key in (
        (outcome.error_before, "difference"),
        (outcome.error_plain, "added"),
    ):
        low = interval(outcome, key, j)[0]
        # Without an interval the errors themselves decide.
        surely = not np.isfinite(low) or low > 0
        yield surely and not harmless and after > _WORSE * error[j]


def _status(outcome, joints, faults):
    """Name the outcome in one word, the worst that is true of any joint."""
    kinds = {v.status for v in joints}
    if faults:
        return "faulty"
    if kinds <= {"no data", "few"}:
        return "no data"
    if kinds <= {"no data", "few", "unsearched"}:
        return "unsearched"
    nothing = not outcome.effects
    for kind, both in _STATUS.items():
        if kind in kinds:
            return both[nothing]
    return "nothing" if nothing else "complete"


def mean_errors(outcome):
    """Return the mean errors of the joints that move enough, as `Errors`."""
    enough = np.asarray(outcome.enough)
    used = np.isfinite(outcome.error_before) & np.isfinite(outcome.error_after) & enough
    floor = np.asarray(outcome.floor, dtype=float)[used]

    def mean(values, counts=used):
        known = np.asarray(values, dtype=float)[counts]
        known = known[np.isfinite(known)]
        return float(known.mean()) if known.size else np.nan

    return Errors(
        before=mean(outcome.error_before),
        plain=mean(outcome.error_plain),
        after=mean(outcome.error_after),
        wide=mean(outcome.wide_after, enough),
        floor=mean(outcome.floor) if np.isfinite(floor).all() else np.nan,
    )


# -- uses ------------------------------------------------------------------------------


def _uses(outcome, status, joints):
    """Judge the uses of an outcome, a tuple of `Use`; reasons are codes."""
    whole = "faulty" if status == "faulty" else ""
    whole = whole or ("contradiction" if outcome.contradictions.found else "")
    found = []
    for name, forbidden in (
        ("feedforward", _UNTRUSTED),
        ("simulation", _UNTRUSTED),
        ("collision detection", _UNTRUSTED + _ABOVE_NOISE),
    ):
        own = {}
        for one in joints if not whole else ():
            if one.status in forbidden:
                own.setdefault(one.status, []).append(one.joint)
        found.append(
            Use(
                name=name,
                allowed=not (whole or own),
                reason=whole or ("joints" if own else ""),
                joints=tuple(own.items()),
            )
        )
    return (*found, *_masses(outcome, whole))


def _masses(outcome, whole):
    """Judge the link masses, those that are identified apart from the others."""
    if not outcome.bodies:
        return ()
    if outcome.gains is not None and not outcome.gains.absolute:
        whole = whole or "relative"
    known = [b.name for b in outcome.bodies if b.known == "yes" and not whole]
    others = [b.name for b in outcome.bodies if b.name not in known]
    split = bool(known and others)
    found = []
    for names, reason in ((known, ""), (others, whole or "masses")):
        if names:
            name = f"link masses of {words.join(names, 3)}" if split else "link masses"
            found.append(Use(name=name, allowed=not reason, reason=reason))
    return tuple(found)
