"""The projection as a convex programme: data, consistent starts, optimality bound."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from sklearn_vbjfa.physical._pseudo_inertia import (
    N_INERTIAL,
    constraint_matrix,
    inertial_parameters,
    min_eigenvalue,
)


@dataclass(frozen=True, kw_only=True)
class ConicProblem:
    """The projection in scaled variables.

    Attributes
    ----------
    constraint : {"pseudo-inertia", "eq30"}
        Which matrix of a body has to be positive definite.
    body_columns : ndarray of int of shape (n_bodies, 10)
        Columns of every body.
    nonnegative : ndarray of int
        Columns that must not be negative.
    margin : float
        Least eigenvalue (dimensionless) of every body's matrix.
    point : ndarray of shape (n_features,)
        The vector to project, divided by the units.
    root : ndarray of shape (n_features, n_features)
        Upper triangular `T`: metric and pull to the anchor as one square root.
    shift : ndarray of shape (n_features,)
        `c`: the distance of a vector is ``|T (vector - point) - c|``.
    n_hidden : int
        Dimensions that the metric does not see, and the anchor alone determines.
    """

    constraint: str
    body_columns: np.ndarray
    nonnegative: np.ndarray
    margin: float
    point: np.ndarray
    root: np.ndarray
    shift: np.ndarray
    n_hidden: int

    @property
    def n_features(self):
        """Length of the parameter vector."""
        return self.point.size

    def residual(self, vector):
        """T (vector - point) - c, shape (n_features,)."""
        return self.root @ (vector - self.point) - self.shift

    def distance(self, vector):
        """Norm of the residual."""
        return float(np.linalg.norm(self.residual(vector)))

    @cached_property
    def generators(self):
        """Matrices of the ten unit bodies, shape (10, n, n), n = 4 or 6."""
        return constraint_matrix(np.eye(N_INERTIAL), self.constraint)

    def slack(self, vector):
        """Matrices that must be positive semidefinite, shape (n_bodies, n, n)."""
        matrices = constraint_matrix(vector[self.body_columns], self.constraint)
        return matrices - self.margin * np.eye(matrices.shape[-1])

    def min_eigenvalues(self, vector):
        """Smallest eigenvalue of each body's matrix, shape (n_bodies,)."""
        return min_eigenvalue(vector[self.body_columns], self.constraint)


def make_problem(
    point,
    *,
    constraint,
    body_columns,
    nonnegative,
    margin,
    metric_root,
    anchor,
    anchor_weight,
):
    """Assemble the programme from scaled quantities.

    Parameters
    ----------
    point : ndarray of shape (n_features,)
        Vector to project, in units of the scales.
    constraint : {"pseudo-inertia", "eq30"}
        Constraint set.
    body_columns : ndarray of int of shape (n_bodies, 10)
        Columns of every body.
    nonnegative : ndarray of int
        Columns that must not be negative.
    margin : float
        Least eigenvalue of every body's matrix.
    metric_root : ndarray of shape (n_features, n_features)
        Square root of the metric in scaled variables, largest column norm one (or
        zero).
    anchor : ndarray of shape (n_features,)
        Where what the metric does not see is pulled, in units of the scales.
    anchor_weight : float
        Weight of that pull.

    Returns
    -------
    problem : ConicProblem
        The programme.
    """
    # |R x|^2 + w |N'(x - a)|^2 as one triangular factor: the stacked QR does not square
    # the condition number as R'R would.
    hidden = _null_space(metric_root)
    pull = np.sqrt(anchor_weight) * hidden.T
    right = np.zeros(len(metric_root) + len(pull))
    right[len(metric_root) :] = pull @ (anchor - point)
    Q, root = np.linalg.qr(np.vstack([metric_root, pull]))
    return ConicProblem(
        constraint=constraint,
        body_columns=body_columns,
        nonnegative=nonnegative,
        margin=margin,
        point=point,
        root=root,
        shift=Q.T @ right,
        n_hidden=len(pull),
    )


