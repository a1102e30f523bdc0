"""Least squares on columns of unit length, and total least squares.

The alternatives to the joint factor models work on the rows or a triangular factor of
them; columns are first scaled to unit length, so that ranks do not depend on units.
"""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa._core._moments import is_constant

# Relative distance of squared singular values below which total least squares is
# nongeneric: nearer than this, half of the solution's digits are rounding.
NONGENERIC = np.sqrt(np.finfo(np.float64).eps)


@dataclass(frozen=True, kw_only=True)
class UnitColumns:
    """Columns of unit length, weighted by the square root of the row weights."""

    # (n_samples, n_features): ``sqrt(weight) * (X - mean) / scale``; 0 if constant
    values: np.ndarray
    mean: np.ndarray  # (n_features,): weighted means; zero without centring
    # (n_features,): lengths of the centred, weighted columns; one if constant
    scale: np.ndarray


def unit_columns(X, weight, *, center):
    """Centre columns X (n, d) at means of weights (n,) > 0, scale to unit length."""
    # Dividing by the largest magnitude keeps squares from overflowing, and a second
    # pass removes the rounding of the first mean: any unit and offset is treated alike.
    total = weight.sum()
    magnitude = np.maximum(X.max(axis=0), -X.min(axis=0))
    magnitude = np.where(magnitude > 0, magnitude, 1.0)
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
    return UnitColumns(values=values, mean=mean * magnitude, scale=scale)


def rank_tolerance(matrix):
    """Relative rounding of the singular values of a matrix of this shape."""
    return 10 * max(matrix.shape) * np.finfo(np.float64).eps


def orthonormal_basis(matrix):
    """Orthonormal basis of the column space, columns scaled to one length first."""
    length = np.linalg.norm(matrix, axis=0)
    scaled = matrix / np.where(length > 0, length, 1.0)
    U, s, _ = np.linalg.svd(scaled, full_matrices=False)
    if s.size == 0:
        return U
    return U[:, s > rank_tolerance(matrix) * s[0]]


@dataclass(frozen=True, kw_only=True)
class ScaledSolution:
    """Least squares in scaled columns."""

    coef: np.ndarray  # (n_features,): solution
    # (n_features, n_features): pseudo-inverse of their Gram matrix, scaled back
    inverse: np.ndarray
    # (n_features,): coefficients that are the same in all solutions
    identified: np.ndarray
    rank: int  # rank of the scaled columns


def scaled_lstsq(matrix, target):
    """Least squares, of minimum norm among the columns scaled to one length."""
    length = np.linalg.norm(matrix, axis=0)
    length = np.where(length > 0, length, 1.0)
    U, s, Vt = np.linalg.svd(matrix / length, full_matrices=True)
    rank = int(np.sum(s > rank_tolerance(matrix) * s.max(initial=0.0)))
    basis = Vt[:rank].T / s[:rank]
    coef = basis @ (U[:, :rank].T @ target) / length
    inverse = basis @ basis.T / np.outer(length, length)
    identified = np.linalg.norm(Vt[rank:], axis=0) <= np.sqrt(np.finfo(float).eps)
    return ScaledSolution(coef=coef, inverse=inverse, identified=identified, rank=rank)


def mixed_tls(columns, target, exact):
    """Mixed least squares - total least squares; coefficients (d,) and rank."""
    # All columns (n, d) but the `exact` ones (d,) have noise of the same variance as
    # the target (n,). Golub, Hoffman & Stewart (1987): the exact columns are eliminated
    # by orthogonal projection, the rest is a classical problem, and back-substitution
    # gives their coefficients.
    coef = np.zeros(columns.shape[1])
    basis = orthonormal_basis(columns[:, exact])
    noisy = columns[:, ~exact]
    # What elimination leaves of a column in the span of the exact ones is rounding
    # of the column itself, not of its remainder.
    floor = rank_tolerance(columns) * np.linalg.norm(noisy)
    coef[~exact], rank = _classical_tls(
        noisy - basis @ (basis.T @ noisy),
        target - basis @ (basis.T @ target),
        floor,
    )
    rest = target - noisy @ coef[~exact]
    coef[exact] = scaled_lstsq(columns[:, exact], rest).coef
    return coef, rank + basis.shape[1]


def _classical_tls(columns, target, floor):
    """Minimum-norm total least squares; singular values below `floor` are zero."""
    # With X = U S V', the singular value decomposition of [X y] is that of the small
    # matrix [[S, c], [0, rho]], c = U'y and rho the norm of y outside the span of X.
    # With sigma_k(X) = sigma_{k+1}([X y]) there is no finite solution, or many: then,
    # following Van Huffel & Vandewalle (1991), the last direction of V is dropped.
    U, s, Vt = np.linalg.svd(columns, full_matrices=False)
    rank = int(np.sum(s > floor))
    along = U.T @ target
    rest = np.linalg.norm(target - U[:, :rank] @ along[:rank])
    while rank > 0:
        arrow = np.zeros((rank + 1, rank + 1))
        arrow[np.arange(rank), np.arange(rank)] = s[:rank]
        arrow[:rank, rank] = along[:rank]
        arrow[rank, rank] = rest
        _, sigma, Wt = np.linalg.svd(arrow)
        if 1 - (sigma[-1] / s[rank - 1]) ** 2 > NONGENERIC:
            # The normal of the fitted hyperplane, with y's element scaled to -1.
            normal = Wt[-1]
            return Vt[:rank].T @ (-normal[:rank] / normal[rank]), rank
        rank -= 1
        rest = np.hypot(rest, along[rank])
    return np.zeros(columns.shape[1]), 0
