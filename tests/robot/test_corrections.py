"""Corrections from effects of the robot model, and the URDF written with them."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.effects import BaseTilt, JointAxis, JointZero, TorqueGain
from sklearn_vbjfa.model import joint_origin
from sklearn_vbjfa.robot import corrections_of

FRICTION = ("viscous", "coulomb")
BODY = """<inertial><origin xyz="{0} 0.05 0.1"/><mass value="{1}"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.12" iyz="0" izz="0.09"/></inertial>"""
JOINT = """<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/>
<origin xyz="0.1 0 0.3" {}/><axis xyz="{}"/>
<limit lower="-3" upper="3" effort="9" velocity="3"/></joint>"""
# Fixed links with rotations in between; one origin has no rpy.
FIXED = (
    '<robot name="fixed"><link name="base"/>'
    + JOINT.format("first", "revolute", "base", "one", 'rpy="0.1 0 0"', "0 0 1")
    + f'<link name="one">{BODY.format(0.1, 3)}</link>'
    + JOINT.format("hold", "fixed", "one", "plate", 'rpy="0.4 1.2 -0.3"', "1 0 0")
    + '<link name="plate"/>'
    + JOINT.format("second", "revolute", "plate", "two", "", "0 1 0")
    + f'<link name="two">{BODY.format(0.2, 2)}</link>'
    + JOINT.format("clamp", "fixed", "two", "tool", 'rpy="0 0.7 0"', "1 0 0")
    + f'<link name="tool">{BODY.format(0.0, 1)}</link>'
    + JOINT.format(
        "third", "revolute", "tool", "three", 'rpy="0 1.5707963 0"', "0 .6 .8"
    )
    + f'<link name="three">{BODY.format(-0.1, 1)}</link></robot>'
)


@pytest.fixture(scope="module")
def robot(moved):
    """Identify the arm with the effects that it has."""
    effects = [BaseTilt(), JointZero(2), JointAxis(3), TorqueGain(1)]
    robot = RobotIdentifier(
        moved.urdf, dt=moved.dt, friction=tuple(moved.friction), effects=effects
    )
    return robot.fit(moved.q, moved.tau)


def rotated_gravity(roll, pitch):
    """Return vertical gravity, rotated about x and then about y."""
    s, c = np.sin(roll), np.cos(roll)
    y, z = 9.81 * s, -9.81 * c
    return np.array([np.sin(pitch) * z, y, np.cos(pitch) * z])


def read_urdf(path, gravity, states, zero, gain, friction):
    """Return the measured torques of a robot in a URDF, by Pinocchio alone."""
    model = pin.buildModelFromUrdf(str(path))
    model.gravity.linear = np.array(gravity, dtype=float)
    data, nv = model.createData(), model.nv
    torques = []
    for row in states:
        q, v, a = row.reshape(3, nv)
        rigid = pin.rnea(model, data, q - zero, v, a)
        torques.append(gain * (rigid + friction[0] * v + friction[1] * np.sign(v)))
    return np.array(torques)


def friction_of(path, names):
    """Return the friction of the joints in a URDF, (2, nv)."""
    joints = {j.get("name"): j for j in ElementTree.parse(path).findall("joint")}
    return np.array(
        [
            [float(joints[name].find("dynamics").get(key)) for name in names]
            for key in ("damping", "friction")
        ]
    )


def test_written_urdf_predicts_as_the_identified_robot(robot, moved, tmp_path):
    path = tmp_path / "identified.urdf"
    robot.to_urdf(path)
    tilt, zero, _, gain = robot.effects_
    states = moved.states[::50]
    expected = robot.predict(states)
    torques = read_urdf(
        path,
        rotated_gravity(tilt.roll, tilt.pitch),
        states,
        zero.zero * np.eye(6)[2],
        1.0 + (gain.gain - 1.0) * np.eye(6)[1],
        friction_of(path, robot.joint_names_),
    )
    np.testing.assert_allclose(torques, expected, rtol=1e-8, atol=1e-8)
    # Without the corrections, the same bodies give other torques.
    plain = read_urdf(
        path, [0, 0, -9.81], states, 0.0, 1.0, friction_of(path, robot.joint_names_)
    )
    assert np.abs(plain - expected).max() > 0.01 * np.abs(expected).max()


