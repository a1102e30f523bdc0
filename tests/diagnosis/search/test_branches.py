"""Separate searches of the branches of a robot, and their combination."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.diagnosis.search._branches import branches_of, root_joints
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.effects import Coupling, resolve
from sklearn_vbjfa.robot import FitOptions
from tests.effects._faults import Cubic
from tests.model._robots import arms


@pytest.fixture(scope="module")
def two_arms():
    model = arms(2)
    recording = make_robot_recording(
        model,
        duration=24.0,
        dt=0.01,
        frequency=1.0,
        friction=("viscous",),
        torque_noise=0.02,
        undeclared={"spring": (5, 4.0)},
        random_state=1,
    )
    # The arms are identical; do not share parameters between them.
    robot = RobotIdentifier(
        model, dt=recording.dt, friction=("viscous",), options=FitOptions(alike=None)
    )
    return recording, robot.fit(recording.q, recording.tau)


def test_payload_at_the_end_of_a_branch(two_arms):
    """The other joints show it, although its joint has no usable samples."""
    recording, robot = two_arms
    added = robot.features_.body(recording.states, 6)[:, :, :4] @ [0.8, 0.0, 0.02, 0.08]
    tau = recording.tau + added * (recording.t >= 12.0)[:, None]
    weight = np.ones(tau.shape) * (np.arange(8) != 6)
    loop = EffectDiscovery(robot, effects=["payload"], random_state=0)
    (effect,) = loop.fit(recording.q, tau, sample_weight=weight).effects_
    assert effect.joint == 6
    assert effect.parameters["dm"] == pytest.approx(0.8, rel=0.05)
    assert effect.parameters["instant"] == pytest.approx(12.0, abs=0.1)


def test_first_joint_of_each_branch(two_arms):
    model = two_arms[1].features_.model_
    chains = [{i - 1 for i in s if i > 0} for s in list(model.supports)[1:]]
    assert root_joints(model).tolist() == [min(chain) for chain in chains]


def test_small_robots_and_custom_effects_are_searched_as_a_whole(two_arms):
    recording, robot = two_arms
    library = resolve(["coulomb", "coupling"])
    assert [b.joints for b in branches_of(robot, library, None)] == [
        [0, 2, 4, 6],
        [1, 3, 5, 7],
    ]
    everything = [list(range(8))]
    assert [b.joints for b in branches_of(robot, library, 3)] == everything
    custom = resolve([Cubic()])
    assert [b.joints for b in branches_of(robot, custom, None)] == everything
    rows = slice(0, 1000)
    small = RobotIdentifier(
        arms(3, ("RY", "RX")), dt=recording.dt, friction=("viscous",)
    ).fit(recording.q[rows, :6], recording.tau[rows, :6])
    assert [b.joints for b in branches_of(small, library, None)] == [list(range(6))]


def test_a_branch_matches_its_part_of_the_robot(two_arms):
    recording, robot = two_arms
    model = robot.features_.model_
    state = np.random.default_rng(0).normal(size=(3, model.nv))
    whole = pin.rnea(model, model.createData(), *state)
    weighted = replace(recording, weight=np.ones(recording.q.shape))
    for branch in branches_of(robot, resolve("all"), None):
        rows = [row[branch.joints].copy() for row in state]
        torque = pin.rnea(branch.model, branch.model.createData(), *rows)
        np.testing.assert_allclose(torque, whole[branch.joints], atol=1e-9)
        part = branch.recording(weighted)
        np.testing.assert_array_equal(part.q, recording.q[:, branch.joints])
        np.testing.assert_array_equal(part.tau, recording.tau[:, branch.joints])
        names = [recording.joint_names[j] for j in branch.joints]
        assert list(part.joint_names) == names
        view = RecordingView(robot, weighted)
        alone = branch.view(robot.robot_, weighted)
        np.testing.assert_array_equal(alone.index, view.index)
        np.testing.assert_allclose(alone.target, view.target[branch.joints])
        np.testing.assert_array_equal(alone.precision, view.precision[branch.joints])
        # Parameters of other branches must have no influence.
        part_torque = alone.equations.Phi @ alone.robot.theta_unconstrained_
        torques = view.equations.Phi @ robot.theta_unconstrained_
        np.testing.assert_allclose(part_torque, torques[:, branch.joints], atol=1e-9)


def test_effects_of_a_branch_map_to_joints_of_the_robot(two_arms):
    _, second = branches_of(two_arms[1], resolve("all"), None)
    moved = second.on_robot(Coupling(joint=1, other=3, ratio=1.0))
    assert (moved.joint, moved.other, moved.ratio) == (3, 7, 1.0)


@pytest.mark.slow
def test_effects_of_a_branch_are_found(two_arms):
    recording, robot = two_arms
    loop = EffectDiscovery(robot, effects=["spring", "joint_zero"])
    loop.fit(recording.q, recording.tau)
    assert [(e.name, e.joint) for e in loop.effects_] == [("spring", 5)]
    assert loop.effects_[0].joint_name == recording.joint_names[5]
    assert loop.error_after_[5] < 0.8 * loop.error_before_[5]
    others = np.arange(8) != 5
    after, before = loop.error_after_[others], loop.error_before_[others]
    np.testing.assert_allclose(after, before, rtol=0.05)
    assert "spring" in str(loop.report_)
    # Joint numbers of hidden effects are those of the robot. Zeros of the last
    # joints are equivalent to a rotation of the last body.
    hidden = [(h.name, h.joint) for h in loop.not_identifiable_]
    zeros = [joint for name, joint in hidden if name == "joint_zero"]
    assert zeros == [6, 7]
    for x in loop.not_identifiable_:
        assert x.joint_name == recording.joint_names[x.joint]


@pytest.mark.slow
def test_signals_are_passed_to_all_branches(two_arms):
    recording, robot = two_arms
    tool = np.floor(recording.t / 3.0) % 2
    tau = recording.tau.copy()
    tau[:, 3] += 6.0 * tool * np.gradient(recording.q[:, 3], recording.dt)
    library = ["spring", "offset", "coulomb", "signal"]
    loop = EffectDiscovery(robot, effects=library)
    loop.fit(recording.q, tau, signals={"tool": tool, "other": np.sin(recording.t)})
    assert ("signal", 3) in {(e.name, e.joint) for e in loop.effects_}
    (effect,) = (e for e in loop.effects_ if e.name == "signal")
    assert (effect.parameters["signal"], effect.parameters["of"]) == ("tool", "viscous")
    assert effect.parameters["k"] == pytest.approx(6.0, rel=0.02)
