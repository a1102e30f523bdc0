"""Joint states out of bags of ROS 1 and ROS 2, and MCAP files, by rosbags."""

import difflib
import functools
import re
import shlex
from pathlib import Path

import numpy as np

from sklearn_vbjfa.recording._table import (
    LARGEST,
    Format,
    Loss,
    RecordingRefused,
    Source,
    Table,
    listed,
    pandas_of,
    parsing,
)

_TYPE = "sensor_msgs/msg/JointState"
# Of controllers of ROS: commanded and measured positions in one message.
_CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
# Topics of joint states that are commands, by words in their names.
_COMMAND = re.compile("command|desired|target|goal|reference|cmd", re.IGNORECASE)
# What repairs a bag that was cut, and what unpacks one, by its ending.
_REPAIR = {
    ".bag": "rosbag reindex {}",
    ".db3": "sqlite3 {} .recover | sqlite3 whole.db3",
    ".mcap": "mcap recover {} -o whole.mcap",
}
_UNPACK = {".bag": "rosbag decompress {}", ".mcap": "mcap decompress {} -o plain.mcap"}


def read_bag(path: Source, wanted) -> Table:
    """Read the joint states of a bag's file."""
    # Of packed messages the folder has the compression.
    folder = path.shown.parent
    file = folder if _packs_messages(folder) else path.file
    return _read([file], path.shown, wanted)


def read_bag_folder(path: Path, wanted, unpacked) -> Table | None:
    """Read the joint states of a bag split over several files; None without any."""
    if _packs_messages(path):
        return _read([path], path, wanted)
    for ending in BAG.endings:
        files = sorted(path.glob(f"*{ending}"))
        for packed in sorted(path.glob(f"*{ending}.zst*")):
            files.append(unpacked(Source(packed, path), packed.suffix).file)
        if files:
            return _read(files, path, wanted)
    return None


def _packs_messages(folder):
    """Whether the description of a bag says that each message is packed."""
    try:
        text = (folder / "metadata.yaml").read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    return bool(re.search(r"compression_mode:\s*[\"']?message\b", text, re.IGNORECASE))


def _read(files, shown, wanted):
    joints = wanted.joints()
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise BAG.missing(shown) from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    remedy = functools.partial(_remedy, files[0], shown)
    with (
        parsing(shown, "bag", remedy),
        AnyReader(files, default_typestore=store) as bag,
    ):
        read = _commanded if wanted.commanded else _joint_states
        return read(bag, shown, wanted.topic, joints)


def _remedy(file, shown, reason):
    """Say what may repair a bag; not a temporary copy of it."""
    at = shlex.quote(str(file if file.is_relative_to(shown) else shown))
    ending = file.suffix.lower()
    if re.search("compress|zstd|lz4|bz2", reason, re.IGNORECASE):
        unpack = _UNPACK.get(ending, "ros2 bag convert -i {} -o plain.yaml").format(at)
        return f"unpack it by the tool that has packed it: {unpack}"
    repair = _REPAIR.get(ending, "ros2 bag reindex {}").format(at)
    return f"it may be cut in the middle, what is left may be saved: {repair}"


# -- messages as rows ------------------------------------------------------------------


def _messages(bag, shown, connections, parts):
    """Return what messages say: a row each, columns (channel, joint), with its times.

    parts : function of a connection and a message that returns its joints and arrays by
    channel, none for a message without use. The index has the numbers of the messages.
    """
    pandas = pandas_of(shown)
    unknown = {x.msgtype for x in connections} - set(bag.typestore.fielddefs)
    if unknown:
        raise RecordingRefused(
            f"{shown}: has messages of {listed(sorted(unknown))} and not their "
            "definition: record with --storage mcap, or convert the bag to MCAP where "
            "ROS knows it."
        )
    count = sum(x.msgcount for x in connections)
    if 200 * count > LARGEST:
        raise RecordingRefused(
            f"{shown}: has {count} messages, too many to be read at once; cut the bag "
            "into shorter ones."
        )
    kinds: dict = {}
    number = 0
    for number, (connection, received, raw) in enumerate(
        bag.messages(connections=connections), start=1
    ):
        message = bag.deserialize(raw, connection.msgtype)
        joints, channels = parts(connection, message)
        if channels:
            kind = kinds.setdefault((connection.topic, joints, tuple(channels)), [])
            stamp = message.header.stamp
            times = number, stamp.sec * 10**9 + stamp.nanosec, received
            kind.append((times, np.concatenate(list(channels.values()))))
    frames, clocks = [], []
    for (topic, joints, channels), rows in kinds.items():
        columns = pandas.MultiIndex.from_product([channels, joints])
        times, values = zip(*rows)
        clock = pandas.DataFrame(times, columns=["number", "stamp", "received"])
        clocks.append(clock.assign(topic=topic).set_index("number"))
        frames.append(pandas.DataFrame(values, clocks[-1].index, columns))
    if not frames:
        return pandas.DataFrame(), pandas.DataFrame(), number
    clock, frame = (pandas.concat(x).sort_index() for x in (clocks, frames))
    return frame, clock, number


