"""Projection of parameter vectors onto the physically consistent set in a metric."""

import warnings
from dataclasses import dataclass

import numpy as np
from sklearn.base import BaseEstimator, OneToOneFeatureMixin, TransformerMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import (
    assert_all_finite,
    check_array,
    check_consistent_length,
    check_scalar,
    column_or_1d,
)
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_vbjfa._core._runtime import one_blas_thread
from sklearn_vbjfa.effects import declarable, declared
from sklearn_vbjfa.physical._programme import Programme
from sklearn_vbjfa.physical._pseudo_inertia import (
    INERTIAL_NAMES,
    N_INERTIAL,
    body_scales,
    check_constraint,
    min_eigenvalue,
    parameter_units,
)
from sklearn_vbjfa.physical._solver import GAP_TARGET, ProjectionError, solve

# -- layout: columns of bodies and non-negative columns --------------------------------

# The paper's layout, and this package's default friction: ten inertial parameters and
# the viscous friction of the joint.
_PAPER_WIDTH = 11


def resolve_layout(n_features, options, names=None):
    """Find the columns of the bodies (n_bodies, 10) and the non-negative columns."""
    if options.body_starts is not None:
        starts, nonnegative = options.body_starts, options.nonnegative
    else:
        layout = _named_layout(n_features, names) or _guessed_layout(n_features)
        starts, nonnegative = layout
    columns = np.array(starts, dtype=int)[:, None] + np.arange(N_INERTIAL)
    return columns, np.array(nonnegative, dtype=int)


def _named_layout(n_features, names):
    """First columns of the bodies and those of friction; None without any names."""
    if names is None:
        return None
    names = [str(name) for name in names]
    if len(names) != n_features:
        raise ValueError(
            f"parameter_names must hold {n_features} names, one for each column; got "
            f"{len(names)}."
        )
    starts = _named_bodies(names)
    return starts and (starts, [k for k, x in enumerate(names) if _is_nonnegative(x)])


def _named_bodies(names):
    """First columns of the bodies by names such as "joint_1:m", a list."""
    split = [name.rpartition(":") for name in names]
    inertial = [bool(colon) and name in INERTIAL_NAMES for _, colon, name in split]
    starts, at = [], 0
    while at < len(names):
        if not inertial[at]:
            at += 1
            continue
        joint = split[at][0]
        body = [f"{joint}:{name}" for name in INERTIAL_NAMES]
        if names[at : at + N_INERTIAL] != body:
            raise ValueError(
                f"The columns named {joint!r} are not the body of one joint from "
                f"column {at} on: expected {body[0]}, {body[1]} to {body[-1]} in the "
                f"order of RigidBodyFeatures; got {', '.join(names[at : at + 10])}."
            )
        starts.append(at)
        at += N_INERTIAL
    return starts


def _is_nonnegative(name):
    """Whether a column such as "joint_1:viscous" is of friction that resists motion."""
    effect = name.rpartition(":")[2]
    return effect in declarable() and bool(declared(effect).nonnegative)


def _guessed_layout(n_features):
    """First columns of the bodies of 10 or 11 columns, and the other columns."""
    if n_features < N_INERTIAL:
        warnings.warn(
            f"{n_features} columns are too few for a body (10 inertial "
            "parameters): there is nothing to constrain and the values pass "
            "through unchanged.",
            stacklevel=5,
        )
        return [], []
    plain, paper = n_features % N_INERTIAL == 0, n_features % _PAPER_WIDTH == 0
    if plain and paper:
        warnings.warn(
            f"{n_features} columns are a whole number of joints both at 10 and at "
            "11 parameters per joint; taken as 11 (viscous friction last). "
            "Pass parameter_names.",
            stacklevel=5,
        )
    if not plain and not paper:
        raise ValueError(
            f"{n_features} columns are not a whole number of joints with 10 or 11 "
            "parameters each: name the columns (pass parameter_names, or data frames "
            'of RigidBodyFeatures, set_output(transform="pandas")).'
        )
    width = _PAPER_WIDTH if paper else N_INERTIAL
    starts = range(0, n_features, width)
    return starts, [first + N_INERTIAL for first in starts] if paper else []


