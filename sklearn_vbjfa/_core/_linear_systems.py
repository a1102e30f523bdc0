"""Linear systems in scaled columns: eigenvalues, least squares, block variances.

Columns of data, or of a Gram or covariance matrix, may have any unit. Scaled to unit
length, or to a unit diagonal, a direction counts as known if its singular value exceeds
rounding: rank, pseudo-inverse and null space then do not depend on the choice of units.
"""

from collections import namedtuple
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import csgraph

# Rounding of a constant column is a few units in the last place of its values; a
# spread below this fraction of its mean carries no data.
CONSTANT_COLUMN = 32 * float(np.finfo(float).eps)
# Rounding of a zero eigenvalue, as a share of the largest one, per row.
ROUNDING = 4 * float(np.finfo(float).eps)


def is_constant(spread, mean):
    """Whether columns are constant up to rounding, in any unit."""
    # spread, mean: standard deviations and means; for uncentred columns root mean
    # squares and zeros, then a column is constant only if it is zero.
    noise = CONSTANT_COLUMN * np.abs(mean)
    return spread <= np.maximum(noise, np.finfo(np.float64).tiny)


def or_one(sizes):
    """Return divisors: sizes, with one in place of values that are not positive."""
    return np.where(sizes > 0, sizes, 1.0)


# Columns sqrt(weight) (X - mean) / scale (n, d) of unit length, 0 if constant; weighted
# means (d,), zero without centring; and lengths (d,), one if constant.
UnitColumns = namedtuple("UnitColumns", "values mean scale")


def unit_columns(X, weight, *, center):
    """Centre columns X (n, d) at means of weights (n,) > 0, scale to unit length."""
    # Dividing by the largest magnitude keeps squares from overflowing, and a second
    # pass removes the rounding of the first mean: units and offsets do not matter.
    total = weight.sum()
    magnitude = or_one(np.maximum(X.max(axis=0), -X.min(axis=0)))
    values = X / magnitude
    mean = np.zeros(X.shape[1])
    if center:
        for _ in range(2):
            shift = weight @ values / total
            values -= shift
            mean += shift
    values *= np.sqrt(weight)[:, np.newaxis]
    length = np.sqrt(np.einsum("ij,ij->j", values, values))
    constant = is_constant(length / np.sqrt(total), mean)
    values[:, constant] = 0.0
    length[constant] = 1.0
    values /= length
    scale = np.where(constant, 1.0, magnitude * length)
    return UnitColumns(values, mean * magnitude, scale)


def svd(matrix, *, full_matrices=True):
    """Return U, s, Vt of the singular value decomposition."""
    try:
        return np.linalg.svd(matrix, full_matrices=full_matrices)
    except linalg.LinAlgError:
        # Divide and conquer does not converge for some matrices with columns or rows of
        # zeros; QR iterations, which take longer, do.
        return linalg.svd(matrix, full_matrices=full_matrices, lapack_driver="gesvd")


def rank_tolerance(matrix):
    """Relative rounding of the singular values of a matrix of this shape."""
    return 10 * max(matrix.shape) * np.finfo(np.float64).eps


def orthonormal_basis(matrix):
    """Orthonormal basis of the column space, columns scaled to one length first."""
    length = or_one(np.linalg.norm(matrix, axis=0))
    U, s, _ = svd(matrix / length, full_matrices=False)
    return U[:, s > rank_tolerance(matrix) * s.max(initial=0.0)]


# Solution (d,), pseudo-inverse (d, d) of the Gram matrix, which coefficients (d,) are
# the same in all solutions, and the rank of the scaled columns.
ScaledSolution = namedtuple("ScaledSolution", "coef inverse identified rank")


