"""Arithmetic of a step: plain NumPy, which Numba compiles where it is installed."""

import numpy as np

_TINY = float(np.finfo(float).tiny)


def step_error(h, a1, a4, a5, fast, tolerance):
    """Error of such a step in units of what is allowed; nan where it is none."""
    # a1, a4, a5 (nv,): accelerations at its beginning, its last slope, and at its end;
    # fast (nv,): fastest speeds.
    allowed = tolerance * np.maximum(fast, h * np.abs(a1))
    return (h / 6.0) * np.max(np.abs(a4 - a5) / allowed)


def is_stiff(h, mass, by_position, by_velocity, stuck, most):
    """Whether friction or springs would keep an explicit step of length h short."""
    inertia = np.abs(np.diag(mass))
    free = np.where(stuck, 0.0, 1.0 / inertia)
    rate = np.max(np.abs(by_velocity) * free)
    return h * max(rate, np.sqrt(np.max(np.abs(by_position) * free))) > most


def load_size(L, low, high):
    """Sizes of loads L (nv,) that ends hold, as constants and slopes by the loads."""
    held = np.minimum(np.maximum(L, low), high)
    inside = held == L
    constant = np.where(inside, 0.0, np.abs(held))
    return constant, np.where(inside, np.sign(L), 0.0)


def directions(v, a):
    """Ways that joints go (nv,): signs of velocities, or of accelerations at rest."""
    return np.where(v != 0.0, np.sign(v), np.sign(a))


def past_events(watched, way, v, exact, stuck, needed, limit, holds, loose):
    """How far joints are past an event, in units of what they may be, (nv,)."""
    # Those that slide turn round; exact (nv,): velocities that count as zero. Those
    # that stick break loose beyond `holds` times the limit of their friction; an excess
    # of `loose` times the limit counts as none. Negative before the event, -inf for
    # joints without any.
    out = np.where(watched & ~stuck, -way * v / exact, -np.inf)
    excess = (np.abs(needed) - holds * limit) / np.maximum(loose * limit, _TINY)
    return np.where(stuck, excess, out)
