"""One parameter vector from the torques of all joints, as a scikit-learn regressor."""

import numpy as np
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin, clone
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_vbjfa.equations._checks import check_weight
from sklearn_vbjfa.equations._equations import Equations
from sklearn_vbjfa.equations._features import check_as_computed, parameter_names_of
from sklearn_vbjfa.equations._joint_moments import piece_moments, sum_moments
from sklearn_vbjfa.fit._estimate import estimate


class JointTorqueRegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):
    """Estimate one parameter vector from the torques of all joints.

    The last step of a pipeline that begins with `RigidBodyFeatures`: splits the wide
    rows into one equation per joint and sample, weights the joints by their noise,
    fits any linear scikit-learn regressor to all equations together, and optionally
    projects the parameters onto the physically consistent set.

    Parameters
    ----------
    regressor : estimator, default=None
        Linear regressor, such as `VBJFARegressor`, `sklearn.linear_model.LassoCV` or
        `sklearn.cross_decomposition.PLSRegression`, or a pipeline of scaler and
        regressor. It is fitted without intercept (an offset is a column),
        to columns and torques of unit mean square. None is
        ``VBJFARegressor(latent="correlated", query="noiseless")``: Bayesian regression
        with automatic relevance determination.
    projector : PhysicalProjector, default=None
        Transformer of parameter vectors; None does not project. If its `metric` is
        None, the weighted Gram matrix of the fit is used (eq. 35 of [1]_); if its
        `parameter_names` are None, those of the features, where X is a data frame
        (``pipeline.set_output(transform="pandas")``): they identify the parameters of
        bodies and non-negative friction.
    joint_weights : "auto", None or array-like of shape (nv,), default="auto"
        Weights of the joints' equations [1 / torque squared]. ``"auto"``: the inverse
        of each joint's residual variance, by iterated least squares. None: unit.

    Attributes
    ----------
    theta_ : ndarray of shape (p,)
        Parameters.
    theta_unconstrained_ : ndarray of shape (p,)
        Parameters before the projection.
    theta_std_ : ndarray of shape (p,)
        Standard deviations of `theta_unconstrained_` for independent rows; nan if the
        regressor provides none.
    joint_weights_ : ndarray of shape (nv,)
        Weights of the joints.
    parameter_names_ : tuple of str or None
        Names of the parameters, such as "joint_1:m", from those of the columns of
        `RigidBodyFeatures`; None if X has no such names.
    regressor_, projector_ : estimator
        The fitted regressor and projector (None without).
    metric_ : ndarray of shape (p, p)
        Weighted Gram matrix of the equations.
    n_features_in_ : int
        nv * p.

    See Also
    --------
    RobotIdentifier : The whole chain in one estimator.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Notes
    -----
    `sample_weight` weights the equations, for any regressor.

    All joints share one parameter vector, so that nothing may rescale or mix the
    columns between `RigidBodyFeatures` and this estimator: rescaled columns raise an
    error. Scalers are allowed as part of `regressor`
    (``make_pipeline(StandardScaler(), Lasso())``).

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.linear_model import LinearRegression
    >>> from sklearn_vbjfa import JointTorqueRegressor
    >>> rng = np.random.default_rng(0)
    >>> Phi = rng.normal(size=(50, 2, 3))  # two joints, three parameters
    >>> tau = Phi @ [1.0, 2.0, 3.0]
    >>> model = JointTorqueRegressor(LinearRegression())
    >>> model.fit(Phi.reshape(50, 6), tau).theta_.round(6)
    array([1., 2., 3.])
    """

    def __init__(self, regressor=None, projector=None, joint_weights="auto"):
        self.regressor = regressor
        self.projector = projector
        self.joint_weights = joint_weights

    def fit(self, X, y, sample_weight=None):
        """Fit the parameters.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv * p)
            Regressor matrices, joints outermost, rows in time order.
        y : array-like of shape (n_samples, nv) or (n_samples,)
            Joint torques.
        sample_weight : array-like of shape (n_samples,) or (n_samples, nv), \
                default=None
            Weights of samples, or of each joint's equations; zero leaves one out.

        Returns
        -------
        self : object
            Fitted estimator.

        Raises
        ------
        ValueError
            If the columns of X do not divide among the joints, or were rescaled.
        """
        X, y = validate_data(
            self, X, y, dtype=np.float64, multi_output=True, y_numeric=True
        )
        self._one_output = y.ndim == 1
        tau = y.reshape(X.shape[0], -1).astype(float)
        nv = tau.shape[1]
        if X.shape[1] % nv:
            raise ValueError(
                f"y has {nv} joints, so that the number of columns of X must be a "
                f"multiple of {nv}; got {X.shape[1]}. (PCA and selections of columns "
                "belong inside the regressor, not before it.)"
            )
        names = getattr(self, "feature_names_in_", None)
        self.parameter_names_ = parameter_names_of(names, nv)
        # One joint without projection does not depend on the units of the columns.
        if nv > 1 or self.projector is not None:
            check_as_computed(X)
        weight = check_weight(sample_weight, tau.shape)
        rows = Equations(
            Phi=X.reshape(*tau.shape, -1), tau=tau, weight=np.array(weight)
        )
        total = sum_moments([piece_moments(rows.Phi, rows.tau, rows.weight)])
        result = estimate(
            total, self.regressor, joint_weights=self.joint_weights, rows=[rows]
        )
        self.theta_unconstrained_ = result.theta_unconstrained
        self.theta_std_ = result.marginal_std
        self.joint_weights_ = result.joint_weights
        self.metric_ = result.metric
        self.regressor_ = result.regressor
        self.theta_ = self._project(self.theta_unconstrained_)
        return self

    def _project(self, theta):
        self.projector_ = None
        if self.projector is None:
            return theta.copy()
        self.projector_ = clone(self.projector)
        if self.projector_.metric is None:
            self.projector_.set_params(metric=self.metric_)
        if self.projector_.parameter_names is None:
            self.projector_.set_params(parameter_names=self.parameter_names_)
        return self.projector_.fit(theta[None]).transform(theta[None])[0]

    def predict(self, X):
        """Predict the joint torques.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv * p)
            Regressor matrices.

        Returns
        -------
        ndarray of shape (n_samples, nv), or (n_samples,) if y had one dimension
            Torques.
        """
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        tau = X.reshape(X.shape[0], -1, self.theta_.size) @ self.theta_
        return tau[:, 0] if self._one_output else tau
