"""Instrumental variables by two-stage least squares."""

import numpy as np
from sklearn.utils.validation import check_array, check_consistent_length

from sklearn_vbjfa._core._linear_systems import orthonormal_basis, scaled_lstsq
from sklearn_vbjfa.regression._base import LinearRegressor


class InstrumentalVariables(LinearRegressor):
    r"""Two-stage least squares: inputs seen through instruments free of their noise.

    Parameters
    ----------
    fit_intercept : bool, default=True
        Whether to fit an intercept, which is its own instrument.

    Attributes
    ----------
    coef_ : ndarray of shape (n_features,)
        Coefficients [unit of y / unit of X_j].
    intercept_ : float
        Intercept [unit of y].
    coef_std_ : ndarray of shape (n_features,)
        Classical standard deviations of `coef_` [unit of y / unit of X_j], for
        independent residuals of one variance. Infinite for a coefficient that
        instruments and X do not determine, NaN without residual degrees of freedom.
    rank_ : int
        Number of directions of X that the instruments reach; the coefficients are
        unique if it is `n_features_in_`.
    n_features_in_ : int
        Number of features seen during `fit`.
    feature_names_in_ : ndarray of shape (`n_features_in_`,)
        Names of features seen during `fit`, if X has string names.

    See Also
    --------
    TotalLeastSquares : Noisy inputs of known noise ratios, without instruments.
    sklearn.linear_model.LinearRegression : No noise in X.

    Notes
    -----
    X may be correlated with the error of y, for example if X is measured with noise;
    the instruments Z are correlated with X and not with that error: a second
    measurement of X with independent noise, the reference trajectory, or the simulated
    response of the robot [2]_. Features known exactly have to be repeated among the
    instruments. With P the orthogonal projector on the columns of Z [1]_,

    .. math::

        \hat\beta = (X^T P X)^{-1} X^T P y, \qquad
        \mathrm{cov}(\hat\beta) = \hat\sigma^2 (X^T P X)^{-1},

    which is :math:`(Z^T X)^{-1} Z^T y` for as many instruments as features.
    :math:`\hat\sigma^2` is the residual sum of squares :math:`\|y - X
    \hat\beta\|^2`, of X and not of PX, over the sum of the weights minus the
    number of coefficients.

    Whether instruments are uncorrelated with :math:`\epsilon` cannot be seen from
    the data if there are no more of them than features. Weak ones bias the estimate
    towards least squares.

    References
    ----------
    .. [1] J. D. Sargan, The Estimation of Economic Relationships using Instrumental
       Variables, Econometrica 26, 393-415, 1958. :doi:`10.2307/1907619`
    .. [2] M. Brunot, A. Janot, P. C. Young and F. Carrillo, An improved instrumental
       variable method for industrial robot model identification, Control
       Engineering Practice 74, 107-117, 2018.
       :doi:`10.1016/j.conengprac.2018.02.010`

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa import InstrumentalVariables
    >>> rng = np.random.default_rng(0)
    >>> xi = rng.normal(size=(5000, 1))
    >>> y = 2.0 * xi[:, 0] + 0.1 * rng.normal(size=5000)
    >>> X = xi + rng.normal(size=(5000, 1))
    >>> repeated = xi + rng.normal(size=(5000, 1))
    >>> InstrumentalVariables().fit(X, y).coef_.round()  # least squares
    array([1.])
    >>> InstrumentalVariables().fit(X, y, instruments=repeated).coef_.round()
    array([2.])
    """

    _parameter_constraints = {"fit_intercept": ["boolean"]}  # noqa: RUF012

    def __init__(self, *, fit_intercept=True):
        self.fit_intercept = fit_intercept

    def fit(self, X, y, *, instruments=None, sample_weight=None):
        """Fit the coefficients.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Inputs.
        y : array-like of shape (n_samples,)
            Output.
        instruments : array-like of shape (n_samples, n_instruments), default=None
            At least as many columns as X; None is X itself, least squares.
        sample_weight : array-like of shape (n_samples,), default=None
            Numbers of repetitions of the rows, not necessarily whole.

        Returns
        -------
        self : InstrumentalVariables
            Fitted estimator.
        """
        X, y, weight = self._check_rows(X, y, sample_weight, min_samples=1)
        n_features = X.shape[1]
        blocks = [X, y]
        if instruments is not None:
            instruments = check_array(
                instruments, dtype=np.float64, input_name="instruments"
            )
            check_consistent_length(X, instruments)
            if instruments.shape[1] < n_features:
                raise ValueError(
                    f"instruments must have at least {n_features} columns, one for "
                    f"each feature of X; got {instruments.shape[1]}. Add instruments, "
                    "such as the features that are known exactly."
                )
            blocks.append(instruments)
        columns, total = self._unit_columns(blocks, weight)
        factor = np.linalg.qr(columns.values, mode="r")
        inputs, output = factor[:, :n_features], factor[:, n_features]
        if instruments is None:
            projected, target = inputs, output
        else:
            basis = orthonormal_basis(factor[:, n_features + 1 :])
            projected, target = basis.T @ inputs, basis.T @ output
        solution = scaled_lstsq(projected, target)

        scale = columns.scale[n_features] / columns.scale[:n_features]
        self._set_coefficients(solution.coef * scale, columns.mean)
        self.rank_ = solution.rank
        residual = output - inputs @ solution.coef
        dof = total - solution.rank - bool(self.fit_intercept)
        if dof > 0:
            std = np.sqrt(residual @ residual / dof * np.diag(solution.inverse)) * scale
            self.coef_std_ = np.where(solution.identified, std, np.inf)
        else:
            self.coef_std_ = np.full(n_features, np.nan)
        return self
