"""What a report says, section by section, in words and cells but in no format.

A section is one function of the outcome and the verdict on it, listed in `SECTIONS`.
Text, Markdown and pages show what it returns; a page draws it by the template that it
names, ``templates/section.html.j2`` if it has no look of its own.
"""

import math
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.explain import ABOVE_FLOOR
from sklearn_vbjfa.diagnosis.report import (
    _evidence,
    _gains,
    _limits,
    _plain,
    _remains,
    _unseen,
    _verdict,
)
from sklearn_vbjfa.diagnosis.report import _ranges as ranges
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.report._pictures import (
    map_picture,
    residual_picture,
    time_axis,
)
from sklearn_vbjfa.diagnosis.search._posterior import UNDECIDED
from sklearn_vbjfa.robot._ranges import held_text

# Entries of a list that a terminal shows as sentences; each further one is a row.
_SENTENCES = 6
# Bars end at this many times the error of the middle joint, or one would flatten all.
_FAR = 8.0
_COLOURS = {
    "complete": "good",
    "nothing": "good",
    "worse": "bad",
    "failed": "bad",
    "no data": "bad",
    "unsearched": "bad",
    "doubtful": "bad",
}
_JOINT_COLOURS = {"floor": "good", "worse": "bad", "failed": "bad", "no data": "bad"}
_ACTIONS = {
    "add": "added",
    "replace": "replaced",
    "drop": "dropped: improbable beside the others",
}


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows of cells, each a str or a tuple of str (one a line)."""

    heads: tuple = ()  # empty for none
    rows: tuple
    # where on its page the effect of each row leads; empty for nowhere
    links: tuple = ()
    # whether all columns but the first and the last are aligned as numbers are
    numbers: bool = False


@dataclass(frozen=True, kw_only=True)
class Section:
    """A part of the report."""

    heading: str  # which a terminal does not show
    sentences: tuple = ()  # paragraphs, or the entries of a list
    table: Table | None = None  # below them
    note: str = ""  # small print below that
    # what a terminal shows; by default the sentences and the table
    terminal: tuple | None = None
    # which of ``templates/<template>.html.j2`` draws it on a page
    template: str = "section"
    drawn: object = None  # what only that template shows

    def __post_init__(self):
        if self.terminal is None:
            shown = (*self.sentences, *([self.table] if self.table else []))
            object.__setattr__(self, "terminal", shown)


def sections(outcome, verdict):
    """Return the sections that have something to show, in order."""
    found = [make(outcome, verdict) for make in SECTIONS]
    return tuple(s for s in found if s.sentences or s.table or s.drawn)


# -- the verdict ------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Headline:
    """The verdict as a page shows it: large, with (value, name) of the mean errors."""

    colour: str
    text: str
    totals: tuple
    causes: str
    files: tuple


def _headline(outcome, verdict):
    errors = verdict.errors
    band = words.number(outcome.wide_cutoff, 2)
    totals = [(errors.before, "mean error before")]
    if outcome.added:
        totals.append((errors.plain, "with the four plain terms"))
    totals.append((errors.after, "after, on untouched data"))
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
            "too slow or too small, so that noise outweighs the torques, or that ends "
            "at rest."
        )
    robot = outcome.declared.get("robot") or "the robot"
    return Section(
        heading=f"What the declared model of {robot} lacks",
        sentences=tuple(filter(None, (verdict.text, causes))),
        template="headline",
        drawn=Headline(
            colour=_COLOURS.get(verdict.status, "warn"),
            text=verdict.headline,
            totals=tuple((words.percent(value), name) for value, name in totals),
            causes=causes,
            files=outcome.provenance.files if outcome.provenance else (),
        ),
    )


# -- errors -----------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class JointBars:
    """A joint's errors as bars; places are per cent of the scale."""

    label: str
    # The verdict on the joint, how to colour it, and what else is known.
    text: str
    colour: str
    note: str
    # ("before", "plain" or "after", length or None, text beside, whether it is cut)
    bars: tuple
    # Where the interval of the error after begins and how long it is, or empty.
    reach: tuple
    floor: float | None


