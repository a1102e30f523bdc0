"""Prediction of a robot that stands still."""

import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import load_demo_recording, make_robot_recording
from sklearn_vbjfa.model import load_model
from tests.effects._arms import inverse_dynamics

EPS = np.finfo(float).eps
FRICTION = ("viscous", "coulomb")
STEP = 5e-4  # of the encoders [rad]


@pytest.fixture(scope="module")
def recording():
    return make_robot_recording(duration=20.0, dt=0.005, random_state=0)


@pytest.fixture(scope="module")
def robot(recording):
    model = load_demo_recording().robot_model()
    robot = RobotIdentifier(model, dt=recording.dt, friction=FRICTION)
    return robot.fit(recording.q, recording.tau)


def standing(recording, n=400):
    """Positions of a robot that stands, read by coarse and noisy encoders."""
    noise = 0.7 * STEP * np.random.default_rng(3).normal(size=(n, recording.nv))
    return STEP * np.round((recording.q[1000] + noise) / STEP)


def coulomb(robot):
    names = [f"{joint}:coulomb" for joint in robot.joint_names_]
    return robot.theta_[[robot.parameter_names_.index(name) for name in names]]


def test_prediction_does_not_rattle_at_rest(robot, recording):
    predicted = robot.predict(standing(recording))
    steps = np.abs(np.diff(predicted, axis=0)).max(axis=0)
    assert np.all(steps < 0.2 * coulomb(robot))
    # friction counts with the middle of its band: the torque is that of gravity
    held = np.zeros((1, 3 * recording.nv))
    held[0, : recording.nv] = recording.q[1000]
    gravity = robot.predict(held)[0]
    missed = np.abs(predicted.mean(axis=0) - gravity)
    assert np.all(missed < 0.1 * coulomb(robot))


def test_given_states_have_all_of_their_friction_however_slow(robot, recording):
    # Velocities that are given are known better than those of the fit.
    held = np.zeros((2, 3 * recording.nv))
    held[:, : recording.nv] = recording.q[1000]
    held[:, recording.nv : 2 * recording.nv] = [[0.01], [-0.01]]
    ahead, back = robot.predict(held)
    viscous = robot.theta_.reshape(recording.nv, -1)[:, 10]
    friction = coulomb(robot) + 0.01 * viscous
    np.testing.assert_allclose((ahead - back) / 2, friction, rtol=0.02)


def test_states_that_move_are_taken_as_they_are(robot, recording):
    v = recording.states[:, recording.nv : 2 * recording.nv]
    moving = recording.states[np.all(np.abs(v) > robot.standstill_, axis=1)]
    Phi = robot.features_.matrices(moving)
    # both sides are sums of as many terms, of forces that all joints share
    size = (np.abs(Phi) @ np.abs(robot.theta_)).max(axis=1, keepdims=True)
    expected = Phi @ robot.theta_
    assert np.all(
        np.abs(robot.predict(moving) - expected) <= Phi.shape[-1] * EPS * size
    )


def test_reversals_keep_their_sign(robot, recording):
    # Passing through zero in a hundredth of a period is not standing: on the whole
    # motion the mean sign costs less than a per cent of the torque.
    Phi = robot.features_.matrices(recording.states)
    sharp = Phi @ robot.theta_
    missed = (robot.predict(recording.states) - sharp).std(axis=0)
    assert np.all(missed < 0.01 * sharp.std(axis=0))


def test_friction_of_a_joint_that_stops_where_it_reverses():
    model = load_model("tests/model/swing.urdf")
    dt = 0.005
    t = np.arange(0.0, 60.0, dt)
    wanted = 1.5 * np.sin(1.7 * t) + 0.8 * np.sin(2.9 * t + 0.7)
    v = np.sign(wanted) * np.maximum(np.abs(wanted) - 0.15, 0.0)
    q, a = np.cumsum(v) * dt, np.gradient(v, dt)
    friction = 0.5 * v + 2.0 * np.clip(wanted / 0.15, -1.0, 1.0)
    rigid = inverse_dynamics(model, np.c_[q, v, a])
    noise = 0.01 * np.random.default_rng(0).normal(size=(t.size, 1))
    robot = RobotIdentifier(model, dt=dt, friction=FRICTION)
    robot.fit(q[:, None], rigid + friction[:, None] + noise)
    assert coulomb(robot) == pytest.approx(2.0, rel=5e-3)
