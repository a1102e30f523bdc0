"""The robot as MJCF: MuJoCo computes the torques that Pinocchio does."""

from dataclasses import replace

import numpy as np
import pytest

pin = pytest.importorskip("pinocchio")

from sklearn_vbjfa.model import (  # noqa: E402
    JointDynamics,
    Tendon,
    load_model,
    write_mjcf,
)
from tests.model._mujoco import drive_torques, moving_states  # noqa: E402
from tests.model._robots import random_body, random_tree, swing  # noqa: E402
from tests.model.test_urdf import TREE  # noqa: E402


def rigid(model, bodies, states):
    """Torques of bodies by Pinocchio's recursion, (n, nv)."""
    model = model.copy()
    for j, body in enumerate(bodies):
        model.inertias[j + 1] = pin.Inertia.FromDynamicParameters(body)
    data, nv = model.createData(), model.nv
    return np.array([pin.rnea(model, data, *row.reshape(3, nv)) for row in states])


def assert_same(found, expected, share=1e-10):
    assert found.shape == expected.shape
    assert (np.abs(found - expected).max(axis=0) < share * expected.std(axis=0)).all()


@pytest.mark.parametrize("seed", range(2))
def test_bodies_of_random_trees(seed, tmp_path):
    """Branches, oblique axes and sliding joints, in an order of MuJoCo's own."""
    pytest.importorskip("mujoco")
    rng = np.random.default_rng(seed)
    model, bodies = random_tree(rng, 8)
    model.gravity.linear = rng.normal(size=3) * 5.0
    path = tmp_path / "tree.xml"
    write_mjcf(path, model, bodies, JointDynamics.none(8))
    states = moving_states(rng, 50, 8)
    assert_same(drive_torques(path, states), rigid(model, bodies, states))


def test_what_joints_do_by_themselves(tmp_path):
    pytest.importorskip("mujoco")
    rng = np.random.default_rng(1)
    nv = 6
    model, bodies = random_tree(rng, nv)
    own = {
        name: rng.uniform(0.5, 2.0, size=nv)
        for name in ("damping", "frictionloss", "armature", "stiffness", "gain")
    }
    own |= {
        name: rng.normal(size=nv) for name in ("springref", "ref", "constant", "slope")
    }
    tendons = (
        Tendon(joints=(1, 4), sign=1, damping=0.7, frictionloss=0.4, armature=0.2),
        Tendon(joints=(0, 2), sign=-1, damping=0.3, frictionloss=1.1),
    )
    path = tmp_path / "tree.xml"
    write_mjcf(path, model, bodies, JointDynamics(**own, tendons=tendons))
    states = moving_states(rng, 200, nv)
    q, v, a = np.split(states, 3, axis=1)
    # A frictional tendon needs a sum of speeds, too.
    slow = (np.abs(v[:, 1] + v[:, 4]) < 0.1) | (np.abs(v[:, 0] - v[:, 2]) < 0.1)
    states, q, v, a = (x[~slow] for x in (states, q, v, a))
    true = states.copy()
    true[:, :nv] -= own["ref"]
    expected = rigid(model, bodies, true)
    expected += own["damping"] * v + own["frictionloss"] * np.sign(v)
    expected += own["armature"] * a + own["stiffness"] * (q - own["springref"])
    expected += own["constant"] + own["slope"] * q
    for x, y in ((v, 0.7), (np.sign, 0.4), (a, 0.2)):
        total = np.sign(v[:, 1] + v[:, 4]) if x is np.sign else x[:, 1] + x[:, 4]
        expected[:, [1, 4]] += y * total[:, None]
    between = 0.3 * (v[:, 0] - v[:, 2]) + 1.1 * np.sign(v[:, 0] - v[:, 2])
    expected[:, 0] += between
    expected[:, 2] -= between
    assert_same(drive_torques(path, states), own["gain"] * expected)


def test_names_ranges_and_order(tmp_path):
    """Continuous joints have no range, an encoder's zero moves the others'."""
    mujoco = pytest.importorskip("mujoco")
    source, path = tmp_path / "tree.urdf", tmp_path / "tree.xml"
    source.write_text(TREE)
    with pytest.warns(UserWarning, match="no mass"):
        model = load_model(source)
    bodies = np.array([random_body(np.random.default_rng(k)) for k in range(2)])
    dynamics = replace(JointDynamics.none(2), ref=np.array([0.0, 0.25]))
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


def test_a_joint_sticks_under_less_load_than_its_friction(tmp_path):
    """Forward dynamics hold it, and let it go with what exceeds the friction."""
    mujoco = pytest.importorskip("mujoco")
    model, path = swing(), tmp_path / "swing.xml"
    body = np.array([model.inertias[1].toDynamicParameters()])
    dynamics = replace(JointDynamics.none(1), frictionloss=np.array([3.0]))
    write_mjcf(path, model, body, dynamics, dt=0.01)
    read = mujoco.MjModel.from_xml_path(str(path))
    # The load at q = 0 is m g c_x about y.
    weight = -2.0 * 9.81 * 0.1
    for push, moves in ((2.9, False), (-2.9, False), (3.4, True)):
        data = mujoco.MjData(read)
        data.ctrl[0] = push + weight
        for _ in range(200):
            mujoco.mj_step(read, data)
        if moves:
            # Half of a t^2 with (3.4 - 3) / I, as long as gravity changes little.
            assert data.qpos[0] > 0.003
        else:
            assert abs(data.qpos[0]) < 1e-5
