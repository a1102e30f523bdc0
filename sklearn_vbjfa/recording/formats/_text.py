"""Tables out of text: encoding, separator, names, cells of each row; then pandas."""

import codecs
import csv
import functools
import io
import re
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.recording._table import (
    CUT,
    Format,
    NotATable,
    Source,
    Table,
    no_rows,
    pandas_of,
    parsing,
)
from sklearn_vbjfa.recording.formats._cells import (
    LONGEST_PREAMBLE,
    NOTHING,
    check_header,
    is_data,
    is_number,
    names_and_start,
    table_of_cells,
    without_blank_ends,
)

# A longer line is not a row of a table; bytes that are checked at once.
_LONGEST_LINE, _BLOCK = 1 << 25, 1 << 24
# Of fewer rows the last is not said to be cut; rows that show the usual decimals.
_FEWEST, _TAIL = 10, 500
# A cell of a spreadsheet, not the beginning of a comment.
_SHEET_ERROR = re.compile(rb"#(N/A|DIV/0!|VALUE!|REF!|NAME\?|NUM!|NULL!)")
_NO_BRACKETS = bytes.maketrans(b"()[]", b"    ")
_SEPARATORS = (";", "\t", ",", "|")
_ANY = re.compile(r"[;,|\s]+")
# This line is the separator for Excel.
_EXCEL_SEPARATOR = re.compile(r'"?sep=.?"?', re.IGNORECASE)
# A row of numbers some of which stand in brackets, as YARP prints its ports.
_BRACKETED = re.compile(r"[-+\d.eE\s,;]*[(\[][-+\d.eE\s,;()\[\]]*")
# Nothing is guessed from how frequent letters are: a mark at the beginning settles the
# encoding; text without one is UTF-8 if all of it is, else it may be a CSV file that
# Excel saved in Western Europe, code page 1252. The longer mark counts.
_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
# The bytes of that code page that are no control characters.
_WINDOWS = bytes({*b"\t\n\r\f", *range(32, 256)} - {*b"\x7f\x81\x8d\x8f\x90\x9d"})


def read_text(path: Source, wanted) -> Table:
    """Read text with a header line; blank lines and comments (#) are skipped."""
    text = _text_in_utf8(path)
    lines = text.lines(2 * LONGEST_PREAMBLE)
    content = [line for line in map(_content, lines) if line]
    if not content:
        raise no_rows(path)
    try:
        if _BRACKETED.fullmatch(content[0]):
            text = text.without_brackets()
            lines = text.lines(2 * LONGEST_PREAMBLE)
        return _read(text, lines)
    except csv.Error as error:
        raise ValueError(
            f"{path}: is not a table of numbers ({error}); save it as CSV in UTF-8."
        ) from error
    except ValueError as error:
        # An empty log is one, and broken.
        if len(content) < 2 or any(is_data(re.split(_ANY, x)) for x in content):
            raise
        raise NotATable(str(error)) from error


def _content(line):
    """Return a line without its comment, "" for one that tells Excel the separator."""
    line = line.split("#", 1)[0].strip()
    return "" if _EXCEL_SEPARATOR.fullmatch(line) else line


