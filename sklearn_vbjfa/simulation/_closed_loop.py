"""Simulated motion of an identified robot under a controller."""

import numpy as np

from sklearn_vbjfa.simulation._dynamics import ForwardDynamics
from sklearn_vbjfa.simulation._integrate import Diverged, Integrator
from sklearn_vbjfa.simulation._simulate import Recorded, SimulationError


def simulate_controlled(robot, control, q0, v0, t, signals=None):
    """Simulate a robot whose torques a controller sets once in every sample period.

    Parameters
    ----------
    robot : TorqueModel
        Robot.
    control : callable
        (row, q, v) -> torques (nv,) as the channels read them [N m or N], held until
        the next row.
    q0, v0 : ndarray of shape (nv,)
        Start [rad or m, and per s].
    t : ndarray of shape (n,)
        Times of the rows [s].
    signals : mapping of str to ndarray of shape (n,), default=None
        What was recorded beside the motion.

    Returns
    -------
    states : ndarray of shape (n, 3 * nv)
        States [q | v | a].
    tau : ndarray of shape (n, nv)
        Torques of the controller.

    Raises
    ------
    SimulationError
        If the loop diverges.
    """
    n, nv = t.size, robot.n_joints
    dynamics = ForwardDynamics(robot, Recorded(signals or {}, t))
    states, tau = np.empty((n, 3 * nv)), np.empty((n, nv))
    tau[0] = control(0, q0, v0)
    with np.errstate(all="ignore"):
        motion = Integrator(dynamics, q0, v0, tau[0] / robot.gains, t[0])
        for i in range(n):
            if i > 0:
                tau[i] = control(i, motion.q, motion.v)
            drive = tau[i] / robot.gains
            dynamics.set_time(t[i])
            motion.refresh(drive)
            states[i] = np.concatenate([motion.q, motion.v, motion.a])
            if i + 1 == n:
                break
            try:
                motion.advance(drive, drive, t[i + 1] - t[i])
            except Diverged as found:
                time = t[i] + found.time
                raise SimulationError(
                    f"The controlled robot diverges at t = {time:.6g} s (row {i}), "
                    f"joint {robot.joint_names[found.joint]}: with these gains the "
                    "loop is not stable. Check their units and signs, and that the "
                    "reference is the commanded position.",
                    time,
                ) from None
    return states, tau
