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
# Of controllers of ROS: commanded and measured positions in one message.
_CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
# Topics of joint states that are commands, by words in their names.
_COMMAND = re.compile("command|desired|target|goal|reference|cmd", re.IGNORECASE)


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


def read_bag(files, shown, wanted) -> Table:
    """Read positions and efforts, or commanded positions, of the joints in a bag."""
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
        choose, take = (_states, _joint_states)
        if wanted.commanded:
            choose, take = (_commands, _commanded)
        connections = choose(bag, shown, wanted)
        frame, clock = _messages(bag, shown, connections, wanted.commanded)
        topics = listed(sorted({x.topic for x in connections}))
        return take(shown, topics, frame, clock, wanted.joints())


# -- messages as rows ------------------------------------------------------------------


def _messages(bag, shown, connections, commanded):
    """Return what messages say, a row each, columns (channel, joint), and times."""
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
    messages = bag.messages(connections=connections)
    for number, (connection, received, raw) in enumerate(messages, start=1):
        message = bag.deserialize(raw, connection.msgtype)
        joints, channels = _channels(message, connection.topic, commanded)
        stamp = message.header.stamp
        times = number, stamp.sec * 10**9 + stamp.nanosec, received
        kind = kinds.setdefault((connection.topic, joints, tuple(channels)), [])
        kind.append((times, np.concatenate([[], *channels.values()])))
    frames, clocks = [], []
    for (topic, joints, channels), rows in kinds.items():
        columns = pandas.MultiIndex.from_product([channels or ["none"], joints])
        times, values = zip(*rows)
        clock = pandas.DataFrame(times, columns=["number", "stamp", "received"])
        clocks.append(clock.assign(topic=topic).set_index("number"))
        if channels:
            frames.append(pandas.DataFrame(values, clocks[-1].index, columns))
    clock = pandas.concat(clocks).sort_index()
    frame = pandas.concat(frames) if frames else pandas.DataFrame()
    return frame.reindex(clock.index), clock


def _channels(message, topic, commanded):
    """Return the joints of a message, and its channels that have a value for each."""
    after = "_desired" if commanded and _COMMAND.search(topic) else ""
    if hasattr(message, "joint_names"):
        # ROS 2 has other names for them since 2023.
        aim = getattr(message, "reference", None) or message.desired
        read = getattr(message, "feedback", None) or message.actual
        names = tuple(message.joint_names)
        channels = {"q_desired": aim.positions, "v_desired": aim.velocities}
        channels |= {"q": read.positions, "v": read.velocities}
    else:
        # Without names the numbers of the joints must do.
        count = len(message.position)
        names = tuple(message.name) or tuple(str(k + 1) for k in range(count))
        channels = {f"q{after}": message.position, f"v{after}": message.velocity}
        channels |= {} if commanded else {"tau": message.effort}
    return names, {k: x for k, x in channels.items() if len(x) == len(names) > 0}


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
        known = frame[channel] if channel in frame else frame[[]]
        if set(joints) <= set(known) and known[joints].notna().any().all():
            mark = "" if numbered else "_"
            columns |= {f"{channel}{mark}{name}": known[name] for name in joints}
    return Table(
        path=shown,
        frame=pandas_of(shown).DataFrame(columns),
        place="message {}",
        joints=() if numbered else tuple(joints),
        notes=tuple(notes),
    )


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
    frame, channels = frame[rows], ["q", "tau"]
    if "v" in frame and set(joints) <= set(frame["v"]):
        channels += ["v"] * bool(np.isfinite(frame["v"][joints]).all(axis=None))
    return _table(shown, frame, clock[rows], joints, channels, notes)


def _commanded(shown, topics, frame, clock, wanted):
    """Make a table of positions and of those that were commanded."""
    commanded, read = (
        set(frame[x].dropna(axis=1, how="all")) if x in frame else set()
        for x in ("q_desired", "q")
    )
    joints = sorted(commanded & read & set(wanted) or commanded & read)
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


# -- which topic -----------------------------------------------------------------------


def _states(bag, shown, wanted):
    """Return the connections of the topic that was asked for, or of the only one."""
    states = [x for x in bag.connections if x.msgtype == _TYPE and x.msgcount]
    topics = sorted({x.topic for x in states})
    if wanted.topic is not None:
        chosen = [x for x in states if x.topic in (wanted.topic, f"/{wanted.topic}")]
        if chosen:
            return chosen
        near = difflib.get_close_matches(wanted.topic, topics, 1)
        near = topics if len(topics) == 1 else near
        raise RecordingRefused(
            f"{shown}: has no joint states ({_TYPE}) in {wanted.topic}, {_all(bag)}.",
            {"topic": near[0]} if near else {},
        )
    if not topics:
        raise RecordingRefused(
            f"{shown}: holds no joint states: expected a topic of {_TYPE} with "
            f"positions and efforts, {_all(bag)}; record /joint_states."
        )
    if len(topics) > 1:
        able = [x for x in topics if _has_joints(bag, states, x, wanted.joints())]
        if len(able) != 1:
            raise _ambiguous(shown, topics, (able or topics)[0])
        topics = able
    return [x for x in states if x.topic == topics[0]]


def _commands(bag, shown, wanted):
    """Return connections of a controller, or of joint states and of their commands."""
    named = (wanted.topic, f"/{wanted.topic}")
    used = [x for x in bag.connections if x.msgcount]
    found = [x for x in used if x.msgtype == _CONTROLLER]
    found = [x for x in found if wanted.topic is None or x.topic in named]
    topics = sorted({x.topic for x in found})
    if len(topics) > 1:
        raise _ambiguous(shown, topics, topics[0])
    states = [x for x in used if x.msgtype == _TYPE]
    commands = {x.topic for x in states if _COMMAND.search(x.topic)}
    others = {x.topic for x in states} - commands
    others = others if wanted.topic is None else others & {*named}
    if not found and len(commands) == 1 and len(others) == 1:
        found = [x for x in states if x.topic in commands | others]
    if not found:
        raise RecordingRefused(
            f"{shown}: holds {len(others)} topic(s) of joint states and "
            f"{len(commands)} of commanded ones; expected one of "
            f"{_CONTROLLER.replace('/msg', '')}, or one of each, that of commands "
            f"called so, {_all(bag)}."
        )
    return found


def _ambiguous(shown, topics, offered):
    return RecordingRefused(
        f"{shown}: holds {len(topics)} topics of joint states: {listed(topics)}; give "
        "--topic with one of them (in Python: topic=...).",
        {"topic": offered},
    )


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
