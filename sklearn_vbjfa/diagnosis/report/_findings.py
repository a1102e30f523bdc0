"""Effects that were found, remedies, and open questions."""

import math
import re
from dataclasses import dataclass

from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.report._limits import (
    channel_warnings,
    is_measured,
    next_sentences,
)
from sklearn_vbjfa.diagnosis.report._render import Section, listed, table_of
from sklearn_vbjfa.effects import BaseTilt, JointAxis, JointZero, TorqueGain
from sklearn_vbjfa.robot._spreads import held_text

# One of a SI unit in the unit that is read off an instrument.
_FINE = {"rad": (180.0 / math.pi, "degrees"), "m": (1e3, "mm")}


@dataclass(frozen=True, kw_only=True)
class Plain:
    """A parameter in a plain unit."""

    value: float
    interval: tuple | None  # 90 %
    unit: str  # "degrees", "mm" or "%"


def in_model(outcome, effect):
    """Whether an effect that was found is part of the robot model."""
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
        interval = effect.intervals.get(name)
        if interval is not None:
            interval = tuple(scale * (float(end) - shift) for end in interval)
        found[name] = Plain(
            value=scale * (float(value) - shift), interval=interval, unit=unit
        )
    return found


def statement(outcome, effect):
    """Say what was found of the robot model, in a sentence without a full stop."""
    values = plain_values(effect)
    joint = words.joint_label(outcome.joint_names, effect.joint)
    told = outcome.library[effect.name].text
    if told:
        first, second = _about(outcome, effect)
        texts = {
            name: _too_much(one) if name == "gain" else _text(one)
            for name, one in values.items()
        }
        unit = next(iter(values.values())).unit
        return told.format(joint=joint, first=first, second=second, unit=unit, **texts)
    # One of a user's own.
    label = words.effect_label(outcome, effect.name, effect.parameters)
    parts = [f"{name} = {_text(one)} {one.unit}" for name, one in values.items()]
    told = ", ".join([label, *parts])
    return told if effect.scope == "robot" else f"{joint}: {told}"


def value_cells(effect):
    """Write each parameter in its plain unit, a tuple of str."""
    return tuple(
        f"{_too_much(plain)}"
        if name == "gain"
        else f"{name.replace('_', ' ')} {_text(plain)} {plain.unit}"
        for name, plain in plain_values(effect).items()
    )


def _text(plain):
    """Write a value with half its interval, without the unit."""
    return words.with_error(plain.value, plain.interval)


def _too_much(plain):
    """Write a gain as what is read too much or too little."""
    way = "too much" if plain.value >= 0 else "too little"
    interval = plain.interval
    if plain.value < 0 and interval is not None:
        interval = (-interval[1], -interval[0])
    return f"{words.with_error(abs(plain.value), interval, '%')} {way}"


def _about(outcome, effect):
    """Return what a turned axis is turned about."""
    for one in outcome.corrections.axes:
        if one.joint == effect.joint:
            return one.about
    return "first cross axis", "second cross axis"


# -- what to do -------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Remedy:
    """What to do about an effect of the robot model."""

    name: str
    joint: int  # from zero; 0 for what belongs to none
    text: str


def remedies(outcome):
    """Say what to do about each effect in the completed model, a tuple of `Remedy`."""
    # Those that were declared are among them.
    found = outcome.corrections
    told = [
        Remedy(name=BaseTilt.name, joint=0, text=_level(t)) for t in [found.tilt] if t
    ]
    for name, own, text in (
        (JointZero.name, found.zeros, _subtract),
        (JointAxis.name, found.axes, _turn),
        (TorqueGain.name, found.gains, _divide),
    ):
        for one in own:
            joint = words.joint_label(outcome.joint_names, one.joint)
            told.append(Remedy(name=name, joint=one.joint, text=text(one, joint)))
    # Recommend corrections for reported effects only, and not for insignificant ones.
    open_ = {(one.name, one.joint) for one in outcome.possible}
    return tuple(
        one
        for one in told
        if (one.name, one.joint) not in open_ and not _is_insignificant(outcome, one)
    )


def _is_insignificant(outcome, remedy):
    """Whether all intervals of the values of a remedy contain no fault."""
    joint = outcome.joint_names[remedy.joint] if outcome.joint_names else ""
    begins = f"{joint}:{remedy.name}:", f"{remedy.name}:"
    known = [one for one in outcome.parameters if one.name.startswith(begins)]
    return bool(known) and all(
        one.interval[0]
        <= (1.0 if one.name.endswith(":gain") else 0.0)
        <= one.interval[1]
        for one in known
    )


