"""Formulas of pages: LaTeX as MathML."""

import re
import xml.etree.ElementTree as ET

import pytest

from sklearn_vbjfa.diagnosis.report import about_effect, added_torque, mathml
from sklearn_vbjfa.effects import Effect, resolve

FORMULAS = {effect.name: effect.formula for effect in resolve("all")}


@pytest.mark.parametrize("name", FORMULAS)
def test_each_formula_of_the_library_is_typeset(name):
    formula = added_torque(FORMULAS[name])
    tree = ET.fromstring(f"<div>{mathml(formula)}</div>")
    shown = "".join(tree.itertext())
    assert "\\" not in shown
    # Names of parameters stay in one piece, as the code has them.
    pieces = [one.text for one in tree.iter() if one.tag.endswith("mtext")]
    for word in re.findall(r"\\mathrm\{(.*?)\}", formula):
        assert word.replace("\\_", "_") in pieces
    fractions = [one for one in tree.iter() if one.tag.endswith("mfrac")]
    assert len(fractions) == formula.count("\\frac")


@pytest.mark.parametrize("formula", ["<script>", r"\text{<b>}", r"\left( <b>"])
def test_a_formula_is_text(formula):
    tags = {one.tag for one in ET.fromstring(f"<div>{mathml(formula)}</div>").iter()}
    assert not any(tag.endswith(("script", "}b")) or tag == "b" for tag in tags)


def test_an_effect_without_a_formula():
    class Bare(Effect):
        """Something without a formula."""

        name = "bare"

    about = about_effect(Bare())
    assert about.formula == ""
    assert about.paragraphs[0] == "Something without a formula."
