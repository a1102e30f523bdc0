"""What a page has to say beyond the outcome itself: groups, values, remedies, rows."""

import math
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.report._verdict import interval
from sklearn_vbjfa.effects import BaseTilt, JointAxis, JointZero, TorqueGain
from sklearn_vbjfa.robot._channels import HALF_WIDTH

# One of a SI unit in the unit that is read off an instrument.
_FINE = {"rad": (180.0 / math.pi, "degrees"), "m": (1e3, "mm")}
# Masses of which one is less than this share of the other do not agree.
_OTHER_MASS = 0.5
# Share of the largest value of a body that rounding leaves of a zero.
_ROUNDING = 1e-9
# Bars end at this many times the error of the middle joint, or one would flatten all.
_FAR = 8.0
# A speed below this share of the fastest is that of a reversal; an end that is this
# small a share of the other is zero.
_SLOW, _ZERO = 0.1, 1e-3
_UNITS = {"position": ("rad", "m"), "speed": ("rad/s", "m/s"), "load": ("N m", "N")}
_WHERE = {"position": "positions", "speed": "speeds", "load": "loads"}


# -- effects of the robot model -----------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Plain:
    """A parameter in a plain unit."""

    value: float
    interval: tuple | None  # 90 %
    unit: str  # "degrees", "mm" or "%"

    @property
    def text(self):
        """The value with half its interval, without the unit."""
        return words.with_error(self.value, self.interval)

    @property
    def excess(self):
        """A gain as what is read too much or too little."""
        sign = 1.0 if self.value >= 0 else -1.0
        ends = self.interval and tuple(sorted(sign * end for end in self.interval))
        size = words.with_error(abs(self.value), ends, "%")
        return f"{size} too {'much' if sign > 0 else 'little'}"


def in_model(outcome, effect):
    """Whether an effect, or what is hidden, is part of the robot model."""
    known = outcome.library.get(effect.name)
    return known is not None and known.in_model


def plain_values(effect):
    """Return the parameters of an effect in the model, symbol -> `Plain`."""
    found = {}
    for name, value in effect.parameters.items():
        if name == "gain":
            scale, shift, unit = 100.0, 1.0, "%"
        elif effect.units.get(name) in _FINE:
            (scale, unit), shift = _FINE[effect.units[name]], 0.0
        else:
            continue
        ends = effect.intervals.get(name)
        ends = ends and tuple(scale * (float(end) - shift) for end in ends)
        value = scale * (float(value) - shift)
        found[name] = Plain(value=value, interval=ends, unit=unit)
    return found


def statement(outcome, effect):
    """State an effect of the robot model by the text of its class."""
    values = plain_values(effect)
    joint = words.joint_label(outcome.joint_names, effect.joint)
    text = outcome.library[effect.name].text
    if not text:
        # A class of the user's.
        label = words.effect_label(outcome, effect.name, effect.parameters)
        parts = [f"{name} = {one.text} {one.unit}" for name, one in values.items()]
        told = ", ".join([label, *parts])
        return told if effect.scope == "robot" else f"{joint}: {told}"
    turned = [x.about for x in outcome.corrections.axes if x.joint == effect.joint]
    first, second = turned[0] if turned else ("first cross axis", "second cross axis")
    texts = {k: x.excess if k == "gain" else x.text for k, x in values.items()}
    unit = next(iter(values.values())).unit
    return text.format(joint=joint, first=first, second=second, unit=unit, **texts)


def value_cells(effect):
    """Write each parameter of an effect in the model in its plain unit, a tuple."""
    return tuple(
        one.excess
        if name == "gain"
        else f"{name.replace('_', ' ')} {one.text} {one.unit}"
        for name, one in plain_values(effect).items()
    )


