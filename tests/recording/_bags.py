"""ROS bags with joint states, written by rosbags."""

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, kw_only=True)
class States:
    """Messages of one topic.

    names : a tuple of joints per message; q, tau (and v) : lists of their values;
    received : times at which the recorder wrote them [s]; stamps : header stamps [s].
    """

    topic: str = "/joint_states"
    names: list
    q: list
    tau: list
    received: np.ndarray
    stamps: np.ndarray | None = None
    v: list = field(default_factory=list)


def states(t, joints, q, tau, **more):
    """Return messages with the same joints in each."""
    count = len(t)
    return States(
        names=count * [tuple(joints)], q=list(q), tau=list(tau), received=t, **more
    )


def _messages(typestore, topic, header):
    """Yield (time of receipt [ns], message)."""
    JointState = typestore.types["sensor_msgs/msg/JointState"]
    stamps = topic.received if topic.stamps is None else topic.stamps
    for k, received in enumerate(topic.received):
        stamp = round(1e9 * float(stamps[k]))
        message = JointState(
            header(k, stamp),
            list(topic.names[k]),
            np.array(topic.q[k], dtype=float),
            np.array(topic.v[k] if topic.v else [], dtype=float),
            np.array(topic.tau[k], dtype=float),
        )
        yield round(1e9 * float(received)) + 10**9, message


def _write(bag, topics, typestore, serialize, header):
    kind = "sensor_msgs/msg/JointState"
    for topic in topics:
        connection = bag.add_connection(topic.topic, kind, typestore=typestore)
        for received, message in _messages(typestore, topic, header):
            bag.write(connection, received, serialize(message, kind))


def write_ros2(folder, topics, plugin="SQLITE3", other=False, packed=None):
    """Write a ROS 2 bag; return the file with the messages."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
    from rosbags.typesys import Stores, get_typestore

    typestore = get_typestore(Stores.ROS2_HUMBLE)
    Header = typestore.types["std_msgs/msg/Header"]
    Time = typestore.types["builtin_interfaces/msg/Time"]

    def header(k, stamp):
        return Header(Time(stamp // 10**9, stamp % 10**9), "")

    bag = Writer(folder, version=9, storage_plugin=getattr(StoragePlugin, plugin))
    if packed is not None:
        mode = getattr(CompressionMode, packed)
        bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        if other:
            kind = "std_msgs/msg/String"
            connection = bag.add_connection("/rosout", kind, typestore=typestore)
            message = typestore.types[kind]("hello")
            bag.write(connection, 10**9, typestore.serialize_cdr(message, kind))
        _write(bag, topics, typestore, typestore.serialize_cdr, header)
    (file,) = [x for x in folder.iterdir() if x.suffix != ".yaml"]
    return file


def write_ros1(file, topics, compression=None):
    """Write a ROS 1 bag; return its path."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    typestore = get_typestore(Stores.ROS1_NOETIC)
    Header = typestore.types["std_msgs/msg/Header"]
    Time = typestore.types["builtin_interfaces/msg/Time"]

    def header(k, stamp):
        return Header(k, Time(stamp // 10**9, stamp % 10**9), "")

    bag = Writer(file)
    if compression is not None:
        bag.set_compression(getattr(Writer.CompressionFormat, compression))
    with bag:
        _write(bag, topics, typestore, typestore.serialize_ros1, header)
    return file
