"""What effects were fitted on, and predictions that leave it."""

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


def robot(*used, **given):
    return RobotIdentifier(
        MODEL, dt=DT, effects=used, **{"friction": ("viscous",), **given}
    )


def said(fitted, *args, **kwargs):
    """Warnings of a prediction."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fitted.predict(*args, **kwargs)
    return [str(one.message) for one in caught]


def ends(values):
    return values.min(), values.max()


# -- what is recorded


def test_ranges_are_those_of_the_rows_that_were_fitted():
    weight = np.ones(TORQUE.shape)
    weight[500:, 1] = 0.0
    fitted = robot(SPRING, **EXACT).fit(STATES, TORQUE, sample_weight=weight)
    *friction, spring = fitted.effect_ranges_
    assert [(r.name, r.joint) for r in friction] == [("viscous", j) for j in range(3)]
    assert (spring.name, spring.joint) == ("spring", 1)
    assert spring.depends == ("position",)
    for one in fitted.effect_ranges_:
        rows = slice(0, 500 if one.joint == 1 else None)
        assert_allclose(one.position, ends(Q[rows, one.joint]), rtol=1e-12)
        assert_allclose(one.speed, ends(np.abs(V[rows, one.joint])), rtol=1e-12)
        assert_allclose(one.load, ends(LOAD[rows, one.joint]), rtol=1e-6)


# -- what is said of a prediction


@pytest.fixture(scope="module")
def fitted():
    return robot(SPRING, friction=("viscous", "coulomb")).fit(Q, TORQUE)


def test_the_motion_of_the_fit_is_inside(fitted):
    assert said(fitted, Q) == []
    assert said(fitted, STATES) == []


def test_one_warning_names_joint_and_range(fitted):
    (message,) = said(fitted, 2.0 * Q)
    low, high = fitted.effect_ranges_[-1].position
    assert "joint_2: positions to " in message
    assert f"fitted on {low:.3g} to {high:.3g} rad (spring; " in message
    assert "% of the rows" in message
    for j in range(3):
        assert f"joint_{j + 1}: speeds to" in message
    assert "coulomb" not in message


# -- torques outside


def held_spring(q):
    low, high = ends(Q[:, 1])
    margin = 0.2 * (high - low) + 1e-9 * max(abs(low), abs(high))
    return 3.0 * np.clip(q, low - margin, high + margin)


def ripple(q):
    return 0.7 * np.sin(2 * np.pi / 0.3 * q)


@pytest.mark.filterwarnings("ignore:Prediction outside:UserWarning")
@pytest.mark.parametrize(
    ("effect", "own", "atol"), [(SPRING, held_spring, 1e-8), (RIPPLE, ripple, 1e-7)]
)
def test_springs_are_held_and_ripples_and_friction_are_not(effect, own, atol, tmp_path):
    def law(states):
        torque = inverse_dynamics(MODEL, states) + VISCOUS * states[:, 3:6]
        torque[:, 1] += own(states[:, 1])
        return torque

    far = 2.0 * STATES
    exact = robot(effect, **EXACT).fit(STATES, law(STATES))
    assert_allclose(exact.predict(STATES), law(STATES), atol=atol)
    assert_allclose(exact.predict(far), law(far), atol=atol)
    # Equal to rounding in the file as well.
    exact.save(tmp_path / "robot.json")
    read = load_identified(tmp_path / "robot.json")
    assert_array_equal(read.predict(far), exact.predict(far))
    one = [read.step(*row.reshape(3, -1)) for row in far[::50]]
    assert_allclose(one, law(far)[::50], atol=atol)


def test_a_fit_holds_nothing():
    # Equations of a fit are those of a robot with an effect without `depends`.
    class Everywhere(effects.Spring):
        depends = ()

    rows = slice(0, 1200)
    one, other = (
        robot(effect).fit(Q[rows], TORQUE[rows])
        for effect in (SPRING, Everywhere(joint=1))
    )
    assert_array_equal(one.theta_, other.theta_)


def test_rest_is_no_speed():
    # One speed only: at rest nothing is asked of viscous friction.
    t = np.arange(0, 4.0, DT)
    ramp = np.column_stack([0.5 * t, np.full_like(t, 0.5), 0 * t])
    own = RobotIdentifier(
        arm("Z"),
        dt=DT,
        options=FitOptions(standstill=0.01),
        projector=None,
        friction=("viscous",),
    )
    own.fit(ramp, ramp[:, 1:2] + 0.1 * ramp[:, :1])
    (viscous,) = own.effect_ranges_
    assert_allclose(viscous.speed, (0.5, 0.5))
    assert said(own, ramp) == []
    assert said(own, ramp * [1.0, 0.0, 0.0]) == []
    (message,) = said(own, ramp * [1.0, 0.4, 1.0])
    assert "speeds to 0.2 rad/s, fitted on 0.5 to 0.5 rad/s" in message
