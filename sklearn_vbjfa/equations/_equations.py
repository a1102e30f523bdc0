"""Low-pass filtered equations of motion of a recording, piece by piece."""

import functools
import itertools
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._core._lowpass import BlockFilter, block_length, coarser, stride
from sklearn_vbjfa._core._runtime import counted, one_blas_thread
from sklearn_vbjfa.effects import (
    Bank,
    InModel,
    Motion,
    OnAllJoints,
    came_from,
    declared_columns,
)
from sklearn_vbjfa.equations._joint_moments import (
    BlockAssignment,
    MomentSums,
    joint_entries,
    sum_moments,
)
from sklearn_vbjfa.equations._plan import effect_indices, in_parallel
from sklearn_vbjfa.equations._ranges import SignalRanges, clipped_motions
from sklearn_vbjfa.equations._repetition import find_repetition
from sklearn_vbjfa.model import TorqueDerivatives, is_prismatic, rounding_entries

# Periods of the state cut-off at each end in which the smoother sees one side only.
_EDGE_PERIODS = 1.0
# Rows whose states are evaluated together; blocks of regressor matrices are shorter.
_SPAN_ROWS = 4096
# Rows of a recording from which on bodies' columns are made of as many as they need.
_MANY_ROWS = 50_000
# Memory for filtered rows of the regressor.
CHUNK_BYTES = 4 << 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Equations:
    """Equations of motion, tau = Phi theta, of all joints at some instants."""

    Phi: np.ndarray  # (n, nv, p)
    tau: np.ndarray  # (n, nv) [N m or N]
    weight: np.ndarray  # (n, nv): zero leaves an equation out
    # (n,) or None: row of the recording at the centre of each filtered row
    index: np.ndarray | None = None
    # (n, nv, p) or None: regressors of another measurement of the motion
    instruments: np.ndarray | None = None

    def torques(self, theta):
        """Return the torques (n, nv) of parameters (p,)."""
        return (theta @ self.Phi.transpose(1, 2, 0)).T

    def zeroed(self, entries):
        """Return the same equations with entries (nv, p), bool, set to zero."""
        instruments = self.instruments
        if instruments is not None:
            # Rounding, in the scale of its column, would be an instrument as well.
            instruments = np.where(entries, 0.0, instruments)
        Phi = np.where(entries, 0.0, self.Phi)
        return replace(self, Phi=Phi, instruments=instruments)


# -- regressor matrices ----------------------------------------------------------------


def make_motion(
    features,
    states,
    t,
    parts,
    theta=None,
    bandwidth=np.inf,
    rest=None,
    effects=(),
    since=None,
    signals=None,
    ranges=(),
    command=None,
    before=None,
):
    """Build the `Motion` that effects are computed from."""
    # parts: slices of the segments; theta: parameters (p,) of the features, for the
    # load, and what `pick_load_free` picks, for the whole torque; bandwidth:
    # cut-off of the low-pass [Hz]; rest: velocity signs at rest; since: first time of
    # the fit [s]; ranges: what the motion is held within, see `Plan`; command, before:
    # see `Recording`.
    nv = features.n_joints_
    load = torque = rigid = derivatives = None
    if theta is not None:
        theta, coefs = np.split(theta, [features.n_parameters_])
        parameters = theta.reshape(nv, -1)
        inertial = np.ascontiguousarray(parameters[:, :10])
        q, v, a = np.split(states, 3, axis=1)
        load = features.torques(q, v, a, inertial)
        friction = declared_columns(features.friction_, v, a, rest)
        torque = load + np.einsum("njk,jk->nj", friction, parameters[:, 10:])

        given = q, v, a, inertial, features.nominal_
        derivatives = TorqueDerivatives(features.model_, *given)
        rigid = functools.partial(features.torques, inertial=inertial)

    motion = Motion(
        q=states[:, :nv],
        v=states[:, nv : 2 * nv],
        a=states[:, 2 * nv :],
        t=t,
        load=load,
        torque=torque,
        parts=tuple(parts),
        prismatic=np.asarray(is_prismatic(features.model_), dtype=bool),
        rigid=rigid,
        last_body=functools.cache(lambda: features.last_body(states)),
        derivatives=derivatives,
        bandwidth=float(bandwidth),
        rest=rest,
        since=since,
        signals={} if signals is None else signals,
        command=command,
        before=before,
    )
    if torque is not None and coefs.size:
        # The torque is the motion's own array.
        for effect, held in zip(effects, clipped_motions(effects, ranges, motion)):
            if is_load_free(effect):
                own, coefs = np.split(coefs, [len(effect.coefficients)])
                which = slice(None) if isinstance(effect, OnAllJoints) else effect.joint
                torque[:, which] += effect.columns(held) @ own
    return motion


