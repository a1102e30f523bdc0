"""Arrays and records by their names: npz, npy, MATLAB and JSON."""

import json
import re
import struct
import zipfile
import zlib
from collections import Counter
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording import _table
from sklearn_vbjfa.recording._table import (
    NotATable,
    Source,
    Table,
    check_names,
    check_size,
    listed,
    no_rows,
    pandas_of,
    parsing,
    quoted,
)
from sklearn_vbjfa.recording.formats._text import CUT

# Nested structures are followed to this depth.
_DEEPEST = 8
# Names of arrays that have a value for every row.
_CHANNEL = re.compile(r"t|segment|(q|tau|v|a)([_.\[(]?\d+[\])]?)?", re.IGNORECASE)


# -- arrays and records as tables ------------------------------------------------------


def table_of(path: Source, columns, **known) -> Table:
    """Make a table of columns by name, or of a matrix whose columns have no names."""
    frame = pandas_of(path).DataFrame(columns)
    if isinstance(columns, np.ndarray):
        frame.columns = [str(k + 1) for k in frame]
        known["nameless"] = True
    frame.index += 1
    return Table(path=path.shown, frame=frame, **known)


def _flattened(values, keep=lambda value: True, depth=0):
    """Return the content of nested structures, names with points."""
    found = {}
    for name, value in values.items():
        inside = None
        if isinstance(value, dict):
            inside = {f"{name}.{key}": one for key, one in value.items()}
        elif _is_list_of(dict, value):
            # Messages have a list of structures, one for each motor.
            inside = {f"{name}[{k}]": one for k, one in enumerate(value)}
        if inside is not None and depth < _DEEPEST:
            found |= _flattened(inside, keep, depth + 1)
        elif keep(value):
            found[name] = value
    return found


def _without_common_part(found):
    """Remove the name of the only structure from the names inside it."""
    if len({name.rpartition(".")[0] for name in found}) == 1:
        return {name.rpartition(".")[2]: x for name, x in found.items()}
    return found


def _is_list_of(kind, value):
    is_list = isinstance(value, list) and len(value) > 0
    return is_list and all(isinstance(x, kind) for x in value)


def _table_of_records(path: Source, records) -> Table:
    """Make columns of rows, each a dict, maybe nested; what a row lacks is nan."""
    records = [_flattened(record) for record in records]
    names = dict.fromkeys(name for record in records for name in record)
    columns = {name: [record.get(name) for record in records] for name in names}
    return _table_of_arrays(path, _without_common_part(columns))


