"""Regression with correlated latent inputs and known input-noise covariance.

    t ~ N(0, Sigma_t),  x = t + e_x,  e_x ~ N(0, Psi),  y = beta't + e_y,
    e_y ~ N(0, psi_y),  beta_m ~ N(0, 1/alpha_m),  alpha_m ~ Gamma,

with Psi known and Sigma_t = psd(S - Psi) from the scatter S of x. Variational
posterior q(T) q(beta) q(alpha); everything follows from n, S, S_xy and S_yy, at
O(d^3) an iteration. With Psi = 0, t is x and this is Bayesian linear regression with
automatic relevance determination.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.special import digamma, gammaln

from sklearn_vbjfa._core._solver import rounding_of_bound

_LOG_2PI = float(np.log(2 * np.pi))

# Smallest output noise, as a share of the variance of y, that second moments can tell
# from their own rounding: the residual is a difference of sums of products.
OUTPUT_FLOOR = 1e-12


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


@dataclass(frozen=True, kw_only=True)
class CorrelatedState:
    """Posterior of beta and alpha, and the output-noise variance."""

    beta_mean: np.ndarray
    beta_cov: np.ndarray
    alpha_shape: float
    alpha_rate: np.ndarray
    psi_y: float

    @property
    def E_alpha(self):
        """Posterior mean of the precisions."""
        return self.alpha_shape / self.alpha_rate


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
class _LatentSums:
    S_tt: np.ndarray
    S_ty: np.ndarray
    bound: float


def _expect_latent(S, xy, yy, n, latent, state):
    """E-step over T: the sums of <tt'> and <t> y, and the data part of the bound."""
    beta, s2 = state.beta_mean, state.psi_y
    if latent.exact:
        residual = yy - 2 * beta @ xy + beta @ S @ beta
        spread = float(np.einsum("ij,ji->", state.beta_cov, S))
        value = -0.5 * (n * (_LOG_2PI + np.log(s2)) + (residual + spread) / s2)
        return _LatentSums(S_tt=S, S_ty=xy, bound=value)
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
    return _LatentSums(S_tt=0.5 * (S_tt + S_tt.T), S_ty=S_ty, bound=float(value))


def _prior_bound(state, shape0, rate0, logdet_cov, shared):
    shape, rate = state.alpha_shape, state.alpha_rate
    E_alpha, E_log = state.E_alpha, digamma(shape) - np.log(rate)
    square = state.beta_mean**2 + np.diagonal(state.beta_cov)
    loadings = 0.5 * (E_log - E_alpha * square + 1.0)
    prior = shape0 * np.log(rate0) - gammaln(shape0) + (shape0 - 1) * E_log
    prior = prior - rate0 * E_alpha
    entropy = shape - np.log(rate) + gammaln(shape) + (1 - shape) * digamma(shape)
    # A precision that `shared` coefficients have in common counts once.
    return float((loadings + (prior + entropy) / shared).sum()) + 0.5 * logdet_cov


def _square_root(S):
    """Return R of shape (rank, d) with S = R'R, without the rounding of the null space.

    Eigenvalues below their own rounding are zero: left in, they would be information
    as soon as the noise is small enough.
    """
    values, vectors = linalg.eigh(S)
    keep = values > values[-1] * values.size * 4 * np.finfo(float).eps
    return np.sqrt(values[keep])[:, None] * vectors[:, keep].T


# Where rounding of S_tt / s2 stays below this share of the prior precision, the
# Cholesky factor of the posterior precision is safe; beyond, the square root is used.
_SAFE_ROUNDING = 1e-8


def _posterior_beta(S_tt, S_ty, yy, s2, alpha, square_root):
    """Posterior mean, covariance and log-determinant of beta, and <|y - beta't|^2>.

    ``square_root()`` returns R with S_tt = R'R; it is asked for only where needed.
    """
    prior = 1.0 / np.sqrt(alpha)
    d = prior.size
    A = S_tt * np.outer(prior, prior) / s2
    if np.finfo(float).eps * d * np.diagonal(A).max() < _SAFE_ROUNDING:
        A[np.diag_indices_from(A)] += 1.0
        factor = linalg.cholesky(A, lower=True)
        inverse = linalg.solve_triangular(factor, np.eye(d), lower=True)
        scaled = inverse * prior
        cov = scaled.T @ scaled
        mean = prior * linalg.cho_solve((factor, True), prior * S_ty) / s2
        logdet = -2 * np.log(np.diagonal(factor)).sum() - np.log(alpha).sum()
        residual = yy - 2 * mean @ S_ty + mean @ S_tt @ mean
        residual += np.einsum("ij,ij->", cov, S_tt)
        return mean, cov, float(logdet), float(residual)
    R = square_root()
    # y in the coordinates of R: S_ty = R' z
    z = (R @ S_ty) / np.einsum("ij,ij->i", R, R)
    U, sv, Vt = linalg.svd(R * prior, full_matrices=False)
    share = s2 / (s2 + sv**2)
    Uz = U.T @ z
    mean = prior * (Vt.T @ (sv / (s2 + sv**2) * Uz))
    cov = (Vt.T * share) @ Vt
    if sv.size < d:
        cov += np.eye(d) - Vt.T @ Vt
    cov *= np.outer(prior, prior)
    logdet = np.log(share).sum() - np.log(alpha).sum()
    # In these coordinates the residual is a sum of squares: no cancellation.
    residual = max(yy - z @ z, 0.0) + np.sum((share * Uz) ** 2) + share @ sv**2
    return mean, cov, float(logdet), float(residual)


