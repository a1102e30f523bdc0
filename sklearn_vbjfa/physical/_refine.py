r"""Primal-dual refinement of a conic solution.

A general solver factors an indefinite, regularised system and stops at a relative gap
of about 1e-7.  Directions that the metric hardly sees need more: at that gap they are
still placed by the barrier, not by the anchor.  Here the slack matrices are
eliminated, which leaves one positive definite system of the size of the parameter
vector, and the gap goes down by another two to four orders of magnitude.

The directions are those of Helmberg, Kojima and Monteiro (doi:10.1137/0806020): with
slack `S`, multiplier `Z` and target `m`,

.. math::

    \Big(T^\top T + \sum_j [\operatorname{tr}(B_k S_j^{-1} B_l Z_j)]_{kl}\Big)
    \mathrm{d}x = -T^\top r + m \sum_j [\operatorname{tr}(B_k S_j^{-1})]_k .
"""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, solve_triangular

from sklearn_vbjfa.physical._programme import lift

# Share of the way to the boundary that a step may go.
_BOUNDARY_SHARE = 0.95
_SHORTEST_STEP = 1e-6
_MAX_STEPS = 40
# Where the path is entered: least eigenvalue of the slack, in scaled units, and of the
# multipliers, relative to the largest.
_START = 1e-3
# The refinement has no more to give when the target has fallen this far below the
# squared distance.
_LAST_TARGET = 1e-15


def _largest_step(matrices, directions):
    """Return the largest t for which matrix + t direction stays definite."""
    if not len(matrices):
        return np.inf
    inverse = np.linalg.inv(np.linalg.cholesky(matrices))
    relative = inverse @ directions @ np.swapaxes(inverse, -1, -2)
    lowest = np.linalg.eigvalsh(relative)[:, 0].min()
    return np.inf if lowest >= 0 else -1.0 / lowest


def _largest_scalar_step(values, directions):
    """Return the largest t for which value + t direction stays positive."""
    falling = directions < 0
    if not falling.any():
        return np.inf
    return float(np.min(-values[falling] / directions[falling]))


def _factorise(problem, gram, blocks, slack, duals, weights):
    """Return a function that solves the system for a right side.

    Near the boundary the barrier's share is larger than the metric's by more than the
    machine precision, and their sum is no longer definite in floating point.  The same
    system as a stack of square roots, ``tr(B S^-1 B Z) = |L^-1 B R|^2`` with
    ``S = L L'`` and ``Z = R R'``, survives that at the cost of a QR decomposition.
    """
    bodies, kept = problem.body_columns, problem.nonnegative
    system = gram.copy()
    system[bodies[:, :, None], bodies[:, None, :]] += blocks
    system[kept, kept] += weights
    # The diagonal of a product with rounding may come out negative.
    diagonal = np.abs(np.diag(system))
    scale = 1.0 / np.sqrt(np.maximum(diagonal, np.finfo(float).eps * diagonal.max()))
    try:
        factor = cho_factor(system * scale * scale[:, None])
    except LinAlgError:
        pass
    else:
        return lambda right_side: scale * cho_solve(factor, scale * right_side)
    inner = np.linalg.inv(np.linalg.cholesky(slack))[:, None] @ problem.generators
    roots = inner @ np.linalg.cholesky(duals)[:, None]
    n_entries = roots.shape[-1] ** 2
    barrier = np.zeros((len(bodies) * n_entries, problem.n_features))
    rows = np.arange(len(barrier)).reshape(len(bodies), n_entries)
    barrier[rows[:, :, None], bodies[:, None, :]] = np.swapaxes(
        roots.reshape(len(bodies), len(problem.generators), n_entries), 1, 2
    )
    bounds = np.zeros((kept.size, problem.n_features))
    bounds[np.arange(kept.size), kept] = np.sqrt(weights)
    stacked = np.vstack([barrier, bounds, problem.root]) * scale
    # Large rows first: Householder's method is then stable row by row.
    order = np.argsort(-np.linalg.norm(stacked, axis=1))
    triangle = np.linalg.qr(stacked[order], mode="r")

    def solve(right_side):
        half = solve_triangular(triangle, scale * right_side, trans="T")
        return scale * solve_triangular(triangle, half)

    return solve


