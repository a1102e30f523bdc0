"""What reaches the joints, from what the torque channels read."""

import numpy as np

from sklearn_vbjfa.effects import Delay, Motion
from sklearn_vbjfa.simulation._terms import CHANNELS


def true_torques(robot, tau, t):
    """Turn measured torques (n, nv) at times t (n,) into those at the joints."""
    # The gains of the channels are divided out. A delay is taken back by reading the
    # recording later (or earlier) by it; a filter, y = x + B x for the torque x, by the
    # first terms of the series of its inverse, x = y - B y + B^2 y: it restores what
    # the filter lets through without blowing up the noise above.
    out = tau / robot.gains
    for effect, coef in zip(robot.effects, robot.coefficients):
        if isinstance(effect, CHANNELS) and t.size > 1:
            j = effect.joint
            if isinstance(effect, Delay):
                out[:, j] = np.interp(t + coef[0], t, out[:, j])
            else:
                once = _changed(effect, coef, out, t)
                twice = _changed(effect, coef, once, t)
                out[:, j] += twice[:, j] - once[:, j]
    return out


def _changed(effect, coef, torque, t):
    """Return what a filter adds to torques (n, nv), zero but on its joint."""
    rest = np.zeros_like(torque)
    motion = Motion(q=rest, v=rest, a=rest, t=t, load=torque, torque=torque)
    out = np.zeros_like(torque)
    out[:, effect.joint] = effect.columns(motion) @ coef
    return out
