"""Robot models: what is read, what is refused, and how."""

import re

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa import RigidBodyFeatures
from sklearn_vbjfa.model import (
    joint_names,
    load_model,
    load_reduced,
    movable_joints,
    nominal_parameters,
    solid_bodies,
)
from sklearn_vbjfa.recording import read_recording
from tests.model._robots import random_tree

ONE_JOINT = """<robot name="bench">
  <link name="base"/>
  <joint name="hinge" type="{kind}">
    <parent link="base"/><child link="bar"/>
    <origin xyz="0 0 1" rpy="0 0 0"/><axis xyz="0 1 0"/>{limit}
  </joint>
  <link name="bar"><inertial>
    <origin xyz="0.1 0 0.3" rpy="0 0 0"/><mass value="2"/>
    <inertia ixx="0.1" ixy="0.01" ixz="0.02" iyy="0.2" iyz="0" izz="0.15"/>
  </inertial></link>
</robot>"""
LIMIT = '<limit lower="-1" upper="1" effort="7" velocity="3"/>'


@pytest.mark.parametrize("limit", ["", '<limit effort="7" velocity="3"/>'])
def test_continuous_joint_is_one_angle(write, limit):
    turning = load_model(write(ONE_JOINT.format(kind="continuous", limit=limit)))
    hinged = load_model(write(ONE_JOINT.format(kind="revolute", limit=LIMIT)))
    assert (turning.nq, turning.nv) == (1, 1)
    assert turning.lowerPositionLimit[0] < -1e6
    assert turning.upperPositionLimit[0] > 1e6
    if limit:
        assert turning.velocityLimit[0] == 3.0
    # beyond one turn, where a (cos, sin) joint would have to wrap
    state = [np.array([x]) for x in (7.5, -2.0, 3.0)]
    np.testing.assert_allclose(
        pin.rnea(turning, turning.createData(), *state),
        pin.rnea(hinged, hinged.createData(), *state),
        rtol=1e-14,
    )


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        ("JointModelFreeFlyer", r"floating \(JointModelFreeFlyer, nq=7, nv=6\)"),
        ("JointModelSpherical", r"\(JointModelSpherical, nq=4, nv=3\)"),
        ("JointModelRUBX", r"nq=2, nv=1.*Of continuous joints \(RUB\), give the URDF"),
    ],
)
def test_refuses_joints_of_other_than_one_freedom(joint, message):
    model, _ = random_tree(np.random.default_rng(0), 2)
    model.addJoint(2, getattr(pin, joint)(), pin.SE3.Identity(), "floating")
    with pytest.raises(ValueError, match=f"one degree of freedom.*{message}"):
        load_model(model)
    with pytest.raises(ValueError, match=r"lock what does not move with pinocchio\."):
        RigidBodyFeatures(model).fit(np.zeros((2, 9)))