def scaled_lstsq(matrix, target):
    """Least squares, of minimum norm among the columns scaled to one length."""
    length = or_one(np.linalg.norm(matrix, axis=0))
    U, s, Vt = svd(matrix / length)
    rank = int(np.sum(s > rank_tolerance(matrix) * s.max(initial=0.0)))
    basis = Vt[:rank].T / s[:rank]
    coef = basis @ (U[:, :rank].T @ target) / length
    inverse = basis @ basis.T / np.outer(length, length)
    identified = np.linalg.norm(Vt[rank:], axis=0) <= np.sqrt(np.finfo(float).eps)
    return ScaledSolution(coef, inverse, identified, rank)


@dataclass(frozen=True, kw_only=True, eq=False)
class ScaledEigen:
    """Decomposition of A = D V diag(values) V' D, and which directions are known."""

    scale: np.ndarray  # (p,): D; one for a column whose diagonal is not positive
    values: np.ndarray  # (p,): eigenvalues of the scaled matrix, ascending
    vectors: np.ndarray  # (p, p): eigenvectors, in scaled coordinates
    known: np.ndarray  # (p,): directions above the tolerance

    @property
    def rank(self):
        return int(self.known.sum())

    @property
    def known_values(self):
        """Eigenvalues of the known directions, ndarray of shape (rank,)."""
        return self.values[self.known]

    @property
    def known_vectors(self):
        """Known directions in scaled coordinates, ndarray of shape (p, rank)."""
        return self.vectors[:, self.known]

    @property
    def null_space(self):
        """Directions that are not known, in scaled coordinates, (p, p - rank)."""
        return self.vectors[:, ~self.known]

    def lost(self, share):
        """Columns (p,), bool, with more than this share in the null space."""
        return (self.null_space**2).sum(axis=1) > share

    def matrix(self):
        """Return A without its null space, ndarray of shape (p, p)."""
        values = np.where(self.known, self.values, 0.0)
        scaled = (self.vectors * values) @ self.vectors.T
        return scaled * np.outer(self.scale, self.scale)

    def root(self):
        """F of shape (rank, p) with F'F = A without its null space."""
        return (self.known_vectors * np.sqrt(self.known_values)).T * self.scale

    def inverse_root(self):
        """L of shape (p, rank) with L L' the pseudo-inverse of A in scaled columns."""
        return self.known_vectors / np.sqrt(self.known_values) / self.scale[:, None]

    def inverse(self):
        """Pseudo-inverse of A in scaled columns, ndarray of shape (p, p)."""
        V = self.known_vectors
        scaled = (V / self.known_values) @ V.T
        return scaled / np.outer(self.scale, self.scale)

    def solve(self, b):
        """Minimum-norm solution x of A x = b, (p,) or (p, k), in scaled columns."""
        V, scale = self.known_vectors, self.scale
        values = self.known_values
        if b.ndim == 2:
            scale, values = scale[:, None], values[:, None]
        return V @ ((V.T @ (b / scale)) / values) / scale


def scaled_eigen(A, tolerance=None, *, scale=None, relative=True):
    """Decompose a symmetric matrix (p, p) in columns of a scale."""
    # scale (p,): the root of the diagonal if None; 1.0 takes A as it is.
    # tolerance: share of the largest eigenvalue above which a direction is known, by
    # default the rounding of p rows; with relative=False the eigenvalue itself.
    p = A.shape[0]
    if scale is None:
        scale = np.sqrt(or_one(np.diagonal(A)))
    scale = np.broadcast_to(np.asarray(scale, dtype=float), (p,))
    values, vectors = _eigen(A / np.outer(scale, scale))
    limit = p * ROUNDING if tolerance is None else tolerance
    if relative:
        limit = limit * max(values[-1], 0.0) if p else limit
    known = values > limit
    return ScaledEigen(scale=scale, values=values, vectors=vectors, known=known)


