"""Directives for the pages of the effects.

A page states where an effect occurs and what it resembles. Torque, parameters, picture,
rivals and export are computed by the package when the documentation is built.
"""

import inspect
import re
import sys
from functools import cache
from pathlib import Path

from docutils import nodes
from docutils.statemachine import StringList
from effect_facts import (
    explanation,
    file_sentence,
    parameters_of,
    source_of,
    step_sentence,
    style,
    typeset,
)
from numpydoc.docscrape import ClassDoc
from simulated_effects import (
    NOISE,
    containing,
    destinations,
    figure_of,
    rivals_of,
    uses,
)
from sphinx.util.docutils import SphinxDirective

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis.report import HEIGHT, WIDTH, environment, words

_SHEET = "effects.css"


# -- facts of the classes ----------------------------------------------------------


@cache
def all_uses():
    """How each effect is simulated, name -> `Use`."""
    return uses()


@cache
def drawn(name):
    """Return the picture of an effect, a `Figure`."""
    return figure_of(all_uses()[name])


def described(kind):
    """Return the parameters in the docstring of a class, name -> text."""
    return {
        name: " ".join(lines)
        for entry in ClassDoc(kind)["Parameters"]
        for name, lines in [(entry.name, entry.desc)]
        for name in name.split(", ")
    }


def _shown(value):
    if isinstance(value, tuple):
        return ", ".join(map(_shown, value))
    return f"``{value!r}``" if isinstance(value, str) else words.number(float(value))


# -- directives --------------------------------------------------------------------


class _OfEffect(SphinxDirective):
    """A directive with the name of an effect as its argument."""

    required_arguments = 1

    @property
    def use(self):
        """The simulated effect."""
        name = self.arguments[0]
        if name not in all_uses():
            raise self.error(f"{name} is no effect of the library.")
        self.env.note_dependency(inspect.getfile(type(all_uses()[name].effect)))
        return all_uses()[name]

    def parsed(self, lines):
        """Nodes of reStructuredText, a list."""
        holder = nodes.Element()
        source = f"effect {self.arguments[0]}" if self.arguments else "effects"
        # Names in docstrings are those of the effects' module.
        lines = [".. currentmodule:: sklearn_vbjfa.effects", "", *lines]
        text = StringList([line for one in lines for line in one.split("\n")], source)
        self.state.nested_parse(text, self.content_offset, holder)
        return holder.children


class Law(_OfEffect):
    """Description of an effect, its formula and its parameters."""

    def run(self):
        """Make the nodes."""
        use, kind = self.use, type(self.use.effect)
        first, *more = explanation(kind)
        lines = [first, "", *typeset(kind.formula), ""]
        lines += [f"{one}\n" for one in more]
        texts, now = described(kind), use.values
        lines += [
            ".. list-table::",
            "    :header-rows: 1",
            "    :widths: auto",
            "",
            "    * - parameter",
            "      - unit",
            "      - in the picture",
            "      - meaning, estimation",
        ]
        for name, (units, how) in parameters_of(use).items():
            what = f"{texts[name].rstrip('.')}; {how}" if name in texts else how
            value = _shown(now[name]) if name in now else "–"
            lines += [
                f"    * - ``{name}``",
                f"      - {units or '–'}",
                f"      - {value}",
                f"      - {what}",
            ]
        lines += ["", "Units are those of a revolute and of a prismatic joint."]
        return self.parsed(lines)


class Picture(_OfEffect):
    """The torque of an effect, drawn as in a report."""

    def run(self):
        """Make the nodes."""
        use = self.use
        draw = environment(True).get_template("figures.html.j2").module.figure
        html = f'<div class="vbjfa">{draw(drawn(use.effect.name))}</div>'
        caption = (
            "Simulation of a six-axis arm with known parameters, with noise of "
            f"{100 * NOISE:g} % of the RMS of the effect and the values of the table."
        )
        return [
            nodes.raw("", html, format="html"),
            nodes.paragraph("", caption, classes=["effect-caption"]),
        ]


class RivalsTable(_OfEffect):
    """Effects that explain the same torque, computed."""

    def run(self):
        """Make the nodes."""
        use, found = self.use, rivals_of(self.use)
        name = use.effect.name
        taken = 100 * (1 - found.kept)
        base = "rigid bodies, viscous and Coulomb friction, offset and rotor inertia"
        if name in ("viscous", "coulomb", "offset", "rotor_inertia"):
            base += ", without this term,"
        lines = [
            f"In the motion of the picture, {base} explain {taken:.0f} % of the mean "
            "square of its torque.",
        ]
        if found.others:
            shares = ", ".join(
                f"{_link(other)} {100 * share:.0f} %" for other, share in found.others
            )
            lines.append(f"Of the remainder, the following effects explain: {shares}.")
        else:
            lines.append("No other effect explains a third of the remainder.")
        inside = ", ".join(map(_link, use.effect.contains))
        outside = ", ".join(map(_link, containing(name)))
        if inside:
            lines.append(f"Simpler effects that it contains: {inside}.")
        if outside:
            lines.append(f"Effects that contain it: {outside}.")
        return self.parsed([" ".join(lines)])


def _link(name):
    """Return a link to the page of an effect."""
    (effect,) = effects.resolve(name)
    return f":doc:`{effect.label} <{name}>`"


class Facts(_OfEffect):
    """Identifiability of an effect and its export."""

    def run(self):
        """Make the nodes."""
        use, kind = self.use, type(self.use.effect)
        urdf, mjcf = destinations(use)
        lines = [
            f":what to record: {kind.record}",
            f":in a control loop (``step``): {step_sentence(use)}",
            f":in URDF: {file_sentence(urdf)}",
            f":in MJCF: {file_sentence(mjcf)}",
            f":class: ``sklearn_vbjfa.effects.{kind.__name__}``",
        ]
        lines.append(f":source: {source_of(kind)}")
        notes = "\n".join(ClassDoc(kind)["Notes"]).strip()
        return self.parsed([*lines, "", *([notes] if notes else [])])


class Index(_OfEffect):
    """All effects with small pictures, in the order of the library."""

    required_arguments = 0

    def run(self):
        """Make the nodes."""
        out, modules = [], {}
        for effect in effects.resolve("all"):
            modules.setdefault(type(effect).__module__, []).append(effect)
        for module, members in modules.items():
            heading = sys.modules[module].__doc__.split("\n")[0].rstrip(".")
            out.append(nodes.rubric("", re.split(": ", heading)[0]))
            cards = nodes.container(classes=["effect-cards"])
            for effect in members:
                card = nodes.container(classes=["effect-card"])
                card += nodes.raw("", thumbnail(drawn(effect.name)), format="html")
                card += self.parsed(
                    [
                        f":doc:`effects/{effect.name}`",
                        "",
                        f"``{effect.name}``; record: {effect.record}",
                    ]
                )
                cards += card
            out.append(cards)
        return out


def thumbnail(figure):
    """Draw the first chart of a figure without axes, as SVG."""
    paths = "".join(
        f'<path class="{kind}" d="{path}"/>'
        for kind, path in figure.charts[0].shapes
        if kind in ("zero", "spread", "law")
    )
    return (
        f'<div class="vbjfa"><svg viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'preserveAspectRatio="none" aria-hidden="true">{paths}</svg></div>'
    )


# -- style -------------------------------------------------------------------------


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
