"""Limits of the figures of a report, and identifiability."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.report._render import Section, Table, table_of
from sklearn_vbjfa.effects import CommandDelay, Offset, Payload
from sklearn_vbjfa.robot._gains import HALF_WIDTH, PAYLOAD

# Share of a value that rounding leaves of it.
_ZERO = 1e-9
# Masses of which one is less than this share of the other do not agree.
_OTHER_MASS = 0.5
_PAYLOAD = (
    "; a known payload that is picked up or put down in the recording, or between two "
    "of them, can (--known-mass payload=KG)"
)
_NOT_SHOWN = (
    "The relative gains of the torque channels are not identifiable from this "
    "recording: no two channels feel enough of the same bodies."
)


def interval_text(settings):
    """Say what the interval of an error holds."""
    if "error_seconds" not in settings:
        return "90 %"
    seconds = words.number(settings["error_seconds"], 2)
    return f"90 % of errors over the next {seconds} s of such motion"


# -- the projection ---------------------------------------------------------------


def projection_sentences(outcome, verdict):
    """Say what physically consistent parameters cost, and where that comes from."""
    cost = outcome.projection
    if cost is None or not cost.costs.any():
        return ()
    names = outcome.joint_names
    costs = [
        f"{words.joint_label(names, j)} from {words.bare_percent(cost.free[j])} to "
        f"{words.percent(cost.held[j])}"
        for j in np.flatnonzero(cost.costs)
    ]
    return (
        f"Physical consistency raises the error of {words.join(costs, 6)}.",
        "Possible causes: a wrong gain of the torque channel, a wrong geometry or a "
        "missing effect.",
    )


# -- masses -----------------------------------------------------------------------


def mass_sentences(outcome, verdict):
    """Name masses that are not identifiable or differ from the description."""
    bodies, gains = outcome.bodies, outcome.gains
    if gains is not None and not gains.absolute:
        # In another unit than those of the description.
        bodies = [replace(b, nominal=b.mass) for b in bodies]
    departed = [_departure(one, outcome.common_size) for one in outcome.departures]
    size = _common_size(outcome.common_size)
    return tuple(filter(None, (_unknown(bodies), _other(bodies), size, *departed)))


def _common_size(factor):
    """Say by how much all bodies together differ from the description, if they do."""
    if _alike(factor, 1.0):
        return ""
    return (
        f"All bodies: {words.number(factor)} times the described masses; the unit of "
        "the masses or of the torques may differ."
    )


def _departure(one, common):
    """Name the body that differs from the description, or the candidates."""
    found = [f"{name} ({times})" for name, times in _factors(one)]
    what = "described mass"
    if not _alike(common, 1.0):
        what = "mass expected from the other bodies"
    if len(found) == 1:
        return f"Body of {found[0]}: differs from the {what}."
    return (
        f"One body differs from the {what}: that of {words.join(found, 6, 'or')}; the "
        "torques do not distinguish them."
    )


def alike(outcome, verdict):
    """Tabulate parameters of joints with the same drive, and name exceptions."""
    rows, others = [], []
    for one in outcome.alike:
        label = words.effect_label(outcome, one.parameter.partition(":")[0])
        if one.joints:
            half = HALF_WIDTH * one.std
            interval = one.value - half, one.value + half
            scatter = ""
            if np.isfinite(one.scatter):
                scatter = words.whole_percent(one.scatter)
            value = words.with_error(one.value, interval)
            count = str(len(one.joints))
            rows.append((one.group, label, value, one.unit, scatter, count))
        others += [_not_alike(other, label, one.group) for other in one.apart]
    heads = ("joints", "parameter", "mean (90 %)", "unit", "scatter")
    return Section(
        heading="Joints with the same drive",
        sentences=tuple(others),
        table=table_of((*heads, "number of joints"), rows),
    )


def _not_alike(one, label, group):
    """Name the joint that differs from those with the same drive."""
    found = [f"{name} ({times})" for name, times in _factors(one)]
    if len(found) == 1:
        return f"The {label} of {found[0]} differs from the other {group} joints."
    return (
        f"The {label} of one of the {group} joints differs from the others: of "
        f"{words.join(found, 6, 'or')}; the torques do not distinguish them."
    )


def _factors(one):
    """Yield the names and factors, with errors, of a `Departure`."""
    for name, factor, std in zip(one.bodies, one.factors, one.stds):
        half = HALF_WIDTH * std
        yield name, f"{words.with_error(factor, (factor - half, factor + half))} times"


def _unknown(bodies):
    """Name the masses that the recording does not determine."""
    alone = [b for b in bodies if b.known == "no"]
    together = [b for b in bodies if b.known == "in combination"]
    described = [b for b in bodies if b.known == "from the description"]
    if not alone and not together and not described:
        return ""
    parts = []
    if alone:
        parts.append(f"{_names(alone, bodies)} (not at all)")
    if together:
        parts.append(f"{_names(together, bodies)} (in combination only)")
    if described:
        parts.append(f"{_names(described, bodies)} (near the description)")
    text = f"Masses that are not identifiable: {'; '.join(parts)}."
    text += " The exported values reproduce the torques"
    odd = [b for b in bodies if b.known != "yes" and not _alike(b.mass, b.nominal)]
    odd.sort(key=lambda b: min(b.mass, b.nominal) / max(b.mass, b.nominal))
    values = [
        f"{b.name} {words.number(b.mass)} kg (described: {words.number(b.nominal)} kg)"
        for b in odd
    ]
    return f"{text}: {words.join(values)}." if values else f"{text}."


def _names(bodies, all_of_them):
    """Write the names of bodies; one word for all."""
    if len(bodies) == len(all_of_them) > 1:
        return "all bodies"
    return words.join([b.name for b in bodies], 6)


def _alike(mass, nominal):
    """Whether a mass may pass for that of the robot description."""
    return min(mass, nominal) >= _OTHER_MASS * max(mass, nominal)


def _other(bodies):
    """Name masses that are measured and are not those of the robot description."""
    heavy, light = [], []
    for body in bodies:
        off = body.mass - body.nominal
        half = HALF_WIDTH * body.std
        if body.known == "yes" and abs(off) > half:
            value = words.with_error(body.mass, (body.mass - half, body.mass + half))
            text = f"{body.name} {value} kg instead of {words.number(body.nominal)} kg"
            (heavy if off > 0 else light).append(text)
    parts = [
        f"{way} than in the robot description: {words.join(found, 6)}"
        for way, found in (("heavier", heavy), ("lighter", light))
        if found
    ]
    return f"{words.capital('; '.join(parts))}." if parts else ""


# -- recordings -------------------------------------------------------------------


def recording_sentences(outcome, verdict):
    """Say first what is wrong with recordings, then what their motion leaves open."""
    return (
        *contradiction_sentences(outcome),
        *repeated_sentences(outcome),
        *motion_sentences(outcome),
        *looked_at_sentences(outcome),
    )


def looked_at_sentences(outcome):
    """State how much of a long recording the search used."""
    one = outcome.recorded
    if one is None or not one.looked_at:
        return ()
    return (
        f"The search used {one.looked_at:,} of {one.samples:,} samples; fits and "
        "errors use all.",
    )


def next_sentences(outcome):
    """State the predicted error on the next recording, and its basis."""
    one = outcome.next_recording
    if one is None or not np.isfinite(one.mean):
        return ()
    low, high = map(words.bare_percent, one.mean_interval)
    text = f"Next recording: predicted error {words.percent(one.mean)} "
    text += f"[{low}, {high}]"
    if one.source == "assumed":
        return (f"{text}, from other robots; record another motion to measure it.",)
    also = ", other robots" if one.source == "mixed" else ""
    basis = f"{one.recordings} left out{also}"
    return (f"{text} ({basis}).",)


def is_measured(outcome):
    """Whether the error to expect rests on recordings of this robot."""
    one = outcome.next_recording
    return one is not None and one.source != "assumed"


def repeated_sentences(outcome):
    """State which motion repeats, and the consequences."""
    if not outcome.repeated:
        return ()
    texts = [_repeated(one, outcome.recordings) for one in outcome.repeated]
    return (
        f"Repeated motion: {words.join(texts, 4)}. Model errors repeat with it, also "
        "in the held-out data: effects are judged between the phases of the motion, "
        "and the errors apply to this motion only.",
    )


def _repeated(one, names):
    """Say how often a motion is there, and where if not everywhere."""
    often = f"one of {words.number(one.seconds)} s, {one.count:.3g} times"
    if len(names) < 2 or len(one.recordings) == len(names):
        return often
    own = words.join([names[r] for r in one.recordings], 8)
    many = "recordings" if len(one.recordings) > 1 else "recording"
    return f"{often} in {many} {own}"


def motion_sentences(outcome):
    """State what is not identifiable for lack of motion."""
    by_kind = {}
    for limit in outcome.motion_limits:
        by_kind.setdefault((limit.kind, limit.recordings), []).append(limit)
    return tuple(
        _motion(outcome, kind, recordings, limits)
        for (kind, recordings), limits in by_kind.items()
    )


def _motion(outcome, kind, recordings, limits):
    """State what a motion lacks, in which recordings, and the consequences."""
    names = outcome.joint_names
    one = len(limits) == 1
    joints = words.capital(words.joint_list(names, [x.joint for x in limits]))
    where = _where(outcome, recordings, kind)
    if kind == "one way":
        return (
            f"{joints} never {'reverses' if one else 'reverse'}{where}: Coulomb "
            "friction and an offset are indistinguishable, and hysteresis, backlash "
            "and asymmetric friction are not identifiable."
        )
    ranges = words.join([_range_of(outcome, x) for x in limits], 3)
    verb = "keeps" if one else "keep"
    if kind == "one speed":
        return (
            f"{joints} {verb} to one speed{where} ({ranges}): viscous and Coulomb "
            "friction are nearly indistinguishable, and friction at other speeds is "
            "extrapolated."
        )
    what = "the weight of its link and an offset" if one else "weight and offsets"
    return (
        f"{joints} {verb} to one pose{where} ({ranges}): {what} are indistinguishable, "
        "and springs and ripple are not identifiable."
    )


def _where(outcome, recordings, kind):
    """Say in which recordings; nothing where there is one only."""
    if len(outcome.recordings) < 2:
        return " in this recording"
    if len(recordings) == len(outcome.recordings):
        return " in any recording" if kind == "one way" else " in all recordings"
    return f" in {_recordings(outcome, recordings)}, and moves in no other"


def _range_of(outcome, limit):
    """Write a range of speed or position with its unit."""
    slides = outcome.torque_units[limit.joint] == "N"
    if limit.kind == "one speed":
        unit = "m/s" if slides else "rad/s"
        return f"{words.number(limit.low)} to {words.number(limit.high)} {unit}"
    return (
        f"{words.number(np.degrees(limit.low))} to "
        f"{words.number(np.degrees(limit.high))} degrees"
    )


def _recordings(outcome, numbers):
    """Write which recordings, by number or by label."""
    names = [outcome.recordings[k] for k in sorted(set(numbers))]
    noun = "recording" if len(names) == 1 else "recordings"
    return f"{noun} {words.join(names, 6)}"


def contradiction(outcome):
    """Name recordings that contradict each other, without a full stop."""
    found = outcome.contradictions.found
    if not found:
        return ""
    joints = words.joint_list(outcome.joint_names, [one.joint for one in found])
    causes = outcome.contradictions.deviations
    own = sorted({one.recordings[0] for one in causes if len(one.recordings) == 1})
    if len(outcome.recordings) == 2:
        first = f"recordings {words.join(outcome.recordings)} contradict each other"
    elif own and all(len(one.recordings) == 1 for one in causes):
        verb = "contradicts" if len(own) == 1 else "contradict"
        first = f"{_recordings(outcome, own)} {verb} the others"
    else:
        first = "the recordings contradict each other"
    return words.capital(f"{first} on {joints}")


def contradiction_sentences(outcome):
    """Name recordings inconsistent with the others, and the differing parameter."""
    found = outcome.contradictions.found
    if not found:
        return ()
    names = outcome.joint_names
    worst = max(found, key=lambda one: one.together / one.alone)
    joint = words.joint_label(names, worst.joint)
    number = _recordings(outcome, [worst.recording])
    first = (
        f"{contradiction(outcome)}: a fit to {number} alone predicts {joint} there to "
        f"{words.percent(worst.alone)} of its torque, one to all of them only to "
        f"{words.percent(worst.together)} (both on parts that were not fitted)."
    )
    causes = outcome.contradictions.deviations
    share = "it" if len(causes) == 1 else "part of it"
    causes = (_cause(outcome, one, share) for one in causes)
    last = (
        "No single robot has these torques: correct the recording, or identify the "
        "recordings separately."
    )
    return (first, *causes, last)


# Alternative causes.
_KINDS = {
    Offset.name: "an offset",
    "gain": "a gain",
    "friction": "different friction",
    Payload.name: "a different load",
    "model": "a different robot",
}


def _cause(outcome, cause, share):
    """State the difference of one recording, or of each, as a sentence."""
    joints = words.joint_list(outcome.joint_names, cause.joints)
    known = np.isfinite(cause.value)
    unit = outcome.torque_units[cause.joints[0]]
    if cause.name == "model":
        what = "more than a gain, an offset, friction or the load differs"
    elif cause.name == Payload.name:
        what = "a different load"
    elif cause.name == "friction":
        what = f"different friction of {joints}"
    elif cause.name == Offset.name and cause.scatters:
        what = (
            f"an offset of {joints} that scatters by {words.number(cause.value)} {unit}"
        )
    elif cause.name == Offset.name:
        what = f"an offset of {words.number(cause.value)} {unit} on {joints}"
    elif cause.scatters:
        what = f"a gain of {joints} that scatters by {words.percent(cause.value)}"
    elif known:
        times = words.number(cause.value)
        what = f"a torque of {joints} that is {times} times as large"
    else:
        what = f"a different gain of the torques of {joints}"
    what = f"{what} {_where_another(outcome, cause)}"
    rivals = words.join([_KINDS[name] for name in cause.rivals], word="or")
    rivals = f"; {rivals} would explain nearly as much" if cause.rivals else ""
    odds = words.odds_text(cause.log_odds)
    return f"{words.capital(what)} accounts for {share} (odds {odds}{rivals})."


def _where_another(outcome, cause):
    """Write the recording, or the candidates."""
    if cause.scatters:
        return "from recording to recording"
    first, *others = cause.recordings
    where = f"in {_recordings(outcome, [first])}"
    if not others:
        return where
    names = words.join([outcome.recordings[k] for k in others], 6, word="or")
    opposite = "the opposite in " if np.isfinite(cause.value) else ""
    return f"{where} (or {opposite}{names})"


# -- channels ---------------------------------------------------------------------


def channel_warnings(outcome):
    """Messages on channels that are wrong, so that no result can be trusted."""
    return [c.message for c in outcome.channels if c.severity == "doubt"]


def drive_sentences(outcome, verdict):
    """State how torques were computed, the delay, and saturation."""
    drive = outcome.declared.get("drive")
    if drive is None:
        return ()
    first = _COMMANDED if drive["kind"] == "PDDrive" else _OF_THE_MOTOR
    return (first, *drive_found(outcome, verdict))


def drive_found(outcome, verdict):
    """State the delay of commands, and saturation."""
    drive = outcome.declared.get("drive")
    if drive is None:
        return ()
    delays = [one for one in outcome.parameters if one.name == "drive:delay"]
    known = drive.get(CommandDelay.model_parameters[0])
    texts = [delay_sentence(one.value, one.interval) for one in delays]
    if known is not None:
        texts = [f"{delay_sentence(known)[:-1]}, as given."]
    if delays:
        texts.append(_LATENCY)
    return (*texts, *_saturated(outcome, drive.get("saturated", ())))


_LATENCY = (
    "A latency of the feedback cannot be told from viscous friction and rotor inertia."
)


_COMMANDED = (
    "No torque was measured: torques are computed from the commands by the control "
    "law, and all values depend on its gains."
)


_OF_THE_MOTOR = (
    "No torque was measured: torques are computed from the input of the motor, and "
    "all values depend on its constants."
)


def delay_sentence(value, interval=None):
    """State the delay of commands; value [s], ends of its 90 % interval [s]."""
    way = "after" if value >= 0 else "before"
    ends = None if interval is None else tuple(1e3 * x for x in interval)
    late = words.with_error(1e3 * abs(value), ends, "ms")
    return f"Commands act {late} {way} they are logged."


def _saturated(outcome, shares):
    """Name the joints that saturate, and how often."""
    full = [
        f"{words.joint_label(outcome.joint_names, j)} in {words.percent(share)}"
        for j, share in enumerate(shares)
        if share > 0
    ]
    if not full:
        return ()
    return (f"Torque saturates: {words.join(full)} of the samples (excluded).",)


def channel_gains(outcome, verdict):
    """Tabulate the gains of the torque channels, where they were identified."""
    found, heading = gain_sentences(outcome), "Gains of the torque channels"
    if not found:
        return Section(heading=heading)
    table = Table(heads=("joint", "gain (90 %)", ""), rows=gain_rows(outcome))
    return Section(
        heading=heading,
        sentences=found,
        table=table,
        terminal=(_gains_text(outcome),),
    )


def _gains_text(outcome):
    """Say in a line what a terminal has of the gains, and which masses do not help."""
    gains, names = outcome.gains, outcome.joint_names
    if not gains.references:
        told = [_NOT_SHOWN]
    else:
        if gains.absolute:
            told = [_unit_of_gains(outcome, gains).partition(": ")[0]]
        else:
            channel = words.joint_list(names, gains.references)
            told = [f"Gains are relative to {channel}"]
        if gains.hidden:
            told.append(f"not identifiable: {words.joint_list(names, gains.hidden)}")
        if gains.doubtful:
            told.append(f"implausible: {words.joint_list(names, gains.doubtful)}")
        told = [f"{'; '.join(told)} (page)."]
    told += filter(None, [_unused(gains, known) for known in gains.common.masses])
    return " ".join(filter(None, [*told, _disagreement(gains.common)]))


def gain_sentences(outcome):
    """Say what the gains are relative to, which are hidden, and what fixes the rest."""
    gains = outcome.gains
    if gains is None:
        return ()
    if not gains.references:
        return gain_warnings(outcome)
    return (_unit_of_gains(outcome, gains), *gain_warnings(outcome))


def gain_warnings(outcome):
    """Name gains that are unknown or implausible, and masses that do not help."""
    gains = outcome.gains
    if gains is None:
        return ()
    told = [] if gains.references else [_NOT_SHOWN]
    told += [_hidden_gains(outcome, gains), _far(outcome, gains)]
    told += [_unused(gains, known) for known in gains.common.masses]
    told.append(_disagreement(gains.common))
    return tuple(filter(None, told))


def gain_rows(outcome):
    """Cells of each joint: its name, the gain with its interval, and its unit."""
    gains, names = outcome.gains, outcome.joint_names
    rows = []
    for j, gain in enumerate(gains.gain):
        value = words.with_error(gain, tuple(gains.intervals[:, j]))
        relative = words.joint_label(names, gains.reference[j])
        if j in gains.hidden:
            cells = ("not identifiable", "")
        elif gains.absolute:
            cells = (value, f"per {outcome.torque_units[j]}")
        elif j in gains.references:
            cells = ("1", "the unit")
        else:
            cells = (value, f"relative to {relative}")
        rows.append((words.joint_label(names, j), *cells))
    return tuple(rows)


def _unit_of_gains(outcome, gains):
    """Say in which unit everything is, and on what that rests."""
    channel = words.joint_list(outcome.joint_names, gains.references)
    common = gains.common
    if gains.absolute:
        masses = [
            f"{_called(known)} of {words.number(known.mass)} kg"
            for known in common.masses
            if known.used
        ]
        share = words.percent(HALF_WIDTH * common.std / common.factor)
        return (
            f"The common gain follows from {words.join(masses, 4)} (to {share}, 90 %): "
            "masses are in kg, and torques and friction in N m or N. A channel reads "
            "its gain times the torque."
        )
    several = len(gains.references) > 1
    return (
        f"Gains are relative to the channel{'s' * several} of {channel}. The common "
        "gain is identifiable with a known mass only: torques, masses and friction are "
        "in units of "
        f"{'these channels' if several else 'that channel'}."
    )


def _called(known):
    return "the payload" if known.name == PAYLOAD else f"the mass of {known.name}"


def _hidden_gains(outcome, gains):
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


def _disagreement(common):
    """Say that known masses disagree."""
    if common.agree:
        return ""
    each = [
        f"{_called(known)} asks for {words.number(known.found / known.mass)}"
        + (
            f" +- {words.number(HALF_WIDTH * known.std / known.mass, 2)}"
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
