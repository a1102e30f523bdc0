"""What each effect is worth on time, or recordings, that were not fitted."""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from scipy import linalg, special

from sklearn_vbjfa.diagnosis.search._problem import precision_at_zero
from sklearn_vbjfa.effects import InModel, OnAllJoints

# Folds of a single recording, stretches one after the other.
_FOLDS = 8
# Recordings from which on each is left out as a whole: another motion.
_MIN_RECORDINGS = 3
# Ridge of the declared columns, over the mean square of a column: rounding.
_RIDGE = 1e-9
# Share of the mean error below which a block's is rounding.
_TINY = 1e-6
_SMALLEST = np.finfo(float).tiny


@dataclass(frozen=True, kw_only=True)
class CrossValidatedGain:
    """What an effect saves on stretches of time that were not fitted."""

    # share of the squared error that it saves: of its joint, or of the robot in units
    # of noise for what acts on all
    gain: float
    gain_std: float  # from the scatter between blocks of time
    # mean logarithm of the ratio of the errors without and with it, over its standard
    # error: a few blocks do not decide alone
    errors: float
    n_blocks: int  # blocks in which it changes anything

    @property
    def p_value(self):
        """One-sided t test over blocks that the second errors are smaller."""
        return float(special.stdtr(max(self.n_blocks - 1, 1), -self.errors))

    @classmethod
    def of(cls, before, after):
        """Compare squared errors (n_blocks,)."""
        saved, total = before - after, before.sum()
        changed = saved != 0
        count = int(changed.sum())
        if count < 2 or total == 0:
            return cls(gain=0.0, gain_std=0.0, errors=0.0, n_blocks=count)
        # A block that is fitted exactly would decide alone.
        tiny = _TINY * before.mean()
        ratio = np.log((before + tiny) / (after + tiny))[changed]
        error = ratio.std(ddof=1) / np.sqrt(count)
        return cls(
            gain=float(saved.sum() / total),
            gain_std=float(saved.std() * np.sqrt(saved.size) / total),
            errors=float(ratio.mean() / error) if error > 0 else 0.0,
            n_blocks=count,
        )


class HeldOut:
    """Regressions of all joints that leave out one fold of time after the other."""

    # Folds are whole recordings where there are three or more, else stretches of each,
    # unless `fold` (m,) is given. edges (n_blocks + 1,), first row of each block;
    # of_row (m,), fold of each row; A (nj, m, r + 1), declared columns and torques of
    # the joints that count, and gram (nj, n_folds, r + 1, r + 1), their products by
    # fold.

    def __init__(self, view, fold=None):
        self.view = view
        self.used_joints = used = np.flatnonzero(view.precision > 0)
        self.fold = fold_of(view) if fold is None else fold
        self.order = order = view.blocks.order
        self.edges = np.r_[view.blocks.starts, view.index.size]
        # A block lies in one fold, but for the one in which a fold ends.
        own = self.fold[order][self.edges[:-1]]
        self.row_fold = np.unique(
            np.repeat(own, np.diff(self.edges)), return_inverse=True
        )[1]
        self.rows = [self.row_fold == k for k in range(self.row_fold.max() + 1)]
        Z, y = view.Z[used][:, order], view.target[used][:, order]
        self.A = np.concatenate([Z, y[:, :, None]], axis=2)
        self.gram = np.array([[A[own].T @ A[own] for own in self.rows] for A in self.A])
        self._cache = WeakKeyDictionary()

    def columns(self, member):
        """Columns (nj, m, k) of a member, row by row."""
        if member.columns not in self._cache:
            columns = self.view.columns([member.effect], self.motion)
            self._cache[member.columns] = columns[:, self.order, 0]
        return self._cache[member.columns]

    def fitted(self, fit):
        """Leave out each fold of a `Fit`; returns a `HeldOutFit`."""
        self.motion = fit.problem.motion
        return HeldOutFit(self, fit)


