"""Variational Bayesian joint factor analysis regression."""

import numpy as np

from sklearn_vbjfa._core._updates import Prior
from sklearn_vbjfa.regression._base import StrOptions
from sklearn_vbjfa.regression._correlated import fit_correlated
from sklearn_vbjfa.regression._input_noise import (
    resolve_cross_noise,
    resolve_input_noise,
)
from sklearn_vbjfa.regression._joint_factor import BaseJointFactorRegressor

# The default prior on the input noise: inverse-gamma on each variance psi_x with its
# mode at this share of the input's own variance, and the weight of this share of the
# samples. A share of a share: free of units, and no stronger or weaker for more data.
NOISE_PRIOR_MODE = 0.2
NOISE_PRIOR_WEIGHT = 0.1


class VBJFARegressor(BaseJointFactorRegressor):
    r"""Variational Bayesian joint factor analysis regression (VB-JFA).

    Linear regression with noise in inputs and output, automatic relevance
    determination, and coefficients for noiseless queries [1]_.

    For predictions from inputs as noisy as those of the fit, the default, this is
    Bayesian regression on the inputs as they are: as good as least squares with many
    rows, where noise in the inputs is no reason to do anything else, and better where
    inputs are many, correlated or irrelevant. What goes beyond that are queries
    without noise: motions that are planned, instruments better than those of the fit,
    coefficients that mean something (a mass, a dose). They need the input noise. Give
    it (`input_noise`) where you know it or can measure it (`replicate_noise`); without,
    the data only bound it, and the intervals say how much that leaves open.

    Parameters
    ----------
    latent : {"auto", "independent", "correlated"}, default="auto"
        ``"independent"``: the paper's model, one hidden input of its own for each
        observed input. ``"correlated"``: the hidden inputs share a full covariance.
        ``"auto"``: correlated; independent with ``prior="paper"``, and with fewer
        samples than inputs and more than 256 of these.
    prior : {"noise", "paper"}, default="noise"
        For independent latents: ``"paper"`` is the model of the paper to the letter
        (one precision alpha_m for both w_zm and w_xm, no prior on the input noise);
        ``"noise"`` puts alpha_m on w_zm alone and a weak prior on the input noise,
        an inverse-gamma with its mode at 0.2 of the input's variance and the weight
        of 0.1 of the samples. See Notes. Not used with correlated latents.
    input_noise : float or array-like, default=None
        What is known of the input noise: its share of each input's variance, in
        [0, 1), its variances, shape (n_features,) [unit of X_j squared], or
        (correlated latents) its covariance, shape (n_features, n_features), or what
        `replicate_noise` returns. ``None``: unknown, see Notes.
    input_output_noise : array-like of shape (n_features,), default=None
        Covariance of the noise of each input with the noise of y [unit of X_j times
        unit of y], for correlated latents and an `input_noise` that is known: an output
        that was computed from the same noisy readings, such as the torque of a position
        controller. None is zero.
    fit_intercept : bool, default=True
        Whether the means of X and y are free.
    query : {"noisy", "noiseless"}, default="noisy"
        Which queries `predict` answers: inputs as noisy as those of the fit, or
        noiseless ones (planned motions). Intervals for noiseless queries with unknown
        `input_noise` hold whatever that noise is, and are up to 3 times as wide as with
        known noise (8 times in 5000 rows). Rows must be independent.
    max_iter : int, default=20000
        Largest number of iterations.
    tol : float, default=1e-7
        Gain of the bound per sample below which the iteration has converged. With
        correlated latents it goes on from there to the fixed point, which a few
        extrapolated steps reach.

    Attributes
    ----------
    coef_ : ndarray of shape (n_features,)
        Coefficients that `predict` uses, unit of y / unit of X_j: `coef_noisy_` or
        `coef_noiseless_`, by `query`.
    coef_noiseless_ : ndarray of shape (n_features,)
        Coefficients for noiseless queries (eq. 29); zero for inputs that are not
        relevant, where inputs are selected (see Notes).
    coef_noisy_ : ndarray of shape (n_features,)
        Coefficients for noisy queries (eq. 27).
    coef_std_ : ndarray of shape (n_features,)
        Posterior standard deviations of `coef_`; infinite for an input that never
        varies. For noiseless queries and correlated latents they hold the uncertainty
        of the input noise: that of its estimate (`replicate_noise`), or both ends of
        what the data permit, see `query`. With independent latents they are given the
        noise.
    coef_cov_ : ndarray of shape (n_features, n_features)
        Their posterior covariance.
    intercept_ : float
        Intercept that goes with `coef_`.
    input_noise_ : ndarray of shape (n_features,) or (n_features, n_features)
        Input-noise variances, or covariance with correlated latents: where it is
        unknown, the middle of what the data permit.
    output_noise_ : float
        Variance of y given noiseless inputs, unit of y squared.
    alpha_ : ndarray of shape (n_features,)
        Posterior means of the ARD precisions, 1 / unit of y squared; infinite for
        an input that never varies. With at most two samples for each input, correlated
        latents and an `input_noise` that is known, all inputs share one.
    relevant_ : ndarray of shape (n_features,), bool
        Inputs that matter. Independent latents: the posterior means of both loadings
        are more than two posterior standard deviations away from zero. Correlated
        latents: the coefficient of an ARD regression on the noisy inputs is. Of inputs
        that are exact combinations of others only the generators can be relevant;
        exact copies share one coefficient and are relevant together.
    elbo_history_ : ndarray
        The bound at each iteration that was kept, at most `n_iter_` values, with all
        constants of the likelihood: of X and y with independent latents, of y given X
        with correlated ones.
    n_iter_ : int
        Number of iterations of the fit behind `coef_`.
    converged_ : bool
        Whether the gain fell below `tol`.
    statistics_ : Moments or None
        Count, means and scatter; None when there were fewer samples than features.
    n_features_in_ : int
        Number of features seen during fit.
    feature_names_in_ : ndarray of shape (n_features,)
        Their names, where X had names that are all strings.

    See Also
    --------
    JFARegressor : The same model by EM, without priors.
    replicate_noise : The input noise from repeated measurements.
    sklearn.linear_model.ARDRegression : Noiseless inputs.

    Notes
    -----
    **What is identifiable.** Second moments fix the coefficients for noisy queries.
    How the variance of an input splits into signal and noise they do not say; they
    only bound the noise from above. So the split comes from `input_noise` if given,
    else from a prior, which is documented and free of units:

    - Correlated latents: all relevant inputs have the same fraction f of noise in
      their variances. With R the correlations of the inputs and :math:`b_0` the
      coefficients for noisy queries, :math:`(R - f I) b_f = R b_0` for every f that
      the data admit, from zero to the smallest eigenvalue of the correlations of the
      inputs given the output; an input is taken to be signal for two thirds at least.
      `coef_noiseless_` is that of the middle, and `coef_cov_` the second moment about
      it over both ends, all inputs switched on, which more rows do not reduce. Exact
      inputs thus get coefficients that are a little too large: give
      ``input_noise=0`` if you know that they are exact.
    - Independent latents with ``prior="noise"``: an inverse-gamma on each psi_x with
      its mode at 0.2 of the input's variance and the weight of 0.1 of the samples.
    - ``prior="paper"``: the starting point and the shared alpha_m, under which both
      loadings of a redundant input shrink at different rates; their ratio then means
      nothing, and the input is reported as not relevant with the coefficient zero.

    **Selection.** For noiseless queries of correlated latents, inputs that are exact
    combinations of others are reduced to those that generate them, only relevant inputs
    are fitted, and their coefficients share one precision. This is left out if
    `input_noise` is zero (Bayesian ARD regression on all inputs) or a full covariance
    (dependencies are then part of what is known), and with hardly more samples than
    inputs.

    **Noisy queries** need no split. With a selection they are answered by the mean of
    two Bayesian regressions on the inputs as they are, one with a precision for each
    input (automatic relevance determination) and one with a precision for all; which of
    them suits depends on how many inputs matter.

    Noise that is independent from input to input is not so among inputs that are sums
    of each other. Exactly dependent inputs are therefore reduced to the ones that
    generate the others with non-negative weights, where these are unique, else to
    the subset of largest volume.

    Known noise: the correlated model fits the second moments of any data of full
    rank exactly, so its estimates are consistent; with zero noise it is Bayesian
    linear regression with automatic relevance determination.

    An iteration costs O(d^2) with independent latents (O(n d) on the data with more
    features than samples), O(d^3) with correlated ones, whatever the number of
    samples.

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

    def _accepts_data_moments(self):
        return self.latent != "correlated"

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
        if self.prior == "paper":
            return "independent"
        return "independent" if data.moments.S is None else "correlated"

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
        solution = result.noiseless_solution
        if self.query == "noisy":
            solution = result.noisy_solution
        self._set_loop_attributes(solution, data, np.log(data.y_scale))
        self._set_linear_models(result.noisy, result.noiseless, data)
        unit = np.outer(data.x_scale, data.x_scale)
        self.input_noise_ = np.zeros((d, d))
        self.input_noise_[np.ix_(data.active, data.active)] = result.psi * unit
        self.alpha_ = data.expand(result.alpha / data.y_scale**2, fill=np.inf)
        self.relevant_ = data.expand(result.relevant).astype(bool)
        return self