@dataclass(frozen=True, kw_only=True)
class CorrelatedSolution:
    """Where the iteration ended; see `_solver.Solution`."""

    state: CorrelatedState
    latent: Latent
    history: np.ndarray
    n_iter: int
    status: str
    fall: float


def solve_correlated(
    S, xy, yy, n, psi, *, ard_shape, ard_rate, max_iter, tol, common=False
):
    """Fit the model to standardised moments.

    Parameters
    ----------
    S, xy, yy : ndarray (d, d), ndarray (d,), float
        Scatter of x, of x with y, and of y.
    n : float
        Number of samples.
    psi : ndarray of shape (d, d)
        Input-noise covariance.
    common : bool
        One precision for all coefficients instead of one for each.
    """
    d = xy.shape[0]
    shared = d if common else 1
    latent = infer_latent(S, n, psi)
    eps = OUTPUT_FLOOR
    shape = ard_shape + 0.5 * shared
    # <alpha> = 1 as in the paper; the noise starts at the whole variance of y, from
    # which the first posterior is a ridge solution.
    alpha_rate = np.full(d, shape)
    s2 = max(yy / n, eps)
    cached = []
    before = None  # the state of the last bound in `history`

    def root_of(S_tt):
        # With exact inputs S_tt is S throughout: one decomposition serves all.
        if not latent.exact:
            return _square_root(S_tt)
        if not cached:
            cached.append(_square_root(S_tt))
        return cached[0]

    mean, cov, logdet, _ = _posterior_beta(
        S, xy, yy, s2, shape / alpha_rate, lambda: _square_root(S)
    )
    state = CorrelatedState(
        beta_mean=mean, beta_cov=cov, alpha_shape=shape, alpha_rate=alpha_rate, psi_y=s2
    )
    history = []
    status, fall = "max_iter", 0.0
    for _ in range(max_iter):
        sums = _expect_latent(S, xy, yy, n, latent, state)
        value = sums.bound + _prior_bound(state, ard_shape, ard_rate, logdet, shared)
        gain = value - history[-1] if history else np.inf
        if gain < -rounding_of_bound(value, n, state.psi_y):
            status, fall = "bound_decreased", -gain
            state = before
            break
        history.append(value)
        if abs(gain) <= tol * n:
            status = "converged"
            break
        before = state
        mean, cov, logdet, residual = _posterior_beta(
            sums.S_tt,
            sums.S_ty,
            yy,
            state.psi_y,
            state.E_alpha,
            lambda: root_of(sums.S_tt),  # noqa: B023 - called at once
        )
        square = mean**2 + np.diagonal(cov)
        if common:
            square = np.full(d, square.sum())
        state = CorrelatedState(
            beta_mean=mean,
            beta_cov=cov,
            alpha_shape=shape,
            alpha_rate=ard_rate + 0.5 * square,
            psi_y=max(residual / n, eps),
        )
    return CorrelatedSolution(
        state=state,
        latent=latent,
        history=np.array(history),
        n_iter=len(history),
        status=status,
        fall=fall,
    )


def posterior_covariance(S, n, psi, solution):
    """Covariance of beta that counts the noise of the inputs' moments too.

    For known psi the corrected estimate has the asymptotic covariance (Fuller 1987,
    eq. 2.2.23, normal errors)

        (v G^-1 + G^-1 (v psi + psi beta beta' psi) G^-1) / n,
        v = psi_y + beta' psi beta,

    G being the covariance of the latent inputs, here with the prior's share added.
    With psi = 0 it is the posterior covariance of Bayesian regression. The
    variational one takes the latent inputs as given and is too small.
    """
    state = solution.state
    if solution.latent.exact:
        return state.beta_cov
    beta = state.beta_mean
    v = state.psi_y + beta @ psi @ beta
    prior = np.sqrt(v * state.E_alpha / n)
    root = 1.0 / prior
    A = solution.latent.Sigma_t * np.outer(root, root)
    A[np.diag_indices_from(A)] += 1.0
    half = linalg.solve_triangular(
        linalg.cholesky(A, lower=True), np.diag(root), lower=True
    )
    G_inv = half.T @ half
    psi_beta = psi @ beta
    middle = v * psi + np.outer(psi_beta, psi_beta)
    cov = (v * G_inv + G_inv @ middle @ G_inv) / n
    return 0.5 * (cov + cov.T)
