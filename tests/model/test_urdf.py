"""The identified robot as URDF: what is read back is what was written."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa.model import load_model, nominal_parameters, write_urdf
from sklearn_vbjfa.physical import is_consistent
from tests.model._robots import random_body

TREE = """<?xml version="1.0"?>
<robot name="tree">
  <link name="base"><inertial><mass value="50"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="stand" type="fixed"><parent link="base"/><child link="column"/></joint>
  <link name="column"><inertial><mass value="20"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="right" type="continuous"><parent link="column"/><child link="arm"/>
    <origin xyz="0.1 0 0.2" rpy="0.3 0.2 0.1"/><axis xyz="0 1 0"/></joint>
  <link name="arm"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
  <joint name="flange" type="fixed"><parent link="arm"/><child link="plate"/>
    <origin xyz="0 0 0.3" rpy="0.5 0 0"/></joint>
  <link name="plate"><inertial><origin xyz="0 0.1 0"/><mass value="1"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="grip" type="fixed"><parent link="plate"/><child link="hand"/></joint>
  <link name="hand"><inertial><mass value="2"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="left" type="prismatic"><parent link="plate"/><child link="slide"/>
    <origin xyz="0 0.1 0"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="9" velocity="2"/>
    <dynamics damping="77" friction="88"/></joint>
  <link name="slide"/>
</robot>
"""


@pytest.fixture
def tree(tmp_path):
    path = tmp_path / "tree.urdf"
    path.write_text(TREE)
    return path


def test_round_trip_of_an_identified_arm(identified, tmp_path):
    path = tmp_path / "identified.urdf"
    identified.to_urdf(path)
    # read by Pinocchio alone: the file is any program's
    read = pin.buildModelFromUrdf(str(path))
    bodies = np.array([b.toDynamicParameters() for b in read.inertias[1:]])
    expected = identified.theta_.reshape(6, 12)[:, :10]
    # About the centre of mass and back: rounding of m c^2.
    np.testing.assert_allclose(bodies, expected, rtol=1e-10, atol=1e-12)
    # On the boundary of the set (margin 1e-8) the text keeps what the arithmetic had.
    for body in bodies:
        assert is_consistent(body, margin=-1e-12)
    root = ElementTree.parse(path).getroot()
    for j, joint in enumerate(root.findall("joint")[:6]):
        dynamics = joint.find("dynamics")
        assert float(dynamics.get("damping")) == identified.theta_[12 * j + 10]
        assert float(dynamics.get("friction")) == identified.theta_[12 * j + 11]
    # The tool is one body with the flange and keeps no inertia of its own.
    links = {link.get("name"): link for link in root.findall("link")}
    assert links["tool"].find("inertial") is None
    assert links["flange"].find("inertial") is not None
    assert len(root.findall("joint")) == 7
    assert {"base", "tool"} < set(links)


def test_links_fixed_to_a_link_are_merged_with_it(tree, tmp_path):
    rng = np.random.default_rng(0)
    bodies = np.array([random_body(rng), random_body(rng)])
    friction = np.array([[0.5, 0.25], [4.0, 8.0]])
    target = tmp_path / "out.urdf"
    model = load_model(tree)
    assert tuple(model.names)[1:] == ("right", "left")
    write_urdf(tree.read_text(), target, model, np.hstack([bodies, friction]))
    again = load_model(target)
    np.testing.assert_allclose(nominal_parameters(again), bodies, rtol=1e-10)
    root = ElementTree.parse(target).getroot()
    links = {link.get("name"): link for link in root.findall("link")}
    has = {name for name, link in links.items() if link.find("inertial") is not None}
    # what stands still keeps its own; plate and hand went into the arm
    assert has == {"base", "column", "arm", "slide"}
    assert links["arm"].find("visual") is not None
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    for name, row in zip(("right", "left"), friction):
        assert len(joints[name].findall("dynamics")) == 1
        dynamics = joints[name].find("dynamics")
        assert float(dynamics.get("damping")) == row[0]
        assert float(dynamics.get("friction")) == row[1]
    assert joints["right"].get("type") == "continuous"
    assert joints["left"].find("limit").get("effort") == "9"
    assert joints["flange"].find("dynamics") is None
    assert tree.read_text() == TREE  # the source is left alone


def test_refuses_a_description_without_the_joints(tree, simulated, tmp_path):
    rows = np.zeros((6, 12))
    rows[:, :10] = [random_body(np.random.default_rng(k)) for k in range(6)]
    model = load_model(simulated.urdf)
    with pytest.raises(ValueError, match="no joint named joint_1, joint_2"):
        write_urdf(tree.read_text(), tmp_path / "out.urdf", model, rows)
    rows[3, 0] = -1.0
    with pytest.raises(ValueError, match=r'mass -1: only .* Use projector="default"'):
        write_urdf(Path(simulated.urdf).read_text(), tmp_path / "out.urdf", model, rows)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "'right' has the axis '0 0 0'"),
        ("</robot>", "<a>" * 2000 + "</a>" * 2000 + "</robot>", "recursion depth"),
    ],
)
def test_descriptions_that_no_robot_has(tmp_path, old, new, message):
    path = tmp_path / "tree.urdf"
    path.write_text(TREE.replace(old, new, 1))
    with pytest.raises(ValueError, match=message) as info:
        load_model(path)
    assert str(path) in str(info.value)
