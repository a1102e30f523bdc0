"""Unnamed joint torque: its terms, fits with it, and when the search adds it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier, load_identified
from sklearn_vbjfa.effects import UnnamedTorque
from tests.effects.test_hard_recordings import LOAD, MODEL, NOISE, Q, V, X


def recorded(torque):
    """Return the measured torques of an arm with an additional torque."""
    return LOAD + 0.5 * V + torque + NOISE


def step(q):
    """Return a detent torque, which is not in the library."""
    return 2.0 * np.tanh(8 * np.sin(2.2 * q))


@pytest.mark.parametrize("of", UnnamedTorque.kinds)
def test_columns_are_the_weighted_terms_of_library_effects(of):
    effect = UnnamedTorque(of=of, reach=2.0, fast=3.0)
    states, load = X[:200], {"load": 2.0 * X[:200, :1]}
    terms = np.hstack([p.fit(states).transform(states, **load) for p in effect.parts])
    effect.weights = tuple(np.arange(1.0, terms.shape[1] + 1))
    column = effect.fit(states).transform(states, **load)
    assert_allclose(column[:, 0], terms @ effect.weights)


@pytest.fixture(scope="module")
def robot():
    parts = (
        UnnamedTorque(of="position", weights=(0.5, 0.1, *6 * [0.2]), reach=1.5),
        UnnamedTorque(of="memory", weights=(0.3, 0.2, 0.1, 0.4), reach=1.5),
    )
    torque = sum(part.fit_transform(X) for part in parts)
    robot = RobotIdentifier(MODEL, dt=0.02, friction=("viscous",), effects=parts)
    return robot.fit(Q, recorded(torque))


def test_shares_are_estimated_and_saved(robot, tmp_path):
    values = dict(zip(robot.parameter_names_, robot.theta_))
    estimates = [value for name, value in values.items() if "unnamed" in name]
    assert_allclose(estimates, 1.0, atol=0.1)
    robot.save(tmp_path / "robot.json")
    loaded = load_identified(tmp_path / "robot.json")
    assert_allclose(loaded.predict(Q), robot.predict(Q))
    expected = loaded.predict(X)
    loaded.reset()
    one_by_one = [loaded.step(*np.split(row, 3)) for row in X[:100]]
    assert_allclose(one_by_one, expected[:100], atol=1e-9)


def test_search_adds_it_only_for_residual_structure():
    for torque, expected in ((0.0 * Q, False), (step(Q), True)):
        robot = RobotIdentifier(MODEL, dt=0.02, friction=("viscous",))
        loop = EffectDiscovery(robot, random_state=0, max_effects=0)
        loop.fit(Q, recorded(torque))
        assert loop.effects_ == ()
        assert bool(loop.report_.outcome.findings["unnamed"]) == expected
        assert ("Residual torque model" in loop.report_.to_html()) == expected
        if expected:
            assert loop.error_after_[0] < 0.8 * loop.error_plain_[0]
            identifier = loop.identifier_
            assert len(identifier.parameter_names_) == len(identifier.theta_)
