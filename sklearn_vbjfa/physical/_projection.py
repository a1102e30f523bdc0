"""Projection of one parameter vector on the physically consistent ones.

Metric of the projection: validation, square root, and what it cannot see.
"""

import warnings
from dataclasses import dataclass, replace
from numbers import Integral, Real

import numpy as np

from sklearn_vbjfa.physical._layout import resolve_layout
from sklearn_vbjfa.physical._programme import (
    ProjectionError,
    clip,
    lift,
    make_problem,
    solve_conic,
)
from sklearn_vbjfa.physical._pseudo_inertia import (
    _check_constraint,
    body_scales,
    min_eigenvalue,
    parameter_units,
)
from sklearn_vbjfa.physical._threads import one_blas_thread
from sklearn_vbjfa.physical._virtual import solve_virtual

# How many times longer than the visible part of a vector its hidden part may be before
# it is taken for rounding; a plausible robot's are of one order.
_HIDDEN_LIMIT = 100.0


@dataclass(frozen=True, kw_only=True)
class Metric:
    """Validated metric with its square root.

    Attributes
    ----------
    matrix : ndarray of shape (n_features, n_features)
        Symmetric positive semidefinite `A`.
    root : ndarray of shape (n_features, n_features)
        `R` with ``R' R = A``.
    size : ndarray of shape (n_features,)
        Square root of the diagonal.
    basis : ndarray of shape (n_features, n_visible)
        Orthonormal basis of what `A` sees, in units of `size`.
    """

    matrix: np.ndarray
    root: np.ndarray
    size: np.ndarray
    basis: np.ndarray

    def without_rounding(self, theta):
        """Drop what the metric does not see where it dwarfs what it sees.

        A least-squares solve that does not cut its singular values returns 1e10 and
        more along the directions without information.  Such numbers say nothing, and
        neither scales nor anchors may come from them.

        Parameters
        ----------
        theta : ndarray of shape (n_features,)
            Parameter vector.

        Returns
        -------
        theta : ndarray of shape (n_features,)
            The vector, or its visible part.
        """
        standardised = theta * self.size
        visible = self.basis @ (self.basis.T @ standardised)
        hidden = np.linalg.norm(standardised - visible)
        if hidden <= _HIDDEN_LIMIT * np.linalg.norm(visible):
            return theta
        warnings.warn(
            f"The part of theta that the metric does not see is {hidden:.1e} long in "
            f"units of the metric, the part it sees {np.linalg.norm(visible):.1e}: "
            "taken for the rounding of a singular regression and replaced by the "
            "shortest vector that predicts the same. Fit with a regressor that cuts "
            "small singular values.",
            UserWarning,
            stacklevel=4,
        )
        return np.divide(
            visible, self.size, out=np.zeros_like(theta), where=self.size > 0
        )


@one_blas_thread()
def check_metric(metric, n_features):
    """Validate a metric and take its square root.

    Parameters
    ----------
    metric : array-like of shape (n_features, n_features)
        Symmetric positive semidefinite matrix.
    n_features : int
        Length of the parameter vectors.

    Returns
    -------
    metric : Metric
        The symmetric part and its square root.

    Raises
    ------
    ValueError
        If the shape is wrong, a value is not finite, or the matrix is not symmetric
        or not positive semidefinite beyond rounding.
    """
    metric = np.asarray(metric, dtype=float)
    if metric.shape != (n_features, n_features):
        raise ValueError(
            f"metric must have shape ({n_features}, {n_features}), one row and column "
            f"per parameter, got {metric.shape}."
        )
    if not np.all(np.isfinite(metric)):
        raise ValueError("metric must be finite; it contains NaN or infinity.")
    diagonal = np.diag(metric)
    if np.any(diagonal < 0):
        raise ValueError(
            "metric must be positive semidefinite; its diagonal has a negative entry "
            f"({diagonal.min():.3g} at {int(diagonal.argmin())})."
        )
    # Compared in units of the diagonal: the entries of a Gram matrix carry the units
    # of two parameters and may be many orders of magnitude apart.
    size = np.sqrt(diagonal)
    inverse = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    unit_free = metric * inverse * inverse[:, None]
    rounding = n_features * np.finfo(float).eps * np.abs(metric).max(initial=0.0)
    asymmetry = np.abs(metric - metric.T)
    if np.any((asymmetry > rounding) & (np.abs(unit_free - unit_free.T) > 1e-8)):
        raise ValueError(
            "metric must be symmetric; the largest difference between an entry and its "
            f"mirror image is {asymmetry.max():.3g}. Pass (A + A.T) / 2 if rounding "
            "made it so."
        )
    metric = 0.5 * (metric + metric.T)
    correlation = 0.5 * (unit_free + unit_free.T)
    eigenvalue, basis = np.linalg.eigh(correlation)
    # A matrix computed in its own units (a clipped eigendecomposition) is semidefinite
    # to rounding in those, though perhaps not in units of a tiny diagonal.
    if eigenvalue[0] < -1e-10 * max(eigenvalue[-1], 1.0) or np.any(
        np.abs(metric[size == 0]) > 0
    ):
        raw = np.linalg.eigvalsh(metric)[0]
        if raw < -10 * rounding:
            raise ValueError(
                "metric must be positive semidefinite; its smallest eigenvalue is "
                f"{raw:.3g}. A Gram matrix from which a noise covariance was "
                "subtracted has to be clipped first."
            )
    visible = eigenvalue > n_features * np.finfo(float).eps * max(eigenvalue[-1], 0.0)
    eigenvalue[~visible] = 0.0
    return Metric(
        matrix=metric,
        root=np.sqrt(eigenvalue)[:, None] * basis.T * size,
        size=size,
        basis=basis[:, visible],
    )


