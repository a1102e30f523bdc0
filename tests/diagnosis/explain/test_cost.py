import numpy as np
import pytest

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
    unconstrained = loop.report_.outcome.column("unconstrained")
    # A model that was never projected, fitted anew to the same rows.
    free = ARM.discover(torque, robot=ARM.robot(projector=None), **CLOSED)
    assert np.isnan(free.report_.outcome.column("unconstrained")).all()
    assert np.isnan(free.consistency_cost_).all()
    assert [e.name for e in free.effects_] == [e.name for e in loop.effects_]
    assert unconstrained == pytest.approx(free.error_after_, rel=1e-6)


def test_only_the_channel_with_the_wrong_gain_costs(gain):
    _, loop = gain
    outcome, cost = loop.report_.outcome, loop.consistency_cost_
    assert (cost > 0).tolist() == [False, True, False]
    rise = outcome.column("after") - outcome.column("unconstrained")
    assert cost[1] == rise[1]


def test_a_cost_is_in_the_data_and_on_the_page(driven):
    rows = driven.report_.to_dict()["errors"]
    assert [x["consistency_cost"] for x in rows] == driven.consistency_cost_.tolist()
    assert section_of(driven.report_, "Cost of physical consistency")
