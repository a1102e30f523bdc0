"""Recording for the search for effects: filtered equations, blocks, columns."""

import copy
import itertools
from dataclasses import replace
from weakref import WeakValueDictionary

import numpy as np

from sklearn_vbjfa._core._autocorrelation import correlation_time
from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa._core._lowpass import coarser, coarser_rows, stride
from sklearn_vbjfa.diagnosis.search._blocks import make_blocks, phase_blocks
from sklearn_vbjfa.effects import InModel, OnAllJoints, declared, earlier_reversals
from sklearn_vbjfa.equations._equations import make_motion, pick_load_free
from sklearn_vbjfa.recording import check_clock

# Maximum number of samples that are searched.
_MAX_SAMPLES = 20_000
# Length of a stretch over that of the low-pass, which shortens both ends.
_LENGTHS = 30
# Stretches of short recordings may be shorter by this factor.
_SHORTER = 5


def stretches(parts, moving, lowpass):
    """Return the rows to search, and the index of the stretch of each row."""
    # parts: recordings or pieces of them; moving (n, nv): whether joints move. Short
    # recordings are searched completely.
    n = len(moving)
    share = min(1.0, _MAX_SAMPLES * stride(lowpass) / n)
    length = min(_LENGTHS * (2 * lowpass.half + 1), int(share * n) // 2)
    if share == 1.0:
        chosen = list(parts)
    else:
        weight = even_weight(moving)
        chosen, budget = [], 0.0
        # Allot rows by increasing length, independent of the order of the recordings.
        for part in sorted(
            parts, key=lambda p: (p.stop - p.start, *moving[p].sum(axis=0))
        ):
            budget += share * (part.stop - part.start)
            slices = _spread_stretches(part, weight[part], int(budget), length)
            budget -= sum(x.stop - x.start for x in slices)
            chosen += slices
        chosen.sort(key=lambda x: x.start)
    rows = [np.arange(x.start, x.stop) for x in chosen]
    return np.concatenate(rows), np.repeat(np.arange(len(chosen)), list(map(len, rows)))


def even_weight(moving):
    """Sum the motion of the joints in each row, each normalised to the same total."""
    return (moving / np.maximum(moving.sum(axis=0), 1)).sum(axis=1)


def _spread_stretches(part, weight, budget, length):
    """Select stretches of a recording, at most `budget` rows in all, slices."""
    n = weight.size
    if budget < min(length // _SHORTER, n):
        return []
    count = max(min(budget, n) // length, 1)
    size = min(budget // count, n // count)
    total = np.cumsum(weight)
    if not total[-1] > 0:
        total = np.arange(1.0, n + 1)
    # Centre them on as many intervals of equal motion.
    middle = np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1])
    first, slices = 0, []
    for left, row in zip(range(count - 1, -1, -1), middle.tolist()):
        start = min(max(row - size // 2, first), n - (left + 1) * size)
        slices.append(slice(part.start + start, part.start + start + size))
        first = start + size
    return slices


# Relative eigenvalues of the scaled Gram matrix below this count as zero.
_RANK = 1e-12
# Share of an identifiable parameter that may lie in the null space.
_DETERMINED = 1e-6
# Values that are filtered at once.
_CHUNK_SIZE = 1 << 20
# Values of unused columns that are cached.
_CACHE_SIZE = 1 << 24
# Views of a corrected robot that are cached: a search alternates between few.
_CACHED_VIEWS = 6
# Minimum number of standstills of a joint for the use of its torque at rest.
_MIN_RESTS = 10


class RecordingView:
    """Filtered equations of a recording, and filtered columns of effects."""

    # robot: fitted with the declared model; origin: recording of each row; repetition:
    # see `find_repetition`, None if unknown.
    # Samples for columns of effects, of a long recording every `stride`-th: states (n,
    # 3 nv), clock (n,) [s] or None, signals (n,) by name.
    # Filtered rows: index (m,), central sample of each; root (m, nv), square roots of
    # the weights; target (nv, m), torques times these; starts, first row of each part;
    # origin (m,), recording of each row; Z (nv, m, r) and back (p, r), see `reduced`;
    # one_sided (nv, n_terms, r), rows of `back` for nonnegative friction terms. blocks:
    # blocks and folds; phases: motion of each row and time in it [s], None without
    # repetition; precision (nv,): weights of the joints; cache: all `Columns`.

    def __init__(
        self,
        robot,
        recording,
        origin=None,
        repetition=None,
        all_samples=False,
    ):
        self.robot = robot = robot.robot_
        self.declared = robot.features_.friction_
        clock = check_clock(recording.t, recording.n_samples, robot.dt)
        states = robot.states(recording.inputs, recording.groups)
        self._lowpass = robot.plan.lowpass
        self.step = (robot.dt or 1.0) * self._lowpass.step
        self.repetition = repetition
        self._source = replace(recording, t=clock), states
        self._original, self._corrections = self, frozenset()
        self._corrected, self.cache, self._recent = {}, WeakValueDictionary(), {}
        self._set_equations()
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
        """Return the view of the robot with the corrections of effects."""
        # Rows, blocks and weights stay the same; equations and coordinates change.
        keys = {effect.key() for effect in self._original.robot.effects_}
        corrections = [e for e in effects if isinstance(e, InModel)]
        corrections = [e for e in corrections if e.corrects or e.key() in keys]
        key = frozenset((e.key(), tuple(e.values.tolist())) for e in corrections)
        if key == self._corrections:
            return self
        original = self._original
        if not key:
            return original
        views = original._corrected
        if key not in views:
            if len(views) >= _CACHED_VIEWS:
                views.pop(next(iter(views)))
            view = copy.copy(original)
            view.robot, view._corrections = original.robot.corrected(corrections), key
            view._set_equations()
            view._set_coordinates()
            views[key] = view
        return views[key]

    def at_rest(self):
        """Return the joints that often stand still for longer than the low-pass."""
        v = self.states[:, self.nv : 2 * self.nv]
        still = np.abs(v) <= self.robot.plan.mask_speeds
        length = max(1.0 / (self.robot.cutoff_ * (self.dt or 1.0)), 1.0)
        count = np.zeros(self.nv, dtype=int)
        for part in self.parts:
            edges = np.diff(still[part].astype(int), axis=0, prepend=0, append=0)
            for j, edge in enumerate(edges.T):
                lengths = np.flatnonzero(edge < 0) - np.flatnonzero(edge > 0)
                count[j] += (lengths > length).sum()
        return np.flatnonzero((count >= _MIN_RESTS) & self.root.any(axis=0)).tolist()

    def with_rest(self, joints):
        """Return a view that includes rows at rest of some joints."""
        joints = tuple(sorted({*joints}))
        if joints == self.robot.plan.resting:
            return self
        view = copy.copy(self._original)
        plan = replace(view.robot.plan, resting=joints)
        view.robot = replace(view.robot, plan=plan)
        view._original, view._corrected = view, {}
        view.cache, view._recent = WeakValueDictionary(), {}
        view._set_equations()
        view._set_coordinates()
        return view

    def without(self, columns):
        """Return a view without some declared columns."""
        if not columns:
            return self
        Phi = self.equations.Phi.copy("K")
        Phi[:, :, columns] = 0.0
        view = copy.copy(self)
        view.equations = replace(self.equations, Phi=Phi)
        view._set_coordinates()
        return view

    @property
    def gains(self):
        """Gains of the torque channels, reading over torque, (nv,)."""
        return self.robot.features_.gains_

    def _set_equations(self):
        """Set the filtered equations of the declared model."""
        recording, states = self._source
        self.equations = self.robot.equations(recording, states)
        tau = self.equations.tau
        self.root = np.sqrt(self.equations.weight)
        self.target = (tau * self.root).T
        self.nv = tau.shape[1]

    def _set_samples(self, all_samples):
        """Select the samples from which columns are computed."""
        recording, states = self._source
        every = 1 if all_samples else stride(self._lowpass)
        rows, self.parts = coarser_rows(recording.segments, self._lowpass, every)
        t = recording.t
        self.states, self.clock = states[rows], None if t is None else t[rows]
        self.signals = {name: x[rows] for name, x in recording.signals.items()}
        command, self.before = recording.command, earlier_reversals(recording.before)
        self.command = None if command is None else command[rows]
        numbers = np.arange(recording.n_samples)[rows]
        self.index = np.searchsorted(numbers, self.recorded)
        self.dt = None if self.robot.dt is None else self.robot.dt * every
        self._lowpass = coarser(self._lowpass, every)

    def _set_blocks(self):
        """Set blocks and joint weights by the robot's fit."""
        robot = self.robot
        weights = robot.joint_weights
        self.precision = np.where(self.root.any(axis=0), weights, 0.0)
        theta = robot.linear_part(robot.theta_unconstrained_)
        residual = self.equations.tau - self.equations.torques(theta)
        correlation = correlation_time(
            residual, self.equations.weight, self.step, self.starts
        )
        # Main lobe width of the low-pass.
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

    def _content_order(self):
        """Sort the parts by content, for folds without regard to order and signs."""
        keys = []
        for start, end in itertools.pairwise([*self.starts, self.index.size]):
            rows = self.index[[start, (start + end) // 2, end - 1]]
            sizes = np.abs(self.states[rows, : self.nv]).sum(axis=1)
            keys.append((end - start, *sizes.round(6)))
        return sorted(range(len(keys)), key=keys.__getitem__)

    def _set_coordinates(self):
        """Set the regressor in base parameters."""
        self.Z, self.back, mask = reduced(self.equations, self.precision)
        size = self.nv, 10 + len(self.declared)
        rows = (self.back * mask[:, None])[: size[0] * size[1]].reshape(*size, -1)
        # Rotor inertias are free, as all inertial parameters in a search.
        terms = [declared(name) for name in self.declared]
        one_sided = [bool(term.nonnegative and term.depends) for term in terms]
        self.one_sided = rows[:, 10:][:, one_sided]

    @property
    def rows(self):
        """Total weight of each joint's rows, (nv,)."""
        return (self.root.T**2).sum(axis=1)

    def motion(self, theta, effects=(), coefs=()):
        """Return signals, with the load of reduced coordinates theta or none."""
        # The torque includes the robot's effects, and `effects` with their `coefs`.
        effects, parameters = (*self.robot.effects_, *effects), None
        if theta is not None:
            n = self.robot.features_.n_parameters_
            rigid, declared = np.split(self.back @ theta, [n])
            load_free = pick_load_free(effects, np.append(declared, coefs))
            parameters = np.append(rigid, load_free)
        return self.motion_of(parameters, effects)

    def motion_of(self, parameters, effects=()):
        """Return signals, with the load of parameters; see `make_motion`."""
        robot, repetition = self.robot, self.repetition
        return make_motion(
            robot.features_,
            self.states,
            self.parts,
            theta=parameters,
            effects=effects,
            rest=robot.plan.fit_rest,
            t=self.clock,
            bandwidth=robot.cutoff_,
            signals=self.signals,
            command=self.command,
            before=self.before,
            begins=None if repetition is None else tuple(repetition.begins),
            waves=robot.waves,
        )

    # -- columns of effects -----------------------------------------------------------

    def filtered(self, columns):
        """Filter columns (n, ...) like the torques."""
        return np.concatenate([self._lowpass(columns[part]) for part in self.parts])

    def columns(self, effects, motion):
        """Compute filtered, weighted columns (nj, m, c, k) of an effect with shapes."""
        joints, n = effects[0].acts_on(self.nv), motion.q.shape[0]
        width = max(len(effect.coefficients) for effect in effects)
        out = np.empty((len(joints), self.index.size, len(effects), width))
        scale = (self.gains * self.root)[:, joints, None, None]
        step = max(1, _CHUNK_SIZE // (n * width * len(joints)))
        for first in range(0, len(effects), step):
            chunk = effects[first : first + step]
            # Pad with zeros if a shape has fewer columns than others.
            raw = np.zeros((len(joints), len(chunk), width, n))
            for c, effect in enumerate(chunk):
                X = self._checked_columns(effect, motion).reshape(n, len(joints), -1)
                raw[:, c, : X.shape[2]] = X.transpose(1, 2, 0)
            rows = self.filtered(raw.reshape(-1, n).T).reshape(-1, *raw.shape[:3])
            out[:, :, first : first + step] = np.moveaxis(rows * scale, 1, 0)
        return out

    def keep(self, key, columns):
        """Cache `Columns` that are in use or were used last."""
        self._recent.pop(key, None)
        self.cache[key] = self._recent[key] = columns
        while sum(x.values.size for x in self._recent.values()) > _CACHE_SIZE:
            self._recent.pop(next(iter(self._recent)))
        return columns

    def _checked_columns(self, effect, motion):
        """Compute columns of an effect, with checks for custom effects."""
        columns = np.asarray(effect.columns(motion))
        n, k = motion.q.shape[0], len(effect.coefficients)
        expected = (n, self.nv, k) if isinstance(effect, OnAllJoints) else (n, k)
        problem = ""
        if columns.shape != expected:
            problem = (
                f"must have columns of shape {expected}, a row for each sample and a "
                f"column for each coefficient; got {columns.shape}."
            )
        elif not np.isfinite(columns).all():
            rows = int((~np.isfinite(columns.reshape(n, -1))).any(axis=1).sum())
            problem = f"has columns that are not finite in {rows} of {n} samples."
        if problem:
            joint = self.robot.joint_names_[effect.joint]
            raise ValueError(f"Effect {effect.name!r} on {joint} {problem}")
        return columns

    def in_equations(self, effect, motion):
        """Compute unweighted filtered columns for all joints, (m, nv, k)."""
        columns = self.filtered(effect.columns(motion))
        return effect.in_all(columns, self.nv) * self.gains[:, None]


def reduced(equations, precision):
    """Express a regressor in base parameters."""
    # Returns the reduced regressor (nv, m, r), rows times roots of weights, the matrix
    # (p, r) to full parameters, and which of these are identifiable.
    weight, Phi = equations.weight, equations.Phi
    # Nonzero columns of each joint: the joints of a tree share few.
    supports = [np.flatnonzero(used) for used in Phi.any(axis=0)]
    G, rows = np.zeros((Phi.shape[2], Phi.shape[2])), []
    for j, (used, factor) in enumerate(zip(supports, precision)):
        rows.append(Phi[:, j, used] * np.sqrt(weight[:, [j]]))
        G[np.ix_(used, used)] += factor * (rows[j].T @ rows[j])
    eigen = scaled_eigen(G, _RANK)
    back = eigen.known_vectors / eigen.scale[:, None]
    back *= np.sqrt(max(float((weight * precision).sum()), 1.0))
    # Sort by branch: zeros between branches take no memory.
    back = back[:, np.argsort((back != 0).argmax(axis=0), kind="stable")]
    Z = np.zeros((len(rows), back.shape[1], Phi.shape[0])).transpose(0, 2, 1)
    for used, X, target in zip(supports, rows, Z):
        nonzero = np.flatnonzero(back[used].any(axis=0))
        target[:, nonzero] = X @ back[np.ix_(used, nonzero)]
    determined = (eigen.known_vectors**2).sum(axis=1) > 1.0 - _DETERMINED
    return Z, back, determined
