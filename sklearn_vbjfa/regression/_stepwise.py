"""Stepwise regression by partial F-tests on a correlation matrix (Draper & Smith)."""

import warnings
from collections import namedtuple
from numbers import Real

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import fdtrc
from sklearn.exceptions import ConvergenceWarning

from sklearn_vbjfa.regression._base import Interval, LinearRegressor

# Smallest fraction of a selected feature's variance that the other selected
# features may leave unexplained ("tolerance"; its inverse is the variance
# inflation factor). Half the digits of a pivot are then still correct.
TOLERANCE = np.sqrt(np.finfo(np.float64).eps)

# A residual sum of squares below this fraction of the total one is rounding of the
# correlation matrix: the fit is exact and F-ratios between such fits mean nothing.
EXACT_FIT = 1e-12

# F-ratios that agree this well are ties (duplicate columns in different units), so
# that rounding does not decide which of two duplicates is taken.
TIE = 1e-8


# A column of X, what happened to it ("enter" or "remove"), its partial F-ratio on 1 and
# the residual degrees of freedom of the larger model, and its upper tail probability.
StepwiseStep = namedtuple("StepwiseStep", "feature action F p_value")


class StepwiseRegressor(LinearRegressor):
    r"""Least squares on features chosen by forward and backward F-tests.

    Starting from no feature, the least significant selected feature is removed as
    long as its test allows it; otherwise the most significant other feature enters.

    Parameters
    ----------
    p_enter : float, default=0.05
        A feature enters if the p-value of its partial F-test is below this.
    p_remove : float, default=0.10
        A selected feature leaves if its p-value is above this; at least `p_enter`.
    fit_intercept : bool, default=True
        Whether to fit an intercept, which is not subject to selection.

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
    With a Gaussian error of one variance and X without error, feature j is tested
    against the model S without it by

    .. math::

        F = \frac{RSS(S) - RSS(S \cup j)}{RSS(S \cup j) / \nu}, \qquad
        \nu = \sum_i w_i - |S \cup j| - 1,

    with one more degree of freedom where no intercept is fitted.

    The p-values are those of tests fixed in advance; after selection they are too
    small, and among collinear features the choice is unstable [3]_.

    All steps work on the correlation matrix of [X y] by the sweep operator [2]_. A
    feature may enter only while its tolerance, 1 - R² on the other selected features,
    and the tolerances it leaves to those are at least 1.5e-8. Nothing enters after an
    exact fit. If rounding proposes a model seen before, the search stops with a warning
    [4]_.

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
        "fit_intercept": ["boolean"],
    }

    def __init__(self, *, p_enter=0.05, p_remove=0.10, fit_intercept=True):
        self.p_enter = p_enter
        self.p_remove = p_remove
        self.fit_intercept = fit_intercept

    def _fit_rows(self, X, y, weight):
        if self.p_enter > self.p_remove:
            raise ValueError(
                "p_enter must not exceed p_remove, or a feature could enter and "
                f"leave for ever; got p_enter={self.p_enter!r} and "
                f"p_remove={self.p_remove!r}. Lower p_enter or raise p_remove."
            )
        columns, total = self._unit_columns([X, y], weight)
        dof = total - bool(self.fit_intercept)
        if dof <= 1:
            raise ValueError(
                "An F-test needs residual degrees of freedom: the sample weights "
                f"must sum up to more than {1 + bool(self.fit_intercept)}, got "
                f"{total:.6g}. A weight is a number of repetitions of its row; "
                "scale the weights to sum up to the number of samples."
            )
        correlation = columns.values.T @ columns.values
        selected, path, self.converged_ = select_features(
            correlation, dof, p_enter=self.p_enter, p_remove=self.p_remove
        )
        chosen = np.flatnonzero(selected)
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

        self._set_coefficients(coef, columns.mean)
        self.selected_, self.path_ = selected, path
        self.n_iter_ = len(path)
        if not self.converged_:
            warnings.warn(
                f"Stepwise selection stopped after {self.n_iter_} steps: rounding "
                "proposed a model seen before. The features are nearly collinear; "
                "remove redundant ones.",
                ConvergenceWarning,
                stacklevel=5,
            )


def sweep(table, pivot):
    """Sweep a square matrix on one diagonal element (Goodnight, 1979)."""
    # Swept on a set S, a correlation matrix R of [X y] holds ``inv(R_SS)`` in the block
    # SS, the standardised coefficients in S y, and in the rest the products of what S
    # leaves unexplained: 1 - R^2 of each other feature on the diagonal, the RSS in y y.
    column = table[:, pivot].copy()
    row = table[pivot] / column[pivot]
    swept = table - np.outer(column, row)
    swept[pivot] = row
    swept[:, pivot] = -column / column[pivot]
    swept[pivot, pivot] = 1.0 / column[pivot]
    return swept


def select_features(correlation, dof, *, p_enter, p_remove):
    """Run forward selection with backward elimination until no test moves a feature."""
    # correlation: products (d + 1, d + 1) of the unit-length columns of [X y], zero for
    # constants; dof: degrees of freedom of y before any feature enters. Returns the
    # features (d,), bool, the steps, and whether no test would move a feature any more;
    # else rounding proposed a model seen before.
    n_features = correlation.shape[0] - 1
    selected = np.zeros(n_features, dtype=bool)
    path = []
    if correlation[-1, -1] == 0:
        return selected, (), True
    table = correlation
    visited = {selected.tobytes()}
    while True:
        step = _removal(table, selected, dof, p_remove)
        if step is None:
            step = _entry(table, selected, dof, p_enter)
        if step is None:
            return selected, tuple(path), True
        proposal = selected.copy()
        proposal[step.feature] = step.action == "enter"
        # In exact arithmetic a model never comes back: with Fe(nu) >= Fr(nu) the
        # critical values of the two tests for nu residual degrees of freedom,
        # log RSS + sum over the sizes of log(1 + Fe(nu) / nu) falls strictly at
        # each entry and does not rise at a removal (Miller, 2002).
        if proposal.tobytes() in visited:
            return selected, tuple(path), False
        visited.add(proposal.tobytes())
        selected = proposal
        path.append(step)
        if step.action == "enter":
            table = sweep(table, step.feature)
        else:
            # Reverse sweeps would pile up rounding; removals are rare enough to
            # start again from the correlations.
            table = correlation
            for feature in np.flatnonzero(selected):
                table = sweep(table, feature)


def _f_ratio(rss_smaller, rss_larger, dof_larger):
    """Partial F-ratio of nested models that differ by one feature."""
    rss_smaller = np.maximum(rss_smaller, EXACT_FIT)
    rss_larger = np.maximum(rss_larger, EXACT_FIT)
    return (rss_smaller - rss_larger) / (rss_larger / dof_larger)


def _removal(table, selected, dof, p_remove):
    """Least significant selected feature, if its test lets it go."""
    features = np.flatnonzero(selected)
    if features.size == 0:
        return None
    nu = dof - features.size
    increase = table[features, -1] ** 2 / table[features, features]
    F = _f_ratio(table[-1, -1] + increase, table[-1, -1], nu)
    chosen = np.flatnonzero(F <= F.min() * (1 + TIE))[-1]
    p_value = fdtrc(1, nu, F[chosen])
    if not p_value > p_remove:
        return None
    feature = int(features[chosen])
    return StepwiseStep(feature, "remove", float(F[chosen]), float(p_value))


def _entry(table, selected, dof, p_enter):
    """Most significant feature outside the model, if its test lets it in."""
    inside = np.flatnonzero(selected)
    features = np.flatnonzero(~selected)
    nu = dof - inside.size - 1
    if nu <= 0:
        return None
    features = features[table[features, features] >= TOLERANCE]
    # An entry must leave the tolerance of the selected features acceptable too.
    inflation = (
        table[inside, inside][:, np.newaxis]
        + table[np.ix_(inside, features)] ** 2 / table[features, features]
    )
    features = features[np.all(inflation * TOLERANCE <= 1, axis=0)]
    if features.size == 0:
        return None
    decrease = table[features, -1] ** 2 / table[features, features]
    F = _f_ratio(table[-1, -1], table[-1, -1] - decrease, nu)
    chosen = np.flatnonzero(F >= F.max() * (1 - TIE))[0]
    p_value = fdtrc(1, nu, F[chosen])
    if not p_value < p_enter:
        return None
    feature = int(features[chosen])
    return StepwiseStep(feature, "enter", float(F[chosen]), float(p_value))