def _read(text, lines):
    path, pandas = text.path, pandas_of(text.path)
    names, start, separator, units, notes = _head(path, lines)
    _without_comments(path, [line.encode() for line in lines[:start]])
    columns = names or _places(lines[start], separator)
    numbers, cut = _check_rows(text, start, columns, separator)
    if not numbers.size:
        raise ValueError(f"{path}: only a header and no rows of data.")
    with parsing(path, "table of numbers", "save it as CSV in UTF-8"):
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
                na_values=[y for x in NOTHING for y in (x, x.upper(), x.capitalize())],
                encoding="utf-8-sig",
                decimal="," if separator != "," and "," in lines[start] else ".",
            )
    if len(frame) != len(numbers):
        raise ValueError(
            f"{path}: has {len(numbers)} lines and {len(frame)} rows; write each row "
            "in one line."
        )
    frame.index = numbers
    return table_of_cells(
        path,
        frame,
        comma=separator != ",",
        notes=(*notes, *[CUT] * cut, *text.notes),
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
    rows = (_cells(x, _separator_of(x)) for _, x in content)
    at, names, start, units = names_and_start(rows)
    # Of a file with a header alone the data begin after it.
    start = content[start][0] if start < len(content) else len(lines)
    if at is not None:
        header, found = content[at]
    else:
        # Numbers at once: the header may be the last comment before them.
        header = max((k for k in range(first) if lines[k].strip()), default=None)
        found = "" if header is None else lines[header].strip().lstrip("#")
        found = found.split("#")[0].strip()
        names = without_blank_ends(_cells(found, _separator_of(found)))
        width = len(_places(line, _separator_of(line)))
        if len(names) != width or any(map(is_number, names)):
            return [], start, _separator_of(line), (), []
    if found == "header:":
        raise ValueError(
            f"{path}: holds messages as topic echo shows them; write them one a line, "
            "ros2 topic echo --csv TOPIC > FILE.csv (rostopic echo -p), or record a bag"
        )
    marks = [mark for mark in (":", "/") if mark in found]
    if len(names) == 1 and marks:
        raise ValueError(
            f"{path}: line {header + 1} is one cell, with {marks[0]!r} in it; separate "
            "the columns by comma, semicolon, tab or blanks."
        )
    check_header(path, names, header + 1)
    notes = [f"the names of the columns are in line {header + 1}."] if at else []
    return list(names), start, _separator_of(found), units, notes


def _places(line, separator):
    """Return names for the columns of a table that has none, by a row."""
    cells = without_blank_ends(_cells(line, separator))
    return [str(k + 1) for k in range(len(cells))]


def _echo_names(line):
    """Return names for the cells of a JointState by ``ros2 topic echo --csv``."""
    # It writes the values of a message one after another and no header (message_to_csv
    # in rosidl_runtime_py/convert.py of github.com/ros2/rosidl_runtime_py): the stamp,
    # the frame, names, positions, velocities and efforts. [] if the line is not one.
    cells = _cells(line, ",")
    n, rest = divmod(len(cells) - 3, 4)
    if n < 1 or rest or not all(re.fullmatch(r"\d+", x) for x in cells[:2]):
        return []
    joints, numbers = cells[3 : 3 + n], cells[3 + n :]
    if any(map(is_number, joints)) or not all(map(is_number, numbers)):
        return []
    names = ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id"]
    for what in ("name", "position", "velocity", "effort"):
        names += [f"{what}_{k}" for k in range(n)]
    return names


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

    def lines(self, count):
        """Return the first lines, without their ends."""
        with io.TextIOWrapper(self.open(), encoding="utf-8-sig") as file:
            read = functools.partial(file.readline, _LONGEST_LINE)
            found = [line for line, _ in zip(iter(read, ""), range(count))]
        self._check_length(found)
        return [line.rstrip("\n") for line in found]

    def without_brackets(self):
        """Return the text with blanks in place of brackets."""
        with self.open() as file:
            content = file.read().translate(_NO_BRACKETS)
        return _Text(self.path, content, self.notes)

    def blocks(self):
        """Yield lists of lines, as bytes; the last line is empty if it has an end."""
        with self.open() as file:
            left = b""
            while block := file.read(_BLOCK):
                left += block
                cut = max(left.rfind(b"\n"), left.rfind(b"\r", 0, -1)) + 1
                if cut:
                    yield _lines(left[:cut])[:-1]
                    left = left[cut:]
                self._check_length([left])
            yield _lines(left)

    def _check_length(self, lines):
        if max(map(len, lines), default=0) >= _LONGEST_LINE:
            raise ValueError(
                f"{self.path}: has a line of more than {_LONGEST_LINE} characters; "
                "expected one row per sample."
            )


def _lines(block):
    if b"\r" in block:
        block = block.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return block.split(b"\n")


def _text_in_utf8(path):
    """Return the text of a file; refuse what is not text in any known encoding."""
    with path.file.open("rb") as file:
        begin = file.read(4)
        file.seek(0)
        marked = [name for mark, name in _BYTE_ORDER_MARKS if begin.startswith(mark)]
        encoding = marked[0] if marked else "utf-8"
        decoder, binary = codecs.getincrementaldecoder(encoding)(), False
        try:
            while block := file.read(_BLOCK):
                binary |= "\0" in decoder.decode(block)
            decoder.decode(b"", final=True)
        except UnicodeDecodeError:
            return _in_another_encoding(path, encoding, bool(marked))
    if binary:
        raise ValueError(f"{path}: is binary, not text; save it as CSV in UTF-8.")
    if encoding.startswith("utf-8"):
        return _Text(path)
    return _Text(path, path.file.read_bytes().decode(encoding).encode())


def _in_another_encoding(path, encoding, marked):
    """Return text in the code page of Windows; refuse what is none."""
    content, name = path.file.read_bytes(), encoding.removesuffix("-sig")
    try:
        # A file with some characters in UTF-8 is damaged, not in another encoding: by
        # chance two letters of the code page make no such character.
        odd = content.translate(None, _WINDOWS)
        if marked or odd or not content.decode("utf-8", "ignore").isascii():
            content.decode(name)
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: is not {name.upper()} ({error.reason} at byte {error.start}); "
            "save it as CSV in UTF-8."
        ) from error
    note = "is not UTF-8, read as Windows text (cp1252), as Excel saves CSV."
    return _Text(path, content.decode("cp1252").encode(), (note,))


