"""Eigen-decomposition of a symmetric matrix in columns scaled to unit diagonal.

Columns of a Gram or covariance matrix may have any unit. With D the roots of its
diagonal, D^-1 A D^-1 = V diag(values) V' is free of units, and a direction counts as
known if its eigenvalue exceeds rounding: rank, pseudo-inverse and null space then do
not depend on the choice of units.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

# Rounding of a zero eigenvalue, as a share of the largest one, per row.
ROUNDING = 4 * float(np.finfo(float).eps)


@dataclass(frozen=True, kw_only=True, eq=False)
class ScaledEigen:
    """Decomposition of A = D V diag(values) V' D, and which directions are known."""

    scale: np.ndarray  # (p,): D; one for a column whose diagonal is not positive
    values: np.ndarray  # (p,): eigenvalues of the scaled matrix, ascending
    vectors: np.ndarray  # (p, p): eigenvectors, in scaled coordinates
    known: np.ndarray  # (p,): directions above the tolerance

    @property
    def rank(self):
        """Number of known directions."""
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

    def by_magnitude(self):
        """Decomposition with the magnitudes of the eigenvalues, none below rounding."""
        # A Newton step with it is an ascent, whatever the signs of the curvature.
        size = np.abs(self.values)
        floor = size.size * np.finfo(float).eps * size[-1]
        known = np.ones(size.size, dtype=bool)
        return replace(self, values=np.maximum(size, floor), known=known)

    def root(self):
        """F of shape (rank, p) with F'F = A without its null space."""
        return (self.known_vectors * np.sqrt(self.known_values)).T * self.scale

    def inverse_root(self):
        """L of shape (p, rank) with L L' the pseudo-inverse of A in scaled columns."""
        return self.known_vectors / np.sqrt(self.known_values) / self.scale[:, None]

    def inverse(self):
        """Pseudo-inverse of A in scaled columns, ndarray of shape (p, p)."""
        V = self.known_vectors
        scaled = (V * (1.0 / self.known_values)) @ V.T
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
        diagonal = np.diagonal(A)
        scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scale = np.broadcast_to(np.asarray(scale, dtype=float), (p,))
    values, vectors = linalg.eigh(A / np.outer(scale, scale))
    limit = p * ROUNDING if tolerance is None else tolerance
    if relative:
        limit = limit * max(values[-1], 0.0) if p else limit
    return ScaledEigen(
        scale=scale, values=values, vectors=vectors, known=values > limit
    )
