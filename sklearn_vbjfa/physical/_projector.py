"""Transformer that projects parameter vectors on the physically consistent ones."""

import numpy as np
from sklearn.base import BaseEstimator, OneToOneFeatureMixin, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_vbjfa.physical._projection import Options, Projection


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

    parameters_per_joint : "auto" or int >= 10, default="auto"
        Columns of one joint: its ten inertial parameters, then its friction and
        effect columns.  "auto" reads the names of the columns, if they have any such
        as "joint_1:m" (see `parameter_names`).  Otherwise it takes 11 (the paper's,
        viscous friction last) or 10, whichever divides the number of columns; if both
        do, 11, with a warning.  A vector with fewer than ten columns holds no body: it
        passes through unchanged, with a warning.  Any other number of columns is
        refused.

    body_starts : array-like of int of shape (n_bodies,) or None, default=None
        First column of each body's ten, for joints with different numbers of extra
        columns; replaces `parameters_per_joint`.  Columns of no body are free scalars
        unless `nonnegative` names them.

    nonnegative : "auto", array-like of int or array-like of bool, default="auto"
        Columns outside the bodies that must not be negative (viscous and Coulomb
        friction, rotor inertia): column numbers, or a mask of shape (n_features,).
        "auto" reads the names: "joint_1:viscous", "joint_1:coulomb" and
        "joint_1:rotor_inertia" must not be negative, all others may have either sign.
        Without names it is the eleventh column of a joint of eleven; a layout with
        other extra columns has to say, since an offset may have either sign.

    margin : float, default=1e-8
        Least eigenvalue of each body's matrix, in units of the body's mass and length
        scale: :math:`S J S / m_0 \succeq \mathrm{margin} \cdot E` with :math:`S =
        \mathrm{diag}(1/l_0, 1/l_0, 1/l_0, 1)`.  Above zero, so that the projected
        robot can be simulated.

    mass_scale : float, array-like of shape (n_bodies,) or None, default=None
        Unit of mass `m0` of each body [kg].  None: :func:`body_scales` of the anchor
        if there is one, otherwise of the rows seen in `fit`.

    length_scale : float, array-like of shape (n_bodies,) or None, default=None
        Unit of length `l0` of each body [m].  None: as for `mass_scale`.

    anchor : array-like of shape (n_features,) or None, default=None
        Vector (a data sheet's, say) that directions the metric does not see are
        pulled to.  None: the row itself, so that such directions move only as far as
        consistency demands.  A row that is consistent already is not pulled.

    anchor_weight : float, default=1e-8
        Weight of that pull, relative to the largest diagonal entry of the metric in
        scaled units.  It makes the minimum unique where the metric is singular, and
        acts on nothing that the metric sees, however little (some 1e-14 of what it sees
        best).  Consistency ties what is seen to what is not: a weaker pull lowers the
        distance, by less and less, at masses further and further from the anchor's.
        `anchor_cost` of a :class:`ProjectionResult` says by how much.

        .. versionchanged:: 0.2
           The pull acted in all directions, also on what the metric saw little of.

    max_solver_iter : int, default=200
        Largest number of interior-point iterations of one solve.

    parameter_names : array-like of str of shape (n_features,) or None, default=None
        Names of the columns, such as `RigidBodyFeatures.parameter_names_`: a joint, a
        colon, and what the parameter is.  None takes those of the data frame seen in
        `fit`; `JointTorqueRegressor` passes on those of its features.  Names without
        any "joint:m" say nothing.

        .. versionadded:: 0.2

    Attributes
    ----------
    metric_ : ndarray of shape (n_features, n_features)
        The metric in use.

    body_starts_ : ndarray of int of shape (n_bodies,)
        First column of each body.

    nonnegative_ : ndarray of int of shape (n_nonnegative,)
        Columns that must not be negative.

    mass_scale_ : ndarray of shape (n_bodies,)
        Unit of mass of each body [kg].

    length_scale_ : ndarray of shape (n_bodies,)
        Unit of length of each body [m].

    n_features_in_ : int
        Number of columns seen in `fit`.

    feature_names_in_ : ndarray of shape (n_features,)
        Names of the columns, where they are strings.

    See Also
    --------
    project : The same for one vector, with the solver's report.
    is_consistent : Test of one body.

    Notes
    -----
    Both sets are convex: the pseudo-inertia and the spatial inertia matrix are linear
    in the parameters, so the projection is a convex quadratic programme with one linear
    matrix inequality per body, and its minimum is unique thanks to the anchor.
    Eq. 30 states the second set through a nonlinear map, in which the paper's
    remark that the minimisation is convex does not hold.

    The scales `m0`, `l0` enter the margin, the default metric and the anchor's weight
    alone.  They are fixed in `fit`, so that projecting twice changes nothing, and they
    follow the units of the data: parameters times a constant, or another unit of
    length, give the same answer in those units.

    The cost is one interior-point solve per row, :math:`O(d^3)` per iteration.  A
    failed solve raises :class:`ProjectionError`; the input is never returned in its
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

    With names, an offset is told from friction.

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
        self.constraint = constraint
        self.metric = metric
        self.parameters_per_joint = parameters_per_joint
        self.body_starts = body_starts
        self.nonnegative = nonnegative
        self.margin = margin
        self.mass_scale = mass_scale
        self.length_scale = length_scale
        self.anchor = anchor
        self.anchor_weight = anchor_weight
        self.max_solver_iter = max_solver_iter
        self.parameter_names = parameter_names

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
        options = self.get_params(deep=False)
        if self.parameter_names is None:
            options["parameter_names"] = getattr(self, "feature_names_in_", None)
        self._projection = Projection.of(X, Options(**options))
        self.metric_ = self._projection.metric.matrix
        self.mass_scale_ = self._projection.mass_scale
        self.length_scale_ = self._projection.length_scale
        self.body_starts_ = self._projection.layout.body_starts
        self.nonnegative_ = self._projection.layout.nonnegative
        return self

    def projections(self, X):
        """Project every row and report how.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Parameter vectors, one a row.

        Returns
        -------
        results : tuple of ProjectionResult
            One per row.

        Raises
        ------
        ProjectionError
            If a row's projection fails.
        """
        return self._project(X, price_anchor=True)

    def _project(self, X, *, price_anchor):
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        return tuple(self._projection(row, price_anchor=price_anchor) for row in X)

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
        results = self._project(X, price_anchor=False)
        return np.array([result.theta for result in results])
