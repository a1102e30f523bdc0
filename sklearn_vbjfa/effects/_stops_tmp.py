import numpy as np


def _turning_points(q):
    """Find the samples at which a position turns, with both ends."""
    step = np.diff(q)
    moving = np.flatnonzero(step)
    if moving.size == 0:
        return np.array([0, q.size - 1])
    way = np.sign(step[moving])
    turns = moving[1:][way[1:] != way[:-1]]
    return np.unique(np.r_[0, turns, q.size - 1])


def stops(q, displacements):
    """Stop operators z' = clip(z + dq / d, -1, 1) of unit size, (n, k)."""
    # Between two turning points the sum of the clipped steps is the clipped sum, so
    # that the state at each turning point determines the rows up to the next one.
    d = np.asarray(displacements, dtype=float)
    turns = _turning_points(q)
    steps = np.diff(q[turns])[:, None] / d
    at_turn = np.zeros((turns.size, d.size))
    for i, step in enumerate(steps):
        at_turn[i + 1] = np.minimum(np.maximum(at_turn[i] + step, -1.0), 1.0)
    last = np.searchsorted(turns, np.arange(q.size), side="right") - 1
    return np.clip(at_turn[last] + (q - q[turns[last]])[:, None] / d, -1.0, 1.0)


