"""Joint states read from ROS bags: joints, stamps, topics and errors."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.recording._bags import States, states, write_ros1, write_ros2
from tests.recording._reading import read_text as read
from tests.recording._reading import refusal

N, DT = 80, 0.01
T = DT * np.arange(N)
JOINTS = ("shoulder", "elbow", "wrist")
Q = np.column_stack([np.sin(3 * T + j) for j in range(3)])
TAU = np.column_stack([np.cos(2 * T + j) for j in range(3)])
CHANNELS = (("q", Q), ("tau", TAU))


def log(**changes):
    return states(**{"t": T, "joints": JOINTS, "q": Q, "tau": TAU} | changes)


def error_of(path, **options):
    """Return the error message, which starts with the file, and its options."""
    error = refusal(path, **options)
    assert str(error).startswith(str(path))
    return str(error), getattr(error, "options", {})


@pytest.fixture(params=["SQLITE3", "MCAP", "ros1", "BZ2", "LZ4"])
def write(request, tmp_path):
    """Write a bag of one of the formats, return its file."""

    def write(*topics, **options):
        if request.param in ("SQLITE3", "MCAP"):
            return write_ros2(tmp_path / "bag", topics, request.param)
        packed = None if request.param == "ros1" else request.param
        return write_ros1(tmp_path / "arm.bag", topics, packed)

    return write


def test_bag_formats_with_and_without_a_folder(write, tmp_path):
    file = write(log())
    alone = Path(shutil.copy(file, tmp_path / f"alone{file.suffix}"))
    for path in (file, alone):
        recording, notes = read(path)
        assert recording.joint_names == JOINTS
        np.testing.assert_array_equal(recording.q, Q)
        np.testing.assert_array_equal(recording.tau, TAU)
        assert recording.dt == pytest.approx(DT)
        assert "read from /joint_states: position [rad or m] as q and effort" in notes
    if file.parent != tmp_path:
        recording, _ = read(file.parent)
        np.testing.assert_array_equal(recording.q, Q)


def test_joint_order_may_change_between_messages(tmp_path):
    rng = np.random.default_rng(0)
    orders = [rng.permutation(3) for _ in range(N)]
    mixed = log(**{x: [y[k, o] for k, o in enumerate(orders)] for x, y in CHANNELS})
    mixed.names[:] = [tuple(JOINTS[j] for j in order) for order in orders]
    recording, _ = read(write_ros2(tmp_path / "bag", [mixed]), joint_names=JOINTS)
    np.testing.assert_array_equal(recording.q, Q)
    np.testing.assert_array_equal(recording.tau, TAU)


def test_header_stamps_are_used_unless_constant(tmp_path):
    late = T + 0.004 * np.random.default_rng(0).uniform(size=N)
    file = write_ros2(tmp_path / "a", [log(t=late, stamps=T)])
    recording, notes = read(file)
    np.testing.assert_allclose(recording.t, T, atol=1e-9)
    file = write_ros2(tmp_path / "b", [log(stamps=np.zeros(N))])
    recording, notes = read(file)
    np.testing.assert_allclose(recording.t, T, atol=1e-9)
    assert "stamps in the headers stand still" in notes


def merged(*topics):
    """Return the messages of several topics as one topic."""
    order = np.argsort(np.concatenate([x.received for x in topics]), kind="stable")

    def values(name):
        listed = [x for topic in topics for x in getattr(topic, name)]
        return [listed[k] for k in order]

    return States(**{x: values(x) for x in ("names", "q", "tau", "received")})


def test_messages_of_other_joints_are_skipped(tmp_path):
    t, finger = T[::8] + 0.001, np.sin(T[::8, None])
    mixed = merged(log(), states(t, ("finger",), finger, 0 * finger))
    file = write_ros2(tmp_path / "bag", [mixed])
    recording, notes = read(file)
    assert recording.joint_names == JOINTS
    np.testing.assert_array_equal(recording.q, Q)
    assert "joint(s) finger have values in less than a fifth of the rows" in notes
    assert "10 row(s) lack a number, the first in message 2, column 'q_sh" in notes
    # Requested joints are read although fewer messages hold them.
    recording, notes = read(file, joint_names=["finger"])
    assert recording.n_samples == 10
    assert "80 row(s) lack a number" in notes


def test_publishers_of_different_joints_are_merged(tmp_path):
    late = T + 0.003
    phase = 3 * late[:, None] + range(3), 2 * late[:, None] + range(3)
    wrist = states(late, JOINTS[2:], np.sin(phase[0])[:, 2:], np.cos(phase[1])[:, 2:])
    arm = log(joints=JOINTS[:2], q=Q[:, :2], tau=TAU[:, :2])
    recording, notes = read(write_ros2(tmp_path / "bag", [merged(arm, wrist)]))
    assert recording.joint_names == JOINTS
    assert "2 sources write rows in turn" in notes
    np.testing.assert_allclose(recording.q, np.sin(phase[0])[:-1], atol=1e-5)
    np.testing.assert_allclose(recording.tau, np.cos(phase[1])[:-1], atol=1e-5)


def test_messages_missing_a_joint_are_interpolated(tmp_path):
    incomplete = log()
    for k in (20, 41):
        incomplete.names[k] = JOINTS[:2]
        incomplete.q[k], incomplete.tau[k] = Q[k, :2], TAU[k, :2]
    recording, notes = read(write_ros2(tmp_path / "bag", [incomplete]))
    assert recording.joint_names == JOINTS
    assert recording.n_samples == N
    np.testing.assert_allclose(recording.q, Q, atol=1e-5)
    assert "2 row(s) lack a number, the first in message 21" in notes
    assert "2 single sample(s) are missing" in notes


def test_unnamed_joints_are_numbered(tmp_path):
    unnamed = log()
    unnamed.names[:] = N * [()]
    recording, _ = read(write_ros2(tmp_path / "bag", [unnamed]))
    assert recording.joint_names == ("joint_1", "joint_2", "joint_3")
    np.testing.assert_array_equal(recording.q, Q)


def test_velocities_are_read_if_in_every_message(tmp_path):
    recording, _ = read(write_ros2(tmp_path / "a", [log(v=list(2 * Q))]))
    np.testing.assert_array_equal(recording.v, 2 * Q)
    recording, _ = read(write_ros2(tmp_path / "b", [log()]))
    assert recording.v is None


def test_sensor_joints_are_skipped_and_unrecorded_joints_held(tmp_path, arm):
    """A sensor's joint is not in the model; the last two joints are held at zero."""
    joints = ("tilt_sensor", *arm.joint_names[3::-1])
    q = np.column_stack([arm.t, arm.q[:, 3::-1]])
    tau = np.column_stack([arm.t, arm.tau[:, 3::-1]])
    file = write_ros2(tmp_path / "bag", [states(arm.t, joints, q, tau)])
    recording, notes = read(file, urdf=arm.urdf)
    assert recording.joint_names == arm.joint_names[:4]
    np.testing.assert_array_equal(recording.q, arm.q[:, :4])
    np.testing.assert_array_equal(recording.tau, arm.tau[:, :4])
    assert "joint(s) tilt_sensor are not joints of the robot" in notes
    assert "no columns of joint(s) joint_5, joint_6: held at zero" in notes


