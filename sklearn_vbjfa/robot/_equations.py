"""Equations of motion behind the low-pass, piece by piece and in parallel.

A piece is a run of filtered rows of one recording. It is made from the states of the
rows that its filters see and reduced to second moments where it is made, so that the
regressor matrices are never there as a whole, and pieces can be made at the same time.
The division into pieces depends on neither the number of jobs nor the order in which
they finish, and their sum is taken in the order of the recording: the result is the
same to the last bit on one processor and on many.

Regressor rows of a robot with effects beside its rigid bodies.
"""

import functools
import itertools
from dataclasses import dataclass

import numpy as np
from sklearn.utils.parallel import Parallel, delayed

from sklearn_vbjfa._core._lowpass import BlockFilter, block_length, decimate
from sklearn_vbjfa.effects import Effect, Motion, resolve
from sklearn_vbjfa.effects import _declared as _friction
from sklearn_vbjfa.model._loading import is_prismatic, joint_names
from sklearn_vbjfa.physical._threads import one_blas_thread
from sklearn_vbjfa.robot._features import rounding_entries
from sklearn_vbjfa.robot._joint_moments import Numbering, joint_statistics
from sklearn_vbjfa.robot._joint_torque import filter_weight
from sklearn_vbjfa.robot._states import SplineStates

# Rows of the feature matrix that are in memory at once while loads are computed.
_LOAD_BYTES = 64 << 20
# Fits until the load in the effects' columns agrees with the parameters: the load is
# mostly gravity and inertia, which a first fit without those effects knows well.
_LOAD_PASSES = 3


def check_effects(effects, nv):
    """Return the effects as a tuple of instances, refusing what cannot be."""
    if isinstance(effects, (str, Effect)):
        effects = (effects,)
    found = tuple(resolve([effect])[0] for effect in effects)
    for effect in found:
        effect.check()
        if not 0 <= effect.joint < nv:
            raise ValueError(
                f"effects names joint {effect.joint} for {effect.name}; expected 0 to "
                f"{nv - 1}, for {nv} joint(s)."
            )
    keys = [(effect.key(), tuple(sorted(effect.shape().items()))) for effect in found]
    for key in keys:
        if keys.count(key) > 1:
            raise ValueError(f"effects holds {key[0][0]} on joint {key[0][1]} twice.")
    return found


def needs_load(effects):
    """Whether the columns depend on the parameters, through the load."""
    return any("load" in effect.needs for effect in effects)


def fit_passes(effects):
    """Effects of each fit: what asks for the load comes after a fit without."""
    if not needs_load(effects):
        return [effects]
    plain = tuple(e for e in effects if "load" not in e.needs)
    return [plain] + (_LOAD_PASSES - 1) * [effects]


def effect_names(effects, model):
    """Names and units of the effects' coefficients, two tuples of str."""
    joints, kinds = joint_names(model), is_prismatic(model)
    names, units = [], []
    for effect in effects:
        kind = int(kinds[effect.joint])
        names += [
            f"{joints[effect.joint]}:{effect.name}:{c}" for c in effect.coefficients
        ]
        units += [unit[kind] for unit in effect.units]
    return tuple(names), tuple(units)


def make_motion(features, states, t, parts, theta=None, bandwidth=np.inf, rest=None):
    """Signals that effects are made from.

    Parameters
    ----------
    features : RigidBodyFeatures
        Loaded features.
    states : ndarray of shape (n, 3 * nv)
        States.
    t : ndarray of shape (n,) or None
        Time [s].
    parts : list of slice
        Recordings.
    theta : ndarray of shape (p,) or None
        Parameters of the features, for the load; None for none.
    bandwidth : float
        Cut-off of the low-pass [Hz].
    rest : Rest or None
        What to take for the sign of velocities, see `Motion`.
    """
    nv = features.n_joints_
    load = torque = rigid = None
    if theta is not None:
        parameters = theta.reshape(nv, -1)
        inertial = np.ascontiguousarray(parameters[:, :10])
        tree = features._regressor
        q, v, a = np.split(states, 3, axis=1)
        load = tree.torques(q, v, a, inertial)
        friction = _friction.columns(features._friction, v, a, rest)
        torque = load + np.einsum("njk,jk->nj", friction, parameters[:, 10:])

        def rigid(q, v, a):
            return tree.torques(q, v, a, inertial)

    @functools.cache
    def last_body():
        out = np.empty((states.shape[0], nv, 10))
        for piece in _pieces(features, states.shape[0]):
            Phi = features._compute(states[piece]).reshape(-1, nv, nv, _width(features))
            out[piece] = Phi[:, :, -1, :10]
        return out

    return Motion(
        q=states[:, :nv],
        v=states[:, nv : 2 * nv],
        a=states[:, 2 * nv :],
        t=t,
        load=load,
        torque=torque,
        parts=tuple(parts),
        prismatic=np.asarray(is_prismatic(features._model), dtype=bool),
        rigid=rigid,
        last_body=last_body,
        bandwidth=float(bandwidth),
        rest=rest,
    )


