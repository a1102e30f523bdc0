"""Fitting of the independent-latent model, shared by the EM and the VB estimator."""

import warnings
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core import _predict, _solver
from sklearn_vbjfa._core._stats import DataMoments
from sklearn_vbjfa._core._updates import VARIANCE_FLOOR, expect_hidden


@dataclass(frozen=True, kw_only=True)
class IndependentFit:
    """Solution in standardised units, with what the attributes are made of."""

    solution: _solver.Solution
    retained: np.ndarray
    noisy: _predict.LinearModel
    noiseless: _predict.LinearModel


def noise_shares(noise, data, names):
    """Turn a user's input noise into shares of the active columns' variances.

    Returns None, or an array of shape (n_active,) in [0, 1]; a share of 1 marks an
    input that holds no signal beyond its noise, of which the user is warned.
    """
    if noise is None:
        return None
    n_active = data.x_scale.shape[0]
    if np.ndim(noise) == 0:
        return np.full(n_active, noise)
    if np.ndim(noise) == 2:
        off = noise - np.diag(np.diagonal(noise))
        if np.any(off):
            raise ValueError(
                "input_noise with covariances between inputs needs "
                'latent="correlated"; with independent latents give the variances '
                "alone, of shape (n_features,)."
            )
        noise = np.diagonal(noise)
    share = noise[data.active] / data.x_scale**2
    full = np.flatnonzero(data.active)[share >= 1.0]
    if full.size:
        shown = ", ".join(str(names[i]) for i in full[:10])
        warnings.warn(
            f"input_noise is at least the whole variance of {full.size} input(s) "
            f"({shown}): they hold no signal beyond noise and get the coefficient 0. "
            "Check the units of input_noise (variances, not standard deviations).",
            UserWarning,
            stacklevel=5,
        )
    return np.minimum(share, 1.0)


def _coefficient_covariance(data, hidden, precision):
    """Covariance of the noisy-query coefficients c, from the collapsed likelihood.

    With z and t integrated out, y | x ~ N(c'x, s), so that c has the precision
    S_xx / s plus that of its prior. The variational variances, conditional on the
    private z of each input, would be far too small.
    """
    moments, s = data.moments, hidden.y_var
    if isinstance(moments, DataMoments):
        # Woodbury with n < d; inputs without a prior have no finite variance.
        if not np.all(precision > 0):
            return np.full((moments.xx.size, moments.xx.size), np.inf)
        scaled = moments.X / precision
        inner = scaled @ moments.X.T
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
    values, vectors = linalg.eigh(moments.S / s)
    keep = values > values[-1] * values.size * 4 * np.finfo(float).eps
    span = vectors[:, keep] / np.sqrt(values[keep])
    cov = span @ span.T
    lost = (vectors[:, ~keep] ** 2).sum(axis=1) > 1e-8
    cov[lost, lost] = np.inf
    return cov


def fit_independent(data, prior, initial_noise, *, max_iter, tol, accelerate=True):
    """Run the iteration and derive coefficients, covariances and noise.

    Parameters
    ----------
    data : Standardised
        Moments and scales.
    prior : Prior
        Priors and known noise.
    initial_noise : float
        Share of each input's variance that is noise at the start.
    max_iter, tol : int, float
        Stopping rule of the loop.
    accelerate : bool
        Whether to do quasi-Newton steps; otherwise the updates as they are printed.
    """
    moments = data.moments
    d = moments.xx.shape[0]
    state = _solver.start(moments, prior, np.full(d, initial_noise))
    solution = _solver.solve(
        moments, state, prior, max_iter=max_iter, tol=tol, accelerate=accelerate
    )
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
    cov_noisy = _coefficient_covariance(data, hidden, precision)
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
        noisy=_predict.LinearModel(
            coef=_predict.coefficients_noisy(state),
            cov=cov_noisy,
            noise=float(hidden.y_var),
        ),
        noiseless=_predict.LinearModel(
            coef=_predict.coefficients_noiseless(state, retained),
            cov=cov,
            noise=float(state.psi_y + state.psi_z.sum()),
        ),
    )
