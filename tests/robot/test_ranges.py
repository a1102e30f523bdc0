"""Fitted ranges of effects, and predictions outside of them."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import RobotIdentifier, effects, load_identified
from sklearn_vbjfa.robot import FitOptions
from tests.effects._arms import arm, inverse_dynamics
from tests.robot import EXACT as STATES_ALONE
from tests.robot.test_identifier_effects import (
    DECLARED,
    DT,
    LOAD,
    MODEL,
    STATES,
    VISCOUS,
    Q,
    V,
    on_joint,
)

TORQUE = DECLARED + on_joint(1, 3.0 * Q[:, 1])
EXACT = {**STATES_ALONE, "regressor": LinearRegression()}
SPRING = effects.Spring(joint=1)
RIPPLE = effects.Ripple(joint=1, period=0.3)


def robot(*used, **settings):
    return RobotIdentifier(
        MODEL, dt=DT, effects=used, **{"friction": ("viscous",), **settings}
    )


def prediction_warnings(fitted, *args, **kwargs):
    """Return the warnings of a prediction."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fitted.predict(*args, **kwargs)
    return [str(warning.message) for warning in caught]


def ends(values):
    return values.min(), values.max()


def test_ranges_cover_the_fitted_rows():
    weight = np.ones(TORQUE.shape)
    weight[500:, 1] = 0.0
    fitted = robot(SPRING, **EXACT).fit(STATES, TORQUE, sample_weight=weight)
    *friction, spring = fitted.effect_ranges_
    assert [(r.name, r.joint) for r in friction] == [("viscous", j) for j in range(3)]
    assert (spring.name, spring.joint) == ("spring", 1)
    assert spring.depends == ("position",)
    for r in fitted.effect_ranges_:
        rows = slice(0, 500 if r.joint == 1 else None)
        assert_allclose(r.position, ends(Q[rows, r.joint]), rtol=1e-12)
        assert_allclose(r.speed, ends(np.abs(V[rows, r.joint])), rtol=1e-12)
        assert_allclose(r.load, ends(LOAD[rows, r.joint]), rtol=1e-6)


@pytest.fixture(scope="module")
def fitted():
    return robot(SPRING, friction=("viscous", "coulomb")).fit(Q, TORQUE)


def test_fitted_motion_gives_no_warning(fitted):
    assert prediction_warnings(fitted, Q) == []
    assert prediction_warnings(fitted, STATES) == []


def test_one_warning_names_joint_and_range(fitted):
    (message,) = prediction_warnings(fitted, 2.0 * Q)
    low, high = fitted.effect_ranges_[-1].position
    assert "joint_2: positions to " in message
    assert f"fitted on {low:.3g} to {high:.3g} rad (spring; " in message
    assert "% of the rows" in message
    for j in range(3):
        assert f"joint_{j + 1}: speeds to" in message
    assert "coulomb" not in message


def clamped_spring(q):
    low, high = ends(Q[:, 1])
    margin = 0.2 * (high - low) + 1e-9 * max(abs(low), abs(high))
    return 3.0 * np.clip(q, low - margin, high + margin)


def ripple(q):
    return 0.7 * np.sin(2 * np.pi / 0.3 * q)


@pytest.mark.filterwarnings("ignore:Prediction outside:UserWarning")
@pytest.mark.parametrize(
    ("effect", "law", "atol"), [(SPRING, clamped_spring, 1e-8), (RIPPLE, ripple, 1e-7)]
)
def test_springs_are_clamped_outside_their_range(effect, law, atol, tmp_path):
    def torques(states):
        torque = inverse_dynamics(MODEL, states) + VISCOUS * states[:, 3:6]
        torque[:, 1] += law(states[:, 1])
        return torque

    outside = 2.0 * STATES
    exact = robot(effect, **EXACT).fit(STATES, torques(STATES))
    assert_allclose(exact.predict(STATES), torques(STATES), atol=atol)
    assert_allclose(exact.predict(outside), torques(outside), atol=atol)
    # A saved robot predicts the same.
    exact.save(tmp_path / "robot.json")
    loaded = load_identified(tmp_path / "robot.json")
    assert_array_equal(loaded.predict(outside), exact.predict(outside))
    steps = [loaded.step(*row.reshape(3, -1)) for row in outside[::50]]
    assert_allclose(steps, torques(outside)[::50], atol=atol)


def test_a_fit_holds_nothing():
    # A fit is the same for an effect without `depends`.
    class Everywhere(effects.Spring):
        depends = ()

    rows = slice(0, 1200)
    clamped, unclamped = (
        robot(effect).fit(Q[rows], TORQUE[rows])
        for effect in (SPRING, Everywhere(joint=1))
    )
    assert_array_equal(clamped.theta_, unclamped.theta_)


def test_standstill_is_not_outside_the_speed_range():
    # Standstill is no extrapolation of a fit at a single speed.
    t = np.arange(0, 4.0, DT)
    ramp = np.column_stack([0.5 * t, np.full_like(t, 0.5), 0 * t])
    identifier = RobotIdentifier(
        arm("Z"),
        dt=DT,
        options=FitOptions(standstill=0.01),
        projector=None,
        friction=("viscous",),
    )
    identifier.fit(ramp, ramp[:, 1:2] + 0.1 * ramp[:, :1])
    (viscous,) = identifier.effect_ranges_
    assert_allclose(viscous.speed, (0.5, 0.5))
    assert prediction_warnings(identifier, ramp) == []
    assert prediction_warnings(identifier, ramp * [1.0, 0.0, 0.0]) == []
    (message,) = prediction_warnings(identifier, ramp * [1.0, 0.4, 1.0])
    assert "speeds to 0.2 rad/s, fitted on 0.5 to 0.5 rad/s" in message
