"""Joint states out of bags of ROS 1 and ROS 2, and MCAP files, by rosbags."""

import difflib
import re
import shlex
from collections.abc import Sequence
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
)

_TYPE = "sensor_msgs/msg/JointState"
# Of controllers of ROS: commanded and measured positions in one message.
_CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
# Topics of joint states that are commands, by words in their names.
_TELLING = re.compile("command|desired|target|goal|reference|cmd", re.IGNORECASE)
# What repairs a bag that was cut, and what unpacks one, by its ending.
_REPAIR = {
    ".bag": "rosbag reindex {}",
    ".db3": "sqlite3 {} .recover | sqlite3 whole.db3",
    ".mcap": "mcap recover {} -o whole.mcap",
}
_UNPACK = {
    ".bag": "rosbag decompress {}",
    ".db3": "ros2 bag convert -i {} -o plain.yaml, where plain.yaml says "
    "output_bags: [{{uri: plain, all_topics: true}}]",
    ".mcap": "mcap decompress {} -o plain.mcap",
}
# How a bag begins, by its ending.
_BEGIN = {
    ".bag": b"#ROSBAG V",
    ".db3": b"SQLite format 3\0",
    ".mcap": b"\x89MCAP0\r\n",
}


def read_bag(path: Source, wanted) -> Table:
    """Read the joint states of a bag's file."""
    # Of packed messages the folder tells how.
    folder = path.shown.parent
    source = Source(folder, path.shown) if _packs_messages(folder) else path
    return _read([source], path.shown, wanted)


def read_bag_folder(path: Path, wanted, unpacked) -> Table | None:
    """Read the joint states of a bag split over several files; None without any."""
    if _packs_messages(path):
        return _read([Source(path, path)], path, wanted)
    for ending in BAG.endings:
        sources = [Source(file, path) for file in sorted(path.glob(f"*{ending}"))]
        for packed in sorted(path.glob(f"*{ending}.zst*")):
            sources.append(unpacked(Source(packed, path), packed.suffix))
        if sources:
            return _read(sources, path, wanted)
    return None


def _packs_messages(folder):
    """Whether the description of a bag says that each message is packed."""
    try:
        text = (folder / "metadata.yaml").read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    mode = re.search(r"compression_mode:\s*[\"']?(\w+)", text)
    return mode is not None and mode[1].lower() == "message"


def _read(paths: Sequence[Source], shown: Path, wanted) -> Table:
    joints = wanted.joints()
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise BAG.missing(shown) from error
    files = [path.file for path in paths]
    for path in paths:
        _check_begin(path)
    try:
        # Reading such a bag without its description gives packed bytes.
        with AnyReader(
            files, default_typestore=get_typestore(Stores.ROS2_HUMBLE)
        ) as bag:
            read = _commanded if wanted.commanded else _joint_states
            return read(bag, shown, wanted.topic, joints)
    except (_Refused, MemoryError):
        raise
    except Exception as error:
        # The parsers of three formats fail on damage in many ways.
        raise _broken(shown, paths, error) from error


class _Refused(RecordingRefused):
    """A refusal of what a bag holds, not of damage."""


def _check_begin(path):
    """Refuse a file that is not what its ending says."""
    begin = _BEGIN.get(path.file.suffix.lower(), b"")
    if not begin:
        return
    with path.file.open("rb") as file:
        found = file.read(len(begin))
    if found != begin:
        what = "is empty" if not found else "does not begin like one"
        raise ValueError(
            f"{path}: is called {path.file.suffix} and {what}; record it again, or "
            "correct its ending."
        )


def _broken(shown, paths, error):
    """Return the refusal of a bag that cannot be read, with what may repair it."""
    # rosbags quotes what an error held as a tuple.
    reason = re.sub(r"\(['\"](.*?)['\"],\)", r"\1", " ".join(str(error).split()))
    reason = reason.rstrip(".") or type(error).__name__
    first = paths[0].file
    ending = first.suffix.lower()
    # Temporary copy: do not suggest repairing it.
    at = first if first.is_relative_to(shown) else shown
    if re.search("compress|zstd|lz4|bz2", reason, re.IGNORECASE):
        unpack = _UNPACK.get(ending, _UNPACK[".db3"]).format(shlex.quote(str(at)))
        remedy = f"unpack it by the tool that has packed it: {unpack}"
    else:
        repair = _REPAIR.get(ending, "ros2 bag reindex {}").format(shlex.quote(str(at)))
        remedy = f"it may be cut in the middle, what is left may be saved: {repair}"
    return ValueError(f"{shown}: is not a complete bag ({reason}); {remedy}")


