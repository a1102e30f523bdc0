"""Variational Bayesian joint factor analysis regression.

The estimator, and below it how the correlated-latent model is fitted: dependencies,
relevance, noise. Tags such as [C18] are equations of the guide.
"""

import warnings
from dataclasses import dataclass
from functools import partial
from numbers import Real

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core._correlated import (
    CorrelatedSolution,
    posterior_covariance,
    solve_correlated,
)
from sklearn_vbjfa._core._linear_systems import find_dependencies
from sklearn_vbjfa._core._updates import LinearModel, Prior
from sklearn_vbjfa.regression._base import Interval, StrOptions
from sklearn_vbjfa.regression._joint_factor import (
    BaseJointFactorRegressor,
    noise_shares,
    resolve_cross_noise,
    resolve_input_noise,
    standard_noise,
)

# An input is relevant when its coefficient is more than this many posterior standard
# deviations away from zero.
RELEVANT_DEVIATIONS = 2.0
# Largest fraction of an input's variance that the prior takes for noise: an input that
# someone measured in order to predict with it is signal for two thirds at least.
LARGEST_FRACTION = 1 / 3


# The default prior on the input noise: inverse-gamma on each variance psi_x with its
# mode at this share of the input's own variance, and the weight of this share of the
# samples. A share of a share: free of units, and no stronger or weaker for more data.
NOISE_PRIOR_MODE = 0.2
NOISE_PRIOR_WEIGHT = 0.1

