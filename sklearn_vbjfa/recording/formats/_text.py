"""Tables out of text: separators guessed, numbers with points or commas."""

import array
import codecs
import csv
import re
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.recording._layout import is_unit
from sklearn_vbjfa.recording._table import (
    CUT,
    Format,
    Source,
    Table,
    quoted,
)

# Separators that are guessed, and others that a header in one piece may have.
_MARKS = (";", "\t", ",")
_OTHER_MARKS = ("|", ":", "/")
# Lines that an instrument may say of itself before the names of its columns.
_LONGEST_PREAMBLE = 100
# Of fewer lines of data the last is not said to be cut.
_FEWEST = 10
# A longer line is not a row of a table.
_LONGEST_LINE = 1 << 25
# float() takes more (1_000, digits of other scripts), which no logger writes.
_NUMBER = re.compile(
    r"[+-]?((\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|nan|inf(inity)?)", re.ASCII | re.I
)
# A cell of a spreadsheet, not the beginning of a comment.
_SHEET_ERROR = re.compile(r"#(N/A|DIV/0!|VALUE!|REF!|NAME\?|NUM!|NULL!)")


# By this line Excel is told the separator.
_TOLD_SEPARATOR = re.compile(r'"?sep=.?"?', re.IGNORECASE)


# A row of numbers some of which stand in brackets, as YARP prints its ports.
_BRACKETED = re.compile(r"[-+\d.eE\s,;]*[(\[][-+\d.eE\s,;()\[\]]*")
_NO_BRACKETS = str.maketrans("()[]", "    ")
# A cell that is a list, as Python and NumPy write it.
_LIST = re.compile(r"[(\[]([^()\[\]]*)[)\]]")


@dataclass(frozen=True)
class _Text(Source):
    """A text file, and its encoding."""

    encoding: str
    bracketed: bool = False  # whether brackets in its lines mean nothing


class _Lines:
    """Lines of data of a text file, without blank ones and comments."""

    # Iterating reads the file anew, line by line.

    def __init__(self, path, header=-1, end=None):
        self.path = path
        self.header, self.end = header, end
        self.numbers = array.array("q")

    def __iter__(self):
        self.numbers = array.array("q")
        for k, line in _raw_lines(self.path):
            if k <= self.header:
                continue
            if k == self.end:
                return
            error = _SHEET_ERROR.search(line) if "#" in line else None
            if error:
                raise ValueError(
                    f"{self.path}: {error.group()!r} in line {k + 1} is not a number; "
                    "correct or remove that line."
                )
            content = line.split("#", 1)[0] if "#" in line else line
            if content.strip():
                self.numbers.append(k)
                yield content

    def where(self, row):
        """Line of a row in words."""
        return f"line {self.numbers[row] + 1}"


def _raw_lines(path):
    """Yield the number (from 0) and the text of every line."""
    with path.file.open(encoding=path.encoding) as file:
        k = 0
        while line := file.readline(_LONGEST_LINE):
            if "\0" in line:
                raise ValueError(
                    f"{path}: is binary, not text; save it as CSV in UTF-8."
                )
            if len(line) == _LONGEST_LINE:
                raise ValueError(
                    f"{path}: line {k + 1} has more than {_LONGEST_LINE} "
                    "characters; expected one row per sample."
                )
            line = line.rstrip("\n")
            yield k, line.translate(_NO_BRACKETS) if path.bracketed else line
            k += 1


def read_text(path: Source, wanted) -> Table:
    """Read text with a header line; blank lines and comments (#) are skipped."""
    text = _Text(path.file, path.shown, _encoding_of(path))
    try:
        first = next(iter(_Lines(text)), "")
        return _read(replace(text, bracketed=bool(_BRACKETED.fullmatch(first))))
    except csv.Error as error:
        raise ValueError(
            f"{path}: is not a table of numbers ({error}); save it as CSV in UTF-8."
        ) from error


