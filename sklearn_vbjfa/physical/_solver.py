"""Solve the projection's programme with a conic solver, and certify the solution.

clarabel solves the programme, and the duality gap certifies the result. The programme
is stated with y = T (x - x_0) / s, where x_0 is the vector to project and s a distance:

    min_(y, t) t  such that  (t, y - c / s) in SOC,
    (M_j(x_0) - eps E) / s + M_j(T^-1 y) >= 0,  x_0k / s + (T^-1 y)_k >= 0.

As a second-order cone the distance keeps the condition number of T, which its square,
the quadratic form T' T, would square. With displacements in place of y the solver's
regularisation would hide directions of small metric.
"""

from dataclasses import dataclass, replace

import clarabel
import numpy as np
from scipy import sparse
from scipy.linalg import solve_triangular

from sklearn_vbjfa.physical._programme import PrimalDual

# Certified gaps over the squared distance: the target, and the largest accepted.
GAP_TARGET, _GAP_LIMIT = 1e-6, 1e-4
# Solutions, each in units of the distance of the previous one, until the target is met.
_SOLUTIONS = 2
# Tolerances of clarabel, its largest number of iterations, and its regularisation.
_TOLERANCE, _MAX_STEPS, _REGULARISATION = 1e-11, 200, 1e-12
# Share of the bodies from which all constraints are used at once.
_MOST = 0.5
_TINY = np.finfo(float).tiny


class ProjectionError(RuntimeError):
    """The projection found no vector that is certified to be the nearest one."""


@dataclass(frozen=True, kw_only=True)
class CertifiedVector:
    """A consistent vector with its certificate."""

    vector: np.ndarray  # (n_features,): consistent vector in scaled units
    # certified excess of the squared distance, relative, see `Programme.relative_gap`
    gap: float
    status: str  # how clarabel ended


def solve(programme):
    """Solve a programme by adding violated constraints until none is left."""
    # ProjectionError if no certified gap is below the limit. Fewer constraints give no
    # larger distance: if their solution meets all constraints, it is the solution.
    vector = programme.point + solve_triangular(programme.root, programme.shift)
    solution = CertifiedVector(vector=vector, gap=0.0, status="nothing to do")
    broken = programme.broken(vector)
    used = tuple(np.zeros_like(x) for x in broken)
    while any((x & ~in_use).any() for x, in_use in zip(broken, used)):
        used = tuple(x | in_use for x, in_use in zip(broken, used))
        if used[0].sum() >= _MOST * used[0].size:
            used = tuple(np.ones_like(x) for x in used)
        part, completed = programme.restricted(*used)
        solution = _solve_together(part)
        solution = replace(solution, vector=completed(solution.vector))
        broken = programme.broken(solution.vector)
    return solution


def _solve_together(programme):
    """Solve a programme with clarabel, and certify the solution."""
    # The smallest lift is a solution if almost nothing has to change; its squared
    # distance bounds its gap.
    vector = programme.lift(programme.point, programme.margin)
    squared, least = programme.distance(vector) ** 2, programme.resolution**2
    gap, status = squared / max(squared, least, _TINY), "nothing to do"
    # The unit is the distance of a consistent vector, as tolerances are also absolute.
    unit = programme.distance(programme.clip(2 * programme.margin))
    for _ in range(_SOLUTIONS):
        if gap <= GAP_TARGET:
            break
        answer, status = solve_conic(programme, max(unit, programme.resolution) or 1.0)
        if answer.is_finite:
            lifted = programme.lift(answer.vector, programme.margin)
            certified = programme.relative_gap(lifted, answer.duals, answer.multipliers)
            if certified < gap:
                vector, gap, unit = lifted, certified, programme.distance(lifted)
    if gap > _GAP_LIMIT:
        raise ProjectionError(
            f"The projection on the {programme.constraint!r} set failed: clarabel "
            f"ended with {status}, and the certified relative gap {gap:.1e} is above "
            f"{_GAP_LIMIT:.0e}. Check the vector and the metric for columns many "
            "orders of magnitude apart."
        )
    return CertifiedVector(vector=vector, gap=max(gap, 0.0), status=status)


def solve_conic(programme, unit):
    """Solve with clarabel in units of a distance; return its solution and status."""
    # The solution is not finite if the solver broke down.
    bodies, kept = programme.body_columns, programme.nonnegative
    n, n_bodies = programme.n_features, len(bodies)
    size = programme.generators.shape[-1]
    # clarabel stacks the upper triangle by columns, off-diagonal entries times sqrt(2).
    column, row = np.tril_indices(size)
    weight = np.where(row == column, 1.0, np.sqrt(2.0))
    entries = weight * programme.generators[:, row, column]
    at_point = weight * programme.slack(programme.point)[:, row, column]
    # x = x_0 + s W y
    W = solve_triangular(programme.root, np.eye(n))
    change = np.c_[W, np.zeros(n)]
    # Rows of s = b - A (y, t): the distance, then every body, then the columns kept.
    matrices = np.einsum("ke,bkn->ben", entries, change[bodies])
    rows = np.vstack([np.eye(n + 1)[n], np.eye(n, n + 1), matrices.reshape(-1, n + 1)])
    cones = [clarabel.SecondOrderConeT(n + 1)]
    cones += [clarabel.PSDTriangleConeT(size)] * n_bodies
    cones += [clarabel.NonnegativeConeT(kept.size)] if kept.size else []

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = _MAX_STEPS
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _TOLERANCE
    settings.static_regularization_constant = _REGULARISATION
    settings.static_regularization_proportional = 0.0
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix((n + 1, n + 1)),
        np.eye(n + 1)[n],
        sparse.csc_matrix(-np.vstack([rows, change[kept]])),
        np.r_[
            0.0,
            -programme.shift / unit,
            at_point.ravel() / unit,
            programme.point[kept] / unit,
        ],
        cones,
        settings,
    ).solve()

    # Multipliers of half the squared distance are those of the distance times it.
    length = unit * max(solution.x[-1], 0.0)
    z = length * np.array(solution.z[n + 1 :])
    stacked = z[: n_bodies * len(row)].reshape(n_bodies, len(row)) / weight
    duals = np.zeros((n_bodies, size, size))
    duals[:, row, column] = duals[:, column, row] = stacked
    answer = PrimalDual(
        vector=programme.point + unit * (W @ solution.x[:n]),
        duals=duals,
        multipliers=z[stacked.size :],
    )
    return answer, str(solution.status)
