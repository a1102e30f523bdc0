"""Base of the EM and the VB estimator: moments, attributes, prediction."""

import warnings
from dataclasses import replace
from numbers import Integral, Real

import numpy as np
from sklearn.exceptions import ConvergenceWarning

from sklearn_vbjfa._core._correlated import inverse_factor
from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa._core._moments import from_data, from_scatter, standardise
from sklearn_vbjfa._core._runtime import one_blas_thread
from sklearn_vbjfa._core._solver import solve, start
from sklearn_vbjfa._core._updates import (
    VARIANCE_FLOOR,
    LinearModel,
    Prior,
    coefficients_noiseless,
    coefficients_noisy,
    expect_hidden,
)
from sklearn_vbjfa.regression._base import (
    BaseRegressor,
    Interval,
    StrOptions,
    noise_shares,
    resolve_input_noise,
)

# Coefficients with finite variances.
_LARGEST_UNIT = 1e140


class BaseJointFactorRegressor(BaseRegressor):
    """Rows to moments, prediction; subclasses fit standardised moments in `_fit`."""

    _parameter_constraints: dict = {  # noqa: RUF012
        "input_noise": [None, Real, "array-like"],
        "fit_intercept": ["boolean"],
        "query": [StrOptions({"noiseless", "noisy"})],
        "max_iter": [Interval(Integral, 1, None, closed="left")],
        "tol": [Interval(Real, 0, None, closed="left")],
    }

    def _fit_rows(self, X, y, weight):
        self._fit_moments(from_data(X, y, weight))

    @one_blas_thread()
    def partial_fit(self, X, y, sample_weight=None):
        """Add rows to those seen so far and refit from the merged statistics.

        The result equals one `fit` on all rows together, in any chunking.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Further rows of inputs.
        y : array-like of shape (n_samples,)
            Their outputs.
        sample_weight : array-like of shape (n_samples,), default=None
            Weights.

        Returns
        -------
        self : object
            Fitted estimator.
        """
        first = not hasattr(self, "statistics_")
        X, y, weight = self._check_rows(X, y, sample_weight, min_samples=1, reset=first)
        rows = from_data(X, y, weight)
        return self._fit_moments(rows if first else self.statistics_ + rows)

    def _fit_moments(self, moments):
        self.statistics_ = moments
        self.n_features_in_ = moments.origin.size - 1
        return self._fit(standardise(moments, centred=self.fit_intercept))

    def _feature_labels(self):
        """Names for messages: the columns' names, or their numbers."""
        return getattr(self, "feature_names_in_", range(self.n_features_in_))

    def _fit_independent(self, data, noise, prior):
        """Fit the independent-latent model and set its attributes."""
        # noise: input noise of the user, validated
        fixed = noise_shares(noise, data, self._feature_labels())
        if data.is_degenerate:
            return self._fit_constant(data)
        prior = replace(prior, psi_x_fixed=fixed)
        solution, retained, noisy, noiseless = fit_independent(
            data, prior, max_iter=self.max_iter, tol=self.tol
        )
        state = solution.state
        units = np.log(data.y_scale) + np.log(data.x_scale).sum()
        self._set_loop_attributes(solution, data, units)
        self._set_linear_models(noisy, noiseless, data)
        self.input_noise_ = data.expand(state.psi_x * data.x_scale**2)
        if prior.ard:
            self.relevant_ = data.expand(retained).astype(bool)
            # w_z in the unit of y: a standardised precision over y's variance
            self.alpha_ = data.expand(state.E_alpha / data.y_scale**2, fill=np.inf)
        if fixed is None and (at_floor := state.psi_x <= 2 * VARIANCE_FLOOR).any():
            where = np.flatnonzero(data.active)[at_floor]
            shown = ", ".join(str(self._feature_labels()[i]) for i in where[:10])
            warnings.warn(
                f"The input-noise variance of {where.size} input(s) ({shown}) went to "
                "zero, the smallest that the data resolve (a Heywood case): the fit "
                "takes them as exact. Give input_noise where it is known.",
                UserWarning,
                stacklevel=7,
            )
        return self

    def _fit_constant(self, data):
        """Set the attributes for a constant y or constant inputs: intercept only."""
        d = data.active.shape[0]
        zero = np.zeros(data.x_scale.size)
        model = LinearModel(zero, np.diag(zero), noise=float(data.y_scale > 0))
        self._set_linear_models(model, model, data)
        self.input_noise_, self.relevant_ = np.zeros(d), np.zeros(d, dtype=bool)
        self.alpha_, self.elbo_history_ = np.full(d, np.inf), np.array([])
        self.n_iter_, self.converged_ = 1, True
        return self

    def _set_loop_attributes(self, solution, data, log_units):
        # convert the bound from standardised units to the units of the data
        n = data.moments.n
        self.elbo_history_ = solution.history - n * log_units
        self.n_iter_ = solution.n_iter
        self.converged_ = solution.status == "converged"
        if solution.status == "bound_decreased":
            warnings.warn(
                f"The bound fell by {solution.fall:.3g} at iteration "
                f"{solution.n_iter} of {type(self).__name__}, more than rounding can "
                "explain; the last state before it is kept. Check the scaling and "
                "the rank of X.",
                ConvergenceWarning,
                stacklevel=8,
            )
        elif solution.status == "max_iter":
            gain = np.diff(solution.history[-2:])
            reached = f"{gain[0] / n:.3g}" if gain.size else "unknown"
            warnings.warn(
                f"{type(self).__name__} stopped after max_iter={self.max_iter} "
                f"iterations with a gain of {reached} per sample, tol={self.tol:.3g}; "
                "increase max_iter or tol.",
                ConvergenceWarning,
                stacklevel=8,
            )

    def _set_linear_models(self, noisy, noiseless, data):
        """Set the models of both kinds of queries, and the one that `predict` uses."""
        unit = data.y_scale / data.x_scale
        if unit.max(initial=1.0) > _LARGEST_UNIT:
            raise ValueError(
                f"Coefficients have the size {unit.max():.3g} [unit of y / unit of X], "
                f"expected at most {_LARGEST_UNIT:g}. Choose other units."
            )
        y2 = data.y_scale**2
        self.coef_noisy_ = data.expand(noisy.coef * unit)
        self.coef_noiseless_ = data.expand(noiseless.coef * unit)
        self.output_noise_ = noiseless.noise * y2
        answer = noisy if self.query == "noisy" else noiseless
        self.coef_ = data.expand(answer.coef * unit)
        # A constant column does not determine its coefficient.
        self.coef_cov_ = cov = np.diag(np.where(data.active, 0.0, np.inf))
        cov[np.ix_(data.active, data.active)] = answer.cov * np.outer(unit, unit)
        # Without noise a variance is zero to rounding, on either side.
        self.coef_std_ = np.sqrt(np.maximum(np.diagonal(self.coef_cov_), 0.0))
        self.intercept_ = float(data.y_offset - data.x_offset @ self.coef_)
        self._x_offset = data.x_offset
        self._query_noise = (answer.noise + answer.open_noise) * y2
        # The mean of y is known from n samples.
        self._mean_noise = self.fit_intercept * self._query_noise / data.moments.n

    def predict(self, X, return_std=False):
        """Predict the output.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Query inputs: as noisy as those of the fit with ``query="noisy"``,
            noiseless ones with ``query="noiseless"``.
        return_std : bool, default=False
            Whether to return the standard deviation of the predicted outputs too.

        Returns
        -------
        y_mean : ndarray of shape (n_samples,)
            Predicted outputs.
        y_std : ndarray of shape (n_samples,)
            Standard deviations of new outputs at these inputs, due to coefficients,
            intercept and noise; only with `return_std`. With unknown `input_noise`
            they allow for exact inputs.
        """
        X = self._check_queries(X)
        mean = X @ self.coef_ + self.intercept_
        if not return_std:
            return mean
        Xc = X - self._x_offset
        # An input that never varied has an infinite deviation, but does not matter at
        # its constant value.
        finite = np.isfinite(self.coef_std_)
        known = Xc[:, finite]
        cov = self.coef_cov_[np.ix_(finite, finite)]
        parameters = np.einsum("ij,ij->i", known @ cov, known)
        parameters = np.where(Xc[:, ~finite].any(axis=1), np.inf, parameters)
        noise = self._query_noise + self._mean_noise
        return mean, np.sqrt(np.maximum(parameters, 0.0) + noise)


