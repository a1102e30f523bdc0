"""Uncertainty that respects correlation in time."""

import numpy as np
from scipy import linalg

# Relative step of the derivative by a shape parameter.
_STEP = 1e-3


def effect_covariances(search):
    """Covariances of each accepted effect's coefficients and shape parameters.

    Least squares with the sandwich over blocks of time: what the residuals of a block
    have in common counts once. The residuals are out of sample, which makes up for
    the number of parameters. Shape parameters enter by their derivatives.

    Parameters
    ----------
    search : EffectSearch
        After its run.

    Returns
    -------
    list of ndarray
        One covariance for each accepted effect: coefficients, then continuous shape
        parameters.
    """
    view, base = search.view, search.base
    columns, places = [base.Z[:, :, : view.Z.shape[2]]], []
    at = view.Z.shape[2]
    for effect in search.accepted:
        own = _effect_columns(search, effect)
        places.append(slice(at, at + own.shape[2]))
        at += own.shape[2]
        columns.append(own)
    A = np.concatenate(columns, axis=2)
    scale = np.sqrt(np.einsum("j,jma,jma->a", view.precision, A, A))
    unit = np.where(scale > 0, scale, 1.0)
    A = A / unit
    H = np.einsum("j,jma,jmb->ab", view.precision, A, A, optimize=True)
    residual = base.residuals()
    score = np.einsum("j,jma,jm->ma", view.precision, A, residual, optimize=True)
    blocks = view.blocks.sums(score)
    n = blocks.shape[0]
    meat = blocks.T @ blocks * n / max(n - 1, 1)
    inverse = linalg.pinvh(H, rtol=1e-10)
    covariance = inverse @ meat @ inverse / np.outer(unit, unit)
    return [covariance[p, p] for p in places]


def _effect_columns(search, effect):
    """Columns of an effect and their derivatives by its continuous parameters."""
    from sklearn.base import clone

    view = search.view
    joints = view.joints_of(effect)
    own = view.columns([effect], search.motion)[:, :, 0]
    coef = search.coefficients(effect)
    pieces = [own]
    for name in effect.continuous:
        value = getattr(effect, name)
        step = _STEP * abs(value) or _STEP
        sides = [
            view.columns(
                [clone(effect).set_params(**{name: value + way * step})],
                search.motion,
            )[:, :, 0]
            @ coef
            for way in (0.5, -0.5)
        ]
        pieces.append(((sides[0] - sides[1]) / step)[:, :, None])
    out = np.zeros((view.nv, own.shape[1], sum(p.shape[2] for p in pieces)))
    out[joints] = np.concatenate(pieces, axis=2)
    return out


def bootstrap_errors(before, after, block_seconds, step, random_state, n_draws=2000):
    """Block-bootstrap intervals of the normalised errors before and after.

    Parameters
    ----------
    before, after : TorqueResiduals
        Residuals of the two models on the same rows.
    block_seconds : float
        Length of a block [s].
    step : float
        Time between rows [s].
    random_state : RandomState
        Source of the draws.
    n_draws : int
        Number of resamples.

    Returns
    -------
    dict of str to ndarray
        ``"before"``, ``"after"``, ``"difference"``: 5 and 95 % quantiles of each
        joint's error and of after minus before, arrays (2, nv).
    """
    m, nv = before.torque.shape
    length = int(np.clip(round(block_seconds / step), 1, max(m // 8, 1)))
    label = np.arange(m) // length
    n_blocks = label[-1] + 1
    sums = []
    for residuals in (before, after):
        squares = np.zeros((n_blocks, nv))
        np.add.at(squares, label, residuals.weight * residuals.residual**2)
        sums.append(squares)
    weight = np.zeros((n_blocks, nv))
    np.add.at(weight, label, before.weight)
    total = before.weight.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (before.weight * before.torque).sum(axis=0) / total
        spread = (before.weight * (before.torque - mean) ** 2).sum(axis=0) / total
        draws = random_state.randint(n_blocks, size=(n_draws, n_blocks))
        counts = np.zeros((n_draws, n_blocks))
        np.add.at(counts, (np.arange(n_draws)[:, None], draws), 1.0)
        errors = [np.sqrt(counts @ s / (counts @ weight) / spread) for s in sums]
    both = {
        "before": errors[0],
        "after": errors[1],
        "difference": errors[1] - errors[0],
    }
    with np.errstate(invalid="ignore"):
        return {
            key: np.quantile(value, [0.05, 0.95], axis=0) for key, value in both.items()
        }