def _joints(outcome, verdict):
    heads = ["untouched\nerror, %", "before"]
    heads += ["four\nterms"] * bool(outcome.added) + ["after [90 %]"]
    heads += ["/".join(dict.fromkeys(outcome.torque_units)), "floor"]
    wide, note = bool(np.isfinite(outcome.wide_cutoff)), ""
    if wide:
        band = words.number(outcome.wide_cutoff, 2)
        fit = words.number(outcome.declared.get("cutoff", np.nan))
        heads.append(f"to\n{band} Hz")
        note = (
            f"; in the band of the fit, up to {fit} Hz. In the wider one, up to {band} "
            "Hz, nothing was identified"
        )
    rows = []
    for v in verdict.joints:
        j = v.joint
        row = [
            v.label,
            words.bare_percent(outcome.error_before[j]),
            *[words.bare_percent(outcome.error_plain[j])] * bool(outcome.added),
            words.bare_percent(outcome.error_after[j]) + _reach_text(outcome, j),
            words.number(outcome.error_after[j] * outcome.spread[j], 2),
            words.bare_percent(outcome.floor[j]),
        ]
        row += [words.bare_percent(outcome.wide_after[j])] * wide
        rows.append((*row, v.text))
    table = Table(heads=(*heads, ""), rows=tuple(rows), numbers=True)
    terminal = table
    if outcome.added:
        # A line has no room for the error in N m beside a third one in per cent.
        at = heads.index("after [90 %]") + 1
        heads, *rows = (
            (*row[:at], *row[at + 1 :]) for row in (table.heads, *table.rows)
        )
        terminal = Table(heads=heads, rows=tuple(rows), numbers=True)
    return Section(
        heading="Error of each joint on untouched data",
        table=table,
        terminal=(terminal,),
        note=f"Interval: {_interval_text(outcome.settings)}. Root mean square of the "
        "torque residual on data that was not touched before, over the standard "
        f"deviation of the torque in the moving time of the whole recording{note}.",
        template="joints",
        drawn=_bars(outcome, verdict.joints),
    )


def _bars(outcome, joints):
    longest = _scale(outcome)

    def place(value):
        share = 100 * float(np.clip(value / longest, 0.0, 1.0))
        return share if np.isfinite(share) else None

    def bar(kind, value, text):
        return kind, place(value), text, bool(value > longest)

    found = []
    for v in joints:
        j = v.joint
        after = outcome.error_after[j]
        kinds = {"before": outcome.error_before[j]}
        if outcome.added:
            kinds["plain"] = outcome.error_plain[j]
        low, high = _verdict.interval(outcome, "after", j)
        note = ""
        if np.isfinite(after):
            newtons = words.number(after * outcome.spread[j], 2)
            note = f"after: {newtons} {outcome.torque_units[j]}"
        if np.isfinite(after) and np.isfinite(outcome.wide_after[j]):
            band = words.number(outcome.wide_cutoff, 2)
            note += f"; up to {band} Hz {words.percent(outcome.wide_after[j])}"
        known = np.isfinite(low) and np.isfinite(high)
        text = words.percent(after) + _reach_text(outcome, j)
        found.append(
            JointBars(
                label=v.label,
                colour=_JOINT_COLOURS.get(v.status, "warn"),
                text=v.text,
                note=note,
                bars=(
                    *(bar(kind, x, words.percent(x)) for kind, x in kinds.items()),
                    bar("after", after, text),
                ),
                reach=(place(low), place(high) - place(low)) if known else (),
                floor=place(outcome.floor[j]),
            )
        )
    return tuple(found)


def _scale(outcome):
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
    low, high = _verdict.interval(outcome, "after", joint)
    if not (np.isfinite(low) and np.isfinite(high)):
        return ""
    return f" [{words.bare_percent(low)}, {words.bare_percent(high)}]"


def _interval_text(settings):
    """Say what the interval of an error holds."""
    if "error_seconds" not in settings:
        return "90 %"
    seconds = words.number(settings["error_seconds"], 2)
    return f"90 % of errors over the next {seconds} s of such motion"


