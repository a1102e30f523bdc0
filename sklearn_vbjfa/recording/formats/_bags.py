"""Joint states out of bags of ROS 1 and ROS 2, and MCAP files, by rosbags."""

import difflib
import re
import shlex

import numpy as np

from sklearn_vbjfa.recording._table import (
    LARGEST,
    Loss,
    RecordingRefused,
    Table,
    listed,
    missing,
    pandas_of,
    parsing,
)

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
