"""Effects of the geometry that one recording can or cannot tell from each other."""

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


def searched(truth, recording, library=GEOMETRY):
    recording = with_faults(truth, recording)
    robot = recording.robot(projector=None, input_noise=None)
    return search(recording.torque(), library, recording, robot)


def rivals(run):
    """Names and joints of what would take the place of the only effect."""
    (finding,) = run.findings
    return [(r.name, r.joint) for r in finding.rivals]


@pytest.fixture(scope="module")
def level():
    """Search a recording without faults."""
    return searched([], VERTICAL).run()


@pytest.mark.parametrize("truth", [BaseTilt(0, 0.07, -0.04), JointAxis(0, 0.06, 0.05)])
def test_a_search_names_the_tilt_and_its_rival(truth):
    """Of a vertical first joint they are one: the recording cannot say which."""
    now = searched([truth], VERTICAL).run()
    assert found(now) == [("base_tilt", 0)]
    assert rivals(now) == [("joint_axis", 0)]


@pytest.mark.parametrize("truth", [JointZero(0, 0.06), BaseTilt(0, 0.0, -0.06)])
def test_the_zero_of_a_horizontal_joint_is_not_told_from_a_tilt(truth):
    """By a tilt about the joint alone; both are named, in this order or the other."""
    now = searched([truth], record("YXY", seed=5)).run()
    told = {*found(now), *rivals(now)}
    # The axis of the next joint may be as well, where there is one like it.
    assert {("base_tilt", 0), ("joint_zero", 0)} <= told


def test_a_tilt_about_other_axes_has_no_zero_for_a_rival():
    now = searched([BaseTilt(0, 0.07, -0.04)], HORIZONTAL).run()
    assert found(now) == [("base_tilt", 0)]
    assert rivals(now) == []


def test_zeros_of_parallel_joints_are_rivals_or_told_apart():
    truth = JointZero(1, 0.06)
    now = searched([truth], PARALLEL).run()
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
def test_a_search_names_what_is_there(truth):
    now = searched(truth, VERTICAL).run()
    assert sorted(found(now)) == sorted((e.name, e.joint) for e in truth)
    members = {m.effect.key(): i for i, m in enumerate(now.fit.members)}
    for effect in truth:
        i = members[effect.key()]
        own, step = now.fit.members[i].effect, now.fit.coefficients(i)
        np.testing.assert_allclose(own.values + step, effect.values, atol=0.02)


@pytest.mark.parametrize("effect", [JointZero(0), JointZero(2)])
def test_what_the_bodies_do_as_well_is_never_offered(level, effect):
    """The zero of a vertical joint, and of the last one, whose body may be turned."""
    problem = level.fit.problem
    groups = level.fit.groups(problem.columns(problem.shapes(effect, first=True)))
    evidence = groups.evidence(level.settings.scale)
    assert not evidence.max() > np.log(level.n_candidates) + level.needed


def test_an_idle_value_is_chance():
    """None is named in recordings with nothing missing, whatever their noise."""
    for seed in range(3):
        assert searched([], record("ZYX", seed=seed)).run().findings == ()
