"""The verdict on the robot and on each joint, and the errors."""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.diagnosis.explain import ABOVE_FLOOR
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.report._limits import (
    channel_warnings,
    contradiction,
    interval_text,
)
from sklearn_vbjfa.diagnosis.report._render import Section, Table
from sklearn_vbjfa.diagnosis.report._uses import use_lines, uses

# A refit moves the errors of all joints; a rise below this factor is no harm.
_WORSE = 1.05
# Effects up to which the headline names them.
_NAMED = 2
# The error of predicting the mean of the held-out torque and no more.
_MEAN_TORQUE = 1.0
# Joints that a terminal has room for; of more, so many that gain most and that lose.
_ROWS, _FIRST, _LAST = 8, 3, 2
# Bars end at this many times the error of the middle joint, or one would flatten all.
_FAR = 8.0
_COLOURS = {
    "complete": "good",
    "nothing": "good",
    "worse": "bad",
    "failed": "bad",
    "no data": "bad",
    "unsearched": "bad",
    "faulty": "bad",
}
_JOINT_COLOURS = {"floor": "good", "worse": "bad", "failed": "bad", "no data": "bad"}


@dataclass(frozen=True, kw_only=True)
class JointVerdict:
    """The verdict on a joint."""

    # status: "floor" (only noise is left), "unexplained", "above" (above the floor on
    # the held-out part only), "unknown" (no floor), "worse", "failed" (an error of 100
    # % or more), "few" (moves too little in the held-out part for a verdict),
    # "unsearched" (its channels show too little) and "no data".

    joint: int  # from zero
    label: str  # what it is called in a sentence
    status: str
    n_effects: int  # accepted ones
    text: str  # the same in words


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Mean errors of the joints that are judged, over the spread; nan if unknown."""

    before: float
    plain: float
    after: float
    # After, in the wider band.
    wide: float
    # Known only if that of every such joint is.
    floor: float


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The verdict on a robot; `text` is the headline with the mean errors."""

    joints: tuple[JointVerdict, ...]
    status: str
    errors: Errors
    headline: str
    text: str


def judge(outcome):
    """Judge an outcome, as a Verdict."""
    joints = tuple(_judge_joint(outcome, j) for j in range(len(outcome.joint_names)))
    status = _status(outcome, joints)
    errors = _mean_errors(outcome)
    headline = _headline(outcome, joints, status)
    apart = contradiction(outcome)
    if apart:
        # What was found is then that of no robot.
        headline = f"{apart}. {headline}"
    text = f"{headline} {_errors_sentence(outcome, errors)}".rstrip()
    return Verdict(
        joints=joints, status=status, errors=errors, headline=headline, text=text
    )


def interval(outcome, key, joint):
    """Interval of a joint's error, (low, high); nan where there is none."""
    values = outcome.intervals.get(key)
    if values is None:
        return np.nan, np.nan
    return tuple(float(x) for x in np.asarray(values, dtype=float)[:, joint])


def _judge_joint(outcome, j):
    status, text = _joint_status(outcome, j)
    return JointVerdict(
        joint=j,
        label=words.joint_label(outcome.joint_names, j),
        status=status,
        n_effects=sum(_belongs(e, j) for e in outcome.effects),
        text=text,
    )


def _belongs(effect, j):
    """Whether an effect is one of a joint."""
    return effect.joint == j and effect.scope == "joint"


