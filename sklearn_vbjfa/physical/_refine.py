r"""Primal-dual refinement of a conic solution.

A general solver factors an indefinite, regularised system and stops at a relative gap of
about 1e-7.  Directions that the metric hardly sees need more: at that gap they are
still placed by the barrier, not by the anchor.  Here the slack matrices are eliminated,
which leaves one positive definite system of the size of the parameter vector, and the
gap goes down by another four to six orders of magnitude.

The directions are those of Helmberg, Kojima and Monteiro: with slack `S`, multiplier `Z`
and target `m`,

.. math::

    \Big(T^\top T + \sum_j [\operatorname{tr}(B_k S_j^{-1} B_l Z_j)]_{kl}\Big)
    \mathrm{d}x = -T^\top r + m \sum_j [\operatorname{tr}(B_k S_j^{-1})]_k .
"""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

# Share of the way to the boundary that a step may go.
_BOUNDARY_SHARE = 0.95
_MAX_STEPS = 40
# The refinement has no more to give when the target has fallen this far below the
# squared distance.
_LAST_TARGET = 1e-15


def _largest_step(matrices, directions):
    """Largest t <= 1 / share for which every matrix + t direction stays definite."""
    if not len(matrices):
        return np.inf
    inverse = np.linalg.inv(np.linalg.cholesky(matrices))
    relative = inverse @ directions @ np.swapaxes(inverse, -1, -2)
    lowest = np.linalg.eigvalsh(relative)[:, 0].min()
    return np.inf if lowest >= 0 else -1.0 / lowest


def _largest_scalar_step(values, directions):
    """Largest t for which every value + t direction stays positive."""
    falling = directions < 0
    if not falling.any():
        return np.inf
    return float(np.min(-values[falling] / directions[falling]))


def refine(problem, vector, duals, multipliers):
    """Follow the central path from near an approximate solution to its end.

    Parameters
    ----------
    problem : ConicProblem
        The programme.
    vector : ndarray of shape (n_features,)
        Strictly consistent vector in scaled units: every slack positive definite.
    duals : ndarray of shape (n_bodies, n, n)
        Positive definite multipliers of the bodies.
    multipliers : ndarray of shape (n_nonnegative,)
        Positive multipliers of the non-negative columns.

    Returns
    -------
    vector : ndarray of shape (n_features,)
        Refined vector, consistent.
    duals : ndarray of shape (n_bodies, n, n)
        Refined multipliers.
    multipliers : ndarray of shape (n_nonnegative,)
        Refined multipliers.
    n_steps : int
        Steps taken.
    """
    bodies, kept = problem.body_columns, problem.nonnegative
    generators = problem.generators
    size = generators.shape[-1]
    order = len(bodies) * size + kept.size
    gram = problem.root.T @ problem.root
    floor = _LAST_TARGET * max(problem.distance(vector) ** 2, np.finfo(float).tiny)

    n_steps = 0
    for _ in range(_MAX_STEPS):
        slack = problem.slack(vector)
        free = vector[kept]
        mean = (np.sum(slack * duals) + free @ multipliers) / order
        if mean <= floor:
            break
        try:
            inverse = np.linalg.inv(slack)
            # [k, j] of shape (10, n_bodies): B_k S_j^-1 and B_k Z_j.
            left = generators[None] @ inverse[:, None]
            right = generators[None] @ duals[:, None]
            system = gram.copy()
            system[bodies[:, :, None], bodies[:, None, :]] += np.einsum(
                "bkij,blji->bkl", left, right
            )
            system[kept, kept] += multipliers / free
            scale = 1.0 / np.sqrt(np.diag(system))
            factor = cho_factor(system * scale * scale[:, None])
            gradient = problem.root.T @ problem.residual(vector)
            barrier = np.zeros(problem.n_features)
            barrier[bodies] = np.einsum("bkii->bk", left)
            barrier[kept] = 1.0 / free

            def direction(target, correction=None):
                right_side = target * barrier - gradient
                if correction is not None:
                    right_side[bodies] -= correction[0]
                    right_side[kept] -= correction[1]
                step = scale * cho_solve(factor, scale * right_side)
                change = np.einsum("kij,bk->bij", generators, step[bodies])
                product = inverse @ change @ duals
                dual_step = target * inverse - duals
                dual_step = dual_step - 0.5 * (product + np.swapaxes(product, -1, -2))
                dual_free = target / free - multipliers - step[kept] * multipliers / free
                if correction is not None:
                    dual_step = dual_step - correction[2]
                    dual_free = dual_free - correction[1]
                return step, change, dual_step, dual_free

            def length(step, change, dual_step, dual_free):
                return min(
                    _largest_step(slack, change),
                    _largest_step(duals, dual_step),
                    _largest_scalar_step(free, step[kept]),
                    _largest_scalar_step(multipliers, dual_free),
                )

            # Mehrotra's predictor tells how far the target can be lowered, and its
            # second-order term corrects the step.
            predictor = direction(0.0)
            reach = min(1.0, length(*predictor))
            target = mean * max((1.0 - reach) ** 3, 1e-3)
            second = inverse @ predictor[1] @ predictor[2]
            second = 0.5 * (second + np.swapaxes(second, -1, -2))
            correction = (
                np.einsum("kij,bij->bk", generators, second),
                predictor[0][kept] * predictor[3] / free,
                second,
            )
            step, change, dual_step, dual_free = direction(target, correction)
            reach = min(
                1.0, _BOUNDARY_SHARE * length(step, change, dual_step, dual_free)
            )
        except (LinAlgError, np.linalg.LinAlgError):
            # Rounding has reached the boundary: the last iterate stands.
            break
        if reach < 1e-6:
            break
        vector = vector + reach * step
        duals = duals + reach * dual_step
        multipliers = multipliers + reach * dual_free
        n_steps += 1
    return vector, duals, multipliers, n_steps
