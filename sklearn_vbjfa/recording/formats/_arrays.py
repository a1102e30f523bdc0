"""Arrays and records by their names: npz, npy, MATLAB and JSON."""

import json
import struct
import zipfile
import zlib
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._table import (
    CUT,
    LARGEST,
    Format,
    NotATable,
    Source,
    Table,
    check_size,
    flattened,
    nameless,
    no_rows,
    parsing,
    quoted,
    table_of_arrays,
    table_of_records,
    without_common_part,
)

# -- NumPy -----------------------------------------------------------------------------


def read_npz(path: Source, wanted) -> Table:
    """Read arrays; a matrix such as q becomes the columns q1, q2, ..."""
    with parsing(path, "npz file", "save it again with numpy.savez"):
        with zipfile.ZipFile(path.file) as archive:
            check_size(path, sum(member.file_size for member in archive.infolist()))
        with np.load(path.file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        # A zip archive of other files, such as a spreadsheet, yields bytes.
        if not all(isinstance(array, np.ndarray) for array in arrays.values()):
            raise ValueError("it holds other files than arrays")
    return table_of_arrays(path, arrays)


def read_npy(path: Source, wanted) -> Table:
    """Read one array: a matrix, or named fields."""
    with parsing(path, "npy file", "save it again with numpy.save"):
        array = np.lib.format.open_memmap(path.file, mode="r")
    if array.ndim == 2 and array.dtype.kind in "biuf":
        return nameless(path, np.array(array))
    if array.dtype.names is None:
        raise ValueError(
            f"{path}: holds an array of shape {array.shape} without names; expected "
            "one with named fields, or numpy.savez(FILE, t=t, q=q, tau=tau) with q and "
            "tau (n_samples, n_joints)."
        )
    return table_of_arrays(path, {x: np.array(array[x]) for x in array.dtype.names})


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
_SAVE = "save(FILE, 't', 'q', 'tau', '-v7')"


def read_mat(path: Source, wanted) -> Table:
    """Read the variables of a MATLAB file."""
    from scipy.io import loadmat

    with path.file.open("rb") as file:
        begin = file.read(128)
    if begin.startswith((b"MATLAB 7.3", b"\x89HDF")):
        raise ValueError(
            f"{path}: is a MATLAB file of version 7.3 (HDF5), expected version 5 to "
            f"7.2; in MATLAB: {_SAVE}."
        )
    what = "MATLAB file of version 5 to 7.2"
    with parsing(path, what, f"write it again with {_SAVE}"):
        # Numbers may be stored as bytes, and become eight of them.
        check_size(path, 8 * _unpacked_size(path.file))
        found = loadmat(path.file, simplify_cells=True)
    # Objects of MATLAB's own classes (tables, time series) have no name here.
    objects = [x for x in found.values() if _is_object(x)]
    found = {name: x for name, x in found.items() if str(name or "__")[:2] != "__"}
    arrays = without_common_part(flattened(found, _is_usable))
    if objects and not arrays:
        raise ValueError(
            f"{path}: holds objects of MATLAB, such as a table or time series, and no "
            "arrays; in MATLAB write its numbers: t = T.Time; q = T{:, 2:7}; ... "
            f"{_SAVE}."
        )
    # A cell of texts is a list of them.
    arrays = {
        name: np.asarray(x, dtype=str if _is_texts(x) else None)
        for name, x in arrays.items()
    }
    table = table_of_arrays(path, arrays)
    note = f"{len(objects)} object(s) of MATLAB's own classes are left out."
    return replace(table, notes=(*table.notes, note)) if objects else table


def _is_usable(value):
    usable = np.asarray(value).dtype.kind in "biufU" or _is_texts(value)
    return usable and not _is_object(value)


def _is_texts(value):
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
    with parsing(path, "JSON file", "write it again"):
        found, notes = _parsed(path.file.read_text(encoding="utf-8-sig"))
    if found is None:
        raise no_rows(path)
    if isinstance(found, dict):
        table, note = _of_object(path, found)
        return replace(table, notes=(*table.notes, *notes, *note))
    rows = found if isinstance(found, list) and found else [found]
    if all(map(_is_row, rows)):
        return nameless(path, _matrix(path, rows), notes=notes)
    for k, record in enumerate(rows):
        if not isinstance(record, dict) or not record:
            raise NotATable(
                f"{path}: holds {quoted(record)} as record {k + 1}; expected objects "
                'such as {"t": 0.0, "q": [0.1, 0.2], "tau": [1.5, 0.4]}, rows of '
                "numbers, or arrays by their names."
            )
    return replace(table_of_records(path, rows), notes=notes)


def _parsed(text):
    """Return the content of a text, all of it or a list of its lines, and notes."""
    if not text.strip():
        return None, ()
    try:
        return json.loads(text), ()
    except json.JSONDecodeError as error:
        lines = text.strip().split("\n")
        if error.msg != "Extra data" or len(lines) < 2:
            raise
    found = []
    for k, line in enumerate(lines):
        try:
            found += [json.loads(line)] if line.strip() else []
        except json.JSONDecodeError as error:
            if k == len(lines) - 1 and not text.endswith("\n"):
                return found, (CUT,)
            raise ValueError(f"{error.msg} in line {k + 1}") from error
    return found, ()


def _of_object(path, found):
    """Return the table of an object and notes: records in it, trials, or arrays."""
    lists = [x for x, one in found.items() if _is_list_of_records(one)]
    # The records are those of the only list, unless they have arrays, as joints do.
    if len(lists) == 1 and _longest(found[lists[0]][0]) <= len(found[lists[0]]):
        (name,) = lists
        note = f"the records are those of {name!r}."
        return table_of_records(path, found[name]), (note,)
    for name in lists:
        lengths = {_longest(one) for one in found[name]}
        if len(lengths) > 1 and _longest(found) < max(lengths):
            arrays = _one_after_another(path, name, found[name])
            note = f"the {len(found[name])} entries of {name!r} are one recording each."
            return table_of_arrays(path, arrays), (note,)
    return table_of_arrays(path, without_common_part(flattened(found))), ()


def _is_list_of_records(one):
    return isinstance(one, list) and one and all(isinstance(x, dict) for x in one)


def _longest(record):
    return max((len(x) for x in record.values() if isinstance(x, list)), default=0)


def _one_after_another(path, name, records):
    """Return the arrays of recordings end to end, with a column segment."""
    arrays = [{k: x for k, x in one.items() if isinstance(x, list)} for one in records]
    counts = [{len(x) for x in one.values()} for one in arrays]
    if len({tuple(x) for x in arrays}) > 1 or any(len(x) != 1 for x in counts):
        raise ValueError(
            f"{path}: the list {name!r} has {len(records)} records with arrays of "
            "different lengths; write one file each, or rows with a column segment."
        )
    found = {key: [x for one in arrays for x in one[key]] for key in arrays[0]}
    segment = np.repeat(np.arange(len(records)), [count.pop() for count in counts])
    return {**found, "segment": segment}


def _is_row(one):
    return isinstance(one, list) and all(isinstance(x, (int, float)) for x in one)


def _matrix(path, rows):
    """Return rows of numbers as a matrix; refuse rows that differ in length."""
    lengths = [len(row) for row in rows]
    usual = max(set(lengths), key=lengths.count)
    odd = [k for k, n in enumerate(lengths) if n != usual or not n]
    if odd:
        raise ValueError(
            f"{path}: record {odd[0] + 1} has {lengths[odd[0]]} numbers, others have "
            f"{usual}; all need as many."
        )
    return np.array(rows, dtype=float)


JSON = Format(
    name="JSON",
    endings=(".json", ".jsonl", ".ndjson"),
    shown=(".json", ".jsonl"),
    read=read_json,
    begins=tuple((begin, ".json") for begin in (b"{", b"[{", b"[\n", b"[\r", b"[ ")),
)
