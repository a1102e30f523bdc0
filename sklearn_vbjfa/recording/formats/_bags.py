"""Joint states out of bags of ROS 1 and ROS 2, and MCAP files, without ROS."""

import difflib
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
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
)

_TYPE = "sensor_msgs/msg/JointState"
# Of controllers of ROS: what joints were told and where they were, in one message.
_CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
# Topics of joint states that are commands, by words in their names.
_TELLING = re.compile("command|desired|target|goal|reference|cmd", re.IGNORECASE)
# What mends a bag that was cut, and what unpacks one, by its ending.
_MEND = {
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


@dataclass
class _Kind:
    """Messages that name the same joints: when they came, and what they hold."""

    order: list = field(default_factory=list)
    stamps: list = field(default_factory=list)
    received: list = field(default_factory=list)
    q: list = field(default_factory=list)
    v: list = field(default_factory=list)
    tau: list = field(default_factory=list)


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
        # The parsers of three formats fail on damage in many ways of their own.
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
            f"{path}: is called {path.file.suffix} and {what}; record it anew, or "
            "correct its ending."
        )


def _broken(shown, paths, error):
    """Return the refusal of a bag that cannot be read, with what may mend it."""
    # rosbags quotes what an error held as a tuple.
    reason = re.sub(r"\(['\"](.*?)['\"],\)", r"\1", " ".join(str(error).split()))
    reason = reason.rstrip(".") or type(error).__name__
    first = paths[0].file
    ending = first.suffix.lower()
    # What was unpacked for reading is where no one can mend it.
    at = first if first.is_relative_to(shown) else shown
    if re.search("compress|zstd|lz4|bz2", reason, re.IGNORECASE):
        unpack = _UNPACK.get(ending, _UNPACK[".db3"]).format(shlex.quote(str(at)))
        remedy = f"unpack it by the tool that has packed it: {unpack}"
    else:
        mend = _MEND.get(ending, "ros2 bag reindex {}").format(shlex.quote(str(at)))
        remedy = f"it may be cut in the middle, what is left may be saved: {mend}"
    return ValueError(f"{shown}: is not a complete bag ({reason}); {remedy}")


def _joint_states(bag, shown, topic, wanted):
    connections = _connections(bag, shown, topic, wanted)
    count = sum(x.msgcount for x in connections)
    if 200 * count > LARGEST:
        raise _Refused(
            f"{shown}: has {count} messages, too many to be read at once; cut the bag "
            "into shorter ones."
        )
    kinds, bare = _kinds(bag, connections)
    name = connections[0].topic
    if not kinds:
        raise _Refused(
            f"{shown}: none of the {bare} messages of {name} has positions and efforts "
            "of its joints; record a topic whose effort is filled in."
        )
    return _table(kinds, bare, shown, name, wanted)


# -- what joints were told -------------------------------------------------------------


def _commanded(bag, shown, topic, wanted):
    """Make a table of positions and of those that were commanded."""
    known = [x for x in bag.connections if x.msgcount and x.msgtype == _CONTROLLER]
    asked = {topic, f"/{topic}"} if topic is not None else {x.topic for x in known}
    found = [x for x in known if x.topic in asked]
    if len({x.topic for x in found}) > 1:
        topics = sorted({x.topic for x in found})
        raise _Refused(
            f"{shown}: holds {len(topics)} topics of controllers: {listed(topics)}; "
            "give --topic with one of them (in Python: topic=...).",
            {"topic": topics[0]},
        )
    if not found:
        found = _states_and_commands(bag, shown, topic, wanted)
    rows = [
        (message.header.stamp, received, _told(connection, message))
        for connection, received, message in _decoded(bag, shown, found)
    ]
    rows = [row for row in rows if row[2]]
    told = {name for _, _, row in rows for key, name in row if key == "q_desired"}
    read = {name for _, _, row in rows for key, name in row if key == "q"}
    joints = sorted(told & read & set(wanted) or told & read)
    if not joints:
        raise _Refused(
            f"{shown}: no joint of {listed(sorted({x.topic for x in found}))} has both "
            "a position and a commanded one; record both by the same names."
        )
    stamps = np.array([x.sec * 10**9 + x.nanosec for x, _, _ in rows])
    notes = [
        "read from " + listed(sorted({x.topic for x in found})) + ": positions [rad or "
        f"m] as q and commanded ones as q_desired of {', '.join(joints)}."
    ]
    still = [
        topic
        for topic in {x.topic for x in found}
        if np.ptp(_of_topic(stamps, rows, topic)) == 0
    ]
    if still:
        stamps = np.array([received for _, received, _ in rows])
        notes.append(
            f"stamps in the headers of {listed(sorted(still))} stand still; times are "
            "those of the recorder."
        )
    order = np.argsort(stamps, kind="stable")
    columns = {"t": (stamps[order] - stamps.min()) / 1e9}
    for key in ("q", "v", "q_desired", "v_desired"):
        values = np.array(
            [[rows[k][2].get((key, name), np.nan) for name in joints] for k in order]
        )
        if np.isfinite(values).any(axis=0).all():
            columns |= {f"{key}_{name}": x for name, x in zip(joints, values.T)}
    return Table(
        path=shown,
        columns=columns,
        where=lambda row: f"message {order[row] + 1}",
        joints=tuple(joints),
        notes=tuple(notes),
    )


