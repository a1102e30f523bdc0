"""How surely a value in the robot model is not idle."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

pytest.importorskip("pinocchio")

from sklearn_vbjfa.diagnosis.search._regression import LEAST_RIDGE
from sklearn_vbjfa.diagnosis.search._shapes import linearised
from sklearn_vbjfa.diagnosis.search._values import (
    blocks_of_time,
    p_of_value,
    shows,
    value_and_spread,
)
from sklearn_vbjfa.effects import BaseTilt, JointAxis, JointZero, TorqueGain
from sklearn_vbjfa.effects._in_model import without_rounding
from tests.diagnosis._faulty import with_faults
from tests.diagnosis._recordings import record
from tests.diagnosis.search._searches import search

ARM = record("ZYX", seed=2)
TILT = BaseTilt(0, 0.07, -0.04)


def model_of(truth=(), seed=0, slow=0.0, effects=()):
    """Fit the declared model to a recording with noise, `slow` of it a random walk."""
    recording = with_faults(truth, ARM)
    rng = np.random.default_rng(seed)
    torque = recording.torque()
    noise = rng.normal(size=torque.shape)
    walk = np.cumsum(noise, axis=0)
    noise = (1 - slow) * noise + slow * walk / walk.std(axis=0)
    robot = recording.robot(projector=None, input_noise=None)
    now = search(torque + 0.05 * noise, ("base_tilt",), recording, robot)
    now.accept(())
    if effects:
        # The load of the declared model first.
        now.accept(effects)
    return now.model.beside(now.model.effects, LEAST_RIDGE)


@pytest.fixture(scope="module")
def leaning():
    return model_of([TILT])


def stacked(model, effect):
    """Rows of all joints, weighted: declared columns, an effect's, and the torques."""
    joints, own = model.view.joints_of(effect), model.columns_of(effect)
    columns = np.zeros((model.view.nv, *own.shape[1:]))
    columns[joints] = own
    root = np.sqrt(model.precision)[:, None, None]
    Z = np.concatenate([model.fitted.Z, columns], axis=2) * root
    y = model.fitted.y * root[:, :, 0]
    return Z.reshape(-1, Z.shape[2]), y.ravel()


@pytest.mark.parametrize(
    "effect", [BaseTilt(), JointZero(1), JointAxis(1), TorqueGain(1)]
)
def test_the_estimate_is_that_of_a_fit_of_everything(leaning, effect):
    Z, y = stacked(leaning, effect)
    scale = np.sqrt((Z**2).sum(axis=0))
    coef = np.linalg.lstsq(Z / scale, y, rcond=None)[0] / scale
    k = len(effect.coefficients)
    estimate, _, _ = value_and_spread(leaning, effect)
    assert_allclose(estimate, effect.values + coef[-k:], rtol=1e-5, atol=1e-8)


def test_white_residuals_have_the_deviation_of_least_squares():
    """The scatter between blocks is that of white rows.

    But for how few they are, and for the low-pass, of which four rows are kept where
    two are independent.
    """
    effect = BaseTilt()
    ratios = []
    for seed in range(6):
        model = model_of((), seed)
        Z, y = stacked(model, effect)
        coef = np.linalg.lstsq(Z, y, rcond=None)[0]
        variance = ((y - Z @ coef) ** 2).sum() / (y.size - Z.shape[1])
        plain = variance * np.linalg.inv(Z.T @ Z)[-2:, -2:]
        covariance = value_and_spread(model, effect)[1]
        ratios.append(np.sqrt(np.diagonal(covariance) / np.diagonal(plain)))
    assert 0.8 < np.mean(ratios) / np.sqrt(2) < 1.25


def test_slow_residuals_widen_the_deviation():
    effect = BaseTilt()
    white, slow = (
        np.mean(
            [
                np.sqrt(np.diagonal(value_and_spread(m, effect)[1])).mean()
                for m in (model_of((), s, share) for s in range(4))
            ]
        )
        for share in (0.0, 0.7)
    )
    assert slow > 1.5 * white


def test_p_is_that_of_students_t_for_one_value(leaning):
    effect = JointZero(1)
    estimate, covariance, freedom = value_and_spread(leaning, effect)
    t = (estimate[0] - 0.0) / np.sqrt(covariance[0, 0])
    expected = 2 * stats.t.sf(abs(t), freedom)
    assert_allclose(p_of_value(leaning, effect), expected, rtol=1e-8)


def test_a_true_value_is_sure_and_an_idle_one_is_chance():
    assert p_of_value(model_of([TILT]), BaseTilt()) < 1e-8
    idle = [p_of_value(model_of((), seed), BaseTilt()) for seed in range(20)]
    # Uniform: the chance of more than five in twenty below 0.1 is 1 %.
    assert sum(p < 0.1 for p in idle) <= 5
    assert max(idle) > 0.3


def test_an_accepted_value_is_judged_with_the_robot_corrected():
    model = linearised(model_of([TILT], effects=[BaseTilt()]), 0)
    (own,) = model.effects
    estimate, covariance, _ = value_and_spread(model, own)
    assert_allclose(estimate, own.values, atol=0.2 * np.sqrt(covariance.max()))
    deviation = np.sqrt(np.diagonal(covariance))
    assert np.all(np.abs(estimate - TILT.values) < 4 * deviation)
    assert p_of_value(model, own) < 1e-8


@pytest.mark.parametrize("effect", [JointZero(0), JointZero(2)])
def test_what_is_hidden_does_not_show(effect):
    model = model_of(())
    assert not shows(model, effect, 0.05)
    assert p_of_value(model, effect) > 0.01


def test_what_is_large_beside_its_deviation_shows():
    model = model_of(())
    for effect in (BaseTilt(), JointZero(1), TorqueGain(1)):
        assert shows(model, effect, 1e-3)


def test_blocks_cover_all_rows_once(leaning):
    view = leaning.view
    rows = [np.arange(view.index.size)[block] for block, _ in blocks_of_time(view)]
    np.testing.assert_array_equal(np.concatenate(rows), np.arange(view.index.size))
    places = [tuple(np.ravel(place)) for _, place in blocks_of_time(view)]
    assert len(set(places)) == len(places)


def test_what_no_test_would_find_does_not_show():
    """At a level so low that the largest plausible value is not far enough."""
    model = model_of(())
    effect = JointZero(1)
    _, covariance, freedom = value_and_spread(model, effect)
    _, high = effect.bounds()
    t = high[0] / np.sqrt(covariance[0, 0]) - 0.84
    level = 2 * stats.t.sf(t, freedom)
    assert shows(model, effect, 2 * level)
    assert not shows(model, effect, 0.5 * level)


class OneTurn(JointAxis):
    """A turned axis of which one turn does nothing, as about the axis before it."""

    def columns(self, motion):
        return super().columns(motion) * [1.0, 0.0]


def test_of_two_values_one_may_be_hidden():
    model = model_of([JointAxis(1, about_x=0.05)])
    estimate, covariance, _ = value_and_spread(model, OneTurn(1))
    assert estimate[1] == 0.0
    assert covariance[1, 1] == 0.0
    assert p_of_value(model, OneTurn(1)) < 1e-8
    assert abs(estimate[0] - 0.05) < 0.01
    assert shows(model, OneTurn(1), 1e-3)


def test_the_rounding_of_zero_is_no_column():
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(20, 3, 2)) * [1.0, 1e-15]
    found = without_rounding(columns)
    np.testing.assert_array_equal(found[..., 0], columns[..., 0])
    assert not found[..., 1].any()
    np.testing.assert_array_equal(without_rounding(0 * columns), 0 * columns)
