"""What each effect is worth on time, or recordings, that were not fitted."""

import functools
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from scipy import linalg

from sklearn_vbjfa.diagnosis.search._problem import Declared, Moments, products

# Folds of a single recording, stretches one after the other.
_FOLDS = 8
# Recordings from which on each is left out as a whole: another motion.
_RECORDINGS = 3
# Ridge of the declared columns, over the mean square of a column: rounding.
_RIDGE = 1e-9
# Share of the mean error below which a block's is rounding.
_TINY = 1e-6


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

    @property
    def helps(self):
        """Whether it saves anything, in the sum and in the mean of the blocks."""
        return self.gain > 0 and self.errors > 0


class HeldOut:
    """Regressions of all joints that leave out one fold of time after the other."""

    # From second moments of blocks of time. Folds are whole recordings where there are
    # three or more, else stretches of each recording, unless others, `fold` (m,), are
    # given: what is worth its name predicts motion that was not fitted.

    def __init__(self, view, fold=None):
        self.view = view
        self.used_joints = np.flatnonzero(view.precision > 0)
        self.fold = fold_of(view) if fold is None else fold
        self.order = order = view.blocks.order
        edges = np.r_[view.blocks.starts, view.index.size]
        self.declared = Declared(view.Z[:, order], view.target[:, order], edges)
        # A block lies in one fold, but for the one in which a fold ends.
        self.of_block = self.fold[order][edges[:-1]]
        self._known = WeakKeyDictionary()

    def moments(self, member):
        """Moments of a member's columns, row by row."""
        if member.moments not in self._known:
            columns = self.view.columns([member.effect], self.motion)[:, self.order]
            edges = self.declared.edges
            self._known[member.moments] = Moments(member.joints, columns, edges)
        return self._known[member.moments]

    def fitted(self, fit, motion):
        """Leave out each fold of a `Fit`; returns a `HeldOutFit`."""
        self.motion = motion
        return HeldOutFit(self, fit)