def _states_and_commands(bag, shown, topic, wanted):
    """Return connections of joint states and of what they were told."""
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


def _decoded(bag, shown, connections):
    """Yield connection, time of receipt [ns] and message of each."""
    unknown = {x.msgtype for x in connections} - set(bag.typestore.fielddefs)
    if unknown:
        raise _Refused(
            f"{shown}: has messages of {listed(sorted(unknown))} and not their "
            "definition: record with --storage mcap, or convert the bag to MCAP where "
            "ROS knows it."
        )
    for connection, received, raw in bag.messages(connections=connections):
        yield connection, received, bag.deserialize(raw, connection.msgtype)


def _told(connection, message):
    """Return what a message says, (channel, joint) -> number, and its topic."""
    if connection.msgtype == _CONTROLLER:
        # ROS 2 has other names for them since 2023.
        told = getattr(message, "reference", None) or message.desired
        read = getattr(message, "feedback", None) or message.actual
        parts = [
            ("q_desired", message.joint_names, told.positions),
            ("v_desired", message.joint_names, told.velocities),
            ("q", message.joint_names, read.positions),
            ("v", message.joint_names, read.velocities),
        ]
    else:
        after = "_desired" if _TELLING.search(connection.topic) else ""
        parts = [
            (f"q{after}", message.name, message.position),
            (f"v{after}", message.name, message.velocity),
        ]
    found = {
        (key, name): float(value)
        for key, names, values in parts
        if len(values) == len(names)
        for name, value in zip(names, values)
        if np.isfinite(value)
    }
    if found:
        found["topic", ""] = connection.topic
    return found


def _of_topic(stamps, rows, topic):
    """Return the stamps of a topic's messages."""
    return stamps[[row["topic", ""] == topic for _, _, row in rows]]


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
    """Return the option of the topic that was meant, {} if it cannot be told."""
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
    """Say which topics a bag has."""
    topics = sorted({f"{x.topic} ({x.msgtype})" for x in bag.connections})
    if not topics:
        return "it holds no topics"
    return f"it holds {listed(topics)}"


def _kinds(bag, connections):
    """Sort messages by the joints that they name; also count those without values."""
    kinds, bare, order = {}, 0, 0
    for connection, received, raw in bag.messages(connections=connections):
        message = bag.deserialize(raw, connection.msgtype)
        names = tuple(message.name)
        n = len(message.position)
        # Without names the numbers of the joints must do.
        names = names or tuple(str(k + 1) for k in range(n))
        order += 1
        if not n or len(names) != n or len(message.effort) != n:
            bare += 1
            continue
        # Drivers send nan for what they do not know, or not yet.
        if not np.isfinite(np.add(message.position, message.effort)).any():
            bare += 1
            continue
        kind = kinds.setdefault(names, _Kind())
        stamp = message.header.stamp
        kind.order.append(order)
        kind.stamps.append(stamp.sec * 10**9 + stamp.nanosec)
        kind.received.append(received)
        kind.q.append(message.position)
        kind.v.append(message.velocity if len(message.velocity) == n else None)
        kind.tau.append(message.effort)
    return kinds, bare


