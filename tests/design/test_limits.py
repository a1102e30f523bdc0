"""Limits of designs; error messages name sufficient values."""

import numpy as np
import pytest

from sklearn_vbjfa.design import MotionLimits, design_motion
from sklearn_vbjfa.model import load_model
from tests.design._chains import chain, posed, problem_of

RANGE = np.array([[-1.5, 1.5]] * 2)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return chain(tmp_path_factory.mktemp("limits"), ("revolute",) * 2, effort=60.0)


def limits(**changed):
    values = {"position": RANGE, "velocity": [2.0, 2.0], "torque": [60.0, 60.0]}
    return MotionLimits(**values | changed)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"position": [[1.0, 1.0], [-1, 1]]}, r"Joint 1 has no room.*\[1\. 1\.\]"),
        ({"position": [[2.0, 1.0], [-1, 1]]}, "position must hold low < high"),
        ({"position": [[np.nan, 1.0], [-1, 1]]}, "Joint 1 has no room"),
        ({"position": [[-1, 1], [-np.inf, 1.0]]}, "Joint 2 turns without end"),
        ({"position": [-1.0, 1.0]}, r"shape \(nv, 2\); got shape \(2,\)"),
        ({"velocity": [2.0]}, r"shape \(2,\) like position; got shape \(1,\)"),
        ({"velocity": [2.0, 0.0]}, "Joint 2 .* velocity must be positive; got 0"),
        ({"velocity": [2.0, np.nan]}, "Joint 2 .* velocity must be positive; got nan"),
        ({"velocity": [2.0, np.inf]}, "Joint 2 has no limit of velocity"),
        ({"torque": [-3.0, 2.0]}, "Joint 1 .* torque must be positive; got -3"),
        ({"torque": [3.0, np.inf]}, "Joint 2 needs a limit of acceleration or of"),
    ],
)
def test_invalid_limits_are_refused(changed, message):
    with pytest.raises(ValueError, match=message):
        limits(**changed)


def test_limits_are_those_of_the_description(tmp_path):
    path = chain(tmp_path, ("revolute", "continuous"), effort=7.0, velocity=3.0)
    for model in (path, load_model(path)):
        described = MotionLimits.of(model)
        np.testing.assert_allclose(described.position, [[-1.5, 1.5], [-np.pi, np.pi]])
        np.testing.assert_allclose(described.velocity, 3.0)
        np.testing.assert_allclose(described.torque, 7.0)
        assert np.isinf(described.acceleration).all()


@pytest.mark.parametrize(
    ("lacking", "message"),
    [({"effort": 0.0}, "no torque limit of"), ({"velocity": 0.0}, "no velocity limit")],
)
def test_a_description_without_limits_is_refused(lacking, message, tmp_path):
    bare = chain(tmp_path, ("revolute", "revolute"), **lacking)
    with pytest.raises(ValueError, match=f"{message}.* chain_1, chain_2. Give limits="):
        design_motion(bare, duration=4.0, dt=0.02)


def number_after(text, words):
    """Return the number that follows words of a message."""
    return float(text.split(words)[1].split()[0].rstrip(".,"))


def test_message_names_a_sufficient_duration(path):
    slow = limits(velocity=[2.0, 0.1])
    with pytest.raises(ValueError, match="too short for chain_2") as refused:
        problem_of(path, duration=4.0, limits=slow)
    value = number_after(str(refused.value), "Give a duration of ")
    problem, z = problem_of(path, duration=value, limits=slow)
    v = problem.curve.states(z, problem.curve.basis(problem.times()))[:, 2:4]
    assert np.all(np.abs(v) <= slow.velocity)


def test_message_names_a_sufficient_torque_limit(path):
    weak = limits(torque=[60.0, 1e-3])
    with pytest.raises(ValueError, match="chain_2 needs") as refused:
        posed(path, limits=weak)
    value = number_after(str(refused.value), "a torque limit of ")
    posed(path, limits=limits(torque=[60.0, value]))


def test_limits_of_another_robot(path):
    other = MotionLimits([[-1, 1]] * 3, [1.0] * 3, torque=[9.0] * 3)
    with pytest.raises(ValueError, match="for 3 joints; the robot has 2: chain_1"):
        problem_of(path, limits=other)
    with pytest.raises(TypeError, match="limits must be MotionLimits; got dict"):
        problem_of(path, limits={"velocity": 2.0})
