"""Rendering of templates: sentences, pages, and terminal text."""

import html
import re
import textwrap
from functools import lru_cache, partial
from operator import attrgetter

import numpy as np
from tabulate import tabulate

from sklearn_vbjfa.diagnosis.explain import ABOVE_FLOOR
from sklearn_vbjfa.diagnosis.report import _facts, _pictures
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.effects import InModel
from sklearn_vbjfa.robot._channels import HALF_WIDTH

# Line width of the terminal, and longest word that a table does not break [characters].
_LINE_WIDTH, _LONG_WORD = 80, 20
# Spaces at which lines are not broken, such as those before units.
_NO_BREAK = re.compile(
    r"(?<=\d) (?=%|x\b|Hz|N\b|m\b|rad|kg|s\b)|(?<=\bN) (?=m\b)|(?<=kg) (?=m)| (?=s/)|"
    r" (?=\+-)|(?<=\+-) | (?==)|(?<=[<>=]) (?=\d)|(?<=joint) (?=\d)| (?=: 1)|"
    r"(?<= :) (?=1)"
)
# Typographic replacements in pages; a no-break space joins number and per cent sign.
_SIGNS = (("+-", "±"), ("^2", "²"), ("^3", "³"), (" %", "\u00a0%"))


@lru_cache
def environment(is_page, package=__package__):
    """Return the Jinja environment of a package, for pages or for plain text."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(package),
        autoescape=is_page,
        finalize=_page_value if is_page else None,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "line": line,
        "capital": words.capital,
        "wrap": _wrapped,
        "groups": lambda items, *names: _facts.grouped(items, attrgetter(*names)),
        "subject": lambda text: re.split("[:;] |(?<!'), ", text)[0].rstrip("."),
        "without_asides": lambda text: re.sub(r" \([^()]*\)", "", text),
    }
    environment.globals |= _FUNCTIONS
    return environment


def line(text):
    """Collapse white space, and remove it before punctuation marks."""
    return re.sub(r"\s+([.,;)])(?=[\s.,;)]|$)", r"\1", " ".join(str(text).split()))


# Functions for templates: those of `words`, and a few more.
_FUNCTIONS = {name: x for name, x in vars(words).items() if callable(x)} | {
    "above_floor": ABOVE_FLOOR[0],
    "agrees": _facts.agrees,
    "each": lambda macro, items: [line(macro(item)) for item in items],
    "finite": lambda x: bool(np.isfinite(x)),
    "half_width": HALF_WIDTH,
    "height": _pictures.HEIGHT,
    # Position in per cent on a scale from zero.
    "on_scale": lambda x, longest: 100 * min(max(x / longest, 0.0), 1.0),
    # Rounded to a thousandth of a degree; adding zero removes the sign of -0.
    "rpy": lambda angles: f'"{" ".join(f"{round(x, 5) + 0.0:.5f}" for x in angles)}"',
    "scaled": lambda ends, factor: ends and tuple(factor * x for x in ends),
    "ticks": _pictures.ticks,
    "value_cells": _facts.value_cells,
    "width": _pictures.WIDTH,
    "with_half": lambda x, std: words.with_error(
        x, (x - HALF_WIDTH * std, x + HALF_WIDTH * std)
    ),
    "zip": zip,
}


class Renderer:
    """Renders a report on an outcome; sentences by names of template macros."""

    def __init__(self, outcome, verdict):
        self._outcome = outcome
        names, library = outcome.robot["joints"], outcome.robot["library"]
        self.values = {
            "o": outcome,
            "findings": outcome.findings,
            "robot": outcome.robot,
            "source": outcome.provenance,
            "settings": outcome.provenance.get("settings", {}),
            "v": verdict,
            "facts": lambda name, *args: getattr(_facts, name)(outcome, *args),
            "figures": lambda name: [
                getattr(_pictures, name)(outcome, curves)
                for curves in outcome.curves.get(name, ())
            ],
            "joint": partial(words.joint_label, names),
            "joints": partial(words.joint_list, names),
            "say": self,
            "recording": lambda k: outcome.provenance["recordings"][k],
            "rivals_of": partial(words.rival_labels, outcome),
            "signal": lambda s, j: words.signal_label(s.signal, names, j),
            "effect_at": lambda e: words.effect_at(
                outcome, e.name, e.joint, e.parameters
            ),
            "effect": partial(words.effect_label, outcome),
            "place": partial(words.place_label, outcome),
            "in_model": lambda name: isinstance(library[name], InModel),
        }
        sentences = environment(False).get_template("sentences.j2")
        self._module = sentences.make_module(self.values)
        advice = self._module.signal_advice, self._module.no_period
        self.values["wanted"] = _facts.to_record(outcome, verdict.status, *advice)

    def __call__(self, name, *values):
        """Render a sentence as one line, empty if it does not apply."""
        return line(getattr(self._module, name)(*values))

    def text(self):
        template = environment(False).get_template("terminal.txt.j2")
        text = template.render(self.values, table=text_table)
        return re.sub(r"\n{2,}(?=- )", "\n", text).strip("\n")

    def sections(self, *, whole):
        """Render nonempty sections: heading, anchor, markup and glossary."""
        values = self.values | {"whole": whole}
        module = environment(True).get_template("sections.html.j2").make_module(values)
        seen, sections = set(), []
        for heading, macro in module.order:
            body = macro()
            if not body.strip():
                continue
            terms = [
                (name, meaning)
                for form, name, meaning in module.terms
                if name not in seen and re.search(form, f"{heading}\n{_text(body)}")
            ]
            seen |= {name for name, _ in terms}
            anchor = re.sub(r"[^a-z]+", "-", heading.lower())
            sections.append((heading, anchor, body, module.glossary(terms)))
        return sections

    def page(self, *, whole=True):
        """Render the report as a whole page, or as a fragment for a notebook."""
        name = "page.html.j2" if whole else "fragment.html.j2"
        head, *sections = self.sections(whole=whole)
        return environment(True).get_template(name).render(head=head, sections=sections)


def _text(body):
    """Return the visible text of a section."""
    return html.unescape(re.sub("<[^>]*>", "\n", body)).replace("\u00a0", " ").strip()


def _page_value(value):
    """Replace plain signs by typographic ones."""
    if type(value) is str:
        for plain, sign in _SIGNS:
            value = value.replace(plain, sign)
    return value


def _wrapped(text, indent="  "):
    """Wrap a sentence, without breaks between numbers and units."""
    lines = textwrap.wrap(
        _NO_BREAK.sub("\u00a0", line(text)),
        _LINE_WIDTH,
        subsequent_indent=indent,
        break_on_hyphens=False,
    )
    return "\n".join(lines).replace("\u00a0", " ")


def text_table(heads, rows):
    """Format a table for a terminal; the first and last columns are wrapped to fit."""
    # All other columns are numbers.
    cells = [heads, *rows]
    widths = [max(map(len, column)) for column in zip(*cells)]
    last = len(widths) - 1
    # Only very long words are broken.
    words_of = [" ".join(column).split() for column in zip(*cells)]
    least = [min(max(map(len, column), default=0), _LONG_WORD) for column in words_of]
    while sum(widths) + 2 * last > _LINE_WIDTH:
        wrapped = [k for k in (0, last) if widths[k] > least[k]]
        if not wrapped:
            break
        widths[max(wrapped, key=widths.__getitem__)] -= 1
    table = tabulate(
        cells,
        tablefmt="plain",
        disable_numparse=True,
        colalign=["left", *["right"] * (last - 1), "left"][: last + 1],
        maxcolwidths=[widths[k] if k in (0, last) else None for k in range(last + 1)],
    )
    return "\n".join(row.rstrip() for row in table.splitlines())