SOLVERS = ("conic", "virtual")
# The virtual solver's steps are cheaper and more numerous than the conic solver's.
_VIRTUAL_STEPS = 10
# Share of the anchor's weight at which it counts as gone. Some pull has to remain: the
# least distance is often reached by no vector, only neared by masses without limit.
_HARDLY = 1e-6
# Excess of the squared distance up to which their answer is accepted, relative.
_VIRTUAL_LIMIT = 1e-4


@dataclass(frozen=True, kw_only=True)
class ProjectionResult:
    """Outcome of :func:`project`.

    Attributes
    ----------
    theta : ndarray of shape (n_features,)
        The consistent vector, in the units of the input.
    status : {"unchanged", "projected"}
        "unchanged": the input was consistent and is returned bit for bit.
    objective : float
        Squared distance to the input, ``(theta - input)' A (theta - input)``
        [unit of the metric times the units of the parameters squared].
    min_eigenvalues : ndarray of shape (n_bodies,)
        Smallest eigenvalue of each body's matrix, dimensionless (in units of
        `mass_scale` and `length_scale`); at least the margin.
    relative_gap : float
        Certified bound on how far the squared distance (with the anchor's pull, where
        the metric is singular) exceeds the least possible one, relative to it (or to
        the square of 1e-7 of the vector's length, where that is larger).  0 for an
        unchanged vector.
    anchor_cost : float
        Share of `objective` that is due to the anchor: what of it a pull a millionth as
        strong would save, at the price of bodies further from the anchor.  No
        consistent vector whose unseen part is as near to the anchor as that of `theta`
        has a smaller distance.  0 if the metric is not singular, since nothing is
        pulled then; nan if the solve with less pull fails.
    iterations : int
        Iterations of the solver, all passes together.
    solver : {"none", "clarabel", "trust-exact"}
        What found the vector.
    message : str
        The solver's own status.
    mass_scale : ndarray of shape (n_bodies,)
        Unit of mass of each body [kg].
    length_scale : ndarray of shape (n_bodies,)
        Unit of length of each body [m].
    """

    theta: np.ndarray
    status: str
    objective: float
    min_eigenvalues: np.ndarray
    relative_gap: float
    anchor_cost: float
    iterations: int
    solver: str
    message: str
    mass_scale: np.ndarray
    length_scale: np.ndarray


def check_options(constraint, margin, anchor_weight, solver, max_solver_iter):
    """Raise ValueError when an option that needs no data is wrong."""
    _check_constraint(constraint)
    if solver not in SOLVERS:
        raise ValueError(f"solver must be one of {SOLVERS}, got {solver!r}")
    if solver == "virtual" and constraint != "eq30":
        raise ValueError(
            'solver="virtual" works in the virtual parameters of eq. 30 and needs '
            f'constraint="eq30", got {constraint!r}. Use solver="conic".'
        )
    if not _is_real(margin) or not 0 < margin < 1:
        raise ValueError(
            "margin must be a number between 0 and 1, both excluded (a fraction of "
            f"each body's own scale), got {margin!r}"
        )
    if not _is_real(anchor_weight) or not 0 < anchor_weight <= 1:
        raise ValueError(
            "anchor_weight must be a number above 0 and at most 1, got "
            f"{anchor_weight!r}"
        )
    whole = isinstance(max_solver_iter, Integral)
    if not whole or isinstance(max_solver_iter, bool) or max_solver_iter < 1:
        raise ValueError(
            f"max_solver_iter must be an integer >= 1, got {max_solver_iter!r}"
        )