# Samples per input from which on each input has a precision of its own, and second
# moments say something of the inputs' noise.
SAMPLES_PER_INPUT = 2


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
        ``"auto"``: correlated with more samples than inputs, else (and with
        ``prior="paper"``) independent.
    selection : "auto" or bool, default="auto"
        Correlated latents and noiseless queries only. Whether inputs that are exact
        combinations of others are reduced to those that generate them, only relevant
        inputs are fitted, and their coefficients share one precision. Noisy queries are
        then answered by all inputs, see Notes. ``"auto"``: yes, unless `input_noise`
        is zero (then this is Bayesian ARD regression on all inputs) or a full
        covariance (then dependencies are part of what is known). ``False`` takes inputs
        of unknown noise as exact, and its intervals say nothing of that noise.
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

        .. versionadded:: 0.2
    initial_input_noise : float, default=0.3
        Share of each input's variance that is noise at the start; not used when
        `input_noise` is given.
    ard_shape, ard_rate : float, default=1e-6
        Gamma prior of the precisions alpha, for standardised X and y.
    fit_intercept : bool, default=True
        Whether the means of X and y are free.
    query : {"noisy", "noiseless"}, default="noisy"
        Which queries `predict` answers: inputs as noisy as those of the fit, or
        noiseless ones (planned motions). Intervals for noiseless queries whose
        `input_noise` is unknown are meant to hold whatever it is, and are wide. Of
        eight inputs, two with correlation 0.95, nominal 90 % held 89 to 100 % of the
        coefficients that are not zero in 600 rows, and 81 to 97 % in 80, least with
        noisy inputs and a signal-to-noise ratio of 30; of new outputs 90 to 100 %. They
        are up to 3 times as wide as with known noise, in 5000 rows 8 times, and those
        of outputs up to 2.4 times. Rows must be independent: with inputs and residuals
        AR(0.9) they held 60 to 96 % of the coefficients (noisy queries 56 to 65, known
        noise 67 to 92).

        .. versionchanged:: 0.2
           The default was ``"noiseless"``, which is worse than least squares wherever
           queries are as noisy as the data, and with them in cross-validation.
    solver : {"accelerated", "plain"}, default="accelerated"
        How the bound is climbed. ``"plain"`` does the updates as printed (in [1]_, and
        in the guide for correlated latents), one iteration after the other.

        .. versionadded:: 0.2
    max_iter : int, default=20000
        Largest number of iterations.
    tol : float, default=1e-7
        Gain of the bound per sample below which the iteration has converged. With
        correlated latents it goes on from there to the fixed point, which a few
        extrapolated steps reach.
    forgetting : float, default=1.0
        Weight that what `partial_fit` has seen keeps with each further row, in
        (0, 1]: the memory is ``1 / (1 - forgetting)`` rows long. `fit` does not
        forget.

    Attributes
    ----------
    coef_ : ndarray of shape (n_features,)
        Coefficients that `predict` uses, unit of y / unit of X_j: `coef_noisy_` or
        `coef_noiseless_`, by `query`.
    coef_noiseless_ : ndarray of shape (n_features,)
        Coefficients for noiseless queries (eq. 29); zero for inputs that are not
        relevant (with `selection`).
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
    intercept_, intercept_noiseless_, intercept_noisy_ : float
        Intercepts that go with the coefficient vectors.
    input_noise_ : ndarray of shape (n_features,) or (n_features, n_features)
        Input-noise variances, or covariance with correlated latents: where it is
        unknown, the middle of what the data permit.
    output_noise_ : float
        Variance of y given noiseless inputs, unit of y squared.
    alpha_ : ndarray of shape (n_features,)
        Posterior means of the ARD precisions, 1 / unit of y squared; infinite for
        an input that never varies. With hardly more samples than inputs, and correlated
        latents, all inputs share one.
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
    basis_rule_ : {"full rank", "rays", "volume", "all inputs"}
        How the generators of exactly dependent inputs were found; correlated latents
        only.
    heywood_ : ndarray of shape (n_features,), bool
        Inputs whose estimated noise went to zero.
    w_x_mean_, w_x_var_, w_z_mean_, w_z_var_ : ndarray of shape (n_features,)
        Posterior means and variances of the loadings (eqs. 8-11); independent
        latents only.
    psi_y_, psi_z_ : float, ndarray of shape (n_features,)
        The parts of `output_noise_` (eqs. 14, 15); independent latents only. The
        variational posterior moves all noise from psi_y to psi_z little by little:
        only their sum means something.
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

    **Noisy queries** need no split. With `selection` they are answered by the mean of
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
        "selection": [StrOptions({"auto"}), "boolean"],
        "prior": [StrOptions({"noise", "paper"})],
        "ard_shape": [Interval(Real, 0, None, closed="neither")],
        "ard_rate": [Interval(Real, 0, None, closed="neither")],
    }

    def __init__(
        self,
        *,
        latent="auto",
        selection="auto",
        prior="noise",
        input_noise=None,
        input_output_noise=None,
        initial_input_noise=0.3,
        ard_shape=1e-6,
        ard_rate=1e-6,
        fit_intercept=True,
        query="noisy",
        solver="accelerated",
        max_iter=20000,
        tol=1e-7,
        forgetting=1.0,
    ):
        self.latent = latent
        self.selection = selection
        self.prior = prior
        self.input_noise = input_noise
        self.input_output_noise = input_output_noise
        self.initial_input_noise = initial_input_noise
        self.ard_shape = ard_shape
        self.ard_rate = ard_rate
        self.fit_intercept = fit_intercept
        self.query = query
        self.solver = solver
        self.max_iter = max_iter
        self.tol = tol
        self.forgetting = forgetting

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
        fixed = noise_shares(noise, data, self._feature_labels())
        weight = 0.0
        if self.prior == "noise" and fixed is None:
            weight = NOISE_PRIOR_WEIGHT * data.moments.n
        prior = Prior(
            ard=True,
            coupled=self.prior == "paper",
            ard_shape=self.ard_shape,
            ard_rate=self.ard_rate,
            psi_x_fixed=fixed,
            psi_x_weight=weight,
            psi_x_mode=np.full(data.x_scale.size, NOISE_PRIOR_MODE),
        )
        return self._fit_independent(data, prior, self.initial_input_noise)

    def _resolve_latent(self, data):
        if self.latent != "auto":
            return self.latent
        if self.prior == "paper":
            return "independent"
        gram = data.moments.S is not None
        more = data.moments.n > data.x_scale.size
        return "correlated" if more and gram else "independent"

    @staticmethod
    def _enough_samples(data):
        return data.moments.n > SAMPLES_PER_INPUT * data.x_scale.size

    def _resolve_selection(self, noise, data):
        if not isinstance(self.selection, str):
            return bool(self.selection)
        if noise is None:
            # With hardly more samples than inputs the smallest eigenvalues, which bound
            # the noise, are those of chance: regression on inputs taken as exact.
            return self._enough_samples(data)
        # Zero noise is Bayesian ARD regression; a covariance is taken at its word.
        return np.ndim(noise) < 2 and bool(np.any(noise))

    def _fit_correlated(self, data, noise):
        d = data.active.shape[0]
        cross = resolve_cross_noise(self.input_output_noise, noise, data)
        if data.is_degenerate:
            self._fit_constant(data)
            self.input_noise_ = np.zeros((d, d))
            return self
        solve = partial(
            solve_correlated,
            # Hardly more samples than inputs do not tell a precision for each.
            common=not self._enough_samples(data),
            ard_shape=self.ard_shape,
            ard_rate=self.ard_rate,
            max_iter=self.max_iter,
            tol=self.tol,
            accelerate=self.solver == "accelerated",
        )
        result = fit_correlated(
            data,
            noise,
            self._feature_labels(),
            solve,
            select=self._resolve_selection(noise, data),
            cross=cross,
            dof=getattr(self.input_noise, "dof", np.inf),
        )
        y2 = data.y_scale**2
        solution = result.noiseless_solution
        if self.query == "noisy":
            solution = result.noisy_solution
        self._set_loop_attributes(solution, data, np.log(data.y_scale))
        self._set_linear_models(result.noisy, result.noiseless, data)
        unit = np.outer(data.x_scale, data.x_scale)
        self.input_noise_ = np.zeros((d, d))
        self.input_noise_[np.ix_(data.active, data.active)] = result.psi * unit
        self.alpha_ = data.expand(result.alpha / y2, fill=np.inf)
        self.relevant_ = data.expand(result.relevant).astype(bool)
        self.heywood_ = np.zeros(d, dtype=bool)
        self.basis_rule_ = result.rule
        return self


