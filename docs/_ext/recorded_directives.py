"""Directives that show a piece of what a benchmark recorded.

``.. recorded-table:: NAME`` shows a table of ``docs/tables/NAME.rst``; options:
``number`` counts the tables from one, ``columns`` and ``rows`` choose, separated by
``|``, and ``title`` stands above. ``.. recorded-line:: NAME`` shows the paragraph that
begins with the option ``begins``. A line below names the commits of the table, also
below ``.. include:: tables/NAME.rst``. A table without NAME.json is an error.
"""

from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from recorded import made, paragraph_in, read, tables_in
from sphinx.util.docutils import SphinxDirective


def _names(argument):
    """Names between vertical bars."""
    return [name.strip() for name in directives.unchanged_required(argument).split("|")]


class _Piece(SphinxDirective):
    """A piece of a file of tables, parsed where the directive stands."""

    required_arguments = 1

    def run(self):
        """Return the nodes of the piece and the line with its commits."""
        name = self.arguments[0]
        folder = Path(self.env.srcdir) / "tables"
        self.env.note_dependency(str(folder / f"{name}.rst"))
        self.env.note_dependency(str(folder / f"{name}.json"))
        try:
            lines, below = self.lines(read(name, folder)), made(name, folder)
        except (OSError, ValueError, KeyError, IndexError) as error:
            raise self.error(f"{name}: {error}") from error
        origin = nodes.container(classes=["made-at"], table=name, below=self.below)
        origin += self.parse_text_to_nodes(StringList([below], source=name))
        return [*self.parse_text_to_nodes(StringList(lines, source=name)), origin]


class MadeAtDirective(_Piece):
    """The commits of a table that is included whole."""

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
    """Add its commits to a file of tables that a page includes."""
    if Path(path).parent.name == "tables":
        content[0] += f"\n\n.. made-at:: {Path(path).stem}\n"


def _once(app, doctree):
    """Keep one line for each file of tables on a page."""
    lines = {}
    for node in doctree.findall(nodes.container):
        if "below" in node:
            lines.setdefault(node["table"], []).append(node)
    for found in lines.values():
        tables = [node for node in found if node["below"] == "table"]
        for node in found:
            if node is not (tables or found)[-1]:
                node.parent.remove(node)


def setup(app):
    """Register the directives."""
    app.add_directive("recorded-table", RecordedTableDirective)
    app.add_directive("recorded-line", RecordedLineDirective)
    app.add_directive("made-at", MadeAtDirective)
    app.connect("include-read", _included)
    app.connect("doctree-read", _once)
    return {"parallel_read_safe": True, "version": "1"}
