"""Arrays out of npz, npy and MATLAB files; nothing in them is executed."""

import re
import struct
import tokenize
import zipfile
import zlib

import numpy as np

from sklearn_vbjfa.recording._table import LARGEST, Source, Table, row_in_words

# What numpy raises on a file that is not a whole zip archive of arrays.
_BROKEN_ARCHIVE = (
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


def read_npz(path: Source) -> Table:
    """Read arrays; a matrix such as q becomes the columns q1, q2, ..."""
    return _laid_out(path, _arrays(path))


def _laid_out(path: Source, arrays) -> Table:
    """Make columns of arrays, numbers of joints behind their names."""
    lengths = {
        name: len(values)
        for name, values in arrays.items()
        if values.ndim > 0 and _is_channel(name)
    }
    matrices = any(values.ndim == 2 and len(values) > 1 for values in arrays.values())
    if not lengths and not matrices:
        raise ValueError(
            f"{path}: holds {', '.join(arrays) or 'nothing'}; expected arrays q and "
            "tau of shape (n_samples, n_joints), or columns q1, ..., tau1, ..."
        )
    if not any(name.lower().startswith(("q", "tau")) for name in lengths):
        # Matrices of other names become columns, for a mapping to say what they are.
        lengths = {
            name: len(values)
            for name, values in arrays.items()
            if values.ndim == 2 and len(values) > 1
        } or lengths
    n_rows = lengths.get("q", next(iter(lengths.values())))
    for name, length in lengths.items():
        if length != n_rows:
            raise ValueError(
                f"{path}: array {name!r} has {length} rows, others have {n_rows}; all "
                "channels need one row per sample."
            )
    columns, scalars = {}, {}
    for name, values in arrays.items():
        if values.ndim not in (1, 2) or len(values) != n_rows:
            scalars[name] = values
            continue
        if values.ndim == 1:
            own = {name: values}
        elif values.shape[1] == 1:
            own = {name: values[:, 0]}
        else:
            own = {f"{name}{k + 1}": x for k, x in enumerate(values.T)}
        twice = sorted(columns.keys() & own.keys())
        if twice:
            raise ValueError(
                f"{path}: column {twice[0]!r} is there twice, on its own and in a "
                "matrix; each needs its own name."
            )
        columns.update(own)
    return Table(path=path.shown, columns=columns, scalars=scalars, where=row_in_words)


def _arrays(path: Source) -> dict[str, np.ndarray]:
    """Return the arrays of an npz file, which may be damaged."""
    broken = f"{path}: is no whole npz file; save it anew with numpy.savez."
    # numpy.load would read other formats under this name.
    if not zipfile.is_zipfile(path.file):
        raise ValueError(broken)
    arrays, name = {}, ""
    try:
        with zipfile.ZipFile(path.file) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > LARGEST:
            raise MemoryError(f"{size / (1 << 30):.1f} GiB unpacked")
        with np.load(path.file, allow_pickle=False) as archive:
            for name in archive.files:
                arrays[name] = archive[name]
    except MemoryError as error:
        raise ValueError(
            f"{path}: is too large to be read at once, or damaged ({error}); save a "
            "shorter recording, or this one anew."
        ) from error
    except _BROKEN_ARCHIVE as error:
        if name and "allow_pickle" in str(error):
            raise ValueError(
                f"{path}: array {name!r} holds Python objects and not numbers; save "
                "numeric arrays of one row per sample with numpy.savez."
            ) from error
        raise ValueError(broken) from error
    # A zip archive of other files, such as a spreadsheet, yields bytes.
    if not all(isinstance(array, np.ndarray) for array in arrays.values()):
        raise ValueError(broken)
    return arrays


def _is_channel(name: str) -> bool:
    """Whether a name is one of a channel, which has a value for every row."""
    name = name.lower()
    own = re.fullmatch(r"t|segment|[va]([_.\[(]?\d+[\])]?)?", name)
    return own is not None or name.startswith(("q", "tau"))


# -- npy -------------------------------------------------------------------------------


def read_npy(path: Source) -> Table:
    """Read one array, which must have named fields."""
    try:
        array = np.load(path.file, allow_pickle=False)
    except MemoryError as error:
        raise ValueError(
            f"{path}: is too large to be read at once, or damaged ({error}); save a "
            "shorter recording, or this one anew."
        ) from error
    except _BROKEN_ARCHIVE as error:
        if "allow_pickle" in str(error):
            raise ValueError(
                f"{path}: holds Python objects and not numbers, which are not loaded; "
                "save numeric arrays with numpy.savez(FILE, t=t, q=q, tau=tau)."
            ) from error
        raise ValueError(
            f"{path}: is no whole npy file; save it anew with numpy.save."
        ) from error
    if not isinstance(array, np.ndarray) or array.dtype.names is None:
        shape = getattr(array, "shape", ())
        raise ValueError(
            f"{path}: holds an array of shape {shape} without names, so that nothing "
            "tells positions from torques; expected one with named fields, or "
            "numpy.savez(FILE, t=t, q=q, tau=tau) with q and tau (n_samples, n_joints)."
        )
    return _laid_out(path, {name: array[name] for name in array.dtype.names})


# -- MATLAB ----------------------------------------------------------------------------


def read_mat(path: Source) -> Table:
    """Read the variables of a MATLAB file, also those inside of structures."""
    from scipy.io import loadmat, matlab, whosmat

    broken = (
        f"{path}: is no whole MATLAB file of version 5 to 7.2; write it anew with "
        "save(FILE, 't', 'q', 'tau', '-v7')."
    )
    with path.file.open("rb") as file:
        begin = file.read(128)
    if begin.startswith(b"MATLAB 7.3") or begin.startswith(b"\x89HDF"):
        raise ValueError(
            f"{path}: is a MATLAB file of version 7.3 (HDF5), expected version 5 to "
            "7.2; in MATLAB: save(FILE, 't', 'q', 'tau', '-v7')."
        )
    try:
        # Sizes as its headers tell: what is packed small must not fill the memory.
        sizes = [
            np.prod([float(n) for n in shape]) for _, shape, _ in whosmat(path.file)
        ]
        if 8 * sum(sizes) > LARGEST or path.file.stat().st_size > LARGEST:
            raise MemoryError(f"{8 * sum(sizes) / (1 << 30):.1f} GiB unpacked")
        found = loadmat(path.file, simplify_cells=True)
    except MemoryError as error:
        raise ValueError(
            f"{path}: is too large to be read at once, or damaged ({error}); save a "
            "shorter recording, or this one anew."
        ) from error
    except (matlab.MatReadError, matlab.MatReadWarning) as error:
        raise ValueError(broken) from error
    except (
        *_BROKEN_ARCHIVE,
        TypeError,
        KeyError,
        IndexError,
        NotImplementedError,
        AttributeError,
        UnboundLocalError,
    ) as error:
        raise ValueError(broken) from error
    arrays = dict(_numeric({k: x for k, x in found.items() if k[:2] != "__"}, ""))
    return _laid_out(path, _upright(_without_common_part(arrays)))


def _numeric(values, prefix, depth=0):
    """Yield the arrays of numbers in nested structures, their names with points."""
    for name, value in values.items():
        if isinstance(value, dict) and depth < 8:
            yield from _numeric(value, f"{prefix}{name}.", depth + 1)
            continue
        array = np.asarray(value)
        if array.dtype.kind in "biufU":
            yield f"{prefix}{name}", array


def _without_common_part(arrays):
    """Take the name of the only structure off the names of its fields."""
    parts = {name.rpartition(".")[0] for name in arrays}
    if len(parts) != 1 or parts == {""}:
        return arrays
    return {name.rpartition(".")[2]: x for name, x in arrays.items()}


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
