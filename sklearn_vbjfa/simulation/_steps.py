"""Arithmetic of a step: plain NumPy, which Numba compiles where it is installed."""

import numpy as np

_TINY = float(np.finfo(float).tiny)


def runge_kutta(q, v, h, v2, v3, v4, a1, a2, a3, a4):
    """End of a classical step of order four from slopes, all (nv,)."""
    q4 = q + (h / 6.0) * (v + 2.0 * (v2 + v3) + v4)
    return q4, v + (h / 6.0) * (a1 + 2.0 * (a2 + a3) + a4)


def forward(q, v, h, velocity, acceleration):
    """Go a straight way from a state."""
    return q + h * velocity, v + h * acceleration


def ways(v, a):
    """Signs of velocities; where they are zero, of what they are about to be."""
    return np.where(v != 0.0, np.sign(v), np.sign(a))


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


def past_events(watched, way, v, exact, stuck, needed, holds, loose):
    """How far joints are past an event, in units of what they may be, (nv,).

    Those that slide turn round; exact (nv,) : velocities that count as zero. Those that
    stick break loose beyond what holds them; loose (nv,) : excess that counts as none.
    Negative before the event, -inf for joints without any.
    """
    out = np.where(watched & ~stuck, -way * v / exact, -np.inf)
    excess = (np.abs(needed) - holds) / np.maximum(loose, _TINY)
    return np.where(stuck, excess, out)
