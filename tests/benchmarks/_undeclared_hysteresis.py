"""Signals that remember: bristles, slipping springs, play, lags.

All are integrated sample by sample within one recording.
"""

from itertools import pairwise

import numpy as np


def pieces(groups):
    """Slices of the recordings."""
    edges = np.flatnonzero(np.diff(groups)) + 1
    bounds = [0, *edges.tolist(), len(groups)]
    return [slice(a, b) for a, b in pairwise(bounds)]


def lugre(v, dt, *, displacement, lag, rise, speed, substeps=4):
    """Friction of the LuGre model for a Coulomb level of one."""
    knots = np.arange(v.size)
    fine = np.interp(
        np.arange((v.size - 1) * substeps) / substeps + 0.5 / substeps, knots, v
    )
    h = dt / substeps
    level = np.sign(fine) * (1.0 + rise * np.exp(-((fine / speed) ** 2)))
    rate = np.abs(fine) / displacement / np.abs(np.where(level == 0.0, 1.0, level))
    decay = np.exp(-rate * h)
    s, states = 0.0, np.zeros(fine.size + 1)
    for i, (target, keep) in enumerate(zip(level.tolist(), decay.tolist())):
        s = target + (s - target) * keep
        states[i + 1] = s
    s = states[::substeps]
    g = 1.0 + rise * np.exp(-((v / speed) ** 2))
    return s + lag * v / displacement * (1.0 - np.sign(v) * s / g)


def maxwell_slip(q, thresholds, stiffness):
    """Friction of springs in parallel that each slip at their own deflection."""
    deflection = np.zeros(len(thresholds))
    force = np.zeros(q.size)
    for i, step in enumerate(np.diff(q), start=1):
        deflection = np.clip(deflection + step, -thresholds, thresholds)
        force[i] = stiffness @ deflection
    return force / (stiffness @ thresholds)


def play(q, width):
    """Position of a part that q pushes to and fro through a gap."""
    half = 0.5 * width
    follower, out = float(q[0]), np.empty(q.size)
    for i, x in enumerate(q.tolist()):
        follower = min(max(follower, x - half), x + half)
        out[i] = follower
    return out


def first_order_lag(x, dt, time_constant):
    """Signal y of T dy/dt = x - y, which begins at rest, by steps of a tenth of T."""
    steps = max(1, int(np.ceil(10.0 * dt / time_constant)))
    h = dt / steps
    keep = (time_constant - 0.5 * h) / (time_constant + 0.5 * h)
    y, out = float(x[0]), np.empty(x.size)
    out[0] = y
    for i in range(1, x.size):
        fine = np.linspace(x[i - 1], x[i], steps + 1)
        # the trapezoidal rule
        for u in 0.5 * (fine[1:] + fine[:-1]):
            y = keep * y + (1.0 - keep) * u
        out[i] = y
    return out


def two_sided_average(x, dt, time_constant):
    """Average of a signal with weights exp(-|s| / T): a lag forwards and backwards."""
    forwards = first_order_lag(x, dt, time_constant)
    return first_order_lag(forwards[::-1], dt, time_constant)[::-1]