def _joint_status(outcome, j):
    """Status of a joint, and the same in words."""
    after, floor = outcome.error_after[j], outcome.floor[j]
    if not np.isfinite(after):
        return "no data", "no samples that count"
    if not outcome.enough[j]:
        seconds = words.number(outcome.seconds[j], 2)
        return "few", f"no verdict: moves for {seconds} s only"
    if after >= _MEAN_TORQUE:
        return "failed", "WORSE than its mean torque"
    if any(_is_worse(outcome, j)):
        return "worse", "WORSE on held-out data"
    if j in outcome.unsearched:
        return "unsearched", "not searched: see its channels"
    for rest in outcome.unexplained:
        if rest.joint == j and np.isfinite(rest.floor):
            return "unexplained", f"{words.percent(rest.of_torque)} unexplained"
        if rest.joint == j:
            return "unknown", "noise unknown"
    if not np.isfinite(floor):
        return "unknown", "noise unknown"
    least = np.nan_to_num(interval(outcome, "after", j)[0], nan=np.inf)
    near, far = (factor * floor for factor in ABOVE_FLOOR)
    # The floor does not know the error of the parameters, which held-out data shows.
    if after > far and least > near:
        return "above", "above floor on held-out data"
    if after > near and least > floor:
        return "floor", f"near the floor ({after / floor:.1f} x)"
    high = interval(outcome, "added", j)[1]
    if any(_belongs(e, j) for e in outcome.effects) and np.isfinite(high) and high >= 0:
        return "floor", "at the floor, gain within chance"
    return "floor", "at the noise floor"


def _is_worse(outcome, j):
    """Whether a joint is worse than declared, and than with the plain terms alone."""
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


def _status(outcome, joints):
    """Name the outcome in one word, the worst that is true of any joint."""
    kinds = {v.status for v in joints}
    if channel_warnings(outcome):
        return "faulty"
    if kinds <= {"no data", "few"}:
        return "no data"
    if kinds <= {"no data", "few", "unsearched"}:
        return "unsearched"
    found = bool(outcome.effects)
    for kind, status in (
        ("failed", "failed"),
        ("worse", "worse"),
        ("unexplained", "partial" if found else "exhausted"),
        ("above", "unsettled"),
        ("unknown", "unknown"),
    ):
        if kind in kinds:
            return status
    return "complete" if found else "nothing"


def _mean(values):
    """Mean of the finite values; nan if there are none."""
    used = np.isfinite(values)
    return float(values[used].mean()) if used.any() else np.nan


def _mean_errors(outcome):
    before, plain, after, floor, wide = (
        np.asarray(values, dtype=float)
        for values in (
            outcome.error_before,
            outcome.error_plain,
            outcome.error_after,
            outcome.floor,
            outcome.wide_after,
        )
    )
    enough = np.asarray(outcome.enough)
    used = np.isfinite(before) & np.isfinite(after) & enough
    known = floor[used].any() and np.isfinite(floor[used]).all()
    return Errors(
        before=_mean(before[used]),
        plain=_mean(plain[used]),
        after=_mean(after[used]),
        wide=_mean(wide[enough]),
        floor=_mean(floor[used]) if known else np.nan,
    )


def _errors_sentence(outcome, errors):
    """Write the mean errors as a sentence; empty if they are unknown."""
    if not np.isfinite(errors.after):
        return ""
    text = f"Mean error on held-out data {words.percent(errors.before)}"
    completed = outcome.effects or outcome.possible
    if completed or outcome.added:
        text += " before"
        if outcome.added:
            text += f", {words.percent(errors.plain)} with the four friction terms"
        if completed:
            text += f", {words.percent(errors.after)} after"
    if np.isfinite(errors.wide):
        band = words.number(outcome.wide_cutoff, 2)
        text += f" ({words.percent(errors.wide)} up to {band} Hz)"
    if np.isfinite(errors.floor):
        text += f"; noise floor {words.percent(errors.floor)}"
    return text + "."


