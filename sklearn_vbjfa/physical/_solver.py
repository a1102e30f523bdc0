"""Solve the projection's programme with a conic solver, and certify the answer.

clarabel solves, the refinement takes its answer to the last digits, and the programme
certifies both. Where clarabel has no answer, or one from which the refinement does not
reach its gap (rods that are hardly spoiled, at distances of 1e-9 of the vector), the
refinement starts from the vector with clipped eigenvalues.

For clarabel the programme is stated with the displacement d from the vector to project,
in units of a distance s:

    min_(d, t) t  such that  (t, T d - c / s) in SOC,
    (M_j(x_0) - eps E) / s + M_j(d) >= 0,  x_0k / s + d_k >= 0.

As a second-order cone the distance keeps the condition number of T, which its square,
the quadratic form T' T, would square.
"""

import threading
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import chain

import clarabel
import numpy as np
from scipy import sparse
from threadpoolctl import ThreadpoolController

from sklearn_vbjfa.physical._programme import PrimalDual
from sklearn_vbjfa.physical._refinement import clipped_starts, refine

# The certified gap that ends the search for a better answer, relative to the squared
# distance, and the one up to which an answer is accepted.
GAP_TARGET = 1e-9
_GAP_LIMIT = 1e-4
# Held by whoever limits the threads of the linear algebra.
_held = threading.Lock()


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
class CertifiedVector:
    """A consistent vector and what is known of it."""

    vector: np.ndarray  # (n_features,): consistent vector in scaled units
    # certified excess of the squared distance, relative, see `Programme.relative_gap`
    gap: float
    n_iter: int  # iterations of clarabel and steps of the refinement
    status: str  # how clarabel ended, and its refinement if the gap is not reached


def solve(programme, *, max_steps):
    """Solve a programme with clarabel, refine the answer and certify it."""
    # ProjectionError if no answer has a certified gap below the limit.

    # The least lift is an answer by itself where hardly anything has to move; no vector
    # is nearer than nothing, so its own squared distance bounds its excess.
    vector = programme.lift(programme.point, programme.margin)
    squared, least = programme.distance(vector) ** 2, programme.resolution**2
    gap = squared / max(squared, least, np.finfo(float).tiny)
    if gap <= GAP_TARGET:
        return CertifiedVector(vector=vector, gap=gap, n_iter=0, status="nothing to do")
    answer, n_iter, status = solve_conic(programme, max_steps=max_steps)
    how = "without a start"
    for start in chain([answer], clipped_starts(programme)):
        if gap <= GAP_TARGET:
            break
        if not start.is_finite:
            continue
        end, steps, ended = refine(programme, start, max_steps=max_steps)
        n_iter += steps
        # The refined vector, or the start itself where that is the better one.
        for candidate in (end, start):
            lifted = programme.lift(candidate.vector, programme.margin)
            found = programme.relative_gap(
                lifted, candidate.duals, candidate.multipliers
            )
            if found < gap:
                vector, gap, how = lifted, found, ended
    if gap > _GAP_LIMIT:
        raise ProjectionError(
            f"The projection on the {programme.constraint!r} set failed: clarabel "
            f"ended with {status} after {n_iter} iterations, and the certified "
            f"relative gap {gap:.1e} is above {_GAP_LIMIT:.0e}. Raise "
            "max_solver_iter, or check the vector and the metric for columns many "
            "orders of magnitude apart."
        )
    if gap > GAP_TARGET:
        status = f"{status}; its refinement ended {how}"
    return CertifiedVector(
        vector=vector, gap=max(gap, 0.0), n_iter=n_iter, status=status
    )


def solve_conic(programme, *, max_steps):
    """Solve with clarabel; return where it ended, its iterations and its own words."""
    # The answer is not finite where the solver broke down.
    # The tolerances are absolute too. The distance of a consistent vector is the unit,
    # unless it is below the resolution, where it cannot be measured.
    upper = programme.distance(programme.clip(2 * programme.margin))
    scale = max(upper, programme.resolution) or 1.0
    bodies, kept = programme.body_columns, programme.nonnegative
    n, n_bodies = programme.n_features, len(bodies)
    size = programme.generators.shape[-1]
    # clarabel stacks the upper triangle by columns, off-diagonal entries times sqrt(2).
    column, row = np.tril_indices(size)
    weight = np.where(row == column, 1.0, np.sqrt(2.0))
    entries = weight * programme.generators[:, row, column]
    at_point = weight * programme.slack(programme.point)[:, row, column]
    # Rows of s = b - A (d, t): the distance, then every body, then the columns kept.
    distance = -np.vstack([np.eye(n + 1)[n], np.c_[programme.root, np.zeros(n)]])
    matrices = np.zeros((n_bodies, len(row), n + 1))
    matrices[np.arange(n_bodies)[:, None], :, bodies] = -entries
    cones = [clarabel.SecondOrderConeT(n + 1)]
    cones += [clarabel.PSDTriangleConeT(size)] * n_bodies
    cones += [clarabel.NonnegativeConeT(kept.size)] if kept.size else []

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = max_steps
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix((n + 1, n + 1)),
        np.eye(n + 1)[n],
        sparse.csc_matrix(
            np.vstack([distance, matrices.reshape(-1, n + 1), -np.eye(n + 1)[kept]])
        ),
        np.r_[
            0.0,
            -programme.shift / scale,
            at_point.ravel() / scale,
            programme.point[kept] / scale,
        ],
        cones,
        settings,
    ).solve()

    # The multipliers are those of the distance; of half its square they are as many
    # times as large as the distance is.
    length = scale * max(solution.x[-1], 0.0)
    z = length * np.array(solution.z[n + 1 :])
    stacked = z[: n_bodies * len(row)].reshape(n_bodies, len(row)) / weight
    duals = np.zeros((n_bodies, size, size))
    duals[:, row, column] = duals[:, column, row] = stacked
    answer = PrimalDual(
        vector=programme.point + scale * np.array(solution.x[:n]),
        duals=duals,
        multipliers=z[stacked.size :],
    )
    return answer, int(solution.iterations), str(solution.status)


@cache
def _controller():
    """Find the loaded libraries; once, since the search takes milliseconds."""
    return ThreadpoolController()


@contextmanager
def one_blas_thread():
    """Limit the BLAS to one thread; usable as a decorator."""
    # The number of threads belongs to the process. If each of two overlapping holders
    # restored what it had found, the limit could stay behind for good; so the first one
    # alone sets and lifts it.
    if not _held.acquire(blocking=False):
        yield
        return
    try:
        with _controller().limit(limits=1, user_api="blas"):
            yield
    finally:
        _held.release()
