"""Directives that show a piece of what a benchmark recorded.

``.. recorded-table:: NAME`` shows a table of ``docs/tables/NAME.rst``; options:
``number`` counts the tables from one, ``columns`` and ``rows`` choose, separated by
``|``, and ``title`` stands above. ``.. recorded-line:: NAME`` shows the paragraph that
begins with the option ``begins``.
"""

from typing import ClassVar

from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from recorded import TABLES, paragraph_in, read, tables_in
from sphinx.util.docutils import SphinxDirective


def _names(argument):
    """Names between vertical bars."""
    return [name.strip() for name in directives.unchanged_required(argument).split("|")]


class _Recorded(SphinxDirective):
    """A piece of a file of tables, parsed where the directive stands."""

    required_arguments = 1

    def run(self):
        """Return the nodes of the piece."""
        name = self.arguments[0]
        # The page is built anew when the figures are.
        self.env.note_dependency(str(TABLES / f"{name}.rst"))
        try:
            lines = self.lines(read(name))
        except (OSError, ValueError, KeyError, IndexError) as error:
            raise self.error(f"{name}: {error}") from error
        return self.parse_text_to_nodes(StringList(lines, source=name))


class RecordedTableDirective(_Recorded):
    """A table, or some of its columns and rows."""

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


class RecordedLineDirective(_Recorded):
    """A paragraph."""

    option_spec: ClassVar = {"begins": directives.unchanged_required}

    def lines(self, text):
        """Return the paragraph."""
        return paragraph_in(text, self.options["begins"]).splitlines()


def setup(app):
    """Register both directives."""
    app.add_directive("recorded-table", RecordedTableDirective)
    app.add_directive("recorded-line", RecordedLineDirective)
    return {"parallel_read_safe": True, "version": "1"}
