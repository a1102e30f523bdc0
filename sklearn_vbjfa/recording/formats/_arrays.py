"""Readers of named arrays: npz, npy, MATLAB, JSON, Parquet, Feather and ROS bags."""

import difflib
import json
import re
import zipfile
from collections import Counter
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._table import (
    NAMES_TITLE,
    NotATable,
    RecordingRefused,
    Table,
    check_names,
    check_size,
    imported,
    listed,
    no_rows,
    parsing,
    quoted,
)
from sklearn_vbjfa.recording.formats._text import CUT

# Maximum depth to which nested structures are flattened.
_MAX_DEPTH = 8
# Names of arrays that must have a value for every row.
_CHANNEL = re.compile(r"t|segment|(q|tau|v|a)([_.\[(]?\d+[\])]?)?", re.IGNORECASE)


def table_of(path, columns, **fields) -> Table:
    """Build a table from columns by name, or from a matrix without column names."""
    frame = imported(path, "pandas").DataFrame(columns)
    if isinstance(columns, np.ndarray):
        frame.columns = [str(k + 1) for k in frame]
    frame.index += 1
    return Table(path=path, frame=frame, **fields)


def _flatten(values, depth=0):
    """Flatten nested structures to a dict with dotted names."""
    flat = {}
    for name, value in values.items():
        nested = None
        if isinstance(value, dict):
            nested = {f"{name}.{key}": item for key, item in value.items()}
        elif _are_records(value):
            # Messages contain lists of structures, one for each motor.
            nested = {f"{name}[{k}]": item for k, item in enumerate(value)}
        if nested is None or depth == _MAX_DEPTH:
            flat[name] = value
        else:
            flat |= _flatten(nested, depth + 1)
    return flat


def _strip_common_prefix(columns):
    """Remove the structure's name from names if all belong to the same structure."""
    if len({name.rpartition(".")[0] for name in columns}) == 1:
        return {name.rpartition(".")[2]: x for name, x in columns.items()}
    return columns


def _are_records(value):
    is_list = isinstance(value, list) and len(value) > 0
    return is_list and all(isinstance(x, dict) for x in value)


def _table_of_records(path, records) -> Table:
    """Build a table from rows given as dicts, maybe nested; missing values are nan."""
    records = _with_all_joints([_flatten(record) for record in records])
    names = dict.fromkeys(name for record in records for name in record)
    columns = {name: [record.get(name) for record in records] for name in names}
    return _table_of_arrays(path, _strip_common_prefix(columns))


def _with_all_joints(records):
    """Extend lists by joint to all joints in one order if their names vary."""
    for title in records[0]:
        names = [x.get(title) for x in records]
        if NAMES_TITLE.fullmatch(title) and all(isinstance(x, list) for x in names):
            joints = list(dict.fromkeys(joint for x in names for joint in x))
            for record, own in zip(records, names):
                for key, x in record.items() if own != joints else ():
                    if isinstance(x, list) and len(x) == len(own):
                        record[key] = [dict(zip(own, x)).get(j) for j in joints]
                record[title] = joints
    return records


def _table_of_arrays(path, arrays) -> Table:
    """Build a table from arrays or lists; a matrix such as q becomes q1, q2, ..."""
    arrays = {name: _to_array(path, name, x) for name, x in arrays.items()}
    # Messages contain empty lists for quantities that are not measured.
    arrays = {k: x.squeeze() if x.ndim > 2 else x for k, x in arrays.items() if x.size}
    n_rows = _number_of_rows(path, arrays)
    rows, scalars = {}, {}
    for name, x in arrays.items():
        # Transpose matrices with one column per sample.
        x = x.T if x.ndim == 2 and x.shape[1] == n_rows != len(x) else x
        if x.ndim in (1, 2) and len(x) == n_rows:
            rows[name] = x
        elif x.ndim and _CHANNEL.fullmatch(name):
            raise RecordingRefused(
                f"{path}: array {name!r} has the shape {x.shape}, others have {n_rows} "
                "rows; all channels need one row per sample."
            )
        else:
            scalars[name] = x
    (name, data), *others = rows.items()
    if not (others or data.ndim == 1 or data.shape[1] == 1 or _CHANNEL.fullmatch(name)):
        return table_of(path, data, scalars=scalars)
    columns = []
    for name, x in rows.items():
        matrix = x.reshape(n_rows, -1).T
        names = [f"{name}{k + 1}" for k in range(len(matrix))]
        columns += zip(names if len(matrix) > 1 else [name], matrix)
    check_names(path, [name for name, _ in columns], "on its own and in a matrix has")
    return table_of(path, dict(columns), scalars=scalars)


