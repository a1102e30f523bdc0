from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.robot import estimate, project
from tests.diagnosis._recordings import record
from tests.diagnosis.report._pages import text_of

ARM = record("ZYY", seed=3)
TWO = record("ZY")
CLOSED = {"effects": ["coulomb"]}


@pytest.fixture(scope="module", name="gain")
def fixture_gain():
    """Torque channel of the second joint with a gain of 1 / 1.3.

    One above 1 is no contradiction: the rotor inertia is larger then.
    """
    torque = ARM.torque()
    torque[:, 1] /= 1.3
    return torque, ARM.discover(torque, **CLOSED)


@pytest.fixture(scope="module", name="driven")
def fixture_driven():
    """First joint whose friction drives it, as its torque has the wrong sign."""
    torque = TWO.torque(joint_1=lambda r: -1.3 * r.v[:, 0])
    return TWO.discover(torque, **CLOSED)


def test_errors_are_those_of_models_with_and_without_constraints(gain):
    torque, loop = gain
    cost = loop.report_.outcome.projection
    assert cost.held == pytest.approx(loop.error_after_)
    # A model that was never projected, fitted anew to the same rows.
    free = ARM.discover(torque, robot=ARM.robot(projector=None), **CLOSED)
    assert free.report_.outcome.projection is None
    assert np.isnan(free.consistency_cost_).all()
    assert [e.name for e in free.effects_] == [e.name for e in loop.effects_]
    assert cost.free == pytest.approx(free.error_after_, rel=1e-6)


def test_the_channel_with_the_wrong_gain_is_named(gain):
    _, loop = gain
    cost = loop.report_.outcome.projection
    assert cost.costs.tolist() == [False, True, False]
    assert cost.cost[1] == cost.held[1] - cost.free[1]
    assert (cost.interval[0] > 0).tolist() == [False, True, False]
    assert cost.channel == 1
    assert cost.channel_share > 0.99
    assert "Without the torque of joint 2 " in text_of(loop.report_)


def test_the_channel_s_share_is_what_a_fit_without_it_saves(gain):
    _, loop = gain
    robot = loop.judged_

    def distance(weights):
        moments = robot.estimator_.statistics_
        free = estimate(moments, joint_weights=weights)
        held = project(free, "default", robot.features_)
        moved = held.theta - free.theta
        return moved @ held.metric @ moved

    weights = robot.estimator_.joint_weights_
    without = weights * np.array([1.0, 0.0, 1.0])
    left = distance(without) / distance(weights)
    cost = loop.report_.outcome.projection
    assert cost.channel_share == pytest.approx(1 - left, abs=1e-6)


def test_friction_that_drives_is_named_with_its_value(driven):
    cost = driven.report_.outcome.projection
    (pushed,) = cost.pushed
    assert (pushed.joint, pushed.kind, pushed.name) == (0, "friction", "joint_1")
    assert (pushed.parameter, pushed.unit) == ("viscous", "N m s/rad")
    assert pushed.free == pytest.approx(0.8 - 1.3, abs=0.01)
    assert pushed.held == pytest.approx(0.0, abs=1e-9)
    std = driven.judged_.theta_std_[10]
    assert pushed.deviations == pytest.approx((pushed.held - pushed.free) / std)
    # What is left is what noise pushes of the five other terms that must not be
    # negative: of chi-squared with as many degrees of freedom, 95 % is below this.
    assert (1.0 - pushed.share) * pushed.deviations**2 < 11.1
    text = text_of(driven.report_)
    moved = f"viscous {pushed.free:.3g} to 0 N m s"
    assert f"the friction of joint 1 is held at zero ({moved}" in text


def test_the_dict_has_the_price_and_what_it_comes_from(driven):
    data = driven.report_.to_dict()["projection"]
    assert data["cost"] == driven.consistency_cost_.tolist()
    assert data["pushed"][0]["kind"] == "friction"
    assert data["channel"] == 0


def test_a_price_within_chance_is_not_mentioned(driven):
    outcome = driven.report_.outcome
    nothing = replace(outcome.projection, cost=np.zeros(2))
    report = Report(replace(outcome, projection=nothing))
    assert "physically possible" not in text_of(report)
    assert "physically possible" in text_of(driven.report_)
