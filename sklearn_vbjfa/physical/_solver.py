"""Solve the projection's programme with a conic solver, and certify the solution.

clarabel solves the programme, the refinement adds the last digits, and the duality gap
certifies the result. If clarabel fails, or the refinement of its solution does not
reach the target gap (rods with small errors, at distances of 1e-9 of the vector), the
refinement starts from the vector with clipped eigenvalues.

For clarabel the programme is stated with the displacement d from the vector to project,
in units of a distance s:

    min_(d, t) t  such that  (t, T d - c / s) in SOC,
    (M_j(x_0) - eps E) / s + M_j(d) >= 0,  x_0k / s + d_k >= 0.

As a second-order cone the distance keeps the condition number of T, which its square,
the quadratic form T' T, would square.
"""

from dataclasses import dataclass, replace
from itertools import chain

import clarabel
import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, cho_factor, cho_solve, solve_triangular

from sklearn_vbjfa.physical._programme import PrimalDual, raised

# Certified gaps over the squared distance: the target, and the largest accepted.
GAP_TARGET = 1e-9
_GAP_LIMIT = 1e-4
# Largest number of iterations of clarabel, and of steps of one refinement.
_MAX_STEPS = 200
# Share of the bodies from which all constraints are used at once.
_MOST = 0.5


class ProjectionError(RuntimeError):
    """The projection found no vector that is certified to be the nearest one."""


@dataclass(frozen=True, kw_only=True)
class CertifiedVector:
    """A consistent vector with its certificate."""

    vector: np.ndarray  # (n_features,): consistent vector in scaled units
    # certified excess of the squared distance, relative, see `Programme.relative_gap`
    gap: float
    status: str  # how clarabel ended, and its refinement if the gap is not reached


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
    """Solve a programme with clarabel, refine the solution and certify it."""
    # The smallest lift is a solution if almost nothing has to change; its squared
    # distance bounds its gap.
    vector = programme.lift(programme.point, programme.margin)
    squared, least = programme.distance(vector) ** 2, programme.resolution**2
    gap = squared / max(squared, least, np.finfo(float).tiny)
    if gap <= GAP_TARGET:
        return CertifiedVector(vector=vector, gap=gap, status="nothing to do")
    answer, status = solve_conic(programme)
    how = "without a start"
    for start in chain([answer], clipped_starts(programme)):
        if gap <= GAP_TARGET:
            break
        if not start.is_finite:
            continue
        end, ended = refine(programme, start)
        # The refined vector, or the start if it is better.
        for candidate in (end, start):
            lifted = programme.lift(candidate.vector, programme.margin)
            certified = programme.relative_gap(
                lifted, candidate.duals, candidate.multipliers
            )
            if certified < gap:
                vector, gap, how = lifted, certified, ended
    if gap > _GAP_LIMIT:
        raise ProjectionError(
            f"The projection on the {programme.constraint!r} set failed: clarabel "
            f"ended with {status}, and the certified relative gap {gap:.1e} is above "
            f"{_GAP_LIMIT:.0e}. Check the vector and the metric for columns many "
            "orders of magnitude apart."
        )
    if gap > GAP_TARGET:
        status = f"{status}; its refinement ended {how}"
    return CertifiedVector(vector=vector, gap=max(gap, 0.0), status=status)


def solve_conic(programme):
    """Solve with clarabel; return its solution and status."""
    # The solution is not finite if the solver broke down.
    # Since tolerances are also absolute, the unit is the distance of a consistent
    # vector, or the resolution if that is larger.
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
    settings.max_iter = _MAX_STEPS
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

    # Multipliers of half the squared distance are those of the distance times it.
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
    return answer, str(solution.status)


# -- primal-dual refinement of a conic solver's answer ---------------------------------

# A general conic solver stops at a relative gap of 1e-7 with several bodies and 1e-4
# with rods, where its barrier still determines directions of small metric. Here the
# slack matrices are eliminated, and Newton's steps converge to the point of the central
# path at a given gap: the solution does not depend on the start. Directions are those
# of Helmberg, Kojima and Monteiro (doi:10.1137/0806020), with slack S, multiplier Z and
# target m:
#
#     (T' T + sum_j [tr(B_k S_j^-1 B_l Z_j)]_kl) dx
#         = -T' r + m sum_j [tr(B_k S_j^-1)]_k.


# Start of the path: target of the products of slack and multipliers, relative to the
# squared distance, and the largest lift of an eigenvalue.
_ENTRY = 1e-3
_LARGEST_LIFT = 1e-3
# Least eigenvalues of the start from clipped eigenvalues, in scaled units.
_CLIPPED = (0.1, 1e-2, 1.0)
# Largest share of the way to the boundary in a step.
_BOUNDARY_SHARE = 0.95
# The same for the last step, which leaves the path.
_LAST_SHARE = 1.0 - 1e-6
_SHORTEST_STEP = 1e-6
# Gap, relative to the squared distance, at which the path ends: above the rounding
# level of 1e-11 to 1e-9, and far below the accepted gap.
_GAP_END = 4e-9
# Distance from the end of the path, in units of that gap, and number of Newton's steps
# there, which converge to one point.
_NEAR = 4.0
_CENTRINGS = 6
# Corrections of a step with the residual of its equations.
_CORRECTIONS = 4


