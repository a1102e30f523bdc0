"""Sections of a page that show what was measured: figures, parameters, provenance."""

import html
import importlib.metadata
import inspect
import re
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.explain import Provenance
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.report._charts import (
    About,
    Figure,
    effect_figure,
    torque_figure,
)
from sklearn_vbjfa.diagnosis.report._mathml import mathml
from sklearn_vbjfa.effects import available
from sklearn_vbjfa.robot._gains import HALF_WIDTH

_KNOWN = {
    "yes": "yes",
    "in combination": "only with others",
    "from the description": "as described",
    "no": "no",
}
# Share of the largest value of a body that rounding leaves of a zero.
_ROUNDING = 1e-9


# -- figures ----------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Figures of a section."""

    figures: tuple


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
                    data={},
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
    return Figures(figures=tuple(found)) if found else None


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
        formula=_typeset(effect.formula),
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


def _typeset(formula):
    """Typeset what an effect adds; one's own effect may have none, or any LaTeX."""
    if not formula:
        return ""
    try:
        return mathml(added_torque(formula))
    except ValueError:
        return f"<code>{html.escape(added_torque(formula))}</code>"


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


def torque_figures(outcome):
    """Draw the torques of each joint over time; None where they are not known."""
    line = outcome.curves.get("line")
    if line is None:
        return None
    found = []
    for one in line.torques:
        unit = outcome.torque_units[one.joint]
        what = "torque" if unit == "N m" else "force"
        joint = words.joint_label(outcome.joint_names, one.joint)
        title, label = f"{words.capital(what)} of {joint}", f"{what} [{unit}]"
        found.append(torque_figure(one, line, title=title, y_label=label))
    return Figures(figures=tuple(found))


# -- parameters -------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ParameterGroup:
    """Parameters of a joint: its label, what is known of them, and rows of cells."""

    label: str
    summary: str
    rows: tuple


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """Groups of parameters, and the heads of their cells."""

    groups: tuple
    heads: tuple = (
        "parameter",
        "identified (90 %)",
        "robot description (90 %)",
        "unit",
        "measured?",
        "learned",
    )


def parameter_groups(outcome):
    """Parameters of each joint beside the robot description; None without any."""
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
            ParameterGroup(
                label=words.capital(label),
                summary=f"{known} of {len(own)} determined by the recording",
                rows=tuple(_cells(one, own, outcome, joint) for one in own),
            )
        )
    return Parameters(groups=tuple(groups)) if groups else None


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


@dataclass(frozen=True, kw_only=True)
class Files:
    """Names of files beside the page."""

    files: tuple


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
