"""Correction of a description from poses, against Pinocchio's gravity torques."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from _posed_arms import NOISE, STEP, Arm, gravity, pin, record, visit

from sklearn_vbjfa import RigidBodyFeatures
from sklearn_vbjfa.design import Clearance
from sklearn_vbjfa.gravity import correct_gravity, gravity_poses, static_samples
from sklearn_vbjfa.model import DoubtWarning, load_model
from tests.model._shaped import arm

FRICTION = np.array([0.3, 1.2, 0.8])
ARM = Arm(
    masses=np.array([4.0, 3.0, 1.5]),
    centres=np.array([[0.01, 0.0, 0.1], [0.0, 0.02, 0.15], [0.0, 0.0, 0.1]]),
    lengths=np.array([0.2, 0.3, 0.2]),
)
WRONG = replace(
    ARM, masses=ARM.masses * [1.0, 0.7, 1.4], centres=ARM.centres * [[1], [1.2], [1]]
)
POSES = np.random.default_rng(0).uniform(-2.0, 2.0, (8, 3))
OTHERS = np.random.default_rng(1).uniform(-2.0, 2.0, (200, 3))


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Make the true robot, its wrong description, and a recording of eight poses."""
    folder = tmp_path_factory.mktemp("arm")
    true = ARM.write(folder / "true.urdf")
    described = folder / "described.urdf"
    before = WRONG.write(described)
    q = visit(POSES)
    recording = record(true, q, FRICTION, np.random.default_rng(2))
    return SimpleNamespace(
        true=true, before=before, described=described, recording=recording
    )


@pytest.fixture(scope="module")
def found(world):
    """Correction by the eight poses."""
    return correct_gravity(world.recording, world.described)


def errors(model, world):
    """Errors (200, 3) of the gravity torque of a model at other poses."""
    return gravity(model, OTHERS) - gravity(world.true, OTHERS)


def exported(correction, folder):
    """Write the corrected description and load it."""
    correction.identifier.to_urdf(folder / "out.urdf")
    return pin.buildModelFromUrdf(str(folder / "out.urdf"))


def assert_corrected(after, world):
    assert (after**2).mean() < 0.05**2 * (errors(world.before, world) ** 2).mean()


def test_samples_are_the_poses_with_the_side_they_were_reached_from(world):
    features = RigidBodyFeatures(world.described, friction=()).load()
    states, tau, _ = static_samples(world.recording, features)
    q, v, _ = np.split(states, 3, axis=1)
    held = np.repeat(POSES, 2, axis=0)
    at_pose = np.abs(q[:, None] - held).max(axis=2).min(axis=1) < 1e-3
    assert at_pose.sum() == 16
    torque = tau - gravity(world.true, q)
    # Each is a mean over at least 40 readings.
    noise = NOISE * np.sqrt((gravity(world.true, world.recording.q) ** 2).mean(axis=0))
    error = np.abs(torque - np.sign(v) * FRICTION)[at_pose]
    assert error.max() < 4 * noise.max() / np.sqrt(40) + STEP / 2


def test_gravity_of_the_exported_description_is_that_of_the_robot(
    world, found, tmp_path
):
    after = errors(exported(found, tmp_path), world)
    assert_corrected(after, world)
    inside = np.abs(after)[:, 1:] <= 2 * found.interval_at(OTHERS)[:, 1:]
    assert inside.mean() > 0.9


def test_inertias_about_centres_of_mass_stay_as_described(world, found, tmp_path):
    after = exported(found, tmp_path)
    text = (tmp_path / "out.urdf").read_text()
    assert "Inertias from the description: link1, link2, link3." in text
    for one, described in zip(after.inertias[1:], world.before.inertias[1:]):
        np.testing.assert_allclose(one.inertia, described.inertia, atol=1e-9)
    assert abs(after.inertias[3].mass / world.before.inertias[3].mass - 1) > 0.1


def test_held_out_errors_decrease(found):
    gravity_joints = found.gravity > 0
    assert gravity_joints.tolist() == [False, True, True]
    ratio = found.error_after[gravity_joints] / found.error_before[gravity_joints]
    assert (ratio < 0.3).all()
    assert found.friction_known.all()
    assert found.friction == pytest.approx(FRICTION, rel=0.1)
    assert found.payload is None
    assert not found.findings


def test_friction_that_reverses_at_once(world, monkeypatch):
    monkeypatch.setattr("_posed_arms.SLIP", 1e-6)
    recording = record(world.true, visit(POSES), FRICTION, np.random.default_rng(2))
    found = correct_gravity(recording, world.described)
    assert found.friction == pytest.approx(FRICTION, rel=0.03)
    assert (found.error_after < 0.05).all()


def test_a_payload_that_the_description_lacks(world, tmp_path):
    right = tmp_path / "right.urdf"
    true = ARM.write(right)
    true.inertias[3] += pin.Inertia(1.0, np.array([0.02, 0.0, 0.1]), 1e-3 * np.eye(3))
    recording = record(true, visit(POSES), FRICTION, np.random.default_rng(3))
    mass, std = correct_gravity(recording, right).payload
    assert abs(mass - 1.0) < 0.1
    assert std < 0.05


def test_one_row_of_each_pose(world):
    rows = slice(0, 24)
    q = OTHERS[rows]
    tau = gravity(world.true, q) + np.random.default_rng(5).normal(0, 0.05, q.shape)
    # The time from pose to pose is not that of a motion.
    one = record(world.true, q, 0 * FRICTION, np.random.default_rng(6))
    one = replace(one, tau=tau, dt=5.0, t=None)
    found = correct_gravity(one, world.described)
    assert found.n_samples == 24
    assert (found.error_after[1:] < 0.3 * found.error_before[1:]).all()


