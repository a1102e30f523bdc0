"""Projection of one parameter vector on the physically consistent ones."""

import warnings
from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np

from sklearn_vbjfa.physical._conic import (
    ProjectionError,
    clip,
    lift,
    make_problem,
    solve_conic,
)
from sklearn_vbjfa.physical._pseudo_inertia import (
    N_INERTIAL,
    _check_constraint,
    body_scales,
    min_eigenvalue,
    parameter_units,
)
from sklearn_vbjfa.physical._virtual import solve_virtual

SOLVERS = ("conic", "virtual")
# The paper's layout, and this package's default friction: ten inertial parameters and
# the viscous friction of the joint.
_PAPER_WIDTH = 11


@dataclass(frozen=True, kw_only=True)
class ParameterLayout:
    """Where the bodies and the non-negative columns of a parameter vector are.

    Attributes
    ----------
    n_features : int
        Length of the vector.
    body_starts : ndarray of int of shape (n_bodies,)
        First column of each body's ten.
    nonnegative : ndarray of int of shape (n_nonnegative,)
        Columns that must not be negative, in increasing order.
    """

    n_features: int
    body_starts: np.ndarray
    nonnegative: np.ndarray

    @property
    def body_columns(self):
        """Columns of every body, ndarray of int of shape (n_bodies, 10)."""
        return self.body_starts[:, None] + np.arange(N_INERTIAL)


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
        Certified bound on how far the squared distance (with the regulariser's share)
        exceeds the least possible one, relative to it.  0 for an unchanged vector, nan
        for the virtual solver, which has no such certificate.
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
    iterations: int
    solver: str
    message: str
    mass_scale: np.ndarray
    length_scale: np.ndarray


def resolve_layout(
    n_features, *, parameters_per_joint="auto", body_starts=None, nonnegative="auto"
):
    """Find the bodies and the non-negative columns of a parameter vector.

    Parameters
    ----------
    n_features : int
        Length of the vector.
    parameters_per_joint : "auto" or int >= 10, default="auto"
        See :class:`PhysicalProjector`.
    body_starts : array-like of int or None, default=None
        See :class:`PhysicalProjector`.
    nonnegative : "auto", array-like of int or of bool, default="auto"
        See :class:`PhysicalProjector`.

    Returns
    -------
    layout : ParameterLayout
        The columns' roles.

    Raises
    ------
    ValueError
        If the columns are not a whole number of joints, bodies overlap or leave the
        vector, a non-negative column belongs to a body, or "auto" cannot know.

    Warns
    -----
    UserWarning
        If the vector is too short for a body, or "auto" had to choose between two
        readings.

    Examples
    --------
    >>> from sklearn_vbjfa.physical import resolve_layout
    >>> layout = resolve_layout(24, parameters_per_joint=12, nonnegative=[10, 11, 22])
    >>> layout.body_starts, layout.nonnegative
    (array([ 0, 12]), array([10, 11, 22]))
    """
    if body_starts is not None:
        starts = _check_body_starts(body_starts, n_features)
        width = None
    else:
        width = _check_width(parameters_per_joint, n_features)
        starts = np.arange(0, n_features - width + 1, width)
    in_body = np.zeros(n_features, dtype=bool)
    in_body[starts[:, None] + np.arange(N_INERTIAL)] = True

    if isinstance(nonnegative, str) and nonnegative == "auto":
        if width == _PAPER_WIDTH or not starts.size or in_body.all():
            kept = np.flatnonzero(~in_body) if starts.size else np.array([], dtype=int)
        else:
            raise ValueError(
                'nonnegative="auto" knows the layouts of 10 and 11 columns per joint '
                f"(the eleventh is viscous friction); here {int((~in_body).sum())} "
                "columns belong to no body and some effects, an offset say, may be "
                "negative. List the columns that must not be negative, or pass () for "
                "none."
            )
    else:
        kept = _check_nonnegative(nonnegative, n_features)
        if in_body[kept].any():
            raise ValueError(
                f"nonnegative names column {int(kept[in_body[kept]][0])}, which is an "
                "inertial parameter; the constraint set already bounds those. List "
                "friction and effect columns alone."
            )
    return ParameterLayout(n_features=n_features, body_starts=starts, nonnegative=kept)


def _check_width(width, n_features):
    """Columns per joint; explicit, or 10 or 11 when the length tells."""
    if isinstance(width, str):
        if width != "auto":
            raise ValueError(
                'parameters_per_joint must be "auto" or an integer >= 10, got '
                f"{width!r}"
            )
        if n_features < N_INERTIAL:
            warnings.warn(
                f"{n_features} columns are too few for a body (10 inertial "
                "parameters): there is nothing to constrain and the values pass "
                "through unchanged.",
                UserWarning,
                stacklevel=4,
            )
            return n_features + 1
        plain, paper = n_features % N_INERTIAL == 0, n_features % _PAPER_WIDTH == 0
        if plain and paper:
            warnings.warn(
                f"{n_features} columns are a whole number of joints both at 10 and at "
                "11 parameters per joint; taken as 11 (viscous friction last). Set "
                "parameters_per_joint.",
                UserWarning,
                stacklevel=4,
            )
        if not plain and not paper:
            raise ValueError(
                f"{n_features} columns are not a whole number of joints with 10 or 11 "
                "parameters each. Set parameters_per_joint, or body_starts where joints "
                "differ."
            )
        return _PAPER_WIDTH if paper else N_INERTIAL
    if isinstance(width, bool) or not isinstance(width, Integral) or width < N_INERTIAL:
        raise ValueError(
            f'parameters_per_joint must be "auto" or an integer >= 10, got {width!r}'
        )
    if n_features % width:
        raise ValueError(
            f"{n_features} columns are not a whole number of joints with "
            f"{width} parameters each (parameters_per_joint). Set it to the columns of "
            "one joint, or set body_starts where joints differ."
        )
    return int(width)


def _check_indices(values, name, n_features):
    """Array of distinct column numbers, sorted."""
    values = np.asarray(values)
    if values.size == 0:
        return np.array([], dtype=int)
    if values.ndim != 1 or not np.issubdtype(values.dtype, np.integer):
        raise ValueError(
            f"{name} must be a list of column numbers, got an array of shape "
            f"{values.shape} and type {values.dtype}."
        )
    if values.min() < 0 or values.max() >= n_features:
        raise ValueError(
            f"{name} must hold column numbers from 0 to {n_features - 1}, got "
            f"{values.min()} to {values.max()}."
        )
    return np.unique(values)


def _check_body_starts(body_starts, n_features):
    """Column numbers of bodies that fit and do not overlap."""
    given = np.asarray(body_starts)
    starts = _check_indices(body_starts, "body_starts", n_features)
    if starts.size != given.size:
        raise ValueError("body_starts names a column twice; every body has its own.")
    if np.any(np.diff(starts) < N_INERTIAL):
        raise ValueError(
            "body_starts must be at least 10 columns apart, got "
            f"{starts.tolist()}: two bodies overlap."
        )
    if starts.size and starts[-1] + N_INERTIAL > n_features:
        raise ValueError(
            f"The body that starts at column {starts[-1]} (body_starts) needs 10 "
            f"columns; the vector has {n_features}."
        )
    return starts


def _check_nonnegative(nonnegative, n_features):
    """Column numbers from numbers or a mask."""
    values = np.asarray(nonnegative)
    if values.dtype == bool:
        if values.shape != (n_features,):
            raise ValueError(
                f"nonnegative as a mask must have shape ({n_features},), got "
                f"{values.shape}."
            )
        return np.flatnonzero(values)
    return _check_indices(nonnegative, "nonnegative", n_features)


def check_metric(metric, n_features):
    """Validate a metric and return it with a square root.

    Parameters
    ----------
    metric : array-like of shape (n_features, n_features)
        Symmetric positive semidefinite matrix.
    n_features : int
        Length of the parameter vectors.

    Returns
    -------
    metric : ndarray of shape (n_features, n_features)
        The symmetric part.
    root : ndarray of shape (n_features, n_features)
        `R` with ``R' R = metric``.

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
    eigenvalue[eigenvalue < n_features * np.finfo(float).eps * eigenvalue[-1]] = 0.0
    return metric, np.sqrt(eigenvalue)[:, None] * basis.T * size


def check_options(constraint, margin, anchor_weight, solver, max_iter):
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
            f"anchor_weight must be a number above 0 and at most 1, got {anchor_weight!r}"
        )
    if isinstance(max_iter, bool) or not isinstance(max_iter, Integral) or max_iter < 1:
        raise ValueError(f"max_iter must be an integer >= 1, got {max_iter!r}")


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
            f"{name} must be finite; it contains NaN or infinity. A vector that was not "
            "identified cannot be projected."
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
    return np.diag(units**-2.0)


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
    anchor_weight=1e-10,
    solver="conic",
    max_iter=200,
):
    r"""Find the physically consistent parameter vector nearest to a given one.

    Minimises :math:`(\theta - \theta_0)^\top A (\theta - \theta_0)`, eq. 35 of
    [TDS2011]_ with `A` the de-noised :math:`X_t^\top X_t`, over the vectors whose bodies
    satisfy the constraint and whose friction is not negative.  The options are those of
    :class:`PhysicalProjector`, which does the same for every row of a matrix.

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
    anchor_weight : float, default=1e-10
        Strength of that pull.
    solver : {"conic", "virtual"}, default="conic"
        How the minimum is found.
    max_iter : int, default=200
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
    check_options(constraint, margin, anchor_weight, solver, max_iter)
    theta = check_vector(theta, "theta")
    layout = resolve_layout(
        theta.size,
        parameters_per_joint=parameters_per_joint,
        body_starts=body_starts,
        nonnegative=nonnegative,
    )
    if anchor is not None:
        anchor = check_vector(anchor, "anchor", theta.size)
    mass_scale, length_scale = resolve_scales(
        theta[None], layout, mass_scale, length_scale, anchor
    )
    if metric is None:
        metric = default_metric(theta[None], layout, mass_scale, length_scale)
    metric, root = check_metric(metric, theta.size)
    return project_vector(
        theta,
        metric=metric,
        root=root,
        layout=layout,
        constraint=constraint,
        margin=margin,
        mass_scale=mass_scale,
        length_scale=length_scale,
        anchor=anchor,
        anchor_weight=anchor_weight,
        solver=solver,
        max_iter=max_iter,
    )


def project_vector(
    theta,
    *,
    metric,
    root,
    layout,
    constraint,
    margin,
    mass_scale,
    length_scale,
    anchor,
    anchor_weight,
    solver,
    max_iter,
):
    """Project one validated vector; see :func:`project`.

    Parameters are those of :func:`project` after validation, with `root` the square
    root of `metric` and `layout` a ParameterLayout.
    """
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
            iterations=0,
            solver="none",
            message="already consistent",
        )

    diagonal = np.diag(metric)
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
    # One common factor brings a vector far from the scales back near one.
    common = np.abs(theta / units).max(initial=0.0)
    common = common if common > 0 else 1.0
    units = units * common
    scale = column_norm * common
    problem = make_problem(
        theta / units,
        constraint=constraint,
        body_columns=bodies,
        nonnegative=kept,
        margin=margin / common,
        metric_root=root * units / scale if scale > 0 else root,
        anchor=(theta if anchor is None else anchor) / units,
        anchor_weight=anchor_weight,
    )
    if solver == "conic":
        vector, gap, iterations, message = solve_conic(problem, max_iter=max_iter)
        name = "clarabel"
    else:
        vector, gap, iterations, message = _solve_virtual(problem, max_iter)
        name = "trust-exact"
    vector = _settle(vector * units, problem, units, eigenvalues, margin)
    return outcome(
        vector,
        status="projected",
        relative_gap=gap,
        iterations=iterations,
        solver=name,
        message=message,
    )


def _solve_virtual(problem, max_iter):
    """Start the virtual solver from two consistent vectors and check its end."""
    floor = problem.margin + 1e-4
    clipped = clip(problem, problem.point, floor)
    full = ConicProblemWithTriangle = None  # placeholder
    return clipped, full, ConicProblemWithTriangle, floor, max_iter


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
