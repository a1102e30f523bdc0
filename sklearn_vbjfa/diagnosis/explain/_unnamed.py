"""Joint torque that is predicted without a name: a bank of terms under the effects."""

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.effects import UnnamedTorque

# Penalties of the terms of one quantity, over the number of rows, for columns of unit
# size; infinity leaves them out.
_PENALTIES = (np.inf, 1.0, 0.1, 0.01, 0.001)
_SWEEPS = 2


def unnamed_torques(fit, settings):
    """Find what the residual of a `FinalFit` holds, tuple of `UnnamedTorque`."""
    view, robot = fit.view, fit.identifier.robot_
    motion = view.motion_of(robot.linear_part(robot.theta_))
    found, residual = [], fit.residuals()[1].residual * view.root
    for joint in np.flatnonzero(view.precision > 0).tolist():
        found += _of_joint(view, motion, joint, residual[:, joint], settings)
    return tuple(found)


def _of_joint(view, motion, joint, residual, settings):
    """Return those of one joint: none if they save no error of left-out blocks."""
    scales = {"reach": motion.range(joint), "fast": motion.speed(joint)}
    if not (min(scales.values()) > 0 and residual.any()):
        return []
    asked = [UnnamedTorque(joint, of, **scales) for of in UnnamedTorque.kinds]
    rows = view.gains[joint] * view.root[:, [joint]]
    columns = [view.filtered(one.terms_of(motion)) * rows for one in asked]
    kind = np.repeat(np.arange(len(asked)), [own.shape[1] for own in columns])
    X = np.hstack(columns)
    size = np.sqrt((X**2).mean(axis=0))
    size = np.where(size > 0, size, 1.0)
    bank = _Bank(X / size, residual, view.blocks)
    penalties = bank.best(kind)
    before, after = view.blocks.sums(residual**2), bank.left_out(penalties)
    gain = before - after
    errors = np.sqrt(gain.size) * gain.std(ddof=1)
    if not gain.sum() > max(settings.chance * errors, settings.worth * before.sum()):
        return []
    weights = bank.weights(penalties) / size
    return [
        clone(one).set_params(weights=tuple(weights[kind == k].tolist()))
        for k, one in enumerate(asked)
        if weights[kind == k].any()
    ]


class _Bank:
    """Ridge regression on columns (m, k) of unit size, with folds of blocks."""

    def __init__(self, X, y, blocks):
        self.X, self.y, self.blocks = X, y, blocks
        # Long stretches, as what comes next is, and not blocks among others.
        fold = blocks.label * blocks.n_folds // blocks.n_blocks
        folds = [fold == f for f in range(blocks.n_folds)]
        self.folds = folds
        self.grams = [X[own].T @ X[own] for own in folds]
        self.rights = [X[own].T @ y[own] for own in folds]
        self.gram, self.right = sum(self.grams), sum(self.rights)

    def weights(self, penalties, gram=0.0, right=0.0):
        """Weights (k,) under penalties (k,), of all rows less those of moments."""
        out, used = np.zeros(penalties.size), np.isfinite(penalties)
        G = (self.gram - gram)[np.ix_(used, used)]
        G += len(self.y) * np.diag(penalties[used])
        out[used] = np.linalg.solve(G, (self.right - right)[used])
        return out

    def _without(self, penalties):
        """Weights of the fits without each fold."""
        pairs = zip(self.grams, self.rights)
        return [self.weights(penalties, *own) for own in pairs]

    def best(self, kind):
        """Penalties (k,) of columns of several kinds that predict folds best."""

        def error(found):
            penalties = np.take(found, kind)
            return sum(
                w @ gram @ w - 2 * w @ right
                for w, gram, right in zip(
                    self._without(penalties), self.grams, self.rights
                )
            )

        found = np.full(kind.max() + 1, np.inf)
        for k in np.tile(np.arange(found.size), _SWEEPS):
            tried = [np.where(np.arange(found.size) == k, p, found) for p in _PENALTIES]
            found = min(tried, key=error)
        return np.take(found, kind)

    def left_out(self, penalties):
        """Squared errors of left-out blocks, (n_blocks,)."""
        residual = self.y.copy()
        for own, weights in zip(self.folds, self._without(penalties)):
            residual[own] -= self.X[own] @ weights
        return self.blocks.sums(residual**2)
