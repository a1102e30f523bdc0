"""A recording as the search for effects sees it: filtered rows, blocks, columns."""

import copy
import itertools
from dataclasses import replace
from weakref import WeakValueDictionary

import numpy as np

from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa._core._lowpass import coarser, stride
from sklearn_vbjfa.diagnosis.search._blocks import (
    correlation_time,
    make_blocks,
    phase_blocks,
)
from sklearn_vbjfa.effects import InModel, OnAllJoints, came_from, declared
from sklearn_vbjfa.equations._equations import make_motion, pick_load_free
from sklearn_vbjfa.recording import check_clock

# Most samples that are looked at.
_MAX_SAMPLES = 20_000
# A stretch is so many times longer than the low-pass, which takes its ends.
_LENGTHS = 30


def coarser_rows(parts, lowpass, every):
    """Return rows that are every so many of some parts, and the parts of these."""
    # Those on which the outputs of the low-pass stand, so that the coarser one has the
    # same.
    if every == 1:
        return slice(None), tuple(parts)
    half = lowpass.half // every
    rows, made, first = [], [], 0
    for part in parts:
        count = lowpass.centres(part.stop - part.start).size
        most = (
            2 * half + (count - 1) * (lowpass.step // every) + 1 if count else 2 * half
        )
        own = np.arange(part.start + lowpass.half % every, part.stop, every)[:most]
        rows.append(own)
        made.append(slice(first, first + own.size))
        first += own.size
    return np.concatenate(rows), tuple(made)


def stretches(parts, moving, lowpass):
    """Return the rows that a search looks at, and the number of the stretch of each."""
    # Of recordings, or pieces of them, `parts`, in which some joints move, `moving`
    # (n, nv): all rows of few.
    n = len(moving)
    share = min(1.0, _MAX_SAMPLES * stride(lowpass) / n)
    length = min(_LENGTHS * (2 * lowpass.half + 1), int(share * n) // 2)
    if share == 1.0:
        kept = list(parts)
    else:
        weight = even_weight(moving)
        kept, due = [], 0.0
        # Short recordings come in turns, which do not know the order of these.
        for part in sorted(
            parts, key=lambda p: (p.stop - p.start, *moving[p].sum(axis=0))
        ):
            due += share * (part.stop - part.start)
            found = _spread_stretches(part, weight[part], int(due), length)
            due -= sum(one.stop - one.start for one in found)
            kept += found
        kept.sort(key=lambda one: one.start)
    rows = [np.arange(one.start, one.stop) for one in kept]
    return np.concatenate(rows), np.repeat(np.arange(len(kept)), list(map(len, rows)))


def even_weight(moving):
    """Motion in each row, all joints counting the same, however little they do."""
    return (moving / np.maximum(moving.sum(axis=0), 1)).sum(axis=1)


def _spread_stretches(part, weight, most, length):
    """Stretches of a recording, at most so many rows together, slices."""
    n = weight.size
    if most < min(length, n):
        return []
    count = max(min(most, n) // length, 1)
    size = min(most // count, n // count)
    done = np.cumsum(weight)
    if not done[-1] > 0:
        done = np.arange(1.0, n + 1)
    # In the middle of as many intervals of equal motion.
    middle = np.searchsorted(done, (np.arange(count) + 0.5) / count * done[-1])
    first, found = 0, []
    for left, row in zip(range(count - 1, -1, -1), middle.tolist()):
        start = min(max(row - size // 2, first), n - (left + 1) * size)
        found.append(slice(part.start + start, part.start + start + size))
        first = start + size
    return found


# Directions of the scaled Gram matrix below this are never used.
_RANK = 1e-12
# Share of a parameter that may lie outside of them.
_DETERMINED = 1e-6
# Numbers of the columns that are filtered together.
_CHUNK_SIZE = 1 << 20
# Numbers of the cosines of columns that are kept after their use.
_CACHE_SIZE = 1 << 24
# Views of a corrected robot that are kept: a search goes to and fro between few.
_CACHED_VIEWS = 6
# Rests of a joint from which on its torque at rest is looked at.
_MIN_RESTS = 10


class RecordingView:
    """Filtered equations of a recording, and effects' columns behind that filter."""

    # robot: fitted with the declared model; leave_out: joints whose channel carries no
    # information; begins: when recordings begin [s].
    # Samples of effects' columns, of a long recording every `stride`-th: states (n, 3
    # nv), clock (n,) [s] or None, signals (n,) by name.
    # Filtered rows: index (m,), sample at the middle of each; moving (m, nv), weights
    # without rows at rest; root (m, nv) of the weights and target (nv, m), torques
    # scaled by it; starts, first row of each part; origin (m,), its recording; Z (nv,
    # m, r) and back (p, r), see `reduced`; one_sided (nv, n, r), rows of it that lead
    # to the declared friction, which cannot be negative. blocks: folds and tempering;
    # phases: motion of each row and time in it [s], None where none repeats; precision
    # (nv,): weights of the joints; made: all `Columns`.

    def __init__(
        self,
        robot,
        recording,
        leave_out=(),
        origin=None,
        begins=None,
        repetition=None,
        all_samples=False,
    ):
        self.robot = robot = robot.robot_
        self.declared = robot.features_.friction_
        clock = check_clock(recording.t, recording.n_samples, robot.dt)
        states = robot.states(recording.inputs, recording.groups)
        self._lowpass = robot.plan.lowpass
        self.step = (robot.dt or 1.0) * self._lowpass.step
        self._begins, self.repetition = begins, repetition
        weight = recording.weight.astype(float)
        weight[:, list(leave_out)] = 0.0
        self._source = replace(recording, weight=weight, t=clock), states
        self._root, self._corrections = self, frozenset()
        self._corrected, self.cache, self._recent = {}, WeakValueDictionary(), {}
        self._set_equations()
        self.moving = self.equations.weight
        self.recorded = self.equations.index
        edges = np.array([part.start for part in recording.segments])
        self.starts = np.unique(np.searchsorted(self.recorded, edges))
        self.starts = self.starts[self.starts < self.recorded.size]
        origin = recording.groups if origin is None else origin
        self.origin = origin[self.recorded]
        self._set_samples(all_samples)
        self._set_blocks()
        self._set_coordinates()

    def corrected(self, effects):
        """Return the view whose robot is corrected by effects that are in the model."""
        # Itself if they correct what its own robot is corrected by. Rows, blocks and
        # weights are the same; equations and coordinates are another robot's.
        own = {effect.key() for effect in self._root.robot.effects_}
        wanted = [e for e in effects if isinstance(e, InModel)]
        wanted = [e for e in wanted if e.corrects or e.key() in own]
        key = frozenset((e.key(), tuple(e.values.tolist())) for e in wanted)
        if key == self._corrections:
            return self
        root = self._root
        if not key:
            return root
        if key not in root._corrected:
            if len(root._corrected) >= _CACHED_VIEWS:
                root._corrected.pop(next(iter(root._corrected)))
            other = copy.copy(root)
            other.robot, other._corrections = root.robot.corrected(wanted), key
            other._set_equations()
            other._set_coordinates()
            root._corrected[key] = other
        return root._corrected[key]

    def at_rest(self):
        """Joints that rest often, each time for longer than the low-pass remembers."""
        v = self.states[:, self.nv : 2 * self.nv]
        still = np.abs(v) <= self.robot.plan.masked
        length = max(1.0 / (self.robot.cutoff_ * (self.dt or 1.0)), 1.0)
        count = np.zeros(self.nv, dtype=int)
        for part in self.parts:
            edges = np.diff(still[part].astype(int), axis=0, prepend=0, append=0)
            for j, own in enumerate(edges.T):
                lengths = np.flatnonzero(own < 0) - np.flatnonzero(own > 0)
                count[j] += (lengths > length).sum()
        return np.flatnonzero((count >= _MIN_RESTS) & self.root.any(axis=0)).tolist()

    def with_rest(self, joints):
        """Return the view in which rows at rest count on some joints."""
        joints = tuple(sorted({*joints}))
        if joints == self.robot.plan.resting:
            return self
        other = copy.copy(self._root)
        plan = replace(other.robot.plan, resting=joints)
        other.robot = replace(other.robot, plan=plan)
        other._root, other._corrected = other, {}
        other.cache, other._recent = WeakValueDictionary(), {}
        other._set_equations()
        other._set_coordinates()
        return other

    def without(self, columns):
        """Return the same view whose equations lack some declared columns."""
        if not columns:
            return self
        Phi = self.equations.Phi.copy("K")
        Phi[:, :, columns] = 0.0
        other = copy.copy(self)
        other.equations = replace(self.equations, Phi=Phi)
        other._set_coordinates()
        return other

    @property
    def gains(self):
        """What torque channels read over the torque, (nv,)."""
        return self.robot.features_.gains_

    def _set_equations(self):
        """Make the filtered equations of the declared model."""
        recording, states = self._source
        self.equations = self.robot.equations(recording, states)
        tau = self.equations.tau
        self.root = np.sqrt(self.equations.weight)
        self.target = (tau * self.root).T
        self.nv = tau.shape[1]

    def _set_samples(self, all_samples):
        """Take the samples of which columns are made."""
        recording, states = self._source
        every = 1 if all_samples else stride(self._lowpass)
        rows, self.parts = coarser_rows(recording.segments, self._lowpass, every)
        t = recording.t
        self.states, self.clock = states[rows], None if t is None else t[rows]
        self.signals = {name: x[rows] for name, x in recording.signals.items()}
        command, self.before = recording.command, came_from(recording.before)
        self.command = None if command is None else command[rows]
        places = np.arange(recording.n_samples)[rows]
        self.index = np.searchsorted(places, self.recorded)
        self.dt = None if self.robot.dt is None else self.robot.dt * every
        self._lowpass = coarser(self._lowpass, every)

    def _set_blocks(self):
        """Take blocks and joint weights from the robot's fit."""
        robot = self.robot
        weights = robot.joint_weights
        self.precision = np.where(self.root.any(axis=0), weights, 0.0)
        theta = robot.linear_part(robot.theta_unconstrained_)
        residual = self.equations.tau - self.equations.torques(theta)
        correlation = correlation_time(
            residual, self.equations.weight, self.step, self.starts
        )
        # What the low-pass spreads in time: the width of its main lobe.
        length = max(1.0 / robot.cutoff_, self.step)
        t, order = self.recorded * (robot.dt or 1.0), self._content_order()
        self.spans = make_blocks(t, self.starts, correlation, length, order)
        self.blocks = self.spans
        self.phases, self.repeats = None, 1.0
        if self.repetition:
            t, begins = self.clock[self.index], self.repetition.begins
            recording = np.searchsorted(begins, t, side="right") - 1
            self.phases = self.repetition.phase(recording, t)
            self.blocks = phase_blocks(*self.phases, correlation, length)
            once = self.blocks.n_blocks * self.blocks.length
            self.repeats = max(self.index.size * self.step / once, 1.0)
        # Blocks in an order that does not know in which order the parts came.
        parts = self.spans.label[np.r_[self.starts, self.index.size - 1]]
        bounds = [*parts[:-1], parts[-1] + 1]
        self.span_order = np.concatenate(
            [np.arange(bounds[k], bounds[k + 1]) for k in order]
        )

    def _content_order(self):
        """Order of the parts by what is in them, so that folds ignore how they came."""
        keys = []
        for start, end in itertools.pairwise([*self.starts, self.index.size]):
            rows = self.index[[start, (start + end) // 2, end - 1]]
            keys.append((end - start, *self.states[rows, : self.nv].round(6).ravel()))
        return sorted(range(len(keys)), key=keys.__getitem__)

    def _set_coordinates(self):
        """Express the regressor in the directions that the data determine."""
        self.Z, self.back, known = reduced(self.equations, self.precision)
        own = self.nv, 10 + len(self.declared)
        rows = (self.back * known[:, None])[: own[0] * own[1]].reshape(*own, -1)
        # Rotors are bodies, which a search leaves free altogether.
        terms = [declared(name) for name in self.declared]
        one_sided = [bool(term.nonnegative and term.depends) for term in terms]
        self.one_sided = rows[:, 10:][:, one_sided]

    @property
    def rows(self):
        """Weight of each joint's rows together, (nv,)."""
        return (self.root.T**2).sum(axis=1)

    def motion(self, theta, effects=(), coefs=()):
        """Signals of the samples; the load from reduced coordinates or None."""
        # Effects, with the coefficients of all of them, are part of the torque.
        rigid, parameters = self.robot.features_.n_parameters_, None
        if theta is not None:
            plain = pick_load_free(effects, coefs)
            parameters = np.concatenate([(self.back @ theta)[:rigid], plain])
        return self.motion_of(parameters, effects)

    def motion_of(self, parameters, effects=()):
        """Signals of the samples, with the load of parameters; see `make_motion`."""
        robot = self.robot
        motion = make_motion(
            robot.features_,
            self.states,
            self.clock,
            self.parts,
            parameters,
            robot.cutoff_,
            rest=robot.plan.turning,
            effects=effects,
            signals=self.signals,
            command=self.command,
            before=self.before,
        )
        return replace(motion, begins=self._begins, waves=robot.waves)

    # -- columns of effects -----------------------------------------------------------

    def filtered(self, columns):
        """Filter columns (n, ...) of the samples as the torques were."""
        return np.concatenate([self._lowpass(columns[part]) for part in self.parts])

    def columns(self, effects, motion):
        """Columns (nj, m, c, k) of an effect with several shape parameters."""
        joints, n = effects[0].acts_on(self.nv), motion.q.shape[0]
        most = max(len(effect.coefficients) for effect in effects)
        out = np.empty((len(joints), self.index.size, len(effects), most))
        scale = (self.gains * self.root)[:, joints, None, None]
        at_once = max(1, _CHUNK_SIZE // (n * most * len(joints)))
        for first in range(0, len(effects), at_once):
            some = effects[first : first + at_once]
            # Side by side, with zeros where a shape has fewer columns than others.
            made = np.zeros((len(joints), len(some), most, n))
            for c, effect in enumerate(some):
                own = self._checked_columns(effect, motion).reshape(n, len(joints), -1)
                made[:, c, : own.shape[2]] = own.transpose(1, 2, 0)
            rows = self.filtered(made.reshape(-1, n).T).reshape(-1, *made.shape[:3])
            out[:, :, first : first + at_once] = np.moveaxis(rows * scale, 1, 0)
        return out

    def shaped(self, effects, motion, cosines):
        """Cosines (nj, n, c, k) of an effect's columns, and their sizes (nj, c, k)."""
        rows = self.columns(effects, motion)
        size = np.sqrt((rows**2).mean(axis=1))
        return cosines(rows, effects[0].acts_on(self.nv)), size

    def keep(self, key, columns):
        """Keep `Columns` while they are in use, or were asked for last."""
        self._recent.pop(key, None)
        self.cache[key] = self._recent[key] = columns
        while sum(x.values.size for x in self._recent.values()) > _CACHE_SIZE:
            self._recent.pop(next(iter(self._recent)))
        return columns

    def _checked_columns(self, effect, motion):
        """Columns of an effect at the samples, checked for custom effects."""
        columns = np.asarray(effect.columns(motion))
        n, k = motion.q.shape[0], len(effect.coefficients)
        name = f"Effect {effect.name!r} on {self.robot.joint_names_[effect.joint]}"
        expected = (n, self.nv, k) if isinstance(effect, OnAllJoints) else (n, k)
        if columns.shape != expected:
            raise ValueError(
                f"{name} must have columns of shape {expected}, a row "
                "for each sample and a column for each coefficient; got "
                f"{columns.shape}."
            )
        if not np.isfinite(columns).all():
            rows = int((~np.isfinite(columns.reshape(n, -1))).any(axis=1).sum())
            raise ValueError(
                f"{name} has columns that are not finite in {rows} of {n} samples."
            )
        return columns

    def in_equations(self, effect, motion):
        """Columns of an effect in all joints' equations, (m, nv, k), not weighted."""
        columns = self.filtered(effect.columns(motion))
        return effect.in_all(columns, self.nv) * self.gains[:, None]


def reduced(equations, precision):
    """Express a regressor in the directions that the data determine."""
    # Returns it in reduced coordinates (nv, m, r), rows scaled by the root of their
    # weight, the matrix (p, r) that leads back to the parameters, and which of these
    # the data determine (p,).
    weight, Phi = equations.weight, equations.Phi
    # Of each joint the columns that it has alone: a tree has branches.
    places = [np.flatnonzero(own) for own in Phi.any(axis=0)]
    G, rows = np.zeros((Phi.shape[2], Phi.shape[2])), []
    for j, (own, factor) in enumerate(zip(places, precision)):
        rows.append(Phi[:, j, own] * np.sqrt(weight[:, [j]]))
        G[np.ix_(own, own)] += factor * (rows[j].T @ rows[j])
    eigen = scaled_eigen(G, _RANK)
    back = eigen.known_vectors / eigen.scale[:, None]
    back *= np.sqrt(max(float((weight * precision).sum()), 1.0))
    # Those of a branch together: what is zero between them takes no memory.
    back = back[:, np.argsort((back != 0).argmax(axis=0), kind="stable")]
    Z = np.zeros((len(rows), back.shape[1], Phi.shape[0])).transpose(0, 2, 1)
    for own, part, made in zip(places, rows, Z):
        seen = np.flatnonzero(back[own].any(axis=0))
        made[:, seen] = part @ back[np.ix_(own, seen)]
    known = (eigen.known_vectors**2).sum(axis=1) > 1.0 - _DETERMINED
    return Z, back, known