def _table(shown, frame, clock, joints, channels, notes):
    """Return the table of some joints' channels, those without any number left out."""
    # Times are those of the headers, unless these stand still.
    times = clock.stamp
    if not (clock.groupby("topic").stamp.nunique() > 1).all():
        notes.append(
            "the stamps in the headers stand still; times are those of the recorder."
        )
        times = clock.received
    if clock.topic.nunique() > 1:
        times = times.sort_values(kind="stable")
        frame = frame.loc[times.index]
    columns = {"t": (times - times.iloc[0]) / 1e9}
    numbered = all(name.isdecimal() for name in joints)
    for channel in channels:
        own = frame[channel] if channel in frame else frame[[]]
        if set(joints) <= set(own) and own[joints].notna().any().all():
            mark = "" if numbered else "_"
            columns |= {f"{channel}{mark}{name}": own[name] for name in joints}
    return Table(
        path=shown,
        frame=pandas_of(shown).DataFrame(columns),
        place="message {}",
        joints=() if numbered else tuple(joints),
        notes=tuple(notes),
    )


# -- joint states ----------------------------------------------------------------------


def _state(connection, message):
    """Return the joints of a message and their channels, none without efforts."""
    position, n = message.position, len(message.position)
    # Without names the numbers of the joints must do.
    names = tuple(message.name) or tuple(str(k + 1) for k in range(n))
    # Drivers send nan for what they do not know, or not yet.
    usable = n and len(names) == len(message.effort) == n
    if not usable or not np.isfinite(position + message.effort).any():
        return names, {}
    channels = {"q": position, "tau": message.effort}
    if len(message.velocity) == n:
        channels["v"] = message.velocity
    return names, channels


def _joint_states(bag, shown, topic, wanted):
    """Make a table of the joints that give most samples."""
    connections = _connections(bag, shown, topic, wanted)
    topic = connections[0].topic
    frame, clock, total = _messages(bag, shown, connections, _state)
    known = np.isfinite(frame["q"]) & np.isfinite(frame["tau"]) if len(frame) else frame
    known = known.loc[:, known.any()]
    if known.empty:
        raise RecordingRefused(
            f"{shown}: none of the {total} messages of {topic} has positions and "
            "efforts of its joints; record a topic whose effort is filled in."
        )
    if known.columns.isin(wanted).any():
        known = known.loc[:, known.columns.isin(wanted)]
    # Joints that come together, the set of them that gives most samples.
    sets = {tuple(known.columns[row]): None for row in np.unique(known, axis=0)}
    joints = max(sets, key=lambda own: len(own) * known[[*own]].all(axis=1).sum())
    joints = [x for x in frame["q"] if x in joints]
    rows = known[joints].all(axis=1)
    notes = [
        f"read from {topic}: position [rad or m] as q and effort [N m or N] as tau of "
        f"{', '.join(joints)}.",
        *_left_out(frame["q"], topic, joints, wanted),
    ]
    if total > rows.sum():
        # Messages of other joints are no loss.
        named = frame["q"][joints].notna().any(axis=1)
        kind = Loss if named.sum() > rows.sum() else str
        notes.append(
            kind(
                f"{total - rows.sum()} of {total} messages of {topic} lack some of the "
                "joints taken, or numbers of theirs, and are left out."
            )
        )
    frame, channels = frame[rows], ["q", "tau"]
    if "v" in frame and set(joints) <= set(frame["v"]):
        channels += ["v"] * bool(np.isfinite(frame["v"][joints]).all(axis=None))
    return _table(shown, frame, clock[rows], joints, channels, notes)


def _left_out(positions, topic, joints, wanted):
    """Note the joints that are not taken, those of the robot as a loss."""
    others = sorted(set(positions) - set(joints))
    of_robot = [x for x in others if x in wanted]
    left = [x for x in others if x not in wanted]
    apart = "they come in other messages, or without numbers"
    if left:
        why = "the robot has none of that name" if wanted else apart
        yield f"joint(s) {listed(left)} of {topic} left out: {why}."
    if of_robot:
        moved = (positions[of_robot].max() - positions[of_robot].min()).max()
        yield Loss(
            f"joint(s) {listed(of_robot)} of {topic} left out: {apart}, and move there "
            f"by up to {np.nan_to_num(moved):.3g} rad or m."
        )


# -- commanded positions ---------------------------------------------------------------


def _commanded(bag, shown, topic, wanted):
    """Make a table of positions and of those that were commanded."""
    connections = _controllers(bag, shown, topic)
    frame, clock, _ = _messages(bag, shown, connections, _command)
    commanded, read = (
        set(frame[x].dropna(axis=1, how="all")) if x in frame else set()
        for x in ("q_desired", "q")
    )
    joints = sorted(commanded & read & set(wanted) or commanded & read)
    topics = listed(sorted({x.topic for x in connections}))
    if not joints:
        raise RecordingRefused(
            f"{shown}: no joint of {topics} has both a position and a commanded one; "
            "record both by the same names."
        )
    notes = [
        f"read from {topics}: positions [rad or m] as q and commanded ones as "
        f"q_desired of {', '.join(joints)}."
    ]
    channels = ["q", "v", "q_desired", "v_desired"]
    return _table(shown, frame, clock, joints, channels, notes)


