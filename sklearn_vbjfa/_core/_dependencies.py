"""Exactly dependent inputs: which of them generate the others.

Independent noise cannot be subtracted from inputs that are sums of each other. Second
moments do not say which generate the rest, but two unit-free rules do. If all dependent
inputs are sums with non-negative weights of as few of them as the span has dimensions,
it is these, the extreme rays of the cone of all. Otherwise it is the subset of largest
volume in standardised columns: all others have weights of at most one.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize

from sklearn_vbjfa._core._scaled_eigen import scaled_eigen

# Share of a standardised column's variance below which a dependency counts as exact:
# a generous bound on the rounding of second moments.
DEPENDENCY_TOLERANCE = 1e-9
# Beyond this many dependent columns the search for extreme rays is not worth its cost.
_MOST_RAYS = 500


@dataclass(frozen=True, kw_only=True)
class Dependencies:
    """Generators among the inputs."""

    basis: np.ndarray  # columns that generate all others, ascending
    # for each column of the basis, the column itself and its exact copies
    copies: tuple
    rule: str  # how the basis was found


def find_dependencies(R):
    """Find the generating columns from the correlation matrix R (d, d)."""
    d = R.shape[0]
    eigen = scaled_eigen(R, DEPENDENCY_TOLERANCE, scale=1.0)
    alone = tuple(np.array([j]) for j in range(d))
    if eigen.rank == d:
        return Dependencies(basis=np.arange(d), copies=alone, rule="full rank")
    involved = eigen.lost(1e-6)
    dependent, free = np.flatnonzero(involved), np.flatnonzero(~involved)
    groups = _copies(R, dependent)
    first = np.array([group[0] for group in groups])
    rank = eigen.rank - free.size
    # Columns as points: F'F = R without the null space.
    rays = _extreme_rays(eigen.root(), first) if first.size <= _MOST_RAYS else None
    if rays is not None and rays.size == rank:
        chosen, rule = rays, "rays"
    else:
        chosen, rule = _largest_volume(R, first, rank), "volume"
    members = {int(group[0]): group for group in groups}
    members.update({int(j): np.array([j]) for j in free})
    basis = np.sort(np.concatenate([free, chosen]))
    return Dependencies(
        basis=basis, copies=tuple(members[int(j)] for j in basis), rule=rule
    )


def _copies(R, columns):
    """Group columns that are multiples of each other."""
    waiting, groups = list(columns), []
    while waiting:
        j = waiting[0]
        same = [k for k in waiting if abs(R[j, k]) > 1 - DEPENDENCY_TOLERANCE]
        groups.append(np.array(same))
        waiting = [k for k in waiting if k not in same]
    return groups


def _extreme_rays(F, columns):
    """Columns that are not non-negative combinations of the others."""
    kept = list(columns)
    for j in columns:
        others = [k for k in kept if k != j]
        if not others:
            break
        _, distance = optimize.nnls(F[:, others], F[:, j])
        if distance < np.sqrt(DEPENDENCY_TOLERANCE):
            kept.remove(j)
    return np.array(kept)


def _largest_volume(R, columns, rank):
    """Greedy pivoting, then swaps while they enlarge the volume."""
    S = R[np.ix_(columns, columns)].copy()
    left = np.diagonal(S).copy()
    L = np.zeros((columns.size, rank))
    chosen = []
    for k in range(rank):
        j = int(np.argmax(left))
        L[:, k] = (S[:, j] - L[:, :k] @ L[j, :k]) / np.sqrt(left[j])
        left -= L[:, k] ** 2
        chosen.append(j)
        left[chosen] = -np.inf
    inside = np.array(chosen)
    outside = np.setdiff1d(np.arange(columns.size), inside)
    while outside.size:
        weights = linalg.solve(
            S[np.ix_(inside, inside)], S[np.ix_(inside, outside)], assume_a="pos"
        )
        i, j = np.unravel_index(np.argmax(np.abs(weights)), weights.shape)
        # Each swap multiplies the volume by the weight: it ends.
        if abs(weights[i, j]) <= 1 + 1e-6:
            break
        inside[i], outside[j] = outside[j], inside[i]
    return columns[inside]