def test_poses_from_one_side_leave_friction_unknown(world):
    rising = np.linspace(-2.0, 2.0, 8)[:, None] * [1.0, 0.9, 0.8]
    rng = np.random.default_rng(4)
    recording = record(world.true, visit(rising, False), FRICTION, rng)
    found = correct_gravity(recording, world.described)
    assert not found.friction_known.any()
    assert (found.error_after**2).sum() < (found.error_before**2).sum()


@pytest.mark.parametrize("factors", [[10.0, 10.0, 10.0], [1.0, 1.3, 1.0]])
def test_factors_of_the_torques_are_warnings(world, factors):
    wrong = replace(world.recording, tau=world.recording.tau * factors)
    with pytest.warns(DoubtWarning, match="times what the described masses require"):
        correct_gravity(wrong, world.described)


def test_single_poses_show_a_sign_and_a_tilted_base(world):
    q, tilted = OTHERS[:24], world.true.copy()
    tilted.gravity.linear = 9.81 * np.array([0.0, -0.5, -np.sqrt(0.75)])
    one_row = {"q": q, "groups": np.zeros(24, dtype=int), "dt": 5.0, "t": None}
    torques = -gravity(world.true, q), gravity(tilted, q)
    for tau, message in zip(torques, ("wrong sign", "30 degrees from the descr")):
        poses = replace(world.recording, tau=tau, **one_row)
        with pytest.raises(ValueError, match=message):
            correct_gravity(poses, world.described)


@pytest.mark.parametrize("masses", [[1.0, 1.0, 1.0], [1.0, 1.0, 1.4]])
def test_torques_without_weight_are_refused(world, tmp_path, masses):
    # A controller takes off the described weight.
    urdf = tmp_path / "described.urdf"
    described = replace(ARM, masses=ARM.masses * masses).write(urdf)
    weight = gravity(described, world.recording.q)
    none = replace(world.recording, tau=world.recording.tau - weight)
    with pytest.raises(ValueError, match="no weight"):
        correct_gravity(none, urdf)


def test_one_joint_with_a_counterbalance_is_not_refused(world):
    tau = world.recording.tau.copy()
    tau[:, 1] -= 1.3 * gravity(world.true, world.recording.q)[:, 1]
    with pytest.warns(DoubtWarning, match="joint2 contain no weight"):
        found = correct_gravity(replace(world.recording, tau=tau), world.described)
    assert (found.error_after < 0.5 * found.error_before)[1:].all()
    assert found.identifier.mass_deviations_[0].bodies == ("joint2",)


def test_slow_motion_with_viscous_friction_and_rotors(world, tmp_path):
    t = np.arange(0.0, 60.0, 0.01)[:, None]
    q = 1.5 * np.sin([0.5, 0.37, 0.61] * t + [0.0, 1.0, 2.0])
    recording = record(world.true, q, FRICTION, np.random.default_rng(7))
    v = np.gradient(q, 0.01, axis=0)
    a = np.gradient(v, 0.01, axis=0)
    tau = recording.tau + [2.0, 5.0, 3.0] * v + [2.0, 1.0, 0.5] * a
    recording = replace(recording, tau=tau)
    found = correct_gravity(recording, world.described)
    # The rotor of a joint with a vertical axis is no mass of its link.
    named = [x for one in found.identifier.mass_deviations_ for x in one.bodies]
    assert "joint1" not in named
    assert_corrected(errors(exported(found, tmp_path), world), world)


def test_poses_after_a_fit_narrow_its_intervals(world, found):
    # Half of the poses leave wider intervals, which the chosen ones narrow.
    rng = np.random.default_rng(8)
    few = record(world.true, visit(POSES[:3]), FRICTION, rng)
    few = correct_gravity(few, world.described)
    q, hold = gravity_poses(world.described, 5, fitted=few.identifier)
    both = visit(np.concatenate([POSES[:3], q[hold > 0][::2]]))
    more = record(world.true, both, FRICTION, np.random.default_rng(9))
    more = correct_gravity(more, world.described)
    assert (more.interval <= few.interval).all()
    assert more.interval.max() < 0.7 * few.interval.max()


FAST = np.sin(6.0 * np.arange(0, 10, 0.01)[:, None] + np.arange(3))


@pytest.mark.parametrize(
    ("q", "message"),
    [
        (visit(np.repeat(POSES[:1], 3, axis=0)), "poses are the same"),
        (FAST, "fewer than 5 poses or windows of slow motion"),
    ],
    ids=["one pose", "fast motion"],
)
def test_motions_without_several_poses_are_refused(world, q, message):
    recording = record(world.true, q, FRICTION, np.random.default_rng(5))
    with pytest.raises(ValueError, match=message):
        correct_gravity(recording, world.described)


def test_designed_poses_are_reached_from_both_sides(world):
    q, hold = gravity_poses(world.described, 6)
    assert q.shape == (24, 3)
    assert np.array_equal(q[1::4], q[3::4])
    assert (q[0::4] < q[1::4]).all()
    assert (q[2::4] > q[1::4]).all()
    assert (np.abs(q) <= 2.5).all()
    assert np.array_equal(hold > 0, np.tile([False, True], 12))


def test_links_do_not_touch_on_the_way_to_designed_poses(tmp_path):
    path = arm(tmp_path)
    q, _ = gravity_poses(path, 40)
    clearance, _ = Clearance.of(path, load_model(path))
    assert clearance.nearest(q)[0] > 0


def test_a_description_without_masses_is_refused(world, tmp_path):
    path = tmp_path / "empty.urdf"
    text = world.described.read_text()
    path.write_text(text.replace("<inertial>", "<!--").replace("</inertial>", "-->"))
    with pytest.raises(ValueError, match="mass"):
        correct_gravity(world.recording, path)