def _read(path):
    header, names, separator, notes = _header(path)
    nameless = names == []
    if nameless:
        names = _places(path, header, separator)
    end = _cut_line(path, _Lines(path, header), len(names), separator)
    if end is not None:
        notes.append(CUT)
    lines = _Lines(path, header, end)
    columns = None
    first = next(iter(lines), None)
    if first is None:
        raise ValueError(f"{path}: only a header and no rows of data.")
    units = row_of_units(_split(first, separator), names)
    if units:
        lines = _Lines(path, lines.numbers[0], end)
        if next(iter(lines), None) is None:
            raise ValueError(f"{path}: only a header and no rows of data.")
    try:
        values = np.loadtxt(
            lines, delimiter=separator, comments=None, quotechar='"', ndmin=2
        )
    except ValueError as error:
        if str(error).startswith(f"{path}: "):
            raise
        values = None
    # In quotes a line may end where the row does not.
    if values is not None and values.shape == (len(lines.numbers), len(names)):
        columns = dict(zip(names, values.T))
    else:
        # Text, empty cells, decimal commas; or to say where the trouble is.
        columns = spread_lists(path, _cells(lines, names, separator))
    if "" in columns:
        notes.append(_left_out_index(path, columns, header))
    if path.encoding == _WINDOWS:
        notes.append("is not UTF-8, read as Windows text (cp1252), as Excel saves CSV.")
    return Table(
        path=path.shown,
        columns=columns,
        where=lines.where,
        units=units,
        nameless=nameless,
        notes=tuple(notes),
    )


def _cut_line(path, lines, n_columns, separator):
    """Return the number of the last line if the file ends within it, else None."""
    with path.file.open("rb") as file:
        file.seek(max(path.file.stat().st_size - 4, 0))
        if file.read().replace(b"\0", b"").endswith((b"\n", b"\r")):
            return None
    # Whole files may lack the end of the last line, too: of a whole cell the decimals
    # are as many as in one of the others.
    before, last, fewest = "", "", _LONGEST_LINE
    for line in lines:
        if last:
            fewest = min(fewest, _decimals(last, separator))
        before, last = last, line
    if len(lines.numbers) < _FEWEST:
        return None
    cells, usual = _split(last, separator), _split(before, separator)
    whole = len(cells) >= n_columns and bool(cells[-1]) >= bool(usual[-1])
    if _LIST.fullmatch(usual[-1]):
        return None if whole and _LIST.fullmatch(cells[-1]) else lines.numbers[-1]
    if whole and _decimals(last, separator) >= fewest:
        return None
    return lines.numbers[-1]


def _decimals(line, separator):
    """Count the decimals of the last cell of a line."""
    cell = line.rstrip().rpartition(separator or " ")[2]
    return len(cell.rpartition("." if separator == "," or "." in cell else ",")[2])


def _places(path, header, separator):
    """Return names for the columns of a table that has none, by the first row."""
    cells = _split(next(iter(_Lines(path, header))), separator)
    while cells and not cells[-1]:
        cells.pop()
    return [str(k + 1) for k in range(len(cells))]


def _left_out_index(path, columns, header):
    """Take out the first column, which has no name, if it counts rows; a note of it."""
    values = columns.pop("")
    counts = values.dtype.kind == "f" and np.array_equal(
        values - values[0], np.arange(values.size)
    )
    if not (counts and columns):
        raise ValueError(
            f"{path}: column 1 has no name in line {header + 1}; name it (t, q1, "
            "tau1, ...) or remove it."
        )
    return "the first column has no name and counts the rows: it is left out."


def row_of_units(cells, names):
    """Return units by column if the cells below the header are units, else {}."""
    cells = [cell.strip().strip("[]()").strip() for cell in cells]
    filled = [cell for cell in cells if cell not in ("", "-", "1")]
    if len(cells) != len(names) or any(_is_number(cell) for cell in filled):
        return {}
    if not any(is_unit(cell) for cell in filled) or max(map(len, filled)) > 12:
        return {}
    return {name: cell for name, cell in zip(names, cells) if cell not in ("", "-")}