def _step(problem, gram, vector, duals, multipliers, mean):
    """One predictor-corrector step: its length and the three directions."""
    bodies, kept = problem.body_columns, problem.nonnegative
    generators = problem.generators
    slack, free = problem.slack(vector), vector[kept]
    # Rounding may have left the set: cholesky raises, which ends the refinement.
    np.linalg.cholesky(slack)
    np.linalg.cholesky(duals)
    inverse, weights = np.linalg.inv(slack), multipliers / free
    # [j, k]: B_k S_j^-1 and B_k Z_j.
    left = generators[None] @ inverse[:, None]
    right = generators[None] @ duals[:, None]
    blocks = np.einsum("bkij,blji->bkl", left, right)
    solve = _factorise(problem, gram, blocks, slack, duals, weights)
    gradient = problem.root.T @ problem.residual(vector)
    barrier = np.zeros(problem.n_features)
    barrier[bodies] = np.einsum("bkii->bk", left)
    barrier[kept] = 1.0 / free

    def symmetric(matrices):
        return 0.5 * (matrices + np.swapaxes(matrices, -1, -2))

    def direction(target, second_bodies, second_free):
        right_side = target * barrier - gradient
        right_side[bodies] -= np.einsum("kij,bij->bk", generators, second_bodies)
        right_side[kept] -= second_free
        step = solve(right_side)
        change = np.einsum("kij,bk->bij", generators, step[bodies])
        dual_step = target * inverse - duals - second_bodies
        dual_step = dual_step - symmetric(inverse @ change @ duals)
        dual_free = target / free - multipliers - step[kept] * weights - second_free
        reach = min(
            _largest_step(slack, change),
            _largest_step(duals, dual_step),
            _largest_scalar_step(free, step[kept]),
            _largest_scalar_step(multipliers, dual_free),
        )
        return reach, step, dual_step, dual_free, change

    # Mehrotra: the predictor tells how far the target can be lowered, and its
    # second-order term corrects the step.
    reach, step, dual_step, dual_free, change = direction(0.0, 0.0 * duals, 0.0 * free)
    target = mean * max((1.0 - min(1.0, reach)) ** 3, 1e-3)
    reach, step, dual_step, dual_free, _ = direction(
        target, symmetric(inverse @ change @ dual_step), step[kept] * dual_free / free
    )
    return min(1.0, _BOUNDARY_SHARE * reach), step, dual_step, dual_free


def refine(problem, vector, duals, multipliers, *, max_steps):
    """Follow the central path from near an approximate solution to its end.

    Parameters
    ----------
    problem : ConicProblem
        The programme.
    vector : ndarray of shape (n_features,)
        Approximate solution in scaled units.
    duals : ndarray of shape (n_bodies, n, n)
        Its multipliers of the bodies.
    multipliers : ndarray of shape (n_nonnegative,)
        Its multipliers of the non-negative columns.
    max_steps : int
        Largest number of steps.

    Returns
    -------
    vector : ndarray of shape (n_features,)
        Refined vector; rounding may leave it outside the set by as much.
    duals : ndarray of shape (n_bodies, n, n)
        Refined multipliers.
    multipliers : ndarray of shape (n_nonnegative,)
        Refined multipliers.
    n_steps : int
        Steps taken.
    """
    kept = problem.nonnegative
    order = len(duals) * problem.generators.shape[-1] + kept.size
    gram = problem.root.T @ problem.root
    floor = _LAST_TARGET * max(problem.distance(vector) ** 2, np.finfo(float).tiny)
    largest = max(np.abs(duals).max(initial=0.0), np.abs(multipliers).max(initial=0.0))
    if largest == 0.0:
        return vector, duals, multipliers, 0
    vector, _ = lift(problem, vector, problem.margin + _START)
    eigenvalue, basis = np.linalg.eigh(duals)
    eigenvalue = np.maximum(eigenvalue, _START * largest)
    duals = np.einsum("bik,bk,bjk->bij", basis, eigenvalue, basis)
    multipliers = np.maximum(multipliers, _START * largest)

    n_steps = 0
    for _ in range(min(max_steps, _MAX_STEPS)):
        gap = np.sum(problem.slack(vector) * duals) + vector[kept] @ multipliers
        if gap <= order * floor:
            break
        try:
            reach, *change = _step(
                problem, gram, vector, duals, multipliers, gap / order
            )
        except (LinAlgError, np.linalg.LinAlgError):
            # Rounding has reached the boundary: the last iterate stands.
            break
        if reach < _SHORTEST_STEP:
            break
        vector = vector + reach * change[0]
        duals = duals + reach * change[1]
        multipliers = multipliers + reach * change[2]
        n_steps += 1
    return vector, duals, multipliers, n_steps
