"""Lag of all torques relative to the positions, as a parameter of the fit."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import CubicSpline

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier, load_identified
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.inspection import inspect_recording


@pytest.fixture(scope="module")
def recording():
    return make_robot_recording(duration=8.0, dt=0.005, random_state=1)


def delayed(recording, lag):
    """Return a recording with torques that lag the motion."""
    t = recording.dt * np.arange(recording.n_samples)
    tau = CubicSpline(t, recording.tau)(np.clip(t - lag, 0.0, t[-1]))
    return replace(recording, tau=tau)


def fitted(recording):
    robot = RobotIdentifier(recording.urdf, dt=recording.dt)
    return robot.fit(recording.q, recording.tau)


@pytest.fixture(scope="module")
def base(recording):
    return fitted(recording)


def test_lag_and_standard_error_are_estimated(recording, base, tmp_path):
    assert base.torque_lag_ == 0.0
    assert not any(name.startswith("torques") for name in base.parameter_names_)
    lag = -0.01
    log = delayed(recording, lag)
    assert [x.kind for x in inspect_recording(log)] == ["delay"]
    robot = fitted(log)
    assert 0 < robot.theta_std_[-1] < 3e-4
    assert abs(robot.torque_lag_ - lag) < 3 * robot.theta_std_[-1]
    assert robot.parameter_names_[-1] == "torques:lag"
    assert robot.theta_[-1] == robot.torque_lag_
    # The other parameters equal those of the fit without a lag.
    change = robot.theta_[:-1] - base.theta_
    assert (np.abs(change) < 2 * np.maximum(base.theta_std_, 1e-3)).all()
    rms = robot.residuals(log.q, log.tau).rms()
    assert_allclose(rms, base.residuals(recording.q, recording.tau).rms(), rtol=0.03)
    robot.save(tmp_path / "arm.json")
    loaded = load_identified(tmp_path / "arm.json")
    assert_allclose(loaded.residuals(log.q, log.tau).rms(), rms, rtol=1e-9)
    assert_allclose(loaded.predict(log.q), robot.predict(log.q), rtol=1e-9)


def test_predictions_and_simulations_are_those_of_late_channels(recording, base):
    log = delayed(recording, 0.02)
    robot = fitted(log)
    scores = [base.score(recording.q, recording.tau), robot.score(log.q, log.tau)]
    q, v, _ = np.split(base.state_estimator_.transform(recording.q)[400], 3)
    tau = log.tau[400:480], recording.tau[400:480]
    # The last torques are not yet recorded.
    late, clean = (x.simulate(y, q, v)[:76, :6] for x, y in zip((robot, base), tau))
    assert_allclose(late, clean, atol=0.02)
    (left_out,) = robot.left_out_
    assert (left_out.name, left_out.joint_name) == ("torque_lag", "all joints")
    loop = EffectDiscovery(RobotIdentifier(log.urdf, dt=log.dt), effects=())
    loop.fit(log.q, log.tau)
    found = loop.identifier_
    assert found.torque_lag_ == loop.torque_lag_ == pytest.approx(0.02, abs=5e-4)
    assert_allclose([*scores, found.score(log.q, log.tau)], scores[0], atol=1e-4)
    assert loop.declared_.residuals(log.q, log.tau).normalised_error().max() < 0.02
