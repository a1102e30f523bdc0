"""Fitting of the correlated-latent model: dependencies, relevance, noise."""

import warnings
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core import _correlated
from sklearn_vbjfa._core._dependencies import find_dependencies

# An input is relevant when its coefficient is more than this many posterior standard
# deviations away from zero.
RELEVANT_DEVIATIONS = 2.0
# Share of the largest noise fraction that the moments permit which is believed, and
# the largest fraction that is believed whatever they permit. The second moments only
# bound the noise from above; see `noise_fraction`.
NOISE_OF_BOUND = 0.9
LARGEST_FRACTION = 0.3


@dataclass(frozen=True, kw_only=True)
class CorrelatedFit:
    """Solution in standardised units, spread over all active columns."""

    solution: _correlated.CorrelatedSolution
    coef: np.ndarray
    coef_noisy: np.ndarray
    coef_cov: np.ndarray
    alpha: np.ndarray
    relevant: np.ndarray
    psi: np.ndarray
    output_noise: float
    noisy_query_noise: float
    rule: str


def noise_fraction(R, r):
    """Input-noise fraction, from the correlations of inputs (d, d) and output (d,).

    Without noise in the inputs' covariance R and in the output what is left must be
    positive semidefinite; even with an output that is all signal, no common fraction
    can exceed the smallest eigenvalue of R - r r', the covariance of the inputs given
    the output. Strongly correlated latent inputs make the bound nearly sharp; for
    weakly correlated ones it says little, hence the cap.
    """
    given_output = R - np.outer(r, r)
    smallest = linalg.eigvalsh(given_output, subset_by_index=[0, 0])[0]
    return float(min(LARGEST_FRACTION, NOISE_OF_BOUND * max(smallest, 0.0)))


def fit_correlated(data, noise, labels, *, select, settings):
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
        Reduce exactly dependent inputs to their generators and fit only relevant
        ones, with one precision in common.
    settings : dict
        ard_shape, ard_rate, max_iter, tol.
    """
    m = data.moments
    d = m.xx.size
    unit = np.outer(data.x_scale, data.x_scale)
    psi = _standard_noise(noise, data, unit)
    if psi is not None:
        _warn_excess(m.S / m.n, psi, data, labels)
    if not select:
        psi = np.zeros((d, d)) if psi is None else psi
        solution = _correlated.solve_correlated(
            m.S, m.xy, m.yy, m.n, psi, root=m.root, **settings
        )
        cov = _correlated.posterior_covariance(m.S, m.n, psi, solution)
        return _result(
            data,
            solution,
            cov,
            psi,
            np.arange(d),
            [np.array([j]) for j in range(d)],
            "all inputs",
        )
    R, r = m.S / m.n, m.xy / m.n
    found = find_dependencies(R)
    basis = found.basis
    kept, variance = _relevant_inputs(m, basis, settings)
    at = basis[kept]
    if psi is None:
        psi_kept = noise_fraction(R[np.ix_(at, at)], r[at]) * np.eye(at.size)
        psi = np.zeros((d, d))
        psi[at, at] = np.diagonal(psi_kept)
    psi_kept = psi[np.ix_(at, at)]
    solution = _correlated.solve_correlated(
        m.S[np.ix_(at, at)],
        m.xy[at],
        m.yy,
        m.n,
        psi_kept,
        common=True,
        root=None if m.root is None else m.root.columns(at),
        **settings,
    )
    cov = _correlated.posterior_covariance(m.S[np.ix_(at, at)], m.n, psi_kept, solution)
    copies = [found.copies[k] for k in np.flatnonzero(kept)]
    result = _result(data, solution, cov, psi, at, copies, found.rule)
    # An input that was switched off keeps the deviation of the test that did it; one
    # that others generate has the coefficient zero by convention.
    off = basis[~kept]
    result.coef_cov[off, off] = variance[~kept]
    return result


def _standard_noise(noise, data, unit):
    if noise is None:
        return None
    d = data.x_scale.size
    if np.ndim(noise) == 0:
        return noise * np.eye(d)
    full = np.diag(noise) if np.ndim(noise) == 1 else noise
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


def _relevant_inputs(m, basis, settings):
    """Find inputs that help to predict y: ARD on noisy inputs, 2 deviations.

    Asked of the noisy inputs on purpose: an input that has nothing to do with y has a
    zero coefficient there too, and the test has not lost power to the correction.
    """
    solution = _correlated.solve_correlated(
        m.S[np.ix_(basis, basis)],
        m.xy[basis],
        m.yy,
        m.n,
        np.zeros((basis.size, basis.size)),
        root=None if m.root is None else m.root.columns(basis),
        **settings,
    )
    state = solution.state
    limit = RELEVANT_DEVIATIONS**2 * np.diagonal(state.beta_cov)
    kept = state.beta_mean**2 > limit
    if not kept.any():
        kept[np.argmax(state.beta_mean**2 / np.diagonal(state.beta_cov))] = True
    return kept, np.diagonal(state.beta_cov)


def _result(data, solution, cov, psi, at, copies, rule):
    """Spread the solution of columns `at` over all active ones, copies sharing."""
    d = data.x_scale.size
    state, latent = solution.state, solution.latent
    noisy = latent.H.T @ state.beta_mean
    # Exact copies have nothing to tell them apart: in standardised columns each
    # takes the same part, with the sign of its correlation.
    spread = np.zeros((d, at.size))
    R = getattr(data.moments, "S", None)
    for k, (j, group) in enumerate(zip(at, copies)):
        sign = np.ones(1) if group.size == 1 else np.sign(R[j, group])
        spread[group, k] = sign / group.size
    alpha = np.full(d, np.inf)
    relevant = np.zeros(d, dtype=bool)
    significant = state.beta_mean**2 > RELEVANT_DEVIATIONS**2 * np.diagonal(cov)
    for k, group in enumerate(copies):
        alpha[group] = state.E_alpha[k]
        relevant[group] = significant[k] if rule == "all inputs" else True
    excess = state.beta_mean @ latent.P @ state.beta_mean
    return CorrelatedFit(
        solution=solution,
        coef=spread @ state.beta_mean,
        coef_noisy=spread @ noisy,
        coef_cov=spread @ cov @ spread.T,
        alpha=alpha,
        relevant=relevant,
        psi=psi,
        output_noise=state.psi_y,
        noisy_query_noise=state.psi_y + excess,
        rule=rule,
    )
