"""Columns with names, out of a file of whatever format."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

# Bytes that a file may hold when unpacked: some hours of a robot at 1 kHz. What is read
# is copied.
LARGEST = 1 << 30


class Loss(str):
    """A note on what of a recording, or of its robot, is left out."""

    __slots__ = ()


@dataclass(frozen=True, kw_only=True)
class Table:
    """Named columns of equal length, numbers or text, out of a file."""

    path: Path  # as messages name it
    columns: dict[str, np.ndarray]  # by name
    # arrays of one entry, or of none per row, that stand beside the columns
    scalars: dict[str, np.ndarray] = field(default_factory=dict)
    # turns a row (from 0) into words: a line of the file where it has lines
    where: Callable[[int], str]
    # units of columns out of a row of their own
    units: Mapping[str, str] = field(default_factory=dict)
    # joints whose columns are called q_<joint> and tau_<joint> for certain
    joints: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()  # what a user should know of the file

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


def row_in_words(row: int) -> str:
    """Name a row where the file has no lines."""
    return f"row {row + 1}"
