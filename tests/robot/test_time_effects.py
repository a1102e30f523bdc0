"""Effects of time in predictions outside the time of the fit, against closed forms."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import RobotIdentifier, effects
from tests.effects._arms import arm, inverse_dynamics, motion, with_changed_body
from tests.robot import EXACT

MODEL = arm("ZYX")
DT = 0.02
T, STATES = motion(3, duration=30.0, dt=DT, seed=4)
Q, V, A = np.split(STATES, 3, axis=1)
VISCOUS = np.array([0.8, 0.5, 0.3])
TORQUE = inverse_dynamics(MODEL, STATES) + VISCOUS * V
D, CONSTANT = 2.0, 12.0
START = 5.0  # of the clock [s]
SIGNALS = {"offset": np.ones_like(T), "coulomb": np.sign(V[:, 1]), "viscous": V[:, 1]}


def fit(of="offset", start=START, **given):
    drift = effects.Drift(joint=1, of=of, time_constant=CONSTANT)
    torque = TORQUE.copy()
    torque[:, 1] += D * np.exp(-(T + start) / CONSTANT) * SIGNALS[of]
    settings = {**EXACT, "regressor": LinearRegression(), **given}
    robot = RobotIdentifier(MODEL, dt=DT, effects=[drift], **settings)
    return robot.fit(STATES, torque, t=T + start)


def drifted(robot, **given):
    """Torque of the drift in a prediction of the same motion."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return (robot.predict(STATES, **given) - TORQUE)[:, 1]


@pytest.mark.parametrize("of", SIGNALS)
def test_a_drift_goes_on_after_the_fit(of):
    later = T + START + 40.0
    expected = D * np.exp(-later / CONSTANT) * SIGNALS[of]
    found = drifted(fit(of), t=later)
    moves = np.abs(V[:, 1]) > 0.05  # at rest the sign is a mean
    assert_allclose(found[moves], expected[moves], atol=1e-6)
    # It tends towards what remains when warm.
    assert_allclose(drifted(fit(of), t=T + 1e3), 0.0, atol=1e-6)


@pytest.mark.parametrize("before", [10.0, 1e3, 1e6])
def test_before_the_fit_it_is_as_it_was_at_first(before):
    found = drifted(fit(), t=T + START - before)
    first = D * np.exp(-START / CONSTANT)
    known = np.maximum(T + START - before, START)
    assert_allclose(found, D * np.exp(-known / CONSTANT), atol=1e-6)
    assert np.abs(found).max() <= first * (1 + 1e-6)


@pytest.fixture(scope="module")
def loaded():
    """Make the last body heavier from the middle on."""
    body = np.array([0.6, 0.0, 0.05, 0.1, 0.03, 0.0, 0.02, 0.0, 0.0, 0.02])
    torque, after = TORQUE.copy(), T >= 15.0
    more = inverse_dynamics(with_changed_body(MODEL, body), STATES) + VISCOUS * V
    torque[after] = more[after]
    payload = effects.Payload(joint=2, instant=15.0)
    robot = RobotIdentifier(MODEL, dt=DT, effects=[payload], **EXACT)
    return robot.set_params(regressor=LinearRegression()).fit(STATES, torque, t=T), more


def test_a_payload_stays_after_the_fit_and_is_not_there_before(loaded):
    robot, more = loaded
    late = robot.predict(STATES, t=T + 100.0)
    scale = np.abs(more - TORQUE).max()
    assert_allclose(late, more, atol=0.05 * scale)
    # Nothing is added before.
    early = robot.predict(STATES, t=T - 100.0)
    assert_allclose(early, TORQUE, atol=0.05 * scale)