@dataclass(frozen=True, kw_only=True)
class CorrelatedFit:
    """Solutions in standardised units, spread over all active columns."""

    # `noisy` and `noiseless` are the linear models for the two kinds of queries, with
    # the solutions that they come from; alpha, relevant (d,) and psi (d, d) are the
    # precisions, the relevant inputs and the input noise.

    noisy: LinearModel
    noiseless: LinearModel
    noisy_solution: CorrelatedSolution
    noiseless_solution: CorrelatedSolution
    alpha: np.ndarray
    relevant: np.ndarray
    psi: np.ndarray
    rule: str


def largest_noise_fraction(R, r):
    """Largest input-noise fraction that correlations R (d, d), r (d,) admit, [C18]."""
    given_output = R - np.outer(r, r)
    smallest = linalg.eigvalsh(given_output, subset_by_index=[0, 0])[0]
    return float(min(LARGEST_FRACTION, max(smallest, 0.0)))  # [C18]


def fit_correlated(data, noise, labels, solve, *, select, cross=None, dof=np.inf):
    """Fit the model to standardised data and its moments as a scatter matrix."""
    # noise: the user's, validated; None estimates it, `dof` are the degrees of freedom
    # with which it was; cross (d,): its covariance with that of y. select, for
    # noiseless queries: reduce exactly dependent inputs to their generators and fit
    # only relevant ones, with one precision in common; noisy queries are then answered
    # by all inputs as they are, see `_average`.
    m = data.moments
    d = m.xx.size
    psi = standard_noise(noise, data)
    if psi is not None:
        _warn_excess(m.S / m.n, psi, data, labels)
    if not select:
        known = np.zeros((d, d)) if psi is None else psi
        return _fit_all(m, known, partial(solve, cross=cross), dof)
    R, r = m.S / m.n, m.xy / m.n
    as_they_are = solve(m, np.zeros((d, d)))
    found = find_dependencies(R)
    basis = found.basis
    kept = _relevant_inputs(m, basis, as_they_are, solve)
    at = basis[kept]
    given = psi is not None
    if not given:
        psi = np.zeros((d, d))
        psi[at, at] = 0.5 * largest_noise_fraction(R[np.ix_(at, at)], r[at])
    if cross is None:
        cross = np.zeros(d)

    def solve_of(chosen, psi):
        return solve(m.columns(chosen), psi, common=True, cross=cross[chosen])

    solution = solve_of(at, psi[np.ix_(at, at)])
    coef = np.zeros(basis.size)
    coef[kept] = solution.state.beta_mean
    # The inputs that were switched off belong to what is not known.
    of_basis = m.columns(basis)
    if given:
        ends = [psi[np.ix_(basis, basis)]]
    else:
        ends = [f * np.eye(basis.size) for f in _admissible_ends(of_basis)]
    cov = sum(
        _uncertainty(of_basis, end, coef, solve_of(basis, end), dof) for end in ends
    ) / len(ends)  # [C20]
    spread = _spread(R, basis, found.copies)
    relevant = np.zeros(d, dtype=bool)
    relevant[np.concatenate([found.copies[k] for k in np.flatnonzero(kept)])] = True
    noisy = _average(m, as_they_are, solve)
    noise = _output_noise(psi[np.ix_(at, at)], solution)
    return CorrelatedFit(
        noisy=noisy,
        noiseless=LinearModel(
            coef=spread @ coef,
            cov=spread @ cov @ spread.T,
            noise=noise,
            # Of exact inputs, the other end, y has the noise that it has of noisy ones.
            open_noise=0.0 if given else max(noisy.noise - noise, 0.0),
        ),
        noisy_solution=as_they_are,
        noiseless_solution=solution,
        alpha=as_they_are.state.E_alpha,
        relevant=relevant,
        psi=psi,
        rule=found.rule,
    )