def _level(tilt):
    """Say what to do about a base that is not level."""
    roll, pitch, _ = tilt.lean_rpy_degrees
    return (
        "level the base, which leans the opposite way (roll "
        f"{_hundredths(roll)}, pitch {_hundredths(pitch)} degrees), or mount it so in "
        f"the robot description (rpy {_rpy(tilt.lean_rpy)})"
    )


def _subtract(zero, joint):
    """Say what to do about a zero."""
    off = f"{_hundredths(zero.plain)} {zero.plain_unit}"
    return f"subtract {off} from the encoder reading of {joint}"


def _turn(axis, joint):
    """Say what to do about an axis."""
    return (
        f"take the rpy of the origin of {joint} from the URDF that is written "
        f"({_rpy(axis.new_rpy)} instead of {_rpy(axis.old_rpy)})"
    )


def _divide(gain, joint):
    """Say what to do about the gain of a channel."""
    return f"divide the torque of {joint} by {gain.gain:.4g}"


def _hundredths(value):
    """Write an angle in degrees or a length in mm."""
    return f"{value:.2f}"


def _rpy(angles):
    """Write three angles [rad] as a URDF has them, to a thousandth of a degree."""
    # Without the sign of a zero.
    return f'"{" ".join(f"{round(angle, 5) + 0.0:.5f}" for angle in angles)}"'


# Channels of which a terminal names what is wrong.
_CHANNELS = 2
# Characters that a terminal has for what to record, and for what an effect is called.
_ADVICE, _LABEL = 40, 34
_NO_PERIOD = "a motion that does not repeat (design makes one)"
_WHERE = {"position": "positions", "speed": "speeds", "load": "loads"}
# A speed below this share of the fastest is that of a reversal.
_SLOW = 0.1
# An end that is this small a share of the other is zero.
_ZERO = 1e-3
_UNITS = {"position": ("rad", "m"), "speed": ("rad/s", "m/s"), "load": ("N m", "N")}

# -- effects ----------------------------------------------------------------------


def effects(outcome, verdict):
    """Tabulate the effects that were found."""
    sentences, short, rows = [], [], []
    for e in outcome.effects:
        joint, label, rivals = _called(outcome, e)
        if in_model(outcome, e):
            first, parameters = statement(outcome, e), value_cells(e)
        else:
            parameters = words.parameter_text(e)
            first = ", ".join([f"{joint}: {label}", *parameters])
        gain, odds = words.whole_percent(e.evidence.gain), words.odds_text(e.log_odds)
        told = [f"- {first}", f"saves {gain}, odds {odds}"]
        if rivals:
            told.append(f"indistinguishable from {words.join(rivals, 2, 'or')}")
        known = tuple(filter(None, [_known_for(outcome, e), _afterwards(e)]))
        told += known
        sentences.append("; ".join(told))
        short.append(
            (joint, _short_label(label), gain, odds.removesuffix(" : 1"), rivals)
        )
        gain += f" +- {words.whole_percent(e.evidence.gain_std)}"
        cannot = words.join(rivals, len(rivals), "or")
        rows.append((joint, label, (*parameters, *known), gain, odds, cannot))
    heads = ("joint", "effect", "parameters (90 %)", "squared error saved", "odds")
    shown = anchors(outcome)
    links = tuple(f"#{anchor}" if anchor else "" for anchor in shown)
    return Section(
        heading="Effects that were missing",
        table=table_of((*heads, "indistinguishable from"), rows, links=links),
        terminal=listed(sentences, [*_by_label(short)]),
    )


def _by_label(effects):
    """Yield cells of a terminal, the same effect on several joints in one line."""
    found = {}
    for joint, label, *evidence in effects:
        found.setdefault(label, []).append((joint, *evidence))
    for label, same in found.items():
        joints, gains, odds, rivals = zip(*same)
        evidence = f"saves {words.join(gains)}"
        evidence += f", odds {odds[0]}" if len(same) == 1 else ""
        evidence += ", has rivals" if any(rivals) else ""
        yield f"- {words.join(joints, len(joints))}", label, evidence


def _short_label(label):
    """Call an effect so that it has room in a line of a terminal."""
    label = words.without_asides(label)
    return label.partition(": ")[0] if len(label) > _LABEL else label


def _called(outcome, effect):
    """Return the place, the label and the rivals of an effect."""
    return (
        words.place_label(outcome, effect.name, effect.joint),
        words.effect_label(outcome, effect.name, effect.parameters),
        [words.other_label(outcome, rival, effect.name) for rival in effect.rivals],
    )


