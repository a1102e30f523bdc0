r"""The projection as a conic programme: assembling, solving, certifying.

In scaled variables `x` (every parameter divided by its unit) the programme is

.. math::

    \min_x \| T x - c \| \quad \text{such that} \quad
    M_j(x) - \varepsilon E \succeq 0 \ \text{for every body},
    \quad x_k \ge 0 \ \text{for the non-negative columns},

with `T` upper triangular and nonsingular.  It is given to the solver with the norm as a
second-order cone.  Of the three usual forms that one is the accurate one here: the
quadratic form ``T' T`` squares a condition number that is large to begin with, and the
least-squares form loses the scale of a small distance in the solver's absolute
tolerance.
"""

from dataclasses import dataclass
from functools import cached_property

import clarabel
import numpy as np
from scipy import sparse
from scipy.linalg import solve_triangular

from sklearn_vbjfa.physical._pseudo_inertia import (
    N_INERTIAL,
    constraint_matrix,
    inertial_parameters,
    min_eigenvalue,
)

# The certified gap that ends the search for a better solve, relative to the squared
# distance, and the one up to which an answer is accepted.
_GAP_TARGET = 1e-6
_GAP_LIMIT = 1e-4
# Distances below this fraction of the vector's own length count as this fraction in the
# relative gap: the solver resolves the matrices to about 1e-9 of their size, the square
# root of the limit times this.
_RESOLUTION = 1e-7


class ProjectionError(RuntimeError):
    """The projection found no vector that is certified to be the nearest one.

    Examples
    --------
    >>> from sklearn_vbjfa.physical import ProjectionError, project
    >>> try:
    ...     project([2, 0, 0, 0, 1, 0, 1, 0, 0, 3], max_solver_iter=1)
    ... except ProjectionError as error:
    ...     print("failed")
    failed
    """


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
        Upper triangular `T`: metric and regulariser as one square root.
    shift : ndarray of shape (n_features,)
        `c`: the distance of a vector is ``|T (vector - point) - c|``.
    """

    constraint: str
    body_columns: np.ndarray
    nonnegative: np.ndarray
    margin: float
    point: np.ndarray
    root: np.ndarray
    shift: np.ndarray

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
    metric_root : ndarray of shape (n_rows, n_features)
        Square root of the metric in scaled variables, largest column norm one (or
        zero).
    anchor : ndarray of shape (n_features,)
        Where the regulariser pulls, in units of the scales.
    anchor_weight : float
        Weight of the regulariser.

    Returns
    -------
    problem : ConicProblem
        The programme.
    """
    n_features = point.size
    # |R x|^2 + w |x - a|^2 as one triangular factor: the stacked QR does not square
    # the condition number as R'R would.
    stacked = np.vstack([metric_root, np.sqrt(anchor_weight) * np.eye(n_features)])
    right = np.zeros(len(stacked))
    right[len(metric_root) :] = np.sqrt(anchor_weight) * (anchor - point)
    Q, root = np.linalg.qr(stacked)
    return ConicProblem(
        constraint=constraint,
        body_columns=body_columns,
        nonnegative=nonnegative,
        margin=margin,
        point=point,
        root=root,
        shift=Q.T @ right,
    )


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


