"""Loops of a URDF are refused by the names of their links and joints."""

import pytest

from sklearn_vbjfa.model import joint_names, load_model, load_reduced

MASS = (
    '<inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" '
    'iyz="0"/></inertial>'
)
LINKS = '<link name="base"/>' + "".join(
    f'<link name="{name}">{MASS}</link>' for name in ("a", "b", "c")
)


def joint(name, parent, child, kind="revolute"):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )


TREE = joint("j1", "base", "a") + joint("j2", "a", "b") + joint("j3", "a", "c")
# What Isaac Sim and Gazebo have for loops.
CLOSURES = {
    "<loop_joint> 'rod' between b and c": (
        '<loop_joint name="rod" type="spherical"><link1 link="b"/><link2 link="c"/>'
        "</loop_joint>"
    ),
    "<joint> 'rod' of <gazebo> between b and c": (
        '<gazebo><joint name="rod" type="revolute"><parent>b</parent>'
        "<child> c </child></joint></gazebo>"
    ),
}


@pytest.fixture
def write(tmp_path):
    def to_file(text):
        path = tmp_path / "robot.urdf"
        path.write_text(f'<robot name="r">{text}</robot>')
        return path

    return to_file


@pytest.mark.parametrize("words", CLOSURES)
def test_extensions_that_close_loops(write, words):
    path = write(LINKS + TREE + CLOSURES[words])
    with pytest.raises(ValueError, match=f"robot.urdf': {words} closes a loop"):
        load_model(path)
    # One of the two moves against the other.
    with pytest.raises(ValueError, match=words):
        load_reduced(path, ["j1", "j2"])
    assert joint_names(load_reduced(path, ["j1"])) == ("j1",)


def test_a_link_on_two_joints(write):
    path = write(LINKS + TREE + joint("j4", "b", "c"))
    with pytest.raises(ValueError, match="'c' has two parent joints, 'j3' and 'j4'"):
        load_model(path)


def test_links_in_a_ring(write):
    ring = joint("j1", "base", "a") + joint("j2", "c", "b") + joint("j3", "b", "c")
    with pytest.raises(ValueError, match="links b - c - b form a closed loop"):
        load_model(write(LINKS + ring))
    with pytest.raises(ValueError, match="links a - a form a closed loop"):
        load_model(write(LINKS + joint("j1", "a", "a")))
