"""Cross-validated gain of each effect, over folds of time or recordings."""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from scipy import linalg, special

from sklearn_vbjfa.diagnosis.search._problem import precision_at_zero
from sklearn_vbjfa.effects import InModel, OnAllJoints

# Folds of a single recording: consecutive stretches.
_FOLDS = 8
# From this number of recordings on, each is one fold, so that motions differ.
_MIN_RECORDINGS = 3
# Ridge of the declared columns, relative to their mean squared norm, against rounding.
_RIDGE = 1e-9
# Share of the mean error below which the error of a block is rounding.
_TINY = 1e-6
_SMALLEST = np.finfo(float).tiny


@dataclass(frozen=True, kw_only=True)
class CrossValidatedGain:
    """Reduction of the cross-validated error by an effect."""

    # relative reduction of the squared error: of its joint, or of all joints in units
    # of noise for an effect on all joints
    gain: float
    gain_std: float  # from the scatter between blocks of time
    # mean log ratio of the errors without and with it, over its standard error; the
    # logarithm keeps few blocks from dominating
    errors: float
    n_blocks: int  # blocks whose error it changes

    @property
    def p_value(self):
        """P-value of a one-sided t test over blocks for smaller errors."""
        return float(special.stdtr(max(self.n_blocks - 1, 1), -self.errors))

    @classmethod
    def of(cls, before, after):
        """Compare squared errors (n_blocks,)."""
        saved, total = before - after, before.sum()
        changed = saved != 0
        count = int(changed.sum())
        if count < 2 or total == 0:
            return cls(gain=0.0, gain_std=0.0, errors=0.0, n_blocks=count)
        # Without this floor a block that is fitted exactly would dominate.
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
    """Data of all joints for cross-validation over folds of time."""

    # Folds are the recordings if there are three or more, else stretches of each,
    # unless `fold` (m,) is given. edges (n_blocks + 1,): first row of each block;
    # row_fold (m,): fold of each row; A (nj, m, r + 1): declared columns and torques of
    # the used joints; gram (nj, n_folds, r + 1, r + 1): their Gram matrices by fold.

    def __init__(self, view, fold=None):
        self.view = view
        self.used_joints = joints = np.flatnonzero(view.precision > 0)
        self.fold = fold_of(view) if fold is None else fold
        self.order = order = view.blocks.order
        self.edges = np.r_[view.blocks.starts, view.index.size]
        # Each block belongs to the fold of its first row.
        folds = self.fold[order][self.edges[:-1]]
        self.row_fold = np.unique(
            np.repeat(folds, np.diff(self.edges)), return_inverse=True
        )[1]
        self.rows = [self.row_fold == k for k in range(self.row_fold.max() + 1)]
        Z, y = view.Z[joints][:, order], view.target[joints][:, order]
        self.A = np.concatenate([Z, y[:, :, None]], axis=2)
        self.gram = np.array([[A[at].T @ A[at] for at in self.rows] for A in self.A])
        self._cache = WeakKeyDictionary()

    def columns(self, member, motion):
        """Return the columns (nj, m, k) of a member in time."""
        if member.columns not in self._cache:
            columns = self.view.columns([member.effect], motion)
            self._cache[member.columns] = columns[:, self.order, 0]
        return self._cache[member.columns]


