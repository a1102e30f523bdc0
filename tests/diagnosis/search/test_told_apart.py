"""Geometric effects that are or are not distinguishable in one recording."""

import numpy as np
import pytest

from sklearn_vbjfa.effects import BaseTilt, JointAxis, JointZero, TorqueGain
from tests.diagnosis._faulty import with_faults
from tests.diagnosis._recordings import record
from tests.diagnosis.search._searches import found, search

GEOMETRY = ("base_tilt", "joint_zero", "joint_axis", "torque_gain")
# First joint vertical; first joint horizontal; two parallel horizontal joints.
VERTICAL, HORIZONTAL = record("ZYX", seed=2), record("YXY", seed=3)
PARALLEL = record("ZYYX", seed=4)


def search_faulty(faults, recording, library=GEOMETRY):
    recording = with_faults(faults, recording)
    robot = recording.robot(projector=None, input_noise=None)
    return search(recording.torque(), library, recording, robot)


def rivals(run):
    """Return name and joint of each rival of the only effect."""
    (finding,) = run.findings
    return [(r.name, r.joint) for r in finding.rivals]


@pytest.fixture(scope="module")
def level():
    """Search a recording without faults."""
    return search_faulty([], VERTICAL).run()


@pytest.mark.parametrize("truth", [BaseTilt(0, 0.07, -0.04), JointAxis(0, 0.06, 0.05)])
def test_tilt_and_vertical_axis_error_are_rivals(truth):
    now = search_faulty([truth], VERTICAL).run()
    assert found(now) == [("base_tilt", 0)]
    assert rivals(now) == [("joint_axis", 0)]


@pytest.mark.parametrize("truth", [JointZero(0, 0.06), BaseTilt(0, 0.0, -0.06)])
def test_zero_of_a_horizontal_joint_and_tilt_are_rivals(truth):
    """A tilt about the joint axis equals a zero; either may come first."""
    now = search_faulty([truth], record("YXY", seed=5)).run()
    reported = {*found(now), *rivals(now)}
    # The axis of the next joint may be a rival too.
    assert {("base_tilt", 0), ("joint_zero", 0)} <= reported


def test_tilt_about_other_axes_has_no_rival():
    now = search_faulty([BaseTilt(0, 0.07, -0.04)], HORIZONTAL).run()
    assert found(now) == [("base_tilt", 0)]
    assert rivals(now) == []


def test_zeros_of_parallel_joints():
    truth = JointZero(1, 0.06)
    now = search_faulty([truth], PARALLEL).run()
    ((name, joint),) = found(now)
    assert name == "joint_zero"
    assert joint == truth.joint or ("joint_zero", truth.joint) in rivals(now)


@pytest.mark.parametrize(
    "truth",
    [
        [JointZero(1, 0.07)],
        [JointAxis(2, 0.06, -0.05)],
        [TorqueGain(1, 1.15)],
        [BaseTilt(0, 0.07, -0.04), JointZero(1, 0.06)],
    ],
    ids=["zero", "axis", "gain", "tilt and zero"],
)
def test_geometric_effects_are_found_with_their_values(truth):
    now = search_faulty(truth, VERTICAL).run()
    assert sorted(found(now)) == sorted((e.name, e.joint) for e in truth)
    members = {m.effect.key(): i for i, m in enumerate(now.fit.members)}
    for effect in truth:
        i = members[effect.key()]
        applied, step = now.fit.members[i].effect, now.fit.coefficients(i)
        np.testing.assert_allclose(applied.values + step, effect.values, atol=0.02)


@pytest.mark.parametrize("truth", [TorqueGain(0, 0.8), TorqueGain(1, 0.8)])
def test_sizes_of_the_bodies_decide_between_gains_of_two_joints(truth):
    now = search_faulty([truth], record("YY", seed=2)).run()
    assert found(now) == [("torque_gain", truth.joint)]
    assert rivals(now) == [("torque_gain", 1 - truth.joint)]


def test_a_viscous_coupling_has_no_ratio():
    recording = record("ZYX", seed=2, noise=0.02)
    torque = recording.torque(joint_2=lambda r: 2.0 * r.v[:, 2])
    (finding,) = search(torque, ["coupling"], recording).run().findings
    assert (finding.effect.other, finding.effect.ratio) == (2, 0.0)


@pytest.mark.parametrize("effect", [JointZero(0), JointZero(2)])
def test_unidentifiable_zeros_are_never_candidates(level, effect):
    """Zeros of a vertical joint and of the last joint are not identifiable."""
    problem = level.fit.problem
    groups = level.fit.groups(problem.columns(problem.shapes(effect, first=True)))
    evidence = groups.evidence(level.settings.scale)
    assert not evidence.max() > np.log(level.n_candidates) + level.needed


def test_no_geometric_effects_without_faults():
    for seed in range(3):
        assert search_faulty([], record("ZYX", seed=seed)).run().findings == ()
