"""Rows that are read when they are looked at: of recordings too long for memory."""

import contextlib
import os
import tempfile
import threading
import weakref
from bisect import bisect_right
from itertools import accumulate, pairwise

import numpy as np

# Rows that are looked at together where any number would do, and gaps between rows that
# are read rather than skipped.
_AT_ONCE, _NEAR = 1 << 16, 1 << 12


class StoredRows(np.lib.mixins.NDArrayOperatorsMixin):
    """Array whose slices are views, and whose rows are read by `numpy.asarray`."""

    # read: (start, stop) -> these rows, an array (stop - start, *shape[1:]). What is
    # done to it as a whole is done in memory: pieces of it are for that.

    def __init__(self, read, shape, dtype=float):
        self._read, self.shape, self.dtype = read, tuple(shape), np.dtype(dtype)

    @classmethod
    def constant(cls, value, shape):
        """Return rows that are all the same, which take no room."""
        value = np.asarray(value)

        def read(start, stop):
            # Laid out as rows are that are no constant: sums go in the same order.
            return np.full((stop - start, *shape[1:]), value)

        return cls(read, shape, value.dtype)

    @classmethod
    def clock(cls, n, dt):
        """Return the time of n rows [s]."""
        return cls(lambda start, stop: np.arange(start, stop) * dt, (n,))

    @property
    def ndim(self):
        """Number of axes."""
        return len(self.shape)

    @property
    def size(self):
        """Number of values."""
        return int(np.prod(self.shape))

    def __len__(self):
        return self.shape[0]

    def __array__(self, dtype=None, copy=None):
        rows = self._read(0, self.shape[0])
        return rows.astype(dtype) if dtype not in (None, rows.dtype) else rows

    def __array_ufunc__(self, ufunc, method, *inputs, **kwargs):
        inputs = [np.asarray(x) if isinstance(x, StoredRows) else x for x in inputs]
        return getattr(ufunc, method)(*inputs, **kwargs)

    def __reduce__(self):
        # Another process gets the rows.
        return np.array, (np.asarray(self),)

    def __getitem__(self, key):
        rows, *rest = key if isinstance(key, tuple) else (key,)
        if isinstance(rows, (int, np.integer)):
            row = int(rows) % self.shape[0]
            return self._read(row, row + 1)[(0, *rest)]
        if not isinstance(rows, slice):
            return self._chosen(np.asarray(rows))[(slice(None), *rest)]
        start, stop, step = rows.indices(self.shape[0])
        if step != 1:
            own = slice(None, None, step)
            return self._read(start, max(stop, start))[(own, *rest)]
        read, shape = self._read, (max(stop - start, 0), *self.shape[1:])
        if not rest:
            return StoredRows(
                lambda a, b: read(start + a, start + b), shape, self.dtype
            )
        own = (slice(None), *rest)
        width = np.empty((0, *shape[1:]))[own].shape[1:]

        def some(a, b):
            out = np.empty((b - a, *width), self.dtype)
            for rows in pieces(b - a):
                rows_ = read(start + a + rows.start, start + a + rows.stop)
                out[rows] = rows_[own]
            return out

        return StoredRows(some, (shape[0], *width), self.dtype)

    def _chosen(self, rows):
        """Rows by their numbers, or those that are marked."""
        if rows.dtype == bool:
            rows = np.flatnonzero(rows)
        order = np.argsort(rows, kind="stable")
        sorted_, out = rows[order], np.empty((rows.size, *self.shape[1:]), self.dtype)
        edges = np.flatnonzero(np.diff(sorted_) > _NEAR) + 1
        for first, last in pairwise([0, *edges.tolist(), rows.size]):
            if last > first:
                low, high = int(sorted_[first]), int(sorted_[last - 1])
                some = sorted_[first:last] - low
                out[order[first:last]] = self._read(low, high + 1)[some]
        return out


class Shelf:
    """A file without a name that holds the rows of any number of arrays."""

    # It ends with the last who reads it: a process may not open a file an array.

    def __init__(self):
        self._file, self._lock = None, threading.Lock()

    def put(self, rows):
        """Write rows (n, ...) behind all others; return them as `StoredRows`."""
        rows = np.ascontiguousarray(rows)
        dtype, width, size = rows.dtype, rows.shape[1:], rows[:1].nbytes
        with self._lock, _room_for(rows.nbytes):
            if self._file is None:
                # With a buffer what finds no room would fail where it is read.
                self._file = tempfile.TemporaryFile(buffering=0)
                weakref.finalize(self, self._file.close)
            begin = self._file.seek(0, os.SEEK_END)
            _all_bytes(rows, self._file.write)

        def read(start, stop):
            out = np.empty((stop - start, *width), dtype)
            with self._lock:
                self._file.seek(begin + start * size)
                _all_bytes(out, self._file.readinto)
            return out

        return StoredRows(read, rows.shape, dtype)


def _all_bytes(rows, transfer):
    """Let a function write or fill the bytes of an array, which may do some at once."""
    left = rows.reshape(-1).view(np.uint8)
    while left.size:
        done = transfer(left)
        if not done:
            raise EOFError("there are no such rows in the file.")
        left = left[done:]


@contextlib.contextmanager
def _room_for(size):
    """Name the temporary folder where bytes cannot be written to it."""
    try:
        yield
    except OSError as error:
        folder = tempfile.tempdir or os.environ.get("TMPDIR") or "temporary folder"
        reason = (
            f"{error.strerror or error}, where {size / 1e6:.3g} MB of a recording were "
            "to be kept; let the environment variable TMPDIR name a folder with room "
            "for all positions and torques (eight bytes a value)"
        )
        raise OSError(error.errno, reason, str(folder)) from error


def put_together(parts):
    """Rows of several arrays, one after the other; stored if one of them is."""
    if not any(isinstance(part, StoredRows) for part in parts):
        return _constant(parts) if _are_constant(parts) else np.concatenate(parts)
    edges = [0, *accumulate(map(len, parts))]

    def read(start, stop):
        first, rows = max(bisect_right(edges, start) - 1, 0), []
        for part, (low, high) in zip(parts[first:], pairwise(edges[first:])):
            if low >= stop and rows:
                break
            rows.append(np.asarray(part[max(start - low, 0) : min(stop, high) - low]))
        return rows[0] if len(rows) == 1 else np.concatenate(rows)

    one = next(part for part in parts if isinstance(part, StoredRows))
    return StoredRows(read, (edges[-1], *one.shape[1:]), one.dtype)


def _are_constant(parts):
    """Whether arrays hold one number that takes no memory, as weights of one do."""
    there = [part for part in parts if part.size]
    same = there and not any(any(part.strides) for part in there)
    return bool(same and len({part.flat[0] for part in there}) == 1)


def _constant(parts):
    """Rows of arrays that hold one number, which take no memory either."""
    one = next(part for part in parts if part.size)
    return np.broadcast_to(one.flat[0], (sum(map(len, parts)), *one.shape[1:]))


def pieces(n):
    """Yield slices of n rows that are looked at one by one."""
    for first in range(0, n, _AT_ONCE):
        yield slice(first, min(first + _AT_ONCE, n))