def test_axes_after_fixed_links_are_written(tmp_path):
    source, path = tmp_path / "fixed.urdf", tmp_path / "out.urdf"
    source.write_text(FIXED)
    axis_errors = {1: (0.04, 0.0, -0.02), 2: (0.03, 0.0, 0.0)}
    recording = make_robot_recording(
        str(source), duration=12.0, dt=0.01, joint_axis=axis_errors, random_state=1
    )
    robot = RobotIdentifier(
        source, dt=recording.dt, friction=FRICTION, effects=[JointAxis(1), JointAxis(2)]
    )
    robot.fit(recording.q, recording.tau)
    assert all(np.abs(effect.values).max() > 1e-3 for effect in robot.effects_)
    robot.to_urdf(path)
    states = recording.states[::50]
    friction = friction_of(path, robot.joint_names_)
    np.testing.assert_allclose(
        read_urdf(path, [0, 0, -9.81], states, 0.0, 1.0, friction),
        robot.predict(states),
        rtol=1e-8,
        atol=1e-8,
    )
    # Reported origins are those in the file, with fixed links in between.
    model = pin.buildModelFromUrdf(str(path))
    corrections = corrections_of(robot)
    assert corrections[0].values["about"] == ("x axis", "z axis")
    assert corrections[1].values["about"] == ("x axis", "axis (0, 0.8, -0.6)")
    for entry in corrections:
        old = joint_origin(robot.features_.nominal_, entry.joint)
        new = joint_origin(model, entry.joint)
        rotation = pin.rpy.rpyToMatrix
        np.testing.assert_allclose(rotation(*entry.values["old_rpy"]), old, atol=1e-12)
        np.testing.assert_allclose(rotation(*entry.values["new_rpy"]), new, atol=1e-12)
    joints = {j.get("name"): j for j in ElementTree.parse(path).findall("joint")}
    original = ElementTree.fromstring(FIXED).findall("joint")
    for joint in original:
        written = joints[joint.get("name")].find("origin")
        assert written.get("xyz") == joint.find("origin").get("xyz")
        same = written.get("rpy") == joint.find("origin").get("rpy")
        assert same == (joint.get("name") not in ("second", "third"))


def test_corrections_hold_the_effect_values(robot, moved):
    corrections = corrections_of(robot)
    tilt, zero, axis, gain = robot.effects_
    expected = [("base_tilt", 0), ("joint_zero", 2), ("joint_axis", 3)]
    assert [(x.name, x.joint) for x in corrections] == [*expected, ("torque_gain", 1)]
    level, offset, turn, channel = (entry.values for entry in corrections)
    np.testing.assert_allclose([level["roll"], level["pitch"]], [4.0, 2.0], atol=0.5)
    np.testing.assert_allclose(level["gravity"], rotated_gravity(tilt.roll, tilt.pitch))
    # Rotating by the lean of the base turns its gravity to -z.
    lean = pin.rpy.rpyToMatrix(*level["lean_rpy"])
    np.testing.assert_allclose(lean @ level["gravity"], [0, 0, -9.81], atol=1e-12)
    assert corrections[1].joint_name == "joint_3"
    assert offset["subtract"] == zero.zero
    assert (offset["plain"], offset["unit"]) == (np.degrees(zero.zero), "degrees")
    assert turn["turns"][0] == np.degrees(axis.about_x)
    assert len(set(turn["about"])) == 2
    assert channel["gain"] == gain.gain


def test_urdf_comment_lists_the_changes(robot, tmp_path):
    path = tmp_path / "identified.urdf"
    robot.to_urdf(path)
    text = path.read_text()
    # The comment is at the top, before any link.
    comment = text[text.index("<!--") : text.index("-->")]
    assert text.index("-->") < text.index("<link")
    level, offset, _, channel = (entry.values for entry in corrections_of(robot))
    assert f"Subtract {offset['plain']:.4g} degrees" in comment
    assert "from what the encoder of joint_3 reads" in comment
    assert f"channel of joint_2 reads by {channel['gain']:.5g}" in comment
    assert f"roll {level['roll']:.4g} and pitch" in comment
    assert "axis of joint_4 was turned" in comment
    assert "Masses that are not individually identifiable" in comment
