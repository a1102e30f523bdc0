"""What a section is, and how it becomes text and a page."""

import contextlib
import html
import re
import textwrap
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import zip_longest

from tabulate import tabulate

from sklearn_vbjfa.diagnosis.report import _pictures
from sklearn_vbjfa.diagnosis.report import _words as words

# Characters of a terminal's line, and of the longest word that a table leaves whole.
_TERMINAL, _LONG = 80, 20
# The frame of the pictures.
_SIZE = {"width": _pictures.WIDTH, "height": _pictures.HEIGHT}
# Entries of a list that a terminal shows as sentences; of more, each is a row.
_SENTENCES = 2
# What is read of a section, its tables and its figures.
_READ: tuple = ("heading", "sentences", "table", "note", "drawn")
_READ += ("heads", "rows", "title", "charts", "keys", "x_label", "y_label")
# Spaces at which no line is broken.
_UNIT = re.compile(
    r"(?<=\d) (?=%|x\b|Hz|N\b|m\b|rad|kg|s\b)|(?<=\bN) (?=m\b)|(?<=kg) (?=m)| (?=s/)|"
    r" (?=\+-)|(?<=\+-) | (?==)|(?<=[<>=]) (?=\d)|(?<=joint) (?=\d)| (?=: 1)|"
    r"(?<= :) (?=1)"
)


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows of cells, each a str or a tuple of str (one a line)."""

    heads: tuple = ()  # empty for none
    rows: tuple
    # where on its page the effect of each row leads; empty for nowhere
    links: tuple = ()
    # whether all columns but the first and the last are aligned as numbers are
    numbers: bool = False


@dataclass(frozen=True, kw_only=True)
class Section:
    """A part of the report."""

    heading: str  # which a terminal does not show
    sentences: tuple = ()  # paragraphs, or the entries of a list
    table: Table | None = None  # below them
    note: str = ""  # small print below that
    # of words that come first in it on a page: the word, and what it means
    terms: tuple = ()
    # what a terminal shows, sentences and tables: the verdict, its table, effects, and
    # what to do next, in about twenty lines
    terminal: tuple = ()
    # which of ``templates/<template>.html.j2`` draws it on a page
    template: str = "section"
    drawn: dict | None = None  # what only that template shows, by name

    @property
    def anchor(self):
        """Its place on a page, for the contents."""
        return re.sub(r"[^a-z]+", "-", self.heading.lower())


def table_of(heads, rows, **more):
    """Make a table; None without rows."""
    return Table(heads=heads, rows=tuple(rows), **more) if rows else None


def listed(sentences, rows):
    """Show a few entries as sentences, many as rows of a table."""
    return sentences if len(rows) <= _SENTENCES else (Table(rows=tuple(rows)),)


def paragraph(heading, sentences_of, *, terminal_of=None):
    """Return a section that is read as one paragraph, except where lists are."""
    # sentences_of, terminal_of (what a terminal has of them; None for nothing):
    # functions of the outcome and the verdict.

    def section(outcome, verdict):
        sentences = tuple(sentences_of(outcome, verdict))
        shown = () if terminal_of is None else terminal_of(outcome, verdict)
        return Section(
            heading=heading,
            sentences=sentences,
            terminal=(" ".join(shown),) if shown else (),
            template="paragraph",
        )

    return section


def explained(sections):
    """Return sections with what the terms mean that come first in each."""
    known, found = set(), []
    for section in sections:
        told = "\n".join(_texts(section))
        terms = [one for one in words.TERMS if one[1] not in known]
        terms = [(name, text) for form, name, text in terms if re.search(form, told)]
        known |= {name for name, _ in terms}
        found.append(replace(section, terms=tuple(terms)))
    return tuple(found)


def _texts(value):
    """Yield all texts that are read in a part of a section, not the data of it."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        yield from _texts(list(value.values()))
    elif isinstance(value, (tuple, list)):
        for one in value:
            yield from _texts(one)
    else:
        read = [getattr(value, key) for key in _READ if hasattr(value, key)]
        yield from _texts(read)


