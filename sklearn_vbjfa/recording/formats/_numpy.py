"""Arrays out of npz and npy files; nothing in them is executed."""

import struct
import tokenize
import zipfile
import zlib

import numpy as np

from sklearn_vbjfa.recording._table import (
    Format,
    Source,
    Table,
    check_memory,
    nameless,
    reading_arrays,
    table_of_arrays,
)

# What numpy raises on a file that is not a whole zip archive of arrays.
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
    broken = f"{path}: is not a complete npz file; save it anew with numpy.savez."
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
    """Read one array, which must have named fields."""
    broken = f"{path}: is not a complete npy file; save it anew with numpy.save."
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


# Zip archives without an ending are told from spreadsheets where they are opened.
NPZ = Format(name="npz", endings=(".npz",), read=read_npz)
NPY = Format(
    name="npy with named fields",
    endings=(".npy",),
    read=read_npy,
    begins=((b"\x93NUMPY", ".npy"),),
)