# -- messages as rows ------------------------------------------------------------------


def _messages(bag, shown, connections, parts):
    """Return what messages say: a row each, columns (channel, joint), with its times.

    parts : function of a connection and a message that returns its joints and arrays by
    channel, none for a message without use. The index has the numbers of the messages.
    """
    pandas = pandas_of(shown)
    unknown = {x.msgtype for x in connections} - set(bag.typestore.fielddefs)
    if unknown:
        raise _Refused(
            f"{shown}: has messages of {listed(sorted(unknown))} and not their "
            "definition: record with --storage mcap, or convert the bag to MCAP where "
            "ROS knows it."
        )
    count = sum(x.msgcount for x in connections)
    if 200 * count > LARGEST:
        raise _Refused(
            f"{shown}: has {count} messages, too many to be read at once; cut the bag "
            "into shorter ones."
        )
    kinds: dict = {}
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
        return pandas.DataFrame(), pandas.DataFrame(), number if count else 0
    clock, frame = (pandas.concat(x).sort_index() for x in (clocks, frames))
    return frame, clock, number


def _with_times(clock, notes):
    """Return the time of each message [ns]: of its header, unless these stand still."""
    if (clock.groupby("topic").stamp.nunique() > 1).all():
        return clock.stamp
    notes.append(
        "the stamps in the headers stand still; times are those of the recorder."
    )
    return clock.received


def _table(shown, frame, times, joints, channels, notes):
    """Return the table of some joints' channels, those without any number left out."""
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
    return names, channels | (
        {"v": message.velocity} if len(message.velocity) == n else {}
    )