def _number_of_rows(path, arrays):
    """Return the most frequent length of channels, or of arrays if there are none."""
    # Arrays of text are excluded: they contain column names.
    sized = {name: x for name, x in arrays.items() if x.size > 1 and x.ndim in (1, 2)}
    sized = {name: x for name, x in sized.items() if x.dtype.kind not in "US"}
    named = [x for name, x in sized.items() if _CHANNEL.fullmatch(name)]
    for chosen in (named, [x for x in sized.values() if len(sized) > 1 or x.ndim > 1]):
        if chosen:
            return Counter(max(x.shape) for x in chosen).most_common(1)[0][0]
    raise NotATable(
        f"{path}: holds {listed(arrays) or 'nothing'}; expected arrays q and tau of "
        "shape (n_samples, n_joints), or columns q1, ..., tau1, ..."
    )


def _to_array(path, name, values):
    """Convert a list to an array of str if its first value is, else of float."""
    if isinstance(values, np.ndarray):
        return values.astype(values.dtype.newbyteorder("="), copy=False)
    sample = values
    while isinstance(sample, list) and sample:
        # Lists may be nested: each message contains the names of all joints.
        sample = next((x for x in sample if x is not None), None)
    try:
        return np.array(values, dtype=str if isinstance(sample, str) else float)
    except (TypeError, ValueError, OverflowError) as error:
        raise RecordingRefused(
            f"{path}: {quoted(name)} holds {quoted(sample)} and others that are not "
            "numbers; write one, or equally long lists of them, for each sample."
        ) from error


def read_npz(path) -> Table:
    """Read arrays; a matrix such as q becomes the columns q1, q2, ..."""
    with parsing(path, "npz file", "save it again with numpy.savez."):
        with zipfile.ZipFile(path) as archive:
            check_size(path, sum(member.file_size for member in archive.infolist()))
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    return _table_of_arrays(path, arrays)


def read_npy(path) -> Table:
    """Read one array: a matrix, or named fields."""
    with parsing(path, "npy file", "save it again with numpy.save."):
        array = np.load(path, allow_pickle=False)
    names = array.dtype.names or ()
    return _table_of_arrays(path, {x: array[x] for x in names} or {"": array})


_SAVE = "save(FILE, 't', 'q', 'tau', '-v7')"


def read_mat(path) -> Table:
    """Read the variables of a MATLAB file."""
    from scipy.io import loadmat

    format_name = "MATLAB file of version 5 to 7.2"
    with parsing(path, format_name, f"write it again with {_SAVE}."):
        data = loadmat(path, simplify_cells=True)
    # MATLAB tables and time series are unnamed here; functions contain no numbers.
    data = {name: x for name, x in data.items() if str(name or "__")[:2] != "__"}
    arrays = {name: np.asarray(x) for name, x in _flatten(data).items()}
    for name, x in arrays.items():
        # Cells with text.
        if x.dtype.kind == "O" and all(isinstance(y, str) for y in x.flat):
            arrays[name] = x.astype(str)
    arrays = {name: x for name, x in arrays.items() if x.dtype.kind in "biufU"}
    if not arrays:
        raise NotATable(
            f"{path}: holds no arrays; in MATLAB write those of tables and time "
            f"series: t = T.Time; q = T{{:, 2:7}}; ... {_SAVE}."
        )
    return _table_of_arrays(path, _strip_common_prefix(arrays))


def read_json(path, content) -> Table:
    """Read a list of records or rows, JSON lines, or an object of named arrays."""
    with parsing(path, "JSON file", "write it again."):
        data, is_cut = _parse_values(content.decode("utf-8-sig"))
    data = data[0] if len(data) == 1 else data
    if isinstance(data, dict):
        table = _table_of_object(path, data)
    elif _are_records(data):
        table = _table_of_records(path, data)
    else:
        table = table_of(path, np.atleast_1d(_to_array(path, "the list", data)))
    return replace(table, notes=(*table.notes, *[CUT] * is_cut))


