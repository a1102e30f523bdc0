"""Formats of files, and how files are opened: unpacked, out of pipes."""

import bz2
import contextlib
import functools
import gzip
import importlib
import lzma
import shlex
import sys
import tempfile
from pathlib import Path

from sklearn_vbjfa.recording import _table
from sklearn_vbjfa.recording._table import Source, Table, Wanted, listed, parsing
from sklearn_vbjfa.recording.formats._arrays import JSON, MATLAB, NPY, NPZ
from sklearn_vbjfa.recording.formats._bags import BAG
from sklearn_vbjfa.recording.formats._cells import SHEET
from sklearn_vbjfa.recording.formats._parquet import PARQUET
from sklearn_vbjfa.recording.formats._text import TEXT

# In the order in which lists name them, bags last.
FORMATS = (TEXT, SHEET, NPZ, NPY, MATLAB, PARQUET, JSON, BAG)


def _alternatives(words):
    """List words as a choice: "a, b or c"."""
    return f"{', '.join(words[:-1])} or {words[-1]}"


_BY_ENDING = {ending: x for x in FORMATS for ending in x.endings}
_KNOWN = (
    f"{_alternatives([x for y in FORMATS for x in y.shown or y.endings[:1]])} (text "
    "also with .gz, .bz2, .xz or .zst)"
)
# What a file may be, and what reads it, for docstrings and the help of commands.
TABLES = _alternatives([x.name for x in FORMATS if not x.has_topics])
PACKAGES = _alternatives([x.needs[0] for x in FORMATS if x.needs])
# What only folders have that are one bag or one data set.
_MARKS = tuple(mark for one in FORMATS for mark in one.marks)

# Modules by which packed files are opened.
_OPEN = {".gz": gzip, ".bz2": bz2, ".xz": lzma, ".lzma": lzma, ".zst": None}
_OPEN |= {".zstd": None}
# What unpacks other files, and how to make a recording of what is not read here.
_OTHER_PACKERS = {".zip": "unzip", ".7z": "7z x", ".rar": "unrar x", ".lz4": "lz4 -d"}
_OTHER_PACKERS |= {".tar": "tar xf", ".tgz": "tar xf"}
_ADVICE = dict.fromkeys(
    (".yaml", ".yml"),
    "of a topic, write ros2 topic echo --csv TOPIC > FILE.csv, or record a bag",
)
_ADVICE |= dict.fromkeys(
    (".h5", ".hdf5", ".pkl", ".pickle"),
    "read it in Python, where it is safe, and write numpy.savez(FILE, t=t, q=q, "
    "tau=tau)",
)
# How files begin, and the ending that they would have.
_PACKED = (
    (b"\x1f\x8b", ".gz"),
    (b"BZh", ".bz2"),
    (b"\xfd7zXZ\x00", ".xz"),
    (b"\x28\xb5\x2f\xfd", ".zst"),
)
_MAGIC = (*_PACKED, *(begin for x in FORMATS for begin in x.begins))
_CHUNK = 1 << 20


def read_table(path, topic=None, joints=lambda: (), commanded=False) -> Table:
    """Read a file's columns, at least one and one row."""
    # path: file, folder of a bag or of a LeRobot data set, or "-" for standard input;
    # topic: topic of a bag; joints: function that returns the robot's joints;
    # commanded: whether commanded positions are needed.
    wanted = Wanted(topic=topic, joints=joints, commanded=commanded)
    path = expanded(path)
    with contextlib.ExitStack() as stack:
        read = _read_folder if path.is_dir() else _read_file
        table = read(stack, path, wanted)
    if table.frame.empty:
        raise _table.no_rows(path)
    return table


def expanded(path):
    """Return a path in which ~ is the home folder; file:// may stand before it."""
    path = Path(str(path).removeprefix("file://"))
    try:
        return path.expanduser()
    except RuntimeError:
        # There is no such user; a file may be called so.
        return path


# -- folders ---------------------------------------------------------------------------


def tables_in(path):
    """Return the tables of a folder without a format, in order."""
    path = expanded(path)
    return _tables(path) if path.is_dir() and not _is_one(path, _MARKS) else []


def recordings_in(path):
    """Return the tables, bags and data sets of a folder, or itself if it is one."""
    path = expanded(path)
    if _is_one(path, [mark for mark in _MARKS if "*" not in mark]):
        return [path]
    folders = [x for x in path.iterdir() if x.is_dir() and _is_one(x, _MARKS)]
    return sorted([*_tables(path), *folders])


def _is_one(path, marks):
    """Whether a folder has one of some marks."""
    return any(next(path.glob(mark), None) for mark in marks)


