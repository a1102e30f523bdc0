"""Pages of the effects: one per effect, consistent with the code."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa import effects

DOCS = Path(__file__).resolve().parents[1] / "docs"
sys.path.insert(0, str(DOCS / "_ext"))
import effect_facts  # noqa: E402
import simulated_effects  # noqa: E402

NAMES = effects.available()
USES = simulated_effects.uses()
PARTS = ("law", "picture", "rivals", "facts")
# Symbols in formulas that need no explanation on a page.
SIGNALS = {"q", "v", "a", "t", "tau", "tauload", "sign", "pi", "e", "i", "g", "d"}
SIGNALS |= {"qj", "vj", "aj", "tauj"}


def page(name):
    return (DOCS / "effects" / f"{name}.rst").read_text(encoding="utf-8")


def test_every_effect_has_a_page_and_every_page_an_effect():
    pages = {path.stem for path in (DOCS / "effects").glob("*.rst")}
    assert pages == set(NAMES) == set(USES)
    guide = (DOCS / "effects.rst").read_text(encoding="utf-8")
    assert re.findall(r"^    effects/(\w+)$", guide, flags=re.M) == list(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_pages_have_all_sections_and_valid_links(name):
    text = page(name)
    (effect,) = effects.resolve(name)
    title, line = text.splitlines()[:2]
    assert title.lower() == effect.label.lower()
    assert line == "=" * len(title)
    assert re.findall(r"^\.\. effect-(\w+):: (\w+)$", text, flags=re.M) == [
        (part, name) for part in PARTS
    ]
    links = re.findall(r":doc:`[^<`]+<([^>]+)>`|:doc:`([^<`]+)`", text)
    for link in map("".join, links):
        assert link != name
        target = DOCS / "effects" / link
        assert any(
            target.with_name(f"{target.name}{end}").is_file() for end in (".rst", ".md")
        ), link


@pytest.mark.parametrize("name", NAMES)
def test_symbols_of_formulas_are_explained(name):
    use = USES[name]
    explanation = effect_facts.explanation(type(use.effect))
    assert "---" not in " ".join(explanation)
    text = page(name) + " ".join(explanation)
    parameters = effect_facts.parameters_of(use)
    formula = effect_facts.symbols(use.effect.formula)
    explained = effect_facts.symbols(
        " ".join(re.findall(r":math:`([^`]*)`", text.replace("\n", " ")))
    )
    words = set(re.findall(r"\w+", text))
    for symbol in formula - set(parameters) - SIGNALS:
        assert symbol in explained | words, symbol
    for symbol, (units, _) in parameters.items():
        if units:
            assert symbol in formula | words, symbol


@pytest.mark.parametrize("name", NAMES)
def test_sources_are_in_the_bibliography(name):
    (effect,) = effects.resolve(name)
    bibliography = " ".join((DOCS / "references.bib").read_text("utf-8").split())
    source = effect_facts.source_of(type(effect))
    assert source
    for doi in re.findall(r":doi:`([^`]+)`", source):
        assert doi in bibliography, doi
    author, year = re.search(r"^([^,( ]+).*?\((\d{4})\)", source).groups()
    entries = re.sub(r"{\\.(\w)}", r"\1", bibliography).split("@")
    assert any(author in entry and year in entry for entry in entries), source


@pytest.mark.parametrize("name", ["viscous", "coulomb", "offset"])
def test_published_values_match_the_table(name):
    table = (DOCS / "tables" / "protocol_emps.rst").read_text("utf-8")
    label = {"viscous": "Fv", "coulomb": "Fc", "offset": "offset"}[name]
    unit = {"viscous": "N s/m", "coulomb": "N", "offset": "N"}[name]
    published = re.search(rf"^{label} \[{unit}\]\s+(\S+)", table, flags=re.M)[1]
    shown = re.search(rf"^(-?[\d.]+) {unit} on the linear drive", page(name), re.M)[1]
    assert float(shown) == round(float(published), len(shown.partition(".")[2]))


@pytest.mark.parametrize("name", NAMES)
def test_figures_show_the_effect(name):
    figure = simulated_effects.figure_of(USES[name])
    chart = figure.charts[0]
    kinds = {kind for kind, _ in chart.shapes}
    assert {"cloud", "law", "spread", "mean-before"} <= kinds
    assert re.search(r"\[[^\]]+\]$", chart.x_label)
    assert re.search(r"\[N m\]$", chart.y_label)
    torque = simulated_effects.torque_of(USES[name], simulated_effects.scene().motion)
    assert np.abs(torque[:, USES[name].joint]).max() > 0


def test_rival_shares_match_least_squares():
    """Compare with one joint regression on the base columns and the candidate."""
    use = USES["stribeck"]
    arm = simulated_effects.scene()
    base = simulated_effects._base_columns("")
    sizes = arm.motion.torque.std(axis=0)
    step = simulated_effects.EVERY
    torque = (simulated_effects.torque_of(use, arm.motion) / sizes)[::step].ravel()
    rivals = simulated_effects.rivals_of(use)
    start = torque - base @ np.linalg.lstsq(base, torque, rcond=None)[0]
    assert_allclose(rivals.kept, start @ start / (torque @ torque), rtol=1e-9)
    other = simulated_effects.columns_of(effects.ViscousQuadratic(joint=1), arm.motion)
    other = (other / sizes[:, None])[::step].reshape(-1, 1)
    columns = np.hstack([base, other])
    residual = torque - columns @ np.linalg.lstsq(columns, torque, rcond=None)[0]
    share = dict(rivals.others)["viscous_quadratic"]
    assert_allclose(share, 1 - residual @ residual / (start @ start), rtol=1e-6)
