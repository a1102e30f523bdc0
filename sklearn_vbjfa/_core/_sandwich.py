"""Variance of a least-squares estimate whose residuals are correlated in time.

A block sandwich estimator from second moments and scores of blocks of time. Residuals
are smaller than the noise, as the fit absorbs part of it in each block; the correction
is exact for white noise.
"""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa._core._linear_systems import scaled_eigen

# Directions of the scaled Gram matrix below this count as undetermined.
_RANK = 1e-10
# Blocks are merged in pairs until neighbours are less correlated than this, as long as
# this many are left.
_NEIGHBOURS = 0.08
_FEWEST = 16
# Smallest factor for the correlation of neighbours, where it is negative.
_LEAST_REACH = 0.5
# A parameter of which the blocks determine little beyond the fit itself takes the mean
# factor of the others.
_OWN = 0.2


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockVariance:
    """Effect of residual correlation in time on the variance of an estimate."""

    factor: np.ndarray  # (p,): ratio of the variance to that for white residuals
    freedom: np.ndarray  # (p,): degrees of freedom of the variance
    white: np.ndarray  # (p,): variance for white residuals of the given noise
    # (n_blocks, p): what each block adds to the error of the estimate, of covariance
    # ``scores.T @ scores``; nan where the blocks show nothing of it, zero if
    # undetermined
    scores: np.ndarray
    # ratio of the variances, in the mean of all directions that are determined
    pooled: float


def block_variance(grams, scores, place, noise=1.0):
    """Compare the scatter of scores between blocks with that of white residuals."""
    # grams (n_blocks, p, p): weighted second moments of each block's rows; scores
    # (n_blocks, p): rows times residuals, weighted alike; place (n_blocks, 2): the
    # recording of a block and its number there, sorted; noise: weighted mean square of
    # the residuals. Undetermined parameters come out as nan.
    H = grams.sum(axis=0)
    used = np.diagonal(H) > 0
    # H^-1 = L L'
    L = np.where(used[:, None], scaled_eigen(H, _RANK).inverse_root(), 0.0)
    K = L.T @ (grams @ L)
    s = scores @ L
    place = np.array(place)
    while True:
        pooled = _pooled(K, s, noise)
        neighbours = _neighbours(K, s, place, noise * pooled)
        if neighbours < _NEIGHBOURS or K.shape[0] < 2 * _FEWEST:
            break
        K, s, place = _join(K, s, place)
    d = s @ L.T
    through = K @ L.T
    # Variance of each block without the fit, and what the fit leaves of it.
    own = np.einsum("ir,bri->bi", L, through)
    left = own - (through**2).sum(axis=1)
    white, expected = (L**2).sum(axis=1), noise * np.maximum(left, 0.0).sum(axis=0)
    seen = expected > _OWN * noise * white
    reach = max(1.0 + 2.0 * neighbours, _LEAST_REACH)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.where(seen, (d**2).sum(axis=0) / expected, pooled)
        count = np.maximum(left, 0.0)
        freedom = count.sum(axis=0) ** 2 / (count**2).sum(axis=0)
        factor = factor * reach
        variance = factor * noise * white
        scale = np.sqrt(variance / (d**2).sum(axis=0))
    # Scores of zero cannot be scaled to a variance: it is not known how the error goes
    # together with others, and must not count as none.
    lost = used & (variance > 0) & ~np.isfinite(scale)
    return BlockVariance(
        factor=np.where(used, factor, np.nan),
        freedom=np.where(seen & used, np.maximum(freedom, 1.0), np.nan),
        white=np.where(used, noise * white, np.nan),
        scores=np.where(lost, np.nan, np.where(np.isfinite(scale), scale, 0.0) * d),
        pooled=pooled * reach,
    )


def _pooled(K, s, noise):
    """Mean variance factor over all determined directions."""
    # Of a single block a fit leaves nothing but rounding.
    all_rows = np.trace(K, axis1=1, axis2=2).sum()
    left = all_rows - np.vdot(K, K)
    seen = noise > 0 and left > _RANK * all_rows
    return float((s**2).sum() / (noise * left)) if seen else 1.0


def _neighbours(K, s, place, noise):
    """Correlation of the scores (n_blocks, r) of adjacent blocks."""
    # For independent blocks, the fit makes their expected product -K_b K_c.
    step = np.diff(place, axis=0)
    follows = (step[:, 0] == 0) & (step[:, 1] == 1)
    squares = (s**2).sum() + noise * np.vdot(K, K)
    if not follows.any() or squares == 0:
        return 0.0
    products = np.einsum("br,br->b", s[:-1], s[1:])
    products += noise * np.einsum("brs,brs->b", K[:-1], K[1:])
    return float(products[follows].mean() / (squares / s.shape[0]))


def _join(K, s, place):
    """Join blocks in pairs, within their recordings."""
    place = np.column_stack([place[:, 0], place[:, 1] // 2])
    new = np.r_[True, (np.diff(place, axis=0) != 0).any(axis=1)]
    starts = np.flatnonzero(new)
    return (
        np.add.reduceat(K, starts, axis=0),
        np.add.reduceat(s, starts, axis=0),
        place[starts],
    )
