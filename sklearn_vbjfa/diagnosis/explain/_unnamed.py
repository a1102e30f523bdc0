"""Unnamed joint torque: a basis expansion fitted to the residual of the effects."""

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._held_out import CrossValidatedGain
from sklearn_vbjfa.effects import UnnamedTorque

# Ridge penalties of the terms of one quantity, per row, for columns of unit root mean
# square; infinity omits the terms.
_PENALTIES = (np.inf, 1.0, 0.1, 0.01, 0.001)
_SWEEPS = 2


def unnamed_torques(fit, settings):
    """Fit the residual of a `FinalFit`, a tuple of `UnnamedTorque`."""
    view, (motion, residual), terms = fit.view, _residuals(fit), []
    for joint in np.flatnonzero(view.precision > 0).tolist():
        terms += _fit_joint(view, motion, joint, residual[:, joint], settings)
    return tuple(terms)


def supported_terms(fit, unnamed):
    """Return each `UnnamedTorque` that reduces the residual of its joint."""
    view, (motion, residual) = fit.view, _residuals(fit)
    new = residual.copy()
    for term in unnamed:
        torque = view.filtered(term.terms_of(motion)) @ np.array(term.weights)
        new[:, term.joint] -= torque * view.gains[term.joint] * view.root[:, term.joint]
    helps = (new**2).sum(axis=0) < (residual**2).sum(axis=0)
    return tuple(term for term in unnamed if helps[term.joint])


def _residuals(fit):
    """Return the motion of a fit and its weighted residuals (m, nv)."""
    view, robot = fit.view, fit.identifier.robot_
    motion = view.motion_of(robot.next_load_parameters(), robot.effects_)
    return motion, (view.equations.tau - fit.predicted(robot.theta_)) * view.root


def _fit_joint(view, motion, joint, residual, settings):
    """Fit a joint; return no terms if they do not reduce the cross-validated error."""
    ranges = {"reach": motion.range(joint), "fast": motion.speed(joint)}
    if not (min(ranges.values()) > 0 and residual.any()):
        return []
    terms = [UnnamedTorque(joint, of, **ranges) for of in UnnamedTorque.kinds]
    columns = [view.filtered(term.terms_of(motion)) for term in terms]
    kind = np.repeat(np.arange(len(terms)), [block.shape[1] for block in columns])
    X = np.hstack(columns) * view.gains[joint] * view.root[:, [joint]]
    scale = np.sqrt((X**2).mean(axis=0))
    scale[scale == 0] = 1.0
    X /= scale
    # Contiguous folds emulate the next recording, which interleaved blocks do not.
    blocks = view.blocks
    fold = blocks.label * blocks.n_folds // blocks.n_blocks
    folds = [fold == f for f in range(blocks.n_folds)]
    moments = [(X[rows].T @ X[rows], X[rows].T @ residual[rows]) for rows in folds]
    penalties = np.take(_best_penalties(moments, kind, residual.size), kind)
    error = residual.copy()
    for rows, held_out in zip(folds, moments):
        error[rows] -= X[rows] @ _weights(moments, held_out, penalties, residual.size)
    gain = CrossValidatedGain.of(blocks.sums(residual**2), blocks.sums(error**2))
    if not gain.gain > max(settings.significance * gain.gain_std, settings.min_gain):
        return []
    weights = _weights(moments, (0.0, 0.0), penalties, residual.size) / scale
    return [
        clone(term).set_params(weights=tuple(weights[kind == k].tolist()))
        for k, term in enumerate(terms)
        if weights[kind == k].any()
    ]


def _weights(moments, held_out, penalties, n):
    """Solve the ridge regression without some moments; return weights (k,)."""
    out, included = np.zeros(penalties.size), np.isfinite(penalties)
    G, h = (sum(each) - less for each, less in zip(zip(*moments), held_out))
    G = G[np.ix_(included, included)] + n * np.diag(penalties[included])
    out[included] = np.linalg.solve(G, h[included])
    return out


def _best_penalties(moments, kind, n):
    """Choose the penalty of each quantity by cross-validation over the folds."""

    def squared_error(choice):
        penalties, total = np.take(choice, kind), 0.0
        for G, h in moments:
            w = _weights(moments, (G, h), penalties, n)
            total += w @ G @ w - 2 * w @ h
        return total

    best = np.full(kind.max() + 1, np.inf)
    for k in np.tile(np.arange(best.size), _SWEEPS):
        candidates = [np.where(np.arange(best.size) == k, p, best) for p in _PENALTIES]
        best = min(candidates, key=squared_error)
    return best
