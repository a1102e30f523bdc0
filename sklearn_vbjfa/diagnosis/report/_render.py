"""Templates: sentences as plain text, pages, and the layout of a terminal."""

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

# Characters of a terminal's line, and of the longest word that a table leaves whole.
_TERMINAL, _LONG = 80, 20
# Spaces at which no line is broken.
_UNIT = re.compile(
    r"(?<=\d) (?=%|x\b|Hz|N\b|m\b|rad|kg|s\b)|(?<=\bN) (?=m\b)|(?<=kg) (?=m)| (?=s/)|"
    r" (?=\+-)|(?<=\+-) | (?==)|(?<=[<>=]) (?=\d)|(?<=joint) (?=\d)| (?=: 1)|"
    r"(?<= :) (?=1)"
)
# Signs of a page; a number and its unit stay on one line.
_SIGNS = (("+-", "±"), ("^2", "²"), ("^3", "³"), (" %", "\u00a0%"))


# -- environments ----------------------------------------------------------------------


@lru_cache
def environment(is_page, package=__package__):
    """Return the templates of a page, or those of plain text, of a package."""
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
    """Collapse the white space of a text; none is left before a mark."""
    return re.sub(r"\s+([.,;)])(?=[\s.,;)]|$)", r"\1", " ".join(str(text).split()))


def _each(make, items):
    """Make a text of each item, a list."""
    return [line(make(one)) for one in items]


# Those of `words`, and a few more.
_FUNCTIONS = {name: x for name, x in vars(words).items() if callable(x)} | {
    "above_floor": ABOVE_FLOOR[0],
    "agrees": _facts.agrees,
    "each": _each,
    "finite": lambda x: bool(np.isfinite(x)),
    "half_width": HALF_WIDTH,
    "height": _pictures.HEIGHT,
    # Place in per cent on a scale from zero.
    "on_scale": lambda x, longest: 100 * min(max(x / longest, 0.0), 1.0),
    # To a thousandth of a degree, without the sign of a zero.
    "rpy": lambda angles: f'"{" ".join(f"{round(x, 5) + 0.0:.5f}" for x in angles)}"',
    "scaled": lambda ends, factor: ends and tuple(factor * x for x in ends),
    "ticks": _pictures.ticks,
    "value_cells": _facts.value_cells,
    "width": _pictures.WIDTH,
    "with_half": _facts.with_half,
    "zip": zip,
}


class Voice:
    """The sentences of a report on an outcome, by names of macros in the templates."""

    def __init__(self, outcome, verdict):
        self._outcome = outcome
        names, library = outcome.robot["joints"], outcome.robot["library"]
        self._values = {
            "o": outcome,
            "findings": outcome.findings,
            "robot": outcome.robot,
            "source": outcome.provenance,
            "settings": outcome.provenance.get("settings", {}),
            "v": verdict,
            "facts": lambda name, *given: getattr(_facts, name)(outcome, *given),
            "figures": lambda name: [
                getattr(_pictures, name)(outcome, one)
                for one in outcome.curves.get(name, ())
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
        self._module = sentences.make_module(self._values)
        advice = self._module.signal_advice, self._module.no_period
        self.add(wanted=_facts.to_record(outcome, verdict.status, *advice))

    def add(self, **values):
        """Add values that the templates of the page and of a terminal show."""
        self._values |= values

    def __call__(self, name, *values):
        """Return a sentence as one line, empty where there is nothing to say."""
        return line(getattr(self._module, name)(*values))

    def text(self):
        """Write the report for a terminal."""
        template = environment(False).get_template("terminal.txt.j2")
        text = template.render(self._values, table=text_table)
        return re.sub(r"\n{2,}(?=- )", "\n", text).strip("\n")

    def sections(self, *, whole):
        """Return heading, anchor, markup and terms of the sections that have any."""
        values = self._values | {"whole": whole}
        module = environment(True).get_template("sections.html.j2").make_module(values)
        known, found = set(), []
        for heading, make in module.order:
            body = make()
            if not body.strip():
                continue
            terms = [
                (name, meaning)
                for form, name, meaning in module.terms
                if name not in known and re.search(form, f"{heading}\n{_read(body)}")
            ]
            known |= {name for name, _ in terms}
            anchor = re.sub(r"[^a-z]+", "-", heading.lower())
            found.append((heading, anchor, body, module.glossary(terms)))
        return found

    def page(self, *, whole=True):
        """Write the report as a whole page, or as what a notebook shows."""
        name = "page.html.j2" if whole else "fragment.html.j2"
        head, *sections = self.sections(whole=whole)
        return environment(True).get_template(name).render(head=head, sections=sections)


def _read(body):
    """Return what is read of a section."""
    return html.unescape(re.sub("<[^>]*>", "\n", body)).replace("\u00a0", " ").strip()


def _page_value(value):
    """Write signs as a page has them."""
    if type(value) is str:
        for plain, sign in _SIGNS:
            value = value.replace(plain, sign)
    return value


# -- a terminal ------------------------------------------------------------------------


def _wrapped(text, indent="  "):
    """Wrap a sentence, with no number apart from its unit."""
    lines = textwrap.wrap(
        _UNIT.sub("\u00a0", line(text)),
        _TERMINAL,
        subsequent_indent=indent,
        break_on_hyphens=False,
    )
    return "\n".join(lines).replace("\u00a0", " ")


def text_table(heads, rows):
    """Lay out a table for a terminal; its widest texts are wrapped until it fits."""
    # All columns but the first and the last are numbers.
    cells = [heads, *rows]
    widths = [max(map(len, column)) for column in zip(*cells)]
    last = len(widths) - 1
    # No word is broken unless it is very long.
    words_of = [" ".join(column).split() for column in zip(*cells)]
    least = [min(max(map(len, column), default=0), _LONG) for column in words_of]
    while sum(widths) + 2 * last > _TERMINAL:
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