def _headline(outcome, joints, status):
    """Say in a sentence what was found and what is still open."""
    if status in ("faulty", "no data", "unsearched"):
        return _unjudged(outcome, joints, status)
    if status in ("failed", "worse", "unsettled", "unknown"):
        return _unsure(outcome, joints, status)
    found, count = _found(outcome), len(outcome.effects)
    silent = _silent(outcome, joints)
    near = "near" if any(v.text.startswith("near") for v in joints) else "at"
    if status == "nothing":
        more = ""
        if outcome.added:
            more = f"{words.capital(plain_words(outcome))} were added; beyond these n"
        if outcome.possible:
            return (
                f"{more or 'N'}o effect is certainly missing, possibly "
                f"{_named(outcome, outcome.possible)}; the residual is {near} the "
                f"noise floor.{silent}"
            )
        return (
            f"{more or 'N'}othing is missing: the residual is {near} the noise "
            f"floor.{silent}"
        )
    if status == "complete":
        text = f"the residual is now {near} the noise floor.{silent}"
        return f"{found} {_missing(outcome)}; {text}"
    which, one = _where(outcome, joints, "unexplained")
    first = "No known effect is missing, but"
    if count:
        first = f"{found} {_missing(outcome)};"
    open_joints = {v.joint for v in joints if v.status == "unexplained"}
    rest = [u for u in outcome.unexplained if u.joint in open_joints]
    worst = max(rest, key=lambda u: u.of_torque)
    noise = f"noise: {words.percent(outcome.floor[worst.joint])}"
    if not one:
        noise = f"{words.joint_label(outcome.joint_names, worst.joint)}; its {noise}"
    return (
        f"{first} {'' if one else 'up to '}{words.percent(worst.of_torque)} of the "
        f"torque of {which} remains unexplained ({noise}).{silent}"
    )


def _where(outcome, joints, kind):
    """Name the joints of a status; whether there is one only."""
    found = [v.joint for v in joints if v.status == kind]
    return words.joint_list(outcome.joint_names, found), len(found) == 1


def _unjudged(outcome, joints, status):
    """Say why nothing is judged."""
    if status == "faulty":
        first, *more = channel_warnings(outcome)
        others = f" ({words.plural(len(more), 'more warning')} below.)" if more else ""
        return (
            f"Fix the recording first. {first}{others} Until then the results below "
            "are not reliable."
        )
    if status == "no data":
        return (
            "No verdict: no joint moves for long enough in the held-out data; record "
            "more motion of each joint."
        )
    which, _ = _where(outcome, joints, "unsearched")
    return (
        f"Nothing was searched: the channels of {which} carry too little information."
    )


def _unsure(outcome, joints, status):
    """Say why the completed model is not to be trusted, or may not be complete."""
    found, count = _found(outcome), len(outcome.effects)
    if status == "failed":
        which, one = _where(outcome, joints, "failed")
        text = (
            f"{which} {'is' if one else 'are'} predicted worse than by "
            f"{'its' if one else 'their'} mean torque: do not use the model there, "
            "and check the recording."
        )
        return f"{found} added, but {text}" if count else words.capital(text)
    if status == "worse":
        which, one = _where(outcome, joints, "worse")
        what = found if count else "Possible effects were"
        if not count and outcome.added:
            what = f"{words.capital(plain_words(outcome))} were"
        declared = any(
            next(_is_worse(outcome, v.joint)) for v in joints if v.status == "worse"
        )
        than = "before" if declared else "with the friction terms alone"
        return (
            f"{what} added, but {which} {'predicts' if one else 'predict'} held-out "
            f"data worse than {than}: do not use the added effects there."
        )
    if status == "unsettled":
        which, _ = _where(outcome, joints, "above")
        return (
            f"{found if count else 'No effect was found to be'} {_missing(outcome)}; "
            f"{which} reached the noise floor in the search but not on "
            "held-out data: record more, or check what changed."
        )
    first = "No effect of the library was found; whether one is missing"
    if count:
        first = f"{found} {_missing(outcome)}; whether more is missing"
    which, _ = _where(outcome, joints, "unknown")
    return f"{first} is unknown, because the noise floor of {which} is unknown."


def _silent(outcome, joints):
    """Name the joints that nothing is known of; begins with a space, or is empty."""
    few, one = _where(outcome, joints, "few")
    silent = ""
    if few:
        verb = "moves" if one else "move"
        silent = f" {words.capital(few)} {verb} too little for a verdict."
    left_out, one = _where(outcome, joints, "unsearched")
    if left_out:
        verb = "was" if one else "were"
        silent += f" {words.capital(left_out)} {verb} not searched."
    return silent