def _header(path):
    """Return the header's line number, the column names, the separator and notes."""
    # No names: the table has none.
    before = first = None
    for k, line in _raw_lines(path):
        if _TOLD_SEPARATOR.fullmatch(line.strip()):
            continue
        if line.split("#", 1)[0].strip():
            first = k, line
            break
        if line.strip():
            before = k, line
    if first is None:
        raise ValueError(f"{path}: no rows of data; expected one row per sample.")
    echo = _echo_names(first[1])
    if echo:
        return first[0] - 1, echo, ",", []
    header, text = _below_preamble(path, first)
    cells = _numbers(text)
    if cells:
        # Numbers at once: the header may be the last comment before them.
        named = [] if before is None else _names_of(before[1])
        if len(named) != len(cells) or _numbers(named and before[1].lstrip(" #")):
            # Data frames without names count them in a header of their own.
            counts = cells == [str(k) for k in range(len(cells))] and len(cells) > 2
            return header - (not counts), [], _separator(text), []
        header, text = before
    text = text.strip().lstrip("#").split("#")[0]
    separator = _separator(text)
    names = [cell.strip("\"' ") for cell in _split(text, separator)]
    marks = [mark for mark in _OTHER_MARKS if mark in text]
    if text.strip() == "header:":
        raise ValueError(
            f"{path}: holds messages as topic echo shows them; write them one a line, "
            "ros2 topic echo --csv TOPIC > FILE.csv (rostopic echo -p), or record a bag"
        )
    if len(names) == 1 and marks:
        raise ValueError(
            f"{path}: line {header + 1} is one cell, with {marks[0]!r} in it; separate "
            "the columns by comma, semicolon, tab or blanks."
        )
    while names and not names[-1]:
        names.pop()
    seen = set()
    for k, name in enumerate(names):
        # A data frame is written with its index, whose column has no name.
        if not name and (k > 0 or len(names) == 1):
            raise ValueError(
                f"{path}: column {k + 1} has no name in line {header + 1}; name it "
                "(t, q1, tau1, ...) or remove it."
            )
        if name in seen:
            raise ValueError(
                f"{path}: line {header + 1} names column {quoted(name)} twice; each "
                "column needs its own name."
            )
        seen.add(name)
    notes = []
    if header > first[0] and before != (header, text):
        notes.append(f"the names of the columns are in line {header + 1}.")
    return header, names, separator, notes


def _names_of(comment):
    """Return the cells of a comment as names."""
    text = comment.strip().lstrip("#").split("#")[0]
    return _split(text, _separator(text.strip()))


def _numbers(text):
    """Return the cells of a line that holds nothing but numbers, else []."""
    separator = _separator(text or "")
    cells = _split(text or "", separator)
    while cells and not cells[-1]:
        cells.pop()
    if separator != ",":
        cells = [x.replace(",", ".", 1) for x in cells]
    return cells if all(map(_is_number, cells)) else []


def _echo_names(line):
    """Return names for the cells of a JointState by ``ros2 topic echo --csv``."""
    # It writes the values of a message one after another and no header (message_to_csv
    # in rosidl_runtime_py/convert.py of github.com/ros2/rosidl_runtime_py): the stamp,
    # the frame, names, positions, velocities and efforts. [] if the line is not one.
    cells = _split(line, ",")
    n, rest = divmod(len(cells) - 3, 4)
    if n < 1 or rest or not all(re.fullmatch(r"\d+", x) for x in cells[:2]):
        return []
    joints, numbers = cells[3 : 3 + n], cells[3 + n :]
    if any(map(_is_number, joints)) or not all(map(_is_number, numbers)):
        return []
    names = ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id"]
    for what in ("name", "position", "velocity", "effort"):
        names += [f"{what}_{k}" for k in range(n)]
    return names


def _below_preamble(path, first):
    """Return the line of names, below what an instrument says of itself."""
    # The first row of numbers tells how many cells it has: it is the last line before
    # them with as many, where the first line has another number.
    seen = []
    for k, line in _raw_lines(path):
        content = line.split("#", 1)[0]
        if not content.strip() or k < first[0]:
            continue
        separator = _separator(content)
        cells = _split(content, separator)
        numbers = [_is_number(x.replace(",", ".", 1)) for x in cells if x]
        if len(cells) > 1 and 2 * sum(numbers) > len(cells):
            break
        seen.append((k, line, len(cells), separator))
        if len(seen) > _LONGEST_PREAMBLE:
            return first
    else:
        return first
    if not seen or seen[0][2] == len(cells):
        return first
    fitting = [x for x in seen if x[2] == len(cells) and x[3] == separator]
    # A row of units stands between the names and the numbers.
    names = [
        x for x in fitting if not row_of_units(_split(x[1], x[3]), ["name"] * x[2])
    ]
    return names[-1][:2] if names else first


def _separator(line: str) -> str | None:
    """Guess the separator; None is white space."""
    for mark in _MARKS:
        if mark in line:
            return mark
    return None


def _split(line, separator):
    """Return the cells of a line; in quotes a separator is none."""
    line = line.split("#")[0].strip(" \r\n")
    if separator is None:
        cells = line.split()
    else:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return [cell.strip("\"' ") for cell in cells]


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell) is not None


