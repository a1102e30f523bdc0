"""Effects of the geometry that one recording cannot tell from each other."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from sklearn_vbjfa.diagnosis.search._classes import (
    inseparable,
    one_of_class,
    stands_for,
)
from sklearn_vbjfa.diagnosis.search._model import SearchModel
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
    now = search(recording.torque(), library, recording, robot)
    now.accept(())
    return now


@pytest.fixture(scope="module")
def leaning():
    return searched([BaseTilt(0, 0.07, -0.04)], VERTICAL)


@pytest.fixture(scope="module")
def lying():
    return searched([BaseTilt(0, 0.07, -0.04)], HORIZONTAL)


def test_a_tilt_and_the_axis_of_a_vertical_first_joint_are_one(leaning):
    model = leaning.model
    assert stands_for(model, BaseTilt(), JointAxis(0))
    assert stands_for(model, JointAxis(0), BaseTilt())
    for other in (JointZero(1), JointAxis(1), JointAxis(2)):
        assert not stands_for(model, BaseTilt(), other)
        assert not stands_for(model, other, BaseTilt())


def test_the_zero_of_a_horizontal_first_joint_is_part_of_a_tilt(lying):
    model = lying.model
    assert stands_for(model, BaseTilt(), JointZero(0))
    # The tilt is more than that.
    assert not stands_for(model, JointZero(0), BaseTilt())
    assert not stands_for(model, BaseTilt(), JointZero(1))


def candidates(now, *effects):
    tried = [now.score(effect, now.model)[0] for effect in effects]
    assert all(c is not None for c in tried)
    return tried


def test_of_equals_the_one_with_precedence_is_named(leaning):
    tilt, axis, zero = candidates(leaning, BaseTilt(), JointAxis(0), JointZero(1))
    for order in ([tilt, axis, zero], [zero, axis, tilt], [axis, tilt]):
        simplest, rivals = one_of_class(leaning.model, order)
        assert simplest is tilt
        assert rivals == (axis,)


def test_what_explains_less_is_no_rival(leaning):
    axis, zero = candidates(leaning, JointAxis(0), JointZero(1))
    simplest, rivals = one_of_class(leaning.model, [zero, axis])
    assert simplest is axis
    assert rivals == ()


@pytest.mark.parametrize("seed", [5, 8])
@pytest.mark.parametrize("truth", [JointZero(0, 0.06), BaseTilt(0, 0.0, -0.06)])
def test_the_zero_of_a_horizontal_joint_is_not_told_from_a_tilt(truth, seed):
    """By a tilt about the joint alone; both are named, in this order or the other."""
    now = searched([truth], record("YXY", seed=seed))
    simplest, rivals = one_of_class(
        now.model, candidates(now, BaseTilt(), JointZero(0))
    )
    assert sorted([simplest.effect.name, *(c.effect.name for c in rivals)]) == [
        "base_tilt",
        "joint_zero",
    ]


def test_a_tilt_about_other_axes_has_no_zero_for_a_rival(lying):
    tilt, zero = candidates(lying, BaseTilt(), JointZero(0))
    simplest, rivals = one_of_class(lying.model, [tilt, zero])
    assert simplest is tilt
    assert rivals == ()


def test_pairs_that_a_model_cannot_tell_apart(leaning):
    effects = [JointAxis(0), JointZero(1), BaseTilt(), JointAxis(2)]
    assert list(inseparable(leaning.model, effects)) == [(effects[0], effects[2])]
    assert list(inseparable(leaning.model, effects[1:])) == []
    assert list(inseparable(leaning.model, effects[:1])) == []


# -- the search


@pytest.mark.parametrize("truth", [BaseTilt(0, 0.07, -0.04), JointAxis(0, 0.06, 0.05)])
def test_a_search_names_the_tilt_and_its_rival(truth):
    """Whichever of the two it was: the recording cannot say."""
    now = searched([truth], VERTICAL).run()
    assert found(now) == [("base_tilt", 0)]
    (step,) = [s for s in now.steps if s.action == "add"]
    assert ("joint_axis", 0) in [(c.effect.name, c.effect.joint) for c in step.rivals]


@pytest.mark.parametrize("truth", [JointZero(1, 0.06), JointZero(2, 0.06)])
def test_zeros_of_parallel_joints_are_rivals_or_told_apart(truth):
    now = searched([truth], PARALLEL).run()
    ((name, joint),) = found(now)
    assert name == "joint_zero"
    (step,) = [s for s in now.steps if s.action == "add"]
    near = [(c.effect.name, c.effect.joint) for c in step.rivals]
    assert joint == truth.joint or ("joint_zero", truth.joint) in near


@pytest.mark.parametrize(
    "truth",
    [
        [JointZero(1, 0.07)],
        [JointAxis(2, 0.06, -0.05)],
        [TorqueGain(1, 1.15)],
        [BaseTilt(0, 0.07, -0.04), JointZero(1, 0.06)],
        [],
    ],
    ids=["zero", "axis", "gain", "tilt and zero", "nothing"],
)
def test_a_search_names_what_is_there(truth):
    now = searched(truth, VERTICAL).run()
    expected = sorted((e.name, e.joint) for e in truth)
    assert sorted(found(now)) == expected
    for effect in truth:
        (own,) = [e for e in now.model.effects if e.key() == effect.key()]
        np.testing.assert_allclose(own.values, effect.values, atol=0.02)


def test_a_model_and_its_view_agree_after_every_step():
    now = searched([BaseTilt(0, 0.07, -0.04), JointZero(1, 0.06)], VERTICAL)
    now.run()
    assert now.model.view is now.view.corrected(now.model.effects)
    again = SearchModel.of(now.view, now.model.effects, now.model)
    np.testing.assert_allclose(
        again.squares.sum(axis=0), now.model.squares.sum(axis=0), rtol=0.01
    )
