from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from tests.diagnosis._recordings import record
from tests.diagnosis.report._pages import section_of

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


def test_only_the_channel_with_the_wrong_gain_costs(gain):
    _, loop = gain
    cost = loop.report_.outcome.projection
    assert cost.costs.tolist() == [False, True, False]
    assert cost.cost[1] == cost.held[1] - cost.free[1]
    assert (cost.interval[0] > 0).tolist() == [False, True, False]


def test_the_dict_has_the_cost(driven):
    data = driven.report_.to_dict()["projection"]
    assert data["cost"] == driven.consistency_cost_.tolist()


def test_a_cost_within_chance_is_not_mentioned(driven):
    outcome = driven.report_.outcome
    nothing = replace(outcome.projection, cost=np.zeros(2))
    heading = "Cost of physical consistency"
    assert section_of(driven.report_, heading)
    assert not section_of(Report(replace(outcome, projection=nothing)), heading)