def plain_words(outcome):
    """Name the plain terms that were added, as "offset and rotor inertia"."""
    labels = [words.effect_label(outcome, name) for name in outcome.added]
    return words.join(labels, len(labels))


def _found(outcome):
    """Name a few effects, count many; with a verb."""
    effects = outcome.effects
    if not effects:
        return "0 effects were"
    verb = "was" if len(effects) == 1 else "were"
    return f"{words.capital(_named(outcome, effects))} {verb}"


def _missing(outcome):
    """Say that effects were missing, or only that they were found."""
    errors = _mean_errors(outcome)
    if outcome.effects and errors.after >= min(errors.before, errors.plain):
        return "found, though the held-out error did not fall"
    return "missing"


def _named(outcome, effects):
    """Name a few effects; many are counted, as they are listed below."""
    if len(effects) > _NAMED:
        return words.plural(len(effects), "effect")
    return words.join(
        words.effect_at(outcome, e.name, e.joint, e.parameters) for e in effects
    )


# -- sections ---------------------------------------------------------------------


def headline(outcome, verdict):
    """Show the verdict, large, with the mean errors."""
    errors = verdict.errors
    band = words.number(outcome.wide_cutoff, 2)
    totals = [(errors.before, "mean error before")]
    if outcome.added:
        totals.append((errors.plain, "with the four friction terms"))
    totals.append((errors.after, "after, on held-out data"))
    for value, name in (
        (errors.wide, f"after, up to {band} Hz"),
        (errors.floor, "noise floor"),
    ):
        if np.isfinite(value):
            totals.append((value, name))
    causes = ""
    if any(v.status == "failed" for v in verdict.joints):
        causes = (
            "Likely causes of an error of 100 % or more: wrong sign, order or unit of "
            "the columns; a coupling between joints that is not in the model; motion "
            "too slow or too small compared with the noise, or that ends at rest."
        )
    robot = outcome.declared.get("robot") or "the robot"
    use = use_lines(uses(outcome, verdict))
    said = tuple(filter(None, (verdict.text, causes)))
    return Section(
        heading=f"Effects missing from the model of {robot}",
        sentences=(*said, *use),
        # The headline of a faulty recording has the reason against every use.
        terminal=said if verdict.status == "faulty" else (*said, *use),
        template="headline",
        drawn=dict(
            colour=_COLOURS.get(verdict.status, "warn"),
            text=verdict.headline,
            totals=tuple((words.percent(value), name) for value, name in totals),
            causes=causes,
            uses=use,
            files=outcome.provenance.files if outcome.provenance else (),
        ),
    )


def joints(outcome, verdict):
    """Tabulate the errors of the joints, the largest gain first; a page adds bars."""
    before, after = outcome.error_before, outcome.error_after
    gain = np.nan_to_num(100 * (before - after))
    order = np.argsort(-np.round(gain, 1), kind="stable")
    unit = "/".join(dict.fromkeys(outcome.torque_units))
    band = words.number(outcome.wide_cutoff, 2)
    reaches = [_reach_text(outcome, j) for j in range(len(after))]
    columns = {
        "error, %": [v.label for v in verdict.joints],
        "before": _percents(before),
        "four terms": _percents(outcome.error_plain) if outcome.added else None,
        "after [90 %]": list(map("".join, zip(_percents(after), reaches))),
        # without the sign of a zero
        "gain": _percents(np.round(before - after, 3) + 0.0),
        unit: [words.number(x, 2) for x in after * outcome.spread],
        "noise": _percents(outcome.floor),
        f"to {band} Hz": _percents(outcome.wide_after),
        "": [v.text for v in verdict.joints],
    }
    note, wide = "", bool(np.isfinite(outcome.wide_cutoff))
    if wide:
        fit = words.number(outcome.declared.get("cutoff", np.nan))
        note = (
            f" Errors are those in the band of the fit, up to {fit} Hz; those up to "
            f"{band} Hz include frequencies that were not fitted."
        )

    def table(left_out):
        heads = [h for h, cells in columns.items() if cells and h not in left_out]
        rows = tuple(tuple(columns[head][j] for head in heads) for j in order)
        return Table(heads=tuple(heads), rows=rows, numbers=True)

    unknown = () if wide else (f"to {band} Hz",)
    # A line of a terminal has room for the size in N m, or for a third error.
    short = {"gain", f"to {band} Hz", unit if outcome.added else "gain"}
    if not np.isfinite(outcome.floor).any():
        short.add("noise")
    if all(v.status == "unknown" for v in verdict.joints):
        # The headline says it.
        short.add("")
    return Section(
        heading="Error of each joint on held-out data",
        table=table(unknown),
        terminal=(_shortened(table(short)),),
        note=f"{added(outcome)}In per cent of the standard deviation of the torque in "
        "the moving time of the whole recording. Gain: before minus after. [ ]: "
        f"{interval_text(outcome.settings)}.{note}",
        template="joints",
        drawn={"joints": _bars(outcome, [verdict.joints[j] for j in order])},
    )


