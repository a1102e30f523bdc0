"""What is in a file of whatever format: named columns, and how messages say so."""

import contextlib
import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

# Bytes that a file may hold when unpacked: some hours of a robot at 1 kHz. What is read
# is copied.
LARGEST = 1 << 30
# Entries of a list, and characters of a name or cell, that are quoted at most: a file
# may have thousands of columns and cells without an end.
_ENTRIES, _CHARACTERS = 20, 60


# Note of a file that ends within a line.
CUT = "the last line is cut, as where a logger is stopped: it is left out."


class Loss(str):
    """A note on what of a recording, or of its robot, is left out."""

    __slots__ = ()


class RecordingRefused(ValueError):
    """A file that would be read with other options.

    Attributes
    ----------
    reason : str
        What is wrong, without the options.
    options : dict of str to str, tuple or None
        The options, by the names of `read_recording`; None for one to leave out. Empty
        if none would do.
    """

    def __init__(self, reason, options=None):
        self.reason = reason.removesuffix(".")
        self.options = dict(options or {})
        offers = [f"{key}={value!r}" for key, value in self.options.items()]
        offer = f"; try {', '.join(offers)}" if offers else ""
        super().__init__(f"{self.reason}{offer}.")


@dataclass(frozen=True, kw_only=True)
class Table:
    """Named columns of equal length, numbers or text, out of a file."""

    path: Path  # as messages name it
    columns: dict[str, np.ndarray]  # by name
    # arrays of one entry, or of none per row, that stand beside the columns
    scalars: dict[str, np.ndarray] = field(default_factory=dict)
    # turns a row (from 0) into words: a line of the file where it has lines
    where: Callable[[int], str] = lambda row: f"row {row + 1}"
    # units of columns out of a row of their own
    units: Mapping[str, str] = field(default_factory=dict)
    # joints whose columns are called q_<joint> and tau_<joint> for certain
    joints: tuple[str, ...] = ()
    # whether columns have no names and are called by their places, from "1" on
    nameless: bool = False
    notes: tuple[str, ...] = ()  # what a user should know of the file
    # [rad] of one per cent of a motor's calibrated range, by column
    shares: Mapping[str, float] = field(default_factory=dict)

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values())))


