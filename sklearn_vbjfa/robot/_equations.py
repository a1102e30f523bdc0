"""Equations of motion behind the low-pass, piece by piece."""

import numpy as np

from sklearn_vbjfa.robot._features import rounding_entries
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
    rows,
    torques,
    weight,
    parts,
    lowpass,
    halves,
    *,
    chunk_bytes,
):
    """Yield (index, Phi, tau, weight) behind the low-pass, piece by piece.

    Parameters
    ----------
    rows : RegressorRows or None
        Regressor matrices; None takes the mean of the two halves': what a quarter of
        the squared difference says of their noise is then exact, the rest being the
        product of one half with the other.
    torques, weight : ndarray of shape (n, nv)
        Measured torques and what they count.
    parts : list of slice
        Recordings.
    lowpass : Lowpass
        What regressors and torques pass.
    halves : tuple of RegressorRows or None
        Regressor matrices from the even and from the odd samples; with them None
        (instruments) and the difference of the two are yielded as well.
    chunk_bytes : int
        Size of a piece of the regressor; pieces overlap by the filter's length, so
        that their size does not matter.
    """
    one = rows if rows is not None else halves[0]
    per_row = 8 * one.n_joints * one.n_parameters
    for part in parts:
        n = part.stop - part.start
        centres = lowpass.centres(n)
        length = max(chunk_bytes // per_row, 4 * lowpass.half, lowpass.step)
        count = max(1, length // lowpass.step)
        for first in range(0, centres.size, count):
            chosen = centres[first : first + count]
            start = part.start + chosen[0] - lowpass.half
            stop = part.start + chosen[-1] + lowpass.half + 1
            piece = slice(start, stop)
            if halves is not None:
                even, odd = (half(piece) for half in halves)
            Phi = 0.5 * (even + odd) if rows is None else rows(piece)
            equations = (
                part.start + chosen,
                lowpass(Phi),
                lowpass(torques[piece]),
                filter_weight(lowpass, weight[piece]),
            )
            if halves is not None:
                equations += (None, lowpass(even - odd))
            yield equations


def unexcited_entries(stats, n_rigid):
    """Find what in the regressor matrices is zero but for rounding.

    The features leave out what is zero in every motion; where a joint does not move
    in this recording there is more.

    Parameters
    ----------
    stats : JointStatistics
        Second moments of nv joints and p parameters.
    n_rigid : int
        Number of parameters of the features; others are never left out.

    Returns
    -------
    ndarray of shape (nv, p), bool
        Entries to be taken as zero.
    """
    nv, n_all = stats.g.shape
    power = np.diagonal(stats.G, axis1=1, axis2=2)[:, :n_rigid]
    rounding = np.zeros((nv, n_all), dtype=bool)
    rigid = rounding_entries(power.reshape(nv, nv, -1))
    rounding[:, :n_rigid] = rigid.reshape(nv, -1)
    return rounding
