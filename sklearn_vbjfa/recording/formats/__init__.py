"""Formats of files, and how files are opened: unpacked, out of pipes."""

import bz2
import contextlib
import gzip
import io
import lzma
import sys
from pathlib import Path

from sklearn_vbjfa.recording._table import Table, check_size, listed, no_rows, parsing
from sklearn_vbjfa.recording.formats import _arrays
from sklearn_vbjfa.recording.formats._arrays import BAGS, INFO, bag_files, read_bag
from sklearn_vbjfa.recording.formats._text import read_sheet, read_text

# What a file may be, for refusals and the help of commands.
TABLES = (
    "CSV (also .gz, .bz2, .xz), Excel, npz, npy with named fields, MATLAB (to version "
    "7.2), parquet or JSON"
)
_KNOWN = f"{TABLES}, or a bag (.bag, .db3, .mcap)"
# Readers of the bytes of a file, which may be packed or a pipe, and of files.
_OF_BYTES = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat"), read_text),
    **dict.fromkeys((".json", ".jsonl", ".ndjson"), _arrays.read_json),
}
_OF_FILES = {
    **dict.fromkeys((".xlsx", ".xlsm", ".xlsb", ".xls", ".ods"), read_sheet),
    ".npz": _arrays.read_npz,
    ".npy": _arrays.read_npy,
    ".mat": _arrays.read_mat,
    **dict.fromkeys(_arrays.PARQUET, _arrays.read_parquet),
}
# How packed text begins, the module that unpacks it, and the endings of its files.
_PACKED = {b"\x1f\x8b": gzip, b"BZh": bz2, b"\xfd7zXZ\x00": lzma}
_PACKED_ENDINGS = (".gz", ".bz2", ".xz")
_CHUNK = 1 << 20
# Files that only the folder of one bag or data set has.
_MARKS = ("metadata.yaml", INFO)


def read_table(path, options) -> Table:
    """Read a file's columns, at least one and one row."""
    # path: file, folder of a bag or of a LeRobot data set, or "-" for standard input.
    ending = _ending(path)
    files = bag_files(path) if path.is_dir() else [path] * (ending in BAGS)
    if str(path) == "-":
        stream = getattr(sys.stdin, "buffer", sys.stdin)
        table = _read_stream(Path("standard input"), ".csv", stream)
    elif not path.exists():
        raise FileNotFoundError(
            f"{path}: no such file; expected a recording: {_KNOWN}."
        )
    elif files:
        table = read_bag(files, path, options.topic, options.joints)
    elif (path / INFO).is_file():
        table = _arrays.read_parquet(path)
    elif path.is_dir():
        names = sorted(x.name for x in path.iterdir() if not x.name.startswith("."))
        raise ValueError(
            f"{path}: is a folder without a recording: {_KNOWN}, or a LeRobot data set "
            f"({INFO}). It holds {listed(names) or 'nothing'}."
        )
    elif ending in _OF_BYTES or not path.is_file():
        # What is no file is a pipe of text.
        with path.open("rb") as stream:
            table = _read_stream(path, ending if path.is_file() else ".csv", stream)
    elif ending in _OF_FILES:
        table = _OF_FILES[ending](path)
    else:
        raise ValueError(
            f"{path}: unknown ending {ending!r}; save the recording as {_KNOWN}, or in "
            "Python by numpy.savez(FILE, t=t, q=q, tau=tau), or unpack it first"
        )
    if table.frame.empty:
        raise no_rows(path)
    return table.with_dates()


def _ending(path):
    """Return the ending of a file in small letters, that of packed text without .gz."""
    if path.suffix.lower() in _PACKED_ENDINGS:
        return path.with_suffix("").suffix.lower() or ".csv"
    return path.suffix.lower()


def _read_stream(path, ending, stream):
    """Read text, which may be packed."""
    content = _content(path, stream)
    module = next((x for mark, x in _PACKED.items() if content.startswith(mark)), None)
    if module is not None:
        with parsing(path, f"{module.__name__} file", "pack it again."):
            content = _content(path, module.open(io.BytesIO(content), "rb"))
    return _OF_BYTES[ending](path, content)


def _content(path, stream):
    """Return the bytes of a stream, as far as a recording may go."""
    content = io.BytesIO()
    while chunk := stream.read(_CHUNK):
        content.write(chunk)
        check_size(path, content.tell())
    return content.getvalue()


# -- folders ---------------------------------------------------------------------------


def expand(path):
    """Return a path in which ~ is the home folder; file:// may stand before it."""
    path = Path(str(path).removeprefix("file://"))
    with contextlib.suppress(RuntimeError):
        # Without such a user a file may be called so.
        path = path.expanduser()
    return path


def tables_in(path):
    """Return the tables of a folder without a format, in order."""
    return _tables(path) if path.is_dir() and not _is_one(path) else []


def recordings_in(path):
    """Return the tables, bags and data sets of a folder, or itself if it is one."""
    path = expand(path)
    if any((path / mark).is_file() for mark in _MARKS):
        return [path]
    return sorted([*_tables(path), *(x for x in path.iterdir() if _is_one(x))])


def _is_one(path):
    marks = (*_MARKS, *(f"*{ending}*" for ending in BAGS))
    return path.is_dir() and any(next(path.glob(mark), None) for mark in marks)


def _tables(path):
    known = {*_OF_BYTES, *_OF_FILES, *BAGS}
    files = [x for x in path.iterdir() if x.is_file() and not x.name.startswith(".")]
    return sorted(x for x in files if _ending(x) in known)
