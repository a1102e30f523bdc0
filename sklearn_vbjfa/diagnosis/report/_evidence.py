"""Pictures, parameters, settings and provenance of a report."""

import importlib.metadata
import inspect
import math
import re

import numpy as np

from sklearn_vbjfa.diagnosis.explain import Provenance
from sklearn_vbjfa.diagnosis.explain._gaps import ABOVE_FLOOR
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.report._findings import anchors
from sklearn_vbjfa.diagnosis.report._pictures import (
    About,
    Figure,
    effect_figure,
    friction_figure,
    spectrum_figure,
    torque_figure,
)
from sklearn_vbjfa.diagnosis.report._render import Section, Table, table_of
from sklearn_vbjfa.effects import available
from sklearn_vbjfa.robot._gains import HALF_WIDTH

_KNOWN = {
    "yes": "yes",
    "in combination": "in combination",
    "from the description": "as described",
    "no": "no",
}
_PARAMETER_HEADS: tuple[str, ...] = (
    "parameter",
    "identified (90 %)",
    "robot description (90 %)",
)
_PARAMETER_HEADS += ("unit", "identifiable", "learned")
# Units of errors of positions, with factors to them.
_FINE = {"rad": (1e3, "mrad"), "m": (1e3, "mm")}
_MODELS = {
    "before": "declared model",
    "plain": "model with the four friction terms",
    "after": "completed model",
}
# Share of the largest value of a body that rounding leaves of a zero.
_ROUNDING = 1e-9


# -- figures ----------------------------------------------------------------------


def effect_pictures(outcome, verdict):
    """Draw the effects."""
    return Section(
        heading="Effects in the torque",
        note="Partial residual of the completed model, without and with the effect, "
        "on all rows in which the joint moves, with the exported parameters. The "
        "errors above are on held-out data.",
        template="figures",
        drawn=effect_figures(outcome),
    )


def effect_figures(outcome):
    """Draw each effect over its own signal, and say what it is; None without any."""
    # One with too few rows for a picture has the words alone.
    found = []
    drawn = outcome.curves.get("effects", ())
    for effect, curves, anchor in zip(outcome.effects, drawn, anchors(outcome)):
        if not anchor:
            continue
        kind = effect.effect
        title = words.capital(
            words.effect_at(outcome, effect.name, effect.joint, effect.parameters)
        )
        about = None if kind is None else about_effect(kind)
        if curves is None:
            found.append(
                Figure(
                    title=title,
                    charts=(),
                    keys=(),
                    about=about,
                    anchor=anchor,
                )
            )
            continue
        joint = words.joint_label(outcome.joint_names, curves.joint)
        unit = outcome.torque_units[curves.joint]
        if curves.joint != effect.joint or (kind is not None and kind.whole_robot):
            title += f", seen on {joint}"
        found.append(
            effect_figure(
                curves,
                title=title,
                x_label=_signal_label(curves, joint),
                y_label=f"residual [{unit}]",
                about=about,
                anchor=anchor,
            )
        )
    return {"figures": tuple(found)} if found else None


def _signal_label(curves, joint):
    """Name the horizontal axis of an effect, with its unit."""
    if curves.kind == "signal":
        return curves.signal
    what = {"time": "time", "": f"torque of the effect on {joint}"}
    what = what.get(curves.kind, f"{curves.kind} of {joint}")
    return f"{what} [{curves.unit}]"


def about_effect(effect):
    """Return what an effect is, an `About`: formula, docstring, source, page."""
    told = [*explanation(type(effect)), _shown_by(effect), source_of(type(effect))]
    return About(
        formula=added_torque(effect.formula) if effect.formula else "",
        paragraphs=tuple(words.without_markup(one) for one in told if one),
        link=documentation_of(effect.name),
    )


def _shown_by(effect):
    """Say what a recording needs to show an effect; empty where its class does not."""
    needs = (("To see it", effect.visible), ("To tell it from others", effect.record))
    return " ".join(f"{goal}: {what}." for goal, what in needs if what)


def explanation(kind):
    """Return what a class says it is: its docstring up to the parameters, a tuple."""
    text = inspect.getdoc(kind) or ""
    paragraphs = text.split("\n\nParameters\n")[0].split("\n\n")
    return tuple(
        " ".join(paragraph.split()) for paragraph in paragraphs if paragraph.strip()
    )