def _controllers(bag, shown, topic):
    """Return connections of a controller, or of joint states and of their commands."""
    asked = (topic, f"/{topic}")
    known = [x for x in bag.connections if x.msgcount and x.msgtype == _CONTROLLER]
    found = [x for x in known if topic is None or x.topic in asked]
    topics = sorted({x.topic for x in found})
    if len(topics) > 1:
        raise _ambiguous(shown, topics, "controllers")
    if found:
        return found
    states = [x for x in bag.connections if x.msgcount and x.msgtype == _TYPE]
    commands = {x.topic for x in states if _COMMAND.search(x.topic)}
    others = {x.topic for x in states} - commands
    if topic is not None:
        others &= {*asked}
    if len(commands) == 1 and len(others) == 1:
        return [x for x in states if x.topic in commands | others]
    kind = _CONTROLLER.replace("/msg", "")
    raise RecordingRefused(
        f"{shown}: holds {len(others)} topic(s) of joint states and {len(commands)} of "
        f"commanded ones; expected one of {kind}, or one of each, that of commands "
        f"called so, {_contents(bag)}."
    )


def _command(connection, message):
    """Return the joints of a message and its channels, commanded ones among them."""
    if connection.msgtype == _CONTROLLER:
        # ROS 2 has other names for them since 2023.
        commanded = getattr(message, "reference", None) or message.desired
        read = getattr(message, "feedback", None) or message.actual
        names = tuple(message.joint_names)
        channels = {"q_desired": commanded.positions, "v_desired": commanded.velocities}
        channels |= {"q": read.positions, "v": read.velocities}
    else:
        after = "_desired" if _COMMAND.search(connection.topic) else ""
        names = tuple(message.name)
        channels = {f"q{after}": message.position, f"v{after}": message.velocity}
    return names, {
        key: x for key, x in channels.items() if names and len(x) == len(names)
    }


# -- which topic -----------------------------------------------------------------------


def _connections(bag, shown, topic, wanted):
    """Return the connections of the topic that was asked for, or of the only one."""
    states = [x for x in bag.connections if x.msgtype == _TYPE and x.msgcount]
    topics = sorted({x.topic for x in states})
    if topic is not None:
        chosen = [x for x in bag.connections if x.topic in (topic, f"/{topic}")]
        if chosen and chosen[0].msgtype == _TYPE:
            return chosen
        what = f"has no topic {topic}"
        if chosen:
            what = f"topic {topic} holds {chosen[0].msgtype}, expected {_TYPE}"
        near = difflib.get_close_matches(topic, topics, 1)
        near = topics if len(topics) == 1 else near
        raise RecordingRefused(
            f"{shown}: {what}; {_contents(bag)}.", {"topic": near[0]} if near else {}
        )
    if not topics:
        raise RecordingRefused(
            f"{shown}: holds no joint states: expected a topic of {_TYPE} with "
            f"positions and efforts, {_contents(bag)}; record /joint_states."
        )
    if len(topics) > 1:
        able = [x for x in topics if _has_joints(bag, states, x, wanted)]
        if len(able) != 1:
            raise _ambiguous(shown, topics, "joint states", able)
        topics = able
    return [x for x in states if x.topic == topics[0]]


def _ambiguous(shown, topics, what, able=()):
    return RecordingRefused(
        f"{shown}: holds {len(topics)} topics of {what}: {listed(topics)}; give "
        "--topic with one of them (in Python: topic=...).",
        {"topic": (able or topics)[0]},
    )


def _has_joints(bag, states, topic, wanted):
    """Whether the first message of a topic has efforts of joints of the robot."""
    own = [x for x in states if x.topic == topic]
    for connection, _, raw in bag.messages(connections=own):
        message = bag.deserialize(raw, connection.msgtype)
        known = not wanted or set(message.name) & set(wanted)
        return bool(known) and len(message.effort) > 0
    return False


def _contents(bag):
    """List the topics of a bag."""
    topics = sorted({f"{x.topic} ({x.msgtype})" for x in bag.connections})
    return f"it holds {listed(topics) or 'no topics'}"


_BEGINS = (b"#ROSBAG V", b"SQLite format 3\0", b"\x89MCAP0\r\n")
BAG = Format(
    name="bag of ROS 1 or 2, MCAP",
    endings=(".bag", ".db3", ".mcap"),
    shown=(".bag", ".db3", ".mcap"),
    read=read_bag,
    begins=tuple(zip(_BEGINS, _REPAIR)),
    read_folder=read_bag_folder,
    marks=("metadata.yaml", "*.db3*", "*.mcap*", "*.bag*"),
    has_topics=True,
    needs=("rosbags", "bags", "bags"),
)
