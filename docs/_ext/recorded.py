"""The tables in ``docs/tables`` as values.

A benchmark writes NAME.rst, paragraphs and tables between lines of equals signs, and
NAME.json with the same tables, the script, the commits that they were made at, and a
digest of the code that made them.
"""

import ast
import functools
import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path

TABLES = Path(__file__).resolve().parents[1] / "tables"
PACKAGE = TABLES.parents[1] / "sklearn_vbjfa"
_BORDER = re.compile(r"=+(  +=+)+")


@dataclass(frozen=True, kw_only=True)
class RecordedTable:
    """A table as it was written.

    Attributes
    ----------
    headers : tuple of str
        Names of the columns.
    rows : tuple of tuple of str
        Cells.
    """

    headers: tuple
    rows: tuple

    def __post_init__(self):
        for row in self.rows:
            if len(row) != len(self.headers):
                raise ValueError(f"{row} has not one cell for each of {self.headers}")

    def column(self, name):
        """Cells of a column, a tuple of str."""
        if name not in self.headers:
            raise KeyError(f"no column {name!r}, there are {', '.join(self.headers)}")
        place = self.headers.index(name)
        return tuple(row[place] for row in self.rows)

    def chosen(self, columns=None, rows=None):
        """Return the table with these columns, and the rows of these first cells."""
        names = self.headers if columns is None else tuple(columns)
        cells = tuple(zip(*(self.column(name) for name in names)))
        if rows is not None:
            known = self.column(self.headers[0])
            missing = sorted(set(rows) - set(known))
            if missing:
                raise KeyError(f"no rows {missing}, there are {', '.join(known)}")
            cells = tuple(
                row for first, row in zip(known, cells, strict=True) if first in rows
            )
        return RecordedTable(headers=names, rows=cells)


def read(name, folder=TABLES):
    """Text of a file of tables, by its name without the ending."""
    return (folder / f"{name}.rst").read_text(encoding="utf-8")


def read_tables(name, folder=TABLES):
    """Tables of a file of data, a tuple of RecordedTable."""
    record = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    return tuple(
        RecordedTable(
            headers=tuple(table["headers"]), rows=tuple(map(tuple, table["rows"]))
        )
        for table in record["tables"]
    )


def made(name, folder=TABLES):
    """Return the script and the commits that made a table, as a sentence."""
    record = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    note = f" ({record['note']})" if "note" in record else ""
    return f"Source: {record['script']} at {' and '.join(record['commits'])}{note}."


def write(name, text, script, commits, rooms, folder=TABLES):
    """Write NAME.rst and NAME.json; `rooms` of the package made the tables."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.rst").write_text(text, encoding="utf-8")
    tables = [{"headers": x.headers, "rows": x.rows} for x in tables_in(text)]
    record = {"script": script, "commits": commits}
    # Results of several commits were made by code that is no longer here.
    if len(commits) == 1:
        record |= {"rooms": rooms, "digest": digest(rooms)}
    (folder / f"{name}.json").write_text(_json(record, tables), encoding="utf-8")


def digest(rooms, package=PACKAGE):
    """Digest of the code of some rooms, without comments and docstrings."""
    found = hashlib.sha256()
    for room in sorted(rooms):
        for path in sorted((package / room).rglob("*.py")):
            found.update(_code(path.read_text(encoding="utf-8")))
    return found.hexdigest()[:16]


@functools.cache
def _code(text):
    """Syntax tree of a module without docstrings, as bytes."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [x for x in body if not _is_text(x)]
    return ast.dump(tree).encode()


def _is_text(node):
    """Whether a statement is a docstring."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def stale(folder=TABLES, package=PACKAGE):
    """Names of the tables that other code than today's made."""
    records = {
        path.stem: json.loads(path.read_text(encoding="utf-8"))
        for path in sorted(folder.glob("*.json"))
    }
    return [
        name
        for name, record in records.items()
        if record.get("digest") != digest(record.get("rooms", ()), package)
    ]


def _json(record, tables):
    """Write one line for each table."""
    lines = ",\n".join(json.dumps(table, ensure_ascii=False) for table in tables)
    begin = json.dumps(record, ensure_ascii=False)[:-1]
    return f'{begin}, "tables": [\n{lines}\n]}}\n'


def tables_in(text):
    """All tables of a text, a tuple of RecordedTable."""
    lines = text.splitlines()
    borders = [k for k, line in enumerate(lines) if _BORDER.fullmatch(line.strip())]
    if len(borders) % 3:
        raise ValueError("a table needs three lines of equals signs")
    found = []
    for top, middle, bottom in zip(borders[::3], borders[1::3], borders[2::3]):
        starts = [match.start() for match in re.finditer(r"=+", lines[top])]
        (headers,) = (_cells(line, starts) for line in lines[top + 1 : middle])
        rows = tuple(_cells(line, starts) for line in lines[middle + 1 : bottom])
        found.append(RecordedTable(headers=headers, rows=rows))
    return tuple(found)


def _cells(line, starts):
    """Texts of a line of which each column begins at one of `starts`."""
    return tuple(line[a:b].strip() for a, b in zip(starts, [*starts[1:], None]))
