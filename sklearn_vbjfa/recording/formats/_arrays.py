"""Arrays by their names out of npz, npy, MATLAB and JSON files."""

import json
import struct
import tokenize
import zipfile
import zlib
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._table import (
    CUT,
    LARGEST,
    Format,
    Source,
    Table,
    check_memory,
    check_size,
    flattened,
    nameless,
    quoted,
    reading_arrays,
    table_of_arrays,
    table_of_records,
    text_of,
    without_common_part,
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


# -- MATLAB ----------------------------------------------------------------------------

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


# -- JSON ------------------------------------------------------------------------------

# Lists and numbers of Python take so many times the bytes of their text.
_SPREAD = 4


def read_json(path: Source, wanted) -> Table:
    """Read a list of records or rows, one a line or not, or arrays by their names."""
    check_size(path, _SPREAD * path.file.stat().st_size, what="as objects")
    found, notes = _parsed(path, text_of(path))
    if isinstance(found, dict):
        records = _records_in(found)
        if not records:
            trials = _trials_in(found)
            arrays = without_common_part(flattened(found))
            if trials:
                arrays = _one_after_another(path, trials, found[trials])
                notes = (
                    *notes,
                    f"the {len(found[trials])} entries of {trials!r} are one recording "
                    "each.",
                )
            table = table_of_arrays(path, arrays)
            return replace(table, notes=(*table.notes, *notes))
        found = found[records]
        notes = (*notes, f"the records are those of {records!r}.")
    if isinstance(found, list) and found and all(map(_is_row, found)):
        return _rows(path, found, notes)
    for k, record in enumerate(found if isinstance(found, list) else [found]):
        if not isinstance(record, dict) or not record:
            raise ValueError(
                f"{path}: holds {quoted(record)} as record {k + 1}; expected objects "
                'such as {"t": 0.0, "q": [0.1, 0.2], "tau": [1.5, 0.4]}, rows of '
                "numbers, or arrays by their names."
            )
    return replace(table_of_records(path, found), notes=notes)


def _lists_of_objects(found):
    """Return the names of the lists of objects in an object."""
    return [
        name
        for name, one in found.items()
        if isinstance(one, list) and one and all(isinstance(x, dict) for x in one)
    ]


def _records_in(found):
    """Return the name of the only list of records in an object, "" for none."""
    lists = _lists_of_objects(found)
    # A list of joints has arrays in it, not samples.
    if len(lists) != 1 or any(
        isinstance(x, list) and len(x) > len(found[lists[0]])
        for x in found[lists[0]][0].values()
    ):
        return ""
    return lists[0]


def _trials_in(found):
    """Return the name of a list of recordings: arrays that differ in length; or ""."""
    for name in _lists_of_objects(found):
        longest = [max(map(len, _lists(one)), default=0) for one in found[name]]
        beside = max(map(len, _lists(found)))
        if len(set(longest)) > 1 and beside < max(longest):
            return name
    return ""


def _lists(record):
    return [x for x in record.values() if isinstance(x, list)]


def _one_after_another(path, name, records):
    """Return the arrays of recordings end to end, with a column segment."""
    counts = [{len(x) for x in _lists(record)} for record in records]
    channels = {
        tuple(k for k, x in record.items() if isinstance(x, list)) for record in records
    }
    if len(channels) > 1 or any(len(count) != 1 for count in counts):
        raise ValueError(
            f"{path}: the list {name!r} has {len(records)} records with arrays of "
            "different lengths; write one file each, or rows with a column segment."
        )
    found = {k: [x for one in records for x in one[k]] for k in channels.pop()}
    segment = np.repeat(np.arange(len(records)), [count.pop() for count in counts])
    return {**found, "segment": segment}


def _is_row(one):
    return isinstance(one, list) and all(isinstance(x, (int, float)) for x in one)


def _rows(path, found, notes):
    """Make a table without names of rows of numbers, or refuse rows that differ."""
    lengths = [len(row) for row in found]
    usual = max(set(lengths), key=lengths.count)
    if not usual or len(set(lengths)) > 1:
        k = next((k for k, n in enumerate(lengths) if n != usual or not n), 0)
        raise ValueError(
            f"{path}: record {k + 1} has {lengths[k]} numbers, others have {usual}; "
            "all need as many."
        )
    return nameless(path, np.array(found, dtype=float), notes=notes)


def _parsed(path, text):
    """Return what a text says, all of it or a list of its lines, and notes."""
    try:
        return json.loads(text), ()
    except (ValueError, RecursionError) as error:
        lines = text.strip().split("\n")
        if getattr(error, "msg", "") != "Extra data" or len(lines) < 2:
            raise _broken(path, error) from error
    found = []
    for k, line in enumerate(lines):
        try:
            found += [json.loads(line)] if line.strip() else []
        except (ValueError, RecursionError) as error:
            if k == len(lines) - 1 and not text.endswith("\n"):
                return found, (CUT,)
            raise _broken(path, error, k) from error
    return found, ()


def _broken(path, error, line=0):
    """Return the refusal of what is not JSON, with the line from which on."""
    where = f" in line {line + getattr(error, 'lineno', 1)}"
    return ValueError(
        f"{path}: is not a complete JSON file ({getattr(error, 'msg', error)}{where}); "
        "write it anew."
    )


JSON = Format(
    name="JSON",
    endings=(".json", ".jsonl", ".ndjson"),
    shown=(".json", ".jsonl"),
    read=read_json,
    begins=tuple((begin, ".json") for begin in (b"{", b"[{", b"[\n", b"[\r", b"[ ")),
)
