r"""Primal-dual refinement of a conic solution.

A general solver factors an indefinite, regularised system and stops at a relative gap
of about 1e-7.  Directions that the metric hardly sees need more: at that gap they are
still placed by the barrier, not by the anchor.  Here the slack matrices are
eliminated, which leaves one positive definite system of the size of the parameter
vector.  Three things take the gap down to 1e-9 and less: the system is formed from the
square roots of its parts, so that it is symmetric and semidefinite to the last digit;
its solutions are corrected; and the multipliers' step is made to balance the gradient,
which the formula for it does only in exact arithmetic.  The path ends at a gap that is
set beforehand, with Newton's steps to the one point that belongs to it, from which one
more step leads to the optimum: the answer is the same whatever the rounding was on the
way.

The directions are those of Helmberg, Kojima and Monteiro (doi:10.1137/0806020): with
slack `S`, multiplier `Z` and target `m`,

.. math::

    \Big(T^\top T + \sum_j [\operatorname{tr}(B_k S_j^{-1} B_l Z_j)]_{kl}\Big)
    \mathrm{d}x = -T^\top r + m \sum_j [\operatorname{tr}(B_k S_j^{-1})]_k .
"""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from sklearn_vbjfa.physical._programme import lift

# Share of the way to the boundary that a step may go.
_BOUNDARY_SHARE = 0.95
# The same for the last step, after which there is no path to keep to.
_LAST_SHARE = 1.0 - 1e-6
_SHORTEST_STEP = 1e-6
_MAX_STEPS = 40
# Where the path is entered: least eigenvalue of the slack, in scaled units, and of the
# multipliers, relative to the largest.
_START = 1e-3
# Gap, relative to the squared distance, at which the path ends: above the parts in 1e11
# to 1e9 at which rounding would stop it, and far below what is asked of an answer.
_GAP_END = 4e-9
# Where the path counts as near its end, in units of that, and Newton's steps there.
# They converge to one point, wherever on the way rounding had led the iterates.
_NEAR = 4.0
_CENTRINGS = 6
# Corrections of a step with the residual of its equations.
_CORRECTIONS = 4


def _largest_step(inverse_factors, directions):
    """Return the largest t for which L L' + t direction stays definite, given L^-1."""
    relative = inverse_factors @ directions @ np.swapaxes(inverse_factors, -1, -2)
    lowest = np.linalg.eigvalsh(relative)[:, 0].min(initial=0.0)
    return np.inf if lowest >= 0 else -1.0 / lowest


def _largest_scalar_step(values, directions):
    """Return the largest t for which value + t direction stays positive."""
    falling = directions < 0
    if not falling.any():
        return np.inf
    return float(np.min(-values[falling] / directions[falling]))


def _factorise(problem, gram, roots, bounds):
    """Return a function that solves the system for a right side.

    The system is ``A' A`` for the stack `A` of the bodies' roots ``L^-1 B R`` (with
    ``S = L L'`` and ``Z = R R'``), the roots of the bounds and `T`; the right side is
    ``A' (bodies, bounds, metric)``.  Near the boundary the barrier's share is larger
    than the metric's by more than the machine precision, and the sum is no longer
    definite in floating point; the triangle of a QR decomposition of `A` is used then.
    Either way the condition number is squared, which corrections with the residual of
    the stack make good: the corrected seminormal equations of Bjoerck
    (doi:10.1016/0024-3795(87)90101-7), repeated.
    """
    columns, kept = problem.body_columns, problem.nonnegative
    system = gram.copy()
    system[columns[:, :, None], columns[:, None, :]] += roots @ np.swapaxes(roots, 1, 2)
    system[kept, kept] += bounds**2
    scale = 1.0 / np.sqrt(np.diag(system))
    try:
        factor = cho_factor(system * scale * scale[:, None], check_finite=False)
    except LinAlgError:
        factor = _triangle(problem, roots, bounds, scale), False

    def solve_once(bodies, free, metric):
        right_side = problem.root.T @ metric
        right_side[columns] += (roots @ bodies[:, :, None])[..., 0]
        right_side[kept] += bounds * free
        return scale * cho_solve(factor, scale * right_side, check_finite=False)

    def solve(bodies, free, metric):
        step = solve_once(bodies, free, metric)
        for _ in range(_CORRECTIONS):
            step = step + solve_once(
                bodies - (step[columns][:, None] @ roots)[:, 0],
                free - bounds * step[kept],
                metric - problem.root @ step,
            )
        return step

    return solve


def _triangle(problem, roots, bounds, scale):
    """Upper triangular factor of the system, from its square roots."""
    columns, kept = problem.body_columns, problem.nonnegative
    n_bodies, _, n_entries = roots.shape
    barrier = np.zeros((n_bodies * n_entries, problem.n_features))
    rows = np.arange(len(barrier)).reshape(n_bodies, n_entries)
    barrier[rows[:, None, :], columns[:, :, None]] = roots
    single = np.zeros((kept.size, problem.n_features))
    single[np.arange(kept.size), kept] = bounds
    stacked = np.vstack([barrier, single, problem.root]) * scale
    # Large rows first: Householder's method is then stable row by row.
    order = np.argsort(-np.linalg.norm(stacked, axis=1))
    return np.linalg.qr(stacked[order], mode="r")