def _is_real(value):
    return isinstance(value, Real) and not isinstance(value, bool)


def check_vector(values, name, n_features=None):
    """Finite float array of shape (n_features,)."""
    values = np.asarray(values, dtype=float)
    if values.ndim != 1 or (n_features is not None and values.size != n_features):
        expected = "(n_features,)" if n_features is None else f"({n_features},)"
        raise ValueError(f"{name} must have shape {expected}, got {values.shape}.")
    if not np.all(np.isfinite(values)):
        raise ValueError(
            f"{name} must be finite; it contains NaN or infinity. A vector that was "
            "not identified cannot be projected."
        )
    return values


def resolve_scales(rows, layout, mass_scale, length_scale, anchor):
    """Units of every body: as given, of the anchor, or of the rows.

    Parameters
    ----------
    rows : ndarray of shape (n_samples, n_features)
        Parameter vectors.
    layout : ParameterLayout
        The columns' roles.
    mass_scale, length_scale : float, array-like of shape (n_bodies,) or None
        Units [kg] and [m]; None for those of the data.
    anchor : ndarray of shape (n_features,) or None
        Preferred source of the units, since it is usually a plausible robot.

    Returns
    -------
    mass_scale, length_scale : ndarray of shape (n_bodies,)
        Units [kg] and [m].
    """
    source = rows if anchor is None else anchor[None]
    found = body_scales(source[:, layout.body_columns])
    scales = []
    for name, given, default in (
        ("mass_scale", mass_scale, found[0]),
        ("length_scale", length_scale, found[1]),
    ):
        value = np.asarray(default if given is None else given, dtype=float)
        if value.ndim > 1 or (value.ndim == 1 and value.shape != default.shape):
            raise ValueError(
                f"{name} must be a number or one number per body "
                f"({default.size}), got an array of shape {value.shape}."
            )
        if not np.all(np.isfinite(value)) or not np.all(value > 0):
            raise ValueError(f"{name} must be positive and finite, got {given!r}")
        scales.append(np.broadcast_to(value, default.shape).copy())
    return scales[0], scales[1]


def default_metric(rows, layout, mass_scale, length_scale):
    """Metric that counts each parameter in its own unit.

    The ten of a body in units of its mass and length scale; a column outside the
    bodies in units of its root mean square over the rows (1 for a column of zeros).
    """
    units = np.sqrt(np.mean(rows**2, axis=0))
    units[units == 0] = 1.0
    units[layout.body_columns] = parameter_units(mass_scale, length_scale)
    return check_metric(np.diag(units**-2.0), units.size)