def _paragraph(heading, sentences):
    """Make a section that is read as one paragraph, except where lists are."""
    return Section(
        heading=heading,
        sentences=sentences,
        terminal=(" ".join(sentences),) if sentences else (),
        template="paragraph",
    )


def _added(outcome, verdict):
    """Say which plain terms were fitted beyond what was declared."""
    if not outcome.added:
        return _paragraph("Plain terms", ())
    # Not "found": they are fitted on every robot, and nothing was tested.
    told = (
        f"Added on every joint, as not declared: {_verdict.plain_words(outcome)}. With "
        "these the model has the four plain terms that hardly any drive is without; "
        "they were fitted, not searched for."
    )
    return _paragraph("Plain terms", (told,))


def _band(outcome, verdict):
    found = _limits.band_sentences(outcome, verdict.errors)
    return _paragraph("Band of the errors", found)


def _next_recording(outcome, verdict):
    return _paragraph("The next recording", _limits.next_sentences(outcome))


def _projection(outcome, verdict):
    found = _limits.projection_sentences(outcome)
    return _paragraph("Price of physical consistency", found)


def _recordings(outcome, verdict):
    """Say first what is wrong with recordings, then what their motion leaves open."""
    found = _limits.contradiction_sentences(outcome)
    found += _limits.repeated_sentences(outcome) + _limits.motion_sentences(outcome)
    return _paragraph("Limits of the recordings", found)


def _channel_gains(outcome, verdict):
    found = _gains.gain_sentences(outcome)
    if not found:
        return _paragraph("Gains of the torque channels", found)
    heads = ("joint", "gain (90 %)", "")
    return Section(
        heading="Gains of the torque channels",
        sentences=found,
        table=Table(heads=heads, rows=_gains.gain_rows(outcome)),
        terminal=(" ".join(found), Table(heads=heads, rows=_gains.gain_rows(outcome))),
    )


def _masses(outcome, verdict):
    return _paragraph("Masses", _limits.mass_sentences(outcome))


# -- findings ---------------------------------------------------------------------


def _effects(outcome, verdict):
    sentences, short, rows = [], [], []
    for e in outcome.effects:
        joint = words.place_label(outcome, e.name, e.joint)
        label = words.effect_label(outcome, e.name, e.parameters)
        if _plain.in_model(outcome, e):
            first, parameters = _plain.statement(outcome, e), _plain.value_cells(e)
        else:
            parameters = words.parameter_text(e)
            first = ", ".join([f"{joint}: {label}", *parameters])
        gain, odds = words.whole_percent(e.evidence.gain), words.odds_text(e.log_odds)
        rivals = [words.other_label(outcome, rival, e.name) for rival in e.rivals]
        evidence = f"saves {gain}, odds {odds}"
        told = [f"- {first}", evidence]
        if rivals:
            told.append(f"this data cannot tell it from {words.join(rivals, 2, 'or')}")
        afterwards = ranges.afterwards_text(e)
        told += filter(None, [ranges.known_for(outcome, e), afterwards])
        sentences.append("; ".join(told))
        short.append((f"- {joint}", label, evidence))
        gain += f" +- {words.whole_percent(e.evidence.gain_std)}"
        cannot = words.join(rivals, len(rivals), "or")
        known = filter(None, [ranges.known_for(outcome, e), afterwards])
        cell = (*parameters, *known)
        rows.append((joint, label, cell, gain, odds, cannot))
    heads = ("joint", "effect", "parameters (90 %)", "squared error saved", "odds")
    shown = _evidence.anchors(outcome)
    links = tuple(f"#{anchor}" if anchor else "" for anchor in shown)
    return Section(
        heading="Effects that were missing",
        table=_table((*heads, "cannot be told from"), rows, links=links),
        terminal=_terminal(sentences, short),
    )


