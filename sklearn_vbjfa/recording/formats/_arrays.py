"""Records by their names: npz, npy, MATLAB, JSON, Parquet, Feather and ROS bags."""

import difflib
import json
import re
import shlex
import struct
import zipfile
import zlib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from sklearn_vbjfa.recording import _table
from sklearn_vbjfa.recording._table import (
    LARGEST,
    Loss,
    NotATable,
    RecordingRefused,
    Source,
    Table,
    check_names,
    check_size,
    listed,
    missing,
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


PARQUET = (".parquet", ".pq", ".feather", ".arrow")
_INFO = Path("meta") / "info.json"


def read_parquet(path: Source) -> Table:
    """Read a parquet or feather file; lists become columns with numbers."""
    return table_of(path, _columns(path, _lerobot_info(path.file)))


def read_lerobot(folder: Path) -> Table:
    """Read all episodes of a LeRobot data set."""
    files = sorted((folder / "data").rglob("*.parquet"))
    if not files:
        raise ValueError(
            f"{folder}: is a LeRobot data set without parquet files in its folder data;"
            " expected data/chunk-000/*.parquet (is it downloaded completely?)."
        )
    size = sum(file.stat().st_size for file in files)
    check_size(folder, size, f"give one of them, such as {files[0]}", "of files")
    info = _lerobot_info(files[0])
    parts = [_columns(Source(x, x), info) for x in files]
    shared = [x for x in parts[0] if all(x in part for part in parts)]
    columns = {x: np.concatenate([part[x] for part in parts]) for x in shared}
    return table_of(Source(folder, folder), columns)


def _columns(path, info):
    """Return the columns of a file as arrays, lists of numbers as columns each."""
    try:
        import pyarrow
        from pyarrow import ipc, parquet
    except ImportError as error:
        raise missing(path, "pyarrow", "parquet files need", "parquet") from error
    with parsing(path, "parquet file of plain columns", "write it again."):
        if path.file.suffix.lower() in PARQUET[:2]:
            with parquet.ParquetFile(path.file) as file:
                groups = map(file.metadata.row_group, range(file.num_row_groups))
                check_size(path, sum(group.total_byte_size for group in groups))
                read = file.read()
        else:
            with ipc.open_file(path.file) as file:
                batches = []
                for k in range(file.num_record_batches):
                    batches.append(file.get_batch(k))
                    check_size(path, sum(one.nbytes for one in batches))
                read = pyarrow.Table.from_batches(batches, file.schema)
        arrays = [column.to_numpy() for column in read.columns]
    check_names(path, read.column_names or [""], "has")
    found = {}
    for name, values in zip(read.column_names, arrays):
        lists = values.dtype.kind == "O" and values.size and values[0] is not None
        if lists and {np.shape(x) for x in values} == {(np.size(values[0]),)}:
            matrix = np.stack(list(values))
            motors = _motors(info, name)
            if len(motors) != matrix.shape[1]:
                motors = range(matrix.shape[1])
            found |= {f"{name}.{motor}": x for motor, x in zip(motors, matrix.T)}
        else:
            found[name] = values
    return found


def _lerobot_info(file):
    """Return what meta/info.json above a parquet file says, a dict."""
    for path in (folder / _INFO for folder in list(file.resolve().parents)[:4]):
        if path.is_file():
            with parsing(path, "JSON file", "download the data set again."):
                info = json.loads(path.read_text(encoding="utf-8"))
            return info if isinstance(info, dict) else {}
    return {}


def _motors(info, name):
    """Return the names of the motors in a column of lists, [] if unknown."""
    names = info
    for key in ("features", name, "names"):
        names = names.get(key) if isinstance(names, dict) else None
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    if not isinstance(names, list):
        return []
    return [str(motor).removesuffix(".pos") for motor in names]


# What repairs a bag that was cut, by its ending.
BAGS = {
    ".bag": "rosbag reindex {}",
    ".db3": "sqlite3 {} .recover | sqlite3 whole.db3",
    ".mcap": "mcap recover {} -o whole.mcap",
}
_TYPE = "sensor_msgs/msg/JointState"


def bag_files(folder):
    """Return the files of a bag in a folder, the folder itself if it is needed."""
    if _packs_messages(folder):
        return [folder]
    for ending in BAGS:
        files = [*folder.glob(f"*{ending}"), *folder.glob(f"*{ending}.zst*")]
        if files:
            return sorted(files)
    return []


def _packs_messages(folder):
    """Whether the description of a bag says that each message is packed."""
    try:
        text = (folder / "metadata.yaml").read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    return bool(re.search(r"compression_mode:\s*[\"']?message\b", text, re.IGNORECASE))


def read_bag(files, shown, topic, joints) -> Table:
    """Read positions and efforts of the joints in a bag."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise missing(shown, "rosbags", "bags need", "bags") from error
    # A temporary copy is not repaired.
    first = files[0] if files[0].is_relative_to(shown) else shown
    repair = BAGS.get(files[0].suffix.lower(), "ros2 bag reindex {}")
    remedy = "it may be cut in the middle, what is left may be saved: "
    remedy += repair.format(shlex.quote(str(first)))
    # Of packed messages the folder has the compression.
    files = [shown.parent] if _packs_messages(shown.parent) else files
    store = get_typestore(Stores.ROS2_HUMBLE)
    with (
        parsing(shown, "bag", remedy),
        AnyReader(files, default_typestore=store) as bag,
    ):
        connections = _connections(bag, shown, topic, joints)
        frame, clock = _messages(bag, shown, connections)
        return _joint_states(shown, connections[0].topic, frame, clock, joints)


# -- messages as rows ------------------------------------------------------------------


def _messages(bag, shown, connections):
    """Return what messages say, a row each, columns (channel, joint), and times."""
    pandas = pandas_of(shown)
    count = sum(x.msgcount for x in connections)
    if 200 * count > LARGEST:
        raise RecordingRefused(
            f"{shown}: has {count} messages, too many to be read at once; cut the bag "
            "into shorter ones."
        )
    kinds: dict = {}
    messages = bag.messages(connections=connections)
    for number, (connection, received, raw) in enumerate(messages, start=1):
        message = bag.deserialize(raw, connection.msgtype)
        # Without names the numbers of the joints must do.
        count = len(message.position)
        joints = tuple(message.name) or tuple(str(k + 1) for k in range(count))
        known = {"q": message.position, "v": message.velocity, "tau": message.effort}
        channels = {k: x for k, x in known.items() if len(x) == len(joints) > 0}
        stamp = message.header.stamp
        times = number, stamp.sec * 10**9 + stamp.nanosec, received
        kind = kinds.setdefault((joints, tuple(channels)), [])
        kind.append((times, np.concatenate([[], *channels.values()])))
    frames, clocks = [], []
    for (joints, channels), rows in kinds.items():
        columns = pandas.MultiIndex.from_product([channels or ["none"], joints])
        times, values = zip(*rows)
        clock = pandas.DataFrame(times, columns=["number", "stamp", "received"])
        clocks.append(clock.set_index("number"))
        if channels:
            frames.append(pandas.DataFrame(values, clocks[-1].index, columns))
    clock = pandas.concat(clocks).sort_index()
    frame = pandas.concat(frames) if frames else pandas.DataFrame()
    return frame.reindex(clock.index), clock


def _joint_states(shown, topic, frame, clock, wanted):
    """Make a table of the joints that give most samples."""
    known = frame[[]]
    if {"q", "tau"} <= set(frame.columns.get_level_values(0)):
        known = np.isfinite(frame["q"]) & np.isfinite(frame["tau"])
        known = known.loc[:, known.any()]
    if known.empty:
        raise RecordingRefused(
            f"{shown}: none of the {len(clock)} messages of {topic} has positions and "
            "efforts of its joints; record a topic whose effort is filled in."
        )
    if known.columns.isin(wanted).any():
        known = known.loc[:, known.columns.isin(wanted)]
    # Joints that come together, the set of them that gives most samples.
    sets = {tuple(known.columns[row]): None for row in np.unique(known, axis=0)}
    best = max(sets, key=lambda x: len(x) * known[[*x]].all(axis=1).sum())
    joints = [x for x in frame["q"] if x in best]
    rows = known[joints].all(axis=1)
    notes = [
        f"read from {topic}: position [rad or m] as q and effort [N m or N] as tau of "
        f"{', '.join(joints)}."
    ]
    others = sorted(set(frame["q"]) - set(joints))
    if others:
        travel = np.nan_to_num((frame["q"].max() - frame["q"].min())[others].max())
        note = (
            f"joint(s) {listed(others)} of {topic} left out: the robot has none of "
            "that name, or they come in other messages, or without numbers, and move "
            f"there by up to {travel:.3g} rad or m."
        )
        notes.append(Loss(note) if {*others} & {*wanted} else note)
    if not rows.all():
        # Messages of other joints are no loss.
        lost = frame["q"][joints].notna().any(axis=1).sum() > rows.sum()
        note = (
            f"{(~rows).sum()} of {rows.size} messages of {topic} lack some of the "
            "joints taken, or numbers of theirs, and are left out."
        )
        notes.append(Loss(note) if lost else note)
    frame, clock, channels = frame[rows], clock[rows], ["q", "tau"]
    if "v" in frame and set(joints) <= set(frame["v"]):
        channels += ["v"] * bool(np.isfinite(frame["v"][joints]).all(axis=None))
    # Times are those of the headers, unless these stand still.
    times = clock.stamp
    if times.nunique() < 2:
        notes.append(
            "the stamps in the headers stand still; times are those of the recorder."
        )
        times = clock.received
    numbered = all(name.isdecimal() for name in joints)
    columns = {"t": (times - times.iloc[0]) / 1e9}
    for channel in channels:
        mark = "" if numbered else "_"
        columns |= {f"{channel}{mark}{name}": frame[channel][name] for name in joints}
    return Table(
        path=shown,
        frame=pandas_of(shown).DataFrame(columns),
        place="message {}",
        joints=() if numbered else tuple(joints),
        notes=tuple(notes),
    )


# -- which topic -----------------------------------------------------------------------


def _connections(bag, shown, topic, joints):
    """Return the connections of the topic that was asked for, or of the only one."""
    states = [x for x in bag.connections if x.msgtype == _TYPE and x.msgcount]
    topics = sorted({x.topic for x in states})
    if topic is not None:
        chosen = [x for x in states if x.topic in (topic, f"/{topic}")]
        if chosen:
            return chosen
        near = difflib.get_close_matches(topic, topics, 1)
        near = topics if len(topics) == 1 else near
        raise RecordingRefused(
            f"{shown}: has no joint states ({_TYPE}) in {topic}, {_all(bag)}.",
            {"topic": near[0]} if near else {},
        )
    if not topics:
        raise RecordingRefused(
            f"{shown}: holds no joint states: expected a topic of {_TYPE} with "
            f"positions and efforts, {_all(bag)}; record /joint_states."
        )
    if len(topics) > 1:
        able = [x for x in topics if _has_joints(bag, states, x, joints)]
        if len(able) != 1:
            raise RecordingRefused(
                f"{shown}: holds {len(topics)} topics of joint states: "
                f"{listed(topics)}; give --topic with one of them (in Python: "
                "topic=...).",
                {"topic": (able or topics)[0]},
            )
        topics = able
    return [x for x in states if x.topic == topics[0]]


def _has_joints(bag, states, topic, joints):
    """Whether the first message of a topic has efforts of joints of the robot."""
    chosen = [x for x in states if x.topic == topic]
    connection, _, raw = next(bag.messages(connections=chosen))
    message = bag.deserialize(raw, connection.msgtype)
    known = not joints or set(message.name) & set(joints)
    return bool(known) and len(message.effort) > 0


def _all(bag):
    topics = sorted({f"{x.topic} ({x.msgtype})" for x in bag.connections})
    return f"it holds {listed(topics) or 'no topics'}"
