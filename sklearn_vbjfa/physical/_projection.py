"""Projection of parameter vectors on the physically consistent ones, in a metric."""

import warnings
from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np
from sklearn.exceptions import ConvergenceWarning

from sklearn_vbjfa.physical._layout import ParameterLayout, resolve_layout
from sklearn_vbjfa.physical._programme import Programme
from sklearn_vbjfa.physical._pseudo_inertia import (
    _check_constraint,
    body_scales,
    min_eigenvalue,
    parameter_units,
)
from sklearn_vbjfa.physical._solver import (
    GAP_TARGET,
    ProjectionError,
    one_blas_thread,
    solve,
)

# How many times longer than the visible part of a vector its hidden part may be before
# it is taken for rounding; a plausible robot's are of one order.
_HIDDEN_LIMIT = 100.0


@dataclass(frozen=True, kw_only=True)
class Metric:
    """Validated metric with its square root."""

    matrix: np.ndarray  # (n_features, n_features): symmetric positive semidefinite `A`
    root: np.ndarray  # (n_features, n_features): `R` with ``R' R = A``
    size: np.ndarray  # (n_features,): square root of the diagonal
    # (n_features, n_visible): orthonormal basis of what `A` sees, in units of `size`
    basis: np.ndarray

    def visible_part(self, theta):
        """Drop what the metric does not see where it dwarfs what it sees."""
        # A least-squares solve that does not cut its singular values returns 1e10 and
        # more along directions without information; neither scales nor anchors may come
        # from those. Also returns the lengths of the hidden and the visible part in
        # units of the metric.
        standardised = theta * self.size
        part = self.basis @ (self.basis.T @ standardised)
        hidden, visible = np.linalg.norm(standardised - part), np.linalg.norm(part)
        if hidden > _HIDDEN_LIMIT * visible:
            theta = np.divide(
                part, self.size, out=np.zeros_like(theta), where=self.size > 0
            )
        return theta, hidden, visible

    def without_rounding(self, theta):
        """Return the `visible_part`; warn where that is not all."""
        part, hidden, visible = self.visible_part(theta)
        if part is not theta:
            warnings.warn(
                f"The part of theta that the metric does not see is {hidden:.1e} long "
                f"in units of the metric, the part it sees {visible:.1e}: taken for "
                "the rounding of a singular regression and replaced by the shortest "
                "vector that predicts the same. Fit with a regressor that cuts small "
                "singular values.",
                UserWarning,
                stacklevel=5,
            )
        return part


@one_blas_thread()
def check_metric(metric, n_features):
    """Validate a metric (n_features, n_features) and take its square root."""
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


# Share of the anchor's weight at which it counts as gone. Some pull has to remain: the
# least distance is often reached by no vector, only neared by masses without limit.
_HARDLY = 1e-6
# Non-negative values below this share of the largest, in the units of the programme,
# are zeros: an interior path ends a little inside. Measured robots have 1e-14 and less,
# and their least friction 1e-3.
_ROUNDING = 1e-12


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
        pulled then; nan if the solve with less pull fails, as `message` then
        says.
    iterations : int
        Iterations of the solver, all passes together.
    solver : {"none", "clarabel"}
        What found the vector.
    message : str
        The solver's own status, how its refinement ended if the gap is larger than 1e-9
        (which is warned of), and why `anchor_cost` is not known.
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


@dataclass(frozen=True, kw_only=True)
class Options:
    """What :func:`project` and :class:`PhysicalProjector` are told, in their words."""

    constraint: str
    metric: object
    parameters_per_joint: object
    body_starts: object
    nonnegative: object
    margin: float
    mass_scale: object
    length_scale: object
    anchor: object
    anchor_weight: float
    max_solver_iter: int
    parameter_names: object

    def __post_init__(self):
        """Raise ValueError when an option that needs no data is wrong."""
        _check_constraint(self.constraint)
        if not _is_real(self.margin) or not 0 < self.margin < 1:
            raise ValueError(
                "margin must be a number between 0 and 1, both excluded (a fraction of "
                f"each body's own scale), got {self.margin!r}"
            )
        if not _is_real(self.anchor_weight) or not 0 < self.anchor_weight <= 1:
            raise ValueError(
                "anchor_weight must be a number above 0 and at most 1, got "
                f"{self.anchor_weight!r}"
            )
        steps = self.max_solver_iter
        if not isinstance(steps, Integral) or isinstance(steps, bool) or steps < 1:
            raise ValueError(f"max_solver_iter must be an integer >= 1, got {steps!r}")