def source_of(kind):
    """Return the literature that a class names, with its number; empty for none."""
    text = inspect.getdoc(kind) or ""
    listed = text.partition("\nReferences\n----------\n")[2].partition("\n\n")[0]
    return re.sub(r"^\.\. ", "", " ".join(listed.split()))


def added_torque(formula):
    """Write a formula of an effect, LaTeX, as what it adds to the torque."""
    return rf"\Delta\tau = {formula}"


def documentation_of(name):
    """Address of an effect's page; empty where the package names no documentation."""
    if name not in available():
        return ""
    try:
        given = importlib.metadata.metadata("sklearn-vbjfa").get_all("Project-URL", [])
    except importlib.metadata.PackageNotFoundError:
        return ""
    for entry in given:
        label, _, address = entry.partition(",")
        if label.strip().lower() == "documentation":
            return f"{address.strip().rstrip('/')}/effects/{name}.html"
    return ""


def commands_alone(outcome, verdict):
    """Tabulate and draw the positions that models reach from commands alone."""
    heading, one = "Closed loop: commands alone", outcome.commands_alone
    if one is None:
        return Section(heading=heading)
    names = outcome.joint_names
    errors = {"declared model": one.before, "with the four friction terms": one.plain}
    errors |= {"completed model": one.after, "at commands": one.told}
    if not outcome.added:
        del errors["with the four friction terms"]
    fine = [_FINE[unit] for unit in one.units]
    rows = [
        (words.joint_label(names, j), fine[j][1])
        + tuple(_sized(fine[j][0] * size[j]) for size in errors.values())
        for j in range(len(names))
    ]
    told, before, after = (
        _mean_size(x, one) for x in (one.told, one.before, one.after)
    )
    failed = [
        f"The {_MODELS[key]} was not simulated to its end: {text}"
        for key, text in one.failed.items()
        if key != "plain" or outcome.added
    ]
    if one.left_out:
        failed.append(f"Simulated without {words.join(one.left_out, 6)}.")
    sentence = (
        f"From the commands of {words.number(one.seconds)} s of held-out motion alone, "
        f"positions of the declared model are off by {before}, those of the completed "
        f"one by {after} (mean of the joints); a robot at its commanded positions is "
        f"off by {told}."
    )
    short = f"From commands alone, positions are off by {before} before, "
    return Section(
        heading=heading,
        sentences=(sentence, *failed),
        terminal=(f"{short}{after} after.",),
        table=Table(heads=("joint", "unit", *errors), rows=tuple(rows), numbers=True),
        note="Root mean squares of simulated minus recorded positions. Each held-out "
        "stretch is simulated from its recorded first state on; the models were fitted "
        "to the other rows.",
        template="commands_alone",
        drawn=position_figures(outcome),
    )


def _sized(value):
    """Write three digits of an error, so that those of a column compare."""
    return f"{value:#.3g}".rstrip(".") if np.isfinite(value) else words.number(value)


def _mean_size(errors, alone):
    """Write the mean errors of joints that turn and of those that slide."""
    texts = []
    for unit in dict.fromkeys(alone.units):
        own = np.array([x for x, other in zip(errors, alone.units) if other == unit])
        factor, name = _FINE[unit]
        size = "an unknown distance"
        if np.isfinite(own).all():
            size = f"{_sized(factor * own.mean())} {name}"
        texts.append(size)
    return words.join(texts)


def position_figures(outcome):
    """Draw the positions of each joint over held-out time; None without any."""
    line = outcome.curves.get("positions")
    if line is None:
        return None
    found = []
    for one in line.torques:
        unit = outcome.commands_alone.units[one.joint]
        factor, fine = _FINE[unit]
        found.append(
            torque_figure(
                one,
                line,
                np.nan,
                title=words.joint_label(outcome.joint_names, one.joint),
                y_labels=(f"position [{unit}]", f"error [{fine}]"),
                x_label="held-out time, its stretches joined [s]",
                border="next stretch",
                finer=factor,
                from_zero=False,
            )
        )
    return {"figures": tuple(found), "pairs": True}