def _perhaps(outcome, verdict):
    """Say what is more probable than not and has no name."""
    rows, told = [], []
    for e in outcome.perhaps:
        joint = words.place_label(outcome, e.name, e.joint)
        label = words.effect_label(outcome, e.name, e.parameters)
        probability = words.probability_text(e.probability)
        rivals = [words.other_label(outcome, rival, e.name) for rival in e.rivals]
        cell = tuple(words.parameter_text(e))
        cannot = words.join(rivals, len(rivals), "or")
        rows.append((joint, label, cell, probability, e.doubt, cannot))
        why = "" if e.doubt == UNDECIDED else f"; {e.doubt}"
        told.append(f"- {joint}: perhaps {label}, probability {probability}{why}")
    heads = ("joint", "effect", "parameters (90 %)", "probability", "why no name")
    return Section(
        heading="Perhaps",
        table=_table((*heads, "cannot be told from"), rows),
        note="Part of the completed model: leaving them out would predict no better."
        if rows
        else "",
        terminal=tuple(told),
    )


def _corrections(outcome, verdict):
    """Say what to mend on the robot, in the program that reads it, or in its files."""
    own = [e for e in outcome.effects if _plain.in_model(outcome, e)]
    remedies = {(one.name, one.joint): one.text for one in _plain.remedies(outcome)}
    told = []
    for e in own:
        said = [_plain.statement(outcome, e), remedies.pop((e.name, e.joint), "")]
        told.append(". ".join(map(words.capital, filter(None, said))))
    # The others were declared.
    told += map(words.capital, remedies.values())
    todo = [one.text for one in _plain.remedies(outcome)]
    rows = [
        (
            words.place_label(outcome, e.name, e.joint),
            words.effect_label(outcome, e.name, e.parameters),
            _plain.value_cells(e),
            tuple(words.parameter_text(e)),
        )
        for e in own
    ]
    return Section(
        heading="What to correct",
        sentences=tuple(f"{text}." for text in told),
        table=_table(("where", "what", "value (90 %)", "in SI units"), rows),
        note="The completed model has all of it: it takes positions and torques as "
        "they were recorded."
        if told
        else "",
        terminal=(f"To correct: {'; '.join(todo)}.",) if todo else (),
    )


def _outside(outcome, verdict):
    """Say where the untouched part leaves what effects were fitted on."""
    sentences = ranges.outside_sentences(outcome)
    title = "Outside the range of the fit"
    held = held_text(outcome.outside, lambda name: words.effect_label(outcome, name))
    return Section(
        heading=f"{title}, on untouched data",
        sentences=(*sentences, *([f"{held}."] if held else [])),
        terminal=_terminal([f"{title}: {sentence}." for sentence in sentences], ()),
    )


def _table(heads, rows, **more):
    """Make a table; None without rows."""
    return Table(heads=heads, rows=tuple(rows), **more) if rows else None


def _terminal(sentences, rows):
    """Show the first entries as sentences, each further one as a row of a table."""
    further = tuple(rows[_SENTENCES:])
    return (*sentences[:_SENTENCES], *([Table(rows=further)] if further else ()))


@dataclass(frozen=True, kw_only=True)
class Maps:
    """Residuals over speed and load."""

    # Of each joint: label, what full colour means, speeds, loads, and the MapPicture.

    pictures: tuple


def _unexplained(outcome, verdict):
    names = outcome.joint_names
    order = sorted(outcome.unexplained, key=lambda u: (not u.floor > 0, -u.of_torque))
    sentences, short = [], []
    for group in _unexplained_groups(outcome, order):
        first = group[0]
        joints = words.joint_list(names, [u.joint for u in group])
        shares = [words.percent(share) for share in sorted(u.of_torque for u in group)]
        share = f"{' to '.join(dict.fromkeys([shares[0], shares[-1]]))} of the torque"
        share += " has no name" if first.floor > 0 else " remains, noise floor unknown"
        all_of_it, strongest = _of_the_rest(outcome, group)
        sentences.append(f"{joints}: {share}; {all_of_it}")
        short.append((f"? {joints}", share, strongest))
    pictures = _maps(outcome)
    return Section(
        heading="Unexplained",
        sentences=tuple(sentences),
        note=_ceiling_note(outcome),
        terminal=_terminal([f"? {sentence}" for sentence in sentences], short),
        template="unexplained",
        drawn=Maps(pictures=pictures) if pictures else None,
    )