def _joint_states(bag, shown, topic, wanted):
    """Make a table of the joints that give most samples."""
    connections = _connections(bag, shown, topic, wanted)
    topic = connections[0].topic
    frame, clock, total = _messages(bag, shown, connections, _state)
    known = np.isfinite(frame["q"]) & np.isfinite(frame["tau"]) if len(frame) else frame
    known = known.loc[:, known.any()]
    if known.empty:
        raise _Refused(
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
    named = frame["q"][joints].notna().any(axis=1)
    notes = [
        f"read from {topic}: position [rad or m] as q and effort [N m or N] as tau of "
        f"{', '.join(joints)}."
    ]
    notes += _left_out(frame["q"], topic, joints, wanted)
    if total > rows.sum():
        # Messages of other joints are no loss.
        kind = Loss if named.sum() > rows.sum() else str
        notes.append(
            kind(
                f"{total - rows.sum()} of {total} messages of {topic} lack some of the "
                "joints taken, or numbers of theirs, and are left out."
            )
        )
    frame, times = frame[rows], _with_times(clock[rows], notes)
    channels = ["q", "tau"]
    if "v" in frame and set(joints) <= set(frame["v"]):
        channels += ["v"] * bool(np.isfinite(frame["v"][joints]).all(axis=None))
    return _table(shown, frame, times, joints, channels, notes)


def _left_out(positions, topic, joints, wanted):
    """Note the joints that are not taken, those of the robot as a loss."""
    others = sorted(set(positions) - set(joints))
    of_robot = [x for x in others if x in wanted]
    strange = "the robot has none of that name"
    if not wanted:
        strange = "they come in other messages, or without numbers"
    left = [x for x in others if x not in of_robot]
    if left:
        yield f"joint(s) {listed(left)} of {topic} left out: {strange}."
    if of_robot:
        moved = (positions[of_robot].max() - positions[of_robot].min()).max()
        yield Loss(
            f"joint(s) {listed(of_robot)} of {topic} left out: they come in other "
            "messages, or without numbers, and move there by up to "
            f"{np.nan_to_num(moved):.3g} rad or m."
        )


# -- commanded positions ---------------------------------------------------------------


def _commanded(bag, shown, topic, wanted):
    """Make a table of positions and of those that were commanded."""
    known = [x for x in bag.connections if x.msgcount and x.msgtype == _CONTROLLER]
    asked = {topic, f"/{topic}"} if topic is not None else {x.topic for x in known}
    found = [x for x in known if x.topic in asked]
    topics = sorted({x.topic for x in found})
    if len(topics) > 1:
        raise _Refused(
            f"{shown}: holds {len(topics)} topics of controllers: {listed(topics)}; "
            "give --topic with one of them (in Python: topic=...).",
            {"topic": topics[0]},
        )
    found = found or _states_and_commands(bag, shown, topic)
    topics = sorted({x.topic for x in found})
    frame, clock, _ = _messages(bag, shown, found, _command)
    commanded, read = (
        set(frame[x].dropna(axis=1, how="all")) if x in frame else set()
        for x in ("q_desired", "q")
    )
    joints = sorted(commanded & read & set(wanted) or commanded & read)
    if not joints:
        raise _Refused(
            f"{shown}: no joint of {listed(topics)} has both a position and a "
            "commanded one; record both by the same names."
        )
    notes = [
        f"read from {listed(topics)}: positions [rad or m] as q and commanded ones as "
        f"q_desired of {', '.join(joints)}."
    ]
    times = _with_times(clock, notes).sort_values(kind="stable")
    channels = ["q", "v", "q_desired", "v_desired"]
    return _table(shown, frame.loc[times.index], times, joints, channels, notes)


def _states_and_commands(bag, shown, topic):
    """Return connections of joint states and of their commands."""
    states = [x for x in bag.connections if x.msgcount and x.msgtype == _TYPE]
    telling = sorted({x.topic for x in states if _TELLING.search(x.topic)})
    others = sorted({x.topic for x in states} - set(telling))
    if topic is not None:
        others = [x for x in others if x in (topic, f"/{topic}")]
    if len(telling) == 1 and len(others) == 1:
        return [x for x in states if x.topic in (*telling, *others)]
    kind = _CONTROLLER.replace("/msg", "")
    raise _Refused(
        f"{shown}: holds {len(others)} topic(s) of joint states and {len(telling)} of "
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
        after = "_desired" if _TELLING.search(connection.topic) else ""
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
        chosen = [x for x in bag.connections if x.topic == topic]
        if not chosen:
            chosen = [x for x in bag.connections if x.topic == f"/{topic}"]
        if not chosen:
            raise _Refused(
                f"{shown}: has no topic {topic}; {_contents(bag)}.",
                _nearest_topic(topic, topics),
            )
        if chosen[0].msgtype != _TYPE:
            raise _Refused(
                f"{shown}: topic {topic} holds {chosen[0].msgtype}, expected {_TYPE}; "
                f"{_contents(bag)}.",
                _nearest_topic(topic, topics),
            )
        return chosen
    if not topics:
        raise _Refused(
            f"{shown}: holds no joint states: expected a topic of {_TYPE} with "
            f"positions and efforts, {_contents(bag)}; record /joint_states."
        )
    if len(topics) > 1:
        able = [x for x in topics if _has_joints(bag, states, x, wanted)]
        if len(able) != 1:
            raise _Refused(
                f"{shown}: holds {len(topics)} topics of joint states: "
                f"{listed(topics)}; give --topic with one of them (in Python: "
                "topic=...).",
                {"topic": (able or topics)[0]},
            )
        topics = able
    return [x for x in states if x.topic == topics[0]]


def _nearest_topic(topic, topics):
    """Return the option of the topic that was meant, {} if none is near."""
    meant = topics if len(topics) == 1 else difflib.get_close_matches(topic, topics, 1)
    return {"topic": meant[0]} if meant else {}


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
    if not topics:
        return "it holds no topics"
    return f"it holds {listed(topics)}"


BAG = Format(
    name="bag of ROS 1 or 2, MCAP",
    endings=(".bag", ".db3", ".mcap"),
    shown=(".bag", ".db3", ".mcap"),
    read=read_bag,
    begins=tuple((begin, ending) for ending, begin in _BEGIN.items()),
    read_folder=read_bag_folder,
    marks=("metadata.yaml", "*.db3*", "*.mcap*", "*.bag*"),
    has_topics=True,
    needs=("rosbags", "bags", "bags"),
)