def test_refuses_what_is_no_robot(write, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.urdf.*expected the path"):
        load_model(tmp_path / "nowhere.urdf")
    with pytest.raises(TypeError, match=r"path of a URDF or MJCF file or a .*got int"):
        load_model(3)
    with pytest.raises(ValueError, match=r"not readable as URDF.*xacro"):
        load_model(write("<robot><link"))
    with pytest.raises(ValueError, match="no moving joint"):
        load_model(write(ONE_JOINT.format(kind="fixed", limit="")))
    with pytest.raises(ValueError, match="no moving joint"):
        load_model(pin.Model())


def two_joints(second="revolute", extra="", inertial=True):
    """URDF of a bar on a hinge, and of a second bar at its end."""
    first = ONE_JOINT.format(kind="revolute", limit=LIMIT)
    bar = first[first.index('<link name="bar">') : first.index("</robot>")]
    end = bar.replace('"bar"', '"end"') if inertial else '<link name="end"/>'
    joint = (
        f'<joint name="second" type="{second}"><parent link="bar"/>'
        '<child link="end"/><origin xyz="0.2 0.1 0.4" rpy="0.3 0.2 0.1"/>'
        f'<axis xyz="0 0 1"/>{LIMIT}{extra}</joint>'
    )
    return first.replace("</robot>", end + joint + "</robot>")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", ["revolute", "continuous", "prismatic", "floating"])
def test_a_held_joint_makes_one_body_of_two(write, kind):
    # by hand: the second body's inertia, seen from the first joint, is added
    both = load_model(write(two_joints()))
    expected = both.inertias[1] + both.jointPlacements[2].act(both.inertias[2])
    model = load_reduced(write(two_joints(kind)), ["hinge"])
    assert joint_names(model) == ("hinge",)
    np.testing.assert_allclose(
        nominal_parameters(model)[0], expected.toDynamicParameters(), atol=1e-14
    )


@pytest.mark.filterwarnings("error")
def test_what_is_fixed_belongs_to_its_parent_without_a_word(write):
    model = load_model(write(two_joints("fixed")))
    assert joint_names(model) == ("hinge",)
    assert nominal_parameters(model)[0, 0] == pytest.approx(4.0)
    # a massless flange or camera frame is nothing to tell of
    model = load_model(write(two_joints("fixed", inertial=False)))
    assert nominal_parameters(model)[0, 0] == pytest.approx(2.0)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace('<mass value="2"/>', '<mass value="0"/>'),
        # moments that break the triangle inequality
        lambda text: text.replace('izz="0.15"', 'izz="0.9"'),
        lambda text: re.sub("<inertial>.*?</inertial>", "", text, flags=re.DOTALL),
    ],
)
def test_a_body_that_cannot_be_is_told_of(write, change):
    text = change(ONE_JOINT.format(kind="revolute", limit=LIMIT))
    with pytest.warns(UserWarning, match="the body of hinge has no mass, or an in"):
        model = load_model(write(text))
    (body,) = nominal_parameters(model)
    assert solid_bodies(body[None]) == [body[0] > 0]
    if body[0] > 0:
        # the two moments that stay have no more to give: I_zz = I_xx + I_yy at most
        ixx, iyy, izz = np.diag(model.inertias[1].inertia)
        assert (body[0], izz) == pytest.approx((2.0, ixx + iyy), rel=0.02)


def branches(*joints, inertia=0.1):
    """URDF of links of 1 kg; joints are (name, parent, child)."""
    links = "".join(
        f'<link name="{child}"><inertial><origin xyz="0 0 -0.2"/><mass value="1"/>'
        f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" '
        'iyz="0"/></inertial></link>'
        for _, _, child in joints
    )
    listed = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>{LIMIT}'
        '<dynamics damping="-1" friction="-0.39"/></joint>'
        for name, parent, child in joints
    )
    return f'<robot name="r"><link name="base"/>{links}{listed}</robot>'


def test_joints_are_in_the_order_of_the_file(write, tmp_path):
    path = write(branches(("z", "base", "l3"), ("y", "l3", "l2"), ("a", "base", "l1")))
    assert joint_names(load_model(path)) == movable_joints(path) == ("z", "y", "a")
    # What carries a joint goes before it; columns by number are as the file lists them.
    path = write(branches(("b", "l1", "l2"), ("a", "base", "l1")))
    assert joint_names(load_model(path)) == ("a", "b")
    assert movable_joints(path) == ("b", "a")
    motion = np.random.default_rng(0).normal(size=(300, 5)).cumsum(axis=0)
    log = tmp_path / "log.csv"
    heads = "time,q1,q2,tau1,tau2"
    motion[:, 0] = 0.01 * np.arange(300)
    np.savetxt(log, motion, delimiter=",", header=heads, comments="", fmt="%.12g")
    recording = read_recording(log, urdf=path)
    own = recording.joint_names.index("b")
    np.testing.assert_allclose(recording.q[:, own], motion[:, 1], atol=1e-9)


def test_lengths_and_inertias_in_millimetres_are_refused(write):
    text = ONE_JOINT.format(kind="revolute", limit=LIMIT)
    far = text.replace('xyz="0 0 1"', 'xyz="0 0 300"')
    with pytest.raises(ValueError, match="millimetres"):
        load_model(write(far))
    large = re.sub(r'(i[xyz]{2}="[0-9.]+)"', r'\1e6"', text)
    with pytest.raises(ValueError, match="kg mm"):
        load_model(write(large))
