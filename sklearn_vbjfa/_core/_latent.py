"""Latent inputs given the observed ones and the coefficients' posterior."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

_LOG_2PI = float(np.log(2 * np.pi))


@dataclass(frozen=True, kw_only=True)
class Latent:
    """Gaussian of the latent inputs given the observed ones.

    Attributes
    ----------
    H : ndarray of shape (d, d)
        E[t | x] = H x.
    P : ndarray of shape (d, d)
        Cov[t | x].
    Sigma_t : ndarray of shape (d, d)
        Covariance of t.
    exact : bool
        The noise is zero, so that t is x.
    clipped : ndarray
        Eigenvalues of S - Psi (relative to S) that were negative.
    """

    H: np.ndarray
    P: np.ndarray
    Sigma_t: np.ndarray
    exact: bool
    clipped: np.ndarray


def infer_latent(S, n, psi, floor=1e-12):
    """Split the covariance of x into that of t and the noise.

    S : scatter (d, d) of x; psi : noise covariance (d, d). Where psi exceeds S along
    some direction no latent signal is left there: the eigenvalue is set to zero.
    """
    covariance = S / n
    d = covariance.shape[0]
    if not psi.any():
        eye = np.eye(d)
        return Latent(
            H=eye,
            P=np.zeros((d, d)),
            Sigma_t=covariance,
            exact=True,
            clipped=np.array([]),
        )
    values, vectors = linalg.eigh(covariance - psi)
    clipped = values[values < -floor * max(values[-1], 0.0)]
    Sigma_t = (vectors * np.maximum(values, 0.0)) @ vectors.T
    total = Sigma_t + psi
    # Exactly redundant columns make `total` singular; the pseudo-inverse keeps to
    # the span of the data, outside of which x never lies.
    H = Sigma_t @ linalg.pinvh(total, rtol=floor)
    P = Sigma_t - H @ Sigma_t
    P = 0.5 * (P + P.T)
    return Latent(H=H, P=P, Sigma_t=Sigma_t, exact=False, clipped=clipped)


@dataclass(frozen=True, kw_only=True)
class LatentSums:
    """Sums of <tt'> and <t> y over the samples, and the data part of the bound."""

    S_tt: np.ndarray
    S_ty: np.ndarray
    bound: float


def expect_latent(S, xy, yy, n, latent, state):
    """E-step over T: the sums of <tt'> and <t> y, and the data part of the bound."""
    beta, s2 = state.beta_mean, state.psi_y
    if latent.exact:
        residual = yy - 2 * beta @ xy + beta @ S @ beta
        spread = float(np.einsum("ij,ji->", state.beta_cov, S))
        value = -0.5 * (n * (_LOG_2PI + np.log(s2)) + (residual + spread) / s2)
        return LatentSums(S_tt=S, S_ty=xy, bound=value)
    d = beta.shape[0]
    # The uncertainty of beta acts as further precision beta_cov / s2 on t.
    inflate = np.eye(d) + latent.P @ state.beta_cov / s2
    lu = linalg.lu_factor(inflate)
    H = linalg.lu_solve(lu, latent.H)
    P = linalg.lu_solve(lu, latent.P)
    P = 0.5 * (P + P.T)
    P_beta = P @ beta
    q = s2 + beta @ P_beta
    k = P_beta / q
    c = H.T @ beta
    S_c = S @ c
    S_xe = xy - S_c
    S_ee = yy - 2 * c @ xy + c @ S_c
    HS = H @ S
    H_xe = H @ S_xe
    S_tt = (
        HS @ H.T
        + np.outer(H_xe, k)
        + np.outer(k, H_xe)
        + S_ee * np.outer(k, k)
        + n * (P - q * np.outer(k, k))
    )
    S_ty = H @ xy + k * (yy - c @ xy)
    # Collapsed data term: log N(y; c'x, q) and the price of beta's uncertainty.
    logdet = np.log(np.abs(np.diagonal(lu[0]))).sum()
    cost = np.einsum("ij,ji->", latent.H.T @ state.beta_cov @ H, S) / s2
    value = -0.5 * (n * (_LOG_2PI + np.log(q) + logdet) + S_ee / q + cost)
    return LatentSums(S_tt=0.5 * (S_tt + S_tt.T), S_ty=S_ty, bound=float(value))