def solve_spd(A, b, least=1.0, parts=()):
    """Solve A x = b with eigenvalues of A >= `least`; x, inverse, log determinant."""
    # parts: indices of the equations of each uncoupled part, if there are several.
    if len(parts) > 1:
        x, inverse, log_det = np.empty(b.shape), np.zeros(A.shape), 0.0
        for rows in parts:
            block = np.ix_(rows, rows)
            x[rows], inverse[block], size = solve_spd(A[block], b[rows], least)
            log_det += size
        return x, inverse, log_det
    root, failed = linalg.lapack.dpotrf(A, lower=True)
    if failed:
        # Some entries may be so large that rounding exceeds the smallest eigenvalue.
        values, vectors = np.linalg.eigh(A)
        values = np.maximum(values, max(least, 1e-13 * values[-1]))
        inverse = (vectors / values) @ vectors.T
        return inverse @ b, inverse, np.log(values).sum()
    inverse, _ = linalg.lapack.dpotri(root, lower=True)
    inverse += np.tril(inverse, -1).T
    x = linalg.cho_solve((root, True), b)
    return x, inverse, 2.0 * np.log(np.diagonal(root)).sum()


def branches(support):
    """Return the connected components of a table (n, p), bool: (rows, columns)."""
    used = np.flatnonzero(support.any(axis=1))
    entries = support[used].astype(int)
    rows = [used[part] for part in components(entries @ entries.T)]
    return [(some, np.flatnonzero(support[some].any(axis=0))) for some in rows]


def components(links):
    """Return the indices of the connected components of a matrix (p, p), a list."""
    # Dense input would be validated as a masked array, which takes longer.
    links = sparse.csr_array(links != 0)
    count, label = csgraph.connected_components(links, directed=False)
    return [np.flatnonzero(label == k) for k in range(count)]


def _eigen(A):
    """Eigenvalues, ascending, and vectors of a symmetric matrix (p, p)."""
    rows, vectors = components(A) or [np.arange(0)], np.empty(A.shape)
    pairs = [linalg.eigh(A[np.ix_(block, block)]) for block in rows]
    values = np.concatenate([w for w, _ in pairs])
    vectors[np.concatenate(rows)] = linalg.block_diag(*(V for _, V in pairs))
    order = np.argsort(values, kind="stable")
    return values[order], vectors[:, order]


# -- residuals that are correlated in time ---------------------------------------------

# Directions of the scaled Gram matrix below this count as undetermined.
_RANK = 1e-10
# Blocks are merged in pairs until the correlation of neighbours is below this, but not
# to fewer blocks than this.
_NEIGHBOURS = 0.08
_FEWEST = 16
# Smallest factor for the correlation of neighbours, where it is negative.
_LEAST_REACH = 0.5
# A parameter takes the mean factor of the others if the fit leaves less than this share
# of the variance of its block scores.
_OWN = 0.2


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockVariance:
    """Effect of residual correlation in time on the variance of an estimate."""

    factor: np.ndarray  # (p,): ratio of the variance to that for white residuals
    freedom: np.ndarray  # (p,): degrees of freedom of the variance
    white: np.ndarray  # (p,): variance for white residuals of the given noise
    # (n_blocks, p): contribution of each block to the error of the estimate, whose
    # covariance is ``scores.T @ scores``; nan if the scores are zero, zero for
    # undetermined parameters
    scores: np.ndarray
    # ratio of the variances, averaged over all determined directions
    pooled: float


