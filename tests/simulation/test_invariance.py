"""Invariance of motions to scale, and the number of steps."""

import numpy as np
import pytest

from sklearn_vbjfa.simulation import Integrator, _dynamics, simulate
from tests.simulation._machines import Arm, machine

FRICTION = {"viscous": [0.3, 0.1], "coulomb": [1.0, 0.4], "offset": [0.1, 0.0]}
T = 0.01 * np.arange(101)
TAU = np.column_stack([6 * np.sin(5 * T), 2 * np.cos(8 * T)])
START = [0.4, -0.6], [1.0, -2.0]


@pytest.mark.parametrize("factor", [1e-4, 1e4])
def test_motion_is_invariant_to_the_unit_of_mass(factor):
    robot = Arm().robot(FRICTION)
    scaled = machine(
        robot.model,
        factor * robot.bodies,
        {name: factor * np.array(values) for name, values in FRICTION.items()},
    )
    states = simulate(robot, TAU, *START)
    scaled_states = simulate(scaled, factor * TAU, *START)
    np.testing.assert_allclose(states[:, :4], scaled_states[:, :4], rtol=0, atol=1e-8)


def steps_per_row(robot, tau, q0, v0=None, rows=100):
    """Return the mean number of steps per sample period."""
    dynamics = _dynamics.ForwardDynamics(robot)
    tau = np.asarray(tau, dtype=float)
    v0 = np.zeros(len(q0)) if v0 is None else np.array(v0)
    motion = Integrator(dynamics, np.array(q0), v0, tau, 0.0)
    for _ in range(rows):
        motion.advance(tau, tau, robot.dt)
    return motion.steps / rows


def test_few_steps_with_steep_friction():
    """Each limit is far below what explicit steps would need for stability."""
    light = Arm().robot({"viscous": [10.0, 1e4]})
    assert steps_per_row(light, [0.0, 0.0], [0.4, -0.6]) < 30
    dry = Arm().robot({"coulomb": [9.0, 9.0]})
    assert steps_per_row(dry, [0.0, 0.0], [0.4, -0.6]) == 1
