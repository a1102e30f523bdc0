"""Facts of the effect pages, read from the classes: text and LaTeX."""

import inspect
import re

from effect_curves import STYLE
from simulated_effects import step_reasons

from sklearn_vbjfa.diagnosis.report import environment
from sklearn_vbjfa.effects import InModel, Stateful

# Attributes of a written file that only accompany others.
_WITH_OTHERS = {
    "biastype",
    "coef",
    "joint",
    "name",
    "range",
    "solimpfriction",
    "solreffriction",
}
# Characters of LaTeX that fit in a line of a page.
_LINE = 95
# The report follows the system; the documentation has a theme switch.
_THEME = """
.vbjfa{background:none;padding:0}
.effect-cards{display:grid;gap:12px;
grid-template-columns:repeat(auto-fill,minmax(min(100%,215px),1fr))}
.effect-card{border:1px solid var(--pst-color-border,#ccc);border-radius:8px;
padding:8px 10px;font-size:.9em}
.effect-caption{font-size:.85em;margin-top:.4em}
.effect-card p{margin:.3em 0 0}
.effect-card svg{width:100%;height:84px;display:block}
.effect-card svg path{fill:none;vector-effect:non-scaling-stroke}
"""


def symbols(formula):
    r"""Return the names in a formula as in the code, a set of str.

    ``F_{vm}`` is Fvm, ``\Delta F_c`` is dFc, ``\mathrm{time\_constant}`` is
    time_constant.
    """
    text = re.sub(r"\\text\{[^}]*\}|\\(left|right|q?quad|[,;: ])", " ", formula)
    text = text.replace(r"\_", "_UNDERSCORE_").replace(r"\Delta", " d")
    text = re.sub(r"\bd\s+(?=[A-Z\\])", "d", text)
    text = re.sub(r"\\(sum_k|sin|cos|frac|partial|ge|dot|ddot)(?![a-z])", " ", text)
    text = re.sub(r"\\mathrm\{([^}]*)\}", r" \1 ", text)
    text = text.replace("_UNDERSCORE_", "\x00")
    found = re.findall(r"\\?[A-Za-z\x00]+(?:_(?:\{\s*\w+\s*\}|\w|\s\w+))?", text)
    return {re.sub(r"[\\_{}\s]", "", one).replace("\x00", "_") for one in found}


def parameters_of(use):
    """Return the parameters of an effect, name -> (units, how found)."""
    kinds = {}
    for effect in (type(use.effect)(joint=use.effect.joint), use.effect):
        fitted = effect.parameters([1.0] * len(effect.coefficients))
        turning, sliding = (effect.parameter_units(p) for p in (False, True))
        for name in dict.fromkeys((*fitted, *effect.shape())):
            units = [unit[name] for unit in (turning, sliding) if name in unit]
            units = " or ".join(dict.fromkeys(units)).replace("^2", "²")
            how = "fitted" if name in fitted else "tried on a grid"
            if name in fitted and name not in symbols(effect.formula):
                how = "derived from the others"
            if name in effect.continuous or name == "instant":
                how = "searched" if name not in fitted else "fitted and searched"
            if isinstance(effect, InModel) and name in effect.coefficients:
                how = "fitted iteratively"
            kinds.setdefault(name, (units.replace("^3", "³"), how))
    return kinds


def explanation(kind):
    """Return the docstring of a class up to its source, a tuple of paragraphs."""
    text = inspect.getdoc(kind) or ""
    paragraphs = re.split(r"Source:\s|\n\n\w+\n-{3,}\n", text)[0].split("\n\n")
    return tuple(" ".join(one.split()) for one in paragraphs if one.strip())


def source_of(kind):
    """Return the literature that a class names; empty for none."""
    listed = (inspect.getdoc(kind) or "").partition("Source:")[2].partition("\n\n")[0]
    return " ".join(listed.split()).rstrip(".")


def added_torque(formula):
    """Write a formula of an effect, LaTeX, as what it adds to the torque."""
    return rf"\Delta\tau = {formula}"


def without_markup(text):
    """Return a sentence of a docstring without the marks of reStructuredText."""
    text = re.sub(r":(\w+):`([^`]*)`", r"\1:\2", text)
    return re.sub(r"`+([^`]*)`+", r"\1", text)


def typeset(formula):
    """Return a directive with the torque of an effect, broken into lines."""
    whole = added_torque(formula)
    lines, first = [], ""
    for part in re.split(r"\s*\\q?quad\s*", whole):
        if part.strip() == r"\text{or}":
            first = r"\text{or}\quad "
        else:
            lines.append(first + part)
            first = ""
    if len(whole) <= _LINE or len(lines) == 1:
        return [".. math::", "", f"    {whole}"]
    together = r" \\ ".join(lines)
    return [".. math::", "", rf"    \begin{{gathered}} {together} \end{{gathered}}"]


def file_sentence(destination):
    """Return what a file holds of an effect."""
    places = [one.split(": ") for one in destination.places]
    places = [
        f"``{name}`` of ``{tag}``" for tag, name in places if name not in _WITH_OTHERS
    ]
    where = ", ".join(places)
    if not destination.lacks:
        return where
    lacks = destination.lacks.replace("; ", ";\n    ")
    return f"partly ({where}): {lacks}" if where else f"not available: {lacks}"


def step_sentence(use):
    """Return whether torques of single states include an effect."""
    reasons = step_reasons(use)
    refused = {reason for _, reason in reasons if reason}
    if not refused:
        stateful = isinstance(use.effect, Stateful)
        memory = ", with memory" if stateful else ""
        return f"yes{memory}"
    (why,) = refused
    if all(reason for _, reason in reasons):
        return f"no: {why}"
    return f"yes, except with {_what_parts(reasons)}: {why}"


def _what_parts(reasons):
    """Name the shapes that are refused by what only they have."""
    for name in reasons[0][0]:
        with_it, without = (
            {_sort(shape[name]) for shape, reason in reasons if bool(reason) is refused}
            for refused in (True, False)
        )
        if with_it.isdisjoint(without):
            return " or ".join(f"``{name}`` {one}" for one in sorted(with_it))
    raise ValueError("no shape parameter parts what is refused.")


def _sort(value):
    if isinstance(value, str):
        return f'"{value}"'
    return "< 0" if value < 0 else "> 0"


def style():
    """Return the style sheet of reports with the theme switch of the documentation."""
    sheet = environment(True).get_template("style.css.j2").render()
    colours = re.findall(r"\.vbjfa\{(--ink:[^}]*?--law:[^;}]*)", sheet)
    light, dark = colours[:2]
    return "".join(
        [
            sheet,
            STYLE,
            _THEME,
            f'html[data-theme="light"] .vbjfa{{{light}}}\n',
            f'html[data-theme="dark"] .vbjfa{{{dark}}}\n',
        ]
    )