def _fit_all(m, psi, solve, dof=np.inf):
    """Fit all inputs with a known noise covariance (d, d), for both queries."""
    solution = solve(m, psi)
    state, latent = solution.state, solution.latent
    in_common = _in_common(m, psi, solution, solve)
    cov = _uncertainty(m, psi, state.beta_mean, in_common, dof)
    noiseless = LinearModel(
        coef=state.beta_mean, cov=cov, noise=_output_noise(psi, solution)
    )
    noisy = noiseless
    if not latent.exact:
        noisy = _noisy_model(m, solution, solve)
    variance = np.diagonal(posterior_covariance(m.n, psi, solution, dof))
    return CorrelatedFit(
        noisy=noisy,
        noiseless=noiseless,
        noisy_solution=solution,
        noiseless_solution=solution,
        alpha=state.E_alpha,
        relevant=state.beta_mean**2 > RELEVANT_DEVIATIONS**2 * variance,
        psi=psi,
        rule="all inputs",
    )


def _in_common(m, psi, solution, solve):
    """Solution with one precision in common, which `solution` may be already."""
    if solve.keywords["common"]:
        return solution
    return solve(m, psi, common=True)


def _uncertainty(m, psi, coef, in_common, dof=np.inf):
    """Second moment (d, d) about `coef` of the posterior with one common precision."""
    # A posterior under automatic relevance determination takes the precisions for
    # known: of a coefficient that it has switched off, or nearly, it says that it is
    # zero. One precision, known from all coefficients together, does not. What both
    # disagree in belongs to what is not known.
    cov = posterior_covariance(m.n, psi, in_common, dof)
    return cov + _square(in_common.state.beta_mean - coef)


