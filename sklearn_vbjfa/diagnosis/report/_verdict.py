"""What an outcome amounts to: the verdict, on the robot and on each joint."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.search._gaps import ABOVE_FLOOR

# A refit moves the errors of all joints; by less than this it did no harm.
_WORSE = 1.05
# Effects that the headline names.
_NAMED = 2
# The error of whoever predicts the mean of the untouched torque and no more.
_MEAN_TORQUE = 1.0


@dataclass(frozen=True, kw_only=True)
class JointVerdict:
    """What was found out about a joint.

    Attributes
    ----------
    joint : int
        Joint, from zero.
    label : str
        What it is called in a sentence.
    status : str
        ``"floor"`` (only noise is left), ``"unexplained"``, ``"above"`` (above the
        floor on the untouched part only), ``"unknown"`` (no floor), ``"worse"``,
        ``"failed"`` (an error of 100 % or more), ``"few"`` (moves too little in the
        untouched part for a verdict) or ``"no data"``.
    n_effects : int
        Accepted effects.
    text : str
        The same in words.
    """

    joint: int
    label: str
    status: str
    n_effects: int
    text: str


def joint_verdicts(outcome):
    """Judge every joint."""
    rest = {u.joint: u for u in outcome.unexplained}
    found = []
    for j in range(len(outcome.joint_names)):
        count = sum(e.joint == j for e in outcome.effects)
        status, text = _judge(outcome, j, rest.get(j))
        found.append(
            JointVerdict(
                joint=j,
                label=words.joint_label(outcome.joint_names, j),
                status=status,
                n_effects=count,
                text=text,
            )
        )
    return tuple(found)


def _judge(outcome, j, rest):
    before, after = outcome.error_before[j], outcome.error_after[j]
    floor = outcome.floor[j]
    if not np.isfinite(after):
        return "no data", "no samples that count"
    if not outcome.enough[j]:
        seconds = words.number(outcome.seconds[j], 2)
        return "few", f"no verdict: moves for {seconds} s only"
    if after >= _MEAN_TORQUE:
        return "failed", "WORSE than its mean torque"
    low, high = interval(outcome, "difference", j)
    # Without an interval the errors themselves decide.
    surely = not np.isfinite(low) or low > 0
    if surely and after > _WORSE * before:
        return "worse", "WORSE on untouched data"
    if rest is not None:
        if not np.isfinite(rest.floor):
            return "unknown", "noise floor unknown"
        return "unexplained", f"{words.percent(rest.of_torque)} unexplained"
    if not np.isfinite(floor):
        return "unknown", "noise floor unknown"
    least = np.nan_to_num(interval(outcome, "after", j)[0], nan=np.inf)
    near, far = (factor * floor for factor in ABOVE_FLOOR)
    # The floor does not know the error of the parameters, which untouched data shows.
    if after > far and least > near:
        return "above", "above floor on untouched data"
    if after > near and least > floor:
        return "floor", f"near the floor ({after / floor:.1f} x)"
    if any(e.joint == j for e in outcome.effects) and np.isfinite(high) and high >= 0:
        return "floor", "at the floor, gain within chance"
    return "floor", "at the noise floor"


def interval(outcome, key, joint):
    """Interval of a joint, nan where there is none."""
    values = outcome.intervals.get(key)
    if values is None:
        return np.nan, np.nan
    return tuple(float(x) for x in np.asarray(values, dtype=float)[:, joint])


def mean(values):
    """Return the mean of the finite values; nan if there are none."""
    values = np.asarray(values, dtype=float)
    used = np.isfinite(values)
    return float(values[used].mean()) if used.any() else np.nan


def mean_errors(outcome):
    """Mean error before, after and floor; the floor only if every joint has one."""
    before = np.asarray(outcome.error_before, dtype=float)
    after = np.asarray(outcome.error_after, dtype=float)
    floor = np.asarray(outcome.floor, dtype=float)
    used = np.isfinite(before) & np.isfinite(after) & np.asarray(outcome.enough)
    floors = mean(floor[used]) if used.any() and np.isfinite(floor[used]).all() else 0
    return mean(before[used]), mean(after[used]), floors or np.nan


def status(outcome, verdicts):
    """Name the outcome in one word.

    ``"complete"`` (effects found, only noise left), ``"nothing"`` (nothing was
    missing), ``"partial"`` (effects found, something remains), ``"exhausted"``
    (nothing found, something remains), ``"unsettled"`` (at the floor where it was
    fitted, above it on untouched data), ``"unknown"`` (no floor to compare with),
    ``"worse"``, ``"failed"`` (worse than the mean torque), ``"no data"`` (too little to
    judge by) or ``"doubtful"`` (a channel is wrong, whatever was found).
    """
    kinds = {v.status for v in verdicts}
    if doubts(outcome):
        return "doubtful"
    if kinds <= {"no data", "few"}:
        return "no data"
    if "failed" in kinds:
        return "failed"
    if "worse" in kinds:
        return "worse"
    if "unexplained" in kinds:
        return "partial" if outcome.effects else "exhausted"
    if "above" in kinds:
        return "unsettled"
    if "unknown" in kinds:
        return "unknown"
    return "complete" if outcome.effects else "nothing"


def doubts(outcome):
    """Return what is wrong with channels so that no result can be trusted."""
    return [c.message for c in outcome.channels if c.severity == "doubt"]


def errors_text(outcome):
    """Write the mean errors as a sentence."""
    before, after, floor = mean_errors(outcome)
    if not np.isfinite(after):
        return ""
    text = f"Mean error on untouched data {words.percent(before)}"
    if outcome.effects:
        text += f" before, {words.percent(after)} after"
    wide = mean(np.where(outcome.enough, outcome.wide_after, np.nan))
    if np.isfinite(wide):
        text += (
            f" ({words.percent(wide)} up to {words.number(outcome.wide_cutoff, 2)} Hz)"
        )
    if np.isfinite(floor):
        text += f"; noise floor {words.percent(floor)}"
    return text + "."


def headline(outcome, verdicts):
    """Say in a sentence what was found and what is still open."""
    kind = status(outcome, verdicts)
    names = outcome.joint_names

    def where(status):
        joints = [v.joint for v in verdicts if v.status == status]
        return words.joint_list(names, joints), len(joints) == 1

    count = len(outcome.effects)
    found = _found(outcome)
    near = "near" if any(v.text.startswith("near") for v in verdicts) else "at"
    if kind == "doubtful":
        first, *more = doubts(outcome)
        others = f" ({words.plural(len(more), 'more doubt')} below.)" if more else ""
        return (
            f"Mend the recording first. {first}{others} Until then nothing below can "
            "be trusted."
        )
    if kind == "no data":
        return (
            "No verdict: no joint moves for long enough in the untouched part; record "
            "more motion of each joint."
        )
    if kind == "failed":
        joints, one = where("failed")
        text = (
            f"{joints} {'is' if one else 'are'} predicted worse than by "
            f"{'its' if one else 'their'} mean torque: do not trust the model there, "
            "check the recording."
        )
        return f"{found} added, but {text}" if count else _capital(text)
    few, one = where("few")
    silent = ""
    if few:
        verb = "moves" if one else "move"
        silent = f" {_capital(few)} {verb} too little for a verdict."
    if kind == "nothing":
        return f"Nothing is missing: the residual is {near} the noise floor.{silent}"
    if kind == "complete":
        return f"{found} missing; what remains is {near} the noise floor.{silent}"
    if kind in ("partial", "exhausted"):
        joints, one = where("unexplained")
        first = f"{found} missing, but that is not all"
        left = max(
            u.of_torque
            for u in outcome.unexplained
            if any(v.joint == u.joint and v.status == "unexplained" for v in verdicts)
        )
        return (
            f"{first if count else 'Something is missing that has no name'}: "
            f"{'' if one else 'up to '}{words.percent(left)} of the torque of "
            f"{joints} is above the noise floor and no effect of the library explains "
            f"it.{silent}"
        )
    if kind == "unsettled":
        return (
            f"{f'{found} missing' if count else 'No effect was found to be missing'}; "
            f"{where('above')[0]} reached the noise floor in the search but not on "
            "untouched data: record more, or look for what changed."
        )
    if kind == "worse":
        joints, one = where("worse")
        return (
            f"{found} added, but {joints} {'predicts' if one else 'predict'} untouched "
            "data worse than before: do not trust what was added there."
        )
    first = (
        f"{found} missing; whether more is"
        if count
        else ("No effect of the library was found; whether one is missing")
    )
    joints, _ = where("unknown")
    return f"{first} cannot be said, as the noise floor of {joints} is unknown."


def _found(outcome):
    """Name the first effects, which save most, and count the others; with a verb."""
    effects, names = outcome.effects, outcome.joint_names
    if not effects:
        return "0 effects were"
    told = [
        f"{words.effect_label(e.name, e.parameters, names)} on "
        f"{words.joint_label(names, e.joint)}"
        for e in effects[:_NAMED]
    ]
    if len(effects) > _NAMED:
        told.append(words.plural(len(effects) - _NAMED, "more effect"))
    verb = "was" if len(effects) == 1 else "were"
    return f"{_capital(words.join(told))} {verb}"


def _capital(text):
    """Begin a sentence."""
    return text[0].upper() + text[1:]
