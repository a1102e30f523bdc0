"""Equations of motion behind the low-pass, piece by piece and in parallel.

A piece is a run of filtered rows of one recording. It is made from the states of the
rows that its filters see and reduced to second moments where it is made, so that the
regressor matrices are never there as a whole, and pieces can be made at the same time.
The division into pieces depends on neither the number of jobs nor the order in which
they finish, and their sum is taken in the order of the recording: the result is the
same to the last bit on one processor and on many.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from sklearn.utils.parallel import Parallel, delayed

from sklearn_vbjfa.physical._threads import one_blas_thread
from sklearn_vbjfa.robot._block_filter import BlockFilter, block_length, decimate
from sklearn_vbjfa.robot._block_moments import Numbering
from sklearn_vbjfa.robot._effect_columns import RegressorRows
from sklearn_vbjfa.robot._features import rounding_entries
from sklearn_vbjfa.robot._joint_statistics import joint_statistics
from sklearn_vbjfa.robot._joint_torque import filter_weight
from sklearn_vbjfa.robot._states import SplineStates

# Periods of the state cut-off at both ends in which the smoother sees one side only.
_EDGE_PERIODS = 1.0
# Rows whose states are evaluated together; a block of regressor matrices has fewer.
_SPAN_ROWS = 4096
# Tasks that are handed out at a time: their results are in memory together.
_BATCH = 32


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """One recording before the low-pass.

    Attributes
    ----------
    first : int
        Number of its first row.
    states : ndarray of shape (n, 3 * nv) or SplineStates
        States that tell whether a joint moves.
    rows : RegressorRows or None
        Regressor matrices; None takes the mean of the two halves': what a quarter of
        the squared difference says of their noise is then exact, the rest being the
        product of one half with the other.
    halves : tuple of RegressorRows or None
        Regressor matrices from the even and from the odd samples.
    torque, weight : ndarray of shape (n, nv)
        Measured torques and what they count.
    standstill : ndarray of shape (nv,)
        Speeds at or below which a joint's rows do not count.
    edge : int
        Rows at both ends that do not count.
    number : int
        Number of the recording.
    """

    first: int
    states: np.ndarray | SplineStates
    rows: RegressorRows | None
    halves: tuple | None
    torque: np.ndarray
    weight: np.ndarray
    standstill: np.ndarray
    edge: int = 0
    number: int = 0

    @property
    def n_rows(self):
        """Number of rows."""
        return self.torque.shape[0]

    def counts(self, rows):
        """Return the weights of a slice of rows, zero where the joint stands."""
        start, stop, _ = rows.indices(self.n_rows)
        moves = np.abs(velocities(self.states, rows)) > self.standstill
        row = np.arange(start, stop)
        inside = (row >= self.edge) & (row < self.n_rows - self.edge)
        return self.weight[rows] * moves * inside[:, None]


def velocities(states, rows):
    """Velocities (n, nv) of a slice of rows."""
    if isinstance(states, SplineStates):
        return states.derivative(rows, 1)
    nv = states.shape[1] // 3
    return states[rows, nv : 2 * nv]


def edge_rows(n, state_estimator):
    """Return how many rows at each end of n rest on samples on one side only.

    Parameters
    ----------
    n : int
        Length of a recording.
    state_estimator : StateEstimator or None
        What made the states; None if they were given.
    """
    if state_estimator is None:
        return 0
    slowest = state_estimator.cutoff_.min()
    if not np.isfinite(slowest):
        return 0
    # At most a tenth of a short recording.
    return min(int(_EDGE_PERIODS / (slowest * state_estimator.dt)), n // 20)


def pieces(stretch, lowpass, chunk_bytes):
    """Divide a recording: slices of its filtered rows of at most so many bytes.

    Pieces overlap by the filter's length in the rows that they are made from, so that
    their size does not matter; none is shorter than twice the filter.
    """
    one = stretch.rows if stretch.rows is not None else stretch.halves[0]
    kinds = (stretch.rows is not None) + 2 * (stretch.halves is not None)
    per_output = 8 * kinds * one.n_joints * one.n_parameters
    count = max(chunk_bytes // per_output, 4 * lowpass.half // lowpass.step, 1)
    total = lowpass.centres(stretch.n_rows).size
    return [slice(i, min(i + count, total)) for i in range(0, total, count)]


def piece_equations(stretch, lowpass, outputs):
    """Return (index, Phi, tau, weight) of some filtered rows.

    With halves None (instruments) and the difference of the two are returned as well.
    """
    chosen = lowpass.centres(stretch.n_rows)[outputs]
    seen = slice(int(chosen[0]) - lowpass.half, int(chosen[-1]) + lowpass.half + 1)
    made = () if stretch.rows is None else (stretch.rows,)
    made += stretch.halves or ()
    filtered = _filter_rows(made, seen, lowpass, chosen.size)
    Phi = filtered[0]
    if stretch.halves is not None:
        even, odd = filtered[-2:]
        if stretch.rows is None:
            Phi = 0.5 * (even + odd)
    equations = (
        stretch.first + chosen,
        Phi,
        decimate(lowpass, stretch.torque[seen]),
        filter_weight(lowpass, stretch.counts(seen)),
    )
    if stretch.halves is not None:
        equations += (None, np.subtract(even, odd, out=even))
    return equations


def _filter_rows(made, seen, lowpass, count):
    """Regressor matrices behind the low-pass, block by block."""
    shape = made[0].n_joints, made[0].n_parameters
    filters = [BlockFilter(lowpass, count, shape, rows.support) for rows in made]
    length = block_length(lowpass, 8 * shape[0] * shape[1])
    span = length * max(1, _SPAN_ROWS // length)
    for begin in range(seen.start, seen.stop, span):
        stretch = slice(begin, min(begin + span, seen.stop))
        for rows, into in zip(made, filters):
            own = rows.part(stretch)
            for at in range(0, stretch.stop - begin, length):
                block = slice(at, min(at + length, stretch.stop - begin))
                into.add(begin - seen.start + at, own(block))
    return [into.outputs for into in filters]


def filtered_equations(stretches, lowpass, *, chunk_bytes):
    """Yield the `piece_equations` of recordings, one after the other.

    Parameters
    ----------
    stretches : iterable of Stretch
        Recordings.
    lowpass : Lowpass
        What regressors and torques pass.
    chunk_bytes : int
        Size of a piece.
    """
    for stretch in stretches:
        for outputs in pieces(stretch, lowpass, chunk_bytes):
            yield piece_equations(stretch, lowpass, outputs)


def numbered(stretches, lowpass):
    """Divide recordings into blocks of time, see `Numbering`."""
    return Numbering.of([lowpass.centres(s.n_rows).size for s in stretches])


def numbered_parts(stretches, lowpass, *, chunk_bytes):
    """Yield the `Numbering.parts` of each piece of `filtered_equations`."""
    numbering = numbered(stretches, lowpass)
    for stretch in stretches:
        for outputs in pieces(stretch, lowpass, chunk_bytes):
            yield numbering.parts(stretch.number, outputs)


def _piece_statistics(stretch, lowpass, outputs, parts):
    with one_blas_thread():
        _, Phi, tau, weight, *others = piece_equations(stretch, lowpass, outputs)
        difference = others[1] if others else None
        return joint_statistics(Phi, tau, weight, difference, parts)


def accumulate(stretches, lowpass, *, chunk_bytes, n_jobs=None, numbering=None):
    """Second moments of the filtered equations of recordings.

    Parameters
    ----------
    stretches : list of Stretch
        Recordings.
    lowpass : Lowpass
        What regressors and torques pass.
    chunk_bytes : int
        Size of a piece.
    n_jobs : int or None
        Number of pieces at a time, as in scikit-learn.
    numbering : Numbering, default=None
        Division into blocks of time, where these are not all the recordings.

    Returns
    -------
    JointStatistics or None
        None if all recordings are shorter than the filter.
    """
    numbering = numbering or numbered(stretches, lowpass)
    tasks = [
        (stretch, lowpass, outputs, numbering.parts(stretch.number, outputs))
        for stretch in stretches
        for outputs in pieces(stretch, lowpass, chunk_bytes)
    ]
    total = None
    for stats in run(_piece_statistics, tasks, n_jobs):
        total = stats if total is None else total + stats
    return total


def run(function, tasks, n_jobs):
    """Yield ``function(*task)`` of tasks, in their order.

    Threads, unless a `joblib.parallel_config` says otherwise: nearly all of the time
    is spent in compiled code, and nothing has to be copied. On one BLAS thread each,
    since the matrices are small and sums must not depend on how many there are.
    """
    tasks = iter(tasks)
    with one_blas_thread(), Parallel(n_jobs=n_jobs, prefer="threads") as parallel:
        while batch := list(itertools.islice(tasks, _BATCH)):
            yield from parallel(delayed(function)(*task) for task in batch)


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
