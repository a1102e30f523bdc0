"""Solve the projection's programme and certify the answer.

clarabel solves, the refinement takes its answer to the last digits, and the programme
certifies both. Where clarabel has no answer, or one from which the refinement does not
reach its gap (rods that are hardly spoiled, at distances of 1e-9 of the vector), the
refinement starts from the vector with clipped eigenvalues.
"""

from dataclasses import dataclass
from itertools import chain

import numpy as np

from sklearn_vbjfa.physical._conic import solve_conic
from sklearn_vbjfa.physical._refinement import clipped_starts, refine

# The certified gap that ends the search for a better answer, relative to the squared
# distance, and the one up to which an answer is accepted.
GAP_TARGET = 1e-9
_GAP_LIMIT = 1e-4


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
class Solution:
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
        return Solution(vector=vector, gap=gap, n_iter=0, status="nothing to do")
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
    return Solution(vector=vector, gap=max(gap, 0.0), n_iter=n_iter, status=status)