def _parse_values(text):
    """Return the consecutive JSON values, and whether the last one is truncated."""
    values, decode, blank = [], json.JSONDecoder().raw_decode, re.compile(r"\s*")
    start = blank.match(text).end()
    while start < len(text):
        try:
            value, end = decode(text, start)
        except json.JSONDecodeError:
            if len(values) < 2 or "\n" in text[start:]:
                raise
            return values, True
        values.append(value)
        start = blank.match(text, end).end()
    return values, False


def _table_of_object(path, data):
    """Return the table of an object that contains records or arrays."""
    # Data frames written by pandas, orient="split" or "columns".
    keys, rows = {"columns", "data"}, data.get("data")
    if keys <= {*data} <= keys | {"index"} and isinstance(rows, list):
        with parsing(path, "frame of pandas", "write it again."):
            names = list(map(str, data["columns"]))
            check_names(path, names or [""], "has")
            rows = [dict(zip(names, row, strict=True)) for row in rows]
        return _table_of_records(path, rows)
    if all(
        isinstance(x, dict) and {*map(str, range(len(x)))} == {*x}
        for x in data.values()
    ):
        data = {name: [x[str(k)] for k in range(len(x))] for name, x in data.items()}
    lists = [x for x, value in data.items() if _are_records(value)]
    # A single list contains the records, unless these hold longer arrays, as joints do.
    if len(lists) == 1 and _max_length(data[lists[0]][0]) <= len(data[lists[0]]):
        table = _table_of_records(path, data[lists[0]])
        note = f"the records are those of {lists[0]!r}."
        return replace(table, notes=(*table.notes, note))
    for name in lists:
        lengths = {_max_length(value) for value in data[name]}
        if len(lengths) > 1 and _max_length(data) < max(lengths):
            raise ValueError(
                f"{path}: the list {name!r} has {len(data[name])} records with arrays "
                "of different lengths; write one file for each."
            )
    return _table_of_arrays(path, _strip_common_prefix(_flatten(data)))


def _max_length(record):
    return max((len(x) for x in record.values() if isinstance(x, list)), default=0)


PARQUET = (".parquet", ".pq", ".feather", ".arrow")
INFO = "meta/info.json"


def read_parquet(path) -> Table:
    """Read a parquet or feather file, or the episodes of a LeRobot data set.

    Columns of lists are split into one column per entry.
    """
    files = [path] if path.is_file() else sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise no_rows(path / "data")
    dataset = imported(path, "pyarrow.dataset").dataset
    is_parquet = files[0].suffix.lower() in PARQUET[:2]
    with parsing(path, "parquet file of plain columns", "write it again."):
        data = dataset(list(map(str, files)), format=("feather", "parquet")[is_parquet])
        names = data.schema.names
        check_size(path, 8 * len(names) * data.count_rows())
        check_names(path, names or [""], "has")
        arrays = {x: y.to_numpy() for x, y in zip(names, data.to_table().columns)}
    features, columns = _lerobot_features(files[0]), {}
    for name, values in arrays.items():
        lists = values.dtype.kind == "O" and values.size and values[0] is not None
        if lists and {np.shape(x) for x in values} == {(np.size(values[0]),)}:
            matrix = np.stack(list(values)).T
            motors = features.get(name, {}).get("names") or ()
            if isinstance(motors, dict):
                (motors,) = motors.values()
            motors = [str(motor).removesuffix(".pos") for motor in motors]
            motors = motors if len(motors) == len(matrix) else range(len(matrix))
            columns |= {f"{name}.{motor}": x for motor, x in zip(motors, matrix)}
        else:
            columns[name] = values
    return table_of(path, columns)


def _lerobot_features(file):
    """Return the column metadata of a LeRobot data set, {} for other files."""
    for path in (folder / INFO for folder in list(file.resolve().parents)[:4]):
        if path.is_file():
            with parsing(path, "JSON file", "download the data set again."):
                return json.loads(path.read_text(encoding="utf-8"))["features"]
    return {}