def is_load_free(effect):
    """Whether an effect needs no load, so that its torque is part of the load's."""
    return "load" not in effect.needs and not isinstance(effect, InModel)


def pick_load_free(effects, coefs):
    widths = np.cumsum([len(effect.coefficients) for effect in effects])
    pieces = np.split(coefs, widths[:-1]) if effects else []
    kept = [own for effect, own in zip(effects, pieces) if is_load_free(effect)]
    return np.concatenate([np.empty(0), *kept])


class RegressorRows:
    """Regressor matrices of any range of rows, with the effects' columns appended."""

    # Effects have memory: their columns are computed once for the whole recording, the
    # rigid-body regressor on demand. states: (n, 3 nv) or `SplineStates`; columns:
    # pairs of effects and their columns; support (n_joints, n_parameters): entries that
    # are nonzero in some motion; used (n_entries,): their places, the features' first.

    def __init__(self, features, states, columns=(), rest=None):
        self._features, self.states, self._rest = features, states, rest
        self.columns = list(columns)
        self._gains = features.gains_ if (features.gains_ != 1).any() else None
        extra = sum(values.shape[-1] for _, values in self.columns)
        self.n_joints = features.n_joints_
        self.n_rigid = features.n_parameters_
        self.n_parameters = features.n_parameters_ + extra
        self.support = np.zeros((self.n_joints, self.n_parameters), dtype=bool)
        self.support[:, : features.n_parameters_] = features.support_
        at = features.n_parameters_
        used = [np.flatnonzero(self.support)]
        for effect, values in self.columns:
            stop = at + values.shape[-1]
            own = np.ix_(effect.acts_on(self.n_joints), np.arange(at, stop))
            self.support[own] = True
            used.append(np.ravel_multi_index(own, self.support.shape).ravel())
            at = stop
        self.used = np.concatenate(used)

    def part(self, rows):
        """Restrict to a slice of rows, renumbered from zero."""
        columns = [(effect, values[rows]) for effect, values in self.columns]
        return RegressorRows(self._features, self.states[rows], columns, self._rest)

    @property
    def n_rows(self):
        return self.states.shape[0]

    def spans(self, rows, length, some=1):
        """Yield where blocks of at most `length` rows begin, and their entries."""
        # Of every so many rows, as which they are counted.
        # States are evaluated, and declared columns made, for many blocks at once. The
        # next block overwrites the entries: their place is in the cache.
        out = np.empty((length, self.used.size))
        span = some * length * max(1, _SPAN_ROWS // (some * length))
        for begin in range(rows.start, rows.stop, span):
            own = self.part(slice(begin, min(begin + span, rows.stop), some))
            declared = self._features.declared(own.states, self._rest)
            for at in range(0, own.n_rows, length):
                block = slice(at, min(at + length, own.n_rows))
                made = own.entries(block, declared[block], out)
                yield (begin - rows.start) // some + at, made

    @property
    def rough(self):
        """Entries that are not smooth, friction and effects: their places (k,)."""
        declared = self._features.declared_places_.ravel()
        return np.r_[declared, self._features.n_entries_ : self.used.size]

    def rough_spans(self, rows, step=1):
        """Yield where blocks of rows begin, and their `rough` entries (n, k)."""
        # Blocks begin at multiples of a step.
        joints = self.used[self.rough] // self.n_parameters
        span = step * max(1, _SPAN_ROWS // step)
        for begin in range(rows.start, rows.stop, span):
            own = self.part(slice(begin, min(begin + span, rows.stop)))
            made = [self._features.declared(own.states, self._rest)]
            made += [values for _, values in own.columns]
            made = [values.reshape(own.n_rows, -1) for values in made]
            yield begin - rows.start, self._read(np.concatenate(made, axis=1), joints)

    @functools.cached_property
    def joints(self):
        return joint_entries(self.support, self.used)

    def __call__(self, piece):
        """Regressor matrices (n, nv, p) of a slice of rows."""
        rows = self.entries(piece)
        out = np.zeros((rows.shape[0], self.support.size))
        out[:, self.used] = rows
        return out.reshape(-1, *self.support.shape)

    def _read(self, values, joints):
        """Multiply derivatives of the torques of joints with the channels' gains."""
        if self._gains is not None:
            values *= self._gains[joints]
        return values

    def entries(self, piece, declared=None, out=None):
        """Entries of the support for a slice of rows, (n, n_entries)."""
        states, at = self.states[piece], self._features.n_entries_
        n = states.shape[0]
        out = np.empty((n, self.used.size)) if out is None else out[:n]
        self._features.entries(states, self._rest, declared, out)
        for _, values in self.columns:
            own = np.asarray(values[piece]).reshape(n, -1)
            out[:, at : at + own.shape[1]] = own
            at += own.shape[1]
        return self._read(out, self.used // self.n_parameters)

    def predict(self, theta, *others):
        """Torques (k, n, nv) by parameters (p,), own and others', without columns."""
        # others: `RegressorRows` of the same motion with other velocity signs.
        bodies, coefs = np.split(theta, [self.n_rigid])
        bodies, kinds = bodies.reshape(self.n_joints, -1), (self, *others)
        found = np.empty((len(kinds), self.states.shape[0], self.n_joints))
        for first in range(0, found.shape[1], _SPAN_ROWS):
            rows = slice(first, min(first + _SPAN_ROWS, found.shape[1]))
            states = self.states[rows]
            motion = np.split(states, 3, axis=1)
            found[:, rows] = self._features.torques(*motion, bodies[:, :10])
            for own, torque in zip(kinds, found[:, rows]):
                friction = self._features.declared(states, own._rest)
                torque += np.einsum("njk,jk->nj", friction, bodies[:, 10:])
                own._add_effects(torque, rows, coefs)
        return self._read(found, np.arange(self.n_joints))

    def effects(self, theta):
        """Torques (n, nv) of the effects alone, before the channels' gains."""
        torque = np.zeros((self.states.shape[0], self.n_joints))
        self._add_effects(torque, slice(None), theta[self.n_rigid :])
        return torque

    def _add_effects(self, torque, rows, coefs):
        at = 0
        for effect, columns in self.columns:
            stop = at + columns.shape[-1]
            which = slice(None) if isinstance(effect, OnAllJoints) else effect.joint
            torque[:, which] += columns[rows] @ coefs[at:stop]
            at = stop


def regressor_rows(
    recording, states, plan, features, *, theta=None, rest=None, cache=None
):
    """Regressor of each segment, with the columns of the plan's effects."""
    # Takes the states of each segment, arrays (n, 3 nv) or `SplineStates`; theta gives
    # the load and the torque, rest the velocity signs at rest; cache: columns that no
    # load changes, to which new ones are added. Returns a list of `RegressorRows`.
    if not plan.effects:
        return [RegressorRows(features, own, rest=rest) for own in states]
    # Effects need all recordings together (time, largest speeds).
    # The samples of a signal are next to each other, as effects take them.
    whole = np.empty((recording.n_samples, 3 * recording.nv), order="F")
    for part, own in zip(recording.segments, states):
        for first in range(part.start, part.stop, _SPAN_ROWS):
            rows = slice(first, min(first + _SPAN_ROWS, part.stop))
            whole[rows] = own[rows.start - part.start : rows.stop - part.start]
    motion = make_motion(
        features,
        whole,
        plan.clock(recording),
        recording.segments,
        theta,
        plan.cutoff,
        rest,
        plan.effects,
        None if plan.time is None else plan.time[0],
        recording.signals,
        plan.ranges,
        recording.command if plan.lag is None else recording.tau,
        came_from(recording.before),
    )
    columns = _effect_columns(plan, motion, {} if cache is None else cache)
    # Splines are a third of the states of all rows, which end here.
    return [
        RegressorRows(features, own, [(e, x[part]) for e, x in columns], rest)
        for part, own in zip(recording.segments, states)
    ]


def _effect_columns(plan, motion, cache):
    """Pair effects with their columns (n, [nv,] k) along a motion."""
    # cache: see `regressor_rows`.
    # Signs of velocities at rest and at turns are another plan's.
    rest = () if motion.rest is None else vars(motion.rest).values()
    found, rest = [], tuple(np.asarray(own, dtype=float).tobytes() for own in rest)
    own_motion = clipped_motions(plan.effects, plan.ranges, motion)
    for effect, own in zip(plan.effects, own_motion):
        shape = (
            motion.q.shape if isinstance(effect, OnAllJoints) else motion.q.shape[:1]
        )
        # The values of effects that are in the model are held by it.
        columns = np.broadcast_to(0.0, (*shape, len(effect.coefficients)))
        if plan.tangents or not isinstance(effect, InModel):
            reason = effect.applies(motion)
            if reason:
                raise ValueError(
                    f"effects holds {effect.name} on joint {effect.joint}: {reason}."
                )
            columns = cache.get((effect, rest))
            if columns is None:
                columns = effect.columns(own)
            if is_load_free(effect):
                cache[effect, rest] = columns
        found.append((effect, columns))
    return found


# -- segments --------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Segment:
    """One contiguous piece of a recording before the low-pass."""

    first: int  # its first row
    states: object  # (n, 3 * nv): for the standstill mask
    # regressor; None takes the mean of the two halves: a quarter of the squared
    # difference is its noise, without which the cross product of the halves is left
    rows: RegressorRows | None
    halves: tuple | None  # regressors from the even and from the odd samples
    # (n, nv): measured, and their weights
    torque: np.ndarray
    weight: np.ndarray
    standstill: np.ndarray  # (nv,): speeds at or below which a joint's rows are masked
    stops: np.ndarray | None  # (nv,): joints that stop where they reverse
    edge: int = 0  # rows at each end that are masked
    every: bool = True  # whether bodies' columns are made of all rows, see `stride`
    # gains (2, nv) by which the torque was made of the positions and their slopes
    feedback: np.ndarray | None = None
    number: int = 0

    @property
    def n_rows(self):
        return self.torque.shape[0]

    def counts(self, rows, v):
        """Return the weights of a slice of rows, zero where the joint is at rest."""
        # v (n, nv): velocities in these rows.
        start, stop, _ = rows.indices(self.n_rows)
        row = np.arange(start, stop)
        inside = (row >= self.edge) & (row < self.n_rows - self.edge)
        moves = (np.abs(v) > self.standstill) & inside[:, None]
        # Sums go through rows of another layout in another order, and are rounded so:
        # the same whether weights take memory or not.
        return np.multiply(self.weight[rows], moves, order="C")

    def filtered_weight(self, lowpass, rows, v):
        """Return the weights of filtered rows, zero where too little of each counts."""
        weight = lowpass.samples(self.counts(rows, v))
        if self.stops is None or not self.stops.any():
            return weight
        # What the low-pass takes of a stop holds friction that is not known.
        moves = np.abs(v) > self.standstill
        return np.where(self.stops, lowpass.certainty(moves), 1.0) * weight

    def pieces(self, lowpass):
        # Neighbouring pieces share input rows over the length of the filter, so none is
        # shorter than twice the filter.
        kinds = (self.rows is not None) + 2 * (self.halves is not None)
        per_output = 8 * kinds * self._made[0].used.size
        # Without a filter no rows are kept.
        most = CHUNK_BYTES // per_output if lowpass.half else _SPAN_ROWS
        count = max(most, 4 * lowpass.half // lowpass.step, 1)
        total = lowpass.centres(self.n_rows).size
        return [slice(i, min(i + count, total)) for i in range(0, total, count)]

    @property
    def _made(self):
        """Regressors that are computed: of all samples, of the halves, or of both."""
        return (() if self.rows is None else (self.rows,)) + (self.halves or ())

    def equations(self, lowpass, entries):
        """Torques, weights and rows of these equations, whose entries are set."""
        # entries (nv * p, n): of the matrices, zeros.
        every, used = slice(None), self._made[0].used
        seen, tau, weight, _ = self._measured(lowpass, every)
        for first, rows, _ in self._filtered(lowpass, seen, every):
            entries[used, first : first + len(rows)] = rows.T
        return tau, weight, self.first + lowpass.centres(self.n_rows)

    @one_blas_thread()
    def moments(self, lowpass, outputs, numbering=None):
        """Return the second moments of these equations, whose matrices are not made."""
        seen, tau, weight, ranges = self._measured(lowpass, outputs)
        sums = MomentSums(
            self._made[0].joints,
            self._made[0].n_parameters,
            tau,
            weight,
            numbering and numbering.parts(self.number, outputs),
            numbering and numbering.recording(self.number),
            noise=self.halves is not None,
            apart=self._apart(lowpass, seen),
        )
        for first, rows, difference in self._filtered(lowpass, seen, outputs):
            sums.add(first, rows, difference)
        return replace(sums.moments(), ranges=ranges)

    def _measured(self, lowpass, outputs):
        """Return the rows seen, and torque, weight and ranges of filtered rows."""
        chosen = lowpass.centres(self.n_rows, outputs)
        seen = slice(int(chosen[0]) - lowpass.half, int(chosen[-1]) + lowpass.half + 1)
        q, v = (derivative(self.states, seen, order) for order in range(2))
        weight = self.filtered_weight(lowpass, seen, v)
        signals = lowpass(np.stack([self.torque[seen], q, v], axis=1))
        tau, q, v = (np.ascontiguousarray(signals[:, k]) for k in range(3))
        ways = np.sign(v) * (np.abs(v) > self.standstill)
        ranges = SignalRanges.of([q, np.abs(v), ways], weight > 0)
        return seen, tau, weight, ranges

    def _apart(self, lowpass, seen):
        """Torque that a drive made of the even samples minus that of the odd ones."""
        if self.halves is None or self.feedback is None:
            return None
        even, odd = (
            [derivative(rows.states, seen, k) for k in range(2)] for rows in self.halves
        )
        apart = sum(
            gain * (one - other) for gain, one, other in zip(self.feedback, even, odd)
        )
        return -lowpass(np.ascontiguousarray(apart))

    def _filtered(self, lowpass, seen, outputs):
        # Entries (n, n_entries) may be overwritten by the next ones.
        count = lowpass.centres(self.n_rows, outputs).size
        some = 1 if self.every else stride(lowpass)
        for first, made in _filter_rows(self._made, seen, lowpass, count, some):
            if self.halves is None:
                yield first, made[0], None
                continue
            even, odd = made[-2:]
            mean = 0.5 * (even + odd) if self.rows is None else made[0]
            yield first, mean, even - odd

    def loads(self, lowpass, torques):
        # torques: (q, v, a) -> torques (n, nv) of the rigid bodies. The states are
        # filtered before, which is the same for motion in the band of the filter.
        rows, made = slice(0, self.n_rows), []
        for order in range(3):
            signals = np.ascontiguousarray(derivative(self.states, rows, order))
            if order == 1:
                weight = self.filtered_weight(lowpass, rows, signals)
            made.append(lowpass(signals))
        return SignalRanges.of([torques(*made)], weight > 0)


def derivative(states, rows, order):
    """Positions, velocities or accelerations (n, nv) of a slice of rows."""
    if not isinstance(states, np.ndarray):
        return states.derivative(rows, order)
    nv = states.shape[1] // 3
    return states[rows, order * nv : (order + 1) * nv]


def _filter_rows(made, seen, lowpass, count, some=1):
    """Yield the first of some filtered rows, and each regressor's (n, n_entries)."""
    # Of every so many rows, but for what is not smooth.
    smooth, coarse = seen, coarser(lowpass, some)
    if some > 1:
        smooth = slice(seen.start + lowpass.half % some, seen.stop)
    length = block_length(coarse, 8 * made[0].used.size)
    if lowpass.half == 0 and lowpass.step == 1:
        # Nothing is added up, and nothing has to be kept.
        for several in zip(*[rows.spans(seen, length) for rows in made]):
            yield several[0][0], [entries for _, entries in several]
        return
    filters = [BlockFilter(coarse, count, rows.used.size) for rows in made]
    for into, rows in zip(filters, made):
        for at, entries in rows.spans(smooth, length, some):
            into.add(at, entries)
        if some > 1:
            places = rows.rough
            rough = BlockFilter(lowpass, count, places.size)
            for at, entries in rows.rough_spans(seen, lowpass.step):
                rough.add(at, entries)
            into.outputs[:, places] = rough.outputs
    yield 0, [into.outputs for into in filters]


def edge_rows(n, state_estimator, most=0.05):
    """Return the number of rows at each end of n where the smoother is one-sided."""
    # Zero for given states (no estimator); most: share of a short recording.
    if state_estimator is None:
        return 0
    slowest = state_estimator.cutoff_.min()
    if not np.isfinite(slowest):
        return 0
    return min(int(_EDGE_PERIODS / (slowest * state_estimator.dt)), int(most * n))


def build_segments(
    recording, states, plan, features, *, theta=None, rest=None, first=0, cache=None
):
    """Combine a recording with its regressor, segment by segment."""
    # states: `RecordingStates`, with halves where the regressor's noise is measured;
    # theta: parameters for the load in effects' columns; rest: velocity signs at rest,
    # for comparisons only; first: number of the first segment; cache: see
    # `regressor_rows`. Returns a list of `Segment`.
    rest, cache = plan.turning if rest is None else rest, {} if cache is None else cache

    def rows_of(own, number=0):
        known = {"theta": theta, "rest": rest, "cache": cache.setdefault(number, {})}
        return regressor_rows(recording, own, plan, features, **known)

    applied, parts = plan.applied(recording), recording.segments
    average = states.halves is not None and plan.corrects_noise
    rows = len(parts) * [None] if average else rows_of(states.own)
    halves = len(parts) * [None]
    if states.halves is not None:
        halves = list(zip(*[rows_of(x, 1 + k) for k, x in enumerate(states.halves)]))
    weight = applied.weight
    if weight is None:
        weight = np.broadcast_to(1.0, applied.tau.shape)
    return [
        Segment(
            first=part.start,
            states=states.own[i],
            rows=rows[i],
            halves=halves[i],
            torque=applied.tau[part],
            weight=weight[part],
            standstill=plan.masked,
            stops=plan.stops,
            edge=edge_rows(part.stop - part.start, plan.state_estimator),
            every=recording.n_samples <= _MANY_ROWS,
            feedback=recording.feedback,
            number=first + i,
        )
        for i, part in enumerate(parts)
    ]


# -- passes over segments --------------------------------------------------------------


def assign_blocks(recording, plan):
    """Divide filtered rows into blocks of time, or of phases, see `BlockAssignment`."""
    sizes = [part.stop - part.start for part in recording.segments]
    centres = [plan.lowpass.centres(n) for n in sizes]
    lengths, clock = [own.size for own in centres], recording.clock
    if clock is None or not sum(lengths):
        return BlockAssignment.of(lengths)
    repetition = find_repetition(recording.q, clock, recording.segments)
    if not repetition:
        return BlockAssignment.of(lengths)
    number = np.repeat(np.arange(len(lengths)), lengths)
    t = repetition.begins[number] + plan.dt * np.concatenate(centres)
    motion, phase = repetition.phase(number, t)
    return BlockAssignment.of(lengths, (motion, phase / (plan.dt * plan.lowpass.step)))


def equations(made, lowpass):
    """Return the `Equations` of segments that are as long as the filter."""
    made = [one for one in made if lowpass.centres(one.n_rows).size]
    edges = np.cumsum([0, *(lowpass.centres(one.n_rows).size for one in made)])
    # Columns one after another: of many joints most are zero, and take no memory.
    shape = made[0]._made[0].support.shape
    entries = np.zeros((shape[0] * shape[1], edges[-1]))
    found = [
        one.equations(lowpass, entries[:, first:last])
        for one, (first, last) in zip(made, itertools.pairwise(edges))
    ]
    tau, weight, index = map(np.concatenate, zip(*found))
    Phi = entries.reshape(*shape, -1).transpose(2, 0, 1)
    return Equations(Phi=Phi, tau=tau, weight=weight, index=index)


def accumulate(made, lowpass, *, n_jobs=None, numbering=None):
    """Second moments (`JointMoments`) of the filtered equations of segments."""
    # None if every segment is shorter than the filter.
    tasks = [
        (segment, lowpass, outputs, numbering)
        for segment in made
        for outputs in segment.pieces(lowpass)
    ]
    done = in_parallel(Segment.moments, tasks, n_jobs)
    return sum_moments(counted(done, "equations", len(tasks)))


def excluded_columns(features, effects):
    """Numbers of parameters whose column an effect of their joint has already."""
    # Plain terms, and columns of further effects: of the same columns the data would
    # know the sum alone, and none of them.
    per_joint = features.n_parameters_ // features.n_joints_
    plain = {name: 10 + k for k, name in enumerate(features.friction_)}
    found, taken = [], set()
    # A constant over two joints takes the offset of the one that is left.
    places = effect_indices(effects, features.n_parameters_)
    for effect, at in sorted(places, key=lambda place: len(place[0].joints)):
        if effect.constant:
            joint = next((j for j in effect.joints if j not in taken), None)
            if joint is None:
                found.append(at.start + effect.coefficients.index(effect.constant))
            elif "offset" in plain:
                found.append(joint * per_joint + plain["offset"])
            taken.add(joint)
        if isinstance(effect, Bank) and "coulomb" in plain:
            found.append(effect.joint * per_joint + plain["coulomb"])
    return found


def unexcited_entries(moments, n_rigid):
    """Find entries (nv, p), bool, of the regressor that are zero up to rounding."""
    # A joint that does not move in this recording adds to the entries that are zero in
    # every motion. Only the first `n_rigid` parameters are examined.
    nv, n_all = moments.g.shape
    power, rounding = np.zeros((nv, n_all)), np.zeros((nv, n_all), dtype=bool)
    for row, (at, one) in zip(power, moments.G):
        row[at] = one.diagonal()
    rigid = rounding_entries(power[:, :n_rigid].reshape(nv, nv, -1))
    rounding[:, :n_rigid] = rigid.reshape(nv, -1)
    return rounding


@dataclass(frozen=True, kw_only=True)
class TorqueResiduals:
    """Measured and predicted torques after the same low-pass, with weights.

    Attributes
    ----------
    index : ndarray of shape (m,)
        Row of the recording at the centre of each filtered sample.
    torque : ndarray of shape (m, nv)
        Filtered measured torques [N m or N].
    predicted : ndarray of shape (m, nv)
        Torques of the model, from filtered regressor columns [N m or N]. Where the
        weight is zero, dry friction has its mean, see `RobotIdentifier.predict`.
    weight : ndarray of shape (m, nv)
        Zero where a joint is at rest or the sample was left out.
    """

    index: np.ndarray
    torque: np.ndarray
    predicted: np.ndarray
    weight: np.ndarray

    @property
    def residual(self):
        """Measured minus predicted torque [N m or N], ndarray of shape (m, nv)."""
        return self.torque - self.predicted

    def rms(self):
        """Root mean square of the residual of each joint [N m or N]."""
        return _weighted(self.residual**2, self.weight) ** 0.5

    def relative_error(self, spread):
        """Root mean square over a torque spread (nv,); nan where there is none."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(spread > 0, self.rms() / spread, np.nan)

    def normalised_error(self):
        """Root mean square over the standard deviation of the torque, (nv,)."""
        return self.relative_error(torque_spread(self))


def torque_spread(*parts):
    """Return the weighted standard deviation of the torque over all parts, (nv,)."""
    # The parts are `TorqueResiduals` of one recording after the same low-pass.
    torque = np.concatenate([part.torque for part in parts])
    weight = np.concatenate([part.weight for part in parts])
    mean = _weighted(torque, weight)
    return _weighted((torque - mean) ** 2, weight) ** 0.5


def compare(segments, others, lowpass, theta):
    """Low-pass filtered residuals of `Segment` by parameters (p,); None: torques."""
    # others: the same segments with the velocity signs of rows without weight. Torques
    # are predicted before the low-pass, which is linear: a filter of one column of each
    # joint instead of all columns of the regressor.
    found, every = [], slice(None)
    for own, other in zip(segments, others):
        torque = predicted = lowpass(np.asarray(own.torque))
        v = derivative(own.states, every, 1)
        weight = own.filtered_weight(lowpass, every, v)
        rows = own.first + lowpass.centres(own.n_rows)
        if theta is not None:
            both = map(lowpass, own.rows.predict(theta, other.rows))
            predicted = np.where(weight > 0, *both)
        found.append((rows, torque, predicted, weight))
    index, torque, predicted, weight = (np.concatenate(x) for x in zip(*found))
    return TorqueResiduals(
        index=index, torque=torque, predicted=predicted, weight=weight
    )


def _weighted(values, weight):
    total = weight.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(total > 0, (values * weight).sum(axis=0) / total, np.nan)
