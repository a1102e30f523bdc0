"""Directives for the pages of the effects; facts come from the classes themselves.

A page holds a formula in words, where an effect is met and what it is confused with.
Its torque, parameters, picture, rivals and destinations are made when the guide is
built, by the package's own code.
"""

import inspect
import re
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

from docutils import nodes
from docutils.statemachine import StringList
from numpydoc.docscrape import ClassDoc
from simulated_effects import (
    NOISE,
    containing,
    destinations,
    figure_of,
    rivals_of,
    step_reasons,
    uses,
)
from sphinx.util.docutils import SphinxDirective

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis.report import _render
from sklearn_vbjfa.diagnosis.report._charts import HEIGHT, WIDTH
from sklearn_vbjfa.diagnosis.report._evidence import (
    added_torque,
    explanation,
    source_of,
)
from sklearn_vbjfa.diagnosis.report._words import number

# Attributes of a written file that come with others and say nothing by themselves.
_WITH_OTHERS = {
    "biastype",
    "coef",
    "joint",
    "name",
    "range",
    "solimpfriction",
    "solreffriction",
}
_SHEET = "effects.css"
# Characters of LaTeX that fit in a line of a page.
_LINE = 95
# The report follows the system; the guide has a switch of its own.
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


# -- what the classes say ----------------------------------------------------------


@cache
def all_uses():
    """How each effect is simulated, name -> `Use`."""
    return uses()


@cache
def drawn(name):
    """Picture of an effect, a `Figure`: with it nothing but noise would be left."""
    figure = figure_of(all_uses()[name])
    return replace(figure, charts=figure.charts[:1])


def symbols(formula):
    r"""Names of what stands in a formula, as the code has them, a set of str.

    ``F_{vm}`` is Fvm, ``\\Delta F_c`` is dFc, ``\\mathrm{time\\_constant}`` is
    time_constant.
    """
    text = re.sub(r"\\text\{[^}]*\}|\\(left|right|q?quad|[,;: ])", " ", formula)
    text = text.replace(r"\_", "_UNDERSCORE_").replace(r"\Delta", " d")
    text = re.sub(r"\bd\s+(?=[A-Z\\])", "d", text)
    text = re.sub(r"\\(sin|cos|tanh|frac|partial|ge|dot|ddot)(?![a-z])", " ", text)
    text = re.sub(r"\\mathrm\{([^}]*)\}", r" \1 ", text)
    text = text.replace("_UNDERSCORE_", "\x00")
    found = re.findall(r"\\?[A-Za-z\x00]+(?:_(?:\{\s*\w+\s*\}|\w|\s\w+))?", text)
    return {re.sub(r"[\\_{}\s]", "", one).replace("\x00", "_") for one in found}


def parameters_of(use):
    """Return what an effect's parameters are, name -> (units, how found).

    Of all its forms: those that are plain come first.
    """
    kinds = {}
    for effect in (type(use.effect)(joint=use.effect.joint), use.effect):
        fitted = effect.parameters([1.0] * len(effect.coefficients))
        turning, sliding = (effect.parameter_units(p) for p in (False, True))
        for name in dict.fromkeys((*fitted, *effect.shape())):
            units = [unit[name] for unit in (turning, sliding) if name in unit]
            units = " or ".join(dict.fromkeys(units)).replace("^2", "²")
            how = "fitted" if name in fitted else "tried"
            if name in effect.continuous:
                how = "searched" if name not in fitted else "fitted and searched"
            if effect.in_model:
                how = "corrected step by step"
            kinds.setdefault(name, (units.replace("^3", "³"), how))
    return kinds


def described(kind):
    """Return what a class says of its parameters, name -> text."""
    return {
        name: _plain(" ".join(lines))
        for entry in ClassDoc(kind)["Parameters"]
        for name, lines in [(entry.name, entry.desc)]
        for name in name.split(", ")
    }


def _plain(text):
    """Text of a docstring whose references are listed elsewhere on the page."""
    return re.sub(r"(\[\d+\])_", r"\1", text)


def typeset(formula):
    """Return a directive that shows what an effect adds, with a long one in lines."""
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


