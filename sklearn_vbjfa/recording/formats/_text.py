"""Tables out of text and spreadsheets: checks of damage before pandas reads them."""

import csv
import io
import itertools
import re
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._table import (
    EXPECTED,
    NotATable,
    RecordingRefused,
    Table,
    check_names,
    imported,
    no_rows,
    parsing,
    quoted,
    split_unit,
    unit_of,
)

# Note of a file that ends within a line.
CUT = "the last line is cut, or has no end: it is left out."
# Lines among which the names of the columns are looked for.
_PREAMBLE = 200
# What loggers write where nothing was measured.
_NOTHING = ("", "-", "nan", "-nan", "+nan", "na", "n/a", "null", "none")
# What lists have beside their numbers; NumPy writes array([np.float64(0.1), ...]).
_OF_LISTS = re.compile(r"np\.\w+|array|dtype=\w+|[\[\](),;]")
# float() takes more (1_000, digits of other scripts), which no logger writes.
_NUMBER = re.compile(
    r"[+-]?((\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|nan|inf(inity)?)", re.ASCII | re.I
)
# A number with separators of thousands and a fraction, 1.234,56 or 1,234.56; or 1,234.
_GROUPED = re.compile(r"[+-]?\d{1,3}((\.\d{3})+,\d+|(,\d{3})+(\.\d*)?)", re.ASCII)
# Of fewer rows the last is not said to be cut.
_FEWEST = 10
_NO_BRACKETS = bytes.maketrans(b"()[]", b"    ")
# This line is the separator for Excel.
_EXCEL_SEPARATOR = re.compile(r'"?sep=.?"?', re.IGNORECASE)
# Names of channels, not the words of a note.
_HEADER = re.compile(r"[^\s;,|]+([\t ]*[;,|\t][\t ]*[^\s;,|]+)+")
# A row of numbers some of which stand in brackets, as YARP prints its ports.
_BRACKETED = re.compile(r"[-+\d.eE\s,;]*[(\[][-+\d.eE\s,;()\[\]]*")


def read_text(path, content) -> Table:
    """Read text with a header line; blank lines and comments (#) are skipped."""
    with parsing(path, "table of numbers", "save it as CSV in UTF-8."):
        content, notes = _decoded(path, content)
        filled = list(filter(None, map(_without_comment, _first_lines(content))))
        if filled and _BRACKETED.fullmatch(filled[0]):
            content = content.translate(_NO_BRACKETS)
        try:
            return _read_lines(path, content, notes)
        except RecordingRefused as error:
            rows = (re.split(r"[;,|\s]+", line) for line in filled)
            header = len(filled) == 1 and _HEADER.fullmatch(filled[0])
            if not content or header or any(map(_is_data, rows)):
                raise
            raise NotATable(error.reason) from error


def _decoded(path, content):
    """Return text in UTF-8, lines ended as on Unix, and notes."""
    # A mark at the beginning settles the encoding. Text without one is UTF-8, or a CSV
    # file that Excel saved in Western Europe, code page 1252.
    notes = ()
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        content = content.decode("utf-16").encode()
    try:
        content.decode()
    except UnicodeDecodeError:
        content = content.decode("cp1252").encode()
        notes = ("is not UTF-8, read as Windows text (cp1252), as Excel saves CSV.",)
    if b"\0" in content:
        raise RecordingRefused(f"{path}: is binary, not text; save it as CSV in UTF-8.")
    content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return content.removeprefix(b"\xef\xbb\xbf"), notes


def _first_lines(content):
    """Return the lines that may come before the data, without their ends."""
    lines = itertools.islice(io.BytesIO(content), _PREAMBLE)
    return [line.decode().rstrip("\n") for line in lines]


def _without_comment(line):
    """Return a line without its comment, "" for one that tells Excel the separator."""
    line = line.split("#", 1)[0].strip(" \n")
    return "" if not line.strip() or _EXCEL_SEPARATOR.fullmatch(line) else line


def _read_lines(path, content, notes=()):
    """Return the table of a text in UTF-8."""
    lines = _first_lines(content)
    names, start, separator, more = _head(path, lines)
    numbers, is_cut = _checked_rows(path, content, names, start, separator)
    if not numbers:
        raise RecordingRefused(f"{path}: only a header and no rows of data.")
    frame = imported(path, "pandas").read_csv(
        io.BytesIO(content),
        sep=separator or r"\s+",
        header=None,
        names=names,
        index_col=False,
        skiprows=start,
        nrows=len(numbers),
        comment="#",
        decimal="," if separator != "," and "," in lines[start] else ".",
    )
    frame.index = numbers
    table = Table(
        path=path, frame=frame, place="line {}", notes=(*more, *[CUT] * is_cut, *notes)
    )
    return _with_cells_read(table, comma=separator != ",")


# -- names -----------------------------------------------------------------------------


