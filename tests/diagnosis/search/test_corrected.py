"""A search looks at a recording with the robot as its effects correct it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa.diagnosis.search import Cosines
from sklearn_vbjfa.effects import (
    BaseTilt,
    Coulomb,
    JointAxis,
    JointZero,
    Offset,
    TorqueGain,
)
from tests.diagnosis._faulty import PLAIN, with_faults
from tests.diagnosis.search._searches import search

TILT, ZERO, GAIN = BaseTilt(0, 0.07, -0.04), JointZero(1, 0.05), TorqueGain(1, 1.2)
LIBRARY = ("base_tilt", "joint_zero", "joint_axis", "torque_gain", "coulomb")


def searched(truth, library=LIBRARY, declared=(), **added):
    """Make a search in the recording of a robot with faults."""
    recording = with_faults(truth)
    robot = recording.robot(projector=None, input_noise=None, effects=declared)
    return search(recording.torque(**added), library, recording, robot)


@pytest.fixture(scope="module")
def view():
    return searched([TILT]).view


# -- the view


def test_the_same_corrections_are_the_same_view(view):
    one = view.corrected([TILT, ZERO])
    assert one is not view
    assert view.corrected([ZERO, TILT]) is one
    assert one.corrected([TILT, ZERO]) is one
    assert one.corrected([ZERO, Coulomb(0), TILT]) is one
    assert view.corrected([TILT, JointZero(1, 0.06)]) is not one
    assert view.corrected([TILT, JointZero(2, 0.05)]) is not one


def test_rows_blocks_and_weights_stay(view):
    other = view.corrected([TILT, ZERO, GAIN])
    assert_array_equal(other.index, view.index)
    assert other.blocks is view.blocks
    assert other.states is view.states
    assert_array_equal(other.root, view.root)
    assert_array_equal(other.target, view.target)
    assert_array_equal(other.precision, view.precision)
    assert_array_equal(other.equations.weight, view.equations.weight)
    assert not np.allclose(other.equations.Phi, view.equations.Phi)


@pytest.mark.parametrize("effects", [[TILT], [ZERO, GAIN], [TILT, JointAxis(2, 0.1)]])
def test_equations_are_those_of_an_identifier_with_the_corrected_model(view, effects):
    """Which has no effects, and knows of the gains by its torques alone."""
    other = view.corrected(effects)
    robot = PLAIN.robot(projector=None, input_noise=None)
    model = view.robot.features_.corrected(effects).model_
    robot.set_params(model=model)
    recording = with_faults([TILT])
    torque = recording.torque()
    robot.fit(recording.position, torque)
    assert robot.cutoff_ == view.robot.cutoff_
    fitted, weight = robot.robot_, np.ones_like(torque)
    whole = fitted.recording(recording.position, torque, weight=weight)
    expected = fitted.equations(whole)
    gains = np.ones(3)
    for effect in effects:
        if isinstance(effect, TorqueGain):
            gains[effect.joint] = effect.gain
    assert_allclose(other.equations.Phi, gains[:, None] * expected.Phi, atol=1e-9)
    assert_allclose(other.equations.tau, expected.tau)
    assert_array_equal(other.gains, gains)


def test_columns_pass_the_channel_as_the_torque_does(view):
    other = view.corrected([GAIN])
    motion, cosines = view.motion(None), Cosines(view)
    for effect in (Coulomb(1), Coulomb(0), Offset(1)):
        factor = 1.2 if effect.joint == 1 else 1.0
        plain = view.columns([effect], motion)
        assert_allclose(other.columns([effect], motion), factor * plain)
        assert_allclose(
            other.column_cosines([effect], motion, cosines)[0],
            factor * cosines(plain, [effect.joint]),
            atol=1e-12,
        )
        assert_allclose(
            other.in_equations(effect, motion),
            factor * view.in_equations(effect, motion),
        )
    # What was made for the one is not taken for the other.
    assert_allclose(
        view.column_cosines([Coulomb(1)], motion, cosines)[0],
        cosines(view.columns([Coulomb(1)], motion), [1]),
        atol=1e-12,
    )


def test_what_the_robot_declares_is_corrected_from_the_start():
    """The identifier found the tilt: the search has nothing to add to it."""
    now = searched([TILT, ZERO], declared=[BaseTilt()])
    assert now.view.robot.effects_[0].corrects
    assert_allclose(now.view.robot.effects_[0].values, TILT.values, atol=0.02)
    view = now.view.corrected([ZERO])
    features = view.robot.features_
    expected = now.view.robot.features_.corrected(
        [*now.view.robot.effects_, ZERO]
    ).model_
    for one, other in zip(features.model_.jointPlacements, expected.jointPlacements):
        assert_allclose(one.homogeneous, other.homogeneous)
    assert_allclose(features.model_.gravity.linear, expected.gravity.linear)


# -- models with corrections


def placed(now, effects):
    """Return the view of a search, and its model with given effects."""
    return now.view, now.path().fit_effects(effects)


@pytest.mark.parametrize(
    "truth",
    [
        [BaseTilt(0, 0.2, -0.15)],
        [JointZero(1, 0.2)],
        [JointAxis(2, 0.15, 0.1)],
        [TorqueGain(1, 1.5)],
        [TorqueGain(2, 0.6)],
    ],
    ids=lambda truth: truth[0].name,
)
def test_values_are_linearised_until_they_stay(truth):
    (start,) = truth
    view, fit = placed(searched(truth), [type(start)(joint=start.joint)])
    (member,) = fit.members
    # What is left to correct is small beside what was corrected.
    step = fit.coefficients(0)
    assert np.all(np.abs(step) < 0.01 * np.abs(start.values).max() + 1e-3)
    assert_allclose(member.effect.values + step, start.values, atol=0.02)
    # The model is of the corrected robot.
    assert fit.problem.view is not view
    assert fit.problem.view.corrected(()) is view


def test_a_gain_changes_the_robot_for_what_comes_later():
    now = searched([GAIN], joint_2=lambda r: 1.2 * np.sign(r.v[:, 1]))
    _, fit = placed(now, [TorqueGain(1), Coulomb(1)])
    gain, _ = fit.members
    assert gain.effect.gain == pytest.approx(1.2, abs=0.03)
    # Friction is what the joint has, not what its channel reads.
    assert fit.coefficients(1)[0] == pytest.approx(1.0, abs=0.05)
