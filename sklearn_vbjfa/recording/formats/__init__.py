"""Formats of files, and how files are opened: unpacked, out of pipes."""

import bz2
import contextlib
import gzip
import lzma
import shlex
import sys
import tempfile
from pathlib import Path

from sklearn_vbjfa.recording._table import (
    Source,
    Table,
    check_size,
    listed,
    no_rows,
    parsing,
)
from sklearn_vbjfa.recording.formats import _arrays
from sklearn_vbjfa.recording.formats._arrays import BAGS, bag_files, read_bag
from sklearn_vbjfa.recording.formats._text import read_sheet, read_text

# What a file may be, for the help of commands.
TABLES = (
    "CSV (also .gz, .bz2, .xz), Excel, npz, npy with named fields, MATLAB (to version "
    "7.2), parquet or JSON"
)
_KNOWN = (
    ".csv, .xlsx, .npz, .npy, .mat, .parquet, .json, .jsonl, .bag, .db3 or .mcap (text "
    "also with .gz, .bz2 or .xz)"
)
_TEXT = (".csv", ".tsv", ".txt", ".dat")
_READERS = {
    **dict.fromkeys(_TEXT, read_text),
    **dict.fromkeys((".xlsx", ".xlsm", ".xlsb", ".xls", ".ods"), read_sheet),
    ".npz": _arrays.read_npz,
    ".npy": _arrays.read_npy,
    ".mat": _arrays.read_mat,
    **dict.fromkeys(_arrays.PARQUET, _arrays.read_parquet),
    **dict.fromkeys((".json", ".jsonl", ".ndjson"), _arrays.read_json),
}
# Modules by which packed files are opened.
_OPEN = {".gz": gzip, ".bz2": bz2, ".xz": lzma, ".lzma": lzma}
# How packed files begin, and the ending that they would have.
_PACKED = {b"\x1f\x8b": ".gz", b"BZh": ".bz2", b"\xfd7zXZ\x00": ".xz"}
# Files that only the folder of one bag or data set has.
_MARKS = ("metadata.yaml", "meta/info.json")
_CHUNK = 1 << 20


def read_table(path, topic=None, joints=lambda: ()) -> Table:
    """Read a file's columns, at least one and one row."""
    # path: file, folder of a bag or of a LeRobot data set, or "-" for standard input;
    # topic: topic of a bag; joints: function that returns the robot's joints.
    path = expanded(path)
    with contextlib.ExitStack() as stack:
        files = bag_files(path) if path.is_dir() else []
        if files:
            table = read_bag(files, path, topic, joints())
        elif path.is_dir():
            table = _read_folder(path)
        else:
            table = _read_file(_source(stack, path), topic, joints)
    if table.frame.empty:
        raise no_rows(path)
    return table


def _read_folder(path):
    """Read the folder of a LeRobot data set."""
    if (path / "meta" / "info.json").is_file():
        return _arrays.read_lerobot(path)
    names = sorted(x.name for x in path.iterdir() if not x.name.startswith("."))
    raise ValueError(
        f"{path}: is a folder; give a file, or the folder of a bag (.db3, .mcap) or of "
        f"a LeRobot data set (meta/info.json). It holds {listed(names) or 'nothing'}."
    )


def _read_file(source, topic, joints):
    """Read a file that is not packed, by its ending."""
    ending = source.file.suffix.lower()
    if ending in BAGS:
        return read_bag([source.file], source.shown, topic, joints())
    if ending in _READERS:
        return _READERS[ending](source)
    remedy = "or in Python by numpy.savez(FILE, t=t, q=q, tau=tau)"
    if ending == ".zip":
        remedy = f"or unpack it first: unzip {shlex.quote(str(source))}"
    raise ValueError(
        f"{source}: unknown ending {ending!r}; save the recording as {_KNOWN}, {remedy}"
    )


# -- folders ---------------------------------------------------------------------------


def expanded(path):
    """Return a path in which ~ is the home folder; file:// may stand before it."""
    path = Path(str(path).removeprefix("file://"))
    with contextlib.suppress(RuntimeError):
        # Without such a user a file may be called so.
        path = path.expanduser()
    return path


def tables_in(path):
    """Return the tables of a folder without a format, in order."""
    path = expanded(path)
    return _tables(path) if path.is_dir() and not _is_one(path) else []


def recordings_in(path):
    """Return the tables, bags and data sets of a folder, or itself if it is one."""
    path = expanded(path)
    if any((path / mark).is_file() for mark in _MARKS):
        return [path]
    folders = [x for x in path.iterdir() if x.is_dir() and _is_one(x)]
    return sorted([*_tables(path), *folders])


def _is_one(path):
    marks = (*_MARKS, *(f"*{ending}*" for ending in BAGS))
    return any(next(path.glob(mark), None) for mark in marks)


def _tables(path):
    found = []
    for file in sorted(path.iterdir()):
        endings = [x.lower() for x in file.suffixes[-2:]]
        if endings and endings[-1] in _OPEN:
            endings.pop()
        known = endings and (endings[-1] in _READERS or endings[-1] in BAGS)
        if known and file.is_file() and not file.name.startswith("."):
            found.append(file)
    return found


# -- pipes and packed files ------------------------------------------------------------


def _source(stack, path):
    """Return the file to read: itself, unpacked, or the content of a pipe."""
    source = Source(path, path)
    if str(path) == "-" or (path.exists() and not path.is_file()):
        source = _from_pipe(stack, path)
    elif not path.is_file():
        raise FileNotFoundError(
            f"{path}: no such file; expected a recording: {_KNOWN}."
        )
    ending = source.file.suffix.lower()
    if ending in _TEXT:
        # Packed text may have lost its ending.
        ending = _ending_of(source.file)
    return _unpacked(stack, source, ending) if ending in _OPEN else source


def _from_pipe(stack, path):
    """Copy a pipe of text to a file whose ending tells whether it is packed."""
    shown, stream = Path("standard input"), getattr(sys.stdin, "buffer", sys.stdin)
    if str(path) != "-":
        shown, stream = path, stack.enter_context(path.open("rb"))
    file = _folder(stack) / "recording"
    _copy(stream, file, shown)
    if not file.stat().st_size:
        raise ValueError(f"{shown}: is empty; expected a recording: {_KNOWN}.")
    return Source(file.rename(file.with_suffix(_ending_of(file))), shown)


def _folder(stack):
    return Path(stack.enter_context(tempfile.TemporaryDirectory()))


def _ending_of(file):
    """Return the ending that packed text should have, from its first bytes."""
    with file.open("rb") as opened:
        begin = opened.read(16)
    return next((x for mark, x in _PACKED.items() if begin.startswith(mark)), ".csv")


def _unpacked(stack, source, ending):
    """Unpack a file into one that is deleted afterwards."""
    name = source.file.name
    if source.file.suffix.lower() not in _TEXT:
        name = name.removesuffix(source.file.suffix) or "recording"
    file, module = _folder(stack) / name, _OPEN[ending]
    with (
        parsing(source, f"{ending[1:]} file", "pack it again."),
        module.open(source.file, "rb") as stream,
    ):
        _copy(stream, file, source.shown)
    if not file.suffix:
        file = file.rename(file.with_suffix(_ending_of(file)))
    return Source(file, source.shown)


def _copy(stream, file, shown):
    """Copy a stream, as far as a recording may go."""
    size = 0
    with file.open("wb") as target:
        while chunk := stream.read(_CHUNK):
            size += len(chunk)
            check_size(shown, size, "give a shorter recording", "or more")
            target.write(chunk)
