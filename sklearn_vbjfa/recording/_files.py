"""Files of recordings: which format they have, unpacked, out of pipes.

The ending tells the format, or the first bytes where there is none, as in a pipe.
"""

import bz2
import contextlib
import gzip
import lzma
import re
import shlex
import sys
import tempfile
import zlib
from pathlib import Path

from sklearn_vbjfa.recording import _arrays, _bags, _parquet, _sheets, _text
from sklearn_vbjfa.recording._quoting import listed
from sklearn_vbjfa.recording._table import LARGEST, Source, Table

# Endings that are read as text with separators.
_TEXT = (".csv", ".tsv", ".txt", ".dat")


def _zstandard(source):
    """Return the module of Zstandard, which Python has from 3.14 on."""
    try:
        from compression import zstd
    except ImportError:
        try:
            from backports import zstd
        except ImportError as error:
            raise ImportError(
                f"{source}: Zstandard comes with Python 3.14 or the extra bags: "
                'pip install "sklearn-vbjfa[bags]"; or unpack it first: zstd -d '
                f"{shlex.quote(str(source))}"
            ) from error
    return zstd


_OPEN = {
    ".gz": gzip.open,
    ".bz2": bz2.open,
    ".xz": lzma.open,
    ".lzma": lzma.open,
}
_OTHER_PACKERS = {
    ".lz4": "lz4 -d",
    ".zip": "unzip",
    ".7z": "7z x",
    ".rar": "unrar x",
    ".tar": "tar xf",
    ".tgz": "tar xf",
}
# How to make a recording of what is not read here.
_ADVICE = {
    **dict.fromkeys(
        (".yaml", ".yml"),
        "of a topic, write ros2 topic echo --csv TOPIC > FILE.csv, or record a bag",
    ),
    **dict.fromkeys(
        (".json", ".jsonl", ".h5", ".hdf5", ".feather", ".arrow", ".pkl", ".pickle"),
        "read it in Python, where it is safe, and write numpy.savez(FILE, t=t, q=q, "
        "tau=tau)",
    ),
}
_READERS = {
    **dict.fromkeys(_TEXT, _text.read_text),
    **dict.fromkeys(_sheets.ENDINGS, _sheets.read_sheet),
    ".npz": _arrays.read_npz,
    ".npy": _arrays.read_npy,
    ".mat": _arrays.read_mat,
    ".parquet": _parquet.read_parquet,
    ".pq": _parquet.read_parquet,
}
_KNOWN = (
    ".csv, .xlsx, .npz, .npy, .mat, .parquet, .bag, .db3 or .mcap (text also with .gz, "
    ".bz2, .xz or .zst behind)"
)
_ZSTANDARD = (".zst", ".zstd")
# How files begin, and the ending that they would have.
_MAGIC = (
    (b"\x1f\x8b", ".gz"),
    (b"BZh", ".bz2"),
    (b"\xfd7zXZ\x00", ".xz"),
    (b"\x28\xb5\x2f\xfd", ".zst"),
    (b"\x93NUMPY", ".npy"),
    (b"PAR1", ".parquet"),
    (b"SQLite format 3\x00", ".db3"),
    (b"\x89MCAP0\r\n", ".mcap"),
    (b"#ROSBAG V", ".bag"),
    (b"MATLAB 5.0", ".mat"),
    (b"\xd0\xcf\x11\xe0", ".xls"),
)
_CHUNK = 1 << 20


def read_table(path, topic=None, wanted=lambda: ()) -> Table:
    """Read a file's columns, at least one and one row."""
    # path: file, folder of a bag or of a LeRobot data set, or "-" for standard input;
    # topic: topic of a bag; wanted: function that returns the robot's joints.
    path = expanded(path)
    with contextlib.ExitStack() as stack:
        if path.is_dir():
            table = _read_folder(stack, path, topic, wanted)
        else:
            table = _read_file(stack, path, topic, wanted)
    if not table.columns or table.n_rows == 0:
        raise ValueError(f"{path}: no rows of data; expected one row per sample.")
    return table


def expanded(path):
    """Return a path in which ~ is the home folder."""
    path = Path(path)
    try:
        return path.expanduser()
    except RuntimeError:
        # There is no such user; a file may be called so.
        return path