def _is_real(value):
    return isinstance(value, Real) and not isinstance(value, bool)


def _check_vector(values, name, n_features=None):
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


def _resolve_scales(found, mass_scale, length_scale):
    """Units (mass, length) of every body, as given or as found in the data."""
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
    return scales


def _default_metric(rows, layout, mass_scale, length_scale):
    """Metric that counts each parameter in its own unit."""
    # The ten of a body in units of its mass and length scale; a column outside the
    # bodies in units of its root mean square over the rows (1 for a column of zeros).
    units = np.sqrt(np.mean(rows**2, axis=0))
    units[units == 0] = 1.0
    units[layout.body_columns] = parameter_units(mass_scale, length_scale)
    return check_metric(np.diag(units**-2.0), units.size)


@dataclass(frozen=True, kw_only=True)
class Projection:
    """Where vectors are projected and in which distance; validated, in SI units."""

    given: Options  # its metric, scales and anchor as they were given
    layout: ParameterLayout
    metric: Metric
    # (n_bodies,): units of each body's matrix [kg] and [m]
    mass_scale: np.ndarray
    length_scale: np.ndarray
    # (n_features,): where unseen directions are pulled; None for the vector
    anchor: np.ndarray | None

    @classmethod
    def of(cls, rows, given):
        """Validate `Options` for rows (n_samples, n_features)."""
        n_features = rows.shape[1]
        layout = resolve_layout(
            n_features,
            parameters_per_joint=given.parameters_per_joint,
            body_starts=given.body_starts,
            nonnegative=given.nonnegative,
            parameter_names=given.parameter_names,
        )
        anchor, metric = given.anchor, given.metric
        if anchor is not None:
            anchor = _check_vector(anchor, "anchor", n_features)
        if metric is not None:
            metric = check_metric(metric, n_features)
            rows = np.array([metric.visible_part(row)[0] for row in rows])
        # The anchor is usually a plausible robot.
        source = rows if anchor is None else anchor[None]
        mass_scale, length_scale = _resolve_scales(
            body_scales(source[:, layout.body_columns]),
            given.mass_scale,
            given.length_scale,
        )
        if metric is None:
            metric = _default_metric(rows, layout, mass_scale, length_scale)
        return cls(
            given=given,
            layout=layout,
            metric=metric,
            mass_scale=mass_scale,
            length_scale=length_scale,
            anchor=anchor,
        )

    @one_blas_thread()
    def __call__(self, theta, *, price_anchor=True):
        """Project one vector; return a :class:`ProjectionResult`."""
        # What the anchor costs takes one more solve where the metric is singular, and
        # is nan without `price_anchor`.
        theta = self.metric.without_rounding(theta)
        bodies, kept = self.layout.body_columns, self.layout.nonnegative
        enough = self._eigenvalues(theta) >= self.given.margin
        if np.all(enough) and np.all(theta[kept] >= 0):
            return self._outcome(
                theta,
                theta.copy(),
                status="unchanged",
                relative_gap=0.0,
                anchor_cost=0.0,
                iterations=0,
                solver="none",
                message="already consistent",
            )
        units, scaled_root = self._scale(theta)
        # One common factor brings bodies far from their scales back near one.
        common = np.abs((theta / units)[bodies]).max(initial=0.0)
        common = common if common > 0 else 1.0
        units = units * common

        def programme(weight):
            return Programme.pulled(
                theta / units,
                constraint=self.given.constraint,
                body_columns=bodies,
                nonnegative=kept,
                margin=self.given.margin / common,
                metric_root=scaled_root,
                anchor=(theta if self.anchor is None else self.anchor) / units,
                anchor_weight=weight,
            )

        nearest = programme(self.given.anchor_weight)
        solution = solve(nearest, max_steps=self.given.max_solver_iter)
        if solution.gap > GAP_TARGET:
            _tell_gap(solution)
        cost, told = (0.0 if nearest.n_hidden == 0 else np.nan), solution.status
        if nearest.n_hidden and price_anchor:
            freer = programme(_HARDLY * self.given.anchor_weight)
            cost, failed = _anchor_cost(
                solution.vector, freer, scaled_root, self.given.max_solver_iter
            )
            told += failed
        return self._outcome(
            theta,
            self._settle(solution.vector * units, units, nearest),
            status="projected",
            relative_gap=solution.gap,
            anchor_cost=cost,
            iterations=solution.n_iter,
            solver="clarabel",
            message=told,
        )

    def _eigenvalues(self, vector):
        """Smallest eigenvalue of each body's matrix, shape (n_bodies,)."""
        return min_eigenvalue(
            vector[self.layout.body_columns],
            self.given.constraint,
            mass_scale=self.mass_scale,
            length_scale=self.length_scale,
        )

    def _outcome(self, theta, vector, **details):
        displacement = self.metric.root @ (vector - theta)
        return ProjectionResult(
            theta=vector,
            objective=float(displacement @ displacement),
            min_eigenvalues=self._eigenvalues(vector),
            mass_scale=self.mass_scale,
            length_scale=self.length_scale,
            **details,
        )

    def _scale(self, theta):
        """Units of the columns, and the metric's root in them, columns up to one."""
        bodies, diagonal = self.layout.body_columns, self.metric.size**2
        units = np.ones(theta.size)
        units[bodies] = parameter_units(self.mass_scale, self.length_scale)
        outside = np.ones(theta.size, dtype=bool)
        outside[bodies] = False
        # Columns outside the bodies have no unit of their own: take the one in which
        # their metric equals the largest of the bodies.
        largest = (diagonal * units**2)[~outside].max(initial=0.0)
        seen = outside & (diagonal > 0)
        units[seen] = np.sqrt((largest if largest > 0 else 1.0) / diagonal[seen])
        root = self.metric.root * units
        size = np.linalg.norm(root, axis=0).max(initial=0.0)
        return units, root / size if size > 0 else root

    def _settle(self, vector, units, programme):
        """Make a vector consistent to the last bit in the user's own units."""
        # Division by the units rounds, so an eigenvalue may come out a few rounding
        # errors below the margin; the least lift that restores it is added.
        bodies, kept = self.layout.body_columns, self.layout.nonnegative
        least = _ROUNDING * np.abs(vector / units).max(initial=0.0) * units[kept]
        vector[kept] = np.where(vector[kept] > least, vector[kept], 0.0)
        excess = np.finfo(float).eps
        for _ in range(60):
            lacking = self._eigenvalues(vector) < self.given.margin
            if not lacking.any():
                return vector
            lifted = programme.lift(vector / units, programme.margin + excess)
            changed = bodies[lacking]
            vector[changed] = lifted[changed] * units[changed]
            excess *= 2
        raise ProjectionError(
            "The projection failed: rounding keeps a body's smallest eigenvalue below "
            f"the margin of {self.given.margin:.1e}. Raise margin."
        )


