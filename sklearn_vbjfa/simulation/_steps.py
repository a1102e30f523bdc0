"""Arithmetic of a step: plain NumPy, which Numba compiles where it is installed."""

import numpy as np


def runge_kutta(y, h, k1, k2, k3, k4):
    """End of a classical step of order four from slopes (2, nv)."""
    return y + (h / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)


def forward(y, h, k):
    """Go a straight way: y + h k."""
    return y + h * k


def step_error(h, a1, a4, a5, fast, tolerance):
    """Error of such a step in units of what is allowed; nan where it is none.

    a1, a4, a5 (nv,) : accelerations at its beginning, its last slope, and at its end;
    fast (nv,) : fastest speeds.
    """
    allowed = tolerance * np.maximum(fast, h * np.abs(a1))
    return (h / 6.0) * np.max(np.abs(a4 - a5) / allowed)


def is_stiff(h, mass, by_position, by_velocity, stuck, most):
    """Whether friction or springs would keep an explicit step of length h short."""
    inertia = np.abs(np.diag(mass))
    free = np.where(stuck, 0.0, 1.0 / inertia)
    rate = np.max(np.abs(by_velocity) * free)
    return h * max(rate, np.sqrt(np.max(np.abs(by_position) * free))) > most


def events(watched, way, v, stuck, needed, most):
    """Joints that turned in a step, and joints that broke loose; (2, nv) of bool.

    most (nv,) : dry friction that holds joints.
    """
    out = np.zeros((2, v.size), dtype=np.bool_)
    out[0] = watched & (way * v < 0.0)
    out[1] = stuck & (np.abs(needed) > most)
    return out