def _tables(path):
    """Return the files of a folder that have the ending of a format, in order."""
    found = []
    for file in sorted(path.iterdir()):
        endings = [x.lower() for x in file.suffixes[-2:]]
        if endings and endings[-1] in _OPEN:
            endings.pop()
        known = _BY_ENDING.get(endings[-1]) if endings else None
        if known and file.is_file() and not file.name.startswith("."):
            found.append(file)
    return found


def _read_folder(stack, path, wanted):
    """Read the folder of a bag or of a LeRobot data set."""
    for one in FORMATS:
        if one.read_folder is not None:
            unpacked = functools.partial(_unpacked, stack)
            table = one.read_folder(path, wanted, unpacked)
            if table is not None:
                _check_topic(path, one, wanted)
                return table
    names = sorted(x.name for x in path.iterdir() if not x.name.startswith("."))
    raise ValueError(
        f"{path}: is a folder; give a file, or the folder of a bag (.db3, .mcap) or of "
        f"a LeRobot data set (meta/info.json). It holds {listed(names) or 'nothing'}."
    )


# -- files -----------------------------------------------------------------------------


def _read_file(stack, path, wanted):
    source = Source(path, path)
    if str(path) == "-" or (path.exists() and not path.is_file()):
        source = _from_pipe(stack, path)
    elif not path.is_file():
        raise FileNotFoundError(
            f"{path}: no such file; expected a recording: {_KNOWN}."
        )
    ending = source.file.suffix.lower()
    if ending in TEXT.endings:
        # Packed text may have lost its ending.
        begin = _begin(source.file)
        ending = next((x for mark, x in _PACKED if begin.startswith(mark)), ending)
    if ending in _OPEN:
        source = _unpacked(stack, source, ending)
        ending = source.file.suffix.lower()
    if ending in _OTHER_PACKERS:
        raise ValueError(
            f"{source}: is packed as {ending[1:]}, expected {_KNOWN}; unpack it first: "
            f"{_OTHER_PACKERS[ending]} {shlex.quote(str(source))}"
        )
    found = _BY_ENDING.get(ending)
    _check_topic(source, found, wanted)
    if found is None:
        advice = _ADVICE.get(ending, "")
        raise ValueError(
            f"{source}: unknown ending {ending!r}; save the recording as {_KNOWN}"
            f"{f'; {advice}' if advice else '.'}"
        )
    return found.read(source, wanted)


def _check_topic(path, found, wanted):
    """Refuse a topic of what has none."""
    if wanted.topic is not None and not (found and found.has_topics):
        raise ValueError(
            f"{path}: is not a bag, so it has no topic {wanted.topic!r}; leave out "
            "the topic, or give a .bag, .db3 or .mcap file."
        )


def _from_pipe(stack, path):
    """Copy a pipe to a file whose ending tells what it is."""
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


def _begin(file):
    with file.open("rb") as opened:
        return opened.read(64)


def _ending_of(file):
    """Return the ending that a file should have, from its first bytes."""
    begin = _begin(file)
    if begin.startswith(b"PK\x03\x04"):
        return ".xlsx" if b"xl/" in file.read_bytes()[:4096] else ".npz"
    return next((x for mark, x in _MAGIC if begin.startswith(mark)), ".csv")


def _unpacked(stack, source, ending):
    """Unpack a file into one that is deleted afterwards."""
    name = source.file.name
    if source.file.suffix.lower() not in TEXT.endings:
        name = name.removesuffix(source.file.suffix) or "recording"
    file, module = _folder(stack) / name, _OPEN[ending] or _zstandard(source)
    with (
        parsing(source, f"{ending[1:]} file", "pack it again"),
        module.open(source.file, "rb") as stream,
    ):
        _copy(stream, file, source.shown)
    if not file.suffix:
        file = file.rename(file.with_suffix(_ending_of(file)))
    return Source(file, source.shown)


def _zstandard(source):
    """Return the module of Zstandard, which Python has from 3.14 on."""
    for name in ("compression.zstd", "backports.zstd"):
        with contextlib.suppress(ImportError):
            return importlib.import_module(name)
    raise ImportError(
        f"{source}: Zstandard comes with Python 3.14 or a package: pip install "
        f"backports.zstd; or unpack it first: zstd -d {shlex.quote(str(source))}"
    )


def _copy(stream, file, shown):
    """Copy a stream, as far as a recording may go."""
    size = 0
    with file.open("wb") as target:
        while chunk := stream.read(_CHUNK):
            size += len(chunk)
            remedy = "give a shorter recording"
            _table.check_size(shown, size, remedy, "or more")
            target.write(chunk)
