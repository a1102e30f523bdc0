"""Columns of data frames are found by name, rows out of order are told of."""

import warnings

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.inspection import inspect_channels
from sklearn_vbjfa.recording import positions_in_order

pandas = pytest.importorskip("pandas")

ORDER = [3, 0, 5, 1, 4, 2]
NAMES = [f"joint_{j + 1}" for j in range(6)]


def frame(values, names):
    return pandas.DataFrame(values, columns=names).iloc[:, ORDER]


def identify(simulated, X, y):
    robot = RobotIdentifier(simulated.urdf, dt=simulated.dt, friction=("viscous",))
    return robot.fit(X, y, groups=simulated.groups)


@pytest.fixture(scope="module")
def plain(simulated):
    return identify(simulated, simulated.q, simulated.tau)


@pytest.mark.parametrize(
    ("positions", "torques"),
    [("q_joint_{}", "joint_{}"), ("q{}", "tau_joint_{}"), ("joint_{}", "tau_{}")],
)
def test_columns_in_any_order(simulated, plain, positions, torques):
    X = frame(simulated.q, [positions.format(j + 1) for j in range(6)])
    y = frame(simulated.tau, [torques.format(j + 1) for j in range(6)])
    robot = identify(simulated, X, y)
    np.testing.assert_allclose(robot.theta_, plain.theta_, rtol=1e-5, atol=1e-7)
    assert list(robot.feature_names_in_) == [positions.format(j + 1) for j in range(6)]
    for rows in (slice(0, 500), slice(500, 900)):
        np.testing.assert_allclose(
            robot.predict(X[rows]), plain.predict(simulated.q[rows]), atol=1e-5
        )
    groups = simulated.groups
    expected = plain.score(simulated.q, simulated.tau, groups=groups)
    assert robot.score(X, y, groups=groups) == pytest.approx(expected, abs=1e-6)
    left = robot.residuals(X, y, groups).normalised_error()
    right = plain.residuals(simulated.q, simulated.tau, groups).normalised_error()
    np.testing.assert_allclose(left, right, rtol=1e-5)


def test_states_by_name():
    values = np.arange(36.0).reshape(2, 18)
    names = [f"{kind}_{name}" for kind in "qva" for name in NAMES]
    shuffled = pandas.DataFrame(values, columns=names)[names[::-1]]
    np.testing.assert_array_equal(positions_in_order(shuffled, NAMES), values)
    counted = [f"{kind}{j}" for kind in "qva" for j in range(6)]
    shuffled = pandas.DataFrame(values, columns=counted)[counted[::-1]]
    np.testing.assert_array_equal(positions_in_order(shuffled, NAMES), values)


def test_foreign_names_are_refused(simulated):
    X = pandas.DataFrame(simulated.q, columns=[*NAMES[:5], "gripper"])
    with pytest.raises(ValueError, match="of which gripper name no joint") as caught:
        identify(simulated, X, simulated.tau)
    assert "expected q_joint_1, " in str(caught.value)
    y = pandas.DataFrame(simulated.tau, columns=[f"current_{j}" for j in range(6)])
    with pytest.raises(ValueError, match="y has columns current_0"):
        identify(simulated, simulated.q, y)


# -- rows ------------------------------------------------------------------------------


def messages(simulated, rows, groups):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        RobotIdentifier(simulated.urdf, dt=simulated.dt, friction=("viscous",)).fit(
            simulated.q[rows], simulated.tau[rows], groups=groups
        )
    return [str(warning.message) for warning in caught]


def test_forgotten_groups_are_told_of_in_the_words_of_the_checks(simulated):
    said = messages(simulated, slice(None), None)
    findings = inspect_channels(
        simulated.urdf, simulated.q, simulated.tau, simulated.dt
    )
    words = [f.message for f in findings if f.kind == "position_jumps"]
    assert words
    assert said == words
    assert messages(simulated, slice(None), simulated.groups) == []


def test_shuffled_rows_are_told_of(simulated):
    order = np.random.default_rng(0).permutation(simulated.n_samples)
    said = messages(simulated, order, None)
    assert said[0].startswith("The rows are not in the order of time")
