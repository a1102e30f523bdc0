"""Records by their names: npz, npy, MATLAB, JSON, Parquet, Feather and ROS bags."""

import difflib
import json
import re
import zipfile
from collections import Counter
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._table import (
    Loss,
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

# Nested structures are followed to this depth.
_DEEPEST = 8
# Names of arrays that have a value for every row.
_CHANNEL = re.compile(r"t|segment|(q|tau|v|a)([_.\[(]?\d+[\])]?)?", re.IGNORECASE)


# -- arrays and records as tables ------------------------------------------------------


def table_of(path, columns, **known) -> Table:
    """Make a table of columns by name, or of a matrix whose columns have no names."""
    frame = imported(path, "pandas").DataFrame(columns)
    if isinstance(columns, np.ndarray):
        frame.columns = [str(k + 1) for k in frame]
    frame.index += 1
    return Table(path=path, frame=frame, **known)


def _flattened(values, depth=0):
    """Return the content of nested structures, names with points."""
    found = {}
    for name, value in values.items():
        inside = None
        if isinstance(value, dict):
            inside = {f"{name}.{key}": one for key, one in value.items()}
        elif _are_records(value):
            # Messages have a list of structures, one for each motor.
            inside = {f"{name}[{k}]": one for k, one in enumerate(value)}
        if inside is None or depth == _DEEPEST:
            found[name] = value
        else:
            found |= _flattened(inside, depth + 1)
    return found


def _without_common_part(found):
    """Remove the name of the only structure from the names inside it."""
    if len({name.rpartition(".")[0] for name in found}) == 1:
        return {name.rpartition(".")[2]: x for name, x in found.items()}
    return found


def _are_records(value):
    is_list = isinstance(value, list) and len(value) > 0
    return is_list and all(isinstance(x, dict) for x in value)


def _table_of_records(path, records) -> Table:
    """Make columns of rows, each a dict, maybe nested; what a row lacks is nan."""
    records = [_flattened(record) for record in records]
    names = dict.fromkeys(name for record in records for name in record)
    columns = {name: [record.get(name) for record in records] for name in names}
    return _table_of_arrays(path, _without_common_part(columns))


def _table_of_arrays(path, arrays) -> Table:
    """Make columns of arrays or lists; a matrix such as q becomes q1, q2, ..."""
    arrays = {name: _array(path, name, x) for name, x in arrays.items()}
    # Messages have empty lists for what is not measured.
    arrays = {name: x for name, x in arrays.items() if x.size}
    n_rows = _number_of_rows(path, arrays)
    rows, scalars = {}, {}
    for name, x in arrays.items():
        # Matrices may have one column per sample.
        x = x.T if x.ndim == 2 and x.shape[1] == n_rows != len(x) else x
        if x.ndim in (1, 2) and len(x) == n_rows:
            rows[name] = x
        elif x.ndim in (1, 2) and _CHANNEL.fullmatch(name):
            raise RecordingRefused(
                f"{path}: array {name!r} has {len(x)} rows, others have {n_rows}; all "
                "channels need one row per sample."
            )
        else:
            scalars[name] = x
    (name, only), *others = rows.items()
    if not (others or only.ndim == 1 or only.shape[1] == 1 or _CHANNEL.fullmatch(name)):
        return table_of(path, only, scalars=scalars)
    columns = []
    for name, x in rows.items():
        matrix = x.reshape(n_rows, -1).T
        names = [f"{name}{k + 1}" for k in range(len(matrix))]
        columns += zip(names if len(matrix) > 1 else [name], matrix)
    check_names(path, [name for name, _ in columns], "on its own and in a matrix has")
    return table_of(path, dict(columns), scalars=scalars)


def _number_of_rows(path, arrays):
    """Return the length of most of the channels, or of all arrays without any."""
    # Texts are names of columns, and as many as these.
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
        raise RecordingRefused(
            f"{path}: {quoted(name)} holds {quoted(first)} and others that are not "
            "numbers, or lists of other lengths; write one number, or equally long "
            "lists of them, for each sample."
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

    what = "MATLAB file of version 5 to 7.2"
    with parsing(path, what, f"write it again with {_SAVE}."):
        found = loadmat(path, simplify_cells=True)
    # Tables and time series have no name here, functions no numbers.
    found = {name: x for name, x in found.items() if str(name or "__")[:2] != "__"}
    arrays = {name: _with_texts(x) for name, x in _flattened(found).items()}
    arrays = {name: x for name, x in arrays.items() if x.dtype.kind in "biufU"}
    if not arrays:
        raise NotATable(
            f"{path}: holds no arrays; in MATLAB write those of tables and time "
            f"series: t = T.Time; q = T{{:, 2:7}}; ... {_SAVE}."
        )
    return _table_of_arrays(path, _without_common_part(arrays))


def _with_texts(values):
    """Return an array; cells with text are text, not objects."""
    array = np.asarray(values)
    texts = array.dtype.kind == "O" and all(isinstance(x, str) for x in array.flat)
    return array.astype(str) if texts else array


# -- JSON ------------------------------------------------------------------------------


def read_json(path, content) -> Table:
    """Read a list of records or rows, one a line or not, or arrays by their names."""
    with parsing(path, "JSON file", "write it again."):
        found, is_cut = _parsed(content.decode("utf-8-sig"))
    found = found[0] if len(found) == 1 else found
    if isinstance(found, dict):
        table = _table_of_object(path, found)
    elif _are_records(found):
        table = _table_of_records(path, found)
    else:
        table = table_of(path, np.atleast_1d(_array(path, "the list", found)))
    return replace(table, notes=(*table.notes, *[CUT] * is_cut))


def _parsed(text):
    """Return the values that follow one another, and whether the last is cut."""
    found, decode, blank = [], json.JSONDecoder().raw_decode, re.compile(r"\s*")
    at = blank.match(text).end()
    while at < len(text):
        try:
            value, end = decode(text, at)
        except json.JSONDecodeError:
            if len(found) < 2 or "\n" in text[at:]:
                raise
            return found, True
        found.append(value)
        at = blank.match(text, end).end()
    return found, False


def _table_of_object(path, found):
    """Return the table of an object: records in it, recordings, or arrays."""
    # Frames of pandas, orient="split", or by columns with the numbers of rows.
    keys, rows = {"columns", "data"}, found.get("data")
    if keys <= {*found} <= keys | {"index"} and isinstance(rows, list):
        with parsing(path, "frame of pandas", "write it again."):
            names = list(map(str, found["columns"]))
            check_names(path, names or [""], "has")
            rows = [dict(zip(names, row, strict=True)) for row in rows]
        return _table_of_records(path, rows)
    if all(
        isinstance(x, dict) and {*map(str, range(len(x)))} == {*x}
        for x in found.values()
    ):
        found = {name: [x[str(k)] for k in range(len(x))] for name, x in found.items()}
    lists = [x for x, one in found.items() if _are_records(one)]
    # The records are those of the only list, unless they have arrays, as joints do.
    if len(lists) == 1 and _longest(found[lists[0]][0]) <= len(found[lists[0]]):
        table = _table_of_records(path, found[lists[0]])
        note = f"the records are those of {lists[0]!r}."
        return replace(table, notes=(*table.notes, note))
    for name in lists:
        lengths = {_longest(one) for one in found[name]}
        if len(lengths) > 1 and _longest(found) < max(lengths):
            raise ValueError(
                f"{path}: the list {name!r} has {len(found[name])} records with arrays "
                "of different lengths; write one file each, or rows with a column "
                "segment."
            )
    return _table_of_arrays(path, _without_common_part(_flattened(found)))


def _longest(record):
    return max((len(x) for x in record.values() if isinstance(x, list)), default=0)


# -- Parquet and Feather ---------------------------------------------------------------

PARQUET = (".parquet", ".pq", ".feather", ".arrow")
INFO = "meta/info.json"


def read_parquet(path) -> Table:
    """Read a parquet or feather file, or the episodes of a LeRobot data set.

    Lists become a column for each entry.
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
        arrays = {x: one.to_numpy() for x, one in zip(names, data.to_table().columns)}
    features, found = _features(files[0]), {}
    for name, values in arrays.items():
        lists = values.dtype.kind == "O" and values.size and values[0] is not None
        if lists and {np.shape(x) for x in values} == {(np.size(values[0]),)}:
            matrix = np.stack(list(values)).T
            motors = features.get(name, {}).get("names") or ()
            if isinstance(motors, dict):
                (motors,) = motors.values()
            motors = [str(motor).removesuffix(".pos") for motor in motors]
            motors = motors if len(motors) == len(matrix) else range(len(matrix))
            found |= {f"{name}.{motor}": x for motor, x in zip(motors, matrix)}
        else:
            found[name] = values
    return table_of(path, found)


def _features(file):
    """Return what a LeRobot data set says of the columns of its file, {} for others."""
    for path in (folder / INFO for folder in list(file.resolve().parents)[:4]):
        if path.is_file():
            with parsing(path, "JSON file", "download the data set again."):
                return json.loads(path.read_text(encoding="utf-8"))["features"]
    return {}


# -- bags ------------------------------------------------------------------------------

BAGS = (".bag", ".db3", ".mcap")
_TYPE = "sensor_msgs/msg/JointState"


def bag_files(folder):
    """Return the files of a bag in a folder; the folder if it describes itself."""
    if (folder / "metadata.yaml").is_file():
        return [folder]
    return sorted(x for x in folder.iterdir() if x.suffix.lower() in BAGS)


def read_bag(files, shown, topic, joints) -> Table:
    """Read positions and efforts of the joints in a bag."""
    typesys = imported(shown, "rosbags.typesys")
    AnyReader = imported(shown, "rosbags.highlevel").AnyReader
    remedy = "if it was cut, rosbag reindex, ros2 bag reindex or mcap recover may help."
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with (
        parsing(shown, "bag", remedy),
        AnyReader(files, default_typestore=store) as bag,
    ):
        connections = _connections(bag, shown, topic)
        names, values, times = _messages(bag, connections)
        return _joint_states(shown, connections[0].topic, names, values, times, joints)


def _connections(bag, shown, topic):
    """Return the connections of the topic that was asked for, or of the only one."""
    states = [x for x in bag.connections if x.msgtype == _TYPE and x.msgcount]
    topics = sorted({x.topic for x in states})
    known = ", ".join(sorted({f"{x.topic} ({x.msgtype})" for x in bag.connections}))
    if not topics:
        raise RecordingRefused(
            f"{shown}: holds no joint states: expected a topic of {_TYPE} with "
            f"positions and efforts, it holds {known or 'no topics'}."
        )
    chosen = [x for x in topics if topic in (None, x, x.removeprefix("/"))]
    if len(chosen) != 1:
        near = difflib.get_close_matches(topic or "/joint_states", topics, 1)
        raise RecordingRefused(
            f"{shown}: give --topic (in Python: topic=...), one of {listed(topics)}; "
            f"it holds {known}.",
            {"topic": near[0]} if near else {},
        )
    return [x for x in states if x.topic == chosen[0]]


def _messages(bag, connections):
    """Return joints, q, v and tau (3, n_messages, n_joints), and times (2, n) [ns]."""
    # What a message lacks is nan; times are those of the header and of the recorder.
    rows, times = [], []
    for connection, received, raw in bag.messages(connections=connections):
        message = bag.deserialize(raw, connection.msgtype)
        # Without names the numbers of the joints must do.
        names = message.name or map(str, range(1, len(message.position) + 1))
        rows.append((tuple(names), message.position, message.velocity, message.effort))
        stamp = message.header.stamp
        times.append((stamp.sec * 10**9 + stamp.nanosec, received))
    kinds = dict.fromkeys(names for names, *_ in rows)
    joints = list(dict.fromkeys(x for names in kinds for x in names))
    places = {names: [joints.index(x) for x in names] for names in kinds}
    values = np.full((3, len(rows), len(joints)), np.nan)
    for k, (names, *channels) in enumerate(rows):
        for own, x in zip(values, channels):
            if len(x) == len(names):
                own[k, places[names]] = x
    return np.array(joints), values, np.array(times).T


def _joint_states(shown, topic, names, values, times, wanted):
    """Make a table of the joints that give most samples."""
    q, v, tau = values
    known = np.isfinite(q) & np.isfinite(tau)
    if not known.any():
        raise RecordingRefused(
            f"{shown}: none of the {len(q)} messages of {topic} has positions and "
            "efforts of its joints; record a topic whose effort is filled in."
        )
    asked = np.isin(names, wanted)
    if known[:, asked].any():
        known &= asked
    # Joints that come together, the set of them that gives most samples.
    best = max(
        np.unique(known, axis=0), key=lambda x: x.sum() * known[:, x].all(axis=1).sum()
    )
    rows = known[:, best].all(axis=1)
    joints, others = names[best].tolist(), sorted(names[~best])
    q, v, tau, t = q[:, best], v[:, best], tau[:, best], times[0, rows]
    taken = "position [rad or m] as q and effort [N m or N] as tau"
    notes = [f"read from {topic}: {taken} of {', '.join(joints)}."]
    if others:
        note = (
            f"joint(s) {listed(others)} of {topic} left out: the robot has none of "
            "that name, or they come in other messages, or without numbers."
        )
        notes.append(Loss(note) if {*others} & {*wanted} else note)
    if not rows.all():
        note = (
            f"{(~rows).sum()} of {rows.size} messages of {topic} lack some of the "
            "joints taken, or numbers of theirs, and are left out."
        )
        # Messages of other joints are no loss.
        notes.append(Loss(note) if np.isfinite(q[~rows]).any() else note)
    if np.ptp(t) == 0:
        t = times[1, rows]
        notes.append("the stamps in the headers stand still: times are the recorder's.")
    numbered = all(name.isdecimal() for name in joints)
    columns = {"t": (t - t[0]) / 1e9}
    for kind, x in (("q", q), ("tau", tau), ("v", v)):
        if np.isfinite(x[rows]).all():
            heads = [f"{kind}{'' if numbered else '_'}{name}" for name in joints]
            columns |= dict(zip(heads, x[rows].T))
    return Table(
        path=shown,
        frame=imported(shown, "pandas").DataFrame(columns, 1 + np.flatnonzero(rows)),
        place="message {}",
        joints=() if numbered else tuple(joints),
        notes=tuple(notes),
    )
