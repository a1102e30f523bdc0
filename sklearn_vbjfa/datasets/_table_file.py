"""Columns with names out of CSV, npz and parquet files."""

import csv
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
# What numpy lets through of a file that is no whole zip archive of arrays.
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
# Separators that are guessed, and others that a header in one piece may have.
_MARKS = (";", "\t", ",")
_OTHER_MARKS = ("|", ":", "/")


@dataclass(frozen=True, kw_only=True)
class Table:
    """Named columns of equal length.

    Attributes
    ----------
    path : Path
        Where they are from.
    columns : dict of str to ndarray of shape (n_rows,)
        Numbers, or text.
    scalars : dict of str to ndarray
        Arrays of one entry, or of none per row, that stand beside the columns.
    where : callable
        Turns a row (from 0) into words: a line of the file where it has lines.
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
    """Read the columns of a file; its ending tells the format.

    Parameters
    ----------
    path : str or os.PathLike
        CSV (also .tsv, .txt, .dat), npz or parquet.

    Returns
    -------
    Table
        At least one column and one row.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ImportError
        If a parquet file is to be read without pyarrow.
    ValueError
        If the file is not what its ending says, or holds no table.
    """
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


def _read_text(path: Path) -> Table:
    """Read text with a header line; blank lines and comments (#) are skipped."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: is no UTF-8 text ({error.reason} at byte {error.start}); save it "
            "as CSV in UTF-8."
        ) from error
    if any("\0" in line for line in lines):
        raise ValueError(f"{path}: is no text but binary; save it as CSV in UTF-8.")
    full = [k for k, line in enumerate(lines) if line.split("#")[0].strip()]
    if not full:
        raise ValueError(f"{path}: no rows of data; expected one row per sample.")
    header, names, separator = _header(path, lines, full)
    rows = [k for k in full if k > header]
    if not rows:
        raise ValueError(f"{path}: only a header and no rows of data.")
    try:
        values = np.loadtxt(
            [lines[k] for k in rows],
            delimiter=separator,
            comments="#",
            quotechar='"',
            ndmin=2,
        )
        columns = dict(zip(names, values.T))
        fast = values.shape[1] == len(names)
    except ValueError:
        fast = False
    if not fast:
        # Text, empty cells, decimal commas; or to say where the trouble is.
        columns = _cells(path, lines, rows, names, separator)
    return Table(
        path=path,
        columns=columns,
        scalars={},
        where=lambda row: f"line {rows[row] + 1}",
    )


def _header(path, lines, full):
    """Return the header's line number, the column names and the separator."""
    first = full[0]
    candidates = [first]
    if all(_is_number(cell) for cell in _split(lines[first], _separator(lines[first]))):
        # Numbers at once: the header may be the last comment before them.
        candidates = [k for k in range(first - 1, -1, -1) if lines[k].strip()][:1]
        if not candidates:
            raise ValueError(
                f"{path}: line {first + 1} holds numbers where the header should be; "
                "put column names such as t,q1,q2,tau1,tau2 in the first line."
            )
    header = candidates[0]
    text = lines[header].strip().lstrip("#").split("#")[0]
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
    for k, name in enumerate(names):
        if not name:
            raise ValueError(
                f"{path}: column {k + 1} has no name in line {header + 1}; name it "
                "(t, q1, tau1, ...) or remove it."
            )
        if name in names[:k]:
            raise ValueError(
                f"{path}: line {header + 1} names column {name!r} twice; each column "
                "needs its own name."
            )
    return header, names, separator


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
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _cells(path, lines, rows, names, separator):
    """Split every line by hand."""
    table = []
    for k in rows:
        cells = _split(lines[k], separator)
        while len(cells) > len(names) and not cells[-1]:
            cells.pop()
        if len(cells) != len(names):
            raise ValueError(
                f"{path}: line {k + 1} has {len(cells)} cells, the header names "
                f"{len(names)} columns; {_remedy(lines[k], cells, names, separator)}."
            )
        table.append(cells)
    return _typed(path, rows, names, table, separator)


def _remedy(line, cells, names, separator):
    """Say what to do about a line with more or fewer cells than the header."""
    if len(cells) == 1 and _separator(line) != separator:
        return "separate the columns as the header does"
    if separator == "," and len(cells) > len(names):
        return "numbers with decimal commas need ; as separator"
    return "correct or remove that line"


def _typed(path, rows, names, table, separator):
    """Turn columns of cells into numbers where the first cell is one."""
    columns = {}
    for name, cells in zip(names, zip(*table)):
        if separator != ",":
            cells = [cell.replace(",", ".", 1) for cell in cells]
        filled = [cell for cell in cells if cell]
        if filled and not _is_number(filled[0]):
            columns[name] = np.array(cells)
            continue
        values = np.full(len(cells), np.nan)
        for row, cell in enumerate(cells):
            if cell:
                if not _is_number(cell):
                    raise ValueError(
                        f"{path}: {cell!r} in line {rows[row] + 1}, column {name!r} is "
                        "no number; correct or remove that line."
                    )
                values[row] = float(cell)
        columns[name] = values
    return columns


# -- binary ----------------------------------------------------------------------------


def _read_npz(path: Path) -> Table:
    """Read arrays; a matrix such as q becomes the columns q1, q2, ..."""
    arrays = _arrays(path)
    lengths = {
        name: len(array)
        for name, array in arrays.items()
        if array.ndim > 0 and _is_channel(name)
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
    for name, array in arrays.items():
        if array.ndim == 0 or len(array) != n_rows:
            scalars[name] = array
        elif array.ndim == 1:
            columns[name] = array
        elif array.ndim == 2 and array.shape[1] == 1:
            columns[name] = array[:, 0]
        elif array.ndim == 2:
            columns.update({f"{name}{k + 1}": x for k, x in enumerate(array.T)})
        else:
            scalars[name] = array
    return Table(path=path, columns=columns, scalars=scalars, where=_row)


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of an npz file, which may be damaged."""
    broken = f"{path}: is no whole npz file; save it anew with numpy.savez."
    # numpy.load would read other formats under this name.
    if not zipfile.is_zipfile(path):
        raise ValueError(broken)
    arrays, name = {}, ""
    try:
        with np.load(path, allow_pickle=False) as archive:
            for name in archive.files:
                arrays[name] = archive[name]
    except MemoryError as error:
        raise ValueError(
            f"{path}: array {name!r} does not fit into memory or is damaged ({error}); "
            "save a shorter recording, or this one anew."
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
    """Whether a name begins like a position or a torque."""
    return name.lower().startswith(("q", "tau"))


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