def _of_the_rest(outcome, group):
    """Say what is known of the rest of some joints, and the same in a few words."""
    alike = [_remains.remains(outcome, u.joint) for u in group]
    first = group[0]
    if alike[0] is not None:
        return (
            _remains.statement(alike, first.floor),
            _remains.short_statement(alike),
        )
    signals = [
        f"{words.signal_label(s.signal, outcome.joint_names, first.joint)} "
        f"({words.whole_percent(s.share)})"
        for s in first.signals
    ]
    if not signals:
        return ("it varies with no single signal",) * 2
    return f"varies with {words.join(signals, 3)}", f"varies with {signals[0]}"


def _unexplained_groups(outcome, unexplained):
    """Put joints together of which the same is said, but for sizes."""
    groups = {}
    for u in unexplained:
        found = _remains.remains(outcome, u.joint)
        if found is None:
            said = u.joint if u.signals else None
        else:
            said = u.joint if found.kind == "form" else (found.kind, found.share > 0)
        groups.setdefault((u.floor > 0, said), []).append(u)
    return groups.values()


def _ceiling_note(outcome):
    """Say what a share of what remains is, for a page."""
    if not outcome.ceiling:
        return ""
    on = "blocks of time that they were not fitted to"
    if not all(math.isnan(c.across[-1]) for c in outcome.ceiling):
        on += ", and on other recordings within the speeds and loads fitted"
    return (
        "What remains is the squared residual of the completed model in the search "
        f"part; shares are what boosted trees explain of it on {on}."
    )


def _maps(outcome):
    """Draw what remains over speed and load, of joints of which these explain it."""
    found = []
    for joint, drawn in outcome.curves.get("maps", {}).items():
        if _remains.has_picture(_remains.remains(outcome, joint)):
            picture = map_picture(drawn)
            unit = outcome.torque_units[joint]
            speed = "m/s" if unit == "N" else "rad/s"
            found.append(
                (
                    words.joint_label(outcome.joint_names, joint),
                    f"full colour: +-{words.number(picture.limit, 2)} {unit}",
                    f"speed {_range(drawn.speed)} {speed}",
                    f"load {_range(drawn.load)} {unit}",
                    picture,
                )
            )
    return tuple(found)


def _range(ends):
    return " to ".join(words.number(end, 2) for end in ends)


def _record_next(outcome, verdict):
    """Say what to record next, what matters most first, without repetition."""
    wanted = _remains.record_next(outcome)
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
        where = words.joint_list(outcome.joint_names, joints)
        if advice:
            found.append(f"{advice} ({where})" if where else advice)
    return Section(
        heading="Record next",
        sentences=tuple(found),
        terminal=(f"Record next: {words.join(found, len(found))}.",) if found else (),
    )


def _own_joint(outcome, effect):
    """Joint of an effect, in a list; an empty one for what belongs to none."""
    found = outcome.library.get(effect.name)
    return [] if found is not None and found.scope == "robot" else [effect.joint]


def _hidden(outcome, verdict):
    """Say what could not be looked for, in a sentence for each reason."""
    sentences = list(_unseen.model_sentences(outcome))
    rest = [h for h in outcome.hidden if not _unseen.is_of_model(outcome, h)]
    for reason, title, because in (
        ("excitation", "This recording cannot show", ""),
        ("signal", "Not looked for:", "; {}"),
        ("span", "No motion can show", ": what is fitted anyway does the same"),
    ):
        own = [h for h in rest if h.reason == reason]
        of_model = _unseen.model_parts(outcome, reason) if reason == "span" else []
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
    sentences += _unseen.together_sentences(outcome, rest)
    return Section(heading="Not visible in this recording", sentences=tuple(sentences))


def _channels(outcome, verdict):
    messages = [" ".join(c.message.split()) for c in outcome.channels]
    # The headline has the first doubt already.
    first = " ".join("".join(_verdict.doubts(outcome)[:1]).split())
    below = [message for message in messages if message != first]
    return Section(
        heading="Channels",
        sentences=tuple(messages),
        terminal=tuple(f"Channel: {message}" for message in below),
    )