def _shown(value):
    if isinstance(value, tuple):
        return ", ".join(map(_shown, value))
    return f"``{value!r}``" if isinstance(value, str) else number(float(value))


# -- directives --------------------------------------------------------------------


class _OfEffect(SphinxDirective):
    """A directive with the name of an effect as its argument."""

    required_arguments = 1

    @property
    def use(self):
        """The effect as it is simulated."""
        name = self.arguments[0]
        if name not in all_uses():
            raise self.error(f"{name} is no effect of the library.")
        self.env.note_dependency(inspect.getfile(type(all_uses()[name].effect)))
        return all_uses()[name]

    def parsed(self, lines):
        """Nodes of reStructuredText, a list."""
        holder = nodes.Element()
        source = f"effect {self.arguments[0]}" if self.arguments else "effects"
        text = StringList([line for one in lines for line in one.split("\n")], source)
        self.state.nested_parse(text, self.content_offset, holder)
        return holder.children


class Law(_OfEffect):
    """What an effect is, its formula and its parameters."""

    def run(self):
        """Make the nodes."""
        use, kind = self.use, type(self.use.effect)
        first, *more = map(_plain, explanation(kind))
        lines = [first, "", *typeset(kind.formula), ""]
        lines += [f"{one}\n" for one in more]
        told, now = described(kind), use.values
        lines += [
            ".. list-table::",
            "    :header-rows: 1",
            "    :widths: auto",
            "",
            "    * - parameter",
            "      - unit",
            "      - in the picture",
            "      - what it is, how it is found",
        ]
        for name, (units, how) in parameters_of(use).items():
            what = f"{told[name].rstrip('.')}; {how}" if name in told else how
            value = _shown(now[name]) if name in now else "–"
            lines += [
                f"    * - ``{name}``",
                f"      - {units or '–'}",
                f"      - {value}",
                f"      - {what}",
            ]
        lines += ["", "Units are those of a revolute or a prismatic joint."]
        return self.parsed(lines)


class Picture(_OfEffect):
    """The torque of an effect, drawn as in a report."""

    def run(self):
        """Make the nodes."""
        use = self.use
        html = f'<div class="vbjfa">{_render.figure(drawn(use.effect.name))}</div>'
        own = use.effect.seen_over or "own torque"
        seen = (
            ""
            if use.signal is None
            else f" Reports draw it over its {own}, as for any robot."
        )
        caption = (
            "Simulated: a made-up six-axis arm that is known exactly, noise of "
            f"{100 * NOISE:g} % of the effect's root mean square, and the values of "
            f"the table, chosen to be seen.{seen}"
        )
        return [
            nodes.raw("", html, format="html"),
            nodes.paragraph("", caption, classes=["effect-caption"]),
        ]


class RivalsTable(_OfEffect):
    """What explains the torque of an effect as well, computed."""

    def run(self):
        """Make the nodes."""
        use, found = self.use, rivals_of(self.use)
        name = use.effect.name
        taken = 100 * (1 - found.kept)
        beside = "bodies, viscous and Coulomb friction, offset and rotor inertia"
        if name in ("viscous", "coulomb", "offset", "rotor_inertia"):
            beside += ", but for this one,"
        lines = [
            f"In the motion of the picture, {beside} take over {taken:.0f} % of the "
            "mean square of its torque.",
        ]
        if found.others:
            told = ", ".join(
                f"{_link(other)} {100 * share:.0f} %" for other, share in found.others
            )
            lines.append(f"Of the rest, others explain with their best shape: {told}.")
        else:
            lines.append("Of the rest, no other effect explains a third.")
        inside = ", ".join(map(_link, use.effect.contains))
        outside = ", ".join(map(_link, containing(name)))
        if inside:
            lines.append(f"It is judged beside what it contains: {inside}.")
        if outside:
            lines.append(f"Those that contain it are judged beside it: {outside}.")
        return self.parsed([" ".join(lines)])


def _link(name):
    """Link to the page of an effect, under what it is called in a sentence."""
    (effect,) = effects.resolve(name)
    return f":doc:`{effect.label} <{name}>`"


