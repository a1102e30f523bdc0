"""The robot as MJCF: MuJoCo computes the torques that Pinocchio does."""

from dataclasses import fields, replace

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa.model import JointDynamics, load_model, write_mjcf
from tests.effects._arms import inverse_dynamics
from tests.model._mujoco import drive_torques, moving_states
from tests.model._robots import random_body, random_tree
from tests.model.test_urdf import TREE


def free_joints(nv):
    """Return joints with the bodies alone."""
    names = [one.name for one in fields(JointDynamics)]
    zeros = {name: np.zeros(nv) for name in names if name not in ("gain", "tendons")}
    return JointDynamics(**zeros, gain=np.ones(nv))


def rigid(model, bodies, states):
    """Torques of bodies by Pinocchio's recursion, (n, nv)."""
    model = model.copy()
    for j, body in enumerate(bodies):
        model.inertias[j + 1] = pin.Inertia.FromDynamicParameters(body)
    return inverse_dynamics(model, states)


def assert_same(found, expected, share=1e-10):
    assert found.shape == expected.shape
    assert (np.abs(found - expected).max(axis=0) < share * expected.std(axis=0)).all()


@pytest.mark.parametrize("seed", range(2))
def test_bodies_of_random_trees(seed, tmp_path):
    """Branches, oblique axes and sliding joints, in an order of MuJoCo's own."""
    rng = np.random.default_rng(seed)
    model, bodies = random_tree(rng, 8)
    model.gravity.linear = rng.normal(size=3) * 5.0
    path = tmp_path / "tree.xml"
    write_mjcf(path, model, bodies, free_joints(8))
    states = moving_states(rng, 50, 8)
    assert_same(drive_torques(path, states), rigid(model, bodies, states))


def test_names_ranges_and_order(tmp_path):
    """Continuous joints have no range, an encoder's zero moves the others'."""
    import mujoco

    source, path = tmp_path / "tree.urdf", tmp_path / "tree.xml"
    source.write_text(TREE)
    with pytest.warns(UserWarning, match="no mass"):
        model = load_model(source)
    bodies = np.array([random_body(np.random.default_rng(k)) for k in range(2)])
    dynamics = replace(free_joints(2), ref=np.array([0.0, 0.25]))
    write_mjcf(path, model, bodies, dynamics, note="of a--b")
    assert "<!-- of a- -b -->" in path.read_text()
    read = mujoco.MjModel.from_xml_path(str(path))
    assert [read.joint(j).name for j in range(2)] == ["right", "left"]
    assert [read.actuator(j).name for j in range(2)] == ["right", "left"]
    assert [read.body(j).name for j in range(3)] == ["world", "arm", "slide"]
    assert read.jnt_limited.tolist() == [False, True]
    np.testing.assert_allclose(read.jnt_range[1], [-0.75, 1.25])
    assert read.jnt_type.tolist() == [
        mujoco.mjtJoint.mjJNT_HINGE,
        mujoco.mjtJoint.mjJNT_SLIDE,
    ]
    np.testing.assert_allclose(read.body_mass[1:], bodies[:, 0], rtol=1e-15)