def _table(kinds, bare, shown, topic, wanted):
    """Make a table of the joints that give most samples."""
    joints, own = _most(kinds, wanted)
    rows = np.concatenate([kinds[names].order for names in own])
    order = np.argsort(rows)
    matrices = {
        key: np.concatenate([_values(kinds[x], key, x, joints) for x in own])
        for key in ("q", "tau")
    }
    known = np.isfinite(np.hstack(list(matrices.values()))).all(axis=1)
    order = order[known[order]]
    if all(x is not None for names in own for x in kinds[names].v):
        v = np.concatenate([_values(kinds[x], "v", x, joints) for x in own])
        if np.isfinite(v[order]).all():
            matrices["v"] = v
    matrices = {key: matrix[order] for key, matrix in matrices.items()}
    stamps, notes = _stamps([kinds[x] for x in own], order)
    columns = {"t": stamps}
    numbered = all(name.isdecimal() for name in joints)
    for key, matrix in matrices.items():
        mark = "" if numbered else "_"
        columns |= {f"{key}{mark}{name}": x for name, x in zip(joints, matrix.T)}
    total = sum(len(kind.order) for kind in kinds.values()) + bare
    others = sorted({name for names in kinds for name in names} - set(joints))
    of_robot = [x for x in others if x in wanted]
    strange = "the robot has none of that name"
    if not wanted:
        strange = "they come in other messages, or without numbers"
    moved = max((_travel(kinds, x) for x in of_robot), default=0.0)
    for kind, left, why in (
        (str, [x for x in others if x not in of_robot], strange),
        (
            Loss,
            of_robot,
            "they come in other messages, or without numbers, and move there by up to "
            f"{moved:.3g} rad or m",
        ),
    ):
        if left:
            notes.append(kind(f"joint(s) {listed(left)} of {topic} left out: {why}."))
    if total > order.size:
        # Messages of other joints are no loss.
        kind = Loss if rows.size > order.size else str
        notes.append(
            kind(
                f"{total - order.size} of {total} messages of {topic} lack some of the "
                "joints taken, or numbers of theirs, and are left out."
            )
        )
    notes.insert(
        0,
        f"read from {topic}: position [rad or m] as q and effort [N m or N] as tau of "
        f"{', '.join(joints)}.",
    )
    sorted_rows = rows[order]
    return Table(
        path=shown,
        columns=columns,
        where=lambda row: f"message {sorted_rows[row]}",
        joints=() if numbered else tuple(joints),
        notes=tuple(notes),
    )


def _most(kinds, wanted):
    """Return the joints that give most samples, and the kinds that have them all."""
    numbers = {names: _with_numbers(kind, names) for names, kind in kinds.items()}
    known = {
        names: tuple(x for x in own if x in wanted) for names, own in numbers.items()
    }
    if not any(known.values()):
        known = numbers

    def samples(joints):
        having = [x for x in kinds if set(joints) <= set(x)]
        return len(joints) * sum(len(kinds[x].order) for x in having)

    joints = max(known.values(), key=samples)
    return joints, [x for x in kinds if set(joints) <= set(x)]


def _with_numbers(kind, names):
    """Return the joints that ever have a position and an effort in such messages."""
    some = np.isfinite(np.array(kind.q)) & np.isfinite(np.array(kind.tau))
    return tuple(name for name, known in zip(names, some.any(axis=0)) if known)


def _travel(kinds, joint):
    """Return how far a joint moves in the messages that have it [rad or m]."""
    found = [
        np.array(kind.q)[:, names.index(joint)]
        for names, kind in kinds.items()
        if joint in names
    ]
    values = np.concatenate(found)
    values = values[np.isfinite(values)]
    return float(np.ptp(values)) if values.size else 0.0


def _values(kind, key, names, joints):
    """Return values (n_messages, n_joints) in the order of `joints`."""
    return np.array(getattr(kind, key))[:, [names.index(x) for x in joints]]


def _stamps(kinds, order):
    """Return times from the first [s]: of the headers, unless they stand still."""
    stamps = np.concatenate([kind.stamps for kind in kinds])[order]
    if np.ptp(stamps) > 0:
        return (stamps - stamps[0]) / 1e9, []
    received = np.concatenate([kind.received for kind in kinds])[order]
    return (received - received[0]) / 1e9, [
        "the stamps in the headers stand still; times are those of the recorder."
    ]


BAG = Format(
    name="bag of ROS 1 or 2, MCAP",
    endings=(".bag", ".db3", ".mcap"),
    shown=(".bag", ".db3", ".mcap"),
    read=read_bag,
    begins=tuple((begin, ending) for ending, begin in _BEGIN.items()),
    read_folder=read_bag_folder,
    marks=("metadata.yaml", "*.db3*", "*.mcap*", "*.bag*"),
    has_topics=True,
    needs=("rosbags", "bags"),
)