def _shortened(table):
    """Return a table for a terminal, without the middle of many rows."""
    rows = table.rows
    if len(rows) <= _ROWS:
        return table
    left = len(rows) - _FIRST - _LAST
    more = (f"{left} more (page)", *[""] * (len(rows[0]) - 1))
    return replace(table, rows=(*rows[:_FIRST], more, *rows[-_LAST:]))


def _percents(values):
    return [words.bare_percent(value) for value in values]


def _bars(outcome, joints):
    """Return each joint's errors as bars; places are per cent of the scale."""
    # bars: kind, length or None, whether it is cut; reach: where the interval of the
    # error after begins and how long it is, or empty.
    longest = _longest(outcome)

    def place(value):
        share = 100 * float(np.clip(value / longest, 0.0, 1.0))
        return share if np.isfinite(share) else None

    kinds = {"before": outcome.error_before}
    if outcome.added:
        kinds["plain"] = outcome.error_plain
    kinds["after"] = outcome.error_after
    found = []
    for v in joints:
        low, high = interval(outcome, "after", v.joint)
        known = np.isfinite(low) and np.isfinite(high)
        sizes = {kind: errors[v.joint] for kind, errors in kinds.items()}
        found.append(
            dict(
                colour=_JOINT_COLOURS.get(v.status, "warn"),
                bars=tuple(
                    (kind, place(size), bool(size > longest))
                    for kind, size in sizes.items()
                ),
                reach=(place(low), place(high) - place(low)) if known else (),
                floor=place(outcome.floor[v.joint]),
            )
        )
    return tuple(found)


def _longest(outcome):
    """Error at the end of the bars: a few joints far above the others are cut off."""
    sizes = np.fmax.reduce([outcome.error_before, outcome.error_after, outcome.floor])
    ends = np.ravel(outcome.intervals.get("after", []))
    everything = np.r_[sizes, ends]
    longest = np.max(everything, where=np.isfinite(everything), initial=0.0)
    sizes = np.sort(sizes[np.isfinite(sizes) & (sizes > 0)])
    if sizes.size:
        longest = min(longest, _FAR * sizes[(sizes.size - 1) // 2])
    return longest or 1.0


def _reach_text(outcome, joint):
    """Interval of a joint's error after, " [1.0, 1.2]"; empty where there is none."""
    low, high = interval(outcome, "after", joint)
    if not (np.isfinite(low) and np.isfinite(high)):
        return ""
    return f" [{words.bare_percent(low)}, {words.bare_percent(high)}]"


def added(outcome):
    """Name the friction terms that were added to the declared ones; empty for none."""
    if not outcome.added:
        return ""
    # Not "found": they are fitted on every robot, and nothing was tested.
    return (
        f"Added on every joint: {plain_words(outcome)}. With these the model has the "
        "four friction terms of most drives; they were fitted, not searched for. "
    )
