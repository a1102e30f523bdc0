"""Columns with names out of CSV, npz and parquet files.

Text goes through numpy, or line by line where a cell is not a plain number, so that a
refusal names the line and the column. A reader of data frames would be no shorter: it
takes most damaged tables for good ones (short rows, names that come twice, decimal
commas between commas) and does not know the line that a row came from.
"""

import array
import csv
import re
import struct
import tokenize
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# Endings that are read as text with separators.
_TEXT = (".csv", ".tsv", ".txt", ".dat")
# What numpy raises on a file that is not a whole zip archive of arrays.
_BROKEN_ARCHIVE = (
    EOFError,
    OSError,
    OverflowError,
    RuntimeError,
    ValueError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
# Bytes of arrays in an archive: some hours of a robot at 1 kHz. What is read is copied.
_LARGEST_ARCHIVE = 1 << 30
# Separators that are guessed, and others that a header in one piece may have.
_MARKS = (";", "\t", ",")
_OTHER_MARKS = ("|", ":", "/")


@dataclass(frozen=True, kw_only=True)
class Table:
    """Named columns of equal length, numbers or text, out of a file.

    `scalars` are arrays of one entry, or of none per row, that stand beside the
    columns; `where` turns a row (from 0) into words: a line of the file where it has
    lines.
    """

    path: Path
    columns: dict[str, np.ndarray]
    scalars: dict[str, np.ndarray]
    where: Callable[[int], str]

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values())))


def read_table(path) -> Table:
    """Read a file's columns, at least one and one row; its ending tells the format."""
    path = Path(path)
    if path.is_dir():
        raise ValueError(f"{path} is a folder; give a CSV, npz or parquet file.")
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: no such file; expected a recording as CSV, npz or parquet."
        )
    ending = path.suffix.lower()
    if ending in _TEXT:
        try:
            table = _read_text(path)
        except csv.Error as error:
            raise ValueError(
                f"{path}: is no table of numbers ({error}); save it as CSV in UTF-8."
            ) from error
    elif ending == ".npz":
        table = _read_npz(path)
    elif ending in (".parquet", ".pq"):
        table = _read_parquet(path)
    else:
        raise ValueError(
            f"{path}: unknown ending {ending!r}; save the recording as .csv, .npz or "
            ".parquet."
        )
    if not table.columns or table.n_rows == 0:
        raise ValueError(f"{path}: no rows of data; expected one row per sample.")
    return table


def _row(row: int) -> str:
    return f"row {row + 1}"


# -- text ------------------------------------------------------------------------------

# A longer line is not a row of a table.
_LONGEST_LINE = 1 << 25
# float() takes more (1_000, digits of other scripts), which no logger writes.
_NUMBER = re.compile(
    r"[+-]?((\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|nan|inf(inity)?)", re.ASCII | re.I
)
# A cell of a spreadsheet, not the beginning of a comment.
_SHEET_ERROR = re.compile(r"#(N/A|DIV/0!|VALUE!|REF!|NAME\?|NUM!|NULL!)")


class _Lines:
    """Lines of data of a text file, without blank ones and comments.

    Iterating reads the file anew, line by line.
    """

    def __init__(self, path, header=-1):
        self.path = path
        self.header = header
        self.numbers = array.array("q")

    def __iter__(self):
        self.numbers = array.array("q")
        for k, line in _raw_lines(self.path):
            if k <= self.header:
                continue
            error = _SHEET_ERROR.search(line) if "#" in line else None
            if error:
                raise ValueError(
                    f"{self.path}: {error.group()!r} in line {k + 1} is no number; "
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
    try:
        with path.open(encoding="utf-8-sig") as file:
            k = 0
            while line := file.readline(_LONGEST_LINE):
                if "\0" in line:
                    raise ValueError(
                        f"{path}: is no text but binary; save it as CSV in UTF-8."
                    )
                if len(line) == _LONGEST_LINE:
                    raise ValueError(
                        f"{path}: line {k + 1} has more than {_LONGEST_LINE} "
                        "characters; expected one row per sample."
                    )
                yield k, line.rstrip("\n")
                k += 1
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: is no UTF-8 text ({error.reason} at byte {error.start}); save it "
            "as CSV in UTF-8."
        ) from error


def _read_text(path: Path) -> Table:
    """Read text with a header line; blank lines and comments (#) are skipped."""
    header, names, separator = _header(path)
    lines = _Lines(path, header)
    columns = None
    if next(iter(lines), None) is None:
        raise ValueError(f"{path}: only a header and no rows of data.")
    try:
        values = np.loadtxt(
            lines, delimiter=separator, comments=None, quotechar='"', ndmin=2
        )
    except UnicodeDecodeError:
        raise
    except ValueError as error:
        if str(error).startswith(f"{path}: "):
            raise
        values = None
    # In quotes a line may end where the row does not.
    if values is not None and values.shape == (len(lines.numbers), len(names)):
        columns = dict(zip(names, values.T))
    else:
        # Text, empty cells, decimal commas; or to say where the trouble is.
        columns = _cells(lines, names, separator)
    return Table(path=path, columns=columns, scalars={}, where=lines.where)


