"""Fitting of the correlated-latent model: dependencies, relevance, noise."""

import warnings
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core import _correlated
from sklearn_vbjfa._core._dependencies import find_dependencies
from sklearn_vbjfa._core._predict import LinearModel

# An input is relevant when its coefficient is more than this many posterior standard
# deviations away from zero.
RELEVANT_DEVIATIONS = 2.0
# Largest fraction of an input's variance that the prior takes for noise: an input that
# someone measured in order to predict with it is signal for two thirds at least.
LARGEST_FRACTION = 1 / 3


@dataclass(frozen=True, kw_only=True)
class CorrelatedFit:
    """Solutions in standardised units, spread over all active columns.

    `noisy` and `noiseless` are the linear models for the two kinds of queries, with
    the solutions that they come from; alpha, relevant (d,) and psi (d, d) are the
    precisions, the relevant inputs and the input noise.
    """

    noisy: LinearModel
    noiseless: LinearModel
    noisy_solution: _correlated.CorrelatedSolution
    noiseless_solution: _correlated.CorrelatedSolution
    alpha: np.ndarray
    relevant: np.ndarray
    psi: np.ndarray
    rule: str


def largest_noise_fraction(R, r):
    """Largest input-noise fraction that correlations R (d, d), r (d,) admit.

    Without noise in the inputs' covariance R and in the output what is left must be
    positive semidefinite: no common fraction can exceed the smallest eigenvalue of
    R - r r', the covariance of the inputs given an output that is all signal.
    """
    given_output = R - np.outer(r, r)
    smallest = linalg.eigvalsh(given_output, subset_by_index=[0, 0])[0]
    return float(min(LARGEST_FRACTION, max(smallest, 0.0)))


def fit_correlated(data, noise, labels, *, select, settings, dof=np.inf):
    """Fit the model.

    Parameters
    ----------
    data : Standardised
        Moments as a scatter matrix, and scales.
    noise : None, float, ndarray of shape (d,) or (d, d)
        The user's input noise, already validated; None estimates it.
    labels : sequence
        Names of the columns for messages.
    select : bool
        For noiseless queries: reduce exactly dependent inputs to their generators and
        fit only relevant ones, with one precision in common. Noisy queries are then
        answered by all inputs as they are, see `_average`.
    settings : dict
        common, ard_shape, ard_rate, max_iter, tol, accelerate; `common` is one
        precision for all inputs.
    dof : float
        Degrees of freedom with which the user's noise was estimated.
    """
    m = data.moments
    d = m.xx.size
    psi = _standard_noise(noise, data)
    if psi is not None:
        _warn_excess(m.S / m.n, psi, data, labels)
    if not select:
        return _fit_all(m, np.zeros((d, d)) if psi is None else psi, settings, dof)
    R, r = m.S / m.n, m.xy / m.n
    as_they_are = _solve(m, np.zeros((d, d)), settings)
    found = find_dependencies(R)
    basis = found.basis
    kept = _relevant_inputs(m, basis, as_they_are, settings)
    at = basis[kept]
    largest = 0.0
    if psi is None:
        largest = largest_noise_fraction(R[np.ix_(at, at)], r[at])
        psi = np.zeros((d, d))
        psi[at, at] = 0.5 * largest
    solution = _solve(m.columns(at), psi[np.ix_(at, at)], {**settings, "common": True})
    coef = np.zeros(basis.size)
    coef[kept] = solution.state.beta_mean
    # The inputs that were switched off belong to what is not known.
    psi_basis = psi[np.ix_(basis, basis)]
    in_common = _solve(m.columns(basis), psi_basis, {**settings, "common": True})
    cov = _uncertainty(m.columns(basis), psi_basis, coef, in_common, dof)
    cov[np.ix_(kept, kept)] += _fraction_covariance(solution, largest)
    spread = _spread(R, basis, found.copies)
    relevant = np.zeros(d, dtype=bool)
    relevant[np.concatenate([found.copies[k] for k in np.flatnonzero(kept)])] = True
    return CorrelatedFit(
        noisy=_average(m, as_they_are, settings),
        noiseless=LinearModel(
            coef=spread @ coef,
            cov=spread @ cov @ spread.T,
            noise=solution.state.psi_y,
        ),
        noisy_solution=as_they_are,
        noiseless_solution=solution,
        alpha=as_they_are.state.E_alpha,
        relevant=relevant,
        psi=psi,
        rule=found.rule,
    )


def _solve(m, psi, settings):
    """Fit all inputs of the moments with a known noise covariance (d, d)."""
    return _correlated.solve_correlated(
        m.S, m.xy, m.yy, m.n, psi, root=m.root, **settings
    )


