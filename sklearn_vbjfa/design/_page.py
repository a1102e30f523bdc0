"""A designed motion in words: a page beside its file, and a summary for a terminal."""

import math
import textwrap
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.design._criterion import SAME_COLUMNS
from sklearn_vbjfa.design._design import MARGIN, ROOM
from sklearn_vbjfa.diagnosis.report import Section, Table, line_figure
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.report import page as render
from sklearn_vbjfa.effects import resolve

# A limit of which this share is used holds a motion back.
_TIGHT = 0.93
# An interval that changes by less stays as it is.
_SAME = 1.1
# Values below this share of what is known of them are rounding.
_ROUNDING = 1e-6
# Points of a curve that a page holds; the file of the motion has all.
_POINTS = 1000
# Entries of a list, joints of a table, and characters of a line on a terminal.
_LISTED, _JOINTS, _WIDTH = 3, 7, 88
_QUANTITIES = ("position", "velocity", "acceleration", "torque")
_BARE = {"position": "range", "velocity": "speed"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Present:
    """What is known of a parameter before the motion."""

    value: float
    # that of its 90 % interval; nan where the recordings do not determine it alone
    half_width: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Background:
    """What a motion was designed from, as the program that asked for it knows it."""

    robot: str  # what to call the robot
    description: str  # its file
    measured: np.ndarray  # (nv,): joints of which the torque noise was measured
    report: str = ""  # its folder; empty for none
    found: dict | None = None  # that report, as `Report.to_dict` has it
    seed: int = 0  # of the random motions
    settings: tuple = ()  # what else was asked for, for the provenance
    held: tuple = ()  # joints that stay at zero
    file: str = ""
    # what to do next: sentences, and commands to type, which begin with "python"
    commands: tuple = ()

    def rivals(self):
        """Return pairs that a report could not tell apart, ({name, name}, joint)."""
        found = self.found or {}
        names = tuple(found.get("joint_names") or ())
        pairs = set()
        for one in (*(found.get("effects") or ()), *(found.get("rounds") or ())):
            for rival in one.get("rivals") or ():
                # Of an effect rivals are names, of a step of the search trials.
                if isinstance(rival, str):
                    name, _, where = rival.rpartition(" on ")
                    rival = rival if where not in names else name
                else:
                    rival = rival["name"]
                pairs.add((frozenset((one["name"], rival)), one["joint"]))
        return pairs

    def present(self):
        """Return what a report says of each parameter, dict of str to `Present`."""
        known = {}
        for one in (self.found or {}).get("parameters") or ():
            low, high = one["interval"]
            alone = one["known"] == "yes" and None not in (low, high)
            half = 0.5 * (high - low) if alone else math.nan
            known[one["name"]] = Present(value=one["value"], half_width=half)
        return known


# -- the page --------------------------------------------------------------------------


def page(motion, background):
    """Write a motion as one page of HTML with its style and pictures inside."""
    sections = [make(motion, background) for make in _SECTIONS]
    shown = [s for s in sections if s.sentences or s.table or s.drawn]
    return render(tuple(shown), "sklearn_vbjfa.design")


def _headline(motion, background):
    n = len(motion.joint_names)
    narrower = _narrower(motion, background)
    totals = [
        (f"{motion.duration:g} s", f"{n} joints, {1 / motion.dt:.4g} Hz"),
        (
            words.number(motion.condition_number),
            "condition number of the columns over their sizes at random states",
        ),
        (
            words.number(motion.start_condition_number),
            "that of the random motion it was improved from",
        ),
    ]
    if "clearance" in motion.margins:
        nearest = words.number(1e3 * motion.margins["clearance"])
        totals.append((f"{nearest} mm", "between the nearest bodies"))
    if narrower is not None:
        totals.append((f"{narrower[0]} of {narrower[1]}", "parameters become narrower"))
    wrong = [] if motion.within_limits else [f"{words.capital(exceeded(motion))}."]
    wrong += unchecked(motion)
    return Section(
        heading=f"Motion to record next with {background.robot}",
        sentences=(_verdict(motion, background),),
        template="headline",
        drawn=dict(
            colour="bad" if wrong else "good",
            text=_verdict(motion, background),
            totals=tuple(totals),
            causes=" ".join(wrong),
            files=(background.file,) if background.file else (),
        ),
    )


def _verdict(motion, background):
    """Say in a sentence what the motion is good for."""
    found = decisions(motion, background)
    if found:
        first = found[0]
        where = words.joint_label(motion.joint_names, first.joint)
        least = _newtons(motion, first.least, first.joint)
        more = len(found) - 1
        told = f"; and {words.plural(more, 'further question')}" * (more > 0)
        return (
            f"This motion tells these causes apart if they exceed {least}: "
            f"{first.causes} on {where}{told}."
        )
    if motion.shows:
        effects = len({one.name for one in motion.shows})
        return (
            f"It determines the model, and shows {words.plural(effects, 'effect')} "
            "that the joints may have."
        )
    return "It determines the model; no effect was asked for."


@dataclass(frozen=True, kw_only=True)
class Decision:
    """What a motion decides: a question of a joint."""

    joint: int  # from zero
    causes: str  # what is told apart, in words
    least: float  # smallest torque from which on all of it is [N m or N]
    hardest: str = ""  # of more than two causes, the two that are hardest to tell apart


def decisions(motion, background):
    """List what a motion decides, what the report names as rivals first."""
    # What would take more torque than the joint has is `undecided`. Causes of a joint
    # that no one has named as rivals are one question together.
    named = background.rivals()
    found, others = [], {}
    for one in motion.parts:
        if one.least > _has(motion, one.joint):
            continue
        if (frozenset(one.names), one.joint) in named:
            found.append(_one_pair(one))
        else:
            others.setdefault(one.joint, []).append(one)
    for joint, pairs in others.items():
        hardest = max(pairs, key=lambda one: one.least)
        if len(pairs) == 1:
            found.append(_one_pair(hardest))
            continue
        causes = dict.fromkeys(name for one in pairs for name in one.names)
        labels = [effect_label(name) for name in causes]
        found.append(
            Decision(
                joint=joint,
                causes=words.join(labels, len(labels)),
                least=hardest.least,
                hardest=_one_pair(hardest).causes,
            )
        )
    return found


def _has(motion, j):
    """Largest torque of a joint: its limit, or without one that in the motion."""
    limit = motion.limits.torque[j]
    return limit if np.isfinite(limit) else np.abs(motion.tau[:, j]).max()


def undecided(motion):
    """Say which causes a motion does not tell apart, a list of str."""
    return [
        f"not told apart on {words.joint_label(motion.joint_names, one.joint)}, except "
        f"by {_newtons(motion, one.least, one.joint)}, more than it has: "
        f"{_one_pair(one).causes}"
        for one in motion.parts
        if one.least > _has(motion, one.joint)
    ]


def unseen(motion, names):
    """Say which effects of some names a motion does not show, a list of str."""
    return [
        f"{effect_label(one.name)} on "
        f"{words.joint_label(motion.joint_names, one.joint)} is not identifiable by "
        f"any motion ({one.reason})"
        for one in motion.invisible
        if one.name in names
    ]


def _one_pair(one):
    """Return a pair as a question of its own."""
    causes = " or ".join(effect_label(name) for name in one.names)
    return Decision(joint=one.joint, causes=causes, least=one.least)


def _to_do(motion, background):
    starts = [
        f"{words.joint_label(motion.joint_names, j)} at "
        f"{words.number(motion.q[0, j])} {_units(motion, background)[j][0]}"
        for j in range(len(motion.joint_names))
    ]
    rest = "It stands still where it begins and ends"
    first = f"Go to the start first: {', '.join(starts)}. {rest}."
    before = _before(motion)
    steps = first, *_repeated_texts(motion, background), *background.commands
    return Section(
        heading="What to do next",
        sentences=(*before, *steps),
        template="steps",
        # What comes before the first step.
        drawn={"before": len(before)},
    )


def unchecked(motion):
    """Warn that links may meet, a list of str; empty where their distances are kept."""
    if "clearance" in motion.margins:
        return []
    reason = motion.no_clearance.rstrip(".")
    return [f"SELF-COLLISION WAS NOT CHECKED. {reason}."]


def _before(motion):
    """Say what to do before a motion that may make the robot hit itself."""
    if not unchecked(motion):
        return ()
    most = max(float(np.max(1.0 - motion.margins[name])) for name in _QUANTITIES)
    return (
        "BEFORE IT RUNS: the robot may hit itself, at up to "
        f"{words.whole_percent(most)} of its limits. Watch all of the motion in a "
        "simulator, then run it slowly with a hand on the emergency stop; or give a "
        "robot description with collision geometry, and design keeps the links apart.",
    )


@dataclass(frozen=True, kw_only=True)
class ShareBar:
    """Share of a limit that a motion uses, None where there is no limit."""

    name: str
    used: float | None
    text: str
    is_tight: bool


@dataclass(frozen=True, kw_only=True)
class JointShares:
    """Bars of a joint."""

    label: str
    bars: tuple


def _margins(motion, background):
    joints = tuple(
        JointShares(
            label=words.joint_label(motion.joint_names, j),
            bars=tuple(_bar(motion, background, j, name) for name in _QUANTITIES),
        )
        for j in range(len(motion.joint_names))
    )
    return Section(
        heading="Limits",
        sentences=(_clearance_text(motion),),
        note=f"At ten times the sampling of the design; {100 * MARGIN:g} % of each "
        f"limit are left. {_clearance_text(motion)}",
        template="margins",
        drawn={"joints": joints},
    )


def _bar(motion, background, j, name):
    """Share of one limit of a joint."""
    used = 1.0 - float(motion.margins[name][j])
    unit = _units(motion, background)[j][_QUANTITIES.index(name)]
    limit = _ends(motion, name, j)
    if not math.isfinite(limit[1]):
        top = words.number(float(np.abs(_signal(motion, name)[:, j]).max()))
        text = f"{top} {unit}, no limit"
        return ShareBar(name=_bare(name), used=None, text=text, is_tight=False)
    ends = words.number(limit[1])
    if name == "position":
        ends = f"{words.number(limit[0])} to {ends}"
    return ShareBar(
        name=_bare(name),
        used=float(np.clip(used, 0.0, 1.0)),
        text=f"{words.whole_percent(used)} of {ends} {unit}",
        is_tight=used > _TIGHT,
    )


def _decided(motion, background):
    """Say what the motion decides."""
    rows = []
    for one in decisions(motion, background):
        hardest = f"hardest: {one.hardest}" if one.hardest else ""
        rows.append(
            (
                words.joint_label(motion.joint_names, one.joint),
                words.capital(one.causes),
                (_newtons(motion, one.least, one.joint), hardest)
                if hardest
                else _newtons(motion, one.least, one.joint),
            )
        )
    heads = ("joint", "causes", "told apart if they exceed")
    return Section(
        heading="Which causes it tells apart",
        table=Table(heads=heads, rows=tuple(rows)) if rows else None,
    )


def _shown(motion, background):
    """Tabulate from which torque on each effect shows, joints side by side."""
    joints = sorted({one.joint for one in motion.shows})
    labels = [words.joint_label(motion.joint_names, j) for j in joints]
    found = {(one.name, one.joint): one for one in motion.shows}
    rows = []
    for name in dict.fromkeys(one.name for one in motion.shows):
        cells = [words.capital(effect_label(name))]
        for j in joints:
            one = found.get((name, j))
            if one is None:
                cells.append("-")
                continue
            beside = f"beside {effect_label(one.rival)}" if one.rival else ""
            least = _newtons(motion, one.least, j)
            cells.append((least, beside) if beside else least)
        rows.append(tuple(cells))
    told = ()
    if rows:
        told = (
            "Smallest torque of an effect, a root mean square, that is told from the "
            "model and from the rival that is most like it, where that is named.",
        )
    return Section(
        heading="What it shows",
        sentences=told,
        table=Table(heads=("effect", *labels), rows=tuple(rows)) if rows else None,
    )


def _invisible(motion, background):
    return Section(
        heading="What it cannot show",
        sentences=tuple(
            words.capital(x)
            for x in (
                *(f"{one}." for one in undecided(motion)),
                *invisible_sentences(motion, background),
            )
        ),
    )


def invisible_sentences(motion, background, most=None):
    """Say what no motion shows, effects with the same reason together; one or none."""
    # most: reasons that are given.
    told = [(one.reason, one.name, one.joint) for one in motion.invisible]
    for one in (background.found or {}).get("hidden") or ():
        if one["reason"] == "span":
            told.append((SAME_COLUMNS, one["name"], one["joint"]))
        elif one["reason"] == "together":
            other = effect_label(one["remedy"])
            why = f"only together with {other}"
            told.append((why, one["name"], one["joint"]))
    by_reason = {}
    for reason, name, joint in dict.fromkeys(told):
        by_reason.setdefault(reason, {}).setdefault(name, []).append(joint)
    found = []
    for reason, effects in by_reason.items():
        parts = [
            f"{effect_label(name)} ({words.joint_list(motion.joint_names, joints)})"
            for name, joints in effects.items()
        ]
        found.append(f"{words.join(parts, len(parts))} ({reason})")
    told = "; ".join(found[:most])
    return [f"Not identifiable by any motion: {told}."] if found else []


def _intervals(motion, background):
    """Tabulate what is known of each parameter now and what will be."""
    present = background.present()
    by_joint = {}
    for one in motion.expected_intervals:
        by_joint.setdefault(_joint_of(one.name, motion.joint_names), []).append(one)
    groups = []
    for j, own in sorted(by_joint.items(), key=lambda x: (x[0] is None, x[0])):
        rows, changes = [], []
        for one in own:
            now = _now(one, present)
            change = _change(one, now)
            changes.append(change)
            rows.append(
                (
                    one.name.partition(":")[2] or one.name,
                    _value_text(one, now),
                    _half_text(one.half_width),
                    _half_text(_together(one, now)),
                    one.unit,
                    _change_text(change)
                    or ("a combination" if now is not None else ""),
                )
            )
        known = [x for x in changes if not math.isnan(x)]
        summary = ""
        if known:
            better = sum(x > _SAME for x in known)
            summary = f"{better} of {len(known)} become narrower"
        label = "robot" if j is None else words.joint_label(motion.joint_names, j)
        groups.append(
            dict(label=words.capital(label), summary=summary, rows=tuple(rows))
        )
    told = "of the robot description"
    if background.found is not None:
        told = "of the report, with its 90 % interval where the recordings so far "
        told += "determine it by itself"
    return Section(
        heading="Parameters",
        note=f"Now: {told}; parameters of bodies stand for the combinations that the "
        "torques depend on. New alone: half width of the 90 % interval from a "
        "recording of this motion, if nothing but noise is left. With both: from it "
        "and the recordings so far, at most; there are no correlations in the report, "
        f"which make it narrower still. {_noise_text(background)}",
        template="parameters",
        drawn=dict(
            groups=tuple(groups),
            heads=("parameter", "now (90 %)", "new alone", "with both", "unit", ""),
        )
        if groups
        else None,
    )


def _curves(motion, background):
    """Draw each joint's motion, with its limits."""
    step = max(1, math.ceil(motion.t.size / _POINTS))
    found = []
    for j in range(len(motion.joint_names)):
        label = words.joint_label(motion.joint_names, j)
        units = _units(motion, background)[j]
        for name, unit in zip(_QUANTITIES, units):
            what = "force" if (name, unit) == ("torque", "N") else name
            levels = [x for x in _ends(motion, name, j) if math.isfinite(x)]
            found.append(
                line_figure(
                    motion.t[::step],
                    _signal(motion, name)[::step, j],
                    title=f"{words.capital(what)} of {label}",
                    y_label=f"{what} [{unit}]",
                    levels=levels,
                )
            )
    return Section(
        heading="The motion",
        note="Torques are those that the model expects.",
        template="motion",
        drawn={"figures": tuple(found)},
    )


def _provenance(motion, background):
    from sklearn_vbjfa import __version__

    report = background.report
    recording = ((background.found or {}).get("provenance") or {}).get("file")
    if report and recording:
        files = [recording] if isinstance(recording, str) else recording
        report += f" (of {words.join(files)})"
    noise = [
        f"{words.joint_label(motion.joint_names, j)}: {_newtons(motion, x, j)}"
        f"{'' if measured else ', assumed'}"
        for j, (x, measured) in enumerate(zip(motion.noise, background.measured))
    ]
    rows = (
        ("Robot description", background.description),
        ("Report", report),
        ("Joints held at zero", ", ".join(background.held)),
        ("Sampling", f"{motion.t.size} rows, {1 / motion.dt:.4g} Hz"),
        *background.settings,
        ("Seed", str(background.seed)),
        ("Noise", tuple(noise)),
        ("Band of the fit", f"{words.number(motion.band)} Hz"),
        ("Package", f"sklearn_vbjfa {__version__}, {_versions()}"),
    )
    return Section(
        heading="Provenance",
        table=Table(rows=tuple(row for row in rows if row[1])),
    )


_SECTIONS = (
    _headline,
    _to_do,
    _decided,
    _margins,
    _invisible,
    _shown,
    _intervals,
    _curves,
    _provenance,
)


# -- the summary -----------------------------------------------------------------------


def summary(motion, background):
    """Say in fewer than 30 lines what a motion is and what it decides."""
    names = motion.joint_names
    of = f" for what {background.report} left open" if background.report else ""
    joints = words.plural(len(names), "joint")
    repeated = _wrapped(" ".join(_repeated_texts(motion, background)))
    wrong = _wrapped(" ".join(unchecked(motion)), "")
    lines = [
        f"Motion of {background.robot}{of}: {joints}, {motion.duration:g} s at "
        f"{1 / motion.dt:.4g} Hz",
        f"condition number {words.number(motion.condition_number)}, at first "
        f"{words.number(motion.start_condition_number)} (columns over their sizes at "
        "random states)",
        *wrong,
        "",
        # A screen has so many lines.
        *_shares_text(
            motion, background, _JOINTS - len(repeated) - max(len(wrong) - 2, 0)
        ),
        *([] if wrong else _wrapped(_clearance_text(motion), "")),
        "",
        *_decides_text(motion, background),
        *_never_text(motion, background),
        *repeated,
        _parameters_text(motion, background),
        *_wrapped(_noise_text(background)),
    ]
    while not lines[-1]:
        lines.pop()
    return lines


def _shares_text(motion, background, most):
    """Tabulate the shares of the limits that are used, in so many lines at most."""
    from tabulate import tabulate

    joints = range(len(motion.joint_names))
    used = {name: 1.0 - motion.margins[name] for name in _QUANTITIES}
    largest = np.max([used[name] for name in _QUANTITIES], axis=0)
    # The line that counts the others takes the place of a joint.
    listed = most if len(joints) <= most else most - 1
    shown = sorted(sorted(joints, key=lambda j: -largest[j])[:listed])
    rows = [
        [words.joint_label(motion.joint_names, j)]
        + [
            "-"
            if not math.isfinite(_ends(motion, name, j)[1])
            else words.whole_percent(used[name][j])
            for name in _QUANTITIES
        ]
        for j in shown
    ]
    heads = ["of the limits", *map(_bare, _QUANTITIES)]
    table = tabulate(
        rows,
        headers=heads,
        tablefmt="plain",
        disable_numparse=True,
        colalign=("left", *4 * ["right"]),
    )
    left = len(joints) - len(shown)
    return [*table.splitlines(), *([f"and {left} joints that use less"] * (left > 0))]


def _decides_text(motion, background):
    """List what is decided, or from which torques on effects show."""
    found = decisions(motion, background)
    if found:
        told = [
            f"- {words.joint_label(motion.joint_names, one.joint)}, from "
            f"{_newtons(motion, one.least, one.joint)}: {one.causes}"
            for one in found
        ]
        head = "It tells apart causes that exceed these torques"
    elif motion.shows:
        by_joint = {}
        for one in motion.shows:
            by_joint.setdefault(one.joint, []).append(one.least)
        told = [
            f"- {words.joint_label(motion.joint_names, j)}: "
            f"{words.plural(len(own), 'effect')}, the clearest from "
            f"{_newtons(motion, min(own), j)}, half of them from "
            f"{_newtons(motion, float(np.median(own)), j)}"
            for j, own in by_joint.items()
        ]
        head = "It shows effects that exceed these torques"
    else:
        return ["It determines the model; name effects that it shall show by --effects"]
    more = len(told) - _LISTED
    more = [f"- {more} more on the page"] if more > 0 else []
    listed = [line for text in told[:_LISTED] for line in _wrapped(text)]
    return [head, *listed, *more]


def _never_text(motion, background):
    """List what stays open or invisible."""
    told = [f"{words.capital(one)}." for one in undecided(motion)[:_LISTED]]
    told += invisible_sentences(motion, background, most=2)
    return [line for text in told for line in _wrapped(text)]


def _parameters_text(motion, background):
    """Say how many parameters become narrower."""
    narrower = _narrower(motion, background)
    if narrower is None:
        return ""
    better, known, middle = narrower
    return (
        f"Parameters: with both, {better} of {known} intervals become narrower, "
        f"the middle one {words.number(middle, 2)} times"
    )


def steps(motion, background):
    """List what to do next for a terminal, from 0 where something comes first."""
    before, told = _before(motion), []
    number = 1 - len(before)
    for step in (*before, *background.commands):
        if step.startswith("python "):
            told.append(step)
            continue
        told += _wrapped(f"{number}. {step}", "   ")
        number += 1
    return told


def _wrapped(text, indent="  "):
    """Break a text into lines of a terminal, the further ones indented."""
    return textwrap.wrap(text, _WIDTH, subsequent_indent=indent, break_on_hyphens=False)


def exceeded(motion):
    """Say which limit a motion exceeds the most, or where its margin is too small."""
    worst = min(_QUANTITIES, key=lambda name: motion.margins[name].min())
    j = int(np.argmin(motion.margins[worst]))
    label = words.joint_label(motion.joint_names, j)
    margin = float(motion.margins[worst][j])
    nearest = motion.margins.get("clearance", math.inf)
    if margin >= MARGIN - 1e-6:
        return (
            f"bodies come as near as {1e3 * nearest:.3g} mm, where {1e3 * ROOM:g} mm "
            "are kept"
        )
    limit = f"the limit of {_bare(worst)} of {label}"
    if margin < 0:
        return f"{limit} is exceeded by {words.percent(-margin)}"
    return f"{limit} is kept with {words.percent(margin)} to spare, not {MARGIN:.0%}"


# -- words -----------------------------------------------------------------------------


def effect_label(name):
    """Plain English for an effect of the library; other names as they are."""
    try:
        (effect,) = resolve((name,))
    except ValueError:
        return name.replace("_", " ")
    return effect.describe({}, lambda joint: f"joint {joint + 1}")


def _bare(name):
    return _BARE.get(name, name)


def _units(motion, background):
    """Units of position, velocity, acceleration and torque of each joint."""
    slides = motion.slides
    return [
        ("m", "m/s", "m/s^2", "N") if one else ("rad", "rad/s", "rad/s^2", "N m")
        for one in slides
    ]


def _newtons(motion, value, joint):
    """Write a torque or force with its unit."""
    unit = "N" if motion.slides[joint] else "N m"
    return f"{words.number(value, 2)} {unit}"


def _signal(motion, name):
    """Values (n, nv) of a quantity."""
    return dict(zip(_QUANTITIES, (motion.q, motion.v, motion.a, motion.tau)))[name]


def _ends(motion, name, j):
    """Lowest and highest value that a quantity of a joint may have."""
    limit = getattr(motion.limits, name)[j]
    if name == "position":
        return float(limit[0]), float(limit[1])
    return -float(limit), float(limit)


def _clearance_text(motion):
    """Say how near bodies come, or why that is not known."""
    if "clearance" in motion.margins:
        nearest = words.number(1e3 * motion.margins["clearance"])
        return (
            f"Bodies stay {nearest} mm apart (at least {1e3 * ROOM:g} mm are kept); "
            "what stands around the robot is not known."
        )
    return " ".join(unchecked(motion))


def _repeated_texts(motion, background):
    """Say why to record another motion, once, where the recorded one repeats."""
    told = [
        f"{one['count']:.3g} times {words.number(one['seconds'])} s"
        for one in (background.found or {}).get("repeated") or ()
    ]
    if not told:
        return ()
    return (
        f"The motion so far repeats ({words.join(told, 2)}), and what the model lacks "
        f"repeats with it. This one does not within its {motion.duration:g} s: record "
        "it once, and others by another --seed.",
    )


def _noise_text(background):
    """Say where the noise comes from; empty where it was measured."""
    if background.measured.all():
        return ""
    return (
        "Noise was not measured: 1 % of the torque limits is assumed, and what depends "
        "on it is as uncertain."
    )


def _joint_of(name, names):
    """Joint that a parameter's name begins with, from zero; None for none."""
    found = [j for j, joint in enumerate(names) if name.startswith(f"{joint}:")]
    return max(found, key=lambda j: len(names[j]), default=None)


def _now(one, present):
    """Return what is known of a parameter now; None where nothing is."""
    # A single coefficient of an effect goes by the effect's name alone.
    if one.name in present:
        return present[one.name]
    longer = [x for x in present if x.startswith(f"{one.name}:")]
    return present[longer[0]] if len(longer) == 1 else None


def _together(one, now):
    """Half width from both recordings, at most; nan where none is known now."""
    # Of two information matrices that are added, what each says of one parameter adds
    # up at least: Schur complements are superadditive.
    if now is None or not (now.half_width > 0 and one.half_width > 0):
        return math.nan
    return 1.0 / math.hypot(1.0 / now.half_width, 1.0 / one.half_width)


def _half_text(half):
    """Write half of an interval; a dash where it is not known."""
    return f"+- {words.number(half, 2)}" if math.isfinite(half) else "-"


def _change(one, now):
    """By which factor both recordings make an interval narrower; nan if not known."""
    together = _together(one, now)
    return now.half_width / together if together > 0 else math.nan


def _change_text(factor):
    if math.isnan(factor):
        return ""
    if factor > _SAME:
        return f"{words.number(factor, 2)} times narrower"
    return "as now"


def _narrower(motion, background):
    """Count intervals that become narrower, of how many, and the middle factor."""
    present = background.present()
    factors = [_change(one, _now(one, present)) for one in motion.expected_intervals]
    factors = [x for x in factors if not math.isnan(x)]
    if not factors:
        return None
    better = sum(x > _SAME for x in factors)
    return better, len(factors), float(np.median(factors))


def _value_text(one, now):
    """Write what a parameter is now, with its interval where it has one."""
    value = one.value
    if now is not None and now.half_width > 0:
        half = now.half_width
        return words.with_error(value, (value - half, value + half))
    if not math.isfinite(value) or abs(value) < _ROUNDING * one.half_width:
        return "0" if math.isfinite(value) else ""
    return words.number(value)


def _versions():
    """Versions of what the motion was computed with."""
    import scipy

    from sklearn_vbjfa.model import import_pinocchio

    return (
        f"numpy {np.__version__}, scipy {scipy.__version__}, pinocchio "
        f"{import_pinocchio().__version__}"
    )
