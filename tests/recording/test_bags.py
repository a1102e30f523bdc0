"""Joint states out of bags: whatever joints they name, and what is refused."""

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


def arm(**changes):
    return states(**{"t": T, "joints": JOINTS, "q": Q, "tau": TAU} | changes)


def refused(path, **options):
    """Return the text of the refusal, which begins with the file, and its options."""
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


def test_every_format_with_and_without_its_folder(write, tmp_path):
    file = write(arm())
    alone = Path(shutil.copy(file, tmp_path / f"alone{file.suffix}"))
    for path in (file, alone):
        recording, said = read(path)
        assert recording.joint_names == JOINTS
        np.testing.assert_array_equal(recording.q, Q)
        np.testing.assert_array_equal(recording.tau, TAU)
        assert recording.dt == pytest.approx(DT)
        assert "read from /joint_states: position [rad or m] as q and effort" in said
    if file.parent != tmp_path:
        recording, _ = read(file.parent)
        np.testing.assert_array_equal(recording.q, Q)


def test_joints_by_name_in_another_order_each_time(tmp_path):
    rng = np.random.default_rng(0)
    orders = [rng.permutation(3) for _ in range(N)]
    mixed = States(
        names=[tuple(JOINTS[j] for j in order) for order in orders],
        q=[Q[k, order] for k, order in enumerate(orders)],
        tau=[TAU[k, order] for k, order in enumerate(orders)],
        received=T,
    )
    recording, _ = read(write_ros2(tmp_path / "bag", [mixed]), joint_names=JOINTS)
    np.testing.assert_array_equal(recording.q, Q)
    np.testing.assert_array_equal(recording.tau, TAU)


def test_stamps_of_the_header_count_unless_they_stand_still(tmp_path):
    late = T + 0.004 * np.random.default_rng(0).uniform(size=N)
    file = write_ros2(tmp_path / "a", [arm(t=late, stamps=T)])
    recording, said = read(file)
    np.testing.assert_allclose(recording.t, T, atol=1e-9)
    file = write_ros2(tmp_path / "b", [arm(stamps=np.zeros(N))])
    recording, said = read(file)
    np.testing.assert_allclose(recording.t, T, atol=1e-9)
    assert "stamps in the headers stand still" in said


def gripper(**more):
    t = T[::4] + 0.001
    finger = np.sin(t)[:, None]
    return {"t": t, "joints": ("finger",), "q": finger, "tau": 0 * finger} | more


def merged(*topics):
    """Return one topic of the messages of several."""
    order = np.argsort(np.concatenate([x.received for x in topics]), kind="stable")

    def values(name):
        listed = [x for one in topics for x in getattr(one, name)]
        return [listed[k] for k in order]

    return States(
        names=values("names"),
        q=values("q"),
        tau=values("tau"),
        received=np.array(values("received")),
    )


def test_joints_that_come_and_go(tmp_path):
    both = merged(arm(), states(**gripper()))
    file = write_ros2(tmp_path / "bag", [both])
    recording, said = read(file)
    assert recording.joint_names == JOINTS
    np.testing.assert_array_equal(recording.q, Q)
    assert "joint(s) finger of /joint_states left out" in said
    assert "20 of 100 messages of /joint_states lack some of the joints taken" in said
    # Those that were asked for, though they come less often.
    recording, said = read(file, joint_names=["finger"])
    assert recording.n_samples == 20
    assert "80 of 100 messages" in said


def test_messages_that_lack_a_joint_are_gaps(tmp_path):
    lost = arm()
    for k in (20, 41):
        lost.names[k] = JOINTS[:2]
        lost.q[k], lost.tau[k] = Q[k, :2], TAU[k, :2]
    recording, said = read(write_ros2(tmp_path / "bag", [lost]))
    assert recording.joint_names == JOINTS
    assert recording.n_samples == N
    np.testing.assert_allclose(recording.q, Q, atol=1e-5)
    assert "2 of 80 messages" in said
    assert "2 single sample(s) are missing" in said


def test_messages_without_names_are_numbered(tmp_path):
    plain = arm()
    plain.names[:] = N * [()]
    recording, _ = read(write_ros2(tmp_path / "bag", [plain]))
    assert recording.joint_names == ("joint_1", "joint_2", "joint_3")
    np.testing.assert_array_equal(recording.q, Q)


