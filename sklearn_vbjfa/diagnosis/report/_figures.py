"""Figures of an outcome, and what an effect is."""

import importlib.metadata
import inspect
import re

import numpy as np

from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.report._facts import FINE, anchors
from sklearn_vbjfa.diagnosis.report._pictures import (
    About,
    Figure,
    effect_figure,
    friction_figure,
    residual_figure,
    torque_figure,
)
from sklearn_vbjfa.effects import available


def effects(outcome):
    """Draw each effect over its own signal, and say what it is."""
    # One with too few rows for a picture has the words alone.
    found = []
    drawn = outcome.curves.get("effects", ())
    for effect, curves, anchor in zip(
        outcome.findings["effects"], drawn, anchors(outcome)
    ):
        if not anchor:
            continue
        kind = effect.effect
        named = effect.name, effect.joint, effect.parameters
        title = words.capital(words.effect_at(outcome, *named))
        about = None if kind is None else about_effect(kind)
        if curves is None:
            more = {"about": about, "anchor": anchor}
            found.append(Figure(title=title, charts=(), keys=(), **more))
            continue
        joint = words.joint_label(outcome.robot["joints"], curves.joint)
        if curves.joint != effect.joint or (kind is not None and kind.whole_robot):
            title += f", seen on {joint}"
        label = curves.signal
        if curves.kind != "signal":
            what = {"time": "time", "": f"torque of the effect on {joint}"}
            what = what.get(curves.kind, f"{curves.kind} of {joint}")
            label = f"{what} [{curves.unit}]"
        found.append(
            effect_figure(
                curves,
                title=title,
                x_label=label,
                y_label=f"residual [{outcome.errors[curves.joint].unit}]",
                about=about,
                anchor=anchor,
            )
        )
    return found


def torques(outcome):
    """Draw the torque of each joint over time, and both residuals below."""
    line = outcome.curves.get("line")
    floor, found = outcome.floor * outcome.column("spread"), []
    for one in () if line is None else line.torques:
        unit = outcome.errors[one.joint].unit
        what = "torque" if unit == "N m" else "force"
        title = words.joint_label(outcome.robot["joints"], one.joint)
        labels = f"{what} [{unit}]", f"residual [{unit}]"
        drawn = torque_figure(one, line, floor[one.joint], title=title, y_labels=labels)
        found.append(drawn)
    return found


def positions(outcome):
    """Draw the positions of each joint over held-out time, from commands alone."""
    line, found = outcome.curves.get("positions"), []
    for one in () if line is None else line.torques:
        unit = outcome.findings["commands_alone"]["units"][one.joint]
        factor, fine = FINE[unit]
        found.append(
            torque_figure(
                one,
                line,
                np.nan,
                title=words.joint_label(outcome.robot["joints"], one.joint),
                y_labels=(f"position [{unit}]", f"error [{fine}]"),
                x_label="held-out time, its stretches joined [s]",
                border="next stretch",
                finer=factor,
                from_zero=False,
            )
        )
    return found


def friction(outcome):
    """Draw the friction of each joint over speed."""
    return [
        friction_figure(
            one,
            title=words.joint_label(outcome.robot["joints"], one.joint),
            y_label=f"friction [{outcome.errors[one.joint].unit}]",
        )
        for one in outcome.curves.get("friction", ())
    ]


def residuals(outcome):
    """Draw each residual over the predicted torque, and its autocorrelation."""
    return [
        residual_figure(
            one,
            title=words.joint_label(outcome.robot["joints"], one.joint),
            unit=outcome.errors[one.joint].unit,
        )
        for one in outcome.curves.get("residuals", ())
    ]


# -- what an effect is -----------------------------------------------------------------


def about_effect(effect):
    """Return what an effect is, an `About`: formula, docstring, source, page."""
    shown_by = f"To identify it, record {effect.record}."
    told = [*explanation(type(effect)), shown_by, source_of(type(effect))]
    return About(
        formula=added_torque(effect.formula) if effect.formula else "",
        paragraphs=tuple(words.without_markup(one) for one in told if one),
        link=documentation_of(effect.name),
    )


def explanation(kind):
    """Return what a class says it is: its docstring up to the sections, a tuple."""
    text = inspect.getdoc(kind) or ""
    paragraphs = re.split(r"\n\n\w+\n-{3,}\n", text)[0].split("\n\n")
    return tuple(" ".join(one.split()) for one in paragraphs if one.strip())


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