def fit_moments(estimator, scatter):
    """Fit an estimator in place to a `Scatter`, without the rows."""
    estimator._validate_params()
    return estimator._fit_moments(from_scatter(scatter))


class JFARegressor(BaseJointFactorRegressor):
    r"""Joint factor analysis regression, fitted by EM.

    Linear regression whose inputs are noisy too, with one hidden input
    :math:`t_{im}` per observed input (Fig. 1b of [1]_):

    .. math::
        y_i = \sum_m z_{im} + \epsilon_{y_i}, \quad
        z_{im} = w_{zm} t_{im} + \epsilon_{z_{im}}, \quad
        x_{im} = w_{xm} t_{im} + \epsilon_{x_{im}}, \quad t_{im} \sim N(0, 1).

    Parameters
    ----------
    input_noise : float or array-like of shape (n_features,), default=None
        Input noise: its share of each input's variance, in
        [0, 1), or its variances [unit of X_j squared]. ``None`` estimates it.
    fit_intercept : bool, default=True
        Whether the means of X and y are free.
    query : {"noisy", "noiseless"}, default="noisy"
        Inputs of `predict`: as noisy as those of the fit, or noiseless.
    max_iter : int, default=20000
        Largest number of iterations.
    tol : float, default=1e-7
        Gain of the log-likelihood per sample and iteration below which the iteration
        stops. The remaining distance may be larger, see Notes.

    Attributes
    ----------
    coef_ : ndarray of shape (n_features,)
        Coefficients that `predict` uses, unit of y / unit of X_j: one of the two below.
    coef_noiseless_ : ndarray of shape (n_features,)
        Coefficients for noiseless queries, w_z / w_x (eq. 29).
    coef_noisy_ : ndarray of shape (n_features,)
        Coefficients for noisy queries, w_z w_x / (w_x^2 + psi_x) (eq. 27).
    coef_std_ : ndarray of shape (n_features,)
        Standard deviations of `coef_`, given the noise variances (for noiseless queries
        with unknown ones, including the difference to exact inputs); infinite for an
        input whose coefficient the data cannot tell from those of others.
    coef_cov_ : ndarray of shape (n_features, n_features)
        Their covariance.
    intercept_ : float
        Intercept of `coef_`.
    input_noise_ : ndarray of shape (n_features,)
        Input-noise variances psi_x (eq. 16), unit of X_j squared.
    output_noise_ : float
        Variance of y given noiseless inputs, psi_y + sum(psi_z), unit of y squared.
    elbo_history_ : ndarray
        Log-likelihood of X and y at each accepted iteration, with all constants.
    n_iter_ : int
        Number of iterations.
    converged_ : bool
        Whether the gain of an iteration fell below `tol`; see Notes.
    statistics_ : Moments
        Count, means and scatter of the rows.
    n_features_in_ : int
        Number of features seen during fit.
    feature_names_in_ : ndarray of shape (n_features,)
        Their names, where X had names that are all strings.

    See Also
    --------
    VBJFARegressor : The same model with priors, which do identify more.
    TotalLeastSquares : Equal noise in inputs and output.

    Notes
    -----
    The likelihood identifies `coef_noisy_`, which is ordinary least squares at its
    maximum, and not the split of an input's variance into signal and noise: that
    depends on the start and the data. Give `input_noise` when you know it.

    A quasi-Newton method climbs the likelihood. The iteration ends where one step gains
    less than `tol`, before the maximum, with known input noise that makes more output
    noise than there is, with fewer samples than features, and for an exact fit. An
    iteration costs O(d^2), whatever the number of samples.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa import JFARegressor
    >>> rng = np.random.default_rng(0)
    >>> t = rng.normal(size=(2000, 2))
    >>> y = t @ [1.0, -2.0] + 0.1 * rng.normal(size=2000)
    >>> X = t + 0.5 * rng.normal(size=t.shape)
    >>> model = JFARegressor(input_noise=[0.25, 0.25]).fit(X, y)
    >>> model.coef_.round(1)  # for inputs as noisy as these
    array([ 0.8, -1.6])
    >>> model.coef_noiseless_.round(1)
    array([ 1., -2.])
    """

    def __init__(
        self,
        *,
        input_noise=None,
        fit_intercept=True,
        query="noisy",
        max_iter=20000,
        tol=1e-7,
    ):
        self.input_noise = input_noise
        self.fit_intercept = fit_intercept
        self.query = query
        self.max_iter = max_iter
        self.tol = tol

    def _fit(self, data):
        noise = resolve_input_noise(self.input_noise, data.active.shape[0])
        return self._fit_independent(data, noise, Prior())


