"""A lag of all torques against the positions, a parameter of the fit."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import CubicSpline

from sklearn_vbjfa import RobotIdentifier, load_identified
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.inspection import inspect_recording


@pytest.fixture(scope="module")
def recording():
    return make_robot_recording(duration=8.0, dt=0.005, random_state=1)


def late(recording, lag):
    """Return a recording whose torques come a lag after the motion."""
    t = recording.dt * np.arange(recording.n_samples)
    tau = CubicSpline(t, recording.tau)(np.clip(t - lag, 0.0, t[-1]))
    return replace(recording, tau=tau)


def fitted(recording):
    robot = RobotIdentifier(recording.urdf, dt=recording.dt)
    return robot.fit(recording.q, recording.tau)


@pytest.fixture(scope="module")
def sound(recording):
    return fitted(recording)


def test_torques_without_a_lag_have_no_such_parameter(sound):
    assert sound.torque_lag_ == 0.0
    assert not any(name.startswith("torques") for name in sound.parameter_names_)


def test_a_lag_is_found_with_its_deviation(recording, sound, tmp_path):
    lag = -0.01
    log = late(recording, lag)
    assert [one.kind for one in inspect_recording(log)] == ["delay"]
    robot = fitted(log)
    assert 0 < robot.theta_std_[-1] < 3e-4
    assert abs(robot.torque_lag_ - lag) < 3 * robot.theta_std_[-1]
    assert robot.parameter_names_[-1] == "torques:lag"
    assert robot.theta_[-1] == robot.torque_lag_
    # Everything else is that of torques in time.
    away = robot.theta_[:-1] - sound.theta_
    assert (np.abs(away) < 2 * np.maximum(sound.theta_std_, 1e-3)).all()
    rms = robot.residuals(log.q, log.tau).rms()
    assert_allclose(rms, sound.residuals(recording.q, recording.tau).rms(), rtol=0.03)
    robot.save(tmp_path / "arm.json")
    again = load_identified(tmp_path / "arm.json")
    assert_allclose(again.residuals(log.q, log.tau).rms(), rms, rtol=1e-9)
    assert_allclose(again.predict(log.q), robot.predict(log.q), rtol=1e-9)