def _cells(lines, names, separator):
    """Split every line by hand; a column is text if its first filled cell is."""
    columns = [array.array("d") for _ in names]
    known = [False] * len(names)
    for line in lines:
        cells = _split(line, separator)
        while len(cells) > len(names) and not cells[-1]:
            cells.pop()
        if len(cells) != len(names):
            raise ValueError(
                f"{lines.path}: {lines.where(-1)} has {len(cells)} cells, the header "
                f"names {len(names)} columns; "
                f"{_remedy(line, cells, names, separator)}."
            )
        for k, cell in enumerate(cells):
            if separator != "," and "." not in cell:
                cell = cell.replace(",", ".", 1)
            if cell and not known[k]:
                known[k] = True
                if not _is_number(cell):
                    columns[k] = [""] * len(columns[k])
            if isinstance(columns[k], list):
                columns[k].append(cell)
            elif not cell or _is_number(cell):
                columns[k].append(float(cell or "nan"))
            else:
                remedy = (
                    "write numbers without separators of thousands"
                    if _is_number(cell.replace(",", ""))
                    else "correct or remove that line"
                )
                raise ValueError(
                    f"{lines.path}: {quoted(cell)} in {lines.where(-1)}, column "
                    f"{quoted(names[k])} is not a number; {remedy}."
                )
    return {name: np.array(column) for name, column in zip(names, columns)}


def spread_lists(path, columns):
    """Give each entry of cells that are lists of numbers a column: q_0, q_1, ..."""
    found = {}
    for name, values in columns.items():
        lists = _lists(path, name, values)
        own = {f"{name}_{k}": x for k, x in enumerate(lists)} or {name: values}
        if found.keys() & own.keys():
            raise ValueError(
                f"{path}: column {quoted(name)} holds lists, whose entries have the "
                f"name of another column; rename it."
            )
        found |= own
    return found


def _lists(path, name, values):
    """Return the entries of cells that are lists of numbers; () for other cells."""
    first = _LIST.fullmatch(values[0]) if values.dtype.kind == "U" else None
    if not first or not all(map(_is_number, _entries(first))):
        return ()
    matches = [_LIST.fullmatch(cell) for cell in values]
    cells = [_entries(match) if match else [] for match in matches]
    if len({len(x) for x in cells}) > 1 or not all(
        _is_number(x) for row in cells for x in row
    ):
        raise ValueError(
            f"{path}: the cells of column {quoted(name)} are not lists of as many "
            "numbers; correct or remove those rows."
        )
    return np.array(cells, dtype=float).T


def _entries(match):
    return re.split(r"[\s,;]+", match[1].strip())


def _remedy(line, cells, names, separator):
    """Say what to do about a line with more or fewer cells than the header."""
    if len(cells) == 1 and _separator(line) != separator:
        return "separate the columns as the header does"
    if separator == "," and len(cells) > len(names):
        return "numbers with decimal commas need ; as separator"
    return "correct or remove that line"


# -- which characters the bytes are ----------------------------------------------------

# Nothing is guessed from how frequent letters are. A mark at the beginning (Excel's
# "Unicode text" has one) settles it; text without one is UTF-8 if all of it is. What is
# left may be a CSV file that Excel saved in Western Europe, with single bytes for
# degrees, micro and umlauts: code page 1252.

# Of marks that begin alike the longer one counts.
_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_WINDOWS = "cp1252"
# What that code page has a character for, control characters left out.
_CHARACTERS = bytes(
    k
    for k in range(256)
    if k in b"\t\n\r\f" or (k >= 32 and k not in b"\x7f\x81\x8d\x8f\x90\x9d")
)


def _encoding_of(path: Source) -> str:
    """Return the encoding of a text file; refuse what is not text in any of them."""
    content = path.file.read_bytes()
    marked = [name for mark, name in _BYTE_ORDER_MARKS if content.startswith(mark)]
    encoding = marked[0] if marked else "utf-8"
    try:
        content.decode(encoding.removesuffix("-sig"))
    except UnicodeDecodeError as error:
        if not marked and _is_windows(content):
            return _WINDOWS
        name = encoding.removesuffix("-sig").upper()
        raise ValueError(
            f"{path}: is not {name} ({error.reason} at byte {error.start}); save it as "
            "CSV in UTF-8."
        ) from error
    return encoding


def _is_windows(content):
    """Whether bytes that are not UTF-8 are text in the code page of Windows."""
    # A file with some characters in UTF-8 is damaged, not in another encoding: by
    # chance two letters of the code page make no such character.
    odd = content.translate(None, _CHARACTERS)
    return not odd and content.decode("utf-8", "ignore").isascii()


TEXT = Format(
    name="CSV (also .gz, .bz2, .xz)",
    endings=(".csv", ".tsv", ".txt", ".dat"),
    read=read_text,
)
