"""Readers of text and spreadsheets, with checks for damage before parsing by pandas."""

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

# Note for a file with a truncated last line.
CUT = "the last line is cut, or has no end: it is left out."
# Maximum number of lines before the data, which may contain the column names.
_MAX_PREAMBLE = 200
# Notations of missing values.
_MISSING = ("", "-", "nan", "-nan", "+nan", "na", "n/a", "null", "none")
# Syntax of lists other than numbers; NumPy writes array([np.float64(0.1), ...]).
_LIST_SYNTAX = re.compile(r"np\.\w+|array|dtype=\w+|[\[\](),;]")
# Numbers as loggers write them; float() also accepts 1_000 and non-ASCII digits.
_NUMBER = re.compile(
    r"[+-]?((\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|nan|inf(inity)?)", re.ASCII | re.I
)
# Numbers with thousands separators: 1.234,56 or 1,234.56 or 1,234.
_THOUSANDS = re.compile(r"[+-]?\d{1,3}((\.\d{3})+,\d+|(,\d{3})+(\.\d*)?)", re.ASCII)
# Minimum number of rows for which an invalid last line is taken as truncated.
_MIN_ROWS = 10
# Errors of spreadsheets and not-a-numbers of Windows in cells, not comments.
_SHEET_ERROR = re.compile(
    rb"#(REF!|N/A|NUM!|VALUE!|DIV/0!|NAME\?|NULL!)|-?\d\.#[A-Z]+\d*|-?nan\(\w+\)"
)
# Decimal commas, in contrast to separators of thousands.
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,(\d{1,2}|\d{4,})([eE].*)?", re.ASCII)
_BRACKETS_TO_BLANKS = bytes.maketrans(b"()[]", b"    ")
# A line that declares the separator to Excel.
_EXCEL_SEPARATOR = re.compile(r'"?sep=.?"?', re.IGNORECASE)
# A line of column names with separators, as opposed to prose.
_HEADER = re.compile(r"[^\s;,|]+([\t ]*[;,|\t][\t ]*[^\s;,|]+)+")
# A row of numbers, some of them in brackets, as YARP prints its ports.
_BRACKETED = re.compile(r"[-+\d.eE\s,;]*[(\[][-+\d.eE\s,;()\[\]]*")


def read_text(path, content) -> Table:
    """Read text with a header line; blank lines and comments (#) are skipped."""
    with parsing(path, "table of numbers", "save it as CSV in UTF-8."):
        content, notes = _decode(path, content)
        filled = list(filter(None, map(_without_comment, _first_lines(content))))
        if filled and _BRACKETED.fullmatch(filled[0]):
            content = content.translate(_BRACKETS_TO_BLANKS)
        try:
            return _read_lines(path, content, notes)
        except RecordingRefused as error:
            rows = (re.split(r"[;,|\s]+", line) for line in filled)
            header = len(filled) == 1 and _HEADER.fullmatch(filled[0])
            if not content or header or any(map(_is_data, rows)):
                raise
            raise NotATable(error.reason) from error


def _decode(path, content):
    """Convert text to UTF-8 with Unix line endings; also return notes."""
    # A byte order mark determines the encoding. Otherwise text is UTF-8 or, as saved by
    # Excel in Western Europe, in code page 1252.
    notes = ()
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        content = content.decode("utf-16").encode()
    try:
        content.decode()
    except UnicodeDecodeError:
        content = content.decode("cp1252").encode()
        notes = ("is not UTF-8, read as Windows text (cp1252), as Excel saves CSV.",)
    if b"\0" in content:
        raise NotATable(f"{path}: is binary, not text; save it as CSV in UTF-8.")
    content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return _SHEET_ERROR.sub(b"nan", content).removeprefix(b"\xef\xbb\xbf"), notes


def _first_lines(content):
    """Return the first lines, which may precede the data, without line endings."""
    lines = itertools.islice(io.BytesIO(content), _MAX_PREAMBLE)
    return [line.decode().rstrip("\n") for line in lines]


def _without_comment(line):
    """Return a line without comment, "" if it declares the separator to Excel."""
    line = line.split("#", 1)[0].strip(" \n")
    return "" if not line.strip() or _EXCEL_SEPARATOR.fullmatch(line) else line


def _read_lines(path, content, notes=()):
    """Parse UTF-8 text with a header into a table."""
    lines = _first_lines(content)
    names, start, separator, more = _parse_header(path, lines)
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
    return _convert_columns(table, comma=separator != ",")


