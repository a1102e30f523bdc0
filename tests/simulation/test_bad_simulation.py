"""What is refused, and what is warned of: every message says when and where."""

import re
import warnings

import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.effects import Elastic, Jerk, Spring
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.robot import FitOptions
from sklearn_vbjfa.simulation import SimulationError, simulate
from tests.simulation._machines import Arm, machine, pendulum, point, slider, wheel

TAU = np.zeros((20, 2))


def refused(message, *args, robot=None, error=ValueError, **keywords):
    robot = Arm().robot() if robot is None else robot
    with pytest.raises(error, match=message) as caught:
        simulate(robot, *args, **keywords)
    return caught.value


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_torque_that_is_no_number_is_named_by_row_time_and_joint(bad):
    tau = TAU.copy()
    tau[7, 1] = tau[9, 0] = bad
    message = rf"holds {bad} in row 7 .0.07 s after the start., joint elbow; 2 value"
    refused(message, tau, [0, 0])


def limited(low, high):
    robot = Arm().robot()
    robot.model.lowerPositionLimit = np.array([low, -np.inf])
    robot.model.upperPositionLimit = np.array([high, np.inf])
    return robot


def test_start_outside_the_limits_says_both():
    message = r"limits of shoulder: 1.5 rad, limits -1 to 1 rad. Check the zero"
    refused(message, TAU, [1.5, 0.0], robot=limited(-1.0, 1.0))


def test_a_joint_that_leaves_its_limits_is_a_warning():
    with pytest.warns(UserWarning, match=r"limits: shoulder at t = 0.[0-9]* s"):
        states = simulate(limited(-1.0, 1.0), TAU, [0.9, 0.0], [6.0, 0.0])
    assert states.shape == (20, 6)


@pytest.mark.parametrize("dt", [2.0, 0.25])
def test_a_joint_that_stops_more_often_than_is_followed_is_told(dt):
    """A wheel on a spring turns 16 times a second, and hardly loses anything."""
    rng = np.random.default_rng(0)
    states = rng.uniform(-1, 1, size=(400, 3)) * [1.0, 25.0, 625.0]
    q, v, a = states.T
    inertia, friction = 0.5, 1e-3
    stiffness = inertia * (8 * 2 * np.pi) ** 2
    tau = inertia * a + friction * np.sign(v) + stiffness * q
    robot = RobotIdentifier(
        wheel(inertia).model,
        dt=dt,
        friction=("coulomb",),
        effects=[Spring(0)],
        cutoff=None,
        options=FitOptions(standstill=None),
    ).fit(states, tau[:, None])
    rest = robot.theta_[-1] / robot.theta_[-2]
    torques, start = np.zeros((round(6 / dt) + 1, 1)), [rest + 0.5]
    if dt < 1.0:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            robot.simulate(torques, start)
        return
    told = "in 3 .*more than 20 stops within a sample period"
    with pytest.warns(UserWarning, match=told) as caught:
        found = robot.simulate(torques, start)
    assert "stop" in str(caught[0].message)
    first = float(re.search(r"at t = ([\d.]+) s", str(caught[0].message))[1])
    # The 21st turn of 16 a second.
    assert first == pytest.approx(21 / 16, abs=0.02)
    assert (found[1:, 1] == 0).all()


def test_times():
    t = 0.01 * np.arange(20)
    refused(r"tau has 20 rows and t has shape \(19,\)", TAU, [0, 0], t=t[:-1])
    bad = t.copy()
    bad[4] = np.nan
    refused("t must rise; it goes from 0.03 to nan s in row 4", TAU, [0, 0], t=bad)
    bad[4] = t[2]
    refused("t must rise; it goes from 0.03 to 0.02 s in row 4", TAU, [0, 0], t=bad)
    refused("every 0.005 s .*identified at 0.01 s", TAU, [0, 0], t=0.5 * t)
    gap = t + 0.5 * (np.arange(20) > 6)
    refused(
        "t goes from 0.06 to 0.57 s in row 7, .*rows are missing", TAU, [0, 0], t=gap
    )


def test_negative_friction_is_a_warning():
    robot = slider(2.0, {"viscous": -1.0})
    with pytest.warns(DoubtWarning, match="Friction of rail has a negative coefficien"):
        states = simulate(robot, np.zeros((100, 1)), [0.0], [1.0])
    # m dv/dt = v
    assert states[-1, 1] == pytest.approx(np.exp(0.5 * 0.99), rel=1e-6)


def test_negative_inertia():
    robot = Arm().robot({"rotor_inertia": [0.0, -1.0]})
    refused("inertia of elbow at q0 is not positive", TAU, [0, 0], robot=robot)


def test_mass_that_is_not_positive():
    model = Arm().model()
    robot = machine(model, [point(1.0, inertia=0.1), np.zeros(10)])
    refused("body of elbow has the mass 0 kg", TAU, [0, 0], robot=robot)


def test_divergence_says_when_and_where():
    robot = slider(2.0, effects=[(Spring(), [-1e9, 0.0])])
    error = refused(
        "diverges at t = .*rail has the velocity",
        np.zeros((100, 1)),
        [1e-3],
        robot=robot,
        error=SimulationError,
    )
    assert 0 < error.time < 1.0


@pytest.mark.parametrize("effect", [Elastic(0), Jerk(0)])
def test_effects_without_forward_dynamics_are_left_out_with_a_warning(effect):
    robot = pendulum(effects=[(effect, [0.01])])
    with pytest.warns(UserWarning, match=f"leaves out {effect.name} on pendulum"):
        found = simulate(robot, np.zeros((20, 1)), [0.5])
    bare = simulate(pendulum(), np.zeros((20, 1)), [0.5])
    np.testing.assert_array_equal(found, bare)