# -- evidence ---------------------------------------------------------------------


def _effect_pictures(outcome, verdict):
    return Section(
        heading="Effects in the torque",
        note="What the rest of the completed model leaves of the torque, without and "
        "with the effect, on all rows in which the joint moves; the parameters are "
        "those of the files. The errors above are of the untouched part instead.",
        template="figures",
        drawn=_evidence.effect_figures(outcome),
    )


def _torques(outcome, verdict):
    return Section(
        heading="Measured and predicted torque",
        note="Behind the low-pass of the fit. Both models were fitted to what is not "
        "shaded.",
        template="figures",
        drawn=_evidence.torque_figures(outcome),
    )


def _parameters(outcome, verdict):
    return Section(
        heading="Identified parameters",
        note="Of the model in the files, fitted to all data. Only with others: torques "
        "depend on it, but not on it alone; the value agrees with them and with the "
        "robot description, and but for those is one of many. As "
        "described: the torques say little beyond the description, whose masses and "
        "inertias are expected to be off by a fifth or so; learned is the share of "
        "that variance which the torques took away.",
        template="parameters",
        drawn=_evidence.parameter_groups(outcome),
    )


def _provenance(outcome, verdict):
    rows = _evidence.provenance_rows(outcome)
    given = outcome.provenance
    return Section(
        heading="Provenance",
        table=_table((), rows),
        terminal=(),
        template="provenance",
        drawn=_evidence.Files(files=tuple(given.files)) if given else None,
    )


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """Pictures of the residuals: label, torque at the edge, its unit, and Picture."""

    pictures: tuple
    axis: tuple


def _residuals(outcome, verdict):
    curves = outcome.curves
    heading = "Torque residuals"
    if not {"before", "after", "weight"} <= set(curves):
        return Section(heading=heading)
    floor = outcome.floor * outcome.spread
    found = []
    for v in verdict.joints:
        picture = residual_picture(curves, v.joint, floor[v.joint])
        if picture is not None:
            unit = outcome.torque_units[v.joint]
            found.append((v.label, words.number(picture.limit, 2), unit, picture))
    axis = time_axis(curves)
    time = "Untouched part in the order of its samples"
    if axis:
        time = "Untouched part, one stretch after the other, over time in seconds"
    return Section(
        heading=heading,
        note=f"one standard deviation. {time}; gaps where the joint stands still.",
        template="residuals",
        drawn=Residuals(pictures=tuple(found), axis=axis) if found else None,
    )


def _steps(outcome, verdict):
    rows = []
    for i, step in enumerate(outcome.rounds, 1):
        j = step.joint
        robot = words.place_label(outcome, step.name, j) == "robot"
        action = _ACTIONS.get(step.action, step.action)
        if step.replaced:
            action = f"replaced {words.effect_label(outcome, step.replaced)}"
        rivals = [
            words.effect_at(outcome, t.name, t.joint, t.shape)
            if robot or t.joint != j
            else words.effect_label(outcome, t.name, t.shape)
            for t in step.rivals
        ]
        rows.append(
            (
                str(i),
                words.place_label(outcome, step.name, j),
                words.effect_label(outcome, step.name, step.shape),
                action,
                words.odds_text(step.log_odds),
                words.join(rivals, 4),
            )
        )
    heads = ("no.", "joint", "effect", "step", "odds", "rivals")
    # A terminal has no room for the way to what was found.
    table = _table(heads, rows)
    return Section(heading="Steps of the search", table=table, terminal=())


# -- settings ---------------------------------------------------------------------


