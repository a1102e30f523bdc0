"""Tables out of text and spreadsheets: encoding, separator, names, cells; pandas."""

import codecs
import contextlib
import csv
import datetime
import io
import itertools
import re
import zipfile
from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np

from sklearn_vbjfa.recording._table import (
    NotATable,
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
_LONGEST_PREAMBLE = 100
# What loggers write where nothing was measured.
_NOTHING = ("", "-", "nan", "-nan", "+nan", "na", "n/a", "null", "none")
# NumPy writes lists of its numbers as [np.float64(0.1), ...].
_OF_NUMPY = re.compile(r"np\.\w+\(([^()]*)\)")
_LIST = re.compile(r"[(\[]([^()\[\]]*)[)\]]")
# float() takes more (1_000, digits of other scripts), which no logger writes.
_NUMBER = re.compile(
    r"[+-]?((\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|nan|inf(inity)?)", re.ASCII | re.I
)
# A longer line is not a row of a table; bytes that are checked at once.
_LONGEST_LINE, _BLOCK = 1 << 25, 1 << 24
# Of fewer rows the last is not said to be cut; rows that show the usual decimals.
_FEWEST, _TAIL = 10, 500
_NO_BRACKETS = bytes.maketrans(b"()[]", b"    ")
_ANY = re.compile(r"[;,|\s]+")
# This line is the separator for Excel.
_EXCEL_SEPARATOR = re.compile(r'"?sep=.?"?', re.IGNORECASE)
# A row of numbers some of which stand in brackets, as YARP prints its ports.
_BRACKETED = re.compile(r"[-+\d.eE\s,;]*[(\[][-+\d.eE\s,;()\[\]]*")
# A mark at the beginning settles the encoding. Text without one is UTF-8, or a CSV file
# that Excel saved in Western Europe, code page 1252.
_MARKS = {codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
# The bytes of that code page that are no control characters.
_WINDOWS = bytes({*b"\t\n\r\f", *range(32, 256)} - {*b"\x7f\x81\x8d\x8f\x90\x9d"})


def read_text(path: Source) -> Table:
    """Read text with a header line; blank lines and comments (#) are skipped."""
    text = _text_of(path)
    lines = text.first_lines()
    content = [line for line in map(_content, lines) if line]
    if not content:
        raise no_rows(path)
    try:
        if _BRACKETED.fullmatch(content[0]):
            text = _Text(path, text.read().translate(_NO_BRACKETS), text.notes)
            lines = text.first_lines()
        return _read(text, lines)
    except csv.Error as error:
        raise ValueError(
            f"{path}: is not a table of numbers ({error}); save it as CSV in UTF-8."
        ) from error
    except ValueError as error:
        # An empty log is one, and broken.
        if len(content) < 2 or any(_is_data(re.split(_ANY, x)) for x in content):
            raise
        raise NotATable(str(error)) from error


def _content(line):
    """Return a line without its comment, "" for one that tells Excel the separator."""
    line = line.split("#", 1)[0].strip()
    return "" if _EXCEL_SEPARATOR.fullmatch(line) else line


def _read(text, lines):
    path, pandas = text.path, pandas_of(text.path)
    names, start, separator, units, notes = _head(path, lines)
    columns = names or _places(lines[start], separator)
    numbers, is_cut = _rows(text, start, columns, separator)
    if not numbers.size:
        raise ValueError(f"{path}: only a header and no rows of data.")
    with parsing(path, "table of numbers", "save it as CSV in UTF-8."):
        with text.open() as file:
            frame = pandas.read_csv(
                file,
                sep=separator or r"\s+",
                header=None,
                names=columns,
                index_col=False,
                skiprows=start,
                nrows=len(numbers),
                comment="#",
                keep_default_na=False,
                na_values=[y for x in _NOTHING for y in (x, x.upper(), x.capitalize())],
                encoding="utf-8-sig",
                decimal="," if separator != "," and "," in lines[start] else ".",
            )
    if len(frame) != len(numbers):
        raise ValueError(
            f"{path}: has {len(numbers)} lines and {len(frame)} rows; write each row "
            "in one line."
        )
    frame.index = numbers
    return _table_of_cells(
        path,
        frame,
        comma=separator != ",",
        notes=(*notes, *[CUT] * is_cut, *text.notes),
        units=dict(units),
        nameless=not names,
    )


# -- names -----------------------------------------------------------------------------


def _head(path, lines):
    """Return the names, the first line of data, the separator, units and notes."""
    content = [(k, x) for k, x in enumerate(map(_content, lines)) if x]
    first, line = content[0]
    echo = _echo_names(line)
    if echo:
        return echo, first, ",", (), []
    at, names, start, units = _names_and_start(_cells(x) for _, x in content)
    # Of a file with a header alone the data begin after it.
    start = content[start][0] if start < len(content) else len(lines)
    if at is not None:
        header, found = content[at]
    else:
        # Numbers at once: the header may be the last comment before them.
        header = max((k for k in range(first) if lines[k].strip()), default=None)
        found = "" if header is None else lines[header].strip().lstrip("#")
        found = found.split("#")[0].strip()
        names = _without_blank_ends(_cells(found))
        separator = _separator_of(line)
        if len(names) != len(_places(line, separator)) or any(map(_is_number, names)):
            return [], start, separator, (), []
    _check_header(path, names, header + 1)
    notes = [f"the names of the columns are in line {header + 1}."] if at else []
    return list(names), start, _separator_of(found), units, notes


def _places(line, separator):
    """Return names for the columns of a table that has none, by a row."""
    count = len(_without_blank_ends(_cells(line, separator)))
    return [str(k + 1) for k in range(count)]


def _echo_names(line):
    """Return names for the cells of a JointState by ``ros2 topic echo --csv``."""
    # It writes the values of a message one after another and no header (message_to_csv
    # in rosidl_runtime_py/convert.py of github.com/ros2/rosidl_runtime_py): the stamp,
    # the frame, names, positions, velocities and efforts. [] if the line is not one.
    cells = _cells(line, ",")
    n, rest = divmod(len(cells) - 3, 4)
    if n < 1 or rest or not all(re.fullmatch(r"\d+", x) for x in cells[:2]):
        return []
    if any(map(_is_number, cells[3 : 3 + n])) or not all(
        map(_is_number, cells[3 + n :])
    ):
        return []
    names = ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id"]
    for what in ("name", "position", "velocity", "effort"):
        names += [f"{what}_{k}" for k in range(n)]
    return names


def _separator_of(line):
    """Return the separator that a line has; None is white space."""
    return next((mark for mark in (";", "\t", ",", "|") if mark in line), None)


def _cells(line, *separator):
    """Return the cells of a line without a comment; in quotes a separator is none."""
    (separator,) = separator or [_separator_of(line)]
    line = line.split("#")[0].strip(" \r\n")
    if separator is None:
        cells = line.split()
    else:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return [cell.strip("\"' ") for cell in cells]


def _is_number(cell: str) -> bool:
    """Whether a cell is a number as loggers write them."""
    return _NUMBER.fullmatch(cell) is not None


def _is_data(cells):
    """Whether most of the cells that are filled are numbers."""
    numbers = [_is_number(x.replace(",", ".", 1)) for x in cells if x]
    return 2 * sum(numbers) > len(cells)


def _names_and_start(lines):
    """Find the names among the first lines, each a list of cells as text.

    Returns the position of the names, None without any, the names, the position of the
    first row of data, and (name, unit) of columns out of a row of units.
    """
    rows = []
    for cells in itertools.islice(lines, _LONGEST_PREAMBLE):
        rows.append(_without_blank_ends(cells))
        if _is_data(rows[-1]):
            break
    # Without a row of numbers, as with one column of text, the names come first.
    found = _is_data(rows[-1])
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
        last = _without_blank_ends(above[at - 1])[-1]
        names = [f"{last if x is None else x} {name}".strip() for x, name in pairs]
    units = _units(above[at + 1], names) if at + 1 < len(above) else ()
    return at, names, at + 1 + bool(units), units


def _without_blank_ends(cells):
    """Return cells without empty ones at the end."""
    return cells[: max((k + 1 for k, cell in enumerate(cells) if cell), default=0)]


def _units(cells, names):
    """Return (name, unit) of columns if the cells below the names are units."""
    cells = [cell.strip("[]() ") for cell in cells]
    cells += [""] * (len(names) - len(cells))
    filled = [cell for cell in cells if cell not in ("", "-", "1")]
    if len(cells) != len(names) or any(map(_is_number, filled)):
        return ()
    if not 0 < len(filled) <= 2 * sum(map(is_unit, filled)):
        return ()
    return tuple((name, x) for name, x in zip(names, cells) if x not in ("", "-"))


def _check_header(path, names, line):
    """Refuse names that are missing or come twice; the first may be an index."""
    for k, name in enumerate(names):
        if not name and (k > 0 or len(names) == 1):
            raise ValueError(
                f"{path}: column {k + 1} has no name in line {line}; name it (t, q1, "
                "tau1, ...) or remove it."
            )
    check_names(path, names, f"line {line} names")


# -- encoding --------------------------------------------------------------------------


@dataclass(frozen=True)
class _Text:
    """A text in UTF-8: a file, or its converted text."""

    path: Source
    content: bytes | None = None
    notes: tuple[str, ...] = ()

    def open(self):
        """Open the text as bytes."""
        if self.content is None:
            return self.path.file.open("rb")
        return io.BytesIO(self.content)

    def read(self):
        """Return all of it."""
        with self.open() as file:
            return file.read()

    def first_lines(self):
        """Return the lines that may come before the data, without their ends."""
        with io.TextIOWrapper(self.open(), encoding="utf-8-sig") as file:
            lines = zip(range(2 * _LONGEST_PREAMBLE), file)
            return [line.rstrip("\n") for _, line in lines]


def _text_of(path):
    """Return the text of a file; refuse what is not text in any known encoding."""
    with path.file.open("rb") as file:
        begin = file.read(2)
        file.seek(0)
        encoding = _MARKS.get(begin, "utf-8")
        decoder = codecs.getincrementaldecoder(encoding)()
        binary, carriage, length = False, False, 0
        try:
            while block := file.read(_BLOCK):
                binary |= "\0" in decoder.decode(block)
                ended = b"\n" in block or b"\r" in block
                carriage |= b"\r" in block and b"\n" not in block
                length = 0 if ended else length + len(block)
                if length >= _LONGEST_LINE:
                    raise ValueError(
                        f"{path}: has a line of more than {_LONGEST_LINE} characters; "
                        "expected one row per sample."
                    )
            decoder.decode(b"", final=True)
        except UnicodeDecodeError as error:
            odd = path.file.read_bytes().translate(None, _WINDOWS)
            if odd or encoding != "utf-8":
                raise ValueError(
                    f"{path}: is not {encoding.upper()} ({error.reason}); save it as "
                    "CSV in UTF-8."
                ) from error
            note = "is not UTF-8, read as Windows text (cp1252), as Excel saves CSV."
            return _converted(path, "cp1252", note)
    if binary:
        raise ValueError(f"{path}: is binary, not text; save it as CSV in UTF-8.")
    if encoding == "utf-8" and not carriage:
        return _Text(path)
    return _converted(path, encoding)


def _converted(path, encoding, *notes):
    """Return text in UTF-8, with the ends of lines of Unix."""
    content = path.file.read_bytes().decode(encoding).encode()
    content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return _Text(path, content, notes)


# -- cells of each row -----------------------------------------------------------------


def _rows(text, start, names, separator):
    """Return the numbers of the lines with rows, and whether a cut one was left out."""
    # Refuses a row that has not as many cells as there are names.
    width, number, numbers, last = len(names), 0, [], []
    mark = None if separator is None else separator.encode()
    with text.open() as file:
        while lines := file.readlines(_BLOCK):
            skipped = max(start - number, 0)
            number += len(lines)
            lines = lines[skipped:]
            first, ended = number - len(lines) + 1, bool(lines) and lines[-1][-1:]
            if any(b"#" in line for line in lines):
                lines = [line.partition(b"#")[0] for line in lines]
            data = np.array([not x.isspace() and bool(x) for x in lines], dtype=bool)
            cells = [x.count(mark) + 1 if mark else len(x.split()) for x in lines]
            odd = np.array(cells) != width
            odd |= width == 1 or any(b'"' in line for line in lines)
            for k in np.flatnonzero(odd & data):
                wrong = _wrong(lines[k].decode(), names, separator)
                # The last line may be one that was cut.
                whole = k + 1 < len(lines) or ended == b"\n"
                if wrong and (whole or sum(map(len, numbers)) + k < _FEWEST):
                    raise ValueError(f"{text.path}: line {first + k} {wrong}.")
            rows = np.flatnonzero(data)
            numbers.append(rows + first)
            last = [*last, *(lines[k].decode() for k in rows[-_TAIL:])][-_TAIL:]
    found = np.concatenate([np.zeros(0, dtype=int), *numbers])
    # Whole files may lack the end of the last line, too.
    may_be_cut = found.size >= _FEWEST and ended != b"\n" and found[-1] == number
    if may_be_cut and _is_cut(last, width, separator):
        return found[:-1], True
    return found, False


def _wrong(line, names, separator):
    """Say why a row has not one cell for each name, "" if it has."""
    if line.count('"') % 2:
        return "has a quotation mark without a second one; correct or remove that line"
    cells = _cells(line, separator)
    while len(cells) > len(names) and not cells[-1]:
        cells.pop()
    if len(cells) == len(names):
        return ""
    remedy = "correct or remove that line"
    if separator == "," and len(cells) > len(names):
        remedy = "numbers with decimal commas need ; as separator"
    return f"has {len(cells)} cells, the header names {len(names)} columns; {remedy}"


def _is_cut(lines, width, separator):
    """Whether the last of some lines is not whole: cells or decimals are missing."""
    last, usual = (_cells(line, separator) for line in (lines[-1], lines[-2]))
    whole = len(last) >= width and bool(last[-1]) >= bool(usual[-1])
    if usual[-1].startswith(("[", "(")):
        return not (whole and last[-1].endswith(("]", ")")))
    decimals = [_decimals(line, separator) for line in lines]
    return not (whole and decimals[-1] >= min(decimals[:-1]))


def _decimals(line, separator):
    cell = line.rstrip().rpartition(separator or " ")[2]
    return len(cell.rpartition("." if separator == "," or "." in cell else ",")[2])


# -- columns ---------------------------------------------------------------------------


def _table_of_cells(path, frame, *, place="line {}", comma=False, notes=(), **known):
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
            _check_header(path, [""], frame.index[0] - 1)
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
    blank = (values.isna() | text.str.lower().isin(_NOTHING)).to_numpy()
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
    if not _is_number(numbers.iloc[first]):
        return text.mask(blank, "").to_numpy(dtype=object)
    wrong = np.flatnonzero(~numbers.str.fullmatch(_NUMBER).to_numpy(bool) & ~blank)
    if wrong.size:
        cell = text.iloc[wrong[0]]
        remedy = "correct or remove that line"
        if _is_number(cell.replace(",", "")):
            remedy = "write numbers without separators of thousands"
        raise ValueError(
            f"{table.path}: {quoted(cell)} in {table.where(wrong[0])}, column "
            f"{quoted(name)} is not a number; {remedy}."
        )
    return numbers.mask(blank, "nan").to_numpy(dtype=object).astype(float)


def _spread(table, name, values):
    """Return a column for each entry of cells that are lists of numbers, else {}."""
    if values.dtype.kind != "O" or not all(map(_is_number, _entries(values[0]))):
        return {}
    cells = [_entries(cell) for cell in values]
    if len({len(x) for x in cells}) > 1 or not all(
        _is_number(x) for row in cells for x in row
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
    filled = [
        name for name, frame in sheets.items() if any(map(_is_data, _texts_in(frame)))
    ]
    name = (filled or list(sheets) or [""])[0]
    frame = sheets.get(name)
    if frame is None:
        raise no_rows(path)
    frame.index += 1
    frame = frame[(frame != "").any(axis=1)]
    if len(frame) < 2:
        raise no_rows(path)
    at, names, start, units = _names_and_start(_texts_in(frame))
    if at is None:
        names = [str(k + 1) for k in range(frame.shape[1])]
    else:
        _check_header(path, [x for x in names if x], frame.index[at])
    used = [k for k, one in enumerate(names) if one]
    frame = frame.iloc[start:, used]
    frame.columns = [names[k] for k in used]
    if not len(frame):
        raise ValueError(f"{path}: only a header and no rows of data.")
    return _table_of_cells(
        path,
        frame,
        place="line {} of sheet " + repr(name).replace("{", "{{").replace("}", "}}"),
        notes=(f"sheet {name!r} of {count} was read.",) * (count > 1),
        units=dict(units),
        nameless=at is None,
    )


def _texts_in(frame):
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