def _read_folder(stack, path, topic, wanted):
    """Read the folder of a bag or of a LeRobot data set."""
    if _parquet.is_lerobot(path):
        _refuse_topic(path, topic)
        return _parquet.read_lerobot(Source(path, path))
    if _packs_messages(path):
        return _bags.read_bag([Source(path, path)], path, topic, wanted())
    for ending in _bags.ENDINGS:
        files = sorted(path.glob(f"*{ending}"))
        sources = [Source(file, path) for file in files]
        for packed in sorted(path.glob(f"*{ending}.zst*")):
            sources.append(_unpacked(stack, Source(packed, path), packed.suffix))
        if sources:
            return _bags.read_bag(sources, path, topic, wanted())
    names = sorted(x.name for x in path.iterdir() if not x.name.startswith("."))
    for name in names:
        stem, _, ending = name.rpartition(".")
        if f".{ending}" in _OTHER_PACKERS and stem.endswith(_bags.ENDINGS):
            raise _packed(path / name, f".{ending}")
    raise ValueError(
        f"{path}: is a folder; give a file, or the folder of a bag (.db3, .mcap) or of "
        f"a LeRobot data set (meta/info.json). It holds {listed(names) or 'nothing'}."
    )


def _packs_messages(folder):
    """Whether the description of a bag says that each message is packed."""
    try:
        text = (folder / "metadata.yaml").read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    mode = re.search(r"compression_mode:\s*[\"']?(\w+)", text)
    return mode is not None and mode[1].lower() == "message"


def _read_file(stack, path, topic, wanted):
    source = Source(path, path)
    if str(path) == "-" or (path.exists() and not path.is_file()):
        source = _from_pipe(stack, path)
    elif not path.is_file():
        raise FileNotFoundError(
            f"{path}: no such file; expected a recording: {_KNOWN}."
        )
    ending = source.file.suffix.lower()
    if ending in _OPEN or ending in _ZSTANDARD:
        source = _unpacked(stack, source, ending)
        ending = source.file.suffix.lower()
    if ending in _OTHER_PACKERS:
        raise _packed(source, ending)
    if ending in _bags.ENDINGS:
        if _packs_messages(path.parent):
            source = Source(path.parent, path)
        return _bags.read_bag([source], source.shown, topic, wanted())
    _refuse_topic(source, topic)
    if ending not in _READERS:
        advice = _ADVICE.get(ending, "")
        raise ValueError(
            f"{source}: unknown ending {ending!r}; save the recording as {_KNOWN}"
            f"{f'; {advice}' if advice else '.'}"
        )
    return _READERS[ending](source)


def _refuse_topic(path, topic):
    if topic is not None:
        raise ValueError(
            f"{path}: is no bag, so that it has no topic {topic!r}; leave out the "
            "topic, or give a .bag, .db3 or .mcap file."
        )


def _packed(path, ending):
    command = f"{_OTHER_PACKERS[ending]} {shlex.quote(str(path))}"
    return ValueError(
        f"{path}: is packed as {ending[1:]}, expected {_KNOWN}; unpack it first: "
        f"{command}"
    )


def _from_pipe(stack, path):
    """Copy a pipe to a file whose ending tells what it is."""
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    shown = Path("standard input") if str(path) == "-" else path
    if str(path) == "-":
        stream = getattr(sys.stdin, "buffer", sys.stdin)
    else:
        stream = stack.enter_context(path.open("rb"))
    file = folder / "recording"
    _copy(stream, file, shown)
    with file.open("rb") as opened:
        begin = opened.read(64)
    if not begin:
        raise ValueError(f"{shown}: is empty; expected a recording: {_KNOWN}.")
    return Source(file.rename(file.with_suffix(_ending_of(file, begin))), shown)


def _ending_of(file, begin):
    """Return the ending that a file should have, from its first bytes."""
    for magic, ending in _MAGIC:
        if begin.startswith(magic):
            return ending
    if begin.startswith(b"PK\x03\x04"):
        return ".xlsx" if b"xl/" in file.read_bytes()[:4096] else ".npz"
    return ".csv"


def _unpacked(stack, source, ending):
    """Unpack a file into one that is deleted afterwards."""
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    inner = Path(source.file.name).with_suffix("")
    file = folder / (inner.name or "recording")
    broken = (OSError, EOFError, lzma.LZMAError, zlib.error)
    if ending in _ZSTANDARD:
        module = _zstandard(source)
        opened, broken = module.open, (*broken, module.ZstdError)
    else:
        opened = _OPEN[ending]
    try:
        with opened(source.file, "rb") as stream:
            _copy(stream, file, source.shown)
    except broken as error:
        raise ValueError(
            f"{source}: is no whole {ending[1:]} file ({error}); pack it anew."
        ) from error
    if not file.suffix:
        with file.open("rb") as opened:
            file = file.rename(file.with_suffix(_ending_of(file, opened.read(64))))
    return Source(file, source.shown)


def _copy(stream, file, shown):
    """Copy a stream, as far as a recording may go."""
    size = 0
    with file.open("wb") as target:
        while chunk := stream.read(_CHUNK):
            size += len(chunk)
            if size > LARGEST:
                raise ValueError(
                    f"{shown}: has more than {LARGEST / (1 << 30):g} GiB, too large to "
                    "be read at once; give a shorter recording."
                )
            target.write(chunk)