def clipped_starts(programme):
    """Yield starts without a solver: eigenvalues clipped, multipliers on the path."""
    kept = programme.nonnegative
    for floor in _CLIPPED:
        vector = programme.clip(programme.margin + floor)
        slack = programme.slack(vector)
        mean = programme.distance(vector) ** 2 / (slack[..., 0].size + kept.size)
        mean = max(mean, np.finfo(float).tiny)
        yield PrimalDual(
            vector=vector,
            duals=mean * _symmetric(np.linalg.inv(slack)),
            multipliers=mean / vector[kept],
        )


def refine(programme, start):
    """Follow the central path from an approximate solution to its end."""
    # Also returns how it ended. Up to rounding the end is inside the set.
    kept = programme.nonnegative
    at = _inside(programme, start)
    order = len(at.duals) * programme.generators.shape[-1] + kept.size
    near = 0
    for _ in range(_MAX_STEPS):
        slack = programme.slack(at.vector)
        mean = (np.sum(slack * at.duals) + at.vector[kept] @ at.multipliers) / order
        end = 0.5 * _GAP_END * programme.distance(at.vector) ** 2 / order
        # A power of two, so that it does not depend on the rounding of earlier steps.
        end = 2.0 ** np.floor(np.log2(max(end, np.finfo(float).tiny)))
        near += mean <= _NEAR * end
        last = near > _CENTRINGS
        try:
            system = _Equations(programme, at, slack)
            if last:
                # From the central path to the optimum.
                reach, step = system.predict_and_correct(0.0, 0.0)
            elif near:
                reach, step, _ = system.direction(end)
            else:
                reach, step = system.predict_and_correct(mean, end)
        except (LinAlgError, np.linalg.LinAlgError):
            # Rounding has reached the boundary: return the last iterate.
            return at, "by rounding, at a matrix that is not definite"
        share = min(1.0, (_LAST_SHARE if last else _BOUNDARY_SHARE) * reach)
        if share < _SHORTEST_STEP:
            return at, "by rounding, at steps without length"
        at = at.moved(step, share)
        if last:
            return at, "at its end"
    return at, "at its last step"


def _inside(programme, start):
    """Move a solution from the boundary to the neighbourhood of the path."""
    # The products of slack and multipliers, zero at a solution, become `m` to ``2 m``
    # by a lift of ``m / |Z|`` and additional multipliers of ``m / S``.
    kept = programme.nonnegative
    duals, multipliers = raised(start.duals, 0.0), np.maximum(start.multipliers, 0.0)
    tiny = np.finfo(float).tiny
    squared = programme.distance(programme.lift(start.vector, programme.margin)) ** 2
    squared = max(squared, programme.resolution**2)
    target = max(_ENTRY * squared / (duals[..., 0].size + kept.size), tiny)
    largest = max(duals.max(initial=0.0), multipliers.max(initial=0.0), tiny)
    lift = min(target / largest, _LARGEST_LIFT)
    vector = programme.lift(start.vector, programme.margin + lift)
    return PrimalDual(
        vector=vector,
        duals=duals + target * _symmetric(np.linalg.inv(programme.slack(vector))),
        multipliers=multipliers + target / vector[kept],
    )


class _Equations:
    """Newton's equations at one point of the path."""

    # The system is A' A for the stack A of the bodies' roots L^-1 B R (S = L L', Z = R
    # R'), the roots of the bounds and T; the right side is A' (bodies, bounds, metric).
    # Near the boundary the sum is no longer definite in floating point; the triangle of
    # a QR decomposition of A is used then. The condition number is squared, which
    # repeated corrections with the residual of the stack make good: the corrected
    # seminormal equations of Bjoerck (doi:10.1016/0024-3795(87)90101-7).

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
        columns, system = programme.body_columns, programme.gram.copy()
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
        # Large rows first, for row-wise stability of Householder's method.
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
        """Return the reach of a step to a target, the step, and its change of slack."""
        # second_bodies and second_free are the second-order terms of the equations.
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
        # Exact balance: inverses of slack matrices near the boundary lose digits.
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
        iterate = PrimalDual(vector=step, duals=dual_step, multipliers=dual_free)
        return reach, iterate, change

    def predict_and_correct(self, mean, end):
        """Return reach and step of Mehrotra's predictor and corrector."""
        # The predictor determines the decrease of the target from `mean`, at most to
        # `end`, and its second-order term corrects the step.
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
