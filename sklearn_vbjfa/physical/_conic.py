r"""The projection as a conic programme: solving and certifying.

In scaled variables `x` (every parameter divided by its unit) the programme is

.. math::

    \min_x \tfrac12 \| T x - c \|^2 \quad \text{such that} \quad
    M_j(x) - \varepsilon E \succeq 0 \ \text{for every body},
    \quad x_k \ge 0 \ \text{for the non-negative columns},

with `T` upper triangular and nonsingular.  The solver gets the quadratic form ``T' T``,
which is the smallest of the usual forms but squares a condition number that is large to
begin with: what it returns is a start.  The refinement, which keeps the factors of all
matrices, makes it exact, and the certificate says how exact.
"""

import clarabel
import numpy as np
from scipy import sparse

from sklearn_vbjfa.physical._programme import certified_gap, clip, lift
from sklearn_vbjfa.physical._refine import refine

# The certified gap that ends the search for a better solve, relative to the squared
# distance, and the one up to which an answer is accepted.
_GAP_TARGET = 1e-6
_GAP_LIMIT = 1e-4
# Distances below this fraction of the vector's own length count as this fraction in the
# relative gap: the solver resolves the matrices to about 1e-9 of their size, the square
# root of the limit times this.
_RESOLUTION = 1e-7
# Where the solver stops, in units of the distance: the refinement starts further back,
# and rounding in the quadratic form allows no more than this.
_SOLVER_TOLERANCE = 1e-8


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
        *refined, steps = refine(
            problem, vector, duals, multipliers, max_steps=max_solver_iter
        )
        n_iter += steps
        best = _better(problem, best, refined, status, least)
        # The solver's own answer, whose last digits are rounding, where it has to be.
        if best[1] > _GAP_TARGET:
            raw = vector, duals, multipliers
            best = _better(problem, best, raw, status, least)
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


def _better(problem, best, candidate, status, least):
    """Return the candidate, made consistent, if its certified gap is the smaller."""
    vector, _ = lift(problem, candidate[0], problem.margin)
    gap = certified_gap(problem, vector, candidate[1], candidate[2])
    relative = 2 * gap / max(problem.distance(vector) ** 2, least)
    return (vector, relative, status) if relative < best[1] else best


def _solve_once(problem, scale, max_solver_iter):
    """One call of the solver, the distance measured in units of `scale`."""
    bodies, kept = problem.body_columns, problem.nonnegative
    size = problem.generators.shape[-1]
    # clarabel stacks the upper triangle by columns, off-diagonal entries times sqrt(2).
    column, row = np.tril_indices(size)
    weight = np.where(row == column, 1.0, np.sqrt(2.0))
    triangle = (problem.generators[:, row, column] * weight).T
    n_bodies, n_entries = len(bodies), len(row)
    # Unknown: the displacement from the point, in units of `scale`.  Rows: s = b - A x,
    # the bodies' first, then those of the non-negative columns.
    entry, parameter = np.nonzero(triangle)
    first_kept = n_bodies * n_entries
    body_rows = n_entries * np.arange(n_bodies)[:, None] + entry
    rows = np.r_[body_rows.ravel(), first_kept + np.arange(kept.size)]
    columns = np.r_[bodies[:, parameter].ravel(), kept]
    values = np.r_[np.tile(-triangle[entry, parameter], n_bodies), -np.ones(kept.size)]
    shape = first_kept + kept.size, problem.n_features
    slack = problem.point[bodies] @ triangle.T - problem.margin * (row == column)
    right = np.r_[slack.ravel(), problem.point[kept]] / scale
    cones = [clarabel.PSDTriangleConeT(size)] * n_bodies
    if kept.size:
        cones.append(clarabel.NonnegativeConeT(kept.size))

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = max_solver_iter
    settings.tol_gap_abs = settings.tol_gap_rel = _SOLVER_TOLERANCE
    settings.tol_feas = _SOLVER_TOLERANCE
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(problem.root.T @ problem.root)),
        -problem.root.T @ problem.shift / scale,
        sparse.csc_matrix((values, (rows, columns)), shape=shape),
        right,
        cones,
        settings,
    ).solve()

    vector = problem.point + scale * np.array(solution.x)
    z = scale * np.array(solution.z)
    duals = np.zeros((n_bodies, size, size))
    entries = z[:first_kept].reshape(n_bodies, n_entries) / weight
    duals[:, row, column] = entries
    duals[:, column, row] = entries
    multipliers = z[first_kept:]
    return vector, duals, multipliers, int(solution.iterations), str(solution.status)