def remedies(outcome):
    """Return corrections of the robot model, (name, joint) -> correction."""
    # Those that were declared are among them.
    given = outcome.corrections
    found = {(BaseTilt.name, 0): given.tilt} if given.tilt else {}
    for name, own in (
        (JointZero.name, given.zeros),
        (JointAxis.name, given.axes),
        (TorqueGain.name, given.gains),
    ):
        found |= {(name, one.joint): one for one in own}
    # Correct reported effects only, and not insignificant ones.
    possible = {(one.name, one.joint) for one in outcome.possible}
    return {
        key: one
        for key, one in found.items()
        if key not in possible and not _is_insignificant(outcome, *key)
    }


def _is_insignificant(outcome, name, joint):
    """Whether all intervals of the values of a correction contain no fault."""
    begins = f"{outcome.joint_names[joint]}:{name}:", f"{name}:"
    known = [one for one in outcome.parameters if one.name.startswith(begins)]
    return bool(known) and all(
        one.interval[0]
        <= (1.0 if one.name.endswith(":gain") else 0.0)
        <= one.interval[1]
        for one in known
    )


# -- ranges ----------------------------------------------------------------------------


def range_text(outcome, joint, quantity, pair):
    """Write a range with its unit, "-1.2 to 1.3 rad"."""
    unit = _UNITS[quantity][int(outcome.torque_units[joint] == "N")]
    width = max(map(abs, pair))
    low, high = (words.number(0.0 if abs(x) < _ZERO * width else x) for x in pair)
    if quantity == "speed" and pair[0] < _SLOW * pair[1]:
        return f"up to {high} {unit}"
    return f"{low} to {high} {unit}"


def fitted_on(outcome, effect):
    """List the ranges of motion that an effect was fitted on, where they matter."""
    known = effect.ranges
    if known is None:
        return []
    found = [
        f"{_WHERE[quantity]} of "
        f"{range_text(outcome, effect.joint, quantity, getattr(known, quantity))}"
        for quantity in known.depends
        if quantity in _UNITS
        if getattr(known, quantity)[0] <= getattr(known, quantity)[1]
    ]
    if "direction" in known.depends:
        low, high = known.direction
        found += ["forward motion only"] if low >= 0 else []
        found += ["backward motion only"] if high <= 0 and low < 0 else []
    return found


# -- groups of which the same is said --------------------------------------------------


def grouped(items, key):
    """Group items by a key, a list of (key, items) in order."""
    found = {}
    for one in items:
        found.setdefault(key(one), []).append(one)
    return list(found.items())


def unexplained_groups(outcome):
    """Group residuals above the floor, those with signals joint by joint."""
    order = sorted(outcome.unexplained, key=lambda u: (not u.floor > 0, -u.of_torque))
    groups = grouped(order, lambda u: (u.floor > 0, u.joint if u.signals else None))
    return [own for _, own in groups]


def hidden_groups(outcome):
    """Group effects that are not identifiable by whether they are in the model, why."""
    model, others = [], {"excitation": [], "signal": [], "span": [], "together": []}
    for one in outcome.hidden:
        if in_model(outcome, one) and one.reason != "span":
            model.append(one)
        else:
            others[one.reason].append(one)

    def cause(one):
        # Partners are several, one for each joint.
        return one.name, one.reason, "" if one.reason == "together" else one.remedy

    def pair(one):
        return one.name, words.other_label(outcome, one.remedy, one.name)

    found = {k: grouped(own, lambda one: one.name) for k, own in others.items()}
    return found | {
        "model": [(*key, own) for key, own in grouped(model, cause)],
        "together": [(*key, own) for key, own in grouped(others["together"], pair)],
    }


def joints_of(outcome, effect):
    """Joint of an effect, in a list; empty for what belongs to none."""
    return [] if words.of_robot(outcome, effect.name) else [effect.joint]


