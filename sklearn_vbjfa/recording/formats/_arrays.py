"""Arrays by their names out of npz, npy and MATLAB files."""

import struct
import tokenize
import zipfile
import zlib
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._table import (
    LARGEST,
    Format,
    Source,
    Table,
    check_memory,
    flattened,
    nameless,
    reading_arrays,
    table_of_arrays,
    without_common_part,
)

# What NumPy raises on a file that is not a whole zip archive of arrays.
_BROKEN = (
    EOFError,
    OSError,
    OverflowError,
    RuntimeError,
    ValueError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def read_npz(path: Source, wanted) -> Table:
    """Read arrays; a matrix such as q becomes the columns q1, q2, ..."""
    broken = f"{path}: is not a complete npz file; save it again with numpy.savez."
    # numpy.load would read other formats under this name.
    if not zipfile.is_zipfile(path.file):
        raise ValueError(broken)
    arrays, name = {}, ""

    def objects():
        return name and (
            f"{path}: array {name!r} holds Python objects and not numbers; save "
            "numeric arrays of one row per sample with numpy.savez."
        )

    with reading_arrays(path, broken, _BROKEN, objects):
        with zipfile.ZipFile(path.file) as archive:
            check_memory(sum(member.file_size for member in archive.infolist()))
        with np.load(path.file, allow_pickle=False) as archive:
            for name in archive.files:
                arrays[name] = archive[name]
    # A zip archive of other files, such as a spreadsheet, yields bytes.
    if not all(isinstance(array, np.ndarray) for array in arrays.values()):
        raise ValueError(broken)
    return table_of_arrays(path, arrays)


def read_npy(path: Source, wanted) -> Table:
    """Read one array: a matrix, or named fields."""
    broken = f"{path}: is not a complete npy file; save it again with numpy.save."
    objects = (
        f"{path}: holds Python objects and not numbers, which are not loaded; save "
        "numeric arrays with numpy.savez(FILE, t=t, q=q, tau=tau)."
    )
    with reading_arrays(path, broken, _BROKEN, lambda: objects):
        array = np.load(path.file, allow_pickle=False)
    if isinstance(array, np.ndarray) and array.ndim == 2 and array.dtype.kind in "biuf":
        return nameless(path, array)
    if not isinstance(array, np.ndarray) or array.dtype.names is None:
        shape = getattr(array, "shape", ())
        raise ValueError(
            f"{path}: holds an array of shape {shape} without names, so that nothing "
            "tells positions from torques; expected one with named fields, or "
            "numpy.savez(FILE, t=t, q=q, tau=tau) with q and tau (n_samples, n_joints)."
        )
    return table_of_arrays(path, {name: array[name] for name in array.dtype.names})


# Zip archives without an ending are distinguished from spreadsheets when opened.
NPZ = Format(name="npz", endings=(".npz",), read=read_npz)
NPY = Format(
    name="npy with named fields",
    endings=(".npy",),
    read=read_npy,
    begins=((b"\x93NUMPY", ".npy"),),
)


# -- MATLAB ----------------------------------------------------------------------------

# Type of a packed variable, as its tag has it, and the bytes that are unpacked at once.
_PACKED, _CHUNK = 15, 1 << 20
# What SciPy's parser raises on damage, besides its own errors.
_DAMAGED = (*_BROKEN, ArithmeticError, AttributeError, LookupError, TypeError)


def read_mat(path: Source, wanted) -> Table:
    """Read the variables of a MATLAB file."""
    from scipy.io import loadmat, matlab

    with path.file.open("rb") as file:
        begin = file.read(128)
    if begin.startswith((b"MATLAB 7.3", b"\x89HDF")):
        raise ValueError(
            f"{path}: is a MATLAB file of version 7.3 (HDF5), expected version 5 to "
            "7.2; in MATLAB: save(FILE, 't', 'q', 'tau', '-v7')."
        )
    broken = (
        f"{path}: is not a complete MATLAB file of version 5 to 7.2; write it again "
        "with save(FILE, 't', 'q', 'tau', '-v7')."
    )
    errors = (*_DAMAGED, NameError, matlab.MatReadError, matlab.MatReadWarning)
    with reading_arrays(path, broken, errors):
        # Numbers may be stored as bytes, and become eight of them.
        check_memory(8 * _unpacked_size(path.file))
        found = loadmat(path.file, simplify_cells=True)
    # Objects of MATLAB's own classes (tables, time series) have no name here.
    objects = [x for x in found.values() if _is_object(x)]
    found = {name: x for name, x in found.items() if str(name or "__")[:2] != "__"}
    arrays = flattened(found, _is_usable)
    if objects and not arrays:
        raise ValueError(
            f"{path}: holds objects of MATLAB, such as a table or time series, and no "
            "arrays; in MATLAB write its numbers: t = T.Time; q = T{:, 2:7}; ... "
            "save(FILE, 't', 'q', 'tau', '-v7')."
        )
    # A cell of texts is a list of them.
    arrays = {
        k: np.asarray(x, dtype=str if _is_texts(x) else None)
        for k, x in without_common_part(arrays).items()
    }
    table = table_of_arrays(path, _upright(arrays))
    if not objects:
        return table
    note = f"{len(objects)} object(s) of MATLAB's own classes are left out."
    return replace(table, notes=(*table.notes, note))


def _is_usable(value):
    usable = np.asarray(value).dtype.kind in "biufU" or _is_texts(value)
    return usable and not _is_object(value)


def _is_texts(value):
    """Whether a value is a cell of texts."""
    own = isinstance(value, np.ndarray) and value.dtype == object
    return own and value.size > 0 and all(isinstance(x, str) for x in value.flat)


def _is_object(value):
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    return isinstance(value, (MatlabOpaque, MatlabFunction))


def _unpacked_size(path):
    """Return the bytes of a file of version 5 with its variables unpacked."""
    size = path.stat().st_size
    with path.open("rb") as file:
        order = "<" if file.read(128)[126:] == b"IM" else ">"
        while len(tag := file.read(8)) == 8:
            kind, count = struct.unpack(f"{order}II", tag)
            if kind != _PACKED:
                file.seek(count, 1)
                continue
            unpacker = zlib.decompressobj()
            while count > 0 and (chunk := file.read(min(count, _CHUNK))):
                count -= len(chunk)
                while chunk and size <= LARGEST:
                    size += len(unpacker.decompress(chunk, _CHUNK))
                    chunk = unpacker.unconsumed_tail
    return size


def _upright(arrays):
    """Turn matrices of one column per sample; MATLAB has either."""
    # Texts are names of columns, and as many as these.
    lengths = [
        max(x.shape)
        for x in arrays.values()
        if x.ndim and x.size > 1 and x.dtype.kind != "U"
    ]
    n_rows = max(set(lengths), key=lengths.count, default=0)
    return {
        name: x.T if x.ndim == 2 and x.shape[1] == n_rows != x.shape[0] else x
        for name, x in arrays.items()
    }


MATLAB = Format(
    name="MATLAB (to version 7.2)",
    endings=(".mat",),
    read=read_mat,
    begins=((b"MATLAB 5.0", ".mat"),),
)
