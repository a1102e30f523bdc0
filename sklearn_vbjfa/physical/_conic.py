r"""The projection as a conic programme: solving and certifying.

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
        best = _better(problem, best, (vector, duals, multipliers), status, least)
        *refined, steps = refine(
            problem, vector, duals, multipliers, max_steps=max_solver_iter
        )
        n_iter += steps
        best = _better(problem, best, refined, status, least)
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