def _fit_all(m, psi, settings, dof=np.inf):
    """Fit all inputs with a known noise covariance (d, d), for both queries."""
    solution = _solve(m, psi, settings)
    state, latent = solution.state, solution.latent
    in_common = _in_common(m, psi, solution, settings)
    cov = _uncertainty(m, psi, state.beta_mean, in_common, dof)
    noiseless = LinearModel(coef=state.beta_mean, cov=cov, noise=state.psi_y)
    noisy = noiseless
    if not latent.exact:
        noisy = _noisy_model(m, solution, settings)
    variance = np.diagonal(
        _correlated.posterior_covariance(m.S, m.n, psi, solution, dof)
    )
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


def _in_common(m, psi, solution, settings):
    """Solution with one precision in common, which `solution` may be already."""
    if settings["common"]:
        return solution
    return _solve(m, psi, {**settings, "common": True})


def _uncertainty(m, psi, coef, in_common, dof=np.inf):
    """Second moment (d, d) about `coef` of the posterior with one precision in common.

    A posterior under automatic relevance determination takes the precisions for known:
    of a coefficient that it has switched off, or nearly, it says that it is zero. One
    precision, known from all coefficients together, does not. What both disagree in
    belongs to what is not known.
    """
    cov = _correlated.posterior_covariance(m.S, m.n, psi, in_common, dof)
    return cov + _square(in_common.state.beta_mean - coef)


def _noisy_model(m, solution, settings):
    """Model of y given noisy inputs, c = H'beta, with its variance v and uncertainty.

    v is psi_y + beta'P beta. That of c is what a regression on the inputs as they are
    leaves open, see `_uncertainty`.
    """
    beta, latent = solution.state.beta_mean, solution.latent
    coef, exact = latent.H.T @ beta, np.zeros_like(m.S)
    in_common = _solve(m, exact, {**settings, "common": True})
    return LinearModel(
        coef=coef,
        cov=_uncertainty(m, exact, coef, in_common),
        noise=solution.state.psi_y + beta @ latent.P @ beta,
    )


def _square(x):
    return np.outer(x, x)


def _fraction_covariance(solution, largest):
    """Covariance (d, d) of the coefficients over a fraction uniform on [0, largest].

    From (R - f I) beta_f = R beta_0, the same for all f, follows the slope
    (R - f I)^-1 beta_f; the variance of f is largest^2 / 12.
    """
    slope = linalg.pinvh(solution.latent.Sigma_t) @ solution.state.beta_mean
    return _square(slope) * largest**2 / 12


def _average(m, solution, settings):
    """Answer to noisy queries: the mean of two regressions on the inputs as they are.

    One gives each input a precision of its own, which suits few relevant inputs; the
    other one precision to all, which suits many. Nothing tells beforehand which suits;
    their mean is nearly as good as the better one, and half of what they differ in is
    not known.
    """
    exact = np.zeros_like(m.S)
    other = _in_common(m, exact, solution, settings)
    both = [one.state for one in (solution, other)]
    coef = 0.5 * sum(state.beta_mean for state in both)
    return LinearModel(
        coef=coef,
        cov=_uncertainty(m, exact, coef, other),
        noise=0.5 * sum(state.psi_y for state in both),
    )


def _standard_noise(noise, data):
    """Noise covariance (d, d) of the standardised active columns; None is unknown."""
    if noise is None:
        return None
    if np.ndim(noise) == 0:
        return noise * np.eye(data.x_scale.size)
    full = np.diag(noise) if np.ndim(noise) == 1 else noise
    unit = np.outer(data.x_scale, data.x_scale)
    return full[np.ix_(data.active, data.active)] / unit


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


def _relevant_inputs(m, basis, as_they_are, settings):
    """Find inputs that help to predict y: ARD on noisy inputs, 2 deviations.

    Asked of the noisy inputs on purpose: an input that has nothing to do with y has a
    zero coefficient there too, and the test has not lost power to the correction.
    """
    state = as_they_are.state
    if basis.size < m.xx.size:
        exact = np.zeros((basis.size, basis.size))
        state = _solve(m.columns(basis), exact, settings).state
    score = state.beta_mean**2 / np.diagonal(state.beta_cov)
    kept = score > RELEVANT_DEVIATIONS**2
    if not kept.any():
        kept[np.argmax(score)] = True
    return kept


def _spread(R, at, copies):
    """Matrix (d, k) that gives the columns `at` and their exact copies their shares.

    Nothing tells copies apart: in standardised columns each takes the same part, with
    the sign of its correlation.
    """
    spread = np.zeros((R.shape[0], at.size))
    for k, (j, group) in enumerate(zip(at, copies)):
        sign = np.ones(1) if group.size == 1 else np.sign(R[j, group])
        spread[group, k] = sign / group.size
    return spread
