r"""The projection as a convex programme: data, consistent starts, optimality bound.

Primal-dual refinement of a conic solution.

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

The projection as a conic programme: solving and certifying.

In scaled variables `x` (every parameter divided by its unit) the programme is

.. math::

    \min_x \tfrac12 \| T x - c \|^2 \quad \text{such that} \quad
    M_j(x) - \varepsilon E \succeq 0 \ \text{for every body},
    \quad x_k \ge 0 \ \text{for the non-negative columns},

with `T` upper triangular and nonsingular.  The solver gets the quadratic form ``T' T``,
which is the smallest of the usual forms but squares a condition number that is large to
begin with: what it returns is a start.  The refinement, which keeps the factors of all
matrices, makes it exact, and the certificate says how exact.
"""

from dataclasses import dataclass
from functools import cached_property

import clarabel
import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, cho_factor, cho_solve, solve_triangular

from sklearn_vbjfa.physical._pseudo_inertia import (
    N_INERTIAL,
    constraint_matrix,
    inertial_parameters,
    min_eigenvalue,
)


@dataclass(frozen=True, kw_only=True)
class ConicProblem:
    """The projection in scaled variables.

    Attributes
    ----------
    constraint : {"pseudo-inertia", "eq30"}
        Which matrix of a body has to be positive definite.
    body_columns : ndarray of int of shape (n_bodies, 10)
        Columns of every body.
    nonnegative : ndarray of int
        Columns that must not be negative.
    margin : float
        Least eigenvalue (dimensionless) of every body's matrix.
    point : ndarray of shape (n_features,)
        The vector to project, divided by the units.
    root : ndarray of shape (n_features, n_features)
        Upper triangular `T`: metric and pull to the anchor as one square root.
    shift : ndarray of shape (n_features,)
        `c`: the distance of a vector is ``|T (vector - point) - c|``.
    n_hidden : int
        Dimensions that the metric does not see, and the anchor alone determines.
    """

    constraint: str
    body_columns: np.ndarray
    nonnegative: np.ndarray
    margin: float
    point: np.ndarray
    root: np.ndarray
    shift: np.ndarray
    n_hidden: int

    @property
    def n_features(self):
        """Length of the parameter vector."""
        return self.point.size

    def residual(self, vector):
        """T (vector - point) - c, shape (n_features,)."""
        return self.root @ (vector - self.point) - self.shift

    def distance(self, vector):
        """Norm of the residual."""
        return float(np.linalg.norm(self.residual(vector)))

    @cached_property
    def generators(self):
        """Matrices of the ten unit bodies, shape (10, n, n), n = 4 or 6."""
        return constraint_matrix(np.eye(N_INERTIAL), self.constraint)

    def slack(self, vector):
        """Matrices that must be positive semidefinite, shape (n_bodies, n, n)."""
        matrices = constraint_matrix(vector[self.body_columns], self.constraint)
        return matrices - self.margin * np.eye(matrices.shape[-1])

    def min_eigenvalues(self, vector):
        """Smallest eigenvalue of each body's matrix, shape (n_bodies,)."""
        return min_eigenvalue(vector[self.body_columns], self.constraint)


def make_problem(
    point,
    *,
    constraint,
    body_columns,
    nonnegative,
    margin,
    metric_root,
    anchor,
    anchor_weight,
):
    """Assemble the programme from scaled quantities.

    Parameters
    ----------
    point : ndarray of shape (n_features,)
        Vector to project, in units of the scales.
    constraint : {"pseudo-inertia", "eq30"}
        Constraint set.
    body_columns : ndarray of int of shape (n_bodies, 10)
        Columns of every body.
    nonnegative : ndarray of int
        Columns that must not be negative.
    margin : float
        Least eigenvalue of every body's matrix.
    metric_root : ndarray of shape (n_features, n_features)
        Square root of the metric in scaled variables, largest column norm one (or
        zero).
    anchor : ndarray of shape (n_features,)
        Where what the metric does not see is pulled, in units of the scales.
    anchor_weight : float
        Weight of that pull.

    Returns
    -------
    problem : ConicProblem
        The programme.
    """
    # |R x|^2 + w |N'(x - a)|^2 as one triangular factor: the stacked QR does not square
    # the condition number as R'R would.
    hidden = _null_space(metric_root)
    pull = np.sqrt(anchor_weight) * hidden.T
    right = np.zeros(len(metric_root) + len(pull))
    right[len(metric_root) :] = pull @ (anchor - point)
    Q, root = np.linalg.qr(np.vstack([metric_root, pull]))
    return ConicProblem(
        constraint=constraint,
        body_columns=body_columns,
        nonnegative=nonnegative,
        margin=margin,
        point=point,
        root=root,
        shift=Q.T @ right,
        n_hidden=len(pull),
    )