def _parse_header(path, lines):
    """Return column names, number of lines before the data, separator and notes."""
    # Columns without names are numbered from "1". The separator None is white space.
    content = [(k, x) for k, x in enumerate(map(_without_comment, lines)) if x]
    if not content:
        raise no_rows(path)
    rows = [_cells(x) for _, x in content]
    # Without a row of numbers, as with a single column of text, names come first.
    data = next((k for k, row in enumerate(rows) if _is_data(row)), 1)
    # If there is only a header, the data begin after it.
    start = content[data][0] if data < len(content) else len(lines)
    name_row, notes = max(data - 1, 0), ()
    (number, line), names = content[name_row], rows[name_row]
    if not data:
        # The names may be in the last comment line before the numbers.
        number = max((k for k in range(start) if lines[k].strip()), default=0)
        names = _echo_names(names) or _cells(lines[number].lstrip("# "))
        if len(names) != len(rows[0]) or any(map(_is_number, names)):
            names = [str(k + 1) for k in range(len(rows[0]))]
            # Data frames without column names are written with a header 0, 1, 2, ...
            start += rows[0] == [str(k) for k in range(max(len(names), 3))]
    elif name_row and (with_units := _with_units(rows[name_row - 1], names)):
        name_row, names = name_row - 1, with_units
        number, line = content[name_row]
    if name_row:
        notes = (f"the names of the columns are in line {number + 1}.",)
    _check_header(path, names, number + 1)
    return names, start, _separator_of(line), notes


def _echo_names(cells):
    """Return names for cells of a JointState by ``ros2 topic echo --csv``, or []."""
    # It writes the values of a message consecutively, without header (message_to_csv
    # in rosidl_runtime_py/convert.py of github.com/ros2/rosidl_runtime_py): time stamp,
    # frame, names, positions, velocities and efforts.
    n = (len(cells) - 3) // 4
    numbers = [_is_number(cell) for cell in [*cells[:2], *cells[3:]]]
    if n < 1 or numbers != 2 * [True] + n * [False] + 3 * n * [True]:
        return []
    names = ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id"]
    for kind in ("name", "position", "velocity", "effort"):
        names += [f"{kind}_{k}" for k in range(n)]
    return names


def _separator_of(line):
    """Return the separator in a line, None for white space."""
    return next((mark for mark in (";", "\t", ",", "|") if mark in line), None)


def _split(line, separator):
    """Return the cells of a line without comment; separators in quotes are ignored."""
    line = line.split("#")[0].strip(" \n")
    if separator is None:
        cells = line.split()
    else:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return [cell.strip("\"' ") for cell in cells]


def _cells(line):
    """Return the cells of a line, without trailing empty cells."""
    cells = _split(line, _separator_of(line)) if line else []
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell) is not None


def _is_data(cells):
    """Return whether more than half of the cells are numbers."""
    numbers = [_is_number(x.replace(",", ".", 1)) for x in cells if x]
    return 2 * sum(numbers) > len(cells)


def _with_units(names, cells):
    """Append the units in the row below to names; return [] if it has no units."""
    cells = [cell.strip("[]()- ") for cell in cells]
    units = [any(unit_of(kind, cell) for kind in EXPECTED) for cell in cells]
    if len(names) != len(cells) or 2 * sum(units) <= len(cells):
        return []
    without_unit = [name and not split_unit(name)[1] for name in names]
    rows = zip(names, cells, without_unit)
    return [f"{name} [{unit}]" if bare and unit else name for name, unit, bare in rows]


def _check_header(path, names, line):
    """Refuse missing or repeated names; only the first, an index, may be empty."""
    for k, name in enumerate(names):
        if not name and (k > 0 or len(names) == 1):
            raise RecordingRefused(
                f"{path}: column {k + 1} has no name in line {line}; name it (t, q1, "
                "tau1, ...) or remove it."
            )
    check_names(path, names, f"line {line} names")


def _checked_rows(path, content, names, start, separator):
    """Return the line numbers of rows, and whether a truncated last row was dropped."""
    # Any other row whose number of cells differs from that of the names is refused.
    numbers, quotes = [], b'"' in content
    sep = None if separator is None else separator.encode()
    last = content.count(b"\n") + (not content.endswith(b"\n"))
    for number, line in enumerate(io.BytesIO(content), start=1):
        row = line.partition(b"#")[0]
        if number <= start or not row.strip():
            continue
        cells, fault = row.count(sep) + 1 if sep else len(row.split()), ""
        if cells != len(names) or quotes:
            fault = _row_fault(row.decode(), names, separator)
        is_cut = fault or not line.endswith(b"\n")
        if number == last and len(numbers) >= _MIN_ROWS and is_cut:
            return numbers, True
        if fault:
            raise RecordingRefused(f"{path}: line {number} {fault}.")
        numbers.append(number)
    return numbers, False