def _width(features):
    return features.n_parameters_ // features.n_joints_


def _pieces(features, n):
    rows = max(1, _LOAD_BYTES // (8 * features.n_joints_ * features.n_parameters_))
    return [slice(i, min(i + rows, n)) for i in range(0, n, rows)]


def _rigid_support(features):
    """Entries of the features that some motion makes, (nv, p), bool."""
    nv = features.n_joints_
    entries = np.zeros((nv, nv, _width(features)), dtype=bool)
    entries[:, :, :10] = features._regressor.carried[:, :, None] & ~features._zeros
    entries[np.arange(nv), np.arange(nv), 10:] = True
    return entries.reshape(nv, -1)


class RegressorRows:
    """Regressor matrices of any stretch of rows, with the effects' columns appended.

    The effects remember (hysteresis, time), so that their columns are made once for
    the whole recordings; the rigid-body regressor is made where it is asked for.

    Parameters
    ----------
    features : RigidBodyFeatures
        Loaded features.
    states : ndarray of shape (n, 3 * nv) or SplineStates
        States.
    effects : tuple of Effect
        Effects.
    motion : Motion or None
        Their signals; None without effects.
    rest : Rest or None
        What to take for the sign of velocities, see `Motion`.

    Attributes
    ----------
    n_joints, n_parameters : int
        Size of a regressor matrix.
    support : ndarray of shape (n_joints, n_parameters), bool
        Entries that are not zero in every motion.
    """

    def __init__(self, features, states, effects=(), motion=None, rest=None):
        self._features = features
        self._states = states
        self._rest = rest
        for effect in effects:
            reason = effect.applies(motion)
            if reason:
                raise ValueError(
                    f"effects holds {effect.name} on joint {effect.joint}: {reason}."
                )
        self._set_columns([(effect, effect.columns(motion)) for effect in effects])

    def _set_columns(self, columns):
        self._columns = columns
        features = self._features
        extra = sum(len(effect.coefficients) for effect, _ in columns)
        self.n_joints = features.n_joints_
        self.n_parameters = features.n_parameters_ + extra
        self.support = np.zeros((self.n_joints, self.n_parameters), dtype=bool)
        self.support[:, : features.n_parameters_] = _rigid_support(features)
        at = features.n_parameters_
        for effect, values in columns:
            stop = at + values.shape[-1]
            joints = slice(None) if effect.whole_robot else effect.joint
            self.support[joints, at:stop] = True
            at = stop

    def part(self, rows):
        """Regressor matrices of one recording alone, numbered from zero."""
        other = object.__new__(RegressorRows)
        other._features, other._states = self._features, self._states[rows]
        other._rest = self._rest
        other._set_columns([(effect, values[rows]) for effect, values in self._columns])
        return other

    def __call__(self, piece):
        """Regressor matrices (n, nv, p) of a slice of rows."""
        Phi = self._features._compute(self._states[piece], self._rest)
        if not self._columns:
            return Phi
        out = np.zeros((*Phi.shape[:2], self.n_parameters))
        at = Phi.shape[2]
        out[:, :, :at] = Phi
        for effect, columns in self._columns:
            stop = at + columns.shape[-1]
            if effect.whole_robot:
                out[:, :, at:stop] = columns[piece]
            else:
                out[:, effect.joint, at:stop] = columns[piece]
            at = stop
        return out


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
