"""Variables out of MATLAB files, also those inside of structures."""

import struct
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
    reading_arrays,
    table_of_arrays,
    without_common_part,
)

# Type of a packed variable, as its tag has it, and the bytes that are unpacked at once.
_PACKED, _CHUNK = 15, 1 << 20


def read_mat(path: Source, wanted) -> Table:
    """Read the variables of a MATLAB file."""
    from scipy.io import loadmat, matlab

    broken = (
        f"{path}: is not a complete MATLAB file of version 5 to 7.2; write it anew "
        "with save(FILE, 't', 'q', 'tau', '-v7')."
    )
    with path.file.open("rb") as file:
        begin = file.read(128)
    if begin.startswith((b"MATLAB 7.3", b"\x89HDF")):
        raise ValueError(
            f"{path}: is a MATLAB file of version 7.3 (HDF5), expected version 5 to "
            "7.2; in MATLAB: save(FILE, 't', 'q', 'tau', '-v7')."
        )
    # What the parser raises on damage.
    errors = (
        ArithmeticError,
        AttributeError,
        EOFError,
        LookupError,
        OSError,
        RuntimeError,
        TypeError,
        UnboundLocalError,
        ValueError,
        matlab.MatReadError,
        matlab.MatReadWarning,
        struct.error,
        zipfile.BadZipFile,
        zlib.error,
    )
    with reading_arrays(path, broken, errors):
        # What is packed small must not fill the memory. Numbers may be stored as bytes,
        # and become eight of them.
        check_memory(8 * _unpacked_size(path.file))
        found = loadmat(path.file, simplify_cells=True)
    # Objects of MATLAB's own classes (tables, time series) have no name here.
    objects = [x for name, x in found.items() if _is_object(x)]
    found = {name: x for name, x in found.items() if str(name or "__")[:2] != "__"}
    arrays = flattened(found, _is_numeric)
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


def _is_numeric(value):
    kind = np.asarray(value).dtype.kind
    return (kind in "biufU" or _is_texts(value)) and not _is_object(value)


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
    if not lengths:
        return arrays
    n_rows = max(set(lengths), key=lengths.count)
    turned = {}
    for name, x in arrays.items():
        if x.ndim == 2 and x.shape[1] == n_rows != x.shape[0]:
            x = x.T
        turned[name] = x
    return turned


MATLAB = Format(
    name="MATLAB (to version 7.2)",
    endings=(".mat",),
    read=read_mat,
    begins=((b"MATLAB 5.0", ".mat"),),
)
