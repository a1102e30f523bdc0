"""Equations of motion behind the low-pass, piece by piece."""

import numpy as np

from sklearn_vbjfa.robot._joint_torque import filter_weight

# Periods of the state cut-off at both ends in which the smoother sees one side only.
_EDGE_PERIODS = 1.0


def away_from_ends(parts, n, state_estimator):
    """Return which of n rows rest on samples on both sides, ndarray of bool.

    Parameters
    ----------
    parts : list of slice
        Recordings.
    n : int
        Number of rows.
    state_estimator : StateEstimator or None
        What made the states; None if they were given.
    """
    inside = np.ones(n, dtype=bool)
    if state_estimator is None:
        return inside
    slowest = state_estimator.cutoff_.min()
    if not np.isfinite(slowest):
        return inside
    for part in parts:
        # At most a tenth of a short recording.
        length = part.stop - part.start
        edge = min(int(_EDGE_PERIODS / (slowest * state_estimator.dt)), length // 20)
        inside[part.start : part.start + edge] = False
        inside[part.stop - edge : part.stop] = False
    return inside


def filtered_equations(
    features,
    states,
    torques,
    weight,
    parts,
    lowpass,
    halves,
    *,
    average,
    chunk_bytes,
):
    """Yield (index, Phi, tau, weight) behind the low-pass, piece by piece.

    With states from the `halves` of the samples also None (instruments) and the
    difference of their regressor matrices. With `average` the matrices are the mean of
    the two halves': what a quarter of the squared difference says of their noise is
    then exact, the rest being the product of one half with the other. A piece of the
    regressor takes about `chunk_bytes`; pieces overlap by the filter's length, so that
    their size does not matter.
    """
    per_row = 8 * features.n_joints_ * features.n_parameters_
    for part in parts:
        n = part.stop - part.start
        centres = lowpass.centres(n)
        rows = max(chunk_bytes // per_row, 4 * lowpass.half, lowpass.step)
        count = max(1, rows // lowpass.step)
        for first in range(0, centres.size, count):
            chosen = centres[first : first + count]
            start = part.start + chosen[0] - lowpass.half
            stop = part.start + chosen[-1] + lowpass.half + 1
            piece = slice(start, stop)
            if halves is not None:
                even, odd = (features._compute(half[piece]) for half in halves)
            if halves is not None and average:
                Phi = 0.5 * (even + odd)
            else:
                Phi = features._compute(states[piece])
            equations = (
                part.start + chosen,
                lowpass(Phi),
                lowpass(torques[piece]),
                filter_weight(lowpass, weight[piece]),
            )
            if halves is not None:
                equations += (None, lowpass(even - odd))
            yield equations