def _head(path, lines):
    """Return names of columns, lines before the first row, the separator, and notes."""
    # Names are places, from "1" on, if there are none. The separator None is white
    # space.
    content = [(k, x) for k, x in enumerate(map(_without_comment, lines)) if x]
    if not content:
        raise no_rows(path)
    rows = [_cells(x) for _, x in content]
    # Without a row of numbers, as with one column of text, the names come first.
    data = next((k for k, row in enumerate(rows) if _is_data(row)), 1)
    # Of a file with a header alone the data begin after it.
    start = content[data][0] if data < len(content) else len(lines)
    at, notes = max(data - 1, 0), ()
    (header, line), names = content[at], rows[at]
    if not data:
        # The names may be in the last comment before the numbers.
        header = max((k for k in range(start) if lines[k].strip()), default=0)
        names = _echo_names(names) or _cells(lines[header].lstrip("# "))
        if len(names) != len(rows[0]) or any(map(_is_number, names)):
            names = [str(k + 1) for k in range(len(rows[0]))]
            # Data frames without names have a header that counts them.
            start += rows[0] == [str(k) for k in range(max(len(names), 3))]
    elif at and (with_units := _with_units(rows[at - 1], names)):
        at, names = at - 1, with_units
        header, line = content[at]
    if at:
        notes = (f"the names of the columns are in line {header + 1}.",)
    _check_header(path, names, header + 1)
    return names, start, _separator_of(line), notes


def _echo_names(cells):
    """Return names for the cells of a JointState by ``ros2 topic echo --csv``."""
    # It writes the values of a message one after another and no header (message_to_csv
    # in rosidl_runtime_py/convert.py of github.com/ros2/rosidl_runtime_py): the stamp,
    # the frame, names, positions, velocities and efforts. [] if the cells are others.
    n = (len(cells) - 3) // 4
    numbers = [_is_number(cell) for cell in [*cells[:2], *cells[3:]]]
    if n < 1 or numbers != 2 * [True] + n * [False] + 3 * n * [True]:
        return []
    names = ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id"]
    for what in ("name", "position", "velocity", "effort"):
        names += [f"{what}_{k}" for k in range(n)]
    return names


def _separator_of(line):
    """Return the separator that a line has; None is white space."""
    return next((mark for mark in (";", "\t", ",", "|") if mark in line), None)


def _split(line, separator):
    """Return the cells of a line without a comment; in quotes a separator is none."""
    line = line.split("#")[0].strip(" \n")
    if separator is None:
        cells = line.split()
    else:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return [cell.strip("\"' ") for cell in cells]


def _cells(line):
    """Return the cells of a line, without empty ones at its end."""
    cells = _split(line, _separator_of(line)) if line else []
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _is_number(cell: str) -> bool:
    """Return whether a cell is a number as loggers write them."""
    return _NUMBER.fullmatch(cell) is not None


def _is_data(cells):
    """Return whether most of the cells that are filled are numbers."""
    numbers = [_is_number(x.replace(",", ".", 1)) for x in cells if x]
    return 2 * sum(numbers) > len(cells)


def _with_units(names, cells):
    """Return names with the units below them, [] if the cells below are others."""
    cells = [cell.strip("[]()- ") for cell in cells]
    units = [any(unit_of(kind, cell) for kind in EXPECTED) for cell in cells]
    if len(names) != len(cells) or 2 * sum(units) <= len(cells):
        return []
    bare = [name and not split_unit(name)[1] for name in names]
    rows = zip(names, cells, bare)
    return [f"{name} [{unit}]" if own and unit else name for name, unit, own in rows]


def _check_header(path, names, line):
    """Refuse names that are missing or come twice; the first may be an index."""
    for k, name in enumerate(names):
        if not name and (k > 0 or len(names) == 1):
            raise RecordingRefused(
                f"{path}: column {k + 1} has no name in line {line}; name it (t, q1, "
                "tau1, ...) or remove it."
            )
    check_names(path, names, f"line {line} names")


def _checked_rows(path, content, names, start, separator):
    """Return the numbers of the lines with rows, and whether a cut one was left out."""
    # Refuses a row that has not as many cells as there are names.
    numbers, quotes = [], b'"' in content
    mark = None if separator is None else separator.encode()
    last = content.count(b"\n") + (not content.endswith(b"\n"))
    for number, line in enumerate(io.BytesIO(content), start=1):
        row = line.partition(b"#")[0]
        if number <= start or not row.strip():
            continue
        cells, wrong = row.count(mark) + 1 if mark else len(row.split()), ""
        if cells != len(names) or quotes:
            wrong = _wrong(row.decode(), names, separator)
        is_cut = wrong or not line.endswith(b"\n")
        if number == last and len(numbers) >= _FEWEST and is_cut:
            return numbers, True
        if wrong:
            raise RecordingRefused(f"{path}: line {number} {wrong}.")
        numbers.append(number)
    return numbers, False