def _table_of_arrays(path: Source, arrays) -> Table:
    """Make columns of arrays or lists; a matrix such as q becomes q1, q2, ..."""
    arrays = {name: _array(path, name, x) for name, x in arrays.items()}
    # Messages have empty lists for what is not measured.
    arrays = _upright({name: x for name, x in arrays.items() if x.size})
    arrays, notes = _with_names_beside(path, arrays)
    n_rows = _number_of_rows(path, arrays)
    rows = {
        name: x for name, x in arrays.items() if x.ndim in (1, 2) and len(x) == n_rows
    }
    scalars = {name: x for name, x in arrays.items() if name not in rows}
    for name, x in scalars.items():
        if x.ndim in (1, 2) and _CHANNEL.fullmatch(name):
            raise ValueError(
                f"{path}: array {name!r} has {len(x)} rows, others have {n_rows}; all "
                "channels need one row per sample."
            )
    (name, only), *others = rows.items()
    if not (others or only.ndim == 1 or only.shape[1] == 1 or _CHANNEL.fullmatch(name)):
        return table_of(path, only, scalars=scalars)
    columns = []
    for name, x in rows.items():
        matrix = x.reshape(n_rows, -1).T
        names = [f"{name}{k + 1}" for k in range(len(matrix))]
        columns += zip(names if len(matrix) > 1 else [name], matrix)
    check_names(path, [name for name, _ in columns], "on its own and in a matrix has")
    left = [name for name, x in scalars.items() if x.ndim and len(x) > n_rows // 2]
    if left:
        notes += (f"array(s) {listed(left)} have not {n_rows} rows: left out.",)
    return table_of(path, dict(columns), scalars=scalars, notes=notes)


def _upright(arrays):
    """Turn matrices that have one column per sample."""
    # Texts are names of columns, and as many as these.
    numbers = [x for x in arrays.values() if x.ndim and x.dtype.kind not in "US"]
    lengths = [max(x.shape) for x in numbers if x.size > 1]
    n_rows = max(set(lengths), key=lengths.count, default=0)
    return {
        name: x.T if x.ndim == 2 and x.shape[1] == n_rows != x.shape[0] else x
        for name, x in arrays.items()
    }


def _number_of_rows(path, arrays):
    """Return the length of the channels: of q, of channels, of matrices, of most."""
    sized = {name: x for name, x in arrays.items() if x.ndim in (1, 2) and len(x) > 1}
    for chosen in (
        [x for name, x in sized.items() if name.lower() == "q"],
        [x for name, x in sized.items() if _CHANNEL.fullmatch(name)],
        [x for x in sized.values() if x.ndim == 2],
        [x for x in sized.values() if len(sized) > 1],
    ):
        if chosen:
            return Counter(map(len, chosen)).most_common(1)[0][0]
    raise NotATable(
        f"{path}: holds {listed(arrays) or 'nothing'}; expected arrays q and tau of "
        "shape (n_samples, n_joints), or columns q1, ..., tau1, ...",
    )


def _with_names_beside(path, arrays):
    """Make columns of the only matrix if a list has their names; notes."""
    # As data frames are split, and as loggers write a matrix and its names.
    matrices = [name for name, x in arrays.items() if x.ndim == 2 and len(x) > 1]
    if len(matrices) != 1 or _CHANNEL.fullmatch(matrices[0]):
        return arrays, ()
    (name,) = matrices
    for key, x in arrays.items():
        if x.dtype.kind not in "US" or x.shape != arrays[name].shape[1:]:
            continue
        # Bytes are text too; MATLAB fills names up with blanks.
        texts = np.char.decode(x, "utf-8", "replace") if x.dtype.kind == "S" else x
        names = [str(text).strip() for text in texts]
        rest = {k: one for k, one in arrays.items() if k not in (key, name)}
        check_names(path, [*names, *rest], f"the names in {key!r} have")
        note = f"the columns of {name!r} are called by the names in {key!r}."
        return {**rest, **dict(zip(names, arrays[name].T))}, (note,)
    return arrays, ()


def _array(path, name, values):
    """Make an array of a list; nothing is nan, and a column of text stays text."""
    if isinstance(values, np.ndarray):
        return values.astype(values.dtype.newbyteorder("="), copy=False)
    first = values
    while isinstance(first, list) and first:
        # Messages name all joints in each.
        first = next((x for x in first if x is not None), None)
    try:
        return np.array(values, dtype=str if isinstance(first, str) else float)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(
            f"{path}: {quoted(name)} holds {quoted(first)} and others that are not "
            "numbers, or lists of other lengths; write one number, or equally long "
            "lists of them, for each sample."
        ) from error


# -- NumPy -----------------------------------------------------------------------------


def read_npz(path: Source) -> Table:
    """Read arrays; a matrix such as q becomes the columns q1, q2, ..."""
    with parsing(path, "npz file", "save it again with numpy.savez."):
        with zipfile.ZipFile(path.file) as archive:
            check_size(path, sum(member.file_size for member in archive.infolist()))
        with np.load(path.file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        # A zip archive of other files, such as a spreadsheet, yields bytes.
        if not all(isinstance(array, np.ndarray) for array in arrays.values()):
            raise ValueError("it holds other files than arrays")
    return _table_of_arrays(path, arrays)


def read_npy(path: Source) -> Table:
    """Read one array: a matrix, or named fields."""
    with parsing(path, "npy file", "save it again with numpy.save."):
        array = np.lib.format.open_memmap(path.file, mode="r")
    if array.ndim == 2 and array.dtype.kind in "biuf":
        return table_of(path, np.array(array))
    if array.dtype.names is None:
        raise ValueError(
            f"{path}: holds an array of shape {array.shape} without names; expected "
            "one with named fields, or numpy.savez(FILE, t=t, q=q, tau=tau)."
        )
    return _table_of_arrays(path, {x: np.array(array[x]) for x in array.dtype.names})


# -- MATLAB ----------------------------------------------------------------------------

# Type of a packed variable, as its tag has it, and the bytes that are unpacked at once.
_PACKED, _CHUNK = 15, 1 << 20
_SAVE = "save(FILE, 't', 'q', 'tau', '-v7')"


def read_mat(path: Source) -> Table:
    """Read the variables of a MATLAB file."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    with path.file.open("rb") as file:
        begin = file.read(128)
    if begin.startswith((b"MATLAB 7.3", b"\x89HDF")):
        raise ValueError(
            f"{path}: is a MATLAB file of version 7.3 (HDF5), expected version 5 to "
            f"7.2; in MATLAB: {_SAVE}."
        )
    what = "MATLAB file of version 5 to 7.2"
    with parsing(path, what, f"write it again with {_SAVE}."):
        # Numbers may be stored as bytes, and become eight of them.
        check_size(path, 8 * _unpacked_size(path.file))
        found = loadmat(path.file, simplify_cells=True)
    # Tables, time series and functions have no name here, or no numbers.
    kinds = (MatlabOpaque, MatlabFunction)
    objects = sum(isinstance(x, kinds) for x in found.values())
    found = {name: x for name, x in found.items() if str(name or "__")[:2] != "__"}
    arrays = _without_common_part(_flattened(found, _is_usable))
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
    table = _table_of_arrays(path, arrays)
    note = f"{objects} object(s) of MATLAB's own classes are left out."
    return replace(table, notes=(*table.notes, note)) if objects else table


def _is_usable(value):
    return np.asarray(value).dtype.kind in "biufU" or _is_texts(value)


def _is_texts(value):
    is_cell = isinstance(value, np.ndarray) and value.dtype == object
    return is_cell and _is_list_of(str, value.ravel().tolist())


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
                while chunk and size <= _table.LARGEST:
                    size += len(unpacker.decompress(chunk, _CHUNK))
                    chunk = unpacker.unconsumed_tail
    return size


# -- JSON ------------------------------------------------------------------------------

# Lists and numbers of Python take so many times the bytes of their text.
_SPREAD = 4


def read_json(path: Source) -> Table:
    """Read a list of records or rows, one a line or not, or arrays by their names."""
    check_size(path, _SPREAD * path.file.stat().st_size, what="as objects")
    with parsing(path, "JSON file", "write it again."):
        found, notes = _parsed(path.file.read_text(encoding="utf-8-sig"))
    if found is None:
        raise no_rows(path)
    rows = found if isinstance(found, list) and found else [found]
    if isinstance(found, dict):
        table = _table_of_object(path, found)
    elif _is_list_of(list, rows):
        table = table_of(path, _array(path, "the list", rows))
    elif _is_list_of(dict, rows):
        table = _table_of_records(path, rows)
    else:
        odd = next(x for x in rows if not isinstance(x, dict))
        raise NotATable(
            f"{path}: holds {quoted(odd)}; expected objects such as "
            '{"t": 0.0, "q": [0.1, 0.2], "tau": [1.5, 0.4]}, rows of numbers, or '
            "arrays by their names."
        )
    return replace(table, notes=(*table.notes, *notes))


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


def _table_of_object(path, found):
    """Return the table of an object: records in it, recordings, or arrays."""
    lists = [x for x, one in found.items() if _is_list_of(dict, one)]
    # The records are those of the only list, unless they have arrays, as joints do.
    if len(lists) == 1 and _longest(found[lists[0]][0]) <= len(found[lists[0]]):
        table = _table_of_records(path, found[lists[0]])
        note = f"the records are those of {lists[0]!r}."
        return replace(table, notes=(*table.notes, note))
    for name in lists:
        lengths = {_longest(one) for one in found[name]}
        if len(lengths) > 1 and _longest(found) < max(lengths):
            table = _table_of_arrays(path, _end_to_end(path, name, found[name]))
            note = f"the {len(found[name])} entries of {name!r} are one recording each."
            return replace(table, notes=(*table.notes, note))
    return _table_of_arrays(path, _without_common_part(_flattened(found)))


def _longest(record):
    return max((len(x) for x in record.values() if isinstance(x, list)), default=0)


def _end_to_end(path, name, records):
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