def _null_space(root):
    """Orthonormal basis (n_features, n_hidden) of what a metric does not see.

    Up to the rounding of the metric, which is the square of its root.
    """
    _, values, rows = np.linalg.svd(root)
    limit = np.sqrt(values.size * np.finfo(float).eps) * values.max(initial=0.0)
    return rows[values <= limit].T


def lift(problem, vector, floor):
    """Move a vector inside the set along the bodies' unit matrices.

    Adding ``t`` times the body whose matrix is the unit matrix raises the smallest
    eigenvalue by exactly ``t``; nothing is moved further than it has to be.

    Parameters
    ----------
    problem : ConicProblem
        The programme.
    vector : ndarray of shape (n_features,)
        Vector in scaled units.
    floor : float
        Least eigenvalue wanted; non-negative columns end at ``floor - margin`` or
        above.

    Returns
    -------
    vector : ndarray of shape (n_features,)
        The lifted copy.
    step : float
        Largest eigenvalue added.
    """
    vector = vector.copy()
    unit = np.zeros(N_INERTIAL)
    unit[0] = 1.0
    unit[[4, 6, 9]] = 2.0 if problem.constraint == "pseudo-inertia" else 1.0
    bodies = problem.body_columns
    step = np.maximum(floor - problem.min_eigenvalues(vector), 0.0)
    vector[bodies] += step[:, None] * unit
    kept = problem.nonnegative
    vector[kept] = np.maximum(vector[kept], floor - problem.margin)
    return vector, float(step.max(initial=0.0))


def clip(problem, vector, floor):
    """Consistent vector by lifting negative eigenvalues: a start, not a projection.

    Parameters
    ----------
    problem : ConicProblem
        The programme.
    vector : ndarray of shape (n_features,)
        Vector in scaled units.
    floor : float
        Least eigenvalue of the result, above the margin.

    Returns
    -------
    vector : ndarray of shape (n_features,)
        A strictly consistent vector.
    """
    vector = vector.copy()
    bodies = problem.body_columns
    J = constraint_matrix(vector[bodies], "pseudo-inertia")
    eigenvalue, basis = np.linalg.eigh(J)
    eigenvalue = np.maximum(eigenvalue, floor)
    vector[bodies] = inertial_parameters(
        np.einsum("...ik,...k,...jk->...ij", basis, eigenvalue, basis)
    )
    return lift(problem, vector, floor)[0]


def certified_gap(problem, vector, duals, multipliers):
    r"""Bound on how far a consistent vector is from optimal.

    For any positive semidefinite `Z_j` and non-negative `z_k`, weak duality of the
    strongly convex programme gives

    .. math::

        \tfrac12 \|r(x)\|^2 - \tfrac12 \|r(x^\star)\|^2 \le
        \sum_j \langle Z_j, M_j(x) - \varepsilon E \rangle + \sum_k z_k x_k
        + \tfrac12 \| T^{-\top} (T^\top r - G^\top z) \|^2.

    It holds whatever the solver says of its own end.

    Parameters
    ----------
    problem : ConicProblem
        The programme.
    vector : ndarray of shape (n_features,)
        Consistent vector in scaled units.
    duals : ndarray of shape (n_bodies, n, n)
        Symmetric matrices; their negative part is dropped.
    multipliers : ndarray of shape (n_nonnegative,)
        Multipliers of the non-negative columns; negative ones are dropped.

    Returns
    -------
    gap : float
        Upper bound on the excess of half the squared distance.
    """
    eigenvalue, basis = np.linalg.eigh(duals)
    duals = np.einsum(
        "...ik,...k,...jk->...ij", basis, np.maximum(eigenvalue, 0.0), basis
    )
    multipliers = np.maximum(multipliers, 0.0)
    complementarity = np.sum(duals * problem.slack(vector))
    complementarity += multipliers @ vector[problem.nonnegative]
    stationarity = problem.root.T @ problem.residual(vector)
    stationarity[problem.body_columns] -= np.einsum(
        "kij,bij->bk", problem.generators, duals
    )
    stationarity[problem.nonnegative] -= multipliers
    error = solve_triangular(problem.root, stationarity, trans="T")
    return float(complementarity + 0.5 * error @ error)


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