class HeldOutFit:
    """A model on folds of time that were not fitted; see `HeldOut`."""

    def __init__(self, held, fit):
        self.held, self.fit = held, fit
        self._r = r = held.A.shape[2] - 1
        self._slices = [slice(r + s.start, r + s.stop) for s in fit.slices]
        self._columns = [self._joint_terms(j) for j in held.used_joints]
        # What the joints weigh with the members there.
        power = (fit.residual[held.used_joints] ** 2).sum(axis=1)
        target = held.view.target[held.used_joints]
        least = _TINY**2 * (target**2).sum(axis=1)
        self.weight = held.view.rows[held.used_joints] / np.maximum(power, least)
        by_fold = self._products(r + fit.n_coefficients)
        total = by_fold.sum(axis=0)
        ridge = _RIDGE * max(np.trace(total[:r, :r]) / max(r, 1), 1.0)
        prior = np.r_[np.full(r, ridge), fit.prior]
        precision, zero = np.diag(prior), fit.problem.held
        if zero.any():
            gram, rows = total[:r, :r] + precision[:r, :r], held.view.one_sided[zero]
            precision[:r, :r] += precision_at_zero(gram, rows)
        self._applied = np.r_[np.zeros(r), fit.applied]
        # by the numbers of members that are left out
        self._factors, self._thetas, self._without = [], {(): []}, {}
        for own in by_fold:
            left = total - own
            self._factors.append(linalg.cho_factor(left[:-1, :-1] + precision))
            right = left[:-1, -1] - prior * self._applied
            self._thetas[()].append(linalg.cho_solve(self._factors[-1], right))

    def _joint_terms(self, j):
        """Places (p_j,) of the coefficients that act on a joint, and columns."""
        found = [
            (np.r_[place], self.held.columns(member)[member.joints.index(j)])
            for place, member in zip(self._slices, self.fit.members)
            if j in member.joints
        ]
        none = np.zeros(0, int), np.zeros((self.held.row_fold.size, 0))
        return tuple(np.concatenate(own, axis=-1) for own in zip(none, *found))

    def _products(self, p):
        """Weighted products of all columns and torques by fold, the torques last."""
        held = self.held
        first, out = np.r_[: self._r, p], np.zeros((len(held.rows), p + 1, p + 1))
        both = zip(self.weight, held.A, held.gram, self._columns)
        for weight, A, gram, (at, X) in both:
            out[:, first[:, None], first] += weight * gram
            for own, rows in zip(out, held.rows):
                cross = weight * (X[rows].T @ A[rows])
                own[at[:, None], first] += cross
                own[first[:, None], at] += cross.T
                own[at[:, None], at] += weight * (X[rows].T @ X[rows])
        return out

    def _residual(self, thetas, j):
        """Residuals (m,) of the j-th joint, with the coefficients of each fold."""
        theta, (at, X), A = np.transpose(thetas), self._columns[j], self.held.A[j]
        fitted = A[:, :-1] @ theta[: self._r] + X @ theta[at]
        return A[:, -1] - fitted[np.arange(len(A)), self.held.row_fold]

    @property
    def squares(self):
        """Squared errors of blocks (n_blocks, nj), of the model."""
        return self.without((), range(len(self._columns)))

    def error(self):
        """Logarithms of the joints' mean squared errors, their rows as weights."""
        rows = self.held.view.rows[self.held.used_joints]
        return float(rows @ np.log(self.squares.sum(axis=0) / rows))

    def error_of(self, joint):
        """Squared error of one joint."""
        own = np.searchsorted(self.held.used_joints, joint)
        return float(self.without((), [own]).sum())

    def _joints_of(self, i):
        """Numbers of the joints that count for a member, and their weights."""
        effect = self.fit.members[i].effect
        # In noise, of the robot, what acts on all.
        if isinstance(effect, (OnAllJoints, InModel)):
            return np.arange(self.weight.size), self.weight
        return np.searchsorted(self.held.used_joints, [effect.joint]), np.ones(1)

    def without(self, numbers, joints):
        """Squared errors (n_blocks, nj) of joints without members, others refitted."""
        known = self._without.setdefault(tuple(numbers), {})
        for j in joints:
            if j not in known:
                squares = self._residual(self._refitted(tuple(numbers)), j) ** 2
                known[j] = np.add.reduceat(squares, self.held.edges[:-1])
        return np.stack([known[j] for j in joints], axis=1)

    def _refitted(self, numbers):
        """Coefficients of each fold without members."""
        if numbers not in self._thetas:
            at = np.concatenate([np.r_[self._slices[i]] for i in numbers])
            unit, self._thetas[numbers] = np.eye(self._applied.size)[:, at], []
            for factor, theta in zip(self._factors, self._thetas[()]):
                inverse = linalg.cho_solve(factor, unit)
                # What leaving columns out does to the others, by the block inverse.
                change = np.linalg.solve(inverse[at], theta[at] + self._applied[at])
                self._thetas[numbers].append(theta - inverse @ change)
        return self._thetas[numbers]

    def share_of(self, i, absent=(), plain=None):
        """Largest share of a joint's squared error that a member saves."""
        # Of the error without it, or without members `plain` if this is larger.
        joints, _ = self._joints_of(i)
        asked = (*absent, i), absent, (*absent, i) if plain is None else plain
        without, own, most = (self.without(x, joints).sum(axis=0) for x in asked)
        size = np.maximum(np.maximum(without, most), _SMALLEST)
        return float(((without - own) / size).max())

    def helps(self, i, least=0.0):
        """Whether a member saves more than a share, in the mean of the blocks too."""
        own = self.gain_of(i)
        return own.gain > 0 and own.errors > 0 and self.share_of(i) > least

    def gain_of(self, i, absent=()):
        """Return what a member saves, others being absent."""
        (joints, weight), both = self._joints_of(i), ((*absent, i), absent)
        errors = (self.without(x, joints) @ weight for x in both)
        return CrossValidatedGain.of(*errors)

    @property
    def residual(self):
        """Residuals (nv, m) of rows that were not fitted, scaled by their roots."""
        # Each over the deviation, in units of noise, with which the other folds predict
        # its row: where a fold is a motion of its own, that is extrapolation.
        held = self.held
        out = np.zeros_like(held.view.target)
        rows = np.arange(out.shape[1])[held.order]
        found = np.zeros((len(self._columns), rows.size))
        for j, own in enumerate(found):
            own[:] = self._residual(self._thetas[()], j)
        for own, weight, A, (at, X) in zip(found, self.weight, held.A, self._columns):
            for factor, fold in zip(self._factors, held.rows):
                columns = np.zeros((fold.sum(), self._applied.size))
                columns[:, : self._r], columns[:, at] = A[fold, :-1], X[fold]
                unknown = columns.T * linalg.cho_solve(factor, columns.T)
                own[fold] /= np.sqrt(1.0 + weight * unknown.sum(axis=0))
        out[held.used_joints[:, None], rows] = found
        return out


def fold_of(view):
    """Fold of each filtered row: recordings, or stretches of one or two, (m,)."""
    if view.repetition:
        return view.blocks.fold
    origins = np.unique(view.origin)
    if origins.size >= _MIN_RECORDINGS:
        return np.searchsorted(origins, view.origin)
    pieces = -(-_FOLDS // origins.size)
    fold = np.empty(view.origin.size, int)
    for k, origin in enumerate(origins):
        own = np.flatnonzero(view.origin == origin)
        fold[own] = k * pieces + np.arange(own.size) * pieces // own.size
    return fold