def _step(problem, gram, vector, slack, duals, multipliers, mean, end, phase):
    """One step: its length and the three directions.

    Down the path towards `end`, a predictor-corrector step; at the "centre" there, one
    of Newton's; and as the "last" a predictor-corrector step from there to the optimum.
    """
    bodies, kept = problem.body_columns, problem.nonnegative
    generators = problem.generators
    flat = generators.reshape(len(generators), -1)
    n_bodies, n_entries, free = len(bodies), flat.shape[1], vector[kept]
    # S = L L' and Z = R R'; `right_inverse` below is the transpose of R^-1.  Rounding
    # may have left the set: cholesky raises, which ends the refinement.
    factors = np.linalg.cholesky(np.concatenate([slack, duals]))
    inverse_factors = np.linalg.inv(factors)
    lower, lower_inverse = factors[:n_bodies], inverse_factors[:n_bodies]
    inverse = np.swapaxes(lower_inverse, 1, 2) @ lower_inverse
    right = factors[n_bodies:]
    right_inverse = np.swapaxes(inverse_factors[n_bodies:], 1, 2)
    roots = lower_inverse[:, None] @ generators @ right[:, None]
    bounds = np.sqrt(multipliers / free)
    solve = _factorise(
        problem, gram, roots.reshape(n_bodies, len(flat), n_entries), bounds
    )
    residual = problem.residual(vector)
    centre = lower_inverse @ right_inverse
    pseudo_inverse = np.linalg.solve(flat @ flat.T, flat)

    def symmetric(matrices):
        return 0.5 * (matrices + np.swapaxes(matrices, -1, -2))

    def direction(target, second_bodies, second_free):
        # tr(B S^-1) = <L^-1 B R, L^-1 R^-T> and <B, C> = <L^-1 B R, L' C R^-T>.
        second = np.swapaxes(lower, 1, 2) @ second_bodies @ right_inverse
        step = solve(
            (target * centre - second).reshape(n_bodies, n_entries),
            (target / free - second_free) / bounds,
            -residual,
        )
        change = (step[bodies] @ flat).reshape(slack.shape)
        dual_step = target * inverse - duals - second_bodies
        dual_step = dual_step - symmetric(inverse @ change @ duals)
        # In exact arithmetic the multipliers now balance the gradient; the inverse of a
        # slack near the boundary has too few digits for that.
        gradient = problem.root.T @ (residual + problem.root @ step)
        balanced = (duals + dual_step).reshape(n_bodies, n_entries) @ flat.T
        lacking = gradient[bodies] - balanced
        dual_step = dual_step + (lacking @ pseudo_inverse).reshape(slack.shape)
        dual_free = gradient[kept] - multipliers
        reach = min(
            _largest_step(inverse_factors, np.concatenate([change, dual_step])),
            _largest_scalar_step(free, step[kept]),
            _largest_scalar_step(multipliers, dual_free),
        )
        return reach, step, dual_step, dual_free, change

    if phase == "centre":
        reach, step, dual_step, dual_free, _ = direction(end, 0.0 * duals, 0.0 * free)
        return min(1.0, _BOUNDARY_SHARE * reach), step, dual_step, dual_free
    # Mehrotra: the predictor tells how far the target can be lowered, and its
    # second-order term corrects the step.
    reach, step, dual_step, dual_free, change = direction(0.0, 0.0 * duals, 0.0 * free)
    target = max(mean * max((1.0 - min(1.0, reach)) ** 3, 1e-3), end)
    if phase == "last":
        target = 0.0
    reach, step, dual_step, dual_free, _ = direction(
        target, symmetric(inverse @ change @ dual_step), step[kept] * dual_free / free
    )
    share = _LAST_SHARE if phase == "last" else _BOUNDARY_SHARE
    return min(1.0, share * reach), step, dual_step, dual_free


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
    largest = max(np.abs(duals).max(initial=0.0), np.abs(multipliers).max(initial=0.0))
    if largest == 0.0:
        return vector, duals, multipliers, 0
    vector, _ = lift(problem, vector, problem.margin + _START)
    eigenvalue, basis = np.linalg.eigh(duals)
    eigenvalue = np.maximum(eigenvalue, _START * largest)
    duals = np.einsum("bik,bk,bjk->bij", basis, eigenvalue, basis)
    multipliers = np.maximum(multipliers, _START * largest)

    n_steps = near = 0
    for _ in range(min(max_steps, _MAX_STEPS)):
        slack = problem.slack(vector)
        mean = (np.sum(slack * duals) + vector[kept] @ multipliers) / order
        end = 0.5 * _GAP_END * problem.distance(vector) ** 2 / order
        # A power of two, so that the rounding of the path so far does not move it.
        end = 2.0 ** np.floor(np.log2(max(end, np.finfo(float).tiny)))
        near += mean <= _NEAR * end
        phase = "last" if near > _CENTRINGS else "centre" if near else "down"
        try:
            reach, *change = _step(
                problem, gram, vector, slack, duals, multipliers, mean, end, phase
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
        if phase == "last":
            break
    return vector, duals, multipliers, n_steps
