"""Joint factor analysis regression by expectation-maximisation."""

from sklearn_vbjfa._core._updates import Prior
from sklearn_vbjfa.regression._joint_factor import (
    BaseJointFactorRegressor,
    noise_shares,
    resolve_input_noise,
)


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
        What is known of the input noise: its share of each input's variance, in
        [0, 1), or its variances [unit of X_j squared]. ``None`` estimates it.
    initial_input_noise : float, default=0.3
        Share of each input's variance that is noise at the start of EM; not used
        when `input_noise` is given. See Notes: where it ends means nothing.
    fit_intercept : bool, default=True
        Whether the means of X and y are free.
    query : {"noisy", "noiseless"}, default="noisy"
        Which queries `predict` answers: inputs as noisy as those of the fit, or
        noiseless ones (planned motions).

        .. versionchanged:: 0.2
           The default was ``"noiseless"``.
    solver : {"accelerated", "plain"}, default="accelerated"
        How the likelihood is climbed. ``"plain"`` does the updates of [1]_ as printed,
        one iteration after the other. ``"accelerated"`` corrects them by a quasi-Newton
        method, and the last step goes to the highest likelihood, which is explicit.

        .. versionadded:: 0.2
    max_iter : int, default=20000
        Largest number of iterations.
    tol : float, default=1e-7
        Gain of the log-likelihood per sample and iteration below which the iteration
        stops. What is left may be far more, see Notes.
    forgetting : float, default=1.0
        Weight that what `partial_fit` has seen keeps with each further row, in
        (0, 1]: the memory is ``1 / (1 - forgetting)`` rows long. `fit` does not
        forget.

    Attributes
    ----------
    coef_ : ndarray of shape (n_features,)
        Coefficients that `predict` uses, unit of y / unit of X_j: one of the two below.
    coef_noiseless_ : ndarray of shape (n_features,)
        Coefficients for noiseless queries, w_z / w_x (eq. 29).
    coef_noisy_ : ndarray of shape (n_features,)
        Coefficients for noisy queries, w_z w_x / (w_x^2 + psi_x) (eq. 27).
    coef_std_ : ndarray of shape (n_features,)
        Standard deviations of `coef_`, given the noise variances; infinite for an
        input whose coefficient the data cannot tell from those of others.
    coef_cov_ : ndarray of shape (n_features, n_features)
        Their covariance.
    intercept_, intercept_noiseless_, intercept_noisy_ : float
        Intercepts that go with the coefficient vectors.
    input_noise_ : ndarray of shape (n_features,)
        Input-noise variances psi_x (eq. 16), unit of X_j squared.
    output_noise_ : float
        Variance of y given noiseless inputs, psi_y + sum(psi_z), unit of y squared.
    w_x_mean_, w_z_mean_ : ndarray of shape (n_features,)
        Loadings [unit of X_j], [unit of y].
    psi_y_, psi_z_ : float, ndarray of shape (n_features,)
        The parts of `output_noise_` (eqs. 14, 15).
    elbo_history_ : ndarray
        Log-likelihood of X and y at each iteration that was kept, at most `n_iter_`
        values, with all constants.
    n_iter_ : int
        Number of iterations.
    converged_ : bool
        Whether the gain of an iteration fell below `tol`; see Notes for what is left
        then.
    statistics_ : Moments or None
        Count, means and scatter; None when there were fewer samples than features.
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
    **What is identifiable.** The likelihood depends on the parameters through the
    variances of the inputs, the noisy-query coefficients and the variance of y given
    x: 2d + 1 numbers for 4d + 1 unknowns. `coef_noisy_` is identified, and is ordinary
    least squares at the highest likelihood. The split of an input's variance into
    signal and noise is not identified. The likelihood bounds it only in that the input
    noise, through the coefficients, makes no more output noise than there is; where
    below that it ends depends on the start, the solver and the data (from 0.3, at
    shares between 0 and 1 on the data below). Give `input_noise` when you know it.

    **What converged means.** With ``solver="accelerated"`` the last step goes to the
    highest likelihood, where `coef_noisy_` is least squares to rounding, in inputs of a
    condition number of 2e5 as well. Three cases are left: input noise that is given and
    makes more output noise than there is, fewer samples than features, and an exact
    fit, which has no highest likelihood; then, and with ``solver="plain"``, the
    iteration ends where one gains less than `tol`. Along flat directions EM creeps: on
    1000 samples of 5 inputs it stopped up to 0.2, 3, 20 and 2 standard errors from
    least squares at condition numbers of 10, 1e2, 1e3 and 2e5, and had converged by its
    own rule in 38 of 40 cases (``tests/benchmarks/bench_likelihood.py``).

    An iteration costs O(d^2), whatever the number of samples, on sufficient
    statistics; with more features than samples O(n d) on the data.

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
        initial_input_noise=0.3,
        fit_intercept=True,
        query="noisy",
        solver="accelerated",
        max_iter=20000,
        tol=1e-7,
        forgetting=1.0,
    ):
        self.input_noise = input_noise
        self.initial_input_noise = initial_input_noise
        self.fit_intercept = fit_intercept
        self.query = query
        self.solver = solver
        self.max_iter = max_iter
        self.tol = tol
        self.forgetting = forgetting

    def _fit(self, data):
        noise = resolve_input_noise(self.input_noise, data.active.shape[0])
        fixed = noise_shares(noise, data, self._feature_labels())
        self._fit_independent(data, Prior(psi_x_fixed=fixed), self.initial_input_noise)
        return self