# -- cells of each row -----------------------------------------------------------------


def _separator_of(line):
    """Return the separator that a line has; None is white space."""
    return next((mark for mark in _SEPARATORS if mark in line), None)


def _cells(line, separator):
    """Return the cells of a line without a comment; in quotes a separator is none."""
    line = line.split("#")[0].strip(" \r\n")
    if separator is None:
        cells = line.split()
    else:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return [cell.strip("\"' ") for cell in cells]


def _check_rows(text, start, names, separator):
    """Return the numbers of the lines with rows, without a last one that was cut."""
    # Refuses a row that has not as many cells as there are names; start: first line.
    width, number, rows, last, ended = len(names), 0, [], [], True
    mark = b"" if separator is None else separator.encode()
    for lines in text.blocks():
        first = max(start, number)
        number += len(lines)
        lines = lines[max(start - number + len(lines), 0) :]
        if not lines:
            continue
        ended = not lines[-1]
        lines = _without_comments(text.path, lines, first)
        counts = [line.count(mark) + 1 if mark else len(line.split()) for line in lines]
        odd = np.array(counts) != width
        odd |= width == 1 or any(b'"' in line for line in lines)
        data = np.ones(len(lines), dtype=bool)
        for k in np.flatnonzero(odd):
            data[k] = bool(lines[k].strip())
            wrong = _wrong(lines[k].decode(), names, separator) if data[k] else ""
            # The last line may be one that was cut.
            may_be_cut = k == len(lines) - 1 and k + sum(map(len, rows)) >= _FEWEST
            if wrong and not may_be_cut:
                raise ValueError(f"{text.path}: line {first + k + 1} {wrong}.")
        data = np.flatnonzero(data)
        rows.append(data + first + 1)
        last = [*last, *(lines[k].decode() for k in data[-_TAIL:])][-_TAIL:]
    numbers = np.concatenate([np.zeros(0, dtype=int), *rows])
    if not ended and numbers.size >= _FEWEST and _is_cut(last, width, separator):
        return numbers[:-1], True
    return numbers, False


def _without_comments(path, lines, first=0):
    """Return lines without comments; refuse errors of spreadsheets."""
    if not any(b"#" in line for line in lines):
        return lines
    for k, line in enumerate(lines):
        error = _SHEET_ERROR.search(line)
        if error:
            raise ValueError(
                f"{path}: {error[0].decode()!r} in line {first + k + 1} is not a "
                "number; correct or remove that line."
            )
    return [line.partition(b"#")[0] for line in lines]


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
    if len(cells) == 1 and _separator_of(line) != separator:
        remedy = "separate the columns as the header does"
    elif separator == "," and len(cells) > len(names):
        remedy = "numbers with decimal commas need ; as separator"
    return f"has {len(cells)} cells, the header names {len(names)} columns; {remedy}"


def _is_cut(lines, width, separator):
    """Whether the last of some lines, which has no end, is not whole."""
    # Whole files may lack the end of the last line, too: of a whole cell the decimals
    # are as many as in one of the others.
    last, usual = (_cells(line, separator) for line in (lines[-1], lines[-2]))
    whole = len(last) >= width and bool(last[-1]) >= bool(usual[-1])
    if usual[-1].startswith(("[", "(")):
        return not (whole and last[-1].endswith(("]", ")")))
    decimals = [_decimals(line, separator) for line in lines]
    return not (whole and decimals[-1] >= min(decimals[:-1]))


def _decimals(line, separator):
    """Count the decimals of the last cell of a line."""
    cell = line.rstrip().rpartition(separator or " ")[2]
    return len(cell.rpartition("." if separator == "," or "." in cell else ",")[2])


TEXT = Format(
    name="CSV (also .gz, .bz2, .xz)",
    endings=(".csv", ".tsv", ".txt", ".dat"),
    read=read_text,
)
