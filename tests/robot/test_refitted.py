"""MuJoCo files of robots with unsupported friction: other terms are refitted."""

from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.effects import Drift, LoadFriction, Signal, Stribeck
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.robot import TERMS, _robot, changed_motion, typical_motion
from tests.model._mujoco import drive_torques

EFFECTS = (Stribeck(1, vs=0.4), LoadFriction(2))


def with_sizes(robot, *sizes):
    """Return the robot with other coefficients of its effects."""
    theta = robot.theta_.copy()
    theta[-len(EFFECTS) :] = sizes
    return replace(robot, theta_=theta)


@pytest.fixture(scope="module")
def robot():
    recording = make_robot_recording(duration=6.0, dt=0.01, random_state=2)
    robot = RobotIdentifier(recording.urdf, dt=recording.dt, effects=EFFECTS)
    robot = robot.fit(recording.q, recording.tau).robot_
    return with_sizes(robot, 6.0, 0.15)


def export_error(robot, path):
    """Return RMS torque errors (nv,) of a file for a new motion."""
    states, _ = typical_motion(robot.effect_ranges_, 6, 0.013)
    v = np.abs(states[::5, 6:12])
    moving = states[::5][(v > 0.05 * v.max(axis=0)).all(axis=1)]
    return np.sqrt(
        ((drive_torques(path, moving) - robot.predict(moving)) ** 2).mean(axis=0)
    )


def test_refit_reduces_the_error_of_the_file(robot, tmp_path, monkeypatch):
    with pytest.warns(DoubtWarning, match=r"again.xml moves .* \(.*joint_3 \d+ %"):
        omitted = robot.to_mjcf(tmp_path / "again.xml")
    assert {(x.name, x.joint) for x in omitted} == {
        ("stribeck", 1),
        ("load_friction", 2),
    }
    assert all("fitted to it" in x.reason for x in omitted)
    refitted = export_error(robot, tmp_path / "again.xml")
    monkeypatch.setattr(_robot, "refitted", lambda robot, totals: 0.0 * totals)
    with pytest.warns(DoubtWarning):
        robot.to_mjcf(tmp_path / "before.xml")
    plain = export_error(robot, tmp_path / "before.xml")
    assert (refitted[[1, 2]] < 0.7 * plain[[1, 2]]).all()
    np.testing.assert_allclose(refitted[[0, 3, 4, 5]], plain[[0, 3, 4, 5]], atol=1e-9)


def test_refitted_terms_change_at_most_by_a_factor_of_two(robot):
    totals = _robot.plain_totals(robot.torque_model())
    file = totals + _robot.refitted(robot, totals)
    assert (file[[1, 2]] != totals[[1, 2]]).any()
    assert (0.5 * totals <= file).all()
    assert (file <= 2 * totals).all()
    np.testing.assert_array_equal(file[:, 2], totals[:, 2])


def test_diverging_robot_is_simulated_with_feedback(robot, tmp_path):
    theta = robot.theta_.copy()
    theta[robot.parameter_names_.index("joint_3:viscous")] = -1000.0
    with pytest.warns(DoubtWarning, match="without feedback"):
        replace(robot, theta_=theta).to_mjcf(tmp_path / "runs_away.xml")


def test_file_has_the_mean_of_a_drift(tmp_path):
    recording = make_robot_recording(duration=6.0, dt=0.01, random_state=2)
    t, path = 0.01 * np.arange(len(recording.tau)), tmp_path / "drifts.xml"
    # Recorded signals do not prevent the export.
    effects = [Drift(1, "offset", 150.0, end=t[-1]), Signal(0, "heat"), LoadFriction(2)]
    robot = RobotIdentifier(recording.urdf, dt=0.01, effects=effects)
    tau = recording.tau + 5.0 * np.outer(t, np.arange(6) == 1)
    robot.fit(recording.q, tau, signals={"heat": t**2})
    with pytest.warns(DoubtWarning, match=r"moves differently .*joint_2 \d+ %"):
        robot.robot_.to_mjcf(path)
    states = np.zeros((1, 18))
    half = robot.predict(states, t=[t[-1] / 2], signals={"heat": [0.0]})
    np.testing.assert_allclose(drive_torques(path, states), half, atol=0.1)


@pytest.mark.filterwarnings("error")
def test_small_omissions_give_no_warning(robot, tmp_path):
    assert len(with_sizes(robot, 0.02, 0.0).to_mjcf(tmp_path / "near.xml")) == 1


@pytest.mark.filterwarnings("ignore:The simulated robot leaves")
def test_changed_motion_matches_simulations(robot):
    plain = with_sizes(robot, 0.0, 0.0)
    change = changed_motion(robot, robot.torque_model(), plain.torque_model())
    states, _ = typical_motion(robot.effect_ranges_, 6, robot.dt)
    tau, squares = robot.predict(states), []
    for start in np.linspace(0, len(states) - 100, 6).astype(int):
        start_of = np.split(states[start], 3)[:2]
        rows = slice(start, start + 100)
        motions = [x.simulate(tau[rows], *start_of)[:, :6] for x in (robot, plain)]
        squares.append(((motions[1] - motions[0]) ** 2).mean(axis=0))
    expected = np.sqrt(np.mean(squares, axis=0)) / states[:, :6].std(axis=0)
    np.testing.assert_allclose(change, expected, rtol=1e-9)


def test_a_file_that_diverges_changes_without_limit(robot):
    model = robot.torque_model()
    runaway = replace(model, friction=-1e3 - model.friction)
    assert np.isinf(changed_motion(robot, model, runaway)).all()


@pytest.mark.filterwarnings("error")
def test_supported_terms_are_not_refitted(robot, tmp_path):
    plain = with_sizes(robot, 0.0, 0.0)
    changes = _robot.refitted(plain, _robot.plain_totals(plain.torque_model()))
    assert changes.shape == (6, len(TERMS))
    assert not changes.any()
    assert plain.to_mjcf(tmp_path / "plain.xml") == ()
