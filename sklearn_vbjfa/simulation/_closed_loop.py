"""Simulated motion of an identified robot under a controller."""

import numpy as np

from sklearn_vbjfa.simulation._dynamics import ForwardDynamics
from sklearn_vbjfa.simulation._integrate import Diverged, Integrator
from sklearn_vbjfa.simulation._simulate import (
    Recorded,
    SimulationError,
    tell_held,
)


def simulate_controlled(robot, control, q0, v0, t, signals=None, updates=1):
    """Simulate a robot whose torques a controller sets and then holds."""
    # control: (row, q, v) -> torques (nv,) as the channels read them, row being 3.5
    # between rows 3 and 4; updates: how often in a sample period. Returns states (n, 3
    # nv), torques (n, nv).
    n, nv = t.size, robot.n_joints
    dynamics = ForwardDynamics(robot, Recorded(signals or {}, t))
    states, tau = np.empty((n, 3 * nv)), np.empty((n, nv))
    drive = control(0.0, q0, v0)
    with np.errstate(all="ignore"):
        dynamics.set_bodies(t[0])
        motion = Integrator(dynamics, q0, v0, drive / robot.gains, t[0])
        for i in range(n):
            for part in range(updates):
                own = control(i + part / updates, motion.q, motion.v)
                drive = own / robot.gains
                length = 0.0 if i + 1 == n else (t[i + 1] - t[i]) / updates
                time = t[i] + part * length
                dynamics.set_bodies(time)
                motion.settle(drive)
                if part == 0:
                    tau[i] = own
                    states[i] = np.concatenate([motion.q, motion.v, motion.a])
                if i + 1 == n:
                    break
                _advance(robot, motion, drive, length, time, i)
    tell_held(robot, motion, stacklevel=3)
    return states, tau


def _advance(robot, motion, drive, length, time, row):
    """Go on under torques that are held, saying where that fails."""
    try:
        motion.advance(drive, drive, length)
    except Diverged as found:
        time += found.time
        raise SimulationError(
            f"The controlled robot diverges at t = {time:.6g} s (row {row}), joint "
            f"{robot.joint_names[found.joint]}: with these gains the loop is not "
            "stable. Check their units and signs, that the reference is the commanded "
            "position, and the period of the controller, which may be shorter than "
            "that of the recording.",
            time,
        ) from None
