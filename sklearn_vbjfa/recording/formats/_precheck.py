"""Text before pandas reads it: encoding, lines, cells of each row, a cut last line."""

import codecs
import csv
import functools
import io
import re
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.recording._table import Source

# A longer line is not a row of a table; bytes that are checked at once.
_LONGEST_LINE, _BLOCK = 1 << 25, 1 << 24
# Of fewer rows the last is not said to be cut; rows that show the usual decimals.
_FEWEST, _TAIL = 10, 500
# A cell of a spreadsheet, not the beginning of a comment.
_SHEET_ERROR = re.compile(rb"#(N/A|DIV/0!|VALUE!|REF!|NAME\?|NUM!|NULL!)")
_NO_BRACKETS = bytes.maketrans(b"()[]", b"    ")
LIST = re.compile(r"[(\[]([^()\[\]]*)[)\]]")
# float() takes more (1_000, digits of other scripts), which no logger writes.
NUMBER = re.compile(
    r"[+-]?((\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|nan|inf(inity)?)", re.ASCII | re.I
)

# Nothing is guessed from how frequent letters are. A mark at the beginning (Excel's
# "Unicode text" has one) settles it; text without one is UTF-8 if all of it is.
# Otherwise it may be a CSV file that Excel saved in Western Europe, code page 1252.
# Of marks that begin alike the longer one counts.
_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
# The characters of that code page, control characters left out.
_WINDOWS = bytes(
    k
    for k in range(256)
    if k in b"\t\n\r\f" or (k >= 32 and k not in b"\x7f\x81\x8d\x8f\x90\x9d")
)


def is_number(cell: str) -> bool:
    """Whether a cell is a number as loggers write them."""
    return NUMBER.fullmatch(cell) is not None


@dataclass(frozen=True)
class Text:
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

    def _check_length(self, lines):
        if max(map(len, lines), default=0) >= _LONGEST_LINE:
            raise ValueError(
                f"{self.path}: has a line of more than {_LONGEST_LINE} characters; "
                "expected one row per sample."
            )

    def without_brackets(self):
        """Return the text with blanks in place of brackets."""
        with self.open() as file:
            content = file.read().translate(_NO_BRACKETS)
        return Text(self.path, content, self.notes)

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


def _lines(block):
    if b"\r" in block:
        block = block.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return block.split(b"\n")


def text_in_utf8(path: Source) -> Text:
    """Return the text of a file; refuse what is not text in any known encoding."""
    with path.file.open("rb") as file:
        begin = file.read(4)
        file.seek(0)
        marked = [name for mark, name in _BYTE_ORDER_MARKS if begin.startswith(mark)]
        encoding = marked[0] if marked else "utf-8"
        decoder = codecs.getincrementaldecoder(encoding)()
        try:
            binary = False
            while block := file.read(_BLOCK):
                binary |= "\0" in decoder.decode(block)
            decoder.decode(b"", final=True)
        except UnicodeDecodeError:
            return _in_another_encoding(path, encoding, bool(marked))
    if binary:
        raise ValueError(f"{path}: is binary, not text; save it as CSV in UTF-8.")
    if encoding.startswith("utf-8"):
        return Text(path)
    return Text(path, path.file.read_bytes().decode(encoding).encode())


def _in_another_encoding(path, encoding, marked):
    """Return text in the code page of Windows; refuse what is none."""
    content = path.file.read_bytes()
    # A file with some characters in UTF-8 is damaged, not in another encoding: by
    # chance two letters of the code page make no such character.
    odd = content.translate(None, _WINDOWS)
    if not marked and not odd and content.decode("utf-8", "ignore").isascii():
        note = "is not UTF-8, read as Windows text (cp1252), as Excel saves CSV."
        return Text(path, content.decode("cp1252").encode(), (note,))
    name = encoding.removesuffix("-sig")
    try:
        content.decode(name)
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: is not {name.upper()} ({error.reason} at byte {error.start}); "
            "save it as CSV in UTF-8."
        ) from error
    raise AssertionError("decoded whole, but not in parts")


# -- cells of each row -----------------------------------------------------------------


def separator_of(line: str) -> str | None:
    """Return the separator that a line has; None is white space."""
    return next((mark for mark in (";", "\t", ",") if mark in line), None)


def cells_of(line, separator):
    """Return the cells of a line without a comment; in quotes a separator is none."""
    line = line.split("#")[0].strip(" \r\n")
    if separator is None:
        cells = line.split()
    else:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return [cell.strip("\"' ") for cell in cells]


def check_rows(text: Text, start, names, separator):
    """Return the numbers of the lines with rows, without a last one that was cut."""
    # Refuses a row that has not as many cells as there are names; start: first line.
    width, number, rows, last, ended = len(names), 0, [], [], True
    mark = b"" if separator is None else separator.encode()
    for lines in text.blocks():
        lines, first = lines[max(start - number, 0) :], max(start, number)
        number += len(lines) if number >= start else len(lines) + start - number
        if not lines:
            continue
        ended = not lines[-1]
        if any(b"#" in line for line in lines):
            lines = without_comments(text.path, lines, first)
        counts = [line.count(mark) + 1 if mark else len(line.split()) for line in lines]
        odd = np.array(counts) != width
        odd |= width == 1 or any(b'"' in line for line in lines)
        data = np.ones(len(lines), dtype=bool)
        for k in np.flatnonzero(odd):
            data[k] = bool(lines[k].strip())
            wrong = _wrong(lines[k].decode(), names, separator) if data[k] else ""
            # The last line may be one that was cut.
            if wrong and (
                k < len(lines) - 1 or k + sum(x.size for x in rows) < _FEWEST
            ):
                raise ValueError(f"{text.path}: line {first + k + 1} {wrong}.")
        data = np.flatnonzero(data)
        rows.append(data + first + 1)
        last = [*last, *(lines[k].decode() for k in data[-_TAIL:])][-_TAIL:]
    numbers = np.concatenate([np.zeros(0, dtype=int), *rows])
    if not ended and numbers.size >= _FEWEST and _is_cut(last, width, separator):
        return numbers[:-1], True
    return numbers, False


def without_comments(path, lines, first=0):
    """Return lines without comments; refuse errors of spreadsheets."""
    for k, line in enumerate(lines):
        error = _SHEET_ERROR.search(line) if b"#" in line else None
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
    cells = cells_of(line, separator)
    while len(cells) > len(names) and not cells[-1]:
        cells.pop()
    if len(cells) == len(names):
        return ""
    remedy = "correct or remove that line"
    if len(cells) == 1 and separator_of(line) != separator:
        remedy = "separate the columns as the header does"
    elif separator == "," and len(cells) > len(names):
        remedy = "numbers with decimal commas need ; as separator"
    return f"has {len(cells)} cells, the header names {len(names)} columns; {remedy}"


def _is_cut(lines, width, separator):
    """Whether the last of some lines, which has no end, is not whole."""
    # Whole files may lack the end of the last line, too: of a whole cell the decimals
    # are as many as in one of the others.
    last, usual = (cells_of(line, separator) for line in (lines[-1], lines[-2]))
    whole = len(last) >= width and bool(last[-1]) >= bool(usual[-1])
    if LIST.fullmatch(usual[-1]):
        return not (whole and LIST.fullmatch(last[-1]))
    decimals = [_decimals(line, separator) for line in lines]
    return not (whole and decimals[-1] >= min(decimals[:-1]))


def _decimals(line, separator):
    """Count the decimals of the last cell of a line."""
    cell = line.rstrip().rpartition(separator or " ")[2]
    return len(cell.rpartition("." if separator == "," or "." in cell else ",")[2])