# -- independent latents ---------------------------------------------------------------

# Initial noise share of each input's variance, if it is unknown.
_INITIAL_NOISE = 0.3


def fit_independent(data, prior, *, max_iter, tol):
    """Run the iteration; derive the solution, relevant inputs, and linear models."""
    # Linear models of noisy and of noiseless queries, in standardised units.
    moments = data.moments
    d = moments.xx.shape[0]
    state = start(moments, prior, np.full(d, _INITIAL_NOISE))
    solution = solve(moments, state, prior, max_iter=max_iter, tol=tol)
    state = solution.state
    hidden = expect_hidden(moments, state)
    gain_x = state.w_x_mean**2 > 4 * state.w_x_var
    gain_z = state.w_z_mean**2 > 4 * state.w_z_var
    if prior.ard:
        retained = gain_x & gain_z
        # c = w_z w_x / V, and w_z ~ N(0, 1/alpha): the prior precision of c
        usable = np.maximum(state.w_x_mean**2, VARIANCE_FLOOR)
        precision = state.E_alpha * (usable + state.psi_x) ** 2 / usable
    else:
        retained = state.w_x_mean**2 > VARIANCE_FLOOR
        precision = np.zeros(d)
    cov_noisy = _coefficient_covariance(moments, hidden.y_var, precision)
    if prior.psi_x_fixed is not None:
        retained &= prior.psi_x_fixed < 1.0
    # beta = c V / w_x^2, input by input; an input switched off keeps c's deviation
    lift = np.ones(d)
    w_x2 = state.w_x_mean[retained] ** 2
    lift[retained] = (w_x2 + state.psi_x[retained]) / w_x2
    finite = np.isfinite(np.diagonal(cov_noisy))
    cov = np.where(np.outer(finite, finite), cov_noisy, 0.0) * np.outer(lift, lift)
    cov[np.diag_indices_from(cov)] += np.where(finite, 0.0, np.inf)
    noisy = LinearModel(coefficients_noisy(state), cov_noisy, float(hidden.y_var))
    coef, noise = (
        coefficients_noiseless(state, retained),
        state.psi_y + state.psi_z.sum(),
    )
    open_noise = 0.0
    if prior.psi_x_fixed is None:
        # The inputs may be exact: then y has the model of noisy queries.
        cov += np.outer(coef - noisy.coef, coef - noisy.coef)
        open_noise = max(noisy.noise - noise, 0.0)
    noiseless = LinearModel(coef, cov, float(noise), open_noise)
    return solution, retained, noisy, noiseless


def _coefficient_covariance(moments, s, precision):
    """Covariance (d, d) of the noisy-query coefficients c, of prior precision (d,)."""
    # With z and t integrated out, y | x ~ N(c'x, s), so that c has the precision
    # S_xx / s plus that of its prior. The variational variances, conditional on the
    # private z of each input, would be far too small.
    if np.all(precision > 0):
        half, _ = inverse_factor(moments.S, 1.0 / np.sqrt(precision), s)
        return half @ half.T
    # Without a prior the null space of S_xx has no finite variance: the span's
    # covariance is reported and the affected inputs are marked infinite.
    eigen = scaled_eigen(moments.S / s, scale=1.0)
    cov, lost = eigen.inverse(), eigen.lost(1e-8)
    cov[lost, lost] = np.inf
    return cov