@dataclass(frozen=True)
class Source:
    """A file to read, and the name under which the user knows it."""

    file: Path
    shown: Path

    def __str__(self):
        return str(self.shown)


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What a user asks of a file that holds more than one robot's recording."""

    topic: str | None = None  # of a bag; None for the only one of joint states
    joints: Callable = lambda: ()  # returns the robot's, empty for all
    commanded: bool = False  # whether positions that joints are told are needed


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format of files: what it is called, how it is known and how it is read."""

    name: str  # as lists of formats call it
    endings: tuple[str, ...]  # with points, in small letters
    # (Source, Wanted) -> Table
    read: Callable
    shown: tuple[str, ...] = ()  # endings that refusals name; none for the first
    # how files begin that have no ending, and the ending that they would have
    begins: tuple[tuple[bytes, str], ...] = ()
    # (folder, Wanted, function that unpacks a Source) -> Table, or None if the folder
    # is not one of this format
    read_folder: Callable | None = None
    marks: tuple[str, ...] = ()  # patterns of files that only such a folder has
    has_topics: bool = False
    # package that reads it, and what needs it
    needs: tuple[str, ...] = ()

    def missing(self, path):
        """Return the error of a package that is not installed."""
        package, what = self.needs
        return ImportError(
            f"{path}: {what} need {package}, which is not installed: "
            f"pip install {package}"
        )


def check_size(path, size, remedy="save a shorter recording", what="unpacked"):
    """Refuse what is packed small and fills the memory."""
    if size > LARGEST:
        raise ValueError(
            f"{path}: has {size / (1 << 30):.1f} GiB {what}, too large to be read at "
            f"once; {remedy}."
        )


@contextlib.contextmanager
def reading_arrays(path, broken, errors, objects=lambda: ""):
    """Turn what a reader of arrays raises into refusals."""
    # broken: what to say of a damaged file, of which `errors` are the signs; objects:
    # returns what to say of one with Python objects in it.
    try:
        yield
    except MemoryError as error:
        raise ValueError(
            f"{path}: is too large to be read at once, or damaged ({error}); save a "
            "shorter recording, or this one anew."
        ) from error
    except errors as error:
        said = objects() if "allow_pickle" in str(error) else ""
        raise ValueError(said or broken) from error


def check_memory(size):
    """Raise what a reader of arrays raises where the memory is too small."""
    if size > LARGEST:
        raise MemoryError(f"{size / (1 << 30):.1f} GiB unpacked")


def text_of(path: Source) -> str:
    """Return a text in UTF-8, which has more than blanks."""
    check_size(path, path.file.stat().st_size, what="of text")
    try:
        text = path.file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: is not UTF-8 ({error.reason} at byte {error.start}); save it "
            "in UTF-8."
        ) from error
    if not text.strip():
        raise ValueError(f"{path}: no rows of data; expected one row per sample.")
    return text


def flattened(values, keep=lambda value: True, depth=0):
    """Return what nested structures hold, names with points."""
    found = {}
    for name, value in values.items():
        if isinstance(value, dict) and depth < 8:
            inside = flattened(value, keep, depth + 1)
            found |= {f"{name}.{key}": x for key, x in inside.items()}
        elif _structures(value) and depth < 8:
            numbered = {f"{name}[{k}]": one for k, one in enumerate(value)}
            found |= flattened(numbered, keep, depth + 1)
        elif keep(value):
            found[name] = value
    return found


def _structures(value):
    """Whether a value is a list of structures, as messages have one for each motor."""
    return isinstance(value, list) and value and all(isinstance(x, dict) for x in value)


def without_common_part(found):
    """Take the name of the only structure off the names of what is in it."""
    if len({name.rpartition(".")[0] for name in found}) == 1:
        return {name.rpartition(".")[2]: x for name, x in found.items()}
    return found


def table_of_records(path: Source, records) -> Table:
    """Make columns of rows, each a dict, maybe nested; what a row lacks is nan."""
    records = [flattened(record) for record in records]
    names = dict.fromkeys(name for record in records for name in record)
    columns = {name: [record.get(name) for record in records] for name in names}
    return table_of_arrays(path, without_common_part(columns))


def table_of_arrays(path: Source, arrays) -> Table:
    """Make columns of arrays or lists; a matrix such as q becomes q1, q2, ..."""
    arrays = {name: _array(path, name, x) for name, x in arrays.items()}
    # Messages have empty lists for what is not measured.
    arrays = {name: values for name, values in arrays.items() if values.size}
    arrays, notes = _with_names_beside(path, arrays)
    lengths = {
        name: len(values)
        for name, values in arrays.items()
        if values.ndim > 0 and _is_channel(name)
    }
    matrices = {
        name: len(values)
        for name, values in arrays.items()
        if values.ndim == 2 and len(values) > 1
    }
    if not lengths and not matrices:
        # Columns of other names, as many of the same length as there are.
        several = Counter(len(x) for x in arrays.values() if x.ndim == 1 and len(x) > 1)
        n_rows, count = max(several.items(), key=lambda x: x[1], default=(0, 0))
        if count > 1:
            matrices = {k: n_rows for k, x in arrays.items() if x.shape == (n_rows,)}
    if not lengths and not matrices:
        raise ValueError(
            f"{path}: holds {', '.join(arrays) or 'nothing'}; expected arrays q and "
            "tau of shape (n_samples, n_joints), or columns q1, ..., tau1, ..."
        )
    if not any(name.lower().startswith(("q", "tau")) for name in lengths):
        # Matrices of other names become columns, for a mapping to say what they are.
        lengths = matrices or lengths
    (usual, _), *_ = Counter(lengths.values()).most_common(1)
    n_rows = lengths.get("q", usual)
    if matrices and not any(_is_channel(x) for x in lengths):
        others = [x for x in arrays if arrays[x].shape == (n_rows,)]
        if len(lengths) == 1 and not others:
            (name,) = lengths
            return nameless(path, arrays.pop(name), arrays)
    for name, length in lengths.items():
        if length != n_rows and _is_channel(name, exactly=True):
            raise ValueError(
                f"{path}: array {name!r} has {length} rows, others have {n_rows}; all "
                "channels need one row per sample."
            )
    others = [name for name, length in lengths.items() if length != n_rows]
    if others:
        notes = (
            *notes,
            f"array(s) {listed(others)} have not {n_rows} rows: left out.",
        )
    columns, scalars = {}, {}
    for name, values in arrays.items():
        if values.ndim not in (1, 2) or len(values) != n_rows:
            scalars[name] = values
            continue
        own = {name: values.reshape(n_rows)} if values.size == n_rows else {}
        if not own:
            own = {f"{name}{k + 1}": x for k, x in enumerate(values.T)}
        twice = sorted(columns.keys() & own.keys())
        if twice:
            raise ValueError(
                f"{path}: column {twice[0]!r} is there twice, on its own and in a "
                "matrix; each needs its own name."
            )
        columns.update(own)
    return Table(path=path.shown, columns=columns, scalars=scalars, notes=notes)


def _with_names_beside(path, arrays):
    """Make columns of the only matrix if a list beside it has their names; notes."""
    # As data frames are split, and as loggers write a matrix and what is in it.
    matrices = [name for name, x in arrays.items() if x.ndim == 2 and len(x) > 1]
    if len(matrices) != 1 or _is_channel(matrices[0]):
        return arrays, ()
    (name,) = matrices
    for key, x in arrays.items():
        if x.dtype.kind not in "US" or x.shape != arrays[name].shape[1:]:
            continue
        # Bytes are text too; MATLAB fills names up with blanks.
        texts = np.char.decode(x, "utf-8", "replace") if x.dtype.kind == "S" else x
        names = [str(text).strip() for text in texts]
        rest = {k: one for k, one in arrays.items() if k not in (key, name)}
        ((first, count),) = Counter([*names, *rest]).most_common(1)
        if count > 1:
            raise ValueError(
                f"{path}: column {first!r} is there twice, by the names in {key!r}; "
                "each needs its own name."
            )
        note = f"the columns of {name!r} are called by the names in {key!r}."
        return {**rest, **dict(zip(names, arrays[name].T))}, (note,)
    return arrays, ()


def nameless(path: Source, matrix, scalars=(), **known) -> Table:
    """Make columns of a matrix (n_rows, n) without names, called by their places."""
    return Table(
        path=path.shown,
        columns={str(k + 1): column for k, column in enumerate(matrix.T)},
        scalars=dict(scalars),
        nameless=True,
        **known,
    )


def _array(path, name, values):
    """Make an array of a list; nothing is nan, and a column of text stays text."""
    if isinstance(values, np.ndarray):
        return values
    first = values
    while isinstance(first, list) and first:
        # Messages name all joints in each.
        first = next((x for x in first if x is not None), None)
    try:
        return np.array(values, dtype=str if isinstance(first, str) else float)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(
            f"{path}: {quoted(name)} holds {quoted(first)} and others that are not "
            "numbers, or lists of other lengths; write one number, or equally long "
            "lists of them, for each sample."
        ) from error


def _is_channel(name: str, exactly: bool = False) -> bool:
    """Whether a name is one of a channel, which has a value for every row."""
    # What begins like one may be another thing: tau_limits.
    name = name.lower()
    own = re.fullmatch(r"t|segment|(q|tau|v|a)([_.\[(]?\d+[\])]?)?", name)
    return own is not None or (not exactly and name.startswith(("q", "tau")))


# -- what a file holds, quoted ---------------------------------------------------------


def quoted(value):
    """Write a cell, a name or another value as Python does; of a long one the begin."""
    if isinstance(value, str):
        text = repr(value[:_CHARACTERS])
        left = len(value) - _CHARACTERS
    else:
        text = repr(value)
        text, left = text[:_CHARACTERS], len(text) - _CHARACTERS
    return f"{text} and {left} characters more" if left > 0 else text


def listed(names):
    """Name columns, joints or topics one after another; of many the first."""
    names = [str(name) for name in names]
    names = [name if len(name) <= _CHARACTERS else quoted(name) for name in names]
    if len(names) > _ENTRIES:
        names[_ENTRIES - 1 :] = [f"and {len(names) - _ENTRIES + 1} more"]
    return ", ".join(names)
