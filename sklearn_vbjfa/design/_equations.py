"""Equations of a motion that has not been recorded yet, and how they change with it.

The torque of a joint is a sum of columns: of the bodies, and of effects, those that the
model has and those that it may lack. All are functions of the states; their derivatives
by the states, contracted with what a criterion says of each entry, are its gradient.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import qr

from sklearn_vbjfa._core._linear_systems import or_one
from sklearn_vbjfa.effects import Motion, Rest, Stateful
from sklearn_vbjfa.model import is_prismatic

# Step of positions [rad or m]; velocities and accelerations take steps of one, by which
# the bodies' columns have exact differences: they are of second and of first degree.
_STEP = 1e-4
# Relative step of what effects depend on.
_RELATIVE_STEP = 1e-5
# Power outside the span of other columns below which a column is in it.
IN_SPAN = 1e-6
# Rows by which is probed what a column depends on.
_PROBES = 60


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """Columns of an effect and what they depend on."""

    effect: object  # at its joint
    inputs: tuple  # signals that its columns depend on row by row, such as ("v", 2)
    # whether a row depends on others: then the columns are differentiated along the
    # motion of the own joint
    remembers: bool

    @classmethod
    def of(cls, effect, motion):
        """Probe an effect with a motion in which all signals vary."""
        before = effect.columns(motion)
        inputs, remembers = [], isinstance(effect, Stateful)
        middle = motion.q.shape[0] // 2
        for name, joint, values in _signals_of(motion):
            moved = _moved(motion, name, joint, np.ptp(values) * 1e-2 + 1e-6)
            if not np.array_equal(effect.columns(moved), before):
                inputs.append((name, joint))
                step = np.zeros(values.size)
                step[middle] = np.ptp(values) * 1e-2 + 1e-6
                one = effect.columns(_moved(motion, name, joint, step)) != before
                one[middle] = False
                remembers |= bool(one.any())
        return cls(effect, tuple(inputs), remembers)


def _signals_of(motion):
    """Yield (name, joint, values (n,)) of the signals of a motion."""
    for name in ("q", "v", "a", "load", "torque"):
        values = getattr(motion, name)
        for joint in range(motion.n_joints):
            yield name, joint, values[:, joint]


def _moved(motion, name, joint, step):
    """Return the motion with a step added to one signal."""
    values = getattr(motion, name).copy()
    values[:, joint] += step
    return replace(motion, **{name: values}, _speeds={})


@dataclass(frozen=True, eq=False)
class MotionEquations:
    """Rows of all joints for the states of a motion."""

    states: np.ndarray  # (n, 3 nv)
    rows: tuple  # (k_j, n): columns that act on each joint, samples last
    motion: Motion = field(repr=False)  # what effects were computed from


class EquationModel:
    """Columns of a robot and of effects, for any motion."""

    # features: of the bodies, without friction; inertial (nv, 10): for the load;
    # effects: at their joints, the n_own of the model first; still (nv,): speeds below
    # which a joint may be standing; reference (n, 3 nv): states as the limits allow
    # them, at which columns are compared; bandwidth: of the fit [Hz].
    # base: bodies' parameters whose columns are kept: with the model's effects they
    # span all columns of the model in any motion; places: which columns act on each
    # joint; n_model, n_columns: columns of the model, and with further effects; spans:
    # columns of each effect.

    def __init__(
        self, features, inertial, effects, *, n_own, still, reference, bandwidth
    ):
        self.features, self.bandwidth = features, bandwidth
        self._theta = np.ascontiguousarray(inertial).ravel()
        nv = self.nv = features.n_joints_
        self._rest = Rest(speed=np.zeros(nv), time=np.zeros(nv), noise=still)
        self.prismatic = np.asarray(is_prismatic(features.model_), dtype=bool)
        support = features.support_
        self._of_joint, self._of_parameter = np.nonzero(support)
        entries = features.entries(reference)
        probe = self._motion(reference[:_PROBES], entries[:, :_PROBES])
        self.effects = [EffectColumns.of(effect, probe) for effect in effects]
        self.n_own = n_own
        self._choose_base(entries, self._motion(reference, entries))

    # -- columns ----------------------------------------------------------------------

    def _choose_base(self, entries, motion):
        """Keep the bodies' columns that add to those of the effects of the model."""
        n, nv = motion.q.shape
        friction = [self._everywhere(one, motion) for one in self.effects[: self.n_own]]
        friction = (
            np.concatenate(friction, axis=2) if friction else np.zeros((n, nv, 0))
        )
        bodies = np.zeros((n, nv, self._theta.size))
        bodies[:, self._of_joint, self._of_parameter] = entries.T
        # Torques and forces have units of their own: rows are over the joint's load.
        unit = np.sqrt((motion.load**2).mean(axis=0))
        unit[unit == 0] = 1.0
        friction, bodies = friction / unit[:, None], bodies / unit[:, None]
        A, B = friction.reshape(n * nv, -1), bodies.reshape(n * nv, -1)
        size = np.linalg.norm(B, axis=0)
        seen = np.flatnonzero(size > 1e-9 * size.max(initial=0.0))
        B = B[:, seen] / size[seen]
        if A.shape[1]:
            norms = np.linalg.norm(A, axis=0)
            Q, _ = np.linalg.qr(A / or_one(norms))
            B = B - Q @ (Q.T @ B)
        R, pivots = qr(B, mode="r", pivoting=True)
        diagonal = np.abs(np.diag(R))
        rank = np.count_nonzero(diagonal**2 > IN_SPAN**2)
        self.base = np.sort(seen[pivots[:rank]])
        place = np.full(self._theta.size, -1)
        place[self.base] = np.arange(rank)
        self._kept = np.flatnonzero(place[self._of_parameter] >= 0)
        joints = self._of_joint[self._kept]
        self._kept_of = [self._kept[joints == j] for j in range(nv)]
        places = [list(place[self._of_parameter[k]]) for k in self._kept_of]
        self.spans, first = [], rank
        for k, one in enumerate(self.effects):
            effect = one.effect
            last = first + len(effect.coefficients)
            self.spans.append(slice(first, last))
            for j in range(nv) if effect.whole_robot else [effect.joint]:
                places[j] += range(first, last)
            first = last
            if k == self.n_own - 1:
                self.n_model = last
        if self.n_own == 0:
            self.n_model = rank
        self.n_columns = first
        self.places = tuple(np.array(friction, dtype=int) for friction in places)

    def _everywhere(self, one, motion):
        """Columns of an effect on all joints, (n, nv, k)."""
        columns = one.effect.columns(motion)
        if one.effect.whole_robot:
            return columns
        spread = np.zeros((len(columns), self.nv, columns.shape[1]))
        spread[:, one.effect.joint] = columns
        return spread

    def _motion(self, states, entries, t=None):
        """Signals of states, with the load of the bodies."""
        q, v, a = np.split(states, 3, axis=1)
        load = self._load(entries)
        inertial = self._theta.reshape(self.nv, -1)
        return Motion(
            q=q,
            v=v,
            a=a,
            t=np.arange(len(q)) / (20.0 * self.bandwidth) if t is None else t,
            load=load,
            torque=load,
            prismatic=self.prismatic,
            rigid=lambda q, v, a: self.features.torques(
                q, v, a, np.ascontiguousarray(inertial)
            ),
            bandwidth=self.bandwidth,
            rest=self._rest,
        )

    def _load(self, entries):
        """Torques of the bodies (n, nv) from all entries of the regressor."""
        load = np.zeros((entries.shape[1], self.nv))
        weighted = entries * self._theta[self._of_parameter][:, None]
        for j in range(self.nv):
            load[:, j] = weighted[self._of_joint == j].sum(axis=0)
        return load

    def __call__(self, states, t=None):
        """Return the `MotionEquations` of states (n, 3 nv) at times (n,) [s]."""
        entries = self.features.entries(states)
        motion = self._motion(states, entries, t)
        rows = [[entries[kept]] for kept in self._kept_of]
        for one in self.effects:
            columns = one.effect.columns(motion)
            if one.effect.whole_robot:
                for j in range(self.nv):
                    rows[j].append(columns[:, j].T)
            else:
                rows[one.effect.joint].append(columns.T)
        return MotionEquations(states, tuple(map(np.concatenate, rows)), motion)

    # -- derivatives ------------------------------------------------------------------

    def pulled_back(self, equations, by_rows, curve=None, z=None, basis=None):
        """Gradients by the states (n, 3 nv), and by coordinates of the curve."""
        # by_rows: derivatives of a criterion by the entries of the rows, nv of (k_j,
        # n). The second, (nv, size) or 0, is what columns with a memory add, which are
        # differentiated along the motion (curve, z, basis).
        motion = equations.motion
        by_states = np.zeros_like(equations.states)
        by_load = np.zeros((len(motion.q), self.nv))
        by_z = 0.0
        row = [len(kept) for kept in self._kept_of]
        for one in self.effects:
            effect, width = one.effect, len(one.effect.coefficients)
            joints = range(self.nv) if effect.whole_robot else [effect.joint]
            slopes = np.array([by_rows[j][row[j] : row[j] + width] for j in joints])
            for j in joints:
                row[j] += width
            if not slopes.any():
                continue
            if one.remembers:
                if z is not None:
                    by_z = by_z + self._along(one, slopes, motion, curve, z, basis)
                continue
            self._add_by_signals(one, slopes, motion, by_states, by_load)
        by_entries = np.zeros((self._of_joint.size, len(motion.q)))
        for j, kept in enumerate(self._kept_of):
            by_entries[kept] = by_rows[j][: len(kept)]
        by_entries += (
            self._theta[self._of_parameter][:, None] * by_load.T[self._of_joint]
        )
        self._add_by_bodies(equations.states, by_entries, by_states)
        return by_states, by_z

    def _add_by_signals(self, one, slopes, motion, by_states, by_load):
        """Add derivatives of an effect's columns, differences in each signal."""
        places = {"q": 0, "v": 1, "a": 2}
        for name, joint in one.inputs:
            values = getattr(motion, name)[:, joint]
            h = _RELATIVE_STEP * max(np.ptp(values), _STEP)
            change = _contracted(
                one.effect.columns(_moved(motion, name, joint, h)), slopes
            ) - _contracted(one.effect.columns(_moved(motion, name, joint, -h)), slopes)
            change /= 2 * h
            if name in ("load", "torque"):
                # Effects see the torque of the bodies as that of the whole model.
                by_load[:, joint] += change
            else:
                by_states[:, places[name] * self.nv + joint] += change

    def _along(self, one, slopes, motion, curve, z, basis):
        """Differentiate columns with a memory by the coordinates of their joint."""
        j = one.effect.joint
        by_z = np.zeros_like(z)
        now = _contracted(one.effect.columns(motion), slopes).sum()
        h = _RELATIVE_STEP * max(np.abs(z[j]).max(), 1e-3)
        for i in range(curve.size):
            moved = {}
            for name, part in zip("qva", basis):
                values = getattr(motion, name).copy()
                values[:, j] += h * part[:, i]
                moved[name] = values
            made = one.effect.columns(replace(motion, **moved, _speeds={}))
            by_z[j, i] = (_contracted(made, slopes).sum() - now) / h
        return by_z

    def _add_by_bodies(self, states, by_entries, by_states):
        """Add derivatives of the bodies' columns, contracted, to (n, 3 nv)."""
        nv = self.nv
        h = np.repeat([_STEP, 1.0], [nv, 2 * nv])
        k = np.arange(3 * nv)
        # All steps go through together: calls cost more than samples. Columns are
        # linear in the accelerations.
        moved = np.repeat(states[None], 5 * nv + 1, axis=0)
        moved[k, :, k] += h[:, None]
        both = k[: 2 * nv]
        moved[3 * nv + both, :, both] = moved[both, :, both] - 2 * h[both, None]
        entries = self.features.entries(moved.reshape(-1, 3 * nv))
        entries = entries.reshape(len(entries), len(moved), -1)
        for i in k:
            if i < 2 * nv:
                change = (entries[:, i] - entries[:, 3 * nv + i]) / (2 * h[i])
            else:
                change = entries[:, i] - entries[:, -1]
            by_states[:, i] += np.einsum("en,en->n", change, by_entries)


def _contracted(columns, slopes):
    """Sum of columns times derivatives by rows (n_joints, k, n), an ndarray (n,)."""
    if columns.ndim == 2:
        columns = columns[:, None]
    return np.einsum("njk,jkn->n", columns, slopes)