def solve_conic(problem, *, max_solver_iter):
    """Solve the programme with clarabel and certify the answer.

    Parameters
    ----------
    problem : ConicProblem
        The programme.
    max_solver_iter : int
        Largest number of interior-point iterations of one solve.

    Returns
    -------
    vector : ndarray of shape (n_features,)
        Strictly consistent vector in scaled units.
    gap : float
        Certified excess of the squared distance, relative to it (or to the square of
        the resolution, where that is larger).
    n_iter : int
        Interior-point iterations.
    status : str
        The solver's status.

    Raises
    ------
    ProjectionError
        If no solve ends with a certified gap below the limit.
    """
    resolution = _RESOLUTION * float(np.linalg.norm(problem.root @ problem.point))
    least = max(resolution**2, np.finfo(float).tiny)
    # The least lift is an answer by itself where hardly anything has to move; no vector
    # is nearer than nothing, so its own squared distance bounds its excess.
    lifted, _ = lift(problem, problem.point, problem.margin)
    squared = problem.distance(lifted) ** 2
    best = (lifted, squared / max(squared, least), "lifted")
    upper = problem.distance(clip(problem, problem.point, 2 * problem.margin))
    # A distance below the resolution cannot be measured, nor used as a scale.
    scale = max(upper, resolution)
    n_iter, status = 0, "nothing to do"
    for _ in range(3):
        if best[1] <= _GAP_TARGET:
            break
        vector, duals, multipliers, iterations, status = _solve_once(
            problem, scale if scale > 0 else 1.0, max_solver_iter
        )
        n_iter += iterations
        if not np.all(np.isfinite(vector)):
            break
        vector, _ = lift(problem, vector, problem.margin)
        gap = certified_gap(problem, vector, duals, multipliers)
        relative = 2 * gap / max(problem.distance(vector) ** 2, least)
        if relative < best[1]:
            best = (vector, relative, status)
        # Solve again in units of the distance found: the guess may have been far off.
        scale = max(problem.distance(best[0]), resolution)
    if best[1] > _GAP_LIMIT:
        raise ProjectionError(
            f"The projection on the {problem.constraint!r} set failed: clarabel ended "
            f"with {status} after {n_iter} iterations, and the certified relative gap "
            f"{best[1]:.1e} is above {_GAP_LIMIT:.0e}. Raise max_solver_iter, or check "
            "the vector and the metric for columns many orders of magnitude apart."
        )
    return best[0], max(best[1], 0.0), n_iter, best[2]


def _solve_once(problem, scale, max_solver_iter):
    """One call of the solver, the distance measured in units of `scale`."""
    n_features = problem.n_features
    bodies, kept = problem.body_columns, problem.nonnegative
    size = problem.generators.shape[-1]
    # clarabel stacks the upper triangle by columns, off-diagonal entries times sqrt(2).
    column, row = np.tril_indices(size)
    weight = np.where(row == column, 1.0, np.sqrt(2.0))
    triangle = (problem.generators[:, row, column] * weight).T
    n_bodies, n_entries = len(bodies), len(row)

    # Unknowns: displacement from the point, then the distance.  Rows: s = b - A x.
    blocks = [np.zeros((1 + n_features, n_features + 1))]
    blocks[0][0, -1] = -1.0
    blocks[0][1:, :-1] = -problem.root / scale
    right = [np.zeros(1), -problem.shift / scale]
    cones = [clarabel.SecondOrderConeT(1 + n_features)]
    for columns in bodies:
        block = np.zeros((n_entries, n_features + 1))
        block[:, columns] = -triangle
        blocks.append(block)
        right.append(
            triangle @ problem.point[columns] - problem.margin * (row == column)
        )
        cones.append(clarabel.PSDTriangleConeT(size))
    if kept.size:
        block = np.zeros((kept.size, n_features + 1))
        block[np.arange(kept.size), kept] = -1.0
        blocks.append(block)
        right.append(problem.point[kept])
        cones.append(clarabel.NonnegativeConeT(kept.size))

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = max_solver_iter
    # A solve takes milliseconds: threads cost more than they bring.
    settings.max_threads = 1
    # Tighter than can be met: the iterations go on until rounding stops them, and the
    # certificate, not the status, decides.
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-13
    objective = np.zeros(n_features + 1)
    objective[-1] = 1.0
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix((n_features + 1, n_features + 1)),
        objective,
        sparse.csc_matrix(np.vstack(blocks)),
        np.concatenate(right),
        cones,
        settings,
    ).solve()

    vector = problem.point + np.array(solution.x)[:-1]
    # The multipliers belong to distance / scale; d(distance^2 / 2) is distance times
    # d(distance).
    z = np.array(solution.z)[1 + n_features :] * scale * problem.distance(vector)
    duals = np.zeros((n_bodies, size, size))
    entries = z[: n_bodies * n_entries].reshape(n_bodies, n_entries) / weight
    duals[:, row, column] = entries
    duals[:, column, row] = entries
    multipliers = z[n_bodies * n_entries :]
    return vector, duals, multipliers, int(solution.iterations), str(solution.status)
