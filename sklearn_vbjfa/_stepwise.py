"""Stepwise regression by partial F-tests (Draper & Smith)."""

import warnings
from numbers import Integral, Real

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_vbjfa._core._standardize import standardize
from sklearn_vbjfa._core._stepwise import StepwiseStep, select_features
from sklearn_vbjfa._sklearn_compat import (
    Interval,
    _fit_context,
    check_sample_weight,
)

__all__ = ["StepwiseRegressor", "StepwiseStep"]


class StepwiseRegressor(RegressorMixin, BaseEstimator):
    r"""Least squares on features chosen by forward and backward F-tests.

    Starting from no feature, the least significant selected feature is removed as
    long as its test allows it; otherwise the most significant feature outside the
    model enters; the search ends when neither test moves a feature.

    Parameters
    ----------
    p_enter : float, default=0.05
        A feature enters if the p-value of its partial F-test is below this.

    p_remove : float, default=0.10
        A selected feature leaves if the p-value of its partial F-test is above
        this. At least `p_enter`, or a feature could enter and leave for ever.

    max_iter : int, default=None
        Largest number of steps, each entering or removing one feature. ``None``
        sets no limit: the search always ends.

    fit_intercept : bool, default=True
        Whether to fit an intercept, which is not subject to selection. Without it,
        the data are expected to be centred, or the model to pass through zero.

    Attributes
    ----------
    coef_ : ndarray of shape (n_features,)
        Least-squares coefficients [unit of y / unit of X_j] on the selected
        features, zero for the others.

    intercept_ : float
        Intercept [unit of y].

    selected_ : ndarray of shape (n_features,), dtype=bool
        Features in the final model.

    path_ : tuple of StepwiseStep
        Steps in order: `feature`, `action` ("enter" or "remove"), `F`, `p_value`.

    n_iter_ : int
        Number of steps, ``len(path_)``.

    converged_ : bool
        Whether no test would move a feature any more.

    n_features_in_ : int
        Number of features seen during `fit`.

    feature_names_in_ : ndarray of shape (`n_features_in_`,)
        Names of features seen during `fit`, if X has string names.

    See Also
    --------
    sklearn.feature_selection.SequentialFeatureSelector : Selection by
        cross-validated score.
    sklearn.linear_model.LassoCV : Selection by shrinkage.

    Notes
    -----
    The model is :math:`y = X \beta + \beta_0 + \epsilon` with independent
    Gaussian :math:`\epsilon` of one variance and X without error. Feature j is
    tested against the model S without it by

    .. math::

        F = \frac{RSS(S) - RSS(S \cup j)}{RSS(S \cup j) / \nu}, \qquad
        \nu = \sum_i w_i - |S \cup j| - 1,

    with one more degree of freedom where no intercept is fitted. Sample weights
    count repetitions: weight 2 is a row given twice, and the degrees of freedom use
    the *sum* of the weights. Weights known only up to a factor have to be scaled to
    sum up to the number of samples.

    The p-values are those of tests fixed in advance; after selection they are too
    small, and among collinear features the choice is unstable [3]_.

    All steps work on the correlation matrix of [X y], formed once at a cost of
    :math:`N d^2`, by the sweep operator [2]_, at :math:`d^2` an entry; a removal
    sweeps the remaining features again from the correlations, so that reverse sweeps
    do not pile up rounding. A feature may enter only while its tolerance, 1 - R² on
    the other selected features, and the tolerances it leaves to those are at least
    1.5e-8: exact duplicates, linear combinations and constants never enter, and of
    two duplicates the first is taken. Units play no role. A residual sum of squares
    of less than 1e-12 of the total one counts as an exact fit, after which nothing
    enters. The final coefficients are refined once on the residuals of the data.

    No model can return while ``p_enter <= p_remove`` [4]_; should rounding propose a
    model seen before, the search stops with a warning.

    References
    ----------
    .. [1] N. R. Draper and H. Smith, Applied Regression Analysis, 3rd ed., chapter
       15, Wiley, 1998. :doi:`10.1002/9781118625590`
    .. [2] J. H. Goodnight, A Tutorial on the SWEEP Operator, The American
       Statistician 33, 149-158, 1979. :doi:`10.1080/00031305.1979.10482685`
    .. [3] S. Derksen and H. J. Keselman, Backward, forward and stepwise automated
       subset selection algorithms, British Journal of Mathematical and Statistical
       Psychology 45, 265-282, 1992. :doi:`10.1111/j.2044-8317.1992.tb00992.x`
    .. [4] A. Miller, Subset Selection in Regression, 2nd ed., Chapman & Hall/CRC,
       2002. :doi:`10.1201/9781420035933`

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa import StepwiseRegressor
    >>> rng = np.random.default_rng(0)
    >>> X = rng.normal(size=(100, 4))
    >>> y = 3.0 * X[:, 2] - X[:, 0] + 0.1 * rng.normal(size=100)
    >>> model = StepwiseRegressor(p_enter=0.01).fit(X, y)
    >>> model.selected_
    array([ True, False,  True, False])
    >>> [(step.feature, step.action) for step in model.path_]
    [(2, 'enter'), (0, 'enter')]
    """

    _parameter_constraints = {  # noqa: RUF012
        "p_enter": [Interval(Real, 0, 1, closed="right")],
        "p_remove": [Interval(Real, 0, 1, closed="right")],
        "max_iter": [Interval(Integral, 1, None, closed="left"), None],
        "fit_intercept": ["boolean"],
    }

    def __init__(
        self, *, p_enter=0.05, p_remove=0.10, max_iter=None, fit_intercept=True
    ):
        self.p_enter = p_enter
        self.p_remove = p_remove
        self.max_iter = max_iter
        self.fit_intercept = fit_intercept

    @_fit_context(prefer_skip_nested_validation=True)
    def fit(self, X, y, sample_weight=None):
        """Select features and fit their coefficients.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Inputs.

        y : array-like of shape (n_samples,)
            Output.

        sample_weight : array-like of shape (n_samples,), default=None
            Numbers of repetitions of the rows, not necessarily whole.

        Returns
        -------
        self : StepwiseRegressor
            Fitted estimator.
        """
        if self.p_enter > self.p_remove:
            raise ValueError(
                "p_enter must not exceed p_remove, or a feature could enter and "
                f"leave for ever; got p_enter={self.p_enter!r} and "
                f"p_remove={self.p_remove!r}. Lower p_enter or raise p_remove."
            )
        X, y = validate_data(
            self, X, y, dtype=np.float64, y_numeric=True, ensure_min_samples=2
        )
        weight = check_sample_weight(sample_weight, X)
        dof = weight.sum() - bool(self.fit_intercept)
        if dof <= 1:
            raise ValueError(
                "An F-test needs residual degrees of freedom: the sample weights "
                f"must sum up to more than {1 + bool(self.fit_intercept)}, got "
                f"{weight.sum():.6g}. A weight is a number of repetitions of its row; "
                "scale the weights to sum up to the number of samples."
            )
        used = weight > 0
        data = np.column_stack([X, y])[used]
        weight = weight[used]

        columns = standardize(data, weight, center=self.fit_intercept)
        correlation = columns.values.T @ columns.values
        selection = select_features(
            correlation,
            dof,
            p_enter=self.p_enter,
            p_remove=self.p_remove,
            max_iter=self.max_iter,
        )

        chosen = np.flatnonzero(selection.selected)
        coef = np.zeros(X.shape[1])
        if chosen.size:
            inputs, output = columns.values[:, chosen], columns.values[:, -1]
            factor = cho_factor(correlation[np.ix_(chosen, chosen)])
            solution = cho_solve(factor, correlation[chosen, -1])
            # One refinement from the data brings the normal equations close to the
            # accuracy of an orthogonal factorisation.
            residual = output - inputs @ solution
            solution += cho_solve(factor, inputs.T @ residual)
            coef[chosen] = solution / columns.scale[chosen] * columns.scale[-1]

        self.coef_ = coef
        self.intercept_ = float(columns.mean[-1] - columns.mean[:-1] @ coef)
        self.selected_ = selection.selected
        self.path_ = selection.path
        self.n_iter_ = len(selection.path)
        self.converged_ = selection.status == "converged"
        if selection.status == "max_iter":
            warnings.warn(
                f"Stepwise selection stopped at max_iter={self.max_iter} steps "
                "although a test would still move a feature; raise max_iter.",
                ConvergenceWarning,
                stacklevel=2,
            )
        elif selection.status == "revisited":
            warnings.warn(
                f"Stepwise selection stopped after {self.n_iter_} steps: rounding "
                "proposed a model seen before. The features are nearly collinear; "
                "remove redundant ones.",
                ConvergenceWarning,
                stacklevel=2,
            )
        return self

    def predict(self, X):
        """Predict the output.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Inputs.

        Returns
        -------
        ndarray of shape (n_samples,)
            Predicted output [unit of y].
        """
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        return X @ self.coef_ + self.intercept_
