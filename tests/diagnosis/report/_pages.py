"""Synthetic outcomes with curves, and parsers of report pages."""

import re
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np

from sklearn_vbjfa.diagnosis.explain import Fact
from sklearn_vbjfa.effects import Ripple
from tests.diagnosis.report._outcomes import changed, make_outcome

FILES = ("report.json", "parameters.csv", "identified.urdf")


def made(nv=3, names=None, n_effects=2, **changes):
    """Make an outcome with curves, parameters and provenance."""
    outcome = make_outcome(nv=nv, names=names, n_effects=n_effects)
    names, effects = outcome.robot["joints"], outcome.findings["effects"]
    rng = np.random.default_rng(0)
    seconds = np.linspace(0.0, 20.0, 500)
    torques = tuple(
        SimpleNamespace(
            joint=j,
            seconds=seconds,
            measured=np.sin(seconds),
            before=0.9 * np.sin(seconds),
            after=np.where(seconds < 10, np.sin(seconds), np.nan),
            counts=seconds > 1.0,
        )
        for j in range(nv)
    )
    residuals = tuple(
        SimpleNamespace(
            joint=j,
            predicted=rng.standard_normal(200),
            residual=0.1 * rng.standard_normal(200),
            lags=0.01 * np.arange(40),
            correlation=0.9 ** np.arange(40),
            chance=0.1,
        )
        for j in range(nv)
    )
    drawn = {"torques": torques, "residuals": residuals}
    parameters = (
        Fact(
            kind="parameter",
            name=f"{name}:{symbol}",
            joint=j,
            value=1.5,
            interval=(1.25, 1.75),
            unit="kg",
            described=described,
            source=source,
        )
        for j, name in enumerate(names)
        for symbol, described, source in (
            ("m", 1.25, "yes"),
            ("viscous", np.nan, "in combination"),
        )
    )
    masses = (make_mass(n, 1.5, 1.2, KNOWN[j % 2], 0.1) for j, n in enumerate(names))
    values = {
        "effects": tuple(replace(e, effect=Ripple(joint=e.joint)) for e in effects),
        "curves": drawn,
        "facts": (*parameters, *masses),
        "provenance": outcome.provenance
        | {
            "recordings": ("slow", "fast"),
            "file": "logs/arm.csv",
            "description": "arm.urdf",
            "held": ("finger_left",),
            "warnings": ("Torque of joint 1 is coarse.", "Another warning."),
            "files": FILES,
        },
    }
    return changed(changed(outcome, **values), **changes)


KNOWN = ("yes", "in combination")


def make_mass(name, mass, described, source, std=np.inf):
    half = 1.645 * std if np.isfinite(std) else np.nan
    return Fact(
        kind="mass",
        name=name,
        joint=0,
        value=mass,
        interval=(mass - half, mass + half),
        unit="kg",
        source=source,
        described=described,
    )


def figures(page):
    return re.findall(r'<figure class="wide"[^>]*>.*?</figure>', page, re.DOTALL)


class _Page(HTMLParser):
    VOID = frozenset({"meta", "br"})

    def __init__(self):
        super().__init__()
        self.open, self.seen, self.attributes = [], [], []

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.attributes += attrs
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def parsed(html):
    page = _Page()
    page.feed(html)
    page.close()
    return page


def line_of(report):
    """Return the terminal text in one line."""
    return " ".join(str(report).split())


def text_of(report):
    """Return the text of the page in one line."""
    html = re.sub(r"<(style|script)\b.*?</\1>", "", report.to_html(), flags=re.DOTALL)
    text = unescape(re.sub("<[^>]*>", " ", html)).replace("±", "+-")
    return " ".join(text.split())


def section_of(report, heading):
    """Return the text of a section of the page; empty if it does not exist."""
    html = report.to_html()
    part = re.search(rf"<h2[^>]*>{heading}</h2>(.*?)(?=<h2|</main>)", html, re.DOTALL)
    if part is None:
        return ""
    text = unescape(re.sub("<[^>]*>", " ", part[1])).replace("±", "+-")
    return " ".join(text.split())
