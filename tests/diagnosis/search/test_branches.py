"""Robots of many joints, searched branch by branch: the same robot, put together."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.diagnosis.search import RecordingView
from sklearn_vbjfa.diagnosis.search._branches import branches_of, root_joints
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
    # The arms are alike; what one lacks is looked for without the other.
    robot = RobotIdentifier(
        model, dt=recording.dt, friction=("viscous",), options=FitOptions(alike=None)
    )
    return recording, robot.fit(recording.q, recording.tau)


def test_the_first_joint_of_each_branch(two_arms):
    model = two_arms[1].features_.model_
    chains = [{i - 1 for i in s if i > 0} for s in list(model.supports)[1:]]
    assert root_joints(model).tolist() == [min(chain) for chain in chains]


def test_the_whole_is_searched_where_it_is_small_or_not_known(two_arms):
    recording, robot = two_arms
    library = resolve(["coulomb", "coupling"])
    assert [b.joints for b in branches_of(robot, library, None)] == [
        [0, 2, 4, 6],
        [1, 3, 5, 7],
    ]
    everything = [list(range(8))]
    assert [b.joints for b in branches_of(robot, library, 3)] == everything
    own = resolve([Cubic()])
    assert [b.joints for b in branches_of(robot, own, None)] == everything
    rows = slice(0, 1000)
    small = RobotIdentifier(
        arms(3, ("RY", "RX")), dt=recording.dt, friction=("viscous",)
    ).fit(recording.q[rows, :6], recording.tau[rows, :6])
    assert [b.joints for b in branches_of(small, library, None)] == [list(range(6))]


def test_a_branch_is_the_robot_without_the_others(two_arms):
    recording, robot = two_arms
    model = robot.features_.model_
    state = np.random.default_rng(0).normal(size=(3, model.nv))
    whole = pin.rnea(model, model.createData(), *state)
    weighted = replace(recording, weight=np.ones(recording.q.shape))
    for branch in branches_of(robot, resolve("all"), None):
        own = [row[branch.joints].copy() for row in state]
        torque = pin.rnea(branch.model, branch.model.createData(), *own)
        np.testing.assert_allclose(torque, whole[branch.joints], atol=1e-9)
        part = branch.recording(weighted)
        np.testing.assert_array_equal(part.q, recording.q[:, branch.joints])
        np.testing.assert_array_equal(part.tau, recording.tau[:, branch.joints])
        names = [recording.joint_names[j] for j in branch.joints]
        assert list(part.joint_names) == names
        view = RecordingView(robot, weighted)
        alone = branch.view(robot.robot_, weighted, ())
        np.testing.assert_array_equal(alone.index, view.index)
        np.testing.assert_allclose(alone.target, view.target[branch.joints])
        np.testing.assert_array_equal(alone.precision, view.precision[branch.joints])
        # the parameters of the others do not matter
        left = alone.equations.Phi @ alone.robot.theta_unconstrained_
        both = view.equations.Phi @ robot.theta_unconstrained_
        np.testing.assert_allclose(left, both[:, branch.joints], atol=1e-9)


def test_effects_are_numbered_by_the_robot(two_arms):
    _, second = branches_of(two_arms[1], resolve("all"), None)
    moved = second.on_robot(Coupling(joint=1, other=3, ratio=1.0))
    assert (moved.joint, moved.other, moved.ratio) == (3, 7, 1.0)
    assert second.local([1, 2, 7]) == [0, 3]


@pytest.mark.slow
def test_what_a_branch_lacks_is_found_on_the_robot(two_arms):
    recording, robot = two_arms
    loop = EffectDiscovery(
        robot,
        effects=["spring", "joint_zero"],
    ).fit(recording.q, recording.tau)
    assert [(e.name, e.joint) for e in loop.effects_] == [("spring", 5)]
    assert loop.effects_[0].joint_name == recording.joint_names[5]
    assert loop.error_after_[5] < 0.8 * loop.error_before_[5]
    others = np.arange(8) != 5
    np.testing.assert_allclose(
        loop.error_after_[others], loop.error_before_[others], rtol=0.05
    )
    assert "spring" in str(loop.report_)
    # What is hidden is told by the robot's joints as well: the last body of either arm
    # may be turned instead of its zero.
    told = [(h.name, h.joint) for h in loop.not_identifiable_]
    zeros = [joint for name, joint in told if name == "joint_zero"]
    assert zeros == [6, 7]
    for one in loop.not_identifiable_:
        assert one.joint_name == recording.joint_names[one.joint]


@pytest.mark.slow
def test_signals_are_those_of_all_branches(two_arms):
    recording, robot = two_arms
    tool = np.floor(recording.t / 3.0) % 2
    tau = recording.tau.copy()
    tau[:, 3] += 6.0 * tool * np.gradient(recording.q[:, 3], recording.dt)
    library = ["spring", "offset", "coulomb", "signal"]
    loop = EffectDiscovery(robot, effects=library)
    loop.fit(recording.q, tau, signals={"tool": tool, "other": np.sin(recording.t)})
    assert ("signal", 3) in {(e.name, e.joint) for e in loop.effects_}
    (found,) = (e for e in loop.effects_ if e.name == "signal")
    assert (found.parameters["signal"], found.parameters["of"]) == ("tool", "viscous")
    assert found.parameters["k"] == pytest.approx(6.0, rel=0.02)