def to_record(outcome, signal_advice, no_period):
    """Return what to record next, the most important first, advice -> joints."""
    wanted = {no_period: []} if outcome.repeated else {}
    for rest in outcome.unexplained:
        for signal in rest.signals:
            advice = signal_advice.get(signal.signal.split(" of ")[0], "")
            wanted.setdefault(advice, []).append(rest.joint)
    for effect in outcome.effects:
        for name in (effect.name, *effect.rivals) if effect.rivals else ():
            advice = words.record_for(outcome, name)
            wanted.setdefault(advice, []).extend(joints_of(outcome, effect))
    for h in outcome.hidden:
        if h.reason == "excitation":
            advice = words.record_for(outcome, h.name) or h.remedy
            wanted.setdefault(advice, []).extend(joints_of(outcome, h))
    wanted.pop("", None)
    return wanted


# Time that decides most questions [s], and the slowest of its speeds over the fastest.
_SECONDS, _SLOWEST = 60, 0.1


def motion_plan(outcome, joints):
    """Rows of joints that are to move: range, speeds and seconds."""
    limits, rows = outcome.declared.get("limits"), []
    for j in sorted(set(joints)) if outcome.motion and limits is not None else ():
        one, (low, high, fastest) = outcome.motion[j], limits[j]
        ends = low, high
        if not np.isfinite(ends).all():
            ends = one.lowest, one.highest
        fastest = fastest if math.isfinite(fastest) else one.fastest
        rows.append(
            (
                words.joint_label(outcome.joint_names, j),
                range_text(outcome, j, "position", ends),
                range_text(outcome, j, "speed", (_SLOWEST * fastest, fastest)),
                f"{_SECONDS} s",
            )
        )
    return rows


def motion_rows(outcome):
    """Rows of what each joint does."""
    return [
        (
            words.joint_label(outcome.joint_names, j),
            range_text(outcome, j, "position", (one.lowest, one.highest)),
            f"{words.number(one.fastest)} {_UNITS['speed'][int(one.slides)]}",
            str(one.reversals),
            words.whole_percent(one.resting),
        )
        for j, one in enumerate(outcome.motion)
    ]


def poorly_shown(outcome):
    """Group joints by what their motion does not show, with the reason."""
    pairs = [(x, j) for j, one in enumerate(outcome.motion) for x in one.hides]
    return [(x, [j for _, j in own]) for x, own in grouped(pairs, lambda p: p[0])]


# -- masses ----------------------------------------------------------------------------


def agrees(mass, nominal):
    """Whether a mass may pass for that of the robot description."""
    return min(mass, nominal) >= _OTHER_MASS * max(mass, nominal)


def masses(outcome):
    """Sort the bodies by how they are known, and those that are heavier or lighter."""
    bodies, gains = outcome.bodies, outcome.gains
    # Relative masses are in another unit than those of the description.
    compared = gains is None or gains.absolute
    groups = dict(grouped(bodies, lambda b: b.known))
    odd = [b for b in bodies if compared and b.known != "yes"]
    odd = [b for b in odd if not agrees(b.mass, b.nominal)]
    odd.sort(key=lambda b: min(b.mass, b.nominal) / max(b.mass, b.nominal))
    sure = [b for b in groups.get("yes", ()) if compared]
    sure = [b for b in sure if abs(b.mass - b.nominal) > HALF_WIDTH * b.std]
    return {
        "unknown": [
            ([b.name for b in groups[known]], known)
            for known in ("no", "in combination", "from the description")
            if known in groups
        ],
        "count": len(bodies),
        "odd": odd,
        "heavier": [b for b in sure if b.mass > b.nominal],
        "lighter": [b for b in sure if b.mass < b.nominal],
    }