# -- projection in a metric ------------------------------------------------------------

# Largest ratio of the part of a vector in the metric's null space to the other part
# before it counts as rounding; for a plausible robot both are of the same order.
_HIDDEN_LIMIT = 100.0


@dataclass(frozen=True, kw_only=True)
class Metric:
    """Validated metric with its square root."""

    matrix: np.ndarray  # (n_features, n_features): symmetric positive semidefinite `A`
    root: np.ndarray  # (n_features, n_features): `R` with ``R' R = A``
    size: np.ndarray  # (n_features,): square root of the diagonal
    # (n_features, n_visible): orthonormal basis of the range of `A`, in units of `size`
    basis: np.ndarray

    def visible_part(self, theta):
        """Drop the part in the metric's null space if it dwarfs the other part."""
        # Least squares without truncation of singular values returns 1e10 and more
        # along directions without information, which must not determine scales and
        # anchors. Also returns the lengths of the hidden and the visible part.
        standardised = theta * self.size
        part = self.basis @ (self.basis.T @ standardised)
        hidden, visible = np.linalg.norm(standardised - part), np.linalg.norm(part)
        if hidden > _HIDDEN_LIMIT * visible:
            theta = np.divide(
                part, self.size, out=np.zeros_like(theta), where=self.size > 0
            )
        return theta, hidden, visible

    def without_rounding(self, theta):
        """Return the `visible_part`, with a warning if it differs from theta."""
        part, hidden, visible = self.visible_part(theta)
        if part is not theta:
            warnings.warn(
                f"The part of theta that the metric does not see is {hidden:.1e} long "
                f"in units of the metric, the part it sees {visible:.1e}: taken for "
                "the rounding of a singular regression and replaced by the shortest "
                "vector that predicts the same. Fit with a regressor that cuts small "
                "singular values.",
                stacklevel=5,
            )
        return part


@one_blas_thread()
def check_metric(metric, n_features):
    """Validate a metric (n_features, n_features) and take its square root."""
    metric = check_array(metric, dtype=np.float64, input_name="metric")
    if metric.shape != (n_features, n_features):
        raise ValueError(
            f"metric must have shape ({n_features}, {n_features}), one row and column "
            f"per parameter, got {metric.shape}."
        )
    diagonal = np.diag(metric)
    if np.any(diagonal < 0):
        raise ValueError("metric must be positive semidefinite; its diagonal is not.")
    # Compared in units of the diagonal: the entries of a Gram matrix carry the units
    # of two parameters and may be many orders of magnitude apart.
    size = np.sqrt(diagonal)
    inverse = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    rounding = n_features * np.finfo(float).eps * np.abs(metric).max(initial=0.0)
    if np.any(np.abs(metric - metric.T) > rounding + 1e-8 * np.outer(size, size)):
        raise ValueError("metric must be symmetric; it is not equal to metric.T.")
    metric = 0.5 * (metric + metric.T)
    correlation = metric * inverse * inverse[:, None]
    correlation = 0.5 * (correlation + correlation.T)
    eigenvalue, basis = np.linalg.eigh(correlation)
    # A clipped eigendecomposition is semidefinite to rounding in its original units,
    # but perhaps not in units of a tiny diagonal.
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


# Non-negative values below this share of the largest, in the units of the programme,
# are zeros: an interior path ends inside. Measured robots: 1e-14, least friction 1e-3.
_ROUNDING = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class Options:
    """Settings of `PhysicalProjector` for other estimators.

    Parameters
    ----------
    body_starts : array-like of int, default=None
        First column of each body. None: see `parameter_names` of `PhysicalProjector`.
    nonnegative : array-like of int, default=()
        Columns that must not be negative (friction); not used without `body_starts`.
    margin : float, default=1e-8
        Least eigenvalue of a body's matrix, in units of the body's mass and length.
    anchor : array-like of shape (n_features,), default=None
        Vector to which directions are pulled that the metric does not see, such as that
        of a data sheet. None: the vector itself.
    """

    body_starts: object = None
    nonnegative: object = ()
    margin: float = 1e-8
    anchor: object = None

    def __post_init__(self):
        """Raise ValueError for an impossible margin."""
        if not 0 < self.margin < 1:
            raise ValueError(f"margin must be between 0 and 1, got {self.margin!r}.")


