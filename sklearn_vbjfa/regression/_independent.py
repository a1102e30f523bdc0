"""How the model with independent latents is fitted to standardised data."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa._core._solver import Solution, solve, start
from sklearn_vbjfa._core._updates import (
    VARIANCE_FLOOR,
    LinearModel,
    coefficients_noiseless,
    coefficients_noisy,
    expect_hidden,
)

# Share of each input's variance that is noise at the start, where it is not given.
_INITIAL_NOISE = 0.3


@dataclass(frozen=True, kw_only=True)
class IndependentFit:
    """Solution in standardised units, with what the attributes are made of."""

    solution: Solution
    retained: np.ndarray
    noisy: LinearModel
    noiseless: LinearModel


def fit_independent(data, prior, *, max_iter, tol):
    """Run the iteration and derive coefficients, covariances and noise."""
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
    return IndependentFit(
        solution=solution,
        retained=retained,
        noisy=LinearModel(
            coef=coefficients_noisy(state),
            cov=cov_noisy,
            noise=float(hidden.y_var),
        ),
        noiseless=LinearModel(
            coef=coefficients_noiseless(state, retained),
            cov=cov,
            noise=float(state.psi_y + state.psi_z.sum()),
        ),
    )


def _coefficient_covariance(moments, s, precision):
    """Covariance (d, d) of the noisy-query coefficients c, of prior precision (d,)."""
    # With z and t integrated out, y | x ~ N(c'x, s), so that c has the precision
    # S_xx / s plus that of its prior. The variational variances, conditional on the
    # private z of each input, would be far too small.
    if moments.S is None:
        # Woodbury with n < d; inputs without a prior have no finite variance.
        if not np.all(precision > 0):
            return np.full((moments.xx.size, moments.xx.size), np.inf)
        rows = moments.root.R
        scaled = rows / precision
        inner = scaled @ rows.T
        inner[np.diag_indices_from(inner)] += s
        return np.diag(1.0 / precision) - scaled.T @ linalg.solve(
            inner, scaled, assume_a="pos"
        )
    if np.all(precision > 0):
        root = 1.0 / np.sqrt(precision)
        A = moments.S * np.outer(root, root) / s
        A[np.diag_indices_from(A)] += 1.0
        factor = linalg.cholesky(A, lower=True)
        half = linalg.solve_triangular(factor, np.diag(root), lower=True)
        return half.T @ half
    # Without a prior the null space of S_xx has no finite variance: the span's
    # covariance is reported and the affected inputs are marked infinite.
    eigen = scaled_eigen(moments.S / s, scale=1.0)
    cov, lost = eigen.inverse(), eigen.lost(1e-8)
    cov[lost, lost] = np.inf
    return cov