def plain_text(sections):
    """Write the sections for a terminal, with a line before a table that has heads."""
    out = ""
    for section in sections:
        for one in section.terminal:
            is_text = isinstance(one, str)
            out += ("\n" if is_text or not one.heads else "\n\n") if out else ""
            out += (
                _wrapped(one, "  " if out else "")
                if is_text
                else text_table(one.heads, one.rows, numbers=one.numbers)
            )
    return out


def _wrapped(sentence, indent):
    """Wrap a sentence, with no number apart from its unit."""
    whole = _UNIT.sub("\u00a0", sentence)
    lines = textwrap.wrap(
        whole, _TERMINAL, subsequent_indent=indent, break_on_hyphens=False
    )
    return "\n".join(lines).replace("\u00a0", " ")


def text_table(heads, rows, *, numbers):
    """Lay out a table for a terminal; its widest words are wrapped until it fits."""
    heads = zip_longest(*(head.splitlines()[::-1] for head in heads), fillvalue="")
    cells = [*list(heads)[::-1], *rows]
    widths = [max(map(len, column)) for column in zip(*cells)]
    last = len(widths) - 1
    flexible = [0, last] if numbers else range(last + 1)
    # No word is broken unless it is very long.
    words = [" ".join(column).split() for column in zip(*cells)]
    least = [min(max(map(len, column), default=0), _LONG) for column in words]
    while sum(widths) + 2 * last > _TERMINAL:
        wrapped = [k for k in flexible if widths[k] > least[k]]
        if not wrapped:
            break
        widths[max(wrapped, key=widths.__getitem__)] -= 1
    table = tabulate(
        cells,
        tablefmt="plain",
        disable_numparse=True,
        colalign=[
            "left" if k in (0, last) or not numbers else "right"
            for k in range(last + 1)
        ],
        maxcolwidths=[
            width if k in flexible else None for k, width in enumerate(widths)
        ],
    )
    return "\n".join(line.rstrip() for line in table.splitlines())


def page(sections):
    """Write the sections as a whole page."""
    return _template("page.html.j2").render(
        sections=sections,
        whole=True,
        **_SIZE,
    )


def fragment(sections):
    """Write the sections as what a page holds, with its style, for notebooks."""
    return _template("fragment.html.j2").render(sections=sections, whole=False, **_SIZE)


def figure(drawn):
    """Write a `Figure` alone; `style` draws it."""
    return _template("figure.html.j2").render(figure=drawn, whole=False, **_SIZE)


def style():
    """Return the style sheet of all that is inside an element of class "vbjfa"."""
    return _template("style.css.j2").render()


@lru_cache
def _template(name):
    """Load a template, in which every value is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("sklearn_vbjfa.diagnosis.report"),
        autoescape=True,
        finalize=_page_value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["mathml"] = mathml
    return environment.get_template(name)


def mathml(formula):
    """Convert LaTeX to MathML; LaTeX that cannot be converted is not changed."""
    from latex2mathml import converter

    # The converter sets upright words by letters, no space around "sin", and passes
    # markup through.
    text = re.sub(r"\\mathrm(?=\{)", r"\\text", formula).replace(r"\_", "_")
    text = re.sub(r" \\(sin|cos|tanh)(?! )", r"\\,\\\1", text)
    text = re.sub(r" \\(sin|cos|tanh) ", r"\\,\\\1\\,", text)
    if not re.search("[<>&]", formula):
        # Its exceptions have no base of their own.
        with contextlib.suppress(Exception):
            # A line may break between formulas, not inside of one.
            parts = re.split(r"\\q?quad(?![A-Za-z])", text)
            return " ".join(converter.convert(part) for part in parts if part.strip())
    return f"<code>{html.escape(formula)}</code>"


def _page_value(value):
    """Write signs as a page has them; a number and its sign stay on one line."""
    if type(value) is not str:
        return value
    for plain, sign in (
        ("+-", "±"),
        ("^2", "²"),
        ("^3", "³"),
        (" %", "\u00a0%"),
    ):
        value = value.replace(plain, sign)
    return value