@dataclass(frozen=True, kw_only=True)
class Projection:
    """Validated constraint set and distance of a projection, in SI units."""

    constraint: str
    margin: float
    bodies: np.ndarray  # (n_bodies, 10): columns of every body
    nonnegative: np.ndarray  # columns that must not be negative
    metric: Metric
    # (n_bodies,): units of each body's matrix [kg] and [m]
    mass_scale: np.ndarray
    length_scale: np.ndarray
    # (n_features,): target of the null space of the metric; None for the vector
    anchor: np.ndarray | None

    @classmethod
    def of(cls, rows, constraint, metric, options, parameter_names=None):
        """Validate the settings for rows (n_samples, n_features)."""
        check_constraint(constraint)
        n_features = rows.shape[1]
        bodies, nonnegative = resolve_layout(n_features, options, parameter_names)
        anchor = options.anchor
        if anchor is not None:
            anchor = column_or_1d(anchor, dtype=np.float64, input_name="anchor")
            assert_all_finite(anchor, input_name="anchor")
            check_consistent_length(anchor, rows.T)
        if metric is not None:
            metric = check_metric(metric, n_features)
            rows = np.array([metric.visible_part(row)[0] for row in rows])
        # The anchor is usually a plausible robot. A light body of it may be far heavier
        # in truth: in its unit, the pull would outweigh the metric.
        source = rows if anchor is None else anchor[None]
        mass_scale, length_scale = body_scales(source[:, bodies])
        if anchor is not None:
            mean = mass_scale.sum() / max(mass_scale.size, 1)
            mass_scale = np.maximum(mass_scale, mean)
        if metric is None:
            # Parameters of a body in units of its scales, others in units of their
            # root mean square, 1 for zeros.
            units = np.sqrt(np.mean(rows**2, axis=0))
            units[units == 0] = 1.0
            units[bodies] = parameter_units(mass_scale, length_scale)
            metric = check_metric(np.diag(units**-2.0), n_features)
        return cls(
            constraint=constraint,
            margin=options.margin,
            bodies=bodies,
            nonnegative=nonnegative,
            metric=metric,
            mass_scale=mass_scale,
            length_scale=length_scale,
            anchor=anchor,
        )

    @one_blas_thread()
    def __call__(self, theta):
        """Project one vector (n_features,)."""
        theta = self.metric.without_rounding(theta)
        bodies, nonnegative = self.bodies, self.nonnegative
        consistent = np.all(self._eigenvalues(theta) >= self.margin)
        if consistent and np.all(theta[nonnegative] >= 0):
            return theta.copy()
        units, scaled_root = self._scale(theta)
        # One common factor brings bodies far from their scales back near one.
        common = np.abs((theta / units)[bodies]).max(initial=0.0)
        common = common if common > 0 else 1.0
        units = units * common
        programme = Programme.pulled(
            theta / units,
            constraint=self.constraint,
            body_columns=bodies,
            nonnegative=nonnegative,
            margin=self.margin / common,
            metric_root=scaled_root,
            anchor=(theta if self.anchor is None else self.anchor) / units,
        )
        solution = solve(programme)
        if solution.gap > GAP_TARGET:
            # Accepted, but above the target gap.
            warnings.warn(
                f"The projection is certified to a relative gap of {solution.gap:.1e}, "
                f"and not to {GAP_TARGET:.0e}: its squared distance may exceed the "
                f"least one by that share. The solver: {solution.status}. Check the "
                "vector and the metric for columns many orders of magnitude apart.",
                ConvergenceWarning,
                stacklevel=4,
            )
        return self._settle(solution.vector * units, units, programme)

    def _eigenvalues(self, vector):
        """Smallest eigenvalue of each body's matrix, shape (n_bodies,)."""
        return min_eigenvalue(
            vector[self.bodies],
            self.constraint,
            mass_scale=self.mass_scale,
            length_scale=self.length_scale,
        )

    def _scale(self, theta):
        """Units of the columns, and the metric's root in them, columns up to one."""
        bodies, diagonal = self.bodies, self.metric.size**2
        units = np.ones(theta.size)
        units[bodies] = parameter_units(self.mass_scale, self.length_scale)
        outside = np.ones(theta.size, dtype=bool)
        outside[bodies] = False
        # Units outside the bodies give the columns the largest metric of the bodies.
        largest = (diagonal * units**2)[~outside].max(initial=0.0)
        seen = outside & (diagonal > 0)
        units[seen] = np.sqrt((largest if largest > 0 else 1.0) / diagonal[seen])
        root = self.metric.root * units
        size = np.linalg.norm(root, axis=0).max(initial=0.0)
        return units, root / size if size > 0 else root

    def _settle(self, vector, units, programme):
        """Make a vector consistent to the last bit in the units of the user."""
        # Division by the units rounds, so that an eigenvalue may be slightly below the
        # margin; add the smallest lift that restores it.
        bodies, at = self.bodies, self.nonnegative
        least = _ROUNDING * np.abs(vector / units).max(initial=0.0) * units[at]
        vector[at] = np.where(vector[at] > least, vector[at], 0.0)
        excess = np.finfo(float).eps
        for _ in range(60):
            lacking = self._eigenvalues(vector) < self.margin
            if not lacking.any():
                return vector
            lifted = programme.lift(vector / units, programme.margin + excess)
            changed = bodies[lacking]
            vector[changed] = lifted[changed] * units[changed]
            excess *= 2
        raise ProjectionError(
            "The projection failed: rounding keeps a body's smallest eigenvalue below "
            f"the margin of {self.margin:.1e}. Raise margin."
        )


