"""A file's content as a data frame with metadata, and refusals."""

import contextlib
import re
from collections import Counter
from collections.abc import Mapping
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

    def values(self, name) -> np.ndarray:
        """Return a column: numbers, dates, or text as objects."""
        return self.frame[name].to_numpy()

    def numbers(self, name) -> np.ndarray:
        """Return a column as finite floats; an error names the wrong cell."""
        values = self.values(name)
        if values.dtype.kind not in "biuf":
            raise ValueError(
                f"{self.path}: column {name!r} holds {quoted(str(values[0]))} and not "
                "numbers; correct or rename it."
            )
        with np.errstate(over="ignore"):
            values = values.astype(float)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise ValueError(
                f"{self.path}: {values[bad[0]]} or nothing in {self.where(bad[0])}, "
                f"column {name!r} ({bad.size} such cells in it); interpolate them or "
                "remove those rows."
            )
        return values

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


# -- files that are damaged, too large or empty, packages that are missing -------------


@contextlib.contextmanager
def parsing(path, what, remedy):
    """Turn whatever a parser raises on a damaged file into one refusal."""
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
        raise ValueError(
            f"{path}: is not a complete {what} ({reason}); {remedy}"
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


def pandas_of(path):
    """Return the module pandas, or say how to install it."""
    try:
        import pandas
    except ImportError as error:
        raise missing(path, "pandas", "reading files needs", "robot") from error
    return pandas


def missing(path, package, needs, extra):
    """Return the error of a package that is not installed."""
    return ImportError(
        f'{path}: {needs} {package}: pip install "sklearn-vbjfa[{extra}]"'
    )


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