def possible(outcome, verdict):
    """Tabulate effects that are more probable than not and are not named."""
    rows, told = [], []
    for e in outcome.possible:
        joint, label, rivals = _called(outcome, e)
        probability = words.probability_text(e.probability)
        cell = tuple(words.parameter_text(e))
        cannot = words.join(rivals, len(rivals), "or")
        rows.append((joint, label, cell, probability, e.warning, cannot))
        at = "" if joint == "robot" else f" on {joint}"
        told.append(f"{_short_label(label)}{at} ({probability})")
    # The page has the others.
    short = f"- possible: {words.first_of(told)}" if told else ""
    heads = ("joint", "effect", "parameters (90 %)", "probability", "reason")
    return Section(
        heading="Possible effects",
        table=table_of((*heads, "indistinguishable from"), rows),
        note="Part of the completed model; excluding them would not improve it."
        if rows
        else "",
        terminal=tuple(filter(None, [short])),
    )


def to_do(outcome, verdict):
    """State what to correct, what to record, and what to expect, in this order."""
    own = [e for e in outcome.effects if in_model(outcome, e)]
    to_mend = {(one.name, one.joint): one.text for one in remedies(outcome)}
    mend = words.join(to_mend.values(), len(to_mend))
    told = []
    for e in own:
        said = [statement(outcome, e), to_mend.pop((e.name, e.joint), "")]
        told.append(". ".join(map(words.capital, filter(None, said))))
    # The others were declared.
    told += map(words.capital, to_mend.values())
    rows = [
        (
            *_called(outcome, e)[:2],
            value_cells(e),
            tuple(words.parameter_text(e)),
        )
        for e in own
    ]
    channels = [" ".join(c.message.split()) for c in outcome.channels]
    # The headline has the first fault; of the others a terminal has the subject.
    first = " ".join("".join(channel_warnings(outcome)[:1]).split())
    short = [
        message if c.severity == "doubt" else f"{_subject(message)}."
        for c, message in zip(outcome.channels, channels)
        if message != first
    ]
    record, expected = recordings(outcome), next_sentences(outcome)
    shown = [f"Channel: {message}" for message in short[:_CHANNELS]]
    if len(short) > _CHANNELS:
        shown.append(f"Channel: {len(short) - _CHANNELS} more (page).")
    shown += [f"To correct: {mend}."] if mend else []
    if record:
        shown.append(f"Record next: {words.first_of(_recordings(outcome, most=0))}.")
    return Section(
        heading="Next steps",
        sentences=(
            *(f"Channel: {message}" for message in channels),
            *(f"{text}." for text in told),
            *(f"Record {text}." for text in record),
            *expected,
        ),
        table=table_of(("joint", "effect", "value (90 %)", "in SI units"), rows),
        note="The completed model includes these corrections and takes positions and "
        "torques as recorded."
        if own
        else "",
        # What is assumed is no finding of this recording: the page has it.
        terminal=(*shown, *(expected if is_measured(outcome) else ())),
    )


def _subject(message):
    """Return the first clause of a message."""
    return re.split("[:,;] ", message)[0].rstrip(".")


def outside(outcome, verdict):
    """Say where the held-out part leaves what effects were fitted on."""
    sentences = _outside_sentences(outcome)
    held = held_text(outcome.outside, lambda name: words.effect_label(outcome, name))
    return Section(
        heading="Outside the range of the fit, on held-out data",
        sentences=(*sentences, *([f"{held}."] if held else [])),
    )


def anchors(outcome):
    """Return where each effect is drawn or explained on a page, a tuple of str."""
    # Empty for one that is neither.
    drawn = outcome.curves.get("effects", ())
    if not drawn:
        return ("",) * len(outcome.effects)
    return tuple(
        "" if curves is None and effect.effect is None else f"effect-{k}"
        for k, (effect, curves) in enumerate(zip(outcome.effects, drawn), 1)
    )


def _range_text(outcome, joint, quantity, pair):
    """Write a range with its unit, "-1.2 to 1.3 rad"."""
    unit = _UNITS[quantity][int(outcome.torque_units[joint] == "N")]
    width = max(map(abs, pair))
    low, high = (words.number(0.0 if abs(x) < _ZERO * width else x) for x in pair)
    if quantity == "speed" and pair[0] < _SLOW * pair[1]:
        return f"up to {high} {unit}"
    return f"{low} to {high} {unit}"


