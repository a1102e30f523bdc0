"""Views of a recording with a corrected robot model."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa.diagnosis.search._problem import Problem
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


def search_faulty(faults, library=LIBRARY, declared=(), **torques):
    """Return the search problem of a robot with faults."""
    recording = with_faults(faults)
    robot = recording.robot(projector=None, input_noise=None, effects=declared)
    return search(recording.torque(**torques), library, recording, robot)


@pytest.fixture(scope="module")
def view():
    return search_faulty([TILT]).view


def test_corrected_views_are_cached(view):
    corrected = view.corrected([TILT, ZERO])
    assert corrected is not view
    assert view.corrected([ZERO, TILT]) is corrected
    assert corrected.corrected([TILT, ZERO]) is corrected
    assert corrected.corrected([ZERO, Coulomb(0), TILT]) is corrected
    assert view.corrected([TILT, JointZero(1, 0.06)]) is not corrected
    assert view.corrected([TILT, JointZero(2, 0.05)]) is not corrected


def test_corrections_keep_rows_blocks_and_weights(view):
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
def test_corrected_equations_match_an_identifier(view, effects):
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


def test_gains_scale_the_columns_of_effects(view):
    other = view.corrected([GAIN])
    motion, equations = view.motion(None), [Problem(x) for x in (view, other)]
    for effect in (Coulomb(1), Coulomb(0), Offset(1)):
        factor = 1.2 if effect.joint == 1 else 1.0
        plain = view.columns([effect], motion)
        assert_allclose(other.columns([effect], motion), factor * plain)
        # The cache must distinguish the two views.
        for made, gain in zip(equations, (1.0, factor)):
            values = made.changed(motion=motion).columns([effect]).values
            cosines = gain * made.cosines(plain, [effect.joint])
            assert_allclose(values, cosines, atol=1e-12)
        assert_allclose(
            other.in_equations(effect, motion),
            factor * view.in_equations(effect, motion),
        )


def test_declared_corrections_are_applied_before_the_search():
    problem = search_faulty([TILT, ZERO], declared=[BaseTilt()])
    assert problem.view.robot.effects_[0].corrects
    assert_allclose(problem.view.robot.effects_[0].values, TILT.values, atol=0.02)
    view = problem.view.corrected([ZERO])
    features = view.robot.features_
    expected = problem.view.robot.features_.corrected(
        [*problem.view.robot.effects_, ZERO]
    ).model_
    for one, other in zip(features.model_.jointPlacements, expected.jointPlacements):
        assert_allclose(one.homogeneous, other.homogeneous)
    assert_allclose(features.model_.gravity.linear, expected.gravity.linear)


def view_and_fit(problem, effects):
    """Return the view of a search problem and its fit with given effects."""
    return problem.view, problem.path().fit_effects(effects)


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
def test_corrections_are_iterated_until_convergence(truth):
    (start,) = truth
    view, fit = view_and_fit(search_faulty(truth), [type(start)(joint=start.joint)])
    (member,) = fit.members
    # The remaining correction is small.
    step = fit.coefficients(0)
    assert np.all(np.abs(step) < 0.01 * np.abs(start.values).max() + 1e-3)
    assert_allclose(member.effect.values + step, start.values, atol=0.02)
    # The fit uses the corrected robot.
    assert fit.problem.view is not view
    assert fit.problem.view.corrected(()) is view


def test_a_gain_applies_to_later_effects():
    problem = search_faulty([GAIN], joint_2=lambda r: 1.2 * np.sign(r.v[:, 1]))
    _, fit = view_and_fit(problem, [TorqueGain(1), Coulomb(1)])
    gain, _ = fit.members
    assert gain.effect.gain == pytest.approx(1.2, abs=0.03)
    # Friction of the joint, before the gain of the channel.
    assert fit.coefficients(1)[0] == pytest.approx(1.0, abs=0.05)
