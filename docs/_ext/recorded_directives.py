"""Directives that show a piece of what a benchmark recorded.

``.. recorded-table:: NAME`` shows a table of ``docs/tables/NAME.rst``; options:
``number`` counts the tables from one, ``columns`` and ``rows`` choose, separated by
``|``, and ``title`` stands above. ``.. recorded-line:: NAME`` shows the paragraph that
begins with the option ``begins``.

Below each table, shown in this way or by ``.. include:: tables/NAME.rst``, a small line
says what it was made from and which files of the package have changed since
(``provenance.py``): once for each file of tables on a page, below its last table, or
below its last paragraph where there is no table. A table without NAME.json is an error.
"""

import functools
from itertools import groupby
from pathlib import Path
from typing import ClassVar

import provenance
from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from recorded import paragraph_in, read, tables_in
from sphinx.util.docutils import SphinxDirective


def _names(argument):
    """Names between vertical bars."""
    return [name.strip() for name in directives.unchanged_required(argument).split("|")]


@functools.cache
def _package(root):
    """Texts of the package beside the documentation."""
    return provenance.sources(root, [provenance.PACKAGE])


def _told(age):
    """Lines of reStructuredText that say how a table stands to the code."""
    if not age.changed:
        return [".. container:: made-at", "", f"    {age.sentence()}"]
    lines = [f".. dropdown:: {age.sentence()}", "    :class-container: made-at", ""]
    for folder, paths in groupby(age.changed, lambda path: path.rpartition("/")[0]):
        names = ", ".join(f"``{path.rpartition('/')[2]}``" for path in paths)
        lines.append(f"    - ``{folder}``: {names}")
    return lines


class _Piece(SphinxDirective):
    """Something of a file of tables, parsed where the directive stands."""

    required_arguments = 1

    def run(self):
        """Return the nodes of the piece, and what it was made from."""
        name, source = self.arguments[0], Path(self.env.srcdir)
        folder = source / "tables"
        # The page is built anew when the figures are, or the code is another one.
        self.env.note_dependency(str(folder / f"{name}.rst"))
        self.env.note_dependency(str(folder / f"{name}.json"))
        try:
            record = provenance.read(name, folder)
            age = provenance.age(record, _package(source.parent))
            lines = self.lines(read(name, folder))
        except (OSError, ValueError, KeyError, IndexError) as error:
            raise self.error(f"{name}: {error}") from error
        for path in age.files:
            self.env.note_dependency(str(source.parent / path))
        told = nodes.container(table=name, below=self.below)
        told += self.parse_text_to_nodes(StringList(_told(age), source=name))
        return [*self.parse_text_to_nodes(StringList(lines, source=name)), told]


class MadeAtDirective(_Piece):
    """What a table that is included whole was made from."""

    below = "table"

    def lines(self, text):
        """Return nothing further."""
        return []


class RecordedTableDirective(_Piece):
    """A table, or some of its columns and rows."""

    below = "table"
    optional_arguments = 0
    option_spec: ClassVar = {
        "number": directives.positive_int,
        "columns": _names,
        "rows": _names,
        "title": directives.unchanged_required,
    }

    def lines(self, text):
        """Return the table as a list of reStructuredText."""
        table = tables_in(text)[self.options.get("number", 1) - 1]
        table = table.chosen(self.options.get("columns"), self.options.get("rows"))
        lines = [
            f".. list-table:: {self.options.get('title', '')}",
            "    :header-rows: 1",
            "    :class: recorded",
            "",
        ]
        for row in (table.headers, *table.rows):
            for k, cell in enumerate(row):
                lines.append(f"    {'*' if k == 0 else ' '} - {cell}")
        return lines


class RecordedLineDirective(_Piece):
    """A paragraph."""

    below = "line"
    option_spec: ClassVar = {"begins": directives.unchanged_required}

    def lines(self, text):
        """Return the paragraph."""
        return paragraph_in(text, self.options["begins"]).splitlines()


def _included(app, path, parent, content):
    """Add what it was made from to a file of tables that a page includes."""
    if Path(path).parent.name == "tables":
        content[0] += f"\n\n.. made-at:: {Path(path).stem}\n"


def _once(app, doctree):
    """Keep one line for each file of tables on a page."""
    told = {}
    for node in doctree.findall(nodes.container):
        if "below" in node:
            told.setdefault(node["table"], []).append(node)
    for found in told.values():
        tables = [node for node in found if node["below"] == "table"]
        for node in found:
            if node is not (tables or found)[-1]:
                node.parent.remove(node)


def setup(app):
    """Register the directives, and what belongs to tables that are included."""
    app.add_directive("recorded-table", RecordedTableDirective)
    app.add_directive("recorded-line", RecordedLineDirective)
    app.add_directive("made-at", MadeAtDirective)
    app.connect("include-read", _included)
    app.connect("doctree-read", _once)
    return {"parallel_read_safe": True, "version": "1"}
