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
    declared_columns,
    earlier_reversals,
)
from sklearn_vbjfa.equations._features import body_torques
from sklearn_vbjfa.equations._joint_moments import (
    BlockAssignment,
    MomentSums,
    joint_entries,
    sum_moments,
)
from sklearn_vbjfa.equations._motion_facts import in_parallel
from sklearn_vbjfa.equations._plan import effect_indices
from sklearn_vbjfa.equations._ranges import SignalRanges, clipped_motions
from sklearn_vbjfa.equations._repetition import find_repetition
from sklearn_vbjfa.model import (
    TorqueDerivatives,
    end_joints,
    is_prismatic,
    rounding_entries,
)

# Periods of the state cut-off at each end in which the smoother is one-sided.
_EDGE_PERIODS = 1.0
# Rows whose states are evaluated together; blocks of regressor matrices are shorter.
_SPAN_ROWS = 4096
# Longer recordings compute the rigid-body columns at the rate that the filter needs.
_MANY_ROWS = 50_000
# Memory for the filtered rows of the regressor [bytes].
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
        """Return the equations with regressor entries (nv, p), bool, set to zero."""
        instruments = self.instruments
        if instruments is not None:
            # Scaled by its column, rounding would act as an instrument.
            instruments = np.where(entries, 0.0, instruments)
        Phi = np.where(entries, 0.0, self.Phi)
        return replace(self, Phi=Phi, instruments=instruments)


# -- regressor matrices ----------------------------------------------------------------


def make_motion(
    features, states, parts, *, theta=None, effects=(), ranges=(), rest=None, **fields
):
    """Build the `Motion` that effects are computed from."""
    # parts: slices of the segments; theta: parameters (p,) of the features, and then
    # `pick_load_free` of the effects, beginning with followers; ranges: limits of the
    # motion, see `Plan`; rest: velocity signs at rest; fields: others of `Motion`.
    nv, (q, v, a) = features.n_joints_, np.split(states, 3, axis=1)
    load = torque = rigid = derivatives = None
    if theta is not None:
        theta, coefs = np.split(theta, [features.n_parameters_])
        following, coefs = np.split(coefs, [10 * sum(x.loads for x in effects)])
        parameters = theta.reshape(nv, -1)
        inertial = np.ascontiguousarray(parameters[:, :10])
        bodies = np.vstack([inertial, following.reshape(-1, 10)])
        rigid = functools.partial(body_torques, features, effects, bodies)
        load = rigid(q, v, a)
        friction = declared_columns(features.friction_, v, a, rest)
        torque = load + np.einsum("njk,jk->nj", friction, parameters[:, 10:])

        arguments = q, v, a, inertial, features.nominal_
        derivatives = TorqueDerivatives(features.model_, *arguments)

    motion = Motion(
        q=q,
        v=v,
        a=a,
        load=load,
        torque=torque,
        parts=tuple(parts),
        prismatic=np.asarray(is_prismatic(features.model_), dtype=bool),
        rigid=rigid,
        end_bodies={
            j: functools.cache(functools.partial(features.body, states, j))
            for j in end_joints(features.model_)
        },
        derivatives=derivatives,
        rest=rest,
        **fields,
    )
    if torque is not None and coefs.size:
        # `torque` is the array of the motion, changed in place.
        for effect, clipped in zip(effects, clipped_motions(effects, ranges, motion)):
            if is_load_free(effect) and not effect.loads:
                coefficients, coefs = np.split(coefs, [len(effect.coefficients)])
                cols = slice(None) if isinstance(effect, OnAllJoints) else effect.joint
                torque[:, cols] += effect.columns(clipped) @ coefficients
    return motion


def is_load_free(effect):
    """Return True if an effect needs no load: its torque is part of `Motion.torque`."""
    return "load" not in effect.needs and not isinstance(effect, InModel)


