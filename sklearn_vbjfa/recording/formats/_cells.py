"""Cells of text and spreadsheets: where the names are, and columns of a kind."""

import datetime
import itertools
import re
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._table import Table, check_names, pandas_of, quoted
from sklearn_vbjfa.recording._units import is_unit
from sklearn_vbjfa.recording.formats._precheck import LIST, NUMBER, is_number

# Lines that an instrument may write before the names of its columns.
LONGEST_PREAMBLE = 100


def names_and_start(lines):
    """Find the names among the first lines, each a list of cells as text.

    Returns the position of the names, None without any, that of the first row of data,
    and (name, unit) of columns out of a row of units below the names.
    """
    rows = []
    for cells in itertools.islice(lines, LONGEST_PREAMBLE):
        while cells and not cells[-1]:
            cells.pop()
        rows.append(cells)
        if is_data(cells):
            break
    else:
        # Without a row of numbers, as with one column of text.
        units = _units(rows[1], rows[0]) if len(rows) > 1 else ()
        return 0, 1 + bool(units), units
    data = rows[-1]
    if len(rows) == 1:
        # Data frames without names have a header that counts them.
        counts = data == [str(k) for k in range(len(data))] and len(data) > 2
        return None, int(counts), ()
    names = 0
    if len(rows[0]) != len(data):
        # Titles stand above the names, which are as many as there are numbers.
        fitting = [k for k, x in enumerate(rows[:-1]) if len(x) == len(data)]
        fitting = [k for k in fitting if not _units(rows[k], rows[k])]
        names = fitting[-1] if fitting else 0
    units = _units(rows[names + 1], rows[names])
    return names, names + 1 + bool(units), units


def is_data(cells):
    """Whether most of the cells that are filled are numbers."""
    numbers = [is_number(x.replace(",", ".", 1)) for x in cells if x]
    return 2 * sum(numbers) > len(cells)


def _units(cells, names):
    """Return (name, unit) of columns if the cells below the names are units."""
    cells = [cell.strip("[]() ") for cell in cells]
    cells += [""] * (len(names) - len(cells))
    filled = [cell for cell in cells if cell not in ("", "-", "1")]
    if len(cells) != len(names) or any(map(is_number, filled)):
        return ()
    if not any(map(is_unit, filled)) or max(map(len, filled)) > 12:
        return ()
    return tuple((name, x) for name, x in zip(names, cells) if x not in ("", "-"))


def check_header(path, names, line):
    """Refuse names that are missing or come twice; the first may be an index."""
    for k, name in enumerate(names):
        if not name and (k > 0 or len(names) == 1):
            raise ValueError(
                f"{path}: column {k + 1} has no name in line {line}; name it (t, q1, "
                "tau1, ...) or remove it."
            )
    check_names(path, names, f"line {line} names")


def table_of_cells(path, frame, *, place="line {}", comma=False, notes=(), **known):
    """Return a table of columns whose cells are numbers, dates, text or lists."""
    # comma: whether numbers may have decimal commas.
    table = Table(path=path.shown, frame=frame, place=place)
    if "" not in frame and all(kind.kind in "iuf" for kind in frame.dtypes):
        return replace(table, notes=notes, **known)
    columns = {}
    for name in frame:
        values = _column(table, name, comma)
        own = _spread(table, name, values) or {name: values}
        if columns.keys() & own.keys():
            raise ValueError(
                f"{path}: column {quoted(name)} holds lists, whose entries have the "
                "name of another column; rename it."
            )
        columns |= own
    if "" in columns:
        index = columns.pop("")
        counts = index.dtype.kind in "if" and (np.diff(index) == 1).all()
        if not (counts and columns):
            check_header(path, [""], frame.index[0] - 1)
        notes = (
            *notes,
            "the first column has no name and counts the rows: it is left out.",
        )
    frame = pandas_of(path).DataFrame(columns, index=frame.index)
    return replace(table, frame=frame, notes=notes, **known)


def _column(table, name, comma):
    """Return cells as numbers, dates or text; a column is what its first cell is."""
    values = table.frame[name]
    if values.dtype.kind in "iuf":
        return values.to_numpy(dtype=float)
    pandas = pandas_of(table.path)
    blank = (values.isna() | (values == "")).to_numpy()
    first = values.iloc[int(np.argmin(blank))]
    if isinstance(first, datetime.date):
        return pandas.to_datetime(values, errors="coerce").to_numpy("datetime64[ns]")
    text = values.astype(str).str.strip("\"' ")
    numbers = text
    if comma:
        commas = ~text.str.contains(".", regex=False)
        numbers = text.where(~commas, text.str.replace(",", ".", n=1, regex=False))
    if blank.all():
        return np.full(len(values), np.nan)
    if not is_number(numbers.iloc[int(np.argmin(blank))]):
        return text.mask(blank, "").to_numpy(dtype=object)
    known = numbers.str.fullmatch(NUMBER).to_numpy(dtype=bool)
    wrong = np.flatnonzero(~known & ~blank)
    if wrong.size:
        cell = text.iloc[wrong[0]]
        remedy = "correct or remove that line"
        if is_number(cell.replace(",", "")):
            remedy = "write numbers without separators of thousands"
        raise ValueError(
            f"{table.path}: {quoted(cell)} in {table.where(wrong[0])}, column "
            f"{quoted(name)} is not a number; {remedy}."
        )
    return numbers.mask(blank, "nan").to_numpy(dtype=object).astype(float)


def _spread(table, name, values):
    """Return a column for each entry of cells that are lists of numbers, else {}."""
    first = LIST.fullmatch(values[0]) if values.dtype.kind == "O" else None
    if not first or not all(map(is_number, _entries(first))):
        return {}
    matches = [LIST.fullmatch(cell) for cell in values]
    cells = [_entries(match) if match else [] for match in matches]
    if len({len(x) for x in cells}) > 1 or not all(
        is_number(x) for row in cells for x in row
    ):
        raise ValueError(
            f"{table.path}: the cells of column {quoted(name)} are not lists of as "
            "many numbers; correct or remove those rows."
        )
    matrix = np.array(cells, dtype=float)
    return {f"{name}_{k}": x for k, x in enumerate(matrix.T)}


def _entries(match):
    return re.split(r"[\s,;]+", match[1].strip())
