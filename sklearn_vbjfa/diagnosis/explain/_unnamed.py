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
    view, (motion, residual), found = fit.view, _rest(fit), []
    for joint in np.flatnonzero(view.precision > 0).tolist():
        found += _of_joint(view, motion, joint, residual[:, joint], settings)
    return tuple(found)


def that_help(fit, unnamed):
    """Return the `UnnamedTorque` of joints whose residual in a fit they reduce."""
    view, (motion, residual) = fit.view, _rest(fit)
    left = residual.copy()
    for one in unnamed:
        torque = view.filtered(one.terms_of(motion)) @ np.array(one.weights)
        left[:, one.joint] -= torque * view.gains[one.joint] * view.root[:, one.joint]
    helps = (left**2).sum(axis=0) < (residual**2).sum(axis=0)
    return tuple(one for one in unnamed if helps[one.joint])


def _rest(fit):
    """Return the motion of a fit, and its residuals (m, nv) in units of their noise."""
    view, robot = fit.view, fit.identifier.robot_
    motion = view.motion_of(robot.linear_part(robot.theta_))
    return motion, (view.equations.tau - fit.predicted(robot.theta_)) * view.root


def _of_joint(view, motion, joint, residual, settings):
    """Return those of one joint: none if they save no error of left-out blocks."""
    scales = {"reach": motion.range(joint), "fast": motion.speed(joint)}
    if not (min(scales.values()) > 0 and residual.any()):
        return []
    asked = [UnnamedTorque(joint, of, **scales) for of in UnnamedTorque.kinds]
    columns = [view.filtered(one.terms_of(motion)) for one in asked]
    kind = np.repeat(np.arange(len(asked)), [own.shape[1] for own in columns])
    X = np.hstack(columns) * view.gains[joint] * view.root[:, [joint]]
    size = np.sqrt((X**2).mean(axis=0))
    size[size == 0] = 1.0
    X /= size
    # Long stretches, as what comes next is, and not blocks among others.
    blocks = view.blocks
    fold = blocks.label * blocks.n_folds // blocks.n_blocks
    folds = [fold == f for f in range(blocks.n_folds)]
    moments = [(X[own].T @ X[own], X[own].T @ residual[own]) for own in folds]
    penalties = np.take(_best(moments, kind, residual.size), kind)
    left = residual.copy()
    for own, without in zip(folds, moments):
        left[own] -= X[own] @ _weights(moments, without, penalties, residual.size)
    before, after = blocks.sums(residual**2), blocks.sums(left**2)
    gain = before - after
    errors = np.sqrt(gain.size) * gain.std(ddof=1)
    if not gain.sum() > max(
        settings.significance * errors, settings.min_gain * before.sum()
    ):
        return []
    weights = _weights(moments, (0.0, 0.0), penalties, residual.size) / size
    return [
        clone(one).set_params(weights=tuple(weights[kind == k].tolist()))
        for k, one in enumerate(asked)
        if weights[kind == k].any()
    ]


def _weights(moments, without, penalties, n):
    """Weights (k,) of all n rows less those of some moments, under penalties (k,)."""
    out, used = np.zeros(penalties.size), np.isfinite(penalties)
    G, right = (sum(each) - less for each, less in zip(zip(*moments), without))
    G = G[np.ix_(used, used)] + n * np.diag(penalties[used])
    out[used] = np.linalg.solve(G, right[used])
    return out


def _best(moments, kind, n):
    """Penalty of each kind of terms with which left-out folds are predicted best."""

    def error(found):
        penalties, total = np.take(found, kind), 0.0
        for G, right in moments:
            w = _weights(moments, (G, right), penalties, n)
            total += w @ G @ w - 2 * w @ right
        return total

    found = np.full(kind.max() + 1, np.inf)
    for k in np.tile(np.arange(found.size), _SWEEPS):
        tried = [np.where(np.arange(found.size) == k, p, found) for p in _PENALTIES]
        found = min(tried, key=error)
    return found
