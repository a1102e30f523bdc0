"""A file's content as a data frame with metadata, and refusals."""

import contextlib
import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas

# Bytes that a file may hold when unpacked: some hours of a robot at 1 kHz.
LARGEST = 1 << 30
# Entries of a list, and characters of a name or cell, that messages quote at most.
_ENTRIES, _CHARACTERS = 20, 60
# Nested structures are followed to this depth.
_DEEPEST = 8
# Note of a file that ends within a line.
CUT = "the last line is cut, as where a logger is stopped: it is left out."
# Names of arrays that have a value for every row.
_CHANNEL = re.compile(r"t|segment|(q|tau|v|a)([_.\[(]?\d+[\])]?)?", re.IGNORECASE)


class Loss(str):
    """A note on a part of a recording, or of its robot, that is left out."""

    __slots__ = ()


class RecordingRefused(ValueError):
    """A file that is not read, maybe with other options that read it.

    Attributes
    ----------
    reason : str
        Why the file is refused, without the options.
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


class NotATable(RecordingRefused):
    """A file that holds no table of numbers at all, such as a text to be read."""


def pandas_of(path):
    """Return the module pandas, or say how to install it."""
    try:
        import pandas
    except ImportError as error:
        raise ImportError(
            f'{path}: reading files needs pandas: pip install "sklearn-vbjfa[robot]"'
        ) from error
    return pandas


@dataclass(frozen=True, kw_only=True)
class Table:
    """Named columns of equal length, numbers or text, out of a file.

    The index of the frame has the number by which messages call each row.
    """

    path: Path  # as messages name it
    frame: "pandas.DataFrame"
    place: str = "row {}"  # a row in messages
    # single values, and arrays of another length
    scalars: Mapping[str, np.ndarray] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)  # from a row of units
    # joints whose columns are called q_<joint> and tau_<joint> for certain
    joints: tuple[str, ...] = ()
    nameless: bool = False  # columns are called by their places, from "1" on
    notes: tuple[str, ...] = ()

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return len(self.frame)

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return list(self.frame)

    @property
    def has_numbers(self) -> bool:
        """Whether a column has numbers."""
        return any(kind.kind in "iuf" for kind in self.frame.dtypes)

    def values(self, name) -> np.ndarray:
        """Return a column: numbers, dates, or text as objects."""
        return self.frame[name].to_numpy()

    def where(self, row) -> str:
        """Name a row in words."""
        return self.place.format(self.frame.index[row])

    def take(self, rows) -> "Table":
        """Return the table of some rows."""
        return replace(self, frame=self.frame.iloc[rows])


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
    commanded: bool = False  # whether commanded positions are needed


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format of files: its name, its endings and its reader."""

    name: str  # as lists of formats call it
    endings: tuple[str, ...]  # with points, in small letters
    read: Callable  # (Source, Wanted) -> Table
    shown: tuple[str, ...] = ()  # endings that refusals name; none for the first
    # how files begin that have no ending, and the ending that they would have
    begins: tuple[tuple[bytes, str], ...] = ()
    # (folder, Wanted, function that unpacks a Source) -> Table, or None if the folder
    # is not one of this format
    read_folder: Callable | None = None
    marks: tuple[str, ...] = ()  # patterns of files that only such a folder has
    has_topics: bool = False
    # package that reads it, what needs it, and the extra that installs it
    needs: tuple[str, ...] = ()

    def missing(self, path):
        """Return the error of a package that is not installed."""
        package, what, extra = self.needs
        return ImportError(
            f'{path}: {what} need {package}: pip install "sklearn-vbjfa[{extra}]"'
        )


# -- files that are damaged, too large or empty ----------------------------------------


@contextlib.contextmanager
def parsing(path, what, remedy):
    """Turn whatever a parser raises on a damaged file into one refusal."""
    # Parsers fail on damage in many ways. remedy: a text, or a function of the reason.
    try:
        yield
    except (RecordingRefused, ImportError):
        raise
    except MemoryError as error:
        raise RecordingRefused(
            f"{path}: is too large to be read at once, or damaged; save a shorter "
            "recording, or this one again."
        ) from error
    except Exception as error:
        if re.search("allow_pickle|Python objects", str(error)):
            raise RecordingRefused(
                f"{path}: holds Python objects and not numbers, which are not loaded; "
                "save numeric arrays with numpy.savez(FILE, t=t, q=q, tau=tau)."
            ) from error
        # rosbags quotes what an error held as a tuple.
        reason = re.sub(r"\(['\"](.*?)['\"],\)", r"\1", " ".join(str(error).split()))
        reason = reason.rstrip(".")[:200] or type(error).__name__
        advice = f"{remedy}." if isinstance(remedy, str) else remedy(reason)
        raise ValueError(
            f"{path}: is not a complete {what} ({reason}); {advice}"
        ) from error


def check_size(path, size, remedy="save a shorter recording", what="unpacked"):
    """Refuse what is packed small and fills the memory."""
    if size > LARGEST:
        raise RecordingRefused(
            f"{path}: has {size / (1 << 30):.1f} GiB {what}, too large to be read at "
            f"once; {remedy}."
        )


def no_rows(path):
    """Return the refusal of a file without data."""
    return ValueError(f"{path}: no rows of data; expected one row per sample.")


def check_names(path, names, what):
    """Refuse a name that comes twice."""
    ((first, count),) = Counter(names).most_common(1)
    if count > 1:
        raise ValueError(
            f"{path}: {what} column {quoted(first)} twice; each column needs its own "
            "name."
        )


