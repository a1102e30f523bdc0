"""File formats, and opening of files, compressed files and pipes."""

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

# Supported formats, for error messages and the help of commands.
TABLES = (
    "CSV (also .gz, .bz2, .xz), Excel, npz, npy with named fields, MATLAB (to version "
    "7.2), parquet or JSON"
)
_FORMATS = f"{TABLES}, or a bag (.bag, .db3, .mcap)"
# Readers of file contents (files may be compressed, or pipes), and readers of files.
_BYTE_READERS = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".log"), read_text),
    **dict.fromkeys((".json", ".jsonl", ".ndjson"), _arrays.read_json),
}
_FILE_READERS = {
    **dict.fromkeys((".xlsx", ".xlsm", ".xlsb", ".xls", ".ods"), read_sheet),
    ".npz": _arrays.read_npz,
    ".npy": _arrays.read_npy,
    ".mat": _arrays.read_mat,
    **dict.fromkeys(_arrays.PARQUET, _arrays.read_parquet),
}
# Magic numbers of compressed files with their modules, and the suffixes of such files.
_CODECS = {b"\x1f\x8b": gzip, b"BZh": bz2, b"\xfd7zXZ\x00": lzma}
_PACKED_SUFFIXES = (".gz", ".bz2", ".xz")
_CHUNK = 1 << 20


def read_table(path, topic) -> Table:
    """Read the table of a file; raise an error if it is empty."""
    # path: file, folder of a bag or of a LeRobot data set, or "-" for standard input.
    suffix = _suffix(path)
    files = bag_files(path) if path.is_dir() else [path] * (suffix in BAGS)
    if str(path) == "-":
        stream = getattr(sys.stdin, "buffer", sys.stdin)
        table = _read_stream(Path("standard input"), ".csv", stream)
    elif not path.exists():
        raise FileNotFoundError(
            f"{path}: no such file; expected a recording: {_FORMATS}."
        )
    elif files:
        table = read_bag(files, path, topic)
    elif (path / INFO).is_file():
        table = _arrays.read_parquet(path)
    elif path.is_dir():
        names = sorted(x.name for x in path.iterdir() if not x.name.startswith("."))
        raise ValueError(
            f"{path}: is a folder without a recording: {_FORMATS}, or a LeRobot data "
            f"set ({INFO}). It holds {listed(names) or 'nothing'}."
        )
    elif suffix in _BYTE_READERS or not path.is_file():
        # A path that is not a regular file is a pipe of text.
        with path.open("rb") as stream:
            table = _read_stream(path, suffix if path.is_file() else ".csv", stream)
    elif suffix in _FILE_READERS:
        table = _FILE_READERS[suffix](path)
    else:
        raise ValueError(
            f"{path}: unknown ending {suffix!r}; save the recording as {_FORMATS}, or "
            "in Python by numpy.savez(FILE, t=t, q=q, tau=tau), or unpack it first"
        )
    if table.frame.empty:
        raise no_rows(path)
    return table.with_dates()


def _suffix(path):
    """Return the suffix of a file in lower case, without that of compression."""
    if path.suffix.lower() in _PACKED_SUFFIXES:
        return path.with_suffix("").suffix.lower() or ".csv"
    return path.suffix.lower()


def _read_stream(path, suffix, stream):
    """Read text, which may be compressed."""
    content = _read_bytes(path, stream)
    module = next((x for mark, x in _CODECS.items() if content.startswith(mark)), None)
    if module is not None:
        with parsing(path, f"{module.__name__} file", "pack it again."):
            content = _read_bytes(path, module.open(io.BytesIO(content), "rb"))
    return _BYTE_READERS[suffix](path, content)


def _read_bytes(path, stream):
    """Return the bytes of a stream, up to the maximum size of a recording."""
    content = io.BytesIO()
    while chunk := stream.read(_CHUNK):
        content.write(chunk)
        check_size(path, content.tell())
    return content.getvalue()


def expand(path):
    """Return a path with ~ expanded and a leading file:// removed."""
    path = Path(str(path).removeprefix("file://"))
    with contextlib.suppress(RuntimeError):
        # If there is no such user, the name is that of a file.
        path = path.expanduser()
    return path


def tables_in(path):
    """Return the table files of a folder, [] for a bag, a data set or a file."""
    return _tables(path) if path.is_dir() and not _is_recording(path) else []


def recordings_in(path):
    """Return the tables, bags and data sets in a folder, or the folder if it is one."""
    path = expand(path)
    if any((path / marker).is_file() for marker in ("metadata.yaml", INFO)):
        return [path]
    return sorted([*_tables(path), *(x for x in path.iterdir() if _is_recording(x))])


def _is_recording(path):
    return path.is_dir() and ((path / INFO).is_file() or bool(bag_files(path)))


def _tables(path):
    suffixes = {*_BYTE_READERS, *_FILE_READERS, *BAGS}
    files = [x for x in path.iterdir() if x.is_file() and not x.name.startswith(".")]
    tables = sorted(x for x in files if _suffix(x) in suffixes)
    # Logs among tables are those of programs.
    return [x for x in tables if _suffix(x) != ".log"] or tables