# -- the transformer -------------------------------------------------------------------


class PhysicalProjector(OneToOneFeatureMixin, TransformerMixin, BaseEstimator):
    r"""Project parameter vectors on the nearest physically consistent ones.

    Each row of the input is one parameter vector of a robot.  The row that comes out
    minimises eq. 35 of [TDS2011]_ over the vectors that some rigid bodies with
    non-negative friction have.  A row that is consistent already comes back bit for
    bit.

    Parameters
    ----------
    constraint : {"pseudo-inertia", "eq30"}, default="pseudo-inertia"
        "pseudo-inertia": every body is a distribution of positive mass, that is, its
        4 x 4 pseudo-inertia matrix is positive definite [WKS2018]_.  "eq30": the
        paper's set, a positive mass and a positive definite inertia about the centre
        of mass; it admits inertias that violate the triangle inequality, which no body
        has.
    metric : array-like of shape (n_features, n_features) or None, default=None
        Symmetric positive semidefinite matrix `A` of the distance
        :math:`(\theta - \theta_0)^\top A (\theta - \theta_0)`: the (de-noised) Gram
        matrix of the regression that gave the vectors, singular as it may be.  Its
        overall scale is immaterial.  A part of a row that the metric does not see and
        that is over a hundred times longer than the rest, in units of the metric, is
        the rounding of a singular regression: it is dropped, with a warning.  None
        counts each parameter in its own unit: those
        of a body in units of its mass and length scale, the others in units of
        their root mean square over the rows seen in `fit`.
    parameter_names : array-like of str of shape (n_features,) or None, default=None
        Names of the columns, such as `RigidBodyFeatures.parameter_names_`: a joint, a
        colon, and the parameter.  They give the bodies ("joint_1:m" and so on) and the
        columns that must not be negative ("joint_1:viscous", "joint_1:coulomb",
        "joint_1:rotor_inertia").  None takes those of the data frame seen in `fit`;
        `JointTorqueRegressor` passes on those of its features.  Without names joints
        have 11 columns (the paper's, viscous friction last) or 10, whichever divides
        the number of columns; if both do, 11, with a warning.
    options : Options or None, default=None
        Settings for other estimators.

    Attributes
    ----------
    metric_ : ndarray of shape (n_features, n_features)
        The metric in use.
    body_starts_ : ndarray of int of shape (n_bodies,)
        First column of each body.
    nonnegative_ : ndarray of int of shape (n_nonnegative,)
        Columns that must not be negative.
    n_features_in_ : int
        Number of columns seen in `fit`.
    feature_names_in_ : ndarray of shape (n_features,)
        Names of the columns, where they are strings.

    See Also
    --------
    is_consistent : Test of one body.

    Notes
    -----
    Both sets are convex: the pseudo-inertia and the spatial inertia matrix are linear
    in the parameters, so the projection is a convex quadratic programme with one linear
    matrix inequality per body, and its minimum is unique thanks to the anchor.

    The scales `m0`, `l0` of the bodies enter the margin, the default metric and the
    anchor's weight alone.  They are fixed in `fit` and follow the units of the data.
    A failed solve raises :class:`ProjectionError`; the input is never returned in its
    place.

    References
    ----------
    .. [TDS2011] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system
       identification with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`
    .. [WKS2018] P. M. Wensing, S. Kim, J.-J. E. Slotine, "Linear Matrix
       Inequalities for Physically Consistent Inertial Parameter Identification: A
       Statistical Perspective on the Mass Distribution", IEEE Robotics and
       Automation Letters 3(1), 2018. :doi:`10.1109/LRA.2017.2729659`

    Examples
    --------
    One joint with viscous friction; its inertia violates Izz <= Ixx + Iyy and its
    friction is negative.

    >>> from sklearn_vbjfa.physical import PhysicalProjector
    >>> theta = [[2.0, 0, 0, 0, 1, 0, 1, 0, 0, 3, -0.1]]
    >>> projected = PhysicalProjector().fit_transform(theta)
    >>> projected[0, [4, 6, 9, 10]].round(4) + 0.0
    array([1.3333, 1.3333, 2.6667, 0.    ])

    With names, an offset is distinguished from friction.

    >>> columns = "m mc_x mc_y mc_z I_xx I_xy I_yy I_xz I_yz I_zz viscous offset"
    >>> names = [f"elbow:{column}" for column in columns.split()]
    >>> named = PhysicalProjector(parameter_names=names)
    >>> named.fit_transform([[*theta[0], -0.2]])[0, 10:].round(4) + 0.0
    array([ 0. , -0.2])
    """

    def __init__(
        self,
        constraint="pseudo-inertia",
        *,
        metric=None,
        parameter_names=None,
        options=None,
    ):
        self.constraint = constraint
        self.metric = metric
        self.parameter_names = parameter_names
        self.options = options

    def fit(self, X, y=None):
        """Learn the layout, the scales of the bodies and the metric.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Parameter vectors, one a row; they need not be consistent.
        y : Ignored
            Not used.

        Returns
        -------
        self : PhysicalProjector
            Fitted transformer.

        Raises
        ------
        ValueError
            If an option is wrong or does not match the number of columns.
        """
        X = validate_data(self, X, dtype=np.float64)
        names = self.parameter_names
        if names is None:
            names = getattr(self, "feature_names_in_", None)
        check_scalar(self.options, "options", (Options, type(None)))
        options = Options() if self.options is None else self.options
        self._projection = Projection.of(
            X, self.constraint, self.metric, options, names
        )
        self.metric_ = self._projection.metric.matrix
        self.body_starts_ = self._projection.bodies[:, 0]
        self.nonnegative_ = self._projection.nonnegative
        return self

    def transform(self, X):
        """Project every row on the nearest consistent vector.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Parameter vectors, one a row.

        Returns
        -------
        X_new : ndarray of shape (n_samples, n_features)
            Consistent vectors in the same units; a row that was consistent is equal
            to the last bit.

        Raises
        ------
        ProjectionError
            If a row's projection fails.
        """
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        return np.array([self._projection(row) for row in X])