def project(
    theta,
    metric=None,
    *,
    constraint="pseudo-inertia",
    parameters_per_joint="auto",
    body_starts=None,
    nonnegative="auto",
    margin=1e-8,
    mass_scale=None,
    length_scale=None,
    anchor=None,
    anchor_weight=1e-8,
    solver="conic",
    max_solver_iter=200,
):
    r"""Find the physically consistent parameter vector nearest to a given one.

    Minimises :math:`(\theta - \theta_0)^\top A (\theta - \theta_0)`, eq. 35 of
    [TDS2011]_ with `A` the de-noised :math:`X_t^\top X_t`, over the vectors whose
    bodies satisfy the constraint and whose friction is not negative.  The options are
    those of :class:`PhysicalProjector`, which does the same for every row of a matrix.

    Parameters
    ----------
    theta : array-like of shape (n_features,)
        Parameter vector: for every joint ten inertial parameters [kg, kg m, kg m^2] in
        Pinocchio's order, then its friction and effect columns.
    metric : array-like of shape (n_features, n_features) or None, default=None
        Symmetric positive semidefinite `A`, of any scale.  None counts every parameter
        in its own unit.
    constraint : {"pseudo-inertia", "eq30"}, default="pseudo-inertia"
        See :class:`PhysicalProjector`, as for all that follow.
    parameters_per_joint : "auto" or int >= 10, default="auto"
        Columns of one joint.
    body_starts : array-like of int or None, default=None
        First columns of the bodies.
    nonnegative : "auto", array-like of int or of bool, default="auto"
        Columns that must not be negative.
    margin : float, default=1e-8
        Least eigenvalue of each body's matrix in its own units.
    mass_scale : float, array-like of shape (n_bodies,) or None, default=None
        Unit of mass of each body [kg]; None: :func:`body_scales` of the anchor, or of
        `theta`.
    length_scale : float, array-like of shape (n_bodies,) or None, default=None
        Unit of length of each body [m].
    anchor : array-like of shape (n_features,) or None, default=None
        Where directions that the metric does not see are pulled.
    anchor_weight : float, default=1e-8
        Strength of that pull; see `anchor_cost` of the result.
    solver : {"conic", "virtual"}, default="conic"
        How the minimum is found.
    max_solver_iter : int, default=200
        Iterations of one solve.

    Returns
    -------
    result : ProjectionResult
        The vector and how it was found.

    Raises
    ------
    ProjectionError
        If no vector is certified to be the nearest one.  The input is never handed
        back in its place.
    ValueError
        If an argument has the wrong shape or value.

    References
    ----------
    .. [TDS2011] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system
       identification with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Examples
    --------
    Izz = 3 exceeds Ixx + Iyy = 2, which no body can have; with weight 4 on Izz the
    nearest body has Ixx = Iyy = 13/9 and Izz = 26/9.

    >>> import numpy as np
    >>> from sklearn_vbjfa.physical import project
    >>> result = project([2, 0, 0, 0, 1, 0, 1, 0, 0, 3], np.diag([1.0] * 9 + [4.0]))
    >>> (result.theta[[4, 6, 9]] * 9).round(5)
    array([13., 13., 26.])
    """
    check_options(constraint, margin, anchor_weight, solver, max_solver_iter)
    theta = check_vector(theta, "theta")
    layout = resolve_layout(
        theta.size,
        parameters_per_joint=parameters_per_joint,
        body_starts=body_starts,
        nonnegative=nonnegative,
    )
    if anchor is not None:
        anchor = check_vector(anchor, "anchor", theta.size)
    rows = theta[None]
    if metric is not None:
        metric = check_metric(metric, theta.size)
        theta = metric.without_rounding(theta)
        rows = theta[None]
    mass_scale, length_scale = resolve_scales(
        rows, layout, mass_scale, length_scale, anchor
    )
    if metric is None:
        metric = default_metric(rows, layout, mass_scale, length_scale)
    return project_vector(
        theta,
        metric=metric,
        layout=layout,
        constraint=constraint,
        margin=margin,
        mass_scale=mass_scale,
        length_scale=length_scale,
        anchor=anchor,
        anchor_weight=anchor_weight,
        solver=solver,
        max_solver_iter=max_solver_iter,
    )


@one_blas_thread()
def project_vector(
    theta,
    *,
    metric,
    layout,
    constraint,
    margin,
    mass_scale,
    length_scale,
    anchor,
    anchor_weight,
    solver,
    max_solver_iter,
    price_anchor=True,
):
    """Project one validated vector; see :func:`project`.

    Parameters are those of :func:`project` after validation, with `metric` a Metric
    and `layout` a ParameterLayout. What the anchor costs takes one more solve where the
    metric is singular, and is nan without `price_anchor`.
    """
    root = metric.root
    bodies, kept = layout.body_columns, layout.nonnegative
    body_units = parameter_units(mass_scale, length_scale)

    def eigenvalues(vector):
        return min_eigenvalue(
            vector[bodies],
            constraint,
            mass_scale=mass_scale,
            length_scale=length_scale,
        )

    def outcome(vector, **details):
        displacement = root @ (vector - theta)
        return ProjectionResult(
            theta=vector,
            objective=float(displacement @ displacement),
            min_eigenvalues=eigenvalues(vector),
            mass_scale=mass_scale,
            length_scale=length_scale,
            **details,
        )

    if np.all(eigenvalues(theta) >= margin) and np.all(theta[kept] >= 0):
        return outcome(
            theta.copy(),
            status="unchanged",
            relative_gap=0.0,
            anchor_cost=0.0,
            iterations=0,
            solver="none",
            message="already consistent",
        )

    diagonal = metric.size**2
    units = np.ones(theta.size)
    units[bodies] = body_units
    weight = diagonal * units**2
    outside = np.ones(theta.size, dtype=bool)
    outside[bodies] = False
    # Columns outside the bodies have no unit of their own: take the one in which their
    # metric equals the largest of the bodies.
    largest = weight[~outside].max(initial=0.0)
    seen = outside & (diagonal > 0)
    units[seen] = np.sqrt((largest if largest > 0 else 1.0) / diagonal[seen])
    column_norm = np.linalg.norm(root * units, axis=0).max(initial=0.0)
    # One common factor brings bodies far from their scales back near one.
    common = np.abs((theta / units)[bodies]).max(initial=0.0)
    common = common if common > 0 else 1.0
    units = units * common
    scale = column_norm * common
    scaled_root = root * units / scale if scale > 0 else root

    def pulled(weight):
        return make_problem(
            theta / units,
            constraint=constraint,
            body_columns=bodies,
            nonnegative=kept,
            margin=margin / common,
            metric_root=scaled_root,
            anchor=(theta if anchor is None else anchor) / units,
            anchor_weight=weight,
        )

    problem = pulled(anchor_weight)
    if solver == "conic":
        vector, gap, iterations, message = solve_conic(
            problem, max_solver_iter=max_solver_iter
        )
        name = "clarabel"
    else:
        vector, gap, iterations, message = _solve_virtual(problem, max_solver_iter)
        name = "trust-exact"
    cost = 0.0 if problem.n_hidden == 0 else np.nan
    if problem.n_hidden and price_anchor:
        freer = pulled(_HARDLY * anchor_weight)
        cost = _anchor_cost(problem, vector, freer, scaled_root, max_solver_iter)
    vector = _settle(vector * units, problem, units, eigenvalues, margin)
    return outcome(
        vector,
        status="projected",
        relative_gap=gap,
        anchor_cost=cost,
        iterations=iterations,
        solver=name,
        message=message,
    )


