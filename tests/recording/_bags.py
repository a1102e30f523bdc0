"""Bags with joint states, as drivers publish them, written by rosbags."""

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, kw_only=True)
class States:
    """Messages of one topic.

    names : a tuple of joints for every message; q, tau (and v) : lists of their values;
    received : time at which the recorder wrote them [s]; stamps : those in the headers.
    """

    topic: str = "/joint_states"
    names: list
    q: list
    tau: list
    received: np.ndarray
    stamps: np.ndarray | None = None
    v: list = field(default_factory=list)


def states(t, joints, q, tau, **more):
    """Return messages that all name the same joints."""
    count = len(t)
    return States(
        names=count * [tuple(joints)], q=list(q), tau=list(tau), received=t, **more
    )


def _messages(typestore, one, header):
    """Yield (time of receipt [ns], message)."""
    JointState = typestore.types["sensor_msgs/msg/JointState"]
    stamps = one.received if one.stamps is None else one.stamps
    for k, received in enumerate(one.received):
        stamp = round(1e9 * float(stamps[k]))
        message = JointState(
            header(k, stamp),
            list(one.names[k]),
            np.array(one.q[k], dtype=float),
            np.array(one.v[k] if one.v else [], dtype=float),
            np.array(one.tau[k], dtype=float),
        )
        yield round(1e9 * float(received)) + 10**9, message


def _write(bag, topics, typestore, serialize, header):
    kind = "sensor_msgs/msg/JointState"
    for one in topics:
        connection = bag.add_connection(one.topic, kind, typestore=typestore)
        for received, message in _messages(typestore, one, header):
            bag.write(connection, received, serialize(message, kind))


def write_ros2(folder, topics, plugin="SQLITE3", other=False, packed=None):
    """Write a bag of ROS 2; return the file with the messages."""
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
            word = typestore.types[kind]("hello")
            bag.write(connection, 10**9, typestore.serialize_cdr(word, kind))
        _write(bag, topics, typestore, typestore.serialize_cdr, header)
    (file,) = [x for x in folder.iterdir() if x.suffix != ".yaml"]
    return file


def write_ros1(file, topics, compression=None):
    """Write a bag of ROS 1; return it."""
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