def pick_load_free(effects, coefs):
    widths = np.cumsum([len(effect.coefficients) for effect in effects])
    pieces = np.split(coefs, widths[:-1]) if effects else []
    selected = [x for effect, x in zip(effects, pieces) if is_load_free(effect)]
    return np.concatenate([np.empty(0), *selected])


class RegressorRows:
    """Regressor matrices of a range of rows, with the effects' columns appended."""

    # Effects have memory: their columns are computed once for the whole recording, the
    # rigid-body regressor on demand. states: (n, 3 nv) or `SplineStates`; columns:
    # pairs of effects and their columns; support (n_joints, n_parameters): entries that
    # are nonzero in some motion; used (n_entries,): their flat indices, features first.

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
        start = features.n_parameters_
        used = [np.flatnonzero(self.support)]
        for effect, values in self.columns:
            stop = start + values.shape[-1]
            entries = np.ix_(effect.acts_on(self.n_joints), np.arange(start, stop))
            self.support[entries] = True
            used.append(np.ravel_multi_index(entries, self.support.shape).ravel())
            start = stop
        self.used = np.concatenate(used)

    def part(self, rows):
        """Restrict to a slice of rows, renumbered from zero."""
        columns = [(effect, values[rows]) for effect, values in self.columns]
        return RegressorRows(self._features, self.states[rows], columns, self._rest)

    @property
    def n_rows(self):
        return self.states.shape[0]

    def spans(self, rows, length, step=1):
        """Yield the first row and the entries of blocks of at most `length` rows."""
        # Only every `step`-th row is computed and counted. States and declared columns
        # are evaluated for many blocks at once. Each block overwrites the entries of
        # the previous one, so that they stay in the processor's cache.
        out = np.empty((length, self.used.size))
        span = step * length * max(1, _SPAN_ROWS // (step * length))
        for begin in range(rows.start, rows.stop, span):
            part = self.part(slice(begin, min(begin + span, rows.stop), step))
            declared = self._features.declared(part.states, self._rest)
            for start in range(0, part.n_rows, length):
                block = slice(start, min(start + length, part.n_rows))
                entries = part.entries(block, declared[block], out)
                yield (begin - rows.start) // step + start, entries

    @property
    def nonsmooth(self):
        """Indices (k,) of the entries of friction and effects, which may jump."""
        declared = self._features.declared_indices_.ravel()
        return np.r_[declared, self._features.n_entries_ : self.used.size]

    def nonsmooth_spans(self, rows, step):
        """Yield the first row and the `nonsmooth` entries (n, k) of blocks of rows."""
        # Blocks begin at multiples of `step`.
        joints = self.used[self.nonsmooth] // self.n_parameters
        span = step * max(1, _SPAN_ROWS // step)
        for begin in range(rows.start, rows.stop, span):
            part = self.part(slice(begin, min(begin + span, rows.stop)))
            cols = [self._features.declared(part.states, self._rest)]
            cols += [values for _, values in part.columns]
            cols = [values.reshape(part.n_rows, -1) for values in cols]
            yield begin - rows.start, self._scale(np.concatenate(cols, axis=1), joints)

    @functools.cached_property
    def joints(self):
        return joint_entries(self.support, self.used)

    def __call__(self, piece):
        """Regressor matrices (n, nv, p) of a slice of rows."""
        rows = self.entries(piece)
        out = np.zeros((rows.shape[0], self.support.size))
        out[:, self.used] = rows
        return out.reshape(-1, *self.support.shape)

    def _scale(self, values, joints):
        """Multiply derivatives of joint torques by the gains of their channels."""
        if self._gains is not None:
            values *= self._gains[joints]
        return values

    def entries(self, piece, declared=None, out=None):
        """Entries of the support for a slice of rows, (n, n_entries)."""
        states, start = self.states[piece], self._features.n_entries_
        n = states.shape[0]
        out = np.empty((n, self.used.size)) if out is None else out[:n]
        self._features.entries(states, self._rest, declared, out)
        for _, values in self.columns:
            columns = np.asarray(values[piece]).reshape(n, -1)
            out[:, start : start + columns.shape[1]] = columns
            start += columns.shape[1]
        return self._scale(out, self.used // self.n_parameters)

    def predict(self, theta, *others):
        """Predict torques (k, n, nv) of self and others without regressor matrices."""
        # theta (p,); others: `RegressorRows` of the same motion, other velocity signs.
        bodies, coefs = np.split(theta, [self.n_rigid])
        bodies, regressors = bodies.reshape(self.n_joints, -1), (self, *others)
        predicted = np.empty((len(regressors), self.states.shape[0], self.n_joints))
        for first in range(0, predicted.shape[1], _SPAN_ROWS):
            rows = slice(first, min(first + _SPAN_ROWS, predicted.shape[1]))
            states = self.states[rows]
            motion = np.split(states, 3, axis=1)
            predicted[:, rows] = self._features.torques(*motion, bodies[:, :10])
            for regressor, torque in zip(regressors, predicted[:, rows]):
                friction = self._features.declared(states, regressor._rest)
                torque += np.einsum("njk,jk->nj", friction, bodies[:, 10:])
                regressor._add_effects(torque, rows, coefs)
        return self._scale(predicted, np.arange(self.n_joints))

    def effects(self, theta):
        """Torques (n, nv) of the effects alone, before the channels' gains."""
        torque = np.zeros((self.states.shape[0], self.n_joints))
        self._add_effects(torque, slice(None), theta[self.n_rigid :])
        return torque

    def _add_effects(self, torque, rows, coefs):
        start = 0
        for effect, columns in self.columns:
            stop = start + columns.shape[-1]
            joints = slice(None) if isinstance(effect, OnAllJoints) else effect.joint
            torque[:, joints] += columns[rows] @ coefs[start:stop]
            start = stop


def regressor_rows(
    recording, states, plan, features, theta=None, rest=None, *, cache=None
):
    """Return the `RegressorRows` of each segment, with the columns of all effects."""
    # states: of each segment, (n, 3 nv) or `SplineStates`; theta: for load and torque;
    # rest: velocity signs at rest; cache: columns of effects without load, filled here.
    if not plan.effects:
        return [RegressorRows(features, X, rest=rest) for X in states]
    # Effects need all recordings together (time, largest speeds). In Fortran order the
    # samples of a signal are contiguous, as effects read them.
    whole = np.empty((recording.n_samples, 3 * recording.nv), order="F")
    for part, X in zip(recording.segments, states):
        for first in range(part.start, part.stop, _SPAN_ROWS):
            rows = slice(first, min(first + _SPAN_ROWS, part.stop))
            whole[rows] = X[rows.start - part.start : rows.stop - part.start]
    motion = make_motion(
        features,
        whole,
        recording.segments,
        theta=theta,
        effects=plan.effects,
        ranges=plan.ranges,
        rest=rest,
        t=plan.clock(recording),
        bandwidth=plan.cutoff,
        since=None if plan.time is None else plan.time[0],
        signals=recording.signals,
        command=recording.command if plan.lag is None else recording.tau,
        before=earlier_reversals(recording.before),
    )
    columns = _effect_columns(plan, motion, {} if cache is None else cache)
    # Keep the splines, which need a third of the memory of `whole`.
    return [
        RegressorRows(features, X, [(e, x[part]) for e, x in columns], rest)
        for part, X in zip(recording.segments, states)
    ]


def _effect_columns(plan, motion, cache):
    """Pair effects with their columns (n, [nv,] k) along a motion."""
    # cache: see `regressor_rows`. Columns depend on the velocity signs at rest.
    rest = () if motion.rest is None else vars(motion.rest).values()
    pairs, rest = [], tuple(np.asarray(x, dtype=float).tobytes() for x in rest)
    motions = clipped_motions(plan.effects, plan.ranges, motion)
    for effect, clipped in zip(plan.effects, motions):
        shape = (
            motion.q.shape if isinstance(effect, OnAllJoints) else motion.q.shape[:1]
        )
        # Effects in the model act through it: their columns are zero without tangents.
        columns = np.broadcast_to(0.0, (*shape, len(effect.coefficients)))
        if plan.tangents or not isinstance(effect, InModel):
            reason = effect.applies(motion)
            if reason:
                raise ValueError(
                    f"effects holds {effect.name} on joint {effect.joint}: {reason}."
                )
            columns = cache.get((effect, rest))
            if columns is None:
                columns = effect.columns(clipped)
            if is_load_free(effect):
                cache[effect, rest] = columns
        pairs.append((effect, columns))
    return pairs


# -- segments --------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Segment:
    """One contiguous piece of a recording before the low-pass."""

    first: int  # its first row
    states: object  # (n, 3 * nv): for the standstill mask
    # None takes the mean of the two halves: a quarter of their squared difference
    # estimates its noise, and subtracting it leaves their cross product
    regressor: RegressorRows | None
    halves: tuple | None  # regressors from the even and from the odd samples
    # (n, nv): measured, and their weights
    torque: np.ndarray
    weight: np.ndarray
    standstill: np.ndarray  # (nv,): speeds at or below which a joint's rows are masked
    stops: np.ndarray | None  # (nv,): joints that stop where they reverse
    edge: int = 0  # rows at each end that are masked
    full_rate: bool = True  # whether bodies' columns use all rows, see `stride`
    # gains (2, nv) of the positions and velocities in a torque that a drive computes
    feedback: np.ndarray | None = None
    number: int = 0

    @property
    def n_rows(self):
        return self.torque.shape[0]

    def moving_weight(self, rows, v):
        """Return the weights of a slice of rows, zero where the joint is at rest."""
        # v (n, nv): velocities in these rows.
        start, stop, _ = rows.indices(self.n_rows)
        row = np.arange(start, stop)
        inside = (row >= self.edge) & (row < self.n_rows - self.edge)
        moves = (np.abs(v) > self.standstill) & inside[:, None]
        # The rounding of sums depends on the memory layout: C order gives the same
        # result for broadcast weights as for allocated ones.
        return np.multiply(self.weight[rows], moves, order="C")

    def filtered_weight(self, lowpass, rows, v):
        """Return the weights of filtered rows, zero if too few samples count."""
        weight = lowpass.samples(self.moving_weight(rows, v))
        if self.stops is None or not self.stops.any():
            return weight
        # A filter window that includes a stop contains unknown friction.
        moves = np.abs(v) > self.standstill
        return np.where(self.stops, lowpass.certainty(moves), 1.0) * weight

    def pieces(self, lowpass):
        # Neighbouring pieces share input rows over the filter length, so that none is
        # shorter than twice the filter.
        regressors = self._regressors
        per_output = 8 * len(regressors) * regressors[0].used.size
        # Without a filter no rows are kept.
        limit = CHUNK_BYTES // per_output if lowpass.half else _SPAN_ROWS
        count = max(limit, 4 * lowpass.half // lowpass.step, 1)
        n_outputs = lowpass.centres(self.n_rows).size
        return [slice(i, min(i + count, n_outputs)) for i in range(0, n_outputs, count)]

    @property
    def _regressors(self):
        """Regressors to compute: of all samples, of the halves, or of both."""
        return tuple(filter(None, (self.regressor, *(self.halves or ()))))

    def equations(self, lowpass, entries):
        """Fill in the regressor entries; return torques, weights and rows."""
        # entries (nv * p, n): zeros, where the nonzero ones are written.
        every, used = slice(None), self._regressors[0].used
        window, tau, weight, _ = self._measured(lowpass, every)
        for first, rows, _ in self._filtered(lowpass, window, every):
            entries[used, first : first + len(rows)] = rows.T
        return tau, weight, self.first + lowpass.centres(self.n_rows)

    @one_blas_thread()
    def moments(self, lowpass, outputs, blocks=None):
        """Return second moments of the equations without storing regressor matrices."""
        window, tau, weight, ranges = self._measured(lowpass, outputs)
        sums = MomentSums(
            self._regressors[0].joints,
            self._regressors[0].n_parameters,
            tau,
            weight,
            blocks and blocks.parts(self.number, outputs),
            blocks and blocks.recording(self.number),
            noise=self.halves is not None,
            drive_noise=self._drive_noise(lowpass, window),
        )
        for first, rows, difference in self._filtered(lowpass, window, outputs):
            sums.add(first, rows, difference)
        return replace(sums.moments(), ranges=ranges)

    def _measured(self, lowpass, outputs):
        """Return the input rows, and torque, weight and ranges of the filtered rows."""
        rows = lowpass.centres(self.n_rows, outputs)
        span = slice(int(rows[0]) - lowpass.half, int(rows[-1]) + lowpass.half + 1)
        q, v = (derivative(self.states, span, order) for order in range(2))
        weight = self.filtered_weight(lowpass, span, v)
        signals = lowpass(np.stack([self.torque[span], q, v], axis=1))
        tau, q, v = (np.ascontiguousarray(signals[:, k]) for k in range(3))
        directions = np.sign(v) * (np.abs(v) > self.standstill)
        ranges = SignalRanges.of([q, np.abs(v), directions], weight > 0)
        return span, tau, weight, ranges

    def _drive_noise(self, lowpass, span):
        """Torque of a drive from the even samples minus that from the odd samples."""
        if self.halves is None or self.feedback is None:
            return None
        even, odd = (
            [derivative(rows.states, span, k) for k in range(2)] for rows in self.halves
        )
        difference = sum(gain * (x - y) for gain, x, y in zip(self.feedback, even, odd))
        return -lowpass(np.ascontiguousarray(difference))

    def _filtered(self, lowpass, span, outputs):
        # The next iteration may overwrite the entries (n, n_entries).
        count = lowpass.centres(self.n_rows, outputs).size
        step = 1 if self.full_rate else stride(lowpass)
        for first, rows in _filter_rows(self._regressors, span, lowpass, count, step):
            if self.halves is None:
                yield first, rows[0], None
                continue
            even, odd = rows[-2:]
            mean = 0.5 * (even + odd) if self.regressor is None else rows[0]
            yield first, mean, even - odd

    def loads(self, lowpass, torques):
        # torques: (q, v, a) -> rigid-body torques (n, nv). Filtering the states instead
        # of the torques is equivalent for motion within the band of the filter.
        rows, filtered = slice(0, self.n_rows), []
        for order in range(3):
            signals = np.ascontiguousarray(derivative(self.states, rows, order))
            if order == 1:
                weight = self.filtered_weight(lowpass, rows, signals)
            filtered.append(lowpass(signals))
        return SignalRanges.of([torques(*filtered)], weight > 0)


def derivative(states, rows, order):
    """Positions, velocities or accelerations (n, nv) of a slice of rows."""
    if not isinstance(states, np.ndarray):
        return states.derivative(rows, order)
    nv = states.shape[1] // 3
    return states[rows, order * nv : (order + 1) * nv]


def _filter_rows(regressors, span, lowpass, count, step):
    """Yield the first filtered row, and the entries (n, n_entries) by regressor."""
    # Smooth entries use every `step`-th row only.
    smooth_span, coarse = span, coarser(lowpass, step)
    if step > 1:
        smooth_span = slice(span.start + lowpass.half % step, span.stop)
    length = block_length(coarse, 8 * regressors[0].used.size)
    if lowpass.half == 0 and lowpass.step == 1:
        # Without a filter no sums have to be kept.
        for spans in zip(*[x.spans(span, length) for x in regressors]):
            yield spans[0][0], [entries for _, entries in spans]
        return
    filters = [BlockFilter(coarse, count, x.used.size) for x in regressors]
    for output, regressor in zip(filters, regressors):
        for at, entries in regressor.spans(smooth_span, length, step):
            output.add(at, entries)
        if step > 1:
            nonsmooth = regressor.nonsmooth
            block_filter = BlockFilter(lowpass, count, nonsmooth.size)
            for at, entries in regressor.nonsmooth_spans(span, lowpass.step):
                block_filter.add(at, entries)
            output.outputs[:, nonsmooth] = block_filter.outputs
    yield 0, [output.outputs for output in filters]


def edge_rows(n, state_estimator, max_share=0.05):
    """Return the number of rows at each end of n where the smoother is one-sided."""
    # Zero without an estimator; max_share: largest share of a short recording.
    if state_estimator is None:
        return 0
    slowest = state_estimator.cutoff_.min()
    return min(int(_EDGE_PERIODS / (slowest * state_estimator.dt)), int(max_share * n))


def build_segments(
    recording, states, plan, features, *, theta=None, rest=None, first=0, cache=None
):
    """Combine a recording with its regressor, segment by segment."""
    # states: `RecordingStates`, with halves if the noise of the regressor is measured;
    # theta: parameters for the load in effects' columns; rest: velocity signs at rest,
    # for comparisons only; first: number of the first segment; cache: see
    # `regressor_rows`. Returns a list of `Segment`.
    rest, cache = (
        plan.fit_rest if rest is None else rest,
        {} if cache is None else cache,
    )

    def regressors_of(X, number=0):
        keywords = {"theta": theta, "rest": rest, "cache": cache.setdefault(number, {})}
        return regressor_rows(recording, X, plan, features, **keywords)

    prepared, parts = plan.with_delays(recording), recording.segments
    average = states.halves is not None and plan.corrects_noise
    regressors = halves = len(parts) * [None]
    if not average:
        regressors = regressors_of(states.full)
    if states.halves is not None:
        both = (regressors_of(x, 1 + k) for k, x in enumerate(states.halves))
        halves = list(zip(*both))
    weight = prepared.weight
    if weight is None:
        weight = np.broadcast_to(1.0, prepared.tau.shape)
    return [
        Segment(
            first=part.start,
            states=states.full[i],
            regressor=regressors[i],
            halves=halves[i],
            torque=prepared.tau[part],
            weight=weight[part],
            standstill=plan.mask_speeds,
            stops=plan.stops,
            edge=edge_rows(part.stop - part.start, plan.state_estimator),
            full_rate=recording.n_samples <= _MANY_ROWS,
            feedback=recording.feedback,
            number=first + i,
        )
        for i, part in enumerate(parts)
    ]


# -- passes over segments --------------------------------------------------------------


def assign_blocks(recording, plan):
    """Assign filtered rows to blocks of time, or of phase if the motion repeats."""
    sizes = [part.stop - part.start for part in recording.segments]
    centres = [plan.lowpass.centres(n) for n in sizes]
    lengths, clock = [x.size for x in centres], recording.clock
    known = clock is not None and sum(lengths)
    repetition = known and find_repetition(recording.q, clock, recording.segments)
    if not repetition:
        return BlockAssignment.of(lengths)
    number = np.repeat(np.arange(len(lengths)), lengths)
    t = repetition.begins[number] + plan.dt * np.concatenate(centres)
    motion, phase = repetition.phase(number, t)
    return BlockAssignment.of(lengths, (motion, phase / (plan.dt * plan.lowpass.step)))


def equations(segments, lowpass):
    """Return the `Equations` of the segments that are as long as the filter."""
    segments = [x for x in segments if lowpass.centres(x.n_rows).size]
    edges = np.cumsum([0, *(lowpass.centres(x.n_rows).size for x in segments)])
    # Parameters first: with many joints most entries are zero, and take no memory.
    shape = segments[0]._regressors[0].support.shape
    entries = np.zeros((shape[0] * shape[1], edges[-1]))
    results = [
        segment.equations(lowpass, entries[:, first:last])
        for segment, (first, last) in zip(segments, itertools.pairwise(edges))
    ]
    tau, weight, index = map(np.concatenate, zip(*results))
    Phi = entries.reshape(*shape, -1).transpose(2, 0, 1)
    return Equations(Phi=Phi, tau=tau, weight=weight, index=index)


def accumulate(segments, lowpass, *, n_jobs=None, blocks=None):
    """Sum the second moments (`JointMoments`) of the segments' filtered equations."""
    # None if every segment is shorter than the filter.
    tasks = [
        (segment, lowpass, outputs, blocks)
        for segment in segments
        for outputs in segment.pieces(lowpass)
    ]
    moments = in_parallel(Segment.moments, tasks, n_jobs)
    return sum_moments(counted(moments, "equations", len(tasks)))


def excluded_columns(features, effects):
    """Return indices of parameters whose column duplicates one of an effect."""
    # Declared friction, and constants of further effects: the data determine only the
    # sum of the coefficients of equal columns.
    per_joint = features.n_parameters_ // features.n_joints_
    declared = {name: 10 + k for k, name in enumerate(features.friction_)}
    indices, used = [], set()
    # Effects on one joint first: those on two take the offset of the remaining joint.
    pairs = effect_indices(effects, features.n_parameters_)
    for effect, cols in sorted(pairs, key=lambda place: len(place[0].joints)):
        if effect.constant:
            joint = next((j for j in effect.joints if j not in used), None)
            if joint is None:
                indices.append(cols.start + effect.coefficients.index(effect.constant))
            elif "offset" in declared:
                indices.append(joint * per_joint + declared["offset"])
            used.add(joint)
        if isinstance(effect, Bank) and "coulomb" in declared:
            indices.append(effect.joint * per_joint + declared["coulomb"])
    return indices


def unexcited_entries(moments, n_rigid):
    """Find entries (nv, p), bool, of the regressor that are zero up to rounding."""
    # Joints that do not move in this recording cause them, in addition to the entries
    # that are zero in every motion. Only the first `n_rigid` parameters are examined.
    nv, n_all = moments.g.shape
    power, rounding = np.zeros((nv, n_all)), np.zeros((nv, n_all), dtype=bool)
    for row, (columns, gram) in zip(power, moments.G):
        row[columns] = gram.diagonal()
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
        return self.rms() / np.where(spread > 0, spread, np.nan)

    def normalised_error(self):
        """Root mean square over the standard deviation of the torque, (nv,)."""
        return self.relative_error(torque_spread(self))


def torque_spread(*parts):
    """Return the weighted standard deviation of the torque over all parts, (nv,)."""
    # parts: `TorqueResiduals` of one recording after the same low-pass.
    torque = np.concatenate([part.torque for part in parts])
    weight = np.concatenate([part.weight for part in parts])
    mean = _weighted(torque, weight)
    return _weighted((torque - mean) ** 2, weight) ** 0.5


def compare(segments, others, lowpass, theta):
    """Compare filtered torques of segments with those predicted by parameters (p,)."""
    # theta: None predicts the measured torques; others: the same segments with the
    # velocity signs of rows without weight. The low-pass is linear: filtering predicted
    # torques takes one column per joint instead of all columns of the regressor.
    parts, all_rows = [], slice(None)
    for segment, other in zip(segments, others):
        torque = predicted = lowpass(np.asarray(segment.torque))
        v = derivative(segment.states, all_rows, 1)
        weight = segment.filtered_weight(lowpass, all_rows, v)
        rows = segment.first + lowpass.centres(segment.n_rows)
        if theta is not None:
            predictions = segment.regressor.predict(theta, other.regressor)
            predictions = map(lowpass, predictions)
            predicted = np.where(weight > 0, *predictions)
        parts.append((rows, torque, predicted, weight))
    index, torque, predicted, weight = (np.concatenate(x) for x in zip(*parts))
    return TorqueResiduals(
        index=index, torque=torque, predicted=predicted, weight=weight
    )


def _weighted(values, weight):
    total = weight.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(total > 0, (values * weight).sum(axis=0) / total, np.nan)
