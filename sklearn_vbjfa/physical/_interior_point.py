r"""Primal-dual interior-point method for the projection.

General conic solvers factor an indefinite, regularised system and stop at a relative
gap of about 1e-7, in whatever form the distance is stated.  Directions that the metric
hardly sees need more: at that gap they are still placed by the barrier, not by the
anchor.  Here the slack matrices are eliminated, which leaves one positive definite
system of the size of the parameter vector.  Three things take the gap down to 1e-9 and
less: the system is formed from the square roots of its parts, so that it is symmetric
and semidefinite to the last digit; its solutions are corrected; and the multipliers'
step is made to balance the gradient, which the formula for it does only in exact
arithmetic.  The path ends at a gap that is set beforehand, with Newton's steps to the
one point that belongs to it, from which one more step leads to the optimum: the answer
is the same whatever the rounding was on the way.

The directions are those of Helmberg, Kojima and Monteiro (doi:10.1137/0806020): with
slack `S`, multiplier `Z` and target `m`,

.. math::

    \Big(T^\top T + \sum_j [\operatorname{tr}(B_k S_j^{-1} B_l Z_j)]_{kl}\Big)
    \mathrm{d}x = -T^\top r + m \sum_j [\operatorname{tr}(B_k S_j^{-1})]_k .
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

# The certified gap that ends the search for a better path, relative to the squared
# distance, and the one up to which an answer is accepted.
_GAP_TARGET = 1e-6
_GAP_LIMIT = 1e-4
# Where a path begins: least eigenvalue of the bodies' matrices, in scaled units.
_STARTS = (0.1, 1e-2, 1.0)
# Share of the way to the boundary that a step may go.
_BOUNDARY_SHARE = 0.95
# The same for the last step, after which there is no path to keep to.
_LAST_SHARE = 1.0 - 1e-6
_SHORTEST_STEP = 1e-6
# Gap, relative to the squared distance, at which the path ends: above the parts in 1e11
# to 1e9 at which rounding would stop it, and far below what is asked of an answer.
_GAP_END = 4e-9
# Where the path counts as near its end, in units of that, and Newton's steps there.
# They converge to one point, wherever on the way rounding had led the iterates.
_NEAR = 4.0
_CENTRINGS = 6
# Corrections of a step with the residual of its equations.
_CORRECTIONS = 4


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
    """A consistent vector and what is known of it.

    Attributes
    ----------
    vector : ndarray of shape (n_features,)
        Consistent vector in scaled units.
    gap : float
        Certified excess of the squared distance, relative, see
        `Programme.relative_gap`.
    n_iter : int
        Steps taken, all paths together.
    status : {"nothing to do", "Solved", "MaxIterations", "Rounding"}
        How the path of the vector ended.
    """

    vector: np.ndarray
    gap: float
    n_iter: int
    status: str


def solve(programme, *, max_steps):
    """Solve a programme and certify the answer.

    Parameters
    ----------
    programme : Programme
        The projection in scaled variables.
    max_steps : int
        Largest number of steps of one path.

    Returns
    -------
    Solution
        The nearest vector.

    Raises
    ------
    ProjectionError
        If no path ends with a certified gap below the limit.
    """
    # The least lift is an answer by itself where hardly anything has to move; no vector
    # is nearer than nothing, so its own squared distance bounds its excess.
    vector = programme.lift(programme.point, programme.margin)
    squared, least = programme.distance(vector) ** 2, programme.resolution**2
    gap = squared / max(squared, least, np.finfo(float).tiny)
    n_iter, status = 0, "nothing to do"
    for start in _STARTS:
        if gap <= _GAP_TARGET:
            break
        end, steps, ended = _follow(programme, start, max_steps)
        n_iter += steps
        candidate = programme.lift(end.vector, programme.margin)
        found = programme.relative_gap(candidate, end.duals, end.multipliers)
        if found < gap:
            vector, gap, status = candidate, found, ended
    if gap > _GAP_LIMIT:
        raise ProjectionError(
            f"The projection on the {programme.constraint!r} set failed: the "
            f"interior-point method ended with {ended} after {n_iter} iterations, and "
            f"the certified relative gap {gap:.1e} is above {_GAP_LIMIT:.0e}. Raise "
            "max_solver_iter, or check the vector and the metric for columns many "
            "orders of magnitude apart."
        )
    return Solution(vector=vector, gap=max(gap, 0.0), n_iter=n_iter, status=status)


@dataclass(frozen=True, kw_only=True)
class Iterate:
    """A point of the path, or a step from one to the next.

    Attributes
    ----------
    vector : ndarray of shape (n_features,)
        Strictly consistent vector in scaled units.
    duals : ndarray of shape (n_bodies, n, n)
        Multipliers of the bodies' matrices.
    multipliers : ndarray of shape (n_nonnegative,)
        Multipliers of the non-negative columns.
    """

    vector: np.ndarray
    duals: np.ndarray
    multipliers: np.ndarray

    def moved(self, step, share):
        """Return the point a share of a step away."""
        return Iterate(
            vector=self.vector + share * step.vector,
            duals=self.duals + share * step.duals,
            multipliers=self.multipliers + share * step.multipliers,
        )


def _follow(programme, start, max_steps):
    """Follow the central path; return its last iterate, the steps and how it ended.

    Rounding may leave the iterate outside the set by as much.
    """
    kept = programme.nonnegative
    vector = programme.clip(programme.margin + start)
    slack = programme.slack(vector)
    order = len(slack) * slack.shape[-1] + kept.size
    mean = max(programme.distance(vector) ** 2 / order, np.finfo(float).tiny)
    at = Iterate(
        vector=vector,
        duals=mean * _symmetric(np.linalg.inv(slack)),
        multipliers=mean / vector[kept],
    )
    near = 0
    for taken in range(max_steps):
        slack = programme.slack(at.vector)
        mean = (np.sum(slack * at.duals) + at.vector[kept] @ at.multipliers) / order
        end = 0.5 * _GAP_END * programme.distance(at.vector) ** 2 / order
        # A power of two, so that the rounding of the path so far does not move it.
        end = 2.0 ** np.floor(np.log2(max(end, np.finfo(float).tiny)))
        near += mean <= _NEAR * end
        try:
            system = _Equations(programme, at, slack)
            if near > _CENTRINGS:
                # From the centre to the optimum, with no path to keep to.
                reach, step = system.predict_and_correct(0.0, 0.0)
            elif near:
                reach, step, _ = system.direction(end)
            else:
                reach, step = system.predict_and_correct(mean, end)
        except (LinAlgError, np.linalg.LinAlgError):
            # Rounding has reached the boundary: the last iterate stands.
            return at, taken, "Rounding"
        last = near > _CENTRINGS
        share = min(1.0, (_LAST_SHARE if last else _BOUNDARY_SHARE) * reach)
        if share < _SHORTEST_STEP:
            return at, taken, "Rounding"
        at = at.moved(step, share)
        if last:
            return at, taken + 1, "Solved"
    return at, max_steps, "MaxIterations"


class _Equations:
    """Newton's equations at one point of the path.

    The system is ``A' A`` for the stack `A` of the bodies' roots ``L^-1 B R`` (with
    ``S = L L'`` and ``Z = R R'``), the roots of the bounds and `T`; the right side is
    ``A' (bodies, bounds, metric)``.  Near the boundary the barrier's share is larger
    than the metric's by more than the machine precision, and the sum is no longer
    definite in floating point; the triangle of a QR decomposition of `A` is used then.
    Either way the condition number is squared, which corrections with the residual of
    the stack make good: the corrected seminormal equations of Bjoerck
    (doi:10.1016/0024-3795(87)90101-7), repeated.

    Parameters
    ----------
    programme : Programme
        The projection in scaled variables.
    at : Iterate
        The point.
    slack : ndarray of shape (n_bodies, n, n)
        Its slack.  LinAlgError is raised where it is not definite.
    """

    def __init__(self, programme, at, slack):
        self._programme, self._at = programme, at
        kept, generators = programme.nonnegative, programme.generators
        n_bodies, size = slack.shape[:2]
        factors = np.linalg.cholesky(np.concatenate([slack, at.duals]))
        self._inverse_factors = np.linalg.inv(factors)
        self._lower, right = factors[:n_bodies], factors[n_bodies:]
        lower_inverse = self._inverse_factors[:n_bodies]
        # The transpose of R^-1.
        self._right_inverse = np.swapaxes(self._inverse_factors[n_bodies:], 1, 2)
        self._inverse = np.swapaxes(lower_inverse, 1, 2) @ lower_inverse
        self._centre = lower_inverse @ self._right_inverse
        roots = lower_inverse[:, None] @ generators @ right[:, None]
        self._roots = roots.reshape(n_bodies, len(generators), size**2)
        self._free = at.vector[kept]
        self._bounds = np.sqrt(at.multipliers / self._free)
        self._residual = programme.residual(at.vector)
        self._flat = generators.reshape(len(generators), -1)
        self._pseudo_inverse = np.linalg.solve(self._flat @ self._flat.T, self._flat)
        self._factorise()

    def _factorise(self):
        columns, kept = self._programme.body_columns, self._programme.nonnegative
        system = self._programme.gram.copy()
        system[columns[:, :, None], columns[:, None, :]] += self._roots @ np.swapaxes(
            self._roots, 1, 2
        )
        system[kept, kept] += self._bounds**2
        self._scale = 1.0 / np.sqrt(np.diag(system))
        scaled = system * self._scale * self._scale[:, None]
        try:
            self._factor = cho_factor(scaled, check_finite=False)
        except LinAlgError:
            self._factor = self._triangle(), False

    def _triangle(self):
        """Upper triangular factor of the system, from its square roots."""
        columns, kept = self._programme.body_columns, self._programme.nonnegative
        n_bodies, _, n_entries = self._roots.shape
        barrier = np.zeros((n_bodies * n_entries, self._scale.size))
        rows = np.arange(len(barrier)).reshape(n_bodies, n_entries)
        barrier[rows[:, None, :], columns[:, :, None]] = self._roots
        single = np.zeros((kept.size, self._scale.size))
        single[np.arange(kept.size), kept] = self._bounds
        stacked = np.vstack([barrier, single, self._programme.root]) * self._scale
        # Large rows first: Householder's method is then stable row by row.
        order = np.argsort(-np.linalg.norm(stacked, axis=1))
        return np.linalg.qr(stacked[order], mode="r")

    def _solve_once(self, bodies, free, metric):
        right_side = self._programme.root.T @ metric
        columns = self._programme.body_columns
        right_side[columns] += (self._roots @ bodies[:, :, None])[..., 0]
        right_side[self._programme.nonnegative] += self._bounds * free
        scaled = self._scale * right_side
        return self._scale * cho_solve(self._factor, scaled, check_finite=False)

    def _solve(self, bodies, free, metric):
        columns, kept = self._programme.body_columns, self._programme.nonnegative
        step = self._solve_once(bodies, free, metric)
        for _ in range(_CORRECTIONS):
            step = step + self._solve_once(
                bodies - (step[columns][:, None] @ self._roots)[:, 0],
                free - self._bounds * step[kept],
                metric - self._programme.root @ step,
            )
        return step

    def direction(self, target, second_bodies=0.0, second_free=0.0):
        """Return how far a step to a target can go, the step, and its change of slack.

        The other two are the second-order terms of the equations.
        """
        programme, at = self._programme, self._at
        bodies, kept = programme.body_columns, programme.nonnegative
        n_bodies, shape = len(bodies), at.duals.shape
        second_bodies = np.broadcast_to(second_bodies, shape)
        # tr(B S^-1) = <L^-1 B R, L^-1 R^-T> and <B, C> = <L^-1 B R, L' C R^-T>.
        second = np.swapaxes(self._lower, 1, 2) @ second_bodies @ self._right_inverse
        step = self._solve(
            (target * self._centre - second).reshape(n_bodies, self._flat.shape[1]),
            (target / self._free - second_free) / self._bounds,
            -self._residual,
        )
        change = (step[bodies] @ self._flat).reshape(shape)
        dual_step = target * self._inverse - at.duals - second_bodies
        dual_step = dual_step - _symmetric(self._inverse @ change @ at.duals)
        # In exact arithmetic the multipliers now balance the gradient; the inverse of a
        # slack near the boundary has too few digits for that.
        gradient = programme.root.T @ (self._residual + programme.root @ step)
        reached = (at.duals + dual_step).reshape(n_bodies, self._flat.shape[1])
        lacking = gradient[bodies] - reached @ self._flat.T
        dual_step = dual_step + (lacking @ self._pseudo_inverse).reshape(shape)
        dual_free = gradient[kept] - at.multipliers
        changes = np.concatenate([change, dual_step])
        relative = (
            self._inverse_factors @ changes @ np.swapaxes(self._inverse_factors, 1, 2)
        )
        falls = np.r_[
            np.linalg.eigvalsh(relative)[:, 0],
            step[kept] / self._free,
            dual_free / at.multipliers,
        ]
        lowest = falls.min(initial=0.0)
        reach = np.inf if lowest >= 0 else -1.0 / lowest
        iterate = Iterate(vector=step, duals=dual_step, multipliers=dual_free)
        return reach, iterate, change

    def predict_and_correct(self, mean, end):
        """Return reach and step of Mehrotra's predictor and corrector.

        The predictor tells how far the target can be lowered from `mean`, at most to
        `end`, and its second-order term corrects the step.
        """
        reach, step, change = self.direction(0.0)
        kept = self._programme.nonnegative
        reach, step, _ = self.direction(
            max(mean * max((1.0 - min(1.0, reach)) ** 3, 1e-3), end),
            _symmetric(self._inverse @ change @ step.duals),
            step.vector[kept] * step.multipliers / self._free,
        )
        return reach, step


def _symmetric(matrices):
    return 0.5 * (matrices + np.swapaxes(matrices, -1, -2))