def forest(outcome):
    """Place identified masses on a scale from zero to twice the described ones."""
    if outcome.gains is not None and not outcome.gains.absolute:
        return []
    rows = []
    for body in (one for one in outcome.bodies if one.nominal > 0):
        half, scale = HALF_WIDTH * body.std, 50.0 / body.nominal
        ends = np.clip([body.mass - half, body.mass + half], 0.0, 2.0 * body.nominal)
        is_known = body.known != "in combination" and np.isfinite(half)
        low, high = scale * ends if is_known else (0.0, 0.0)
        rows.append(
            {
                "name": body.name,
                "value": with_half(body.mass, body.std if is_known else np.nan),
                "nominal": body.nominal,
                "place": float(np.clip(scale * body.mass, 0.0, 100.0)),
                "reach": (low, high - low) if is_known else (),
            }
        )
    return rows


def with_half(value, std, unit=""):
    """Write a value with half its 90 % interval."""
    half = HALF_WIDTH * std
    return words.with_error(value, (value - half, value + half), unit)


# -- parameters ------------------------------------------------------------------------


def parameter_groups(outcome):
    """Group the parameters by joint, a list of dict."""
    names = outcome.joint_names

    def joint_of(one):
        found = [j for j, name in enumerate(names) if one.name.startswith(f"{name}:")]
        return max(found, key=lambda j: len(names[j]), default=None)

    groups = []
    for joint, own in grouped(outcome.parameters, joint_of):
        # A prior leaves each parameter of a joint an interval of its own.
        prior = any(np.isfinite(p.before) for p in own)
        largest = {}
        for one in own:
            largest[one.unit] = max(largest.get(one.unit, 0.0), abs(one.value))
        rows = []
        for one in own:
            begin = "" if joint is None else f"{names[joint]}:"
            zero = abs(one.value) < _ROUNDING * largest[one.unit]
            ends = one.interval if one.known == "yes" or prior else None
            rows.append(
                {
                    "name": one.name.removeprefix(begin),
                    "value": words.with_error(0.0 if zero else one.value, ends),
                    "nominal": with_half(one.nominal, one.before)
                    if np.isfinite(one.nominal)
                    else "",
                    "unit": one.unit,
                    "known": one.known,
                    "learned": words.whole_percent(one.learned)
                    if np.isfinite(one.learned)
                    else "",
                }
            )
        groups.append({"joint": joint, "rows": rows, "parameters": own})
    return groups


# -- errors ----------------------------------------------------------------------------

# Joints that a terminal has room for; of more, so many that gain most and that lose.
_ROWS, _FIRST, _LAST = 8, 3, 2


def error_rows(outcome):
    """Cells of the errors of each joint, the largest gain first, a list of dict."""
    before, after = outcome.error_before, outcome.error_after
    gain = np.nan_to_num(100 * (before - after))
    percent, rows = words.bare_percent, []
    for j in np.argsort(-np.round(gain, 1), kind="stable").tolist():
        low, high = interval(outcome, "after", j)
        known = np.isfinite(low) and np.isfinite(high)
        reach = f" [{percent(low)}, {percent(high)}]" if known else ""
        cells = {
            "before": percent(before[j]),
            "four terms": percent(outcome.error_plain[j]),
            "after [90 %]": f"{percent(after[j])}{reach}",
            # Without the sign of a zero.
            "reduction": percent(np.round(before[j] - after[j], 3) + 0.0),
            "size": words.number(after[j] * outcome.spread[j], 2),
            "noise": percent(outcome.floor[j]),
            "wide": percent(outcome.wide_after[j]),
        }
        left_out = [] if outcome.added else ["four terms"]
        left_out += [] if np.isfinite(outcome.wide_cutoff) else ["wide"]
        cells = {key: text for key, text in cells.items() if key not in left_out}
        rows.append({"joint": j, "cells": list(cells.values()), "named": cells})
    return rows