def torques(outcome, verdict):
    """Draw the torques over time, and what both models leave of them below."""
    return Section(
        heading="Torque and residual over time",
        note="Both models were fitted to what is not shaded; where they agree, one "
        "line hides the other. Residuals are left out where the joint stands still.",
        template="figures",
        drawn=torque_figures(outcome),
    )


def torque_figures(outcome):
    """Draw the torques of each joint over time; None where they are not known."""
    line = outcome.curves.get("line")
    if line is None:
        return None
    floor = outcome.floor * outcome.spread
    found = []
    for one in line.torques:
        unit = outcome.torque_units[one.joint]
        what = "torque" if unit == "N m" else "force"
        title = words.joint_label(outcome.joint_names, one.joint)
        labels = f"{what} [{unit}]", f"residual [{unit}]"
        drawn = torque_figure(one, line, floor[one.joint], title=title, y_labels=labels)
        found.append(drawn)
    return {"figures": tuple(found)}


def friction(outcome, verdict):
    """Draw the friction of each joint over speed."""
    return Section(
        heading="Friction of each joint",
        note="Measured: the torque minus the rigid bodies and all other terms of the "
        "completed model, low-pass filtered. Lines are means at a speed; friction that "
        "varies with load or time scatters about them.",
        template="figures",
        drawn=_small(outcome, "friction", friction_figure, "friction"),
    )


def spectra(outcome, verdict):
    """Draw the spectrum of what both models leave."""
    return Section(
        heading="Spectrum of the residual",
        note="On held-out data. Shaded: the band of the fit, in which the errors are "
        "taken; nothing was fitted above it.",
        template="figures",
        drawn=_small(outcome, "spectra", spectrum_figure, "residual"),
    )


def _small(outcome, key, draw, what):
    """Draw curves of each joint side by side; None where there are none."""
    found = tuple(
        draw(
            one,
            title=words.joint_label(outcome.joint_names, one.joint),
            y_label=f"{what} [{outcome.torque_units[one.joint]}{one.per}]",
        )
        for one in outcome.curves.get(key, ())
    )
    return {"figures": found, "pairs": True} if found else None


# -- parameters -------------------------------------------------------------------


def parameters(outcome, verdict):
    """Tabulate the parameters and the robot description."""
    return Section(
        heading="Identified parameters",
        note="Of the exported model, fitted to all data. In combination: the torques "
        "depend on a combination with other parameters; the value is one of many. As "
        "described: the torques add little to the description, whose masses and "
        "inertias are assumed to be wrong by about a fifth; learned is the share of "
        "that variance that the torques removed.",
        template="parameters",
        drawn=parameter_groups(outcome),
    )


def parameter_groups(outcome):
    """Return the parameters of each joint with the description; None without any."""
    by_joint = {}
    for one in outcome.parameters:
        joint = _joint_of(one.name, outcome.joint_names)
        by_joint.setdefault(joint, []).append(one)
    groups = []
    for joint, own in by_joint.items():
        known = sum(one.known == "yes" for one in own)
        label = (
            "robot" if joint is None else words.joint_label(outcome.joint_names, joint)
        )
        groups.append(
            dict(
                label=label,
                summary=f"{known} of {len(own)} determined by the recording",
                rows=tuple(_cells(one, own, outcome, joint) for one in own),
            )
        )
    return {"groups": tuple(groups), "heads": _PARAMETER_HEADS} if groups else None


def _joint_of(name, names):
    """Joint that a parameter's name begins with, from zero; None for none."""
    found = [j for j, joint in enumerate(names) if name.startswith(f"{joint}:")]
    return max(found, key=lambda j: len(names[j]), default=None)


def _cells(one, group, outcome, joint):
    """Cells of a parameter: name, value, nominal value, unit, whether it is known."""
    name = one.name
    if joint is not None:
        name = name.removeprefix(f"{outcome.joint_names[joint]}:")
    largest = max((abs(p.value) for p in group if p.unit == one.unit), default=0.0)
    value = 0.0 if abs(one.value) < _ROUNDING * largest else one.value
    # A prior leaves each parameter of a joint an interval of its own.
    own = one.known == "yes" or any(np.isfinite(p.before) for p in group)
    half = HALF_WIDTH * one.before
    nominal = words.with_error(one.nominal, (one.nominal - half, one.nominal + half))
    return (
        name,
        words.with_error(value, one.interval if own else None),
        nominal if np.isfinite(one.nominal) else "",
        one.unit,
        _KNOWN[one.known],
        words.whole_percent(one.learned) if np.isfinite(one.learned) else "",
    )


