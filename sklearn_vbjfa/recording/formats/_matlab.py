"""Variables out of MATLAB files, also those inside of structures."""

import struct
import zipfile
import zlib

import numpy as np

from sklearn_vbjfa.recording._table import (
    Format,
    Source,
    Table,
    check_memory,
    flattened,
    reading_arrays,
    table_of_arrays,
    without_common_part,
)


def read_mat(path: Source, wanted) -> Table:
    """Read the variables of a MATLAB file."""
    from scipy.io import loadmat, matlab, whosmat

    broken = (
        f"{path}: is no whole MATLAB file of version 5 to 7.2; write it anew with "
        "save(FILE, 't', 'q', 'tau', '-v7')."
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
        # Sizes as its headers tell: what is packed small must not fill the memory.
        sizes = [
            np.prod([float(n) for n in shape]) for _, shape, _ in whosmat(path.file)
        ]
        check_memory(max(8 * sum(sizes), path.file.stat().st_size))
        found = loadmat(path.file, simplify_cells=True)
    found = {name: x for name, x in found.items() if name[:2] != "__"}
    arrays = without_common_part(flattened(found, _is_numeric))
    arrays = {name: np.asarray(x) for name, x in arrays.items()}
    return table_of_arrays(path, _upright(arrays))


def _is_numeric(value):
    return np.asarray(value).dtype.kind in "biufU"


def _upright(arrays):
    """Turn matrices of one column per sample; MATLAB has either."""
    lengths = [max(x.shape) for x in arrays.values() if x.ndim and x.size > 1]
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
