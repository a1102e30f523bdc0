"""Cells of text and spreadsheets: where the names are, and columns of a kind."""

import contextlib
import datetime
import itertools
import re
import zipfile
from dataclasses import replace
from importlib.util import find_spec

import numpy as np

from sklearn_vbjfa.recording._table import (
    Source,
    Table,
    check_names,
    check_size,
    missing,
    no_rows,
    pandas_of,
    parsing,
    quoted,
)
from sklearn_vbjfa.recording._units import is_unit

# Note of a file that ends within a line.
CUT = "the last line is cut, as where a logger is stopped: it is left out."
# Lines that an instrument may write before the names of its columns.
LONGEST_PREAMBLE = 100
# What loggers write where nothing was measured.
NOTHING = ("", "-", "nan", "-nan", "+nan", "na", "n/a", "null", "none")
# NumPy writes lists of its numbers as [np.float64(0.1), ...].
_OF_NUMPY = re.compile(r"np\.\w+\(([^()]*)\)")
_LIST = re.compile(r"[(\[]([^()\[\]]*)[)\]]")
# float() takes more (1_000, digits of other scripts), which no logger writes.
_NUMBER = re.compile(
    r"[+-]?((\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|nan|inf(inity)?)", re.ASCII | re.I
)


def is_number(cell: str) -> bool:
    """Whether a cell is a number as loggers write them."""
    return _NUMBER.fullmatch(cell) is not None


def is_data(cells):
    """Whether most of the cells that are filled are numbers."""
    numbers = [is_number(x.replace(",", ".", 1)) for x in cells if x]
    return 2 * sum(numbers) > len(cells)


# -- names -----------------------------------------------------------------------------


def names_and_start(lines):
    """Find the names among the first lines, each a list of cells as text.

    Returns the position of the names, None without any, the names, the position of the
    first row of data, and (name, unit) of columns out of a row of units.
    """
    rows = []
    for cells in itertools.islice(lines, LONGEST_PREAMBLE):
        rows.append(without_blank_ends(cells))
        if is_data(rows[-1]):
            break
    # Without a row of numbers, as with one column of text, the names come first.
    found = is_data(rows[-1])
    width = len(rows[-1]) if found else len(rows[0])
    above = rows[:-1] if found else rows[:2]
    if not above:
        # Data frames without names have a header that counts them.
        counts = rows[0] == [str(k) for k in range(width)] and width > 2
        return None, (), int(counts), ()
    # Titles stand above the names, which are as many as there are numbers.
    fitting = [k for k, x in enumerate(above) if len(x) == width and not _units(x, x)]
    at = 0 if len(above[0]) == width or not fitting else fitting[-1]
    names = above[at]
    if at and len(set(names)) < len(names):
        # Groups of columns stand above their names.
        groups = itertools.accumulate(above[at - 1][:width], lambda x, y: y or x)
        pairs = itertools.zip_longest(groups, names)
        last = without_blank_ends(above[at - 1])[-1]
        names = [f"{last if x is None else x} {name}".strip() for x, name in pairs]
    units = _units(above[at + 1], names) if at + 1 < len(above) else ()
    return at, names, at + 1 + bool(units), units


def without_blank_ends(cells):
    """Return cells without empty ones at the end."""
    return cells[: max((k + 1 for k, cell in enumerate(cells) if cell), default=0)]


def _units(cells, names):
    """Return (name, unit) of columns if the cells below the names are units."""
    cells = [cell.strip("[]() ") for cell in cells]
    cells += [""] * (len(names) - len(cells))
    filled = [cell for cell in cells if cell not in ("", "-", "1")]
    if len(cells) != len(names) or any(map(is_number, filled)):
        return ()
    if not 0 < len(filled) <= 2 * sum(map(is_unit, filled)):
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


# -- columns ---------------------------------------------------------------------------


def table_of_cells(path, frame, *, place="line {}", comma=False, notes=(), **known):
    """Return a table of columns whose cells are numbers, dates, text or lists."""
    # comma: whether numbers may have decimal commas.
    frame, notes = _without_headers(frame, notes)
    table = Table(path=path.shown, frame=frame, place=place)
    if "" not in frame and all(kind.kind in "iuf" for kind in frame.dtypes):
        return replace(table, notes=notes, **known)
    columns = {}
    for name in frame:
        values = _column(table, name, comma)
        spread = _spread(table, name, values) or {name: values}
        check_names(path, [*columns, *spread], "as an entry of a list has")
        columns |= spread
    if "" in columns:
        index = columns.pop("")
        counts = index.dtype.kind in "if" and (np.diff(index) == 1).all()
        if not (counts and columns):
            check_header(path, [""], frame.index[0] - 1)
        note = "the first column has no name and counts the rows: it is left out."
        notes = (*notes, note)
    frame = pandas_of(path).DataFrame(columns, index=frame.index)
    return replace(table, frame=frame, notes=notes, **known)


