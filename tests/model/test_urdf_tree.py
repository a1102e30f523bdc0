"""Loops of a URDF are refused by the names of their links and joints."""

import pytest

from sklearn_vbjfa.model import joint_names, load_model, load_reduced
from tests.model._shaped import joint, link

LINKS = '<link name="base"/>' + "".join(map(link, "abc"))
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


def robot(text):
    return f'<robot name="r">{text}</robot>'


@pytest.mark.parametrize("words", CLOSURES)
def test_extensions_that_close_loops(write, words):
    path = write(robot(LINKS + TREE + CLOSURES[words]))
    with pytest.raises(ValueError, match=f"robot.urdf': {words} closes a loop"):
        load_model(path)
    # One of the two moves against the other.
    with pytest.raises(ValueError, match=words):
        load_reduced(path, ["j1", "j2"])
    assert joint_names(load_reduced(path, ["j1"])) == ("j1",)


def test_a_link_on_two_joints(write):
    path = write(robot(LINKS + TREE + joint("j4", "b", "c")))
    with pytest.raises(ValueError, match="'c' has two parent joints, 'j3' and 'j4'"):
        load_model(path)


def test_links_in_a_ring(write):
    ring = joint("j1", "base", "a") + joint("j2", "c", "b") + joint("j3", "b", "c")
    with pytest.raises(ValueError, match="links b - c - b form a closed loop"):
        load_model(write(robot(LINKS + ring)))
    with pytest.raises(ValueError, match="links a - a form a closed loop"):
        load_model(write(robot(LINKS + joint("j1", "a", "a"))))