def block_variance(parts, scores, place, noise=1.0):
    """Compare the scatter of scores between blocks with that of white residuals."""
    # A block sandwich estimator, exact for white noise. parts: indices (k,) of
    # parameters without equations in common with others, and weighted second moments
    # (n_blocks, k, k); scores (n_blocks, p): rows times residuals; place (n_blocks, 2):
    # recording of a block and its number there; noise: mean square of the residuals.
    # Undetermined parameters get nan.
    shape, place = scores.shape, np.array(place)
    white, used = np.zeros(shape[1]), np.zeros(shape[1], dtype=bool)
    roots = _inverse_roots([grams.sum(axis=0) for _, grams in parts])
    K = [L.T @ (grams @ L) for (_, grams), L in zip(parts, roots)]
    s = [scores[:, rows] @ L for (rows, _), L in zip(parts, roots)]
    while True:
        pooled = _pooled(K, s, noise)
        neighbours = _neighbours(K, s, place, noise * pooled)
        if neighbours < _NEIGHBOURS or len(place) < 2 * _FEWEST:
            break
        K, s, place = _join(K, s, place)
    d, left = np.zeros((2, len(place), shape[1]))
    for (rows, grams), L, scaled, score in zip(parts, roots, K, s):
        used[rows] = np.einsum("bii->i", grams) > 0
        white[rows] = (L**2).sum(axis=1)
        d[:, rows] = score @ L.T
        # Variance of each block without the fit, and after it.
        through = scaled @ L.T
        alone = np.einsum("ir,bri->bi", L, through)
        left[:, rows] = alone - (through**2).sum(axis=1)
    expected = noise * np.maximum(left, 0.0).sum(axis=0)
    seen = expected > _OWN * noise * white
    reach = max(1.0 + 2.0 * neighbours, _LEAST_REACH)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = reach * np.where(seen, (d**2).sum(axis=0) / expected, pooled)
        count = np.maximum(left, 0.0)
        freedom = count.sum(axis=0) ** 2 / (count**2).sum(axis=0)
        variance = factor * noise * white
        scale = np.sqrt(variance / (d**2).sum(axis=0))
    # Scores of zero cannot be scaled to a variance: the covariance with other
    # parameters is unknown, not zero.
    lost = used & (variance > 0) & ~np.isfinite(scale)
    return BlockVariance(
        factor=np.where(used, factor, np.nan),
        freedom=np.where(seen & used, np.maximum(freedom, 1.0), np.nan),
        white=np.where(used, noise * white, np.nan),
        scores=np.where(lost, np.nan, np.where(np.isfinite(scale), scale, 0.0) * d),
        pooled=pooled * reach,
    )


def _inverse_roots(matrices):
    """Return L (k, r) of each matrix (k, k), whose pseudo-inverse is L L'."""
    eigen = [scaled_eigen(H, 0.0, relative=False) for H in matrices]
    limit = _RANK * max((e.values[-1] for e in eigen if e.values.size), default=0)
    roots = (replace(e, known=e.values > limit).inverse_root() for e in eigen)
    excited = (np.diagonal(H)[:, None] > 0 for H in matrices)
    return [np.where(used, L, 0.0) for used, L in zip(excited, roots)]


def _pooled(K, s, noise):
    """Mean variance factor over all determined directions."""
    # With a single block, only rounding is left after the fit.
    all_rows = sum(np.einsum("brr->", block) for block in K)
    left = all_rows - sum(np.vdot(block, block) for block in K)
    seen = noise > 0 and left > _RANK * all_rows
    return float(sum((x**2).sum() for x in s) / (noise * left)) if seen else 1.0


def _neighbours(K, s, place, noise):
    """Correlation of the scores (n_blocks, r) of adjacent blocks."""
    # For independent blocks the expected product after the fit is -K_b K_c.
    step = np.diff(place, axis=0)
    follows = (step[:, 0] == 0) & (step[:, 1] == 1)
    squares = sum((x**2).sum() for x in s) + noise * sum(np.vdot(x, x) for x in K)
    if not follows.any() or squares == 0:
        return 0.0
    products = sum(np.einsum("br,br->b", x[:-1], x[1:]) for x in s)
    products += noise * sum(np.einsum("brs,brs->b", x[:-1], x[1:]) for x in K)
    return float(products[follows].mean() / (squares / len(place)))


def _join(K, s, place):
    """Join blocks in pairs, within their recordings."""
    place = np.column_stack([place[:, 0], place[:, 1] // 2])
    new = np.r_[True, (np.diff(place, axis=0) != 0).any(axis=1)]
    starts = np.flatnonzero(new)
    K, s = ([np.add.reduceat(x, starts, axis=0) for x in parts] for parts in (K, s))
    return K, s, place[starts]