def _anchor_cost(vector, freer, root, max_steps):
    """Share of a solution's squared distance that a programme with less pull saves."""
    # With what is to be said of it: nothing, or why it is nan.
    try:
        other = solve(freer, max_steps=max_steps).vector
    except ProjectionError as error:
        return np.nan, f"; anchor_cost is not known, the solve with less pull: {error}"
    squared, least = (
        float(np.sum((root @ (x - freer.point)) ** 2)) for x in (vector, other)
    )
    return (max(1.0 - least / squared, 0.0) if squared > 0 else 0.0), ""


def _tell_gap(solution):
    """Warn of an answer that is accepted, but not certified as well as was aimed at."""
    warnings.warn(
        f"The projection is certified to a relative gap of {solution.gap:.1e}, and not "
        f"to {GAP_TARGET:.0e}: its squared distance may exceed the least one by that "
        f"share. The solver: {solution.status}. Raise max_solver_iter, or check the "
        "vector and the metric for columns many orders of magnitude apart.",
        ConvergenceWarning,
        stacklevel=5,
    )


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
    max_solver_iter=200,
    parameter_names=None,
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
    max_solver_iter : int, default=200
        Iterations of one solve.
    parameter_names : array-like of str of shape (n_features,) or None, default=None
        Names of the columns, which tell bodies and friction apart.

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
    theta = _check_vector(theta, "theta")
    given = Options(
        constraint=constraint,
        metric=metric,
        parameters_per_joint=parameters_per_joint,
        body_starts=body_starts,
        nonnegative=nonnegative,
        margin=margin,
        mass_scale=mass_scale,
        length_scale=length_scale,
        anchor=anchor,
        anchor_weight=anchor_weight,
        max_solver_iter=max_solver_iter,
        parameter_names=parameter_names,
    )
    return Projection.of(theta[None], given)(theta)
