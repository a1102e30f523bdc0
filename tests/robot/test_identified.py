"""Identified robots without data and estimator."""

import copy
import pickle
import warnings

import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier, load_identified
from sklearn_vbjfa.effects import (
    BaseTilt,
    Drift,
    Jerk,
    JointZero,
    LoadFriction,
    MaxwellSlip,
    Spring,
    TorqueGain,
)
from tests.model.test_mjcf import rigid
from tests.robot.test_identifier import identify


def mean_sign(rest, v, a):
    """Mean sign of noiseless velocities at rest, by the formula of `Rest`."""
    width = rest.speed / (1 + np.abs(a) * rest.time / rest.speed)
    return np.clip(v / width, -1, 1)


@pytest.fixture(scope="module")
def loaded(simulated):
    """Robot with plain friction and effects of several kinds, fitted to positions."""
    effects = [
        LoadFriction(joint=1),
        Spring(joint=2),
        Drift(joint=0, of="offset", time_constant=5.0),
        TorqueGain(joint=3, gain=1.1),
        JointZero(joint=2),
    ]
    friction = ("viscous", "coulomb", "offset", "rotor_inertia")
    return identify(simulated, friction=friction, effects=effects)


def test_a_torque_model_holds_what_predict_knows(loaded, simulated, new_motion):
    known = loaded.robot_.torque_model()
    states = new_motion.states
    _, v, a = np.split(states, 3, axis=1)
    t = 3.0 + new_motion.dt * np.arange(len(states))
    friction = dict(zip(known.friction_names, known.friction.T))
    sign = mean_sign(known.rest, v, a)
    torque = rigid(known.model, known.bodies, states)
    torque += friction["viscous"] * v + friction["coulomb"] * sign
    torque += friction["offset"] + friction["rotor_inertia"] * a
    load = rigid(known.model, known.load.bodies, states)
    mu, spring, drift, gain, zero = known.coefficients
    torque[:, 1] += mu * np.abs(load[:, 1]) * sign[:, 1]
    torque[:, 2] += spring[0] * states[:, 2] + spring[1]
    torque[:, 0] += drift * np.exp(-t / 5.0)
    expected = known.gains * torque
    found = loaded.predict(states, t=t)
    assert np.abs(found - expected).max() < 1e-12 * expected.std(axis=0).max()
    np.testing.assert_array_equal(known.gains[3], gain[0])
    np.testing.assert_array_equal(known.gains[[0, 1, 2, 4, 5]], 1.0)
    # The zero acts through the model.
    nominal = loaded.features_.nominal_
    assert known.model.jointPlacements[3] != nominal.jointPlacements[3]
    assert np.isfinite(zero).all()
    assert known.since == 0.0
    assert known.joint_names == loaded.joint_names_
    assert known.dt == simulated.dt


def test_a_tilted_base_is_in_the_model(simulated):
    model = simulated.robot_model().copy()
    model.gravity.linear = np.array([0.0, 0.5, -9.8])
    robot = RobotIdentifier(
        model, dt=simulated.dt, effects=[BaseTilt()], friction=("viscous",)
    )
    robot.fit(simulated.q, simulated.tau, groups=simulated.groups)
    gravity = robot.robot_.torque_model().model.gravity.linear
    assert np.abs(gravity - model.gravity.linear).max() > 1e-3
    np.testing.assert_allclose(
        np.linalg.norm(gravity), np.linalg.norm(model.gravity.linear), rtol=1e-12
    )


@pytest.fixture(scope="module")
def read(simulated, tmp_path_factory):
    """Robot with a memory, and with an effect that needs the future, from a file."""
    effects = [LoadFriction(joint=1), MaxwellSlip(joint=2), Jerk(joint=0)]
    robot = identify(simulated, effects=effects)
    path = tmp_path_factory.mktemp("read") / "robot.json"
    robot.save(path)
    return load_identified(path)


def one_by_one(robot, X):
    return np.array([robot.step(*np.split(x, 3)) for x in X])


def test_states_one_by_one_have_the_torques_of_all(read, new_motion):
    X = new_motion.states[:300]
    (left,) = read.left_out_
    assert (left.name, left.joint) == ("jerk", 0)
    assert "other states" in left.reason
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        expected = read.predict(X)
    # Of the jerk on joint 0, so that the others agree.
    read.reset()
    found = one_by_one(read, X)
    spread = expected.std(axis=0).max()
    np.testing.assert_allclose(found[:, 1:], expected[:, 1:], atol=1e-12 * spread)
    j = read.parameter_names_.index("joint_1:jerk:J")
    jerk = read.theta_[j] * np.gradient(X[:, 12], read.dt)
    np.testing.assert_allclose(
        found[:, 0], expected[:, 0] - jerk, rtol=0, atol=1e-12 * spread
    )
    # It remembers, until it is reset; copies begin anew.
    again = one_by_one(read, X)
    assert np.abs(again[:, 2] - found[:, 2]).max() > 1e-6 * spread
    for other in (copy.deepcopy(read), pickle.loads(pickle.dumps(read))):
        np.testing.assert_array_equal(one_by_one(other, X), found)
    read.reset()
    np.testing.assert_array_equal(one_by_one(read, X), found)
