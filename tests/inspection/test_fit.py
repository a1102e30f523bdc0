"""Warnings of fits of logs that contradict the robot description."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier, StateEstimator
from sklearn_vbjfa.datasets import load_demo_recording
from sklearn_vbjfa.inspection import inspect_recording
from sklearn_vbjfa.model import DoubtWarning
from tests.effects._arms import inverse_dynamics
from tests.inspection.test_many_joints import arms, record_motion


@pytest.fixture(scope="module")
def recording():
    return load_demo_recording().select(0)


def warned(recording, q, tau, **settings):
    """Return the messages of the warnings of a fit."""
    robot = RobotIdentifier(recording.urdf, dt=recording.dt, **settings)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        robot.fit(q, tau)
    return [str(x.message) for x in caught if issubclass(x.category, DoubtWarning)]


def test_fit_warns_of_wrong_torque_sign_and_unit(recording):
    assert warned(recording, recording.q, recording.tau) == []
    tau = recording.tau.copy()
    tau[:, 1] *= -1
    (message,) = warned(recording, recording.q, tau)
    assert "joint_2 has the wrong sign" in message
    (message,) = warned(recording, recording.q, -recording.tau)
    assert "The torque of all joints has the wrong sign" in message
    (message,) = warned(recording, recording.q, 10.2 * recording.tau)
    assert "All torques together" in message
    # The torque scale is not checked if gains or all masses are identified.
    for settings in ({"gains": "unknown"}, {"bodies": "free"}):
        assert warned(recording, recording.q, 10.2 * recording.tau, **settings) == []


@pytest.mark.parametrize(
    ("factor", "amplitude", "pattern"),
    [
        (180 / np.pi, 1.0, 'look like degrees.* columns="q=q{i} .deg."'),
        (180 / np.pi, 0.2, "look like degrees"),
        (100.0, 1.0, r"joint_2 (99|100|101)\S* ± .*gear ratios"),
    ],
)
def test_units_of_positions_come_before_the_size_of_torques(factor, amplitude, pattern):
    model, dt = arms(1), 0.01
    q = record_motion(model).q
    q = q.mean(axis=0) + amplitude * (q - q.mean(axis=0))
    v = np.gradient(q, dt, axis=0)
    tau = inverse_dynamics(model, np.hstack([q, v, np.gradient(v, dt, axis=0)]))
    noise = 0.05 * np.random.default_rng(0).normal(size=q.shape)
    robot = RobotIdentifier(model, dt=dt)
    with pytest.warns(DoubtWarning, match="positions of all joints") as caught:
        robot.fit(factor * q, tau + 0.5 * np.sign(v) + 0.3 * v + noise)
    assert re.search(pattern, str(caught[0].message))
    assert "--" not in str(caught[0].message)


def test_fit_warns_of_rows_without_torques_and_of_stuck_encoders(recording):
    q, tau = recording.q.copy(), recording.tau.copy()
    tau[::3] = 0.0
    (message,) = warned(recording, recording.q, tau)
    assert "All torques are zero in 1334 rows" in message
    q[len(q) // 2 :, :2] = q[len(q) // 2, :2]
    messages = warned(recording, q, recording.tau)
    assert sum("encoder was stuck" in x for x in messages) == 2
    rows = (np.floor(np.arange(len(q)) / 1.6) * 1.6).astype(int)
    messages = warned(recording, recording.q[rows], recording.tau)
    assert any("a new value only every 1.6 rows" in x for x in messages)


def test_fit_warns_of_a_single_outlier_and_of_some_in_a_row(recording):
    for rows in (slice(700, 701), slice(700, 705)):
        tau = recording.tau.copy()
        tau[rows, 1] += 50 * tau[:, 1].std()
        (message,) = warned(recording, recording.q, tau)
        assert "The torque of joint_2 has" in message
        assert "outlier(s)" in message


@pytest.mark.parametrize(
    ("blocks", "factors", "pattern"),
    [
        ([0, 1, 2], [1, 1, 1, 1], None),
        ([0, 1, 2], [1, 2, 1, 1], "of the positions are 0.5 times those given"),
        ([0, 1, 2], [1, 1, -1, 1], "of the velocities are -1 times those given"),
        ([1, 0, 2], [1, 1, 1, 1], "of all joints are the derivatives of the columns"),
        ([0, 1, 2], [1, 1, 1, -1], "has the wrong sign"),
    ],
)
def test_given_states_are_inspected(recording, blocks, factors, pattern):
    states = StateEstimator(dt=recording.dt).fit_transform(recording.q)
    states = np.split(states, 3, axis=1)
    X = np.hstack([factors[k] * states[k] for k in blocks])
    messages = warned(recording, X, factors[3] * recording.tau)
    assert len(messages) == (pattern is not None)
    assert not messages or re.search(pattern, messages[0])


def test_logged_velocities_are_compared_with_the_positions(recording):
    v, log = np.gradient(recording.q, recording.dt, axis=0), {"states": None}
    (note,) = inspect_recording(replace(recording, v=np.rad2deg(v), **log))
    assert (note.kind, note.severity) == ("wrong_states", "note")
    (error,) = inspect_recording(replace(recording, q=v, v=recording.q, **log))
    assert error.severity == "error"
    assert "exchange the two" in error.message
