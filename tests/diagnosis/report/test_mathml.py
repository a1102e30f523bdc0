"""Formulas of pages: LaTeX as MathML, against another converter and by hand."""

import re
import xml.etree.ElementTree as ET

import pytest

from sklearn_vbjfa.diagnosis.report import about_effect, added_torque, mathml
from sklearn_vbjfa.effects import Effect, resolve

FORMULAS = {effect.name: effect.formula for effect in resolve("all")}


def parts(formula):
    """MathML elements of a formula, parsed."""
    return ET.fromstring(f"<div>{mathml(formula)}</div>")


def scripts(tree):
    """Count what stands above and below something."""
    each = {"msub": 1, "msup": 1, "mover": 1, "msubsup": 2, "munderover": 2}
    return sum(each.get(one.tag.rpartition("}")[2], 0) for one in tree.iter())


def fractions(tree):
    return sum(one.tag.endswith("mfrac") for one in tree.iter())


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("x", "<mi>x</mi>"),
        (
            "F_v v^2",
            "<msub><mi>F</mi><mi>v</mi></msub><msup><mi>v</mi><mn>2</mn></msup>",
        ),
        (
            "x^2_j",
            "<msubsup><mi>x</mi><mi>j</mi><mn>2</mn></msubsup>",
        ),
        (
            r"\frac{1}{k}",
            "<mfrac><mrow><mn>1</mn></mrow><mrow><mi>k</mi></mrow></mfrac>",
        ),
        (r"a - b", "<mi>a</mi><mo>−</mo><mi>b</mi>"),
        (
            r"\mathrm{time\_constant}",
            '<mi mathvariant="normal">time_constant</mi>',
        ),
        (r"\ddot\tau", '<mover accent="true"><mi>τ</mi><mo>¨</mo></mover>'),
        (
            r"\left(q\right.",
            '<mrow><mo fence="true" form="prefix">(</mo><mi>q</mi></mrow>',
        ),
    ],
)
def test_small_formulas(formula, expected):
    assert mathml(formula) == f"<math>{expected}</math>"


def test_wide_spaces_are_where_a_line_may_break():
    assert mathml(r"a \quad\text{or}\quad b") == (
        "<math><mi>a</mi></math> <math><mtext>or</mtext></math> <math><mi>b</mi></math>"
    )


@pytest.mark.parametrize("name", FORMULAS)
def test_another_converter_reads_the_same(name):
    """The same symbols in the same order, and as many fractions and scripts."""
    other = pytest.importorskip("docutils.utils.math.latex2mathml")
    formula = added_torque(FORMULAS[name])
    found = parts(formula)
    written = str(other.tex2mathml(formula)).replace("&ApplyFunction;", "")
    expected = ET.fromstring(written)

    def symbols(tree):
        # Without what is not seen, and dots, which the other puts over the script.
        text = re.sub(r"[\s\u2061\u00a0.\u02d9¨]", "", "".join(tree.itertext()))
        return text.replace("-", "−")

    assert symbols(found) == symbols(expected)
    assert scripts(found) == scripts(expected)
    assert fractions(found) == fractions(expected)


@pytest.mark.parametrize(
    "formula",
    [
        r"\unknown{x}",
        r"{x",
        "x}",
        r"x_",
        r"\left( x",
        r"x \right)",
        r"\mathrm x",
        r"\text{x",
        "x & y",
        r"\frac{x}",
    ],
)
def test_what_is_not_known_is_refused(formula):
    with pytest.raises(ValueError, match=r"was expected|^expected|is not known|has no"):
        mathml(formula)


@pytest.mark.parametrize("formula", ["<script>", r"\text{<b>}", r"\mathrm{a&b}", "a<b"])
def test_whatever_stands_in_a_formula_is_text(formula):
    tree = parts(formula)
    tags = {one.tag for one in tree.iter()}
    assert tags <= {"div", "math", "mi", "mo", "mtext", "mn"}


def test_ones_own_formula_is_shown_as_it_is_where_it_cannot_be_typeset():
    class Own(Effect):
        """Something of one's own."""

        name = "own"
        formula = r"\oint <b>x</b>"

    class Bare(Effect):
        """Something without a formula."""

        name = "bare"

    about = about_effect(Own())
    assert about.formula == (r"<code>\Delta\tau = \oint &lt;b&gt;x&lt;/b&gt;</code>")
    assert about.paragraphs == (
        "Something of one's own.",
        "To see it: the joint moves.",
    )
    assert about.link == ""
    assert about_effect(Bare()).formula == ""
