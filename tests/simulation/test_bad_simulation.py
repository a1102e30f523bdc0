"""Errors and warnings of simulations name time and place."""

import numpy as np
import pytest

from sklearn_vbjfa.effects import Elastic, Jerk, Spring
from sklearn_vbjfa.simulation import SimulationError, simulate
from tests.simulation._machines import Arm, machine, pendulum, point, slider

TAU = np.zeros((20, 2))


def simulation_error(message, *args, robot=None, error=ValueError, **keywords):
    robot = Arm().robot() if robot is None else robot
    with pytest.raises(error, match=message) as caught:
        simulate(robot, *args, **keywords)
    return caught.value


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_torque_is_named_by_row_time_and_joint(bad):
    tau = TAU.copy()
    tau[7, 1] = tau[9, 0] = bad
    message = rf"holds {bad} in row 7 .0.07 s after the start., joint elbow; 2 value"
    simulation_error(message, tau, [0, 0])


def test_negative_friction_accelerates():
    robot = slider(2.0, {"viscous": -1.0})
    states = simulate(robot, np.zeros((100, 1)), [0.0], [1.0])
    # m dv/dt = v
    assert states[-1, 1] == pytest.approx(np.exp(0.5 * 0.99), rel=1e-6)


def test_negative_inertia_is_refused():
    robot = Arm().robot({"rotor_inertia": [0.0, -1.0]})
    what = "inertia of elbow at q0 is not positive"
    simulation_error(what, TAU, [0, 0], robot=robot, error=SimulationError)


def test_non_positive_mass_is_refused():
    model = Arm().model()
    robot = machine(model, [point(1.0, inertia=0.1), np.zeros(10)])
    simulation_error("body of elbow has the mass 0 kg", TAU, [0, 0], robot=robot)


def test_divergence_names_time_and_joint():
    robot = slider(2.0, effects=[(Spring(), [-1e9, 0.0])])
    simulation_error(
        "diverges at t = 0.*rail has the velocity",
        np.zeros((100, 1)),
        [1e-3],
        robot=robot,
        error=SimulationError,
    )


@pytest.mark.parametrize("effect", [Elastic(0), Jerk(0)])
def test_effects_without_forward_dynamics_are_left_out_with_a_warning(effect):
    robot = pendulum(effects=[(effect, [0.01])])
    with pytest.warns(UserWarning, match=f"leaves out {effect.name} on pendulum"):
        states = simulate(robot, np.zeros((20, 1)), [0.5])
    bare = simulate(pendulum(), np.zeros((20, 1)), [0.5])
    np.testing.assert_array_equal(states, bare)
