"""Variational Bayesian joint factor analysis regression."""

import numpy as np

from sklearn_vbjfa._core._updates import Prior
from sklearn_vbjfa.regression._base import (
    StrOptions,
    resolve_cross_noise,
    resolve_input_noise,
)
from sklearn_vbjfa.regression._correlated import fit_correlated
from sklearn_vbjfa.regression._joint_factor import BaseJointFactorRegressor

# The default prior on the input noise: inverse-gamma on each variance psi_x with its
# mode at this share of the input's own variance, and the weight of this share of the
# samples. A share of a share: free of units, and no stronger or weaker for more data.
NOISE_PRIOR_MODE = 0.2
NOISE_PRIOR_WEIGHT = 0.1
# Up to this many features the model with correlated latents, whose iterations cost the
# cube of their number, takes at most some seconds with fewer samples than features.
CUBIC_FEATURES = 128


class VBJFARegressor(BaseJointFactorRegressor):
    r"""Variational Bayesian joint factor analysis regression (VB-JFA).

    Linear regression with noise in inputs and output, automatic relevance
    determination, and coefficients for noiseless queries [1]_.

    With the default ``query="noisy"`` this is Bayesian regression for predictions from
    inputs that are as noisy as the fitted ones. It equals least squares with many rows,
    and is better with many, correlated or irrelevant inputs. With fewer rows than
    inputs, more than 128, it assumes that few matter; if all do, use ridge regression.
    ``query="noiseless"`` corrects the bias by input noise, for planned motions, better
    instruments and coefficients with a meaning. It needs the size of the noise
    (`input_noise`, `replicate_noise`); without it the data only bound the coefficients.

    Parameters
    ----------
    latent : {"auto", "independent", "correlated"}, default="auto"
        ``"independent"``: the model of the paper, one latent input for each observed
        input. ``"correlated"``: the latent inputs have a full covariance. ``"auto"``:
        correlated; independent with ``prior="paper"``, and with fewer samples than
        inputs and more than 128 inputs.
    prior : {"noise", "paper"}, default="noise"
        Prior of independent latent inputs. ``"paper"``: one precision alpha_m for both
        loadings w_zm and w_xm, no prior on the input noise. ``"noise"``: alpha_m for
        w_zm alone, and an inverse-gamma prior on the input noise with its mode at 0.2
        of the variance of the input and the weight of 0.1 of the samples. Not used with
        correlated latent inputs.
    input_noise : float or array-like, default=None
        Input noise: its share of the variance of each input in [0, 1), its variances of
        shape (n_features,) [unit of X_j squared], or, with correlated latent inputs,
        its covariance of shape (n_features, n_features) or the result of
        `replicate_noise`. None: unknown, see Notes.
    input_output_noise : array-like of shape (n_features,), default=None
        Covariance of the noise of each input with that of y [unit of X_j times unit of
        y], for correlated latent inputs and known `input_noise`. An example is the
        torque that a position controller computes from noisy readings. None is zero.
    fit_intercept : bool, default=True
        If False, X and y are not centred.
    query : {"noisy", "noiseless"}, default="noisy"
        Inputs of `predict`: as noisy as those of the fit, or noiseless. For noiseless
        queries with unknown `input_noise` the intervals cover all admissible noise of
        the same fraction in each input. Rows must be independent.
    max_iter : int, default=20000
        Maximum number of iterations.
    tol : float, default=1e-7
        Increase of the bound per sample below which the iteration has converged.

    Attributes
    ----------
    coef_ : ndarray of shape (n_features,)
        Coefficients of `predict` [unit of y / unit of X_j]: `coef_noisy_` or
        `coef_noiseless_`, see `query`.
    coef_noiseless_ : ndarray of shape (n_features,)
        Coefficients for noiseless queries (eq. 29); zero for inputs that are not
        selected.
    coef_noisy_ : ndarray of shape (n_features,)
        Coefficients for noisy queries (eq. 27).
    coef_std_ : ndarray of shape (n_features,)
        Posterior standard deviations of `coef_`; infinite for a constant input. For
        noiseless queries they include the uncertainty of the input noise. Too small if
        all coefficients are within the noise of least squares and samples are few, as
        in Bayesian ridge regression; with independent latent inputs and known noise
        they are valid for relevant inputs alone.
    coef_cov_ : ndarray of shape (n_features, n_features)
        Posterior covariance of `coef_`.
    intercept_ : float
        Intercept of `coef_`.
    input_noise_ : ndarray of shape (n_features,) or (n_features, n_features)
        Variances of the input noise, or its covariance with correlated latent inputs;
        if unknown, the middle of the admissible range.
    output_noise_ : float
        Variance of y given noiseless inputs [unit of y squared]; biased if it is small
        relative to the noise of many inputs.
    alpha_ : ndarray of shape (n_features,)
        Posterior means of the precisions [1 / unit of y squared]; infinite for a
        constant input.
    relevant_ : ndarray of shape (n_features,), bool
        Relevant inputs. Independent latent inputs: both loadings exceed two posterior
        standard deviations. Correlated latent inputs: the coefficient of an ARD
        regression on the noisy inputs does. Of exactly dependent inputs only the
        generators can be relevant; exact copies share one coefficient.
    elbo_history_ : ndarray
        The bound at each accepted iteration, at most `n_iter_` values: of X and y with
        independent latent inputs, of y given X with correlated ones.
    n_iter_ : int
        Number of iterations.
    converged_ : bool
        Whether the increase fell below `tol`.
    statistics_ : Moments
        Count, means and scatter of the rows.
    n_features_in_ : int
        Number of features seen during fit.
    feature_names_in_ : ndarray of shape (n_features,)
        Names of the features, if X has names that are all strings.

    See Also
    --------
    JFARegressor : The same model by EM, without priors.
    replicate_noise : Estimate the input noise from repeated measurements.
    sklearn.linear_model.ARDRegression : Regression with noiseless inputs.

    Notes
    -----
    The second moments determine the coefficients for noisy queries. They only bound the
    split of the variance of an input into signal and noise, which follows from
    `input_noise` if given, and otherwise from a prior:

    - Correlated latent inputs: all relevant inputs have the same fraction of noise,
      from zero to the smallest eigenvalue of the correlations of the inputs given the
      output, at most a third. `coef_noiseless_` is the middle, and `coef_cov_` the
      second moment about it over both ends, which more rows do not reduce. If the
      inputs are exact, pass ``input_noise=0``.
    - Independent latent inputs: the inverse-gamma prior; with ``prior="paper"`` the
      starting point and the shared alpha_m.

    For noiseless queries of correlated latent inputs only relevant inputs are fitted,
    unless `input_noise` is zero or a full covariance, or samples are few. Noisy queries
    are then answered by the mean of two regressions on all inputs, one with a precision
    for each input and one with a common precision (``docs/theory.rst``).

    An iteration costs O(d^2) with independent latent inputs and O(d^3) with correlated
    ones, for any number of samples.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa import VBJFARegressor
    >>> rng = np.random.default_rng(0)
    >>> t = rng.normal(size=(2000, 3))
    >>> y = t @ [1.0, -2.0, 0.0] + 0.1 * rng.normal(size=2000)
    >>> X = t + 0.5 * rng.normal(size=t.shape)
    >>> model = VBJFARegressor(input_noise=[0.25, 0.25, 0.25]).fit(X, y)
    >>> model.coef_.round(1)  # for inputs as noisy as these
    array([ 0.8, -1.6, -0. ])
    >>> model.coef_noiseless_.round(1)
    array([ 1., -2.,  0.])
    >>> model.relevant_
    array([ True,  True, False])
    """

    _parameter_constraints: dict = {  # noqa: RUF012
        **BaseJointFactorRegressor._parameter_constraints,
        "latent": [StrOptions({"auto", "independent", "correlated"})],
        "prior": [StrOptions({"noise", "paper"})],
        "input_output_noise": [None, "array-like"],
    }

    def __init__(
        self,
        *,
        latent="auto",
        prior="noise",
        input_noise=None,
        input_output_noise=None,
        fit_intercept=True,
        query="noisy",
        max_iter=20000,
        tol=1e-7,
    ):
        self.latent = latent
        self.prior = prior
        self.input_noise = input_noise
        self.input_output_noise = input_output_noise
        self.fit_intercept = fit_intercept
        self.query = query
        self.max_iter = max_iter
        self.tol = tol

    def _fit(self, data):
        noise = resolve_input_noise(self.input_noise, data.active.shape[0])
        if self._resolve_latent(data) == "correlated":
            return self._fit_correlated(data, noise)
        if self.input_output_noise is not None:
            raise ValueError(
                "input_output_noise needs correlated latents: set "
                'latent="correlated", or leave it out.'
            )
        weight = 0.0
        if self.prior == "noise" and noise is None:
            weight = NOISE_PRIOR_WEIGHT * data.moments.n
        prior = Prior(
            ard=True,
            coupled=self.prior == "paper",
            psi_x_weight=weight,
            psi_x_mode=np.full(data.x_scale.size, NOISE_PRIOR_MODE),
        )
        return self._fit_independent(data, noise, prior)

    def _resolve_latent(self, data):
        if self.latent != "auto":
            return self.latent
        d = data.x_scale.size
        few = data.moments.n <= d and d > CUBIC_FEATURES
        return "independent" if few or self.prior == "paper" else "correlated"

    def _fit_correlated(self, data, noise):
        d = data.active.shape[0]
        cross = resolve_cross_noise(self.input_output_noise, noise, data)
        if data.is_degenerate:
            self._fit_constant(data)
            self.input_noise_ = np.zeros((d, d))
            return self
        result = fit_correlated(
            data,
            noise,
            self._feature_labels(),
            max_iter=self.max_iter,
            tol=self.tol,
            cross=cross,
            dof=getattr(self.input_noise, "dof", np.inf),
        )
        solution = getattr(result, f"{self.query}_solution")
        self._set_loop_attributes(solution, data, np.log(data.y_scale))
        self._set_linear_models(result.noisy, result.noiseless, data)
        unit = np.outer(data.x_scale, data.x_scale)
        self.input_noise_ = np.zeros((d, d))
        self.input_noise_[np.ix_(data.active, data.active)] = result.psi * unit
        alpha = result.noisy_solution.state.E_alpha
        self.alpha_ = data.expand(alpha / data.y_scale**2, fill=np.inf)
        self.relevant_ = data.expand(result.relevant).astype(bool)
        return self