class HeldOutFit:
    """A cross-validated model, see `HeldOut`."""

    def __init__(self, data, fit):
        self.data, self.fit = data, fit
        self._r = r = data.A.shape[2] - 1
        self._slices = [slice(r + s.start, r + s.stop) for s in fit.slices]
        self._columns = [self._joint_terms(j) for j in data.used_joints]
        # Weights of the joints by the residuals of the fit.
        power = (fit.residual[data.used_joints] ** 2).sum(axis=1)
        target = data.view.target[data.used_joints]
        smallest = _TINY**2 * (target**2).sum(axis=1)
        self.weight = data.view.rows[data.used_joints] / np.maximum(power, smallest)
        by_fold = self._products(r + fit.n_coefficients)
        total = by_fold.sum(axis=0)
        ridge = _RIDGE * max(np.trace(total[:r, :r]) / max(r, 1), 1.0)
        prior = np.r_[np.full(r, ridge), fit.prior]
        precision, zero = np.diag(prior), fit.problem.at_zero
        if zero.any():
            gram, rows = total[:r, :r] + precision[:r, :r], data.view.one_sided[zero]
            precision[:r, :r] += precision_at_zero(gram, rows)
        self._applied = np.r_[np.zeros(r), fit.applied]
        # by the indices of the members that are left out
        self._factors, self._thetas, self._without = [], {(): []}, {}
        for fold in by_fold:
            training = total - fold
            self._factors.append(linalg.cho_factor(training[:-1, :-1] + precision))
            rhs = training[:-1, -1] - prior * self._applied
            self._thetas[()].append(linalg.cho_solve(self._factors[-1], rhs))

    def _joint_terms(self, j):
        """Return indices (p_j,) of coefficients that act on a joint, and columns."""
        terms, motion = [], self.fit.problem.motion
        for place, member in zip(self._slices, self.fit.members):
            if j in member.joints:
                columns = self.data.columns(member, motion)
                terms.append((np.r_[place], columns[member.joints.index(j)]))
        empty = np.zeros(0, int), np.zeros((self.data.row_fold.size, 0))
        return tuple(np.concatenate(parts, axis=-1) for parts in zip(empty, *terms))

    def _products(self, p):
        """Compute weighted Gram matrices of all columns and torques (last) by fold."""
        data = self.data
        base, products = np.r_[: self._r, p], np.zeros((len(data.rows), p + 1, p + 1))
        joints = zip(self.weight, data.A, data.gram, self._columns)
        for weight, A, gram, (at, X) in joints:
            products[:, base[:, None], base] += weight * gram
            for moments, rows in zip(products, data.rows):
                cross = weight * (X[rows].T @ A[rows])
                moments[at[:, None], base] += cross
                moments[base[:, None], at] += cross.T
                moments[at[:, None], at] += weight * (X[rows].T @ X[rows])
        return products

    def _residual(self, thetas, j):
        """Compute residuals (m,) of the j-th joint by the coefficients of each fold."""
        theta, (at, X), A = np.transpose(thetas), self._columns[j], self.data.A[j]
        fitted = A[:, :-1] @ theta[: self._r] + X @ theta[at]
        return A[:, -1] - fitted[np.arange(len(A)), self.data.row_fold]

    @property
    def squares(self):
        """Squared errors of the model by block, (n_blocks, nj)."""
        return self.without((), range(len(self._columns)))

    def error(self):
        """Return the log mean squared errors of the joints, weighted by their rows."""
        rows = self.data.view.rows[self.data.used_joints]
        return float(rows @ np.log(self.squares.sum(axis=0) / rows))

    def error_of(self, joint):
        """Return the squared error of one joint."""
        index = np.searchsorted(self.data.used_joints, joint)
        return float(self.without((), [index]).sum())

    def _joints_of(self, i):
        """Return indices and weights of the joints whose error a member changes."""
        effect = self.fit.members[i].effect
        # Errors of several joints are added in units of noise.
        if isinstance(effect, (OnAllJoints, InModel)):
            return np.arange(self.weight.size), self.weight
        return np.searchsorted(self.data.used_joints, [effect.joint]), np.ones(1)

    def without(self, numbers, joints):
        """Return squared errors (n_blocks, nj) of a refit without some members."""
        errors = self._without.setdefault(tuple(numbers), {})
        for j in joints:
            if j not in errors:
                squares = self._residual(self._refitted(tuple(numbers)), j) ** 2
                errors[j] = np.add.reduceat(squares, self.data.edges[:-1])
        return np.stack([errors[j] for j in joints], axis=1)

    def _refitted(self, numbers):
        """Return the coefficients of each fold without some members."""
        if numbers not in self._thetas:
            at = np.concatenate([np.r_[self._slices[i]] for i in numbers])
            unit, self._thetas[numbers] = np.eye(self._applied.size)[:, at], []
            for factor, theta in zip(self._factors, self._thetas[()]):
                inverse = linalg.cho_solve(factor, unit)
                # Change of the other coefficients, by the block inverse.
                change = np.linalg.solve(inverse[at], theta[at] + self._applied[at])
                self._thetas[numbers].append(theta - inverse @ change)
        return self._thetas[numbers]

    def share_of(self, i, absent=(), plain=None):
        """Return the largest share of a joint's squared error that a member saves."""
        # Relative to the error without it, or without members `plain` if larger.
        joints, _ = self._joints_of(i)
        excluded = (*absent, i), absent, (*absent, i) if plain is None else plain
        without, full, base = (self.without(x, joints).sum(axis=0) for x in excluded)
        size = np.maximum(np.maximum(without, base), _SMALLEST)
        return float(((without - full) / size).max())

    def helps(self, i, least=0.0):
        """Check if a member saves more than a share, and lowers the mean log error."""
        gain = self.gain_of(i)
        return gain.gain > 0 and gain.errors > 0 and self.share_of(i) > least

    def gain_of(self, i, absent=()):
        """Return the gain of a member in a model without members `absent`."""
        (joints, weight), excluded = self._joints_of(i), ((*absent, i), absent)
        errors = (self.without(x, joints) @ weight for x in excluded)
        return CrossValidatedGain.of(*errors)

    @property
    def residual(self):
        """Cross-validated residuals (nv, m), times the square roots of the weights."""
        # Divided by their predicted standard deviation in units of noise, which is
        # large if the other folds have to be extrapolated.
        data = self.data
        scaled = np.zeros_like(data.view.target)
        joints = zip(data.used_joints, self.weight, data.A, self._columns)
        for j, (joint, weight, A, (at, X)) in enumerate(joints):
            residual = self._residual(self._thetas[()], j)
            for factor, fold in zip(self._factors, data.rows):
                columns = np.zeros((fold.sum(), self._applied.size))
                columns[:, : self._r], columns[:, at] = A[fold, :-1], X[fold]
                variance = columns.T * linalg.cho_solve(factor, columns.T)
                residual[fold] /= np.sqrt(1.0 + weight * variance.sum(axis=0))
            scaled[joint, data.order] = residual
        return scaled


def fold_of(view):
    """Return the fold of each row: recordings, or stretches of one or two, (m,)."""
    if view.repetition:
        return view.blocks.fold
    origins = np.unique(view.origin)
    pieces = 1 if origins.size >= _MIN_RECORDINGS else -(-_FOLDS // origins.size)
    fold = np.empty(view.origin.size, int)
    for k, origin in enumerate(origins):
        rows = np.flatnonzero(view.origin == origin)
        fold[rows] = k * pieces + np.arange(rows.size) * pieces // rows.size
    return fold