def short_errors(outcome, verdicts):
    """Heads and rows of the errors for a terminal, without the middle of many."""
    # A line has room for the size in N m, or for a third error.
    left_out = ["reduction", "wide", *(["size"] if outcome.added else [])]
    if not np.isfinite(outcome.floor).any():
        left_out.append("noise")
    # The headline says what is unknown of all joints.
    silent = all(v.status == "unknown" for v in verdicts)
    heads, rows = [], []
    for row in error_rows(outcome):
        cells = {k: x for k, x in row["named"].items() if k not in left_out}
        verdict = verdicts[row["joint"]]
        heads = ["error, %", *cells, *([] if silent else [""])]
        rows.append(
            [verdict.label, *cells.values(), *([] if silent else [verdict.text])]
        )
    units = "/".join(dict.fromkeys(outcome.torque_units))
    heads = [units if head == "size" else head for head in heads]
    if len(rows) > _ROWS:
        more = f"{len(rows) - _FIRST - _LAST} more (page)"
        middle = [more, *[""] * (len(heads) - 1)]
        rows = [*rows[:_FIRST], middle, *rows[-_LAST:]]
    return heads, rows


def effects_by_label(outcome, label):
    """Rows of a terminal, the same effect on several joints in one line."""
    rows = []
    for text, same in grouped(outcome.effects, lambda e: label(e.name, e.parameters)):
        places = [words.place_label(outcome, e.name, e.joint) for e in same]
        evidence = "saves "
        evidence += words.join(words.whole_percent(e.evidence.gain) for e in same)
        if len(same) == 1:
            odds = words.odds_text(same[0].log_odds).removesuffix(" : 1")
            evidence += f", odds {odds}"
        evidence += ", has rivals" if any(e.rivals for e in same) else ""
        rows.append([f"- {words.join(places, len(places))}", text, evidence])
    return rows


def bars(outcome, joint):
    """Bars of the errors of a joint; places in per cent of the scale."""
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
    low, high = interval(outcome, "after", joint)
    known = np.isfinite(low) and np.isfinite(high)
    return {
        "bars": [
            (kind, place(x[joint]), bool(x[joint] > longest))
            for kind, x in kinds.items()
        ],
        "reach": (place(low), place(high) - place(low)) if known else (),
        "floor": place(outcome.floor[joint]),
    }


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


# -- further parts ---------------------------------------------------------------------

# Units of errors of positions, with factors to them.
FINE = {"rad": (1e3, "mrad"), "m": (1e3, "mm")}


def any_cut(outcome):
    """Whether the bar of a joint is longer than its scale."""
    joints = range(len(outcome.joint_names))
    return any(cut for j in joints for *_, cut in bars(outcome, j)["bars"])


def worst_contradiction(outcome):
    """Return the contradiction that raises an error most."""
    return max(outcome.contradictions.found, key=lambda one: one.together / one.alone)


def sizes(outcome, errors):
    """Write the mean errors of the joints that turn and of those that slide."""
    texts, units = [], outcome.commands_alone.units
    for unit in dict.fromkeys(units):
        own = np.array([x for x, other in zip(errors, units) if other == unit])
        known = np.isfinite(own).all()
        text = f"{words.sized(FINE[unit][0] * own.mean())} {FINE[unit][1]}"
        texts.append(text if known else "an unknown distance")
    return words.join(texts)


def saturated(outcome):
    """List the joints whose drive saturates, and how often."""
    shares = outcome.declared["drive"].get("saturated", ())
    return [(j, share) for j, share in enumerate(shares) if share > 0]


def culprits(outcome):
    """Return recordings that contradict the others; empty if it may be one."""
    causes = outcome.contradictions.deviations
    alone = all(len(one.recordings) == 1 for one in causes)
    return sorted({one.recordings[0] for one in causes}) if alone else []


def anchors(outcome):
    """Where each effect is drawn or explained on a page; empty if it is not."""
    drawn = outcome.curves.get("effects", ())
    if not drawn:
        return [""] * len(outcome.effects)
    return [
        "" if curves is None and effect.effect is None else f"effect-{k}"
        for k, (effect, curves) in enumerate(zip(outcome.effects, drawn), 1)
    ]