def _anchor_cost(problem, vector, freer, root, max_solver_iter):
    """Share of a solution's squared distance that a programme with less pull saves."""
    try:
        other, *_ = solve_conic(freer, max_solver_iter=max_solver_iter)
    except ProjectionError:
        return np.nan
    squared, least = (
        float(np.sum((root @ (x - problem.point)) ** 2)) for x in (vector, other)
    )
    return max(1.0 - least / squared, 0.0) if squared > 0 else 0.0


def _solve_virtual(problem, max_solver_iter):
    """Start the virtual solver from two consistent vectors and check its end."""
    # Away from the boundary: a factor that is exactly zero has a zero derivative and
    # would stay zero.
    floor = problem.margin + 1e-4
    stricter, _, used, _ = solve_conic(
        replace(problem, constraint="pseudo-inertia"), max_solver_iter=max_solver_iter
    )
    starts = [
        lift(problem, stricter, floor)[0],
        clip(problem, problem.point, floor),
    ]
    vector, steps, message = solve_virtual(
        problem, starts, max_solver_iter=_VIRTUAL_STEPS * max_solver_iter
    )
    # A stationary point of a problem that is not convex proves nothing.  The convex
    # programme has the same minimum, and its certificate bounds it from below.
    nearest, gap, checked, _ = solve_conic(problem, max_solver_iter=max_solver_iter)
    least = problem.distance(nearest) ** 2 * (1.0 - gap)
    excess = problem.distance(vector) ** 2 / max(least, np.finfo(float).tiny) - 1.0
    if not excess <= _VIRTUAL_LIMIT:
        raise ProjectionError(
            "The projection in the virtual parameters of eq. 30 failed: after "
            f"{steps} steps the optimiser reports {message!r}, {excess:.1e} above the "
            "least squared distance (relative). Raise max_solver_iter, or use "
            'solver="conic".'
        )
    return vector, max(excess, 0.0), used + steps + checked, message


def _settle(vector, problem, units, eigenvalues, margin):
    """Make a vector consistent to the last bit in the user's own units.

    Division by the units rounds, so an eigenvalue may come out a few rounding errors
    below the margin; the least lift that restores it is added.
    """
    bodies, kept = problem.body_columns, problem.nonnegative
    vector[kept] = np.maximum(vector[kept], 0.0)
    excess = np.finfo(float).eps
    for _ in range(60):
        lacking = eigenvalues(vector) < margin
        if not lacking.any():
            return vector
        scaled = vector / units
        lifted, _ = lift(problem, scaled, problem.margin + excess)
        changed = bodies[lacking]
        vector[changed] = lifted[changed] * units[changed]
        excess *= 2
    raise ProjectionError(
        "The projection failed: rounding keeps a body's smallest eigenvalue below the "
        f"margin of {margin:.1e}. Raise margin."
    )
