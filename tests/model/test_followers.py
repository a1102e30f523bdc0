"""Joints that follow others are folded: the robot is the full one to its leaders."""

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa.effects import Motion
from sklearn_vbjfa.equations import RigidBodyFeatures, with_followers
from sklearn_vbjfa.model import (
    joint_names,
    load_folded,
    load_model,
    load_reduced,
    movable_joints,
    write_reduced,
)


def link(name, mass):
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/>'
        '<origin xyz=".1 .02 .03"/><inertia ixx=".1" iyy=".12" izz=".13" '
        'ixy=".01" ixz=".02" iyz=".03"/>'
        "</inertial></link>"
    )


def joint(name, parent, child, kind="revolute", axis="0 1 0", mimic=""):
    inside = f"<mimic {mimic}/>" if mimic else ""
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz=".1 .2 .3" rpy=".1 .2 .3"/>'
        f'<parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
        f'<limit lower="-3" upper="3" effort="1" velocity="20"/>{inside}</joint>'
    )


def robot(*joints):
    used = {name for name in "abcdefgh" if f'child link="{name}"' in "".join(joints)}
    links = "".join(link(name, ord(name) - 96) for name in sorted(used))
    return f'<robot name="r"><link name="base"/>{links}{"".join(joints)}</robot>'


ARM = (joint("j1", "base", "a"), joint("j2", "a", "b", axis="1 0 0"))
GRIP = joint("grip", "b", "c", "prismatic", "1 1 0")
# One that slides, one that hangs on it and follows it, with a fixed tip, and one of its
# own branch that follows the second joint.
FOLLOWERS = (
    joint(
        "f2",
        "b",
        "d",
        "prismatic",
        "1 0 1",
        'joint="grip" multiplier="-.7" offset=".1"',
    ),
    joint("f3", "d", "e", axis="0 0 1", mimic='joint="f2" multiplier="2"'),
    joint("tip", "e", "f", "fixed"),
    joint("f4", "base", "g", "continuous", "0 1 1", 'joint="j2" offset=".3"'),
)
GRIPPER = robot(*ARM, GRIP, *FOLLOWERS)
# Position of each joint: leader, multiplier, offset.
RELATIONS = {
    "j1": ("j1", 1.0, 0.0),
    "j2": ("j2", 1.0, 0.0),
    "grip": ("grip", 1.0, 0.0),
    "f2": ("grip", -0.7, 0.1),
    "f3": ("grip", -1.4, 0.2),
    "f4": ("j2", 1.0, 0.3),
}


def literal(path, q, v, a, names):
    """Torques A' tau(A q + b) of the full robot, by Pinocchio's recursion, (n, nv)."""
    full = pin.buildModelFromXML(
        path.read_text().replace('type="continuous"', 'type="revolute"')
    )
    A, b = np.zeros((full.nv, len(names))), np.zeros(full.nv)
    for name, (leader, multiplier, offset) in RELATIONS.items():
        at = full.joints[full.getJointId(name)].idx_v
        A[at, names.index(leader)], b[at] = multiplier, offset
    data = full.createData()
    return np.array(
        [
            A.T @ pin.rnea(full, data, A @ x + b, A @ y, A @ z)
            for x, y, z in zip(q, v, a)
        ]
    )


def test_torques_are_those_of_the_full_robot_seen_from_its_leaders(write):
    """A' tau(A q + b) of the full one; bodies of followers have their own columns."""
    path = write(GRIPPER)
    features = RigidBodyFeatures(path).load()
    names = joint_names(features.model_)
    assert names == movable_joints(path) == ("j1", "j2", "grip")
    q, v, a = np.random.default_rng(0).normal(size=(3, 20, 3))
    data = features.model_.createData()
    found = [pin.rnea(features.model_, data, *row) for row in zip(q, v, a)]
    effects = with_followers((), features)
    assert [effect.of for effect in effects] == ["f2", "f3", "f4"]
    for effect, body in zip(effects, features.followers_):
        found = found + effect.columns(Motion(q=q, v=v, a=a)) @ body.parameters
    expected = literal(path, q, v, a, names)
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_held_followers(write, tmp_path):
    """What follows a joint that moves moves along, unless it is named."""
    path, target = write(GRIPPER), tmp_path / "held.urdf"
    assert write_reduced(path, target, ["j1", "j2"]) == ("grip", "f2", "f3")
    held = load_folded(target)
    assert joint_names(held.model) == ("j1", "j2")
    assert [body.name for body in held.followers] == ["f4"]
    assert joint_names(load_reduced(path, ["j1"])) == ("j1",)
    assert write_reduced(path, target, ["j2", "grip", "f2"]) == ("j1",)
    named = load_folded(target)
    assert joint_names(named.model) == ("j2", "grip", "f2")
    assert [body.name for body in named.followers] == ["f3", "f4"]
    leader = joint_names(named.model)[named.followers[0].leader]
    assert leader in {"f2", "grip"}
    # The total mass is the same, wherever it hangs.
    for one in (held, named, load_folded(path)):
        mass = sum(inertia.mass for inertia in one.model.inertias)
        mass += sum(body.parameters[0] for body in one.followers)
        still = sum(inertia.mass for inertia in one.still.inertias)
        assert mass == pytest.approx(sum(range(1, 8)))
        assert still == pytest.approx(sum(range(1, 8)))


def test_one_that_carries_a_joint_of_its_own_cannot_be_folded(write):
    rod = joint("rod", "b", "c", mimic='joint="j2" multiplier="-1"')
    path = write(robot(*ARM, rod, joint("wrist", "c", "d")))
    with pytest.warns(UserWarning, match="rod follow.s. another joint and carries"):
        model = load_model(path)
    assert joint_names(model) == movable_joints(path) == ("j1", "j2", "rod", "wrist")
    # With the wrist held it can; it is not held where its leader moves.
    assert joint_names(load_reduced(path, ["j1", "j2"])) == ("j1", "j2")
    with pytest.raises(ValueError, match="rod follows j2, which moves"):
        load_reduced(path, ["j1", "j2", "wrist"])


@pytest.mark.parametrize(
    ("mimic", "message"),
    [
        ('joint="gone"', "'f' mimics 'gone', which is not a moving joint"),
        ('multiplier="2"', "'f' mimics '', which is not a moving joint"),
        ('joint="f"', "mimic joints f form a cycle"),
        ('joint="j2" multiplier="x"', "with the multiplier 'x', which is not a number"),
        ('joint="j2" offset="inf"', "with the offset 'inf', which is not a number"),
    ],
)
def test_refuses_what_cannot_be_followed(write, mimic, message):
    path = write(robot(*ARM, joint("f", "b", "c", mimic=mimic)))
    for read in (load_model, movable_joints):
        with pytest.raises(ValueError, match=f"robot.urdf.*{message}"):
            read(path)