# The certified gap that ends the search for a better solve, relative to the squared
# distance, and the one up to which an answer is accepted.
_GAP_TARGET = 1e-6
_GAP_LIMIT = 1e-4
# Distances below this fraction of the vector's own length count as this fraction in the
# relative gap: the solver resolves the matrices to about 1e-9 of their size, the square
# root of the limit times this.
_RESOLUTION = 1e-7
# Where the solver stops, in units of the distance: the refinement starts further back,
# and rounding in the quadratic form allows no more than this.
_SOLVER_TOLERANCE = 1e-8


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
        *refined, steps = refine(
            problem, vector, duals, multipliers, max_steps=max_solver_iter
        )
        n_iter += steps
        best = _better(problem, best, refined, status, least)
        # The solver's own answer, whose last digits are rounding, where it has to be.
        if best[1] > _GAP_TARGET:
            raw = vector, duals, multipliers
            best = _better(problem, best, raw, status, least)
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
    bodies, kept = problem.body_columns, problem.nonnegative
    size = problem.generators.shape[-1]
    # clarabel stacks the upper triangle by columns, off-diagonal entries times sqrt(2).
    column, row = np.tril_indices(size)
    weight = np.where(row == column, 1.0, np.sqrt(2.0))
    triangle = (problem.generators[:, row, column] * weight).T
    n_bodies, n_entries = len(bodies), len(row)
    # Unknown: the displacement from the point, in units of `scale`.  Rows: s = b - A x,
    # the bodies' first, then those of the non-negative columns.
    entry, parameter = np.nonzero(triangle)
    first_kept = n_bodies * n_entries
    body_rows = n_entries * np.arange(n_bodies)[:, None] + entry
    rows = np.r_[body_rows.ravel(), first_kept + np.arange(kept.size)]
    columns = np.r_[bodies[:, parameter].ravel(), kept]
    values = np.r_[np.tile(-triangle[entry, parameter], n_bodies), -np.ones(kept.size)]
    shape = first_kept + kept.size, problem.n_features
    slack = problem.point[bodies] @ triangle.T - problem.margin * (row == column)
    right = np.r_[slack.ravel(), problem.point[kept]] / scale
    cones = [clarabel.PSDTriangleConeT(size)] * n_bodies
    if kept.size:
        cones.append(clarabel.NonnegativeConeT(kept.size))

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = max_solver_iter
    settings.tol_gap_abs = settings.tol_gap_rel = _SOLVER_TOLERANCE
    settings.tol_feas = _SOLVER_TOLERANCE
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(problem.root.T @ problem.root)),
        -problem.root.T @ problem.shift / scale,
        sparse.csc_matrix((values, (rows, columns)), shape=shape),
        right,
        cones,
        settings,
    ).solve()

    vector = problem.point + scale * np.array(solution.x)
    z = scale * np.array(solution.z)
    duals = np.zeros((n_bodies, size, size))
    entries = z[:first_kept].reshape(n_bodies, n_entries) / weight
    duals[:, row, column] = entries
    duals[:, column, row] = entries
    multipliers = z[first_kept:]
    return vector, duals, multipliers, int(solution.iterations), str(solution.status)