# -- provenance -------------------------------------------------------------------


def provenance(outcome, verdict):
    """Say where the report comes from."""
    rows = provenance_rows(outcome)
    given = outcome.provenance
    return Section(
        heading="Provenance",
        table=table_of((), rows),
        template="provenance",
        drawn={"files": tuple(given.files)} if given else None,
    )


def provenance_rows(outcome):
    """Cells that say where the report comes from, (what, which)."""
    given = outcome.provenance or Provenance()
    recorded = outcome.recorded
    length = rate = ""
    if recorded is not None:
        length = words.plural(recorded.samples, "sample")
        if np.isfinite(recorded.seconds):
            length += f", {words.number(recorded.seconds, 4)} s"
            rate = f"{words.number(recorded.rate, 4)} Hz"
        count = len(outcome.recordings)
        if count > 1:
            length += f", {count} recordings ({words.join(outcome.recordings, 8)})"
    version = outcome.settings.get("versions", {}).get("sklearn_vbjfa", "")
    rows = (
        ("Recording" if isinstance(given.file, str) else "Recordings", given.file),
        ("Length", length),
        ("Sample rate", rate),
        ("Robot description", given.description),
        ("Joints held at zero", ", ".join(given.held)),
        ("Package", f"sklearn_vbjfa {version}" if version else ""),
        ("Warnings", tuple(given.warnings)),
    )
    return tuple(row for row in rows if row[1])


# -- method ----------------------------------------------------------------------------


def method(outcome, verdict):
    """Describe the settings and the method."""
    given = outcome.settings
    sentences = (_short(outcome), _split(given))
    sentences += (_named(given), _errors(given))
    versions = [f"{name} {v}" for name, v in given.get("versions", {}).items()]
    effects = given.get("effects", ())
    if not isinstance(effects, str):
        effects = ", ".join(map(str, effects)) or "none"
    seed = given.get("random_state")
    rows = (
        ("Declared model", _declared(outcome.declared)),
        ("Searched for", effects),
        ("Signals", ", ".join(given.get("signals", ()))),
        ("Seed", "" if seed is None else str(seed)),
        ("Versions", ", ".join(versions)),
    )
    sentences = tuple(filter(None, sentences))
    return Section(
        heading="Method",
        sentences=sentences,
        table=Table(rows=tuple(row for row in rows if row[1])),
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
        f"Too short for the residual of {where}, which {stays}: slow effects are not "
        "distinguishable from it."
    )


def _split(settings):
    """Say what was held out and how the rest was divided."""
    if "test_size" not in settings:
        return ""
    text = f"Held out: {words.whole_percent(settings['test_size'])} of the motion"
    if "untouched_stretches" in settings:
        count = settings["untouched_stretches"]
        text += f" ({count} {'stretch' if count == 1 else 'stretches'}"
        text += f", {words.number(settings['untouched_seconds'])} s)"
        if settings.get("undecided_stretches"):
            text += ", without those with a change of payload"
    if "n_blocks" in settings:
        seconds = words.number(settings.get("block_seconds", math.nan))
        text += f". Search: {settings['n_blocks']} blocks of {seconds} s in "
        text += f"{settings.get('n_folds', '?')} folds"
    if "correlation_seconds" in settings:
        seconds = settings["correlation_seconds"]
        known = math.isfinite(seconds)
        length = f"for {words.number(seconds, 2)} s" if known else "throughout"
        text += f"; residuals are correlated {length}"
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
        f"An effect is reported if its probability is at least {sure} ({candidates}, "
        f"of which {words.number(own['expected'])} is expected a priori) and it "
        f"removes at least {worth} of the squared error on data that was not fitted, "
        "significantly. A joint is unexplained above "
        f"{ABOVE_FLOOR[0]} times its noise floor."
    )


def _errors(settings):
    """Say what the model was fitted to in the end."""
    if "error_seconds" not in settings:
        return ""
    return (
        "The exported model was fitted to all data, in the same band, after the errors "
        "were measured."
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