def _noisy_model(m, solution, solve):
    """Model of y given noisy inputs: c = H'beta, its variance v and uncertainty."""
    # v is psi_y + beta'P beta, less what noise of the inputs does to y directly. That
    # of c is what a regression on the inputs as they are
    # leaves open, see `_uncertainty`.
    beta, latent = solution.beyond, solution.latent
    coef = latent.H.T @ beta + solution.direct  # [C5]
    exact = np.zeros_like(m.S)
    in_common = solve(m, exact, common=True)
    return LinearModel(
        coef=coef,
        cov=_uncertainty(m, exact, coef, in_common),
        noise=solution.state.psi_y + beta @ latent.P @ beta,  # [C5]
    )


def _output_noise(psi, solution):
    """Variance of y given noiseless inputs."""
    b = solution.direct
    return solution.state.psi_y + float(b @ psi @ b)


def _square(x):
    return np.outer(x, x)


def _admissible_ends(m):
    """Smallest and largest fraction of noise, f of [C19], that moments `m` admit."""
    n, d = m.n, m.xx.size
    R, r = m.S / n, m.xy / n
    # The smallest eigenvalue of n rows is too small by (n - d) / n in the mean, for d
    # coefficients were fitted to find it. Beyond that of R there is no signal left.
    largest = largest_noise_fraction(R, r) * n / max(n - d, 1)
    no_signal = max(float(linalg.eigvalsh(R, subset_by_index=[0, 0])[0]), 0.0)
    return 0.0, min(largest, LARGEST_FRACTION, no_signal)


def _average(m, solution, solve):
    """Answer to noisy queries: the mean of two regressions on the noisy inputs."""
    # One gives each input a precision of its own, which suits few relevant inputs;
    # the other one precision to all, which suits many. Nothing tells beforehand which
    # suits; their mean is nearly as good as the better one, and half of what they
    # differ in is not known.
    exact = np.zeros_like(m.S)
    other = _in_common(m, exact, solution, solve)
    both = [one.state for one in (solution, other)]
    coef = 0.5 * sum(state.beta_mean for state in both)
    return LinearModel(
        coef=coef,
        cov=_uncertainty(m, exact, coef, other),
        noise=0.5 * sum(state.psi_y for state in both),
    )


def _warn_excess(R, psi, data, labels):
    """Name the columns whose noise alone exceeds what was measured."""
    over = np.flatnonzero(np.diagonal(psi) > np.diagonal(R) * (1 + 1e-9))
    if over.size:
        shown = ", ".join(
            str(labels[i]) for i in np.flatnonzero(data.active)[over][:10]
        )
        warnings.warn(
            f"input_noise exceeds the whole variance of {over.size} input(s) "
            f"({shown}): no signal is left in them. Check the units of input_noise "
            "(variances, not standard deviations).",
            UserWarning,
            stacklevel=6,
        )


def _relevant_inputs(m, basis, as_they_are, solve):
    """Find inputs that help to predict y: ARD on noisy inputs, 2 deviations."""
    # Asked of the noisy inputs on purpose: an input that has nothing to do with y has
    # a zero coefficient there too, and the test has not lost power to the correction.
    state = as_they_are.state
    if basis.size < m.xx.size:
        exact = np.zeros((basis.size, basis.size))
        state = solve(m.columns(basis), exact).state
    score = state.beta_mean**2 / np.diagonal(state.beta_cov)
    kept = score > RELEVANT_DEVIATIONS**2
    if not kept.any():
        kept[np.argmax(score)] = True
    return kept


def _spread(R, at, copies):
    """Matrix (d, k) that gives the columns `at` and their exact copies their shares."""
    # Nothing tells copies apart: in standardised columns each takes the same part,
    # with the sign of its correlation.
    spread = np.zeros((R.shape[0], at.size))
    for k, (j, group) in enumerate(zip(at, copies)):
        sign = np.ones(1) if group.size == 1 else np.sign(R[j, group])
        spread[group, k] = sign / group.size
    return spread