# -- arrays and records as tables ------------------------------------------------------


def flattened(values, keep=lambda value: True, depth=0):
    """Return the content of nested structures, names with points."""
    found = {}
    for name, value in values.items():
        inside = None
        if isinstance(value, dict):
            inside = {f"{name}.{key}": one for key, one in value.items()}
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            # Messages have a list of structures, one for each motor.
            if all(isinstance(x, dict) for x in value):
                inside = {f"{name}[{k}]": one for k, one in enumerate(value)}
        if inside is not None and depth < _DEEPEST:
            found |= flattened(inside, keep, depth + 1)
        elif keep(value):
            found[name] = value
    return found


def without_common_part(found):
    """Remove the name of the only structure from the names inside it."""
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
    arrays = _upright({name: x for name, x in arrays.items() if x.size})
    arrays, notes = _with_names_beside(path, arrays)
    n_rows = _number_of_rows(path, arrays)
    rows = {
        name: x for name, x in arrays.items() if x.ndim in (1, 2) and len(x) == n_rows
    }
    scalars = {name: x for name, x in arrays.items() if name not in rows}
    for name, x in scalars.items():
        if x.ndim in (1, 2) and _is_channel(name):
            raise ValueError(
                f"{path}: array {name!r} has {len(x)} rows, others have {n_rows}; all "
                "channels need one row per sample."
            )
    (name, only), *others = rows.items()
    if not others and only.ndim == 2 and only.shape[1] > 1 and not _is_channel(name):
        return nameless(path, only, scalars=scalars)
    columns = []
    for name, x in rows.items():
        matrix = x.reshape(n_rows, -1).T
        names = [f"{name}{k + 1}" for k in range(len(matrix))]
        columns += zip(names if len(matrix) > 1 else [name], matrix)
    check_names(path, [name for name, _ in columns], "on its own and in a matrix has")
    left = [name for name, x in scalars.items() if x.ndim and len(x) > n_rows // 2]
    if left:
        notes += (f"array(s) {listed(left)} have not {n_rows} rows: left out.",)
    frame = pandas_of(path).DataFrame(dict(columns))
    frame.index += 1
    return Table(path=path.shown, frame=frame, scalars=scalars, notes=notes)


def nameless(path: Source, matrix, **known) -> Table:
    """Make columns of a matrix (n_rows, n) without names, called by their places."""
    frame = pandas_of(path).DataFrame(matrix)
    frame.columns, frame.index = [str(k + 1) for k in frame], frame.index + 1
    return Table(path=path.shown, frame=frame, nameless=True, **known)


def _is_channel(name):
    return _CHANNEL.fullmatch(name) is not None


def _upright(arrays):
    """Turn matrices that have one column per sample."""
    # Texts are names of columns, and as many as these.
    numbers = [x for x in arrays.values() if x.ndim and x.dtype.kind not in "US"]
    lengths = [max(x.shape) for x in numbers if x.size > 1]
    n_rows = max(set(lengths), key=lengths.count, default=0)
    return {
        name: x.T if x.ndim == 2 and x.shape[1] == n_rows != x.shape[0] else x
        for name, x in arrays.items()
    }


def _number_of_rows(path, arrays):
    """Return the length of the channels: of q, of channels, of matrices, of most."""
    sized = {name: x for name, x in arrays.items() if x.ndim in (1, 2) and len(x) > 1}
    for chosen in (
        [x for name, x in sized.items() if name.lower() == "q"],
        [x for name, x in sized.items() if _is_channel(name)],
        [x for x in sized.values() if x.ndim == 2],
        [x for x in sized.values() if len(sized) > 1],
    ):
        if chosen:
            return Counter(map(len, chosen)).most_common(1)[0][0]
    raise NotATable(
        f"{path}: holds {listed(arrays) or 'nothing'}; expected arrays q and tau of "
        "shape (n_samples, n_joints), or columns q1, ..., tau1, ...",
    )


def _with_names_beside(path, arrays):
    """Make columns of the only matrix if a list has their names; notes."""
    # As data frames are split, and as loggers write a matrix and its names.
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
        check_names(path, [*names, *rest], f"the names in {key!r} have")
        note = f"the columns of {name!r} are called by the names in {key!r}."
        return {**rest, **dict(zip(names, arrays[name].T))}, (note,)
    return arrays, ()


def _array(path, name, values):
    """Make an array of a list; nothing is nan, and a column of text stays text."""
    if isinstance(values, np.ndarray):
        return values.astype(values.dtype.newbyteorder("="), copy=False)
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


# -- what a file holds, quoted ---------------------------------------------------------


def quoted(value):
    """Write a value as Python does; of a long one the beginning."""
    is_text = isinstance(value, str)
    text = value if is_text else repr(value)
    left = len(text) - _CHARACTERS
    shown = repr(text[:_CHARACTERS]) if is_text else text[:_CHARACTERS]
    return f"{shown} and {left} characters more" if left > 0 else shown


def listed(names):
    """List names with commas; of many the first."""
    names = [str(name) for name in names]
    names = [name if len(name) <= _CHARACTERS else quoted(name) for name in names]
    if len(names) > _ENTRIES:
        names[_ENTRIES - 1 :] = [f"and {len(names) - _ENTRIES + 1} more"]
    return ", ".join(names)
