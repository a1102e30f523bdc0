"""The identified robot as a Pinocchio model, and its gravity."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording


@pytest.fixture(scope="module")
def robot():
    recording = make_robot_recording(duration=6.0, dt=0.01, random_state=0)
    robot = RobotIdentifier(recording.urdf, dt=recording.dt)
    return robot.fit(recording.q, recording.tau).robot_


def test_pinocchio_has_the_torques_of_the_robot(robot):
    model = robot.to_pinocchio()
    states = np.random.default_rng(0).uniform(-1.0, 1.0, size=(5, 18))
    offsets = robot.bodies(robot.theta_)[
        :, 10 + robot.features_.friction_.index("offset")
    ]
    for q, v, a in zip(*np.split(states, 3, axis=1)):
        # Fast enough to move.
        v = v + np.sign(v)
        torque = robot.predict(np.r_[q, v, a][None])[0]
        rigid = pin.rnea(model, model.createData(), q, v, a)
        friction = model.damping * v + model.upperDryFrictionLimit * np.sign(v)
        assert_allclose(rigid + friction + offsets, torque, rtol=1e-9, atol=1e-9)


def test_gravity_is_that_of_pinocchio(robot):
    model = robot.to_pinocchio()
    q = np.random.default_rng(1).uniform(-1.0, 1.0, size=(4, 6))
    found = robot.gravity(q)
    for row, torque in zip(q, found):
        exact = pin.computeGeneralizedGravity(model, model.createData(), row)
        assert_allclose(torque, exact, rtol=1e-9, atol=1e-9)
    assert_allclose(robot.gravity(q[0]), found[0])
    with pytest.raises(ValueError, match="positions of 6 joints"):
        robot.gravity(q[:, :5])