def _without_headers(frame, notes):
    """Begin another recording where the names stand between rows."""
    if any(kind.kind in "iuf" for kind in frame.dtypes):
        return frame, notes
    again = (frame == list(frame.columns)).all(axis=1)
    if not again.any():
        return frame, notes
    if "segment" not in frame:
        frame = frame.assign(segment=again.cumsum().astype(float))
    lines = ", ".join(map(str, frame.index[again][:5]))
    note = f"the names of the columns stand again in line {lines}: another recording."
    return frame[~again], (*notes, note)


def _column(table, name, comma):
    """Return cells as numbers, dates or text; a column is what its first cell is."""
    values = table.frame[name]
    if values.dtype.kind in "iuf":
        return values.to_numpy(dtype=float)
    text = values.astype(str).str.strip("\"' ")
    blank = (values.isna() | text.str.lower().isin(NOTHING)).to_numpy()
    if blank.all():
        return np.full(len(values), np.nan)
    first = int(np.argmin(blank))
    if isinstance(values.iloc[first], datetime.date):
        dates = pandas_of(table.path).to_datetime(values, errors="coerce")
        return dates.to_numpy("datetime64[ns]")
    numbers = text
    if comma:
        points = text.str.contains(".", regex=False)
        numbers = text.where(points, text.str.replace(",", ".", n=1, regex=False))
    if not is_number(numbers.iloc[first]):
        return text.mask(blank, "").to_numpy(dtype=object)
    wrong = np.flatnonzero(~numbers.str.fullmatch(_NUMBER).to_numpy(bool) & ~blank)
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
    if values.dtype.kind != "O" or not all(map(is_number, _entries(values[0]))):
        return {}
    cells = [_entries(cell) for cell in values]
    if len({len(x) for x in cells}) > 1 or not all(
        is_number(x) for row in cells for x in row
    ):
        raise ValueError(
            f"{table.path}: the cells of column {quoted(name)} are not lists of as "
            "many numbers; correct or remove those rows."
        )
    matrix = np.array(cells, dtype=float)
    return {f"{name}_{k}": x for k, x in enumerate(matrix.T)}


def _entries(cell):
    """Return the texts in a list; of what is none, one that is no number."""
    match = _LIST.fullmatch(_OF_NUMPY.sub(r"\1", cell))
    return re.split(r"[\s,;]+", match[1].strip()) if match else ["none"]


# -- spreadsheets ----------------------------------------------------------------------


def read_sheet(path: Source) -> Table:
    """Read the first sheet with a table of numbers, below the names of its columns."""
    pandas = pandas_of(path)
    if find_spec("python_calamine") is None:
        raise missing(path, "python-calamine", "spreadsheets need", "excel")
    check_size(path, _unpacked_size(path), "save a shorter recording, or CSV")
    with (
        parsing(path, "spreadsheet", "save it as CSV."),
        pandas.ExcelFile(path.file, engine="calamine") as book,
    ):
        sheets = {
            name: pandas.read_excel(
                book,
                name,
                dtype=object,
                header=None,
                keep_default_na=False,
                na_values=[],
            )
            for name in book.sheet_names
        }
    count = len(sheets)
    sheets = {name: frame for name, frame in sheets.items() if len(frame)}
    filled = [name for name, frame in sheets.items() if any(map(is_data, _rows(frame)))]
    name = (filled or list(sheets) or [""])[0]
    frame = sheets.get(name)
    if frame is None:
        raise no_rows(path)
    frame.index += 1
    frame = frame[(frame != "").any(axis=1)]
    if len(frame) < 2:
        raise no_rows(path)
    at, names, start, units = names_and_start(_rows(frame))
    if at is None:
        names = [str(k + 1) for k in range(frame.shape[1])]
    else:
        check_header(path, [x for x in names if x], frame.index[at])
    used = [k for k, one in enumerate(names) if one]
    frame = frame.iloc[start:, used]
    frame.columns = [names[k] for k in used]
    if not len(frame):
        raise ValueError(f"{path}: only a header and no rows of data.")
    return table_of_cells(
        path,
        frame,
        place="line {} of sheet " + repr(name).replace("{", "{{").replace("}", "}}"),
        notes=(f"sheet {name!r} of {count} was read.",) * (count > 1),
        units=dict(units),
        nameless=at is None,
    )


def _rows(frame):
    return ([str(x).strip() for x in row] for row in frame.itertuples(index=False))


def _unpacked_size(path):
    """Return the bytes of a file, or of what is packed in it."""
    size = path.file.stat().st_size
    with (
        contextlib.suppress(zipfile.BadZipFile, OSError),
        zipfile.ZipFile(path.file) as archive,
    ):
        size = max(size, sum(x.file_size for x in archive.infolist()))
    return size
