"""Figures of an outcome, and the description of an effect."""

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
    """Draw each effect over its own signal, and describe it."""
    shown, drawn = outcome.findings["effects"], outcome.curves.get("effects", ())
    found = []
    for effect, curves, anchor in zip(shown, drawn, anchors(outcome)):
        kind, joint = effect.effect, effect.joint
        if not anchor:
            continue
        title = words.effect_at(outcome, effect.name, joint, effect.parameters)
        title = words.capital(title)
        about = {"about": kind and about_effect(kind), "anchor": anchor}
        if curves is None:
            # Too few rows for a picture.
            found.append(Figure(title=title, charts=(), keys=(), **about))
            continue
        place, unit = _label(outcome, curves.joint), outcome.errors[curves.joint].unit
        if curves.joint != joint or (kind is not None and kind.whole_robot):
            title += f", seen on {place}"
        labels = {"signal": curves.signal, "time": f"time [{curves.unit}]"}
        labels[""] = f"torque of the effect on {place} [{curves.unit}]"
        label = labels.get(curves.kind, f"{curves.kind} of {place} [{curves.unit}]")
        axes = {"x_label": label, "y_label": f"residual [{unit}]"}
        found.append(effect_figure(curves, title=title, **axes, **about))
    return found


def _label(outcome, joint):
    return words.joint_label(outcome.robot["joints"], joint)


def torques(outcome):
    """Draw the torque of each joint over time, and both residuals below."""
    line, found = outcome.curves.get("line"), []
    for one in () if line is None else line.torques:
        own = outcome.errors[one.joint]
        what = "torque" if own.unit == "N m" else "force"
        labels = f"{what} [{own.unit}]", f"residual [{own.unit}]"
        known = {"title": _label(outcome, one.joint), "y_labels": labels}
        found.append(torque_figure(one, line, own.floor * own.spread, **known))
    return found


def positions(outcome):
    """Draw the positions of each joint over held-out time, from commands alone."""
    line, found = outcome.curves.get("positions"), []
    for one in () if line is None else line.torques:
        unit = outcome.findings["commands_alone"]["units"][one.joint]
        factor, fine = FINE[unit]
        drawn = torque_figure(
            one,
            line,
            np.nan,
            title=_label(outcome, one.joint),
            y_labels=(f"position [{unit}]", f"error [{fine}]"),
            x_label="held-out time, its stretches joined [s]",
            border="next stretch",
            finer=factor,
            from_zero=False,
        )
        found.append(drawn)
    return found


def friction(outcome):
    """Draw the friction of each joint over speed."""
    return [
        friction_figure(
            one,
            title=_label(outcome, one.joint),
            y_label=f"friction [{outcome.errors[one.joint].unit}]",
        )
        for one in outcome.curves.get("friction", ())
    ]


def residuals(outcome):
    """Draw each residual over the predicted torque, and its autocorrelation."""
    return [
        residual_figure(
            one, title=_label(outcome, one.joint), unit=outcome.errors[one.joint].unit
        )
        for one in outcome.curves.get("residuals", ())
    ]


# -- description of an effect ----------------------------------------------------------


def about_effect(effect):
    """Return formula, docstring, source and page of an effect, an `About`."""
    kind = type(effect)
    texts = [*explanation(kind), f"To identify it, record {effect.record}."]
    texts.append(source_of(kind))
    return About(
        formula=added_torque(effect.formula) if effect.formula else "",
        paragraphs=tuple(words.without_markup(one) for one in texts if one),
        link=documentation_of(effect.name),
    )


def explanation(kind):
    """Return the docstring of a class up to its sections, a tuple of paragraphs."""
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
    try:
        given = importlib.metadata.metadata("sklearn-vbjfa").get_all("Project-URL", [])
    except importlib.metadata.PackageNotFoundError:
        return ""
    pairs = (entry.partition(",") for entry in given)
    found = {label.strip().lower(): address.strip() for label, _, address in pairs}
    if name not in available() or "documentation" not in found:
        return ""
    return f"{found['documentation'].rstrip('/')}/effects/{name}.html"