def _null_space(root):
    """Orthonormal basis (n_features, n_hidden) of what a metric does not see.

    Up to the rounding of the metric, which is the square of its root.
    """
    _, values, rows = np.linalg.svd(root)
    limit = np.sqrt(values.size * np.finfo(float).eps) * values.max(initial=0.0)
    return rows[values <= limit].T


def lift(problem, vector, floor):
    """Move a vector inside the set along the bodies' unit matrices.

    Adding ``t`` times the body whose matrix is the unit matrix raises the smallest
    eigenvalue by exactly ``t``; nothing is moved further than it has to be.

    Parameters
    ----------
    problem : ConicProblem
        The programme.
    vector : ndarray of shape (n_features,)
        Vector in scaled units.
    floor : float
        Least eigenvalue wanted; non-negative columns end at ``floor - margin`` or
        above.

    Returns
    -------
    vector : ndarray of shape (n_features,)
        The lifted copy.
    step : float
        Largest eigenvalue added.
    """
    vector = vector.copy()
    unit = np.zeros(N_INERTIAL)
    unit[0] = 1.0
    unit[[4, 6, 9]] = 2.0 if problem.constraint == "pseudo-inertia" else 1.0
    bodies = problem.body_columns
    step = np.maximum(floor - problem.min_eigenvalues(vector), 0.0)
    vector[bodies] += step[:, None] * unit
    kept = problem.nonnegative
    vector[kept] = np.maximum(vector[kept], floor - problem.margin)
    return vector, float(step.max(initial=0.0))


def clip(problem, vector, floor):
    """Consistent vector by lifting negative eigenvalues: a start, not a projection.

    Parameters
    ----------
    problem : ConicProblem
        The programme.
    vector : ndarray of shape (n_features,)
        Vector in scaled units.
    floor : float
        Least eigenvalue of the result, above the margin.

    Returns
    -------
    vector : ndarray of shape (n_features,)
        A strictly consistent vector.
    """
    vector = vector.copy()
    bodies = problem.body_columns
    J = constraint_matrix(vector[bodies], "pseudo-inertia")
    eigenvalue, basis = np.linalg.eigh(J)
    eigenvalue = np.maximum(eigenvalue, floor)
    vector[bodies] = inertial_parameters(
        np.einsum("...ik,...k,...jk->...ij", basis, eigenvalue, basis)
    )
    return lift(problem, vector, floor)[0]


def certified_gap(problem, vector, duals, multipliers):
    r"""Bound on how far a consistent vector is from optimal.

    For any positive semidefinite `Z_j` and non-negative `z_k`, weak duality of the
    strongly convex programme gives

    .. math::

        \tfrac12 \|r(x)\|^2 - \tfrac12 \|r(x^\star)\|^2 \le
        \sum_j \langle Z_j, M_j(x) - \varepsilon E \rangle + \sum_k z_k x_k
        + \tfrac12 \| T^{-\top} (T^\top r - G^\top z) \|^2.

    It holds whatever the solver says of its own end.

    Parameters
    ----------
    problem : ConicProblem
        The programme.
    vector : ndarray of shape (n_features,)
        Consistent vector in scaled units.
    duals : ndarray of shape (n_bodies, n, n)
        Symmetric matrices; their negative part is dropped.
    multipliers : ndarray of shape (n_nonnegative,)
        Multipliers of the non-negative columns; negative ones are dropped.

    Returns
    -------
    gap : float
        Upper bound on the excess of half the squared distance.
    """
    eigenvalue, basis = np.linalg.eigh(duals)
    duals = np.einsum(
        "...ik,...k,...jk->...ij", basis, np.maximum(eigenvalue, 0.0), basis
    )
    multipliers = np.maximum(multipliers, 0.0)
    complementarity = np.sum(duals * problem.slack(vector))
    complementarity += multipliers @ vector[problem.nonnegative]
    stationarity = problem.root.T @ problem.residual(vector)
    stationarity[problem.body_columns] -= np.einsum(
        "kij,bij->bk", problem.generators, duals
    )
    stationarity[problem.nonnegative] -= multipliers
    error = solve_triangular(problem.root, stationarity, trans="T")
    return float(complementarity + 0.5 * error @ error)