def _row_fault(line, names, separator):
    """Return why a row does not have one cell per name, "" if it does."""
    if line.count('"') % 2:
        return "has a quotation mark without a second one; correct or remove that line"
    cells = _split(line, separator)
    if len(cells) >= len(names) and not any(cells[len(names) :]):
        return ""
    remedy = "correct or remove that line"
    if separator == "," and len(cells) > len(names):
        remedy = "numbers with decimal commas need ; as separator"
    return f"has {len(cells)} cells, the header names {len(names)} columns; {remedy}"


def _convert_columns(table, comma):
    """Convert the cells of a table to numbers or text, and split columns of lists."""
    path, frame, notes = table.path, table.frame, table.notes
    if "" not in frame and all(kind.kind in "iuf" for kind in frame.dtypes):
        return table
    columns = []
    for name in frame:
        values = _convert_cells(table, name, comma)
        columns += _split_lists(table, name, values) or [(name, values)]
    check_names(path, [name for name, _ in columns], "as an entry of a list has")
    columns = dict(columns)
    if "" in columns:
        index = columns.pop("")
        is_index = index.dtype.kind in "if" and (np.diff(index) == 1).all()
        if not (is_index and columns):
            _check_header(path, [""], frame.index[0] - 1)
        note = "the first column has no name and counts the rows: it is left out."
        notes = (*notes, note)
    frame = imported(path, "pandas").DataFrame(columns, index=frame.index)
    return replace(table, frame=frame, notes=notes)


def _convert_cells(table, name, comma):
    """Convert a column to numbers, or to text if its first filled cell is text."""
    values = table.frame[name]
    if values.dtype.kind in "iuf":
        return values.to_numpy(dtype=float)
    text = values.astype(str).str.strip("\"' ")
    filled = values.notna() & ~text.str.lower().isin(_MISSING)
    cells = text.where(filled)
    if comma or text.str.fullmatch(_DECIMAL_COMMA).any():
        points = text.str.contains(".", regex=False)
        cells = cells.where(points, cells.str.replace(",", ".", n=1, regex=False))
    numbers = imported(table.path, "pandas").to_numeric(cells, errors="coerce")
    invalid = np.flatnonzero(filled & numbers.isna())
    if not invalid.size:
        return numbers.to_numpy(dtype=float)
    cell, remedy = text.iloc[invalid[0]], "correct or remove that line"
    has_thousands = _THOUSANDS.fullmatch(cell)
    if invalid[0] == np.argmax(filled) and not has_thousands:
        return text.where(filled, "").to_numpy(dtype=object)
    if has_thousands:
        remedy = "write numbers without separators of thousands"
    raise RecordingRefused(
        f"{table.path}: {quoted(cell)} in {table.where(invalid[0])}, column "
        f"{quoted(name)} is not a number; {remedy}."
    )


def _split_lists(table, name, values):
    """Split cells with lists of numbers to named columns; return [] for other cells."""
    if values.dtype.kind != "O":
        return []
    rows = [_LIST_SYNTAX.sub(" ", cell).split() for cell in values]
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


def read_sheet(path) -> Table:
    """Read the first sheet with numbers, by conversion to tab-separated text."""
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
        lines = {name: _lines_of(cells) for name, cells in sheets.items()}
        # Prefer the first sheet with numbers, then the first with text.
        numbers = [x for x, y in lines.items() if any(map(_is_data, map(_cells, y)))]
        name = [*numbers, *(x for x in lines if any(lines[x])), *lines][0]
        table = _read_lines(path, "\n".join([*lines[name], ""]).encode())
    place = "line {} of sheet " + repr(name).replace("{", "{{").replace("}", "}}")
    return replace(table, place=place)


def _lines_of(sheet):
    """Return the rows of a sheet as tab-separated lines, without empty columns."""
    cells = sheet.astype(str).replace(r'[\s"#;]+', " ", regex=True)
    cells = cells.loc[:, (cells != "").any()]
    lines = ("\t".join(row) for row in cells.itertuples(index=False))
    return [line if line.strip() else "" for line in lines]