def test_bag_without_joint_states_is_refused(tmp_path):
    text, options = error_of(write_ros2(tmp_path / "bag", [], other=True))
    assert (
        "holds no joint states: expected a topic of sensor_msgs/msg/JointState" in text
    )
    assert "/rosout (std_msgs/msg/String)" in text
    assert not options


def test_several_joint_state_topics_need_a_choice(tmp_path):
    topics = [log(), log(q=2 * Q, topic="/left/joint_states")]
    file = write_ros2(tmp_path / "bag", topics, other=True)
    text, options = error_of(file)
    assert "give --topic (in Python: topic=...), one of /joint_states, /left" in text
    recording, _ = read(file, **options)
    np.testing.assert_array_equal(recording.q, Q)
    recording, _ = read(file, topic="left/joint_states")
    np.testing.assert_array_equal(recording.q, 2 * Q)
    text, _ = error_of(file, topic="/right")
    assert "/rosout (std_msgs/msg/String)" in text


@pytest.mark.parametrize("part", [0.02, 0.5, 0.9])
def test_truncated_bag_is_refused(write, part):
    file = write(log())
    content = file.read_bytes()
    file.write_bytes(content[: int(part * len(content))])
    text, _ = error_of(file)
    assert "is not a complete bag" in text
    # The message is not the repr of a tuple.
    assert "',)" not in text


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE", "STORAGE"])
def test_zstandard_compressed_bags(tmp_path, mode):
    plugin = "MCAP" if mode == "STORAGE" else "SQLITE3"
    file = write_ros2(tmp_path / "bag", [log()], plugin, packed=mode)
    recording, _ = read(file.parent)
    np.testing.assert_array_equal(recording.q, Q)
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    error_of(file.parent)


def test_messages_with_nan_are_skipped(tmp_path):
    start = log(tau=np.where(T[:, None] < 0.1, np.nan, TAU), v=list(np.full_like(Q, 0)))
    start.q[40] = np.array([np.nan, 0, 0])
    start.v[60] = np.array([np.nan, 0, 0])
    recording, notes = read(write_ros2(tmp_path / "bag", [start]))
    assert recording.n_samples == N - 10
    np.testing.assert_allclose(recording.q, Q[10:], atol=1e-4)
    assert "11 row(s) lack a number, the first in message 1" in notes


def test_joint_with_nan_efforts_is_left_out(tmp_path, arm):
    names, tau = arm.joint_names, arm.tau.copy()
    tau[:, 5] = np.nan
    file = write_ros2(tmp_path / "bag", [states(arm.t, names, arm.q, tau)])
    recording, notes = read(file, urdf=arm.urdf)
    assert recording.joint_names == names[:5]
    assert f"joint(s) {names[5]} have values in less than a fifth of" in notes
    file = write_ros2(tmp_path / "none", [log(tau=np.full_like(TAU, np.nan))])
    text, _ = error_of(file)
    assert "none of the 80 messages of /joint_states has positions and efforts" in text