def _wrong(line, names, separator):
    """Say why a row has not one cell for each name, "" if it has."""
    if line.count('"') % 2:
        return "has a quotation mark without a second one; correct or remove that line"
    cells = _split(line, separator)
    if len(cells) >= len(names) and not any(cells[len(names) :]):
        return ""
    remedy = "correct or remove that line"
    if separator == "," and len(cells) > len(names):
        remedy = "numbers with decimal commas need ; as separator"
    return f"has {len(cells)} cells, the header names {len(names)} columns; {remedy}"


# -- columns ---------------------------------------------------------------------------


def _with_cells_read(table, comma):
    """Return a table of columns whose cells are numbers, dates, text or lists."""
    path, frame, notes = table.path, table.frame, table.notes
    if "" not in frame and all(kind.kind in "iuf" for kind in frame.dtypes):
        return table
    columns = []
    for name in frame:
        values = _column(table, name, comma)
        columns += _spread(table, name, values) or [(name, values)]
    check_names(path, [name for name, _ in columns], "as an entry of a list has")
    columns = dict(columns)
    if "" in columns:
        index = columns.pop("")
        counts = index.dtype.kind in "if" and (np.diff(index) == 1).all()
        if not (counts and columns):
            _check_header(path, [""], frame.index[0] - 1)
        note = "the first column has no name and counts the rows: it is left out."
        notes = (*notes, note)
    frame = imported(path, "pandas").DataFrame(columns, index=frame.index)
    return replace(table, frame=frame, notes=notes)


def _column(table, name, comma):
    """Return cells as numbers or text; a column is what its first cell is."""
    values = table.frame[name]
    if values.dtype.kind in "iuf":
        return values.to_numpy(dtype=float)
    text = values.astype(str).str.strip("\"' ")
    filled = values.notna() & ~text.str.lower().isin(_NOTHING)
    plain = text.where(filled)
    if comma:
        points = text.str.contains(".", regex=False)
        plain = plain.where(points, plain.str.replace(",", ".", n=1, regex=False))
    numbers = imported(table.path, "pandas").to_numeric(plain, errors="coerce")
    wrong = np.flatnonzero(filled & numbers.isna())
    if not wrong.size:
        return numbers.to_numpy(dtype=float)
    cell, remedy = text.iloc[wrong[0]], "correct or remove that line"
    grouped = _GROUPED.fullmatch(cell)
    if wrong[0] == np.argmax(filled) and not grouped:
        return text.where(filled, "").to_numpy(dtype=object)
    if grouped:
        remedy = "write numbers without separators of thousands"
    raise RecordingRefused(
        f"{table.path}: {quoted(cell)} in {table.where(wrong[0])}, column "
        f"{quoted(name)} is not a number; {remedy}."
    )


def _spread(table, name, values):
    """Return names and columns of the entries of cells that are lists of numbers."""
    # Empty for other cells.
    if values.dtype.kind != "O":
        return []
    rows = [_OF_LISTS.sub(" ", cell).split() for cell in values]
    if not rows[0] or not all(map(_is_number, rows[0])):
        return []
    try:
        matrix = np.array(rows, dtype=float)
    except ValueError as error:
        raise RecordingRefused(
            f"{table.path}: the cells of column {quoted(name)} are not lists of as "
            "many numbers; correct or remove those rows."
        ) from error
    return [(f"{name}_{k}", x) for k, x in enumerate(matrix.T)]


# -- spreadsheets ----------------------------------------------------------------------


def read_sheet(path) -> Table:
    """Read the first sheet with a table of numbers, as text with tabs."""
    pandas = imported(path, "pandas")
    imported(path, "python_calamine")
    with parsing(path, "spreadsheet", "save it as CSV."):
        sheets = pandas.read_excel(
            path,
            sheet_name=None,
            engine="calamine",
            dtype=object,
            header=None,
            keep_default_na=False,
            na_values=[],
        )
        texts = {name: _lines_of(cells) for name, cells in sheets.items()}
        # The first with numbers, or else with text.
        numbers = [x for x, y in texts.items() if any(map(_is_data, map(_cells, y)))]
        name = [*numbers, *(x for x in texts if any(texts[x])), *texts][0]
        table = _read_lines(path, "\n".join([*texts[name], ""]).encode())
    place = "line {} of sheet " + repr(name).replace("{", "{{").replace("}", "}}")
    return replace(table, place=place)


def _lines_of(sheet):
    """Return the rows of a sheet as lines with tabs, without columns that are empty."""
    cells = sheet.astype(str).replace(r'[\s"#;]+', " ", regex=True)
    cells = cells.loc[:, (cells != "").any()]
    lines = ("\t".join(row) for row in cells.itertuples(index=False))
    return [line if line.strip() else "" for line in lines]