def _one_way(known):
    """Return the direction in which a joint moved; empty if both."""
    low, high = known.direction
    if low >= 0:
        return "forward motion only"
    return "backward motion only" if high <= 0 else ""


def _known_for(outcome, effect):
    """Say for which motion an effect is known; empty where it does not matter."""
    known = effect.ranges
    if known is None:
        return ""
    told = [
        f"{_WHERE[quantity]} of "
        f"{_range_text(outcome, effect.joint, quantity, getattr(known, quantity))}"
        for quantity in known.depends
        if quantity in _UNITS
        if getattr(known, quantity)[0] <= getattr(known, quantity)[1]
    ]
    if "direction" in known.depends:
        told += filter(None, [_one_way(known)])
    return f"fitted on {words.join(told)}" if told else ""


def _outside_sentences(outcome):
    """Say where the held-out part leaves what effects were fitted on."""
    found = []
    for one in outcome.outside:
        labels = [words.effect_label(outcome, name) for name in one.names]
        if one.quantity == "direction":
            way = "forward" if one.reached > 0 else "backward"
            what = f"moves {way}, fitted on the other direction only"
        else:
            fitted = _range_text(outcome, one.joint, one.quantity, one.fitted)
            reached = words.number(one.reached)
            what = f"{one.quantity} reaches {reached}, fitted on {fitted}"
        found.append(
            f"{words.joint_label(outcome.joint_names, one.joint)}: {what} "
            f"({words.percent(one.share)} of the rows; {words.join(labels)})"
        )
    return tuple(found)


def _afterwards(effect):
    """Say what an effect of time is taken to do after the recording; else empty."""
    known = effect.afterwards
    if known is None:
        return ""
    when = f"after {words.number(known.seconds)} s"
    left = [
        words.with_error(value, known.intervals.get(name), effect.units.get(name, ""))
        for name, value in known.left.items()
    ]
    return f"{when} it {known.how}" + (f" from {words.join(left)}" if left else "")


# -- what remains -----------------------------------------------------------------


def unexplained(outcome, verdict):
    """List residuals above the noise floor."""
    names = outcome.joint_names
    order = sorted(outcome.unexplained, key=lambda u: (not u.floor > 0, -u.of_torque))
    sentences = []
    for group in _unexplained_groups(outcome, order):
        first = group[0]
        joints = words.joint_list(names, [u.joint for u in group])
        shares = [words.percent(share) for share in sorted(u.of_torque for u in group)]
        share = f"{' to '.join(dict.fromkeys([shares[0], shares[-1]]))} of the torque"
        share += " remains unexplained"
        if not first.floor > 0:
            share += ", noise floor unknown"
        sentences.append(f"{joints}: {share}; {_of_the_rest(outcome, group)}")
    return Section(
        heading="Unexplained",
        sentences=tuple(sentences),
    )


def _of_the_rest(outcome, group):
    """List the signals that residuals depend on."""
    first = group[0]
    signals = [
        f"{words.signal_label(s.signal, outcome.joint_names, first.joint)} "
        f"({words.whole_percent(s.share)})"
        for s in first.signals
    ]
    if signals:
        return f"correlated with {words.join(signals, 3)}"
    recorded = outcome.settings.get("signals", ())
    signals = ["position", "speed", "acceleration", "load", "time", *recorded]
    return f"not correlated with {words.join(signals, 8, 'or')}"


def _unexplained_groups(outcome, unexplained):
    """Put joints together of which the same is said, but for sizes."""
    groups = {}
    for u in unexplained:
        said = u.joint if u.signals else None
        groups.setdefault((u.floor > 0, said), []).append(u)
    return groups.values()


# -- what to record ---------------------------------------------------------------


def recordings(outcome):
    """Say what to record next, what matters most first, without repetition; a list."""
    return _recordings(outcome, most=3)


def _recordings(outcome, most):
    """Say what to record next, with the names of so many joints; a list."""
    wanted = dict.fromkeys([_NO_PERIOD] if outcome.repeated else [], ())
    for rest in outcome.unexplained:
        for signal in rest.signals:
            advice = words.record_for_signal(signal.signal)
            wanted.setdefault(advice, []).append(rest.joint)
    for effect in outcome.effects:
        for name in (effect.name, *effect.rivals) if effect.rivals else ():
            where = wanted.setdefault(words.record_for(outcome, name), [])
            where += _own_joint(outcome, effect)
    for h in outcome.hidden:
        if h.reason == "excitation":
            advice = words.record_for(outcome, h.name) or h.remedy
            wanted.setdefault(advice, []).extend(_own_joint(outcome, h))
    found = []
    for advice, joints in wanted.items():
        where = words.joint_list(outcome.joint_names, joints, most)
        if not most and len(advice) > _ADVICE:
            advice = advice.partition(", ")[0]
        if advice:
            found.append(f"{advice} ({where})" if where else advice)
    return found