def _settings(outcome, verdict):
    settings = outcome.settings
    sentences = (_short(outcome), _split(settings), _named(settings), _errors(settings))
    versions = [f"{name} {v}" for name, v in settings.get("versions", {}).items()]
    effects = settings.get("effects", ())
    if not isinstance(effects, str):
        effects = ", ".join(map(str, effects)) or "none"
    seed = settings.get("random_state")
    rows = (
        ("Declared model", _declared(outcome.declared)),
        ("Looked for", effects),
        ("Signals", ", ".join(settings.get("signals", ()))),
        ("Seed", "" if seed is None else str(seed)),
        ("Versions", ", ".join(versions)),
    )
    sentences = tuple(filter(None, sentences))
    return Section(
        heading="Settings",
        sentences=sentences,
        table=Table(rows=tuple(row for row in rows if row[1])),
        terminal=sentences,
    )


def _short(outcome):
    """Say where the recording is too short for a slow residual."""
    joints = outcome.settings.get("too_short", ())
    if not joints:
        return ""
    where = words.joint_list(outcome.joint_names, [j for j, _ in joints])
    times = [seconds for _, seconds in joints]
    stays = "stays correlated throughout"
    if math.isfinite(max(times)):
        up_to = "up to " if len(times) > 1 else ""
        stays = f"stays correlated for {up_to}{words.number(max(times), 2)} s"
    return (
        f"Too short for the residual of {where}, which {stays}: slow effects cannot be "
        "told from it."
    )


def _split(settings):
    """Say what was untouched and how the rest was divided."""
    if "test_size" not in settings:
        return ""
    text = f"Untouched: {words.whole_percent(settings['test_size'])} of the motion"
    if "untouched_stretches" in settings:
        count = settings["untouched_stretches"]
        text += f" ({count} {'stretch' if count == 1 else 'stretches'}"
        text += f", {words.number(settings['untouched_seconds'])} s)"
        if settings.get("undecided_stretches"):
            text += ", without what a change of payload falls into"
    if "n_blocks" in settings:
        seconds = words.number(settings.get("block_seconds", math.nan))
        text += f"; search: {settings['n_blocks']} blocks of {seconds} s, "
        text += f"{settings.get('n_folds', '?')} folds"
    if "correlation_seconds" in settings:
        seconds = settings["correlation_seconds"]
        known = math.isfinite(seconds)
        length = f"for {words.number(seconds, 2)} s" if known else "throughout"
        text += f"; residual correlated {length}"
    return f"{text}."


def _named(settings):
    """Say what it takes to be named."""
    if "search" not in settings:
        return ""
    own = settings["search"]
    sure = words.whole_percent(1.0 - settings["alpha"])
    worth = words.whole_percent(own["worth"])
    candidates = words.plural(settings["n_candidates"], "candidate")
    return (
        f"Named: probability of {sure} or more among {candidates}, of which "
        f"{words.number(own['expected'])} is expected before looking; saves >= {worth} "
        "of squared error on stretches that were not fitted, beyond chance; "
        f"unexplained: > {ABOVE_FLOOR[0]} x floor."
    )


def _errors(settings):
    """Say what the intervals are of, and what the model was fitted to in the end."""
    if "error_seconds" not in settings:
        return ""
    return (
        f"+-: 90 % interval of a parameter; [ ]: {_interval_text(settings)}. Files and "
        "parameters: fitted to all data after the errors were taken, in the same band."
    )


def _declared(declared):
    """Say what the model had before the search."""
    parts = [str(declared["robot"])] if declared.get("robot") else []
    if "friction" in declared:
        names = ", ".join(map(str, declared["friction"])) or "none"
        parts.append(f"friction: {names}")
    if "n_parameters" in declared:
        parts.append(f"{declared['n_parameters']} parameters")
    if "cutoff" in declared:
        cutoff = words.number(declared["cutoff"])
        known = math.isfinite(declared["cutoff"])
        parts.append(f"low-pass {cutoff} Hz" if known else "no low-pass")
    return "; ".join(parts)


SECTIONS = (
    _headline,
    _joints,
    _added,
    _band,
    _next_recording,
    _recordings,
    _projection,
    _effects,
    _perhaps,
    _effect_pictures,
    _corrections,
    _outside,
    _unexplained,
    _record_next,
    _hidden,
    _channel_gains,
    _masses,
    _channels,
    _torques,
    _residuals,
    _parameters,
    _steps,
    _settings,
    _provenance,
)