def test_velocities_are_taken_if_all_messages_have_them(tmp_path):
    recording, _ = read(write_ros2(tmp_path / "a", [arm(v=list(2 * Q))]))
    np.testing.assert_array_equal(recording.v, 2 * Q)
    recording, _ = read(write_ros2(tmp_path / "b", [arm()]))
    assert recording.v is None


# -- robots ----------------------------------------------------------------------------


def test_sensors_and_joints_that_were_not_recorded(tmp_path, made):
    """A sensor's joint is none of the robot's; the last two joints are held."""
    joints = ("tilt_sensor", *made.joint_names[3::-1])
    q = np.column_stack([made.t, made.q[:, 3::-1]])
    tau = np.column_stack([made.t, made.tau[:, 3::-1]])
    file = write_ros2(tmp_path / "bag", [states(made.t, joints, q, tau)])
    recording, said = read(file, urdf=made.urdf)
    assert recording.joint_names == made.joint_names[:4]
    np.testing.assert_array_equal(recording.q, made.q[:, :4])
    np.testing.assert_array_equal(recording.tau, made.tau[:, :4])
    assert "joint(s) tilt_sensor of /joint_states left out" in said
    assert "no columns of joint(s) joint_5, joint_6: held at zero" in said


# -- what is refused -------------------------------------------------------------------


def test_a_bag_without_joint_states(tmp_path):
    text, options = refused(write_ros2(tmp_path / "bag", [], other=True))
    assert (
        "holds no joint states: expected a topic of sensor_msgs/msg/JointState" in text
    )
    assert "/rosout (std_msgs/msg/String)" in text
    assert not options


def test_several_topics_of_joint_states(tmp_path):
    topics = [arm(), arm(q=2 * Q, topic="/left/joint_states")]
    file = write_ros2(tmp_path / "bag", topics, other=True)
    text, options = refused(file)
    assert "give --topic (in Python: topic=...), one of /joint_states, /left" in text
    recording, _ = read(file, **options)
    np.testing.assert_array_equal(recording.q, Q)
    recording, _ = read(file, topic="left/joint_states")
    np.testing.assert_array_equal(recording.q, 2 * Q)
    text, _ = refused(file, topic="/right")
    assert "/rosout (std_msgs/msg/String)" in text


@pytest.mark.parametrize("part", [0.02, 0.5, 0.9])
def test_a_bag_that_was_cut(write, part):
    file = write(arm())
    content = file.read_bytes()
    file.write_bytes(content[: int(part * len(content))])
    text, _ = refused(file)
    assert "is not a complete bag" in text
    # No tuple of Python's.
    assert "',)" not in text


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE", "STORAGE"])
def test_bags_packed_by_zstandard(tmp_path, mode):
    plugin = "MCAP" if mode == "STORAGE" else "SQLITE3"
    file = write_ros2(tmp_path / "bag", [arm()], plugin, packed=mode)
    recording, _ = read(file.parent)
    np.testing.assert_array_equal(recording.q, Q)
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    refused(file.parent)


def test_a_driver_that_does_not_know_yet(tmp_path):
    begin = arm(tau=np.where(T[:, None] < 0.1, np.nan, TAU), v=list(np.full_like(Q, 0)))
    begin.q[40] = np.array([np.nan, 0, 0])
    begin.v[60] = np.array([np.nan, 0, 0])
    recording, said = read(write_ros2(tmp_path / "bag", [begin]))
    assert recording.n_samples == N - 10
    np.testing.assert_allclose(recording.q, Q[10:], atol=1e-4)
    assert "11 of 80 messages of /joint_states lack some of the joints taken" in said


def test_a_joint_whose_effort_nobody_knows(tmp_path, made):
    names, tau = made.joint_names, made.tau.copy()
    tau[:, 5] = np.nan
    file = write_ros2(tmp_path / "bag", [states(made.t, names, made.q, tau)])
    recording, said = read(file, urdf=made.urdf)
    assert recording.joint_names == names[:5]
    assert f"joint(s) {names[5]} of /joint_states left out" in said
    file = write_ros2(tmp_path / "none", [arm(tau=np.full_like(TAU, np.nan))])
    text, _ = refused(file)
    assert "none of the 80 messages of /joint_states has positions and efforts" in text
