"""Data frame columns are matched by name; rows out of order give a warning."""

import warnings

import numpy as np
import pandas
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.inspection import inspect_channels
from sklearn_vbjfa.recording import positions_and_signals, torques_in_order
from tests.effects._arms import arm, inverse_dynamics, motion

ORDER = [3, 0, 5, 1, 4, 2]
NAMES = [f"joint_{j + 1}" for j in range(6)]


def frame(values, names):
    return pandas.DataFrame(values, columns=names).iloc[:, ORDER]


def identify(simulated, X, y):
    robot = RobotIdentifier(simulated.urdf, dt=simulated.dt, friction=("viscous",))
    return robot.fit(X, y, groups=simulated.groups)


@pytest.mark.parametrize("names", ["q_joint_{}", "joint_{}", "q{}"])
def test_positions_in_any_order(simulated, names):
    X = frame(simulated.q, [names.format(j + 1) for j in range(6)])
    np.testing.assert_array_equal(positions_and_signals(X, NAMES)[0], simulated.q)


@pytest.mark.parametrize("names", ["tau_joint_{}", "joint_{}", "tau{}", "tau_{}"])
def test_torques_in_any_order(simulated, names):
    y = frame(simulated.tau, [names.format(j + 1) for j in range(6)])
    np.testing.assert_array_equal(torques_in_order(y, NAMES), simulated.tau)


def test_fit_accepts_columns_in_any_order(simulated):
    plain = identify(simulated, simulated.q, simulated.tau)
    names = [f"q_{name}" for name in NAMES]
    X, y = frame(simulated.q, names), frame(simulated.tau, NAMES)
    robot = identify(simulated, X, y)
    np.testing.assert_allclose(robot.theta_, plain.theta_, rtol=1e-5, atol=1e-7)
    assert list(robot.feature_names_in_) == names
    rows = slice(500, 900)
    expected = plain.predict(simulated.q[rows])
    np.testing.assert_allclose(robot.predict(X[rows]), expected, atol=1e-5)
    error = robot.residuals(X, y, simulated.groups).normalised_error()
    expected_error = plain.residuals(simulated.q, simulated.tau, simulated.groups)
    np.testing.assert_allclose(error, expected_error.normalised_error(), rtol=1e-5)


def test_states_by_name():
    values = np.arange(36.0).reshape(2, 18)
    names = [f"{kind}_{name}" for kind in "qva" for name in NAMES]
    shuffled = pandas.DataFrame(values, columns=names)[names[::-1]]
    np.testing.assert_array_equal(positions_and_signals(shuffled, NAMES)[0], values)
    counted = [f"{kind}{j}" for kind in "qva" for j in range(6)]
    shuffled = pandas.DataFrame(values, columns=counted)[counted[::-1]]
    np.testing.assert_array_equal(positions_and_signals(shuffled, NAMES)[0], values)


def test_unknown_column_names_are_refused(simulated):
    X = pandas.DataFrame(simulated.q, columns=[*NAMES[:5], "gripper"])
    with pytest.raises(ValueError, match=r"X has columns .*, gripper; ") as caught:
        identify(simulated, X, simulated.tau)
    assert "expected q_joint_1, " in str(caught.value)
    y = pandas.DataFrame(simulated.tau, columns=[f"current_{j}" for j in range(6)])
    with pytest.raises(ValueError, match="y has columns current_0"):
        identify(simulated, simulated.q, y)


@pytest.fixture(scope="module")
def logs():
    """Return a small arm and two concatenated recordings of it."""
    model, parts = arm("ZY"), [motion(2, 8.0, seed=seed)[1] for seed in (1, 2)]
    states = np.concatenate(parts)
    return model, states[:, :2], inverse_dynamics(model, states)


def fit_warnings(logs, rows=slice(None), groups=None):
    model, q, tau = logs
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        RobotIdentifier(model, dt=0.01, friction=()).fit(
            q[rows], tau[rows], groups=groups
        )
    return [str(warning.message) for warning in caught]


def test_missing_groups_give_the_warning_of_the_channel_checks(logs):
    model, q, tau = logs
    findings = inspect_channels(model, q, tau, 0.01)
    expected = [f.message for f in findings if f.kind == "position_jumps"]
    assert expected
    assert fit_warnings(logs)[: len(expected)] == expected
    assert fit_warnings(logs, groups=np.repeat([0, 1], len(q) // 2)) == []


def test_shuffled_rows_give_a_warning(logs):
    notes = fit_warnings(logs, np.random.default_rng(0).permutation(len(logs[1])))
    assert notes[0].startswith("The rows are not in the order of time")