def _header(path):
    """Return the header's line number, the column names and the separator."""
    before = first = None
    for k, line in _raw_lines(path):
        if line.split("#", 1)[0].strip():
            first = k, line
            break
        if line.strip():
            before = k, line
    if first is None:
        raise ValueError(f"{path}: no rows of data; expected one row per sample.")
    header, text = first
    if all(_is_number(cell) for cell in _split(text, _separator(text))):
        # Numbers at once: the header may be the last comment before them.
        if before is None:
            raise ValueError(
                f"{path}: line {header + 1} holds numbers where the header should be; "
                "put column names such as t,q1,q2,tau1,tau2 in the first line."
            )
        header, text = before
    text = text.strip().lstrip("#").split("#")[0]
    separator = _separator(text)
    names = [cell.strip("\"' ") for cell in _split(text, separator)]
    marks = [mark for mark in _OTHER_MARKS if mark in text]
    if len(names) == 1 and marks:
        raise ValueError(
            f"{path}: line {header + 1} is one cell, with {marks[0]!r} in it; separate "
            "the columns by comma, semicolon, tab or blanks."
        )
    while names and not names[-1]:
        names.pop()
    seen = set()
    for k, name in enumerate(names):
        if not name:
            raise ValueError(
                f"{path}: column {k + 1} has no name in line {header + 1}; name it "
                "(t, q1, tau1, ...) or remove it."
            )
        if name in seen:
            raise ValueError(
                f"{path}: line {header + 1} names column {_short(name)} twice; each "
                "column needs its own name."
            )
        seen.add(name)
    return header, names, separator


def _short(text):
    """Quote a text, its beginning if it is long."""
    return repr(text if len(text) < 60 else f"{text[:57]}...")


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
            if separator != ",":
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
                raise ValueError(
                    f"{lines.path}: {_short(cell)} in {lines.where(-1)}, column "
                    f"{_short(names[k])} is no number; correct or remove that line."
                )
    return {name: np.array(column) for name, column in zip(names, columns)}


def _remedy(line, cells, names, separator):
    """Say what to do about a line with more or fewer cells than the header."""
    if len(cells) == 1 and _separator(line) != separator:
        return "separate the columns as the header does"
    if separator == "," and len(cells) > len(names):
        return "numbers with decimal commas need ; as separator"
    return "correct or remove that line"


# -- binary ----------------------------------------------------------------------------


def _read_npz(path: Path) -> Table:
    """Read arrays; a matrix such as q becomes the columns q1, q2, ..."""
    arrays = _arrays(path)
    lengths = {
        name: len(values)
        for name, values in arrays.items()
        if values.ndim > 0 and _is_channel(name)
    }
    if not lengths:
        raise ValueError(
            f"{path}: holds {', '.join(arrays) or 'nothing'}; expected arrays q and "
            "tau of shape (n_samples, n_joints), or columns q1, ..., tau1, ..."
        )
    n_rows = lengths.get("q", next(iter(lengths.values())))
    for name, length in lengths.items():
        if length != n_rows:
            raise ValueError(
                f"{path}: array {name!r} has {length} rows, others have {n_rows}; all "
                "channels need one row per sample."
            )
    columns, scalars = {}, {}
    for name, values in arrays.items():
        if values.ndim not in (1, 2) or len(values) != n_rows:
            scalars[name] = values
            continue
        if values.ndim == 1:
            own = {name: values}
        elif values.shape[1] == 1:
            own = {name: values[:, 0]}
        else:
            own = {f"{name}{k + 1}": x for k, x in enumerate(values.T)}
        twice = sorted(columns.keys() & own.keys())
        if twice:
            raise ValueError(
                f"{path}: column {twice[0]!r} is there twice, on its own and in a "
                "matrix; each needs its own name."
            )
        columns.update(own)
    return Table(path=path, columns=columns, scalars=scalars, where=_row)


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of an npz file, which may be damaged."""
    broken = f"{path}: is no whole npz file; save it anew with numpy.savez."
    # numpy.load would read other formats under this name.
    if not zipfile.is_zipfile(path):
        raise ValueError(broken)
    arrays, name = {}, ""
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > _LARGEST_ARCHIVE:
            raise MemoryError(f"{size / (1 << 30):.1f} GiB unpacked")
        with np.load(path, allow_pickle=False) as archive:
            for name in archive.files:
                arrays[name] = archive[name]
    except MemoryError as error:
        raise ValueError(
            f"{path}: is too large to be read at once, or damaged ({error}); save a "
            "shorter recording, or this one anew."
        ) from error
    except _BROKEN_ARCHIVE as error:
        if name and "allow_pickle" in str(error):
            raise ValueError(
                f"{path}: array {name!r} holds Python objects and not numbers; save "
                "numeric arrays of one row per sample with numpy.savez."
            ) from error
        raise ValueError(broken) from error
    # A zip archive of other files, such as a spreadsheet, yields bytes.
    if not all(isinstance(array, np.ndarray) for array in arrays.values()):
        raise ValueError(broken)
    return arrays


def _is_channel(name: str) -> bool:
    """Whether a name is one of a channel, which has a value for every row."""
    name = name.lower()
    own = re.fullmatch(r"t|segment|[va]([_.\[(]?\d+[\])]?)?", name)
    return own is not None or name.startswith(("q", "tau"))


def _read_parquet(path: Path) -> Table:
    """Read a parquet file with pyarrow."""
    try:
        from pyarrow import ArrowException, parquet
    except ImportError as error:
        raise ImportError(
            f"{path}: parquet files need pyarrow, which is not installed: "
            'pip install "sklearn-vbjfa[parquet]"'
        ) from error
    try:
        with parquet.ParquetFile(path) as file:
            read = file.read()
        arrays = [column.to_numpy() for column in read.columns]
    except (ArrowException, OSError, UnicodeDecodeError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise ValueError(
            f"{path}: is no whole parquet file of plain columns ({reason}); write it "
            "anew."
        ) from error
    twice = [name for name, count in Counter(read.column_names).items() if count > 1]
    if twice:
        raise ValueError(
            f"{path}: has column {twice[0]!r} twice; each column needs its own name."
        )
    columns = dict(zip(read.column_names, arrays))
    return Table(path=path, columns=columns, scalars={}, where=_row)