class Facts(_OfEffect):
    """What shows an effect, and where it goes."""

    def run(self):
        """Make the nodes."""
        use, kind = self.use, type(self.use.effect)
        urdf, mjcf = destinations(use)
        lines = [
            f":shows if the recording has: {kind.visible}",
            f":to tell it from rivals, record: {kind.record}",
            f":in a control loop, ``step``: {told_of_step(use)}",
            f":in URDF: {told_of_file(urdf)}",
            f":in MJCF: {told_of_file(mjcf)}",
            f":class: `~sklearn_vbjfa.effects.{kind.__name__}`",
        ]
        lines.append(f":source: {source_of(kind)}")
        notes = "\n".join(ClassDoc(kind)["Notes"]).strip()
        return self.parsed([*lines, "", *([_plain(notes)] if notes else [])])


def told_of_file(destination):
    """Say what a file has of an effect."""
    places = [one.split(": ") for one in destination.places]
    places = [
        f"``{name}`` of ``{tag}``" for tag, name in places if name not in _WITH_OTHERS
    ]
    where = ", ".join(places)
    if not destination.lacks:
        return where
    lacks = destination.lacks.replace("; ", ";\n    ")
    return f"in part ({where}): {lacks}" if where else f"no place: {lacks}"


def told_of_step(use):
    """Say whether torques state by state have an effect."""
    reasons = step_reasons(use)
    refused = {reason for _, reason in reasons if reason}
    if not refused:
        memory = " with a memory" if use.effect.memory == "past" else ""
        return f"yes{memory}"
    (why,) = refused
    if all(reason for _, reason in reasons):
        return f"no: {why}"
    return f"yes; not with {_what_parts(reasons)}: {why}"


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


class Index(_OfEffect):
    """All effects with small pictures, in the order of the library."""

    required_arguments = 0

    def run(self):
        """Make the nodes."""
        out, modules = [], {}
        for effect in effects.resolve("all"):
            modules.setdefault(type(effect).__module__, []).append(effect)
        for module, own in modules.items():
            heading = sys.modules[module].__doc__.split("\n")[0].rstrip(".")
            out.append(nodes.rubric("", re.split(": ", heading)[0]))
            cards = nodes.container(classes=["effect-cards"])
            for effect in own:
                card = nodes.container(classes=["effect-card"])
                card += nodes.raw("", thumbnail(drawn(effect.name)), format="html")
                card += self.parsed(
                    [
                        f":doc:`effects/{effect.name}`",
                        "",
                        f"``{effect.name}``; to see it: {effect.visible}",
                    ]
                )
                cards += card
            out.append(cards)
        return out


def thumbnail(figure):
    """Draw the first chart of a figure without axes, as SVG."""
    shapes = [
        one for one in figure.charts[0].shapes if one.kind in ("zero", "spread", "law")
    ]
    paths = "".join(f'<path class="{one.kind}" d="{one.path}"/>' for one in shapes)
    return (
        f'<div class="vbjfa"><svg viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'preserveAspectRatio="none" aria-hidden="true">{paths}</svg></div>'
    )


# -- style -------------------------------------------------------------------------


def style():
    """Return the report's style sheet, with the guide's own switch for dark pages."""
    sheet = _render.style()
    colours = re.findall(r"\.vbjfa\{(--ink:[^}]*?--untouched:[^;}]*)", sheet)
    light, dark = colours[:2]
    return "".join(
        [
            sheet,
            _THEME,
            f'html[data-theme="light"] .vbjfa{{{light}}}\n',
            f'html[data-theme="dark"] .vbjfa{{{dark}}}\n',
        ]
    )


def _write_style(app):
    if app.builder.format == "html":
        folder = Path(app.outdir) / "_static"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / _SHEET).write_text(style(), encoding="utf-8")


def setup(app):
    """Add the directives."""
    for name, directive in (
        ("effect-law", Law),
        ("effect-picture", Picture),
        ("effect-rivals", RivalsTable),
        ("effect-facts", Facts),
        ("effect-index", Index),
    ):
        app.add_directive(name, directive)
    app.add_css_file(_SHEET)
    app.connect("builder-inited", _write_style)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