BAGS = (".bag", ".db3", ".mcap")
_TYPE = "sensor_msgs/msg/JointState"


def bag_files(folder):
    """Return the bag files in a folder, or the folder if it has metadata."""
    if (folder / "metadata.yaml").is_file():
        return [folder]
    return sorted(x for x in folder.iterdir() if x.suffix.lower() in BAGS)


def read_bag(files, shown, topic) -> Table:
    """Read joint positions and efforts from a bag; nan in messages without them."""
    typesys = imported(shown, "rosbags.typesys")
    AnyReader = imported(shown, "rosbags.highlevel").AnyReader
    remedy = "if it was cut, rosbag reindex, ros2 bag reindex or mcap recover may help."
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with (
        parsing(shown, "bag", remedy),
        AnyReader(files, default_typestore=store) as bag,
    ):
        connections = _connections(bag, shown, topic)
        joints, (q, v, tau), times = _messages(bag, connections)
    topic, valid = connections[0].topic, np.isfinite(q) & np.isfinite(tau)
    if not valid.any():
        raise RecordingRefused(
            f"{shown}: none of the {len(q)} messages of {topic} has positions and "
            "efforts of its joints; record a topic whose effort is filled in."
        )
    mapping = "position [rad or m] as q and effort [N m or N] as tau"
    notes = [f"read from {topic}: {mapping} of {', '.join(joints)}."]
    t, received = times
    if np.ptp(t[valid.any(axis=1)]) == 0:
        t = received
        notes.append("the stamps in the headers stand still: times are the recorder's.")
    numbered = all(name.isdecimal() for name in joints)
    columns = {"t": (t - t[0]) / 1e9}
    for kind, x in (("q", q), ("tau", tau), ("v", v)):
        if np.isfinite(x[valid]).all():
            headers = [f"{kind}{'' if numbered else '_'}{name}" for name in joints]
            columns |= dict(zip(headers, np.where(valid, x, np.nan).T))
    table = table_of(shown, columns, place="message {}", notes=tuple(notes))
    return replace(table, joints=() if numbered else tuple(joints))


def _connections(bag, shown, topic):
    """Return the connections of the requested topic, or of the only one."""
    states = [x for x in bag.connections if x.msgtype == _TYPE and x.msgcount]
    topics = sorted({x.topic for x in states})
    available = ", ".join(sorted({f"{x.topic} ({x.msgtype})" for x in bag.connections}))
    if not topics:
        raise RecordingRefused(
            f"{shown}: holds no joint states: expected a topic of {_TYPE} with "
            f"positions and efforts, it holds {available or 'no topics'}."
        )
    matching = [x for x in topics if topic in (None, x, x.removeprefix("/"))]
    if len(matching) != 1:
        close = difflib.get_close_matches(topic or "/joint_states", topics, 1)
        raise RecordingRefused(
            f"{shown}: give --topic (in Python: topic=...), one of {listed(topics)}; "
            f"it holds {available}.",
            {"topic": close[0]} if close else {},
        )
    return [x for x in states if x.topic == matching[0]]


def _messages(bag, connections):
    """Return joints, q, v and tau (3, n_messages, n_joints), and times (2, n) [ns]."""
    # Missing values are nan; times are those of the header and of the recorder.
    rows, times = [], []
    for connection, received, raw in bag.messages(connections=connections):
        message = bag.deserialize(raw, connection.msgtype)
        # Without names, joints are named by their numbers.
        names = message.name or map(str, range(1, len(message.position) + 1))
        rows.append((tuple(names), message.position, message.velocity, message.effort))
        stamp = message.header.stamp
        times.append((stamp.sec * 10**9 + stamp.nanosec, received))
    kinds = dict.fromkeys(names for names, *_ in rows)
    joints = list(dict.fromkeys(x for names in kinds for x in names))
    indices = {names: [joints.index(x) for x in names] for names in kinds}
    values = np.full((3, len(rows), len(joints)), np.nan)
    for k, (names, *channels) in enumerate(rows):
        for channel, x in zip(values, channels):
            if len(x) == len(names):
                channel[k, indices[names]] = x
    return joints, values, np.array(times).T
