"""Weights of the joints' equations, and of blocks of time, from their residuals."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa._core._linear_systems import ROUNDING, scaled_eigen
from sklearn_vbjfa.robot._joint_moments import sum_moments


def least_squares(G, g):
    """Minimum-norm solution in columns scaled to unit diagonal."""
    return scaled_eigen(G, 2 * ROUNDING * G.shape[0]).solve(g)


def noise_weights(moments, max_iter=30, tol=1e-6):
    """Inverse residual variance of each joint by iterated weighted least squares."""
    # Starts from the mean squared torques, so the unit of a joint's torque does not
    # matter; a joint without rows gets zero weight.
    used = moments.n > 0
    n = np.where(used, moments.n, 1.0)
    variance = np.where(used & (moments.yy > 0), moments.yy / n, np.inf)
    for _ in range(max_iter):
        weight = 1.0 / variance
        theta = least_squares(
            np.einsum("j,jik->ik", weight, moments.G), weight @ moments.g
        )
        new = moments.residual_squares(theta) / n
        new = np.where(np.isfinite(variance), new, np.inf)
        # An exactly fitted joint would get infinite weight.
        new = np.maximum(new, 1e-12 * np.where(used, moments.yy / n, np.inf))
        new = np.where(new > 0, new, np.inf)
        finite = np.isfinite(new)
        change = np.abs(new[finite] / variance[finite] - 1)
        variance = new
        if change.size == 0 or change.max() < tol:
            break
    return 1.0 / variance


# Degrees of freedom of Student's t; the customary value for robust regression without
# tuning (Lange, Little and Taylor, 1989).
_STUDENT_FREEDOM = 4.0


def block_precisions(pieces, blocks, max_iter=20, tol=1e-3):
    """Relative precision of each joint's noise in each block of time, by EM."""
    # Residuals are Gaussian with a precision of their own in every block, Gamma(nu/2,
    # nu/2) times the joint's: a multivariate Student t. Model errors (stiction,
    # transients) are confined to intervals of time, which are then down-weighted.
    # Parameters are fitted by weighted least squares in between. blocks: block number
    # (n,) of each row of each piece; returns weight factors (n, nv), near one, for each
    # piece.
    n_blocks = 1 + max(int(block.max()) for block in blocks)
    nv = pieces[0].tau.shape[1]
    nu = _STUDENT_FREEDOM
    factor = np.ones((n_blocks, nv))
    count = sum(_by_block(one.weight, b, n_blocks) for one, b in zip(pieces, blocks))
    for _ in range(max_iter):
        moments = _sum_moments(pieces, blocks, factor)
        weight = noise_weights(moments)
        theta = least_squares(
            np.einsum("j,jik->ik", weight, moments.G), weight @ moments.g
        )
        squares = sum(
            _by_block(one.weight * (one.tau - one.Phi @ theta) ** 2, b, n_blocks)
            for one, b in zip(pieces, blocks)
        )
        scaled = squares * weight
        new = (nu + count) / (nu + scaled)
        new = np.where(count > 0, new, 1.0)
        change = np.abs(new / factor - 1).max()
        factor = new
        if change < tol:
            break
    return [factor[b] for b in blocks]


def _by_block(values, block, n_blocks):
    out = np.zeros((n_blocks, values.shape[1]))
    np.add.at(out, block, values)
    return out


def _sum_moments(pieces, blocks, factor):
    return sum_moments(
        reweighted_moments(replace(one, difference=None, blocks=None), factor[block])
        for one, block in zip(pieces, blocks)
    )


def reweighted_moments(one, factor):
    """Moments of equations with weights times (n, nv); the number of rows is kept."""
    return replace(one.reweighted(factor).moments(), n=one.weight.sum(axis=0))