def _own_joint(outcome, effect):
    """Joint of an effect, in a list; an empty one for what belongs to none."""
    found = outcome.library.get(effect.name)
    return [] if found is not None and found.scope == "robot" else [effect.joint]


def hidden(outcome, verdict):
    """List effects that are not identifiable, in a sentence for each reason."""
    sentences = list(_model_sentences(outcome))
    rest = [h for h in outcome.hidden if not _is_of_model(outcome, h)]
    for reason, title, because in (
        ("excitation", "Not excited in this recording:", ""),
        ("signal", "Not searched for:", "; {}"),
        ("span", "Not identifiable by any motion:", " (absorbed by other parameters)"),
    ):
        own = [h for h in rest if h.reason == reason]
        of_model = _model_parts(outcome, reason) if reason == "span" else []
        if not (own or of_model):
            continue
        by_effect = {}
        for h in own:
            by_effect.setdefault(h.name, []).append(h.joint)
        parts = [
            f"{words.effect_label(outcome, name)} "
            f"({words.joint_list(outcome.joint_names, joints)})"
            for name, joints in by_effect.items()
        ]
        parts = [*of_model, *parts]
        because = because.format(words.join(sorted({h.remedy for h in own}), 2))
        sentences.append(f"{title} {words.join(parts, len(parts))}{because}.")
    sentences += _together_sentences(outcome, rest)
    return Section(
        heading="Not identifiable from this recording", sentences=tuple(sentences)
    )


def _is_of_model(outcome, hidden):
    """Whether what is hidden is an effect of the robot model."""
    known = outcome.library.get(hidden.name)
    return known is not None and known.in_model


def _model_sentences(outcome):
    """List effects of the robot model that are not identifiable, tuple of str."""
    # Those that no motion can show are reported elsewhere: `_model_parts`.
    groups = {}
    for one in outcome.hidden:
        if _is_of_model(outcome, one) and one.reason != "span":
            # Partners are several, one for each joint.
            why = "" if one.reason == "together" else one.remedy
            groups.setdefault((one.reason, one.name, why), []).append(one)
    return tuple(
        _unseen(outcome, reason, name, why, own)
        for (reason, name, why), own in groups.items()
    )


def _model_parts(outcome, reason):
    """Name the effects of the robot model that are hidden for a reason, a list."""
    groups = {}
    for one in outcome.hidden:
        if _is_of_model(outcome, one) and one.reason == reason:
            groups.setdefault(one.name, []).append(one)
    return [_what(outcome, name, own) for name, own in groups.items()]


def _unseen(outcome, reason, name, why, own):
    """State why an effect is not identifiable on some joints."""
    what = words.capital(_what(outcome, name, own))
    if reason == "signal":
        return f"{what} was not searched for: {why}."
    if reason == "together":
        partners = dict.fromkeys(
            words.other_label(outcome, one.remedy, name) for one in own
        )
        return (
            f"{what} is indistinguishable from {words.join(partners, 4)}: only the sum "
            "is identifiable."
        )
    needed = f": it needs {why}" if why else ""
    return f"{what} is not identifiable from this recording{needed}."


def _what(outcome, name, own):
    """Name an effect on some joints as the subject of a sentence."""
    joints = [one.joint for one in own]
    where = words.joint_list(outcome.joint_names, joints)
    subject = outcome.library[name].subject
    if subject:
        return subject[len(set(joints)) > 1].format(where)
    label = words.effect_label(outcome, name)
    if words.place_label(outcome, name, joints[0]) == "robot":
        return label
    return f"{label} on {where}"


def _together_sentences(outcome, hidden):
    """List other effects that are identifiable in combination only."""
    found = {}
    for one in hidden:
        if one.reason == "together":
            key = (one.name, words.other_label(outcome, one.remedy, one.name))
            found.setdefault(key, []).append(one.joint)
    parts = [
        f"{words.effect_label(outcome, name)} "
        f"({words.joint_list(outcome.joint_names, joints)}) with {partner}"
        for (name, partner), joints in found.items()
    ]
    if not parts:
        return []
    return [f"Only their sum is identifiable: {words.join(parts, len(parts))}."]