class HeldOutFit:
    """A model on folds of time that were not fitted; see `HeldOut`."""

    def __init__(self, held, fit):
        self.held, self.fit = held, fit
        view, r = held.view, held.declared.Z.shape[2]
        p = r + fit.n_coefficients
        self._places = [slice(r + s.start, r + s.stop) for s in fit.places]
        self._members = [held.moments(member) for member in fit.members]
        self._moments = self._assembled(r, p)
        # What the joints weigh with the members there.
        power = (fit.residual[held.used_joints] ** 2).sum(axis=1)
        least = _TINY**2 * (view.target[held.used_joints] ** 2).sum(axis=1)
        self.weight = weight = view.rows[held.used_joints] / np.maximum(power, least)
        weighted = np.einsum("j,bjpq->bpq", weight, self._moments)
        total = weighted.sum(axis=0)
        ridge = _RIDGE * max(np.trace(total[:r, :r]) / max(r, 1), 1.0)
        prior = np.r_[np.full(r, ridge), fit.prior]
        self._done = np.r_[np.zeros(r), fit.done]
        self._folds = []
        for k in np.unique(held.of_block):
            blocks = held.of_block == k
            left = total - weighted[blocks].sum(axis=0)
            G = left[:p, :p] + np.diag(prior)
            factor = linalg.cho_factor(G)
            theta = linalg.cho_solve(factor, left[:p, p] - prior * self._done)
            self._folds.append((blocks, factor, theta))

    def _assembled(self, r, p):
        """Products of all columns and torques, (n_blocks, nj, p + 1, p + 1)."""
        held, declared = self.held, self.held.declared
        out = np.zeros((held.of_block.size, held.used_joints.size, p + 1, p + 1))
        out[:, :, :r, :r] = declared.gram[held.used_joints].swapaxes(0, 1)
        out[:, :, :r, p] = declared.right[held.used_joints].swapaxes(0, 1)
        out[:, :, p, p] = declared.power[held.used_joints].T
        acting = {i: [] for i in range(held.used_joints.size)}
        for place, own in zip(self._places, self._members):
            cross, right = own.declared(declared), own.right(declared)
            for i, j in enumerate(held.used_joints):
                if j in own.joints:
                    k = own.joints.index(j)
                    out[:, i, :r, place] = cross[k]
                    out[:, i, place, p] = right[k]
                    acting[i].append((np.r_[place], own.columns[k, :, 0]))
        for i, found in acting.items():
            if found:
                at = np.concatenate([x[0] for x in found])
                X = np.hstack([x[1] for x in found])
                out[:, i, at[:, None], at] = products(declared.edges, X, X)
        # What is below the diagonal stands above it.
        return np.triu(out) + np.triu(out, 1).swapaxes(2, 3)

    def _squares(self, blocks, theta):
        """Squared errors (n, nj) of some blocks."""
        full = np.r_[theta, -1.0]
        return (self._moments[blocks] @ full) @ full

    @functools.cached_property
    def squares(self):
        """Squared errors of blocks (n_blocks, nj), of the model."""
        found = np.empty(self._moments.shape[:2])
        for blocks, _, theta in self._folds:
            found[blocks] = self._squares(blocks, theta)
        return found

    def error(self):
        """Logarithms of the joints' mean squared errors, their rows as weights."""
        rows = self.held.view.rows[self.held.used_joints]
        return float(rows @ np.log(self.squares.sum(axis=0) / rows))

    def error_of(self, joint):
        """Squared error of one joint."""
        own = np.searchsorted(self.held.used_joints, joint)
        return float(self.squares[:, own].sum())

    def of_member(self, member, squares):
        """Errors of blocks (n_blocks,) of a member's joint; in noise, of the robot."""
        if member.effect.whole_robot or member.effect.in_model:
            return squares @ self.weight
        return squares[:, np.searchsorted(self.held.used_joints, member.effect.joint)]

    def by_joint(self, member, squares):
        """Errors of the joints that a member acts on, summed over the blocks."""
        if member.effect.whole_robot or member.effect.in_model:
            return squares.sum(axis=0)
        return self.of_member(member, squares).sum(keepdims=True)

    def without(self, *numbers):
        """Squared errors (n_blocks, nj) without members, the others refitted."""
        if not numbers:
            return self.squares
        place = np.concatenate([np.r_[self._places[i]] for i in numbers])
        found, unit = np.empty_like(self.squares), np.eye(self._done.size)[:, place]
        for blocks, factor, theta in self._folds:
            inverse = linalg.cho_solve(factor, unit)
            # What leaving columns out does to the others, by the block inverse.
            away = np.linalg.solve(inverse[place], theta[place] + self._done[place])
            found[blocks] = self._squares(blocks, theta - inverse @ away)
        return found

    def gain_of(self, i, absent=()):
        """Return what a member saves, others being absent."""
        both = self.without(*absent, i), self.without(*absent)
        member = self.fit.members[i]
        return CrossValidatedGain.of(*(self.of_member(member, x) for x in both))

    @property
    def residual(self):
        """Residuals (nv, m) of rows that were not fitted, scaled by their roots."""
        held, r = self.held, self.held.declared.Z.shape[2]
        out = np.zeros_like(held.view.target)
        for blocks, _, theta in self._folds:
            rows = np.isin(held.view.blocks.label, np.flatnonzero(blocks))
            for j in held.used_joints:
                own = held.view.target[j, rows] - held.view.Z[j, rows] @ theta[:r]
                for place, member in zip(self._places, self._members):
                    if j in member.joints:
                        columns = member.columns[member.joints.index(j), rows, 0]
                        own -= columns @ theta[place]
                out[j, rows] = own
        return out


def fold_of(view):
    """Fold of each filtered row: recordings, or stretches of one or two, (m,)."""
    if view.repetition:
        return view.blocks.fold
    origins = np.unique(view.origin)
    if origins.size >= _RECORDINGS:
        return np.searchsorted(origins, view.origin)
    pieces = -(-_FOLDS // origins.size)
    fold = np.empty(view.origin.size, int)
    for k, origin in enumerate(origins):
        own = np.flatnonzero(view.origin == origin)
        fold[own] = k * pieces + np.arange(own.size) * pieces // own.size
    return fold
