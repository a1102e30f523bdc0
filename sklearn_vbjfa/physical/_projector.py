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

    parameter_names : array-like of str of shape (n_features,) or None, default=None
        Names of the columns, such as `RigidBodyFeatures.parameter_names_`: a joint, a
        colon, and the parameter.  They give the bodies ("joint_1:m" and so on) and the
        columns that must not be negative ("joint_1:viscous", "joint_1:coulomb",
        "joint_1:rotor_inertia").  None takes those of the data frame seen in `fit`;
        `JointTorqueRegressor` passes on those of its features.  Without names joints
        have 11 columns (the paper's, viscous friction last) or 10.

    options : Options or None, default=None
        Layout, margin and anchor for other estimators.

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
