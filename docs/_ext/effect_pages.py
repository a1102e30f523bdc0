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
from effect_facts import (
    parameters_of,
    style,
    told_of_file,
    told_of_step,
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
from sklearn_vbjfa.diagnosis.report import (
    HEIGHT,
    WIDTH,
    explanation,
    figure,
    source_of,
    words,
)

_SHEET = "effects.css"


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
        # Names in docstrings are those of the effects' module.
        lines = [".. currentmodule:: sklearn_vbjfa.effects", "", *lines]
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
        html = f'<div class="vbjfa">{figure(drawn(use.effect.name))}</div>'
        own = use.effect.seen_over or "own torque"
        seen = (
            ""
            if use.signal is None
            else f" Reports draw it over its {own}, as they do for any robot."
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
