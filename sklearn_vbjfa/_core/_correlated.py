"""Regression with correlated latent inputs and known input-noise covariance.

    t ~ N(0, Sigma_t),  x = t + e_x,  e_x ~ N(0, Psi),  y = beta't + e_y,
    e_y ~ N(0, psi_y),  beta_m ~ N(0, 1/alpha_m),  alpha_m ~ Gamma,

with Psi known and Sigma_t = psd(S - Psi) from the scatter S of x. Variational
posterior q(T) q(beta) q(alpha); everything follows from n, S, S_xy and S_yy, at
O(d^3) an iteration. With Psi = 0, t is x and this is Bayesian linear regression with
automatic relevance determination.

Latent inputs given the observed ones and the coefficients' posterior.

Exact conditional maximisers of the correlated-latent model's bound.

The plain iteration updates coefficients, precisions and output noise one after the
other, each given the others' last values, and creeps where two of them move together.
Here pairs are maximised jointly; every result is a higher bound at the price of the
same O(d^3), and the fixed points are those of the plain iteration.
"""

from collections import deque
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import linalg
from scipy.special import digamma, gammaln

from sklearn_vbjfa._core._moments import SquareRoot
from sklearn_vbjfa._core._scaled_eigen import scaled_eigen
from sklearn_vbjfa._core._solver import rounding_of_bound, rounding_of_fit

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
    H = Sigma_t @ scaled_eigen(total, floor, scale=1.0).inverse()
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


# Newton steps of the joint maximum of mean and noise; it is close from the second
# iteration on, and the outer loop goes on where this one stops.
_NEWTON_STEPS = 20
_ENOUGH = 1e-4  # share of the promised gain that a step must bring
# Largest logarithm of a precision or a noise: exp of it must stay a number.
_LARGEST_LOG = 300.0


def precisions_given_others(mean, variance, alpha, shape0, rate0):
    """Best E[alpha_m] of each coefficient, the posterior of the others held.

    mean, variance : posterior of beta under the precisions `alpha`, each (d,). Without
    its own prior, beta_m has the precision s_m = 1/variance - alpha and the score
    q_m = mean / variance (Tipping and Faul, 2003). The plain update is then

        alpha <- (2 a0 + 1) / (2 b0 + q^2 / (alpha + s)^2 + 1 / (alpha + s)),

    whose fixed points are the roots of a cubic. It rises with alpha, so that it would
    end at the next root on the side to which it moves: that one is returned.
    """
    total = 2 * shape0 + 1.0
    # An input that says nothing has s = 0, to rounding.
    s = np.maximum(1.0 / variance - alpha, np.finfo(float).eps / variance)
    strength = (mean / variance) ** 2 / s
    rate = 2 * rate0 * s
    # In v = s / alpha: total v^3 = (rate + strength + 1 - 2 total) v^2
    #                              + (2 rate - 2 a0) v + rate
    companion = np.zeros((s.size, 3, 3))
    companion[:, 0, 0] = (rate + strength + 1.0 - 2 * total) / total
    companion[:, 0, 1] = (2 * rate - 2 * shape0) / total
    companion[:, 0, 2] = rate / total
    companion[:, 1, 0] = companion[:, 2, 1] = 1.0
    roots = np.linalg.eigvals(companion)
    now = s / alpha
    v_next = now[:, None] / (1.0 + now[:, None])  # s / (alpha + s)
    plain = total / (rate + v_next[:, 0] * (strength * v_next[:, 0] + 1.0))  # alpha/s
    falls = (1.0 / plain < now)[:, None]  # v falls when alpha rises
    real = np.abs(roots.imag) <= np.sqrt(np.finfo(float).eps) * np.abs(roots)
    v = np.where(real & (roots.real > 0), roots.real, np.nan)
    below = np.where(v <= now[:, None], v, -np.inf).max(axis=1)
    above = np.where(v >= now[:, None], v, np.inf).min(axis=1)
    found = np.where(falls[:, 0], below, above)
    found = np.where(np.isfinite(found), found, 1.0 / plain)  # a root lost to rounding
    return s / found


def noise_given_shape(squares, n, d, penalty):
    """Best output noise s2 when the posterior covariance of beta scales with it.

    Maximises -(n log s2 + squares / s2) / 2 + (d log s2 - penalty s2) / 2, `penalty`
    being sum(alpha_m cov_mm) / s2.
    """
    half = 0.5 * (n - d)
    root = np.sqrt(half * half + penalty * squares)
    if half > 0:
        return squares / (half + root)
    return (root - half) / penalty


def mean_and_noise(moments, latent_gain, latent_cov, shape, start, alpha):
    """Best mean of beta and output noise together, q(T) at its optimum throughout.

    Given shape = cov / s2 (d, d), the noise enters the bound through
    y | x ~ N(c'x, s2 + beta'P beta), c = H'beta, with H and P the latent gain and
    covariance raised by `shape`; the prior and the entropy add
    -(beta' A beta + penalty s2 - d log s2) / 2. Newton's method in (beta, log s2) with
    the magnitudes of the eigenvalues, which makes each step an ascent.

    Parameters
    ----------
    moments : tuple
        S (d, d), S_xy (d,), S_yy and n.
    latent_gain, latent_cov : ndarray of shape (d, d)
        E[t | x] = H x and Cov[t | x].
    shape : ndarray of shape (d, d)
        Posterior covariance of beta over s2.
    start : tuple
        Mean (d,) and noise to start from.
    alpha : ndarray of shape (d,)
        Precisions of the prior.
    """
    S, xy, yy, n = moments
    mean, noise = start
    d = mean.size
    lu = linalg.lu_factor(np.eye(d) + latent_cov @ shape)
    H, P = linalg.lu_solve(lu, latent_gain), linalg.lu_solve(lu, latent_cov)
    P = 0.5 * (P + P.T)
    K, k = H @ S @ H.T, H @ xy
    penalty = alpha @ np.diagonal(shape)

    def value(mean, log_noise):
        s2 = np.exp(log_noise)
        q = s2 + mean @ P @ mean
        if not q > 0:  # rounding of P, where there is hardly any noise
            return -np.inf
        squares = yy - 2 * mean @ k + mean @ K @ mean
        data = n * np.log(q) + squares / q
        return -0.5 * (data + alpha @ mean**2 - d * log_noise + penalty * s2)

    log_noise = np.log(noise)
    best = value(mean, log_noise)
    curvature = np.empty((d + 1, d + 1))
    for _ in range(_NEWTON_STEPS):
        s2, w = np.exp(log_noise), 2 * P @ mean
        q = s2 + 0.5 * mean @ w
        r = k - K @ mean
        squares = yy - mean @ (k + r)
        on_q, on_qq = 0.5 * (squares / q - n) / q, (0.5 * n - squares / q) / q**2
        gradient = np.append(
            on_q * w + r / q - alpha * mean, on_q * s2 + 0.5 * (d - penalty * s2)
        )
        cross = np.outer(w, r) / q**2
        curvature[:d, :d] = K / q - 2 * on_q * P - on_qq * np.outer(w, w)
        curvature[:d, :d] += cross + cross.T + np.diag(alpha)
        curvature[:d, d] = curvature[d, :d] = s2 * (r / q**2 - on_qq * w)
        curvature[d, d] = 0.5 * penalty * s2 - on_q * s2 - on_qq * s2**2
        unit = 1.0 / np.sqrt(np.append(np.diagonal(K) / q + alpha, 0.5 * n))
        values, vectors = linalg.eigh(curvature * np.outer(unit, unit))
        values = np.maximum(np.abs(values), d * np.finfo(float).eps * abs(values[-1]))
        step = unit * (vectors @ ((vectors.T @ (unit * gradient)) / values))
        promised = gradient @ step
        # The exponential of the noise's logarithm must stay a number.
        length = min(1.0, _LARGEST_LOG / max(abs(step[d]), 1.0))
        while True:
            trial = mean + length * step[:d], log_noise + length * step[d]
            new = value(*trial)
            if new >= best + _ENOUGH * length * promised:
                break
            length *= 0.5
            if length * promised <= np.finfo(float).eps * n:
                return mean, float(np.exp(log_noise))
        (mean, log_noise), best = trial, new
    return mean, float(np.exp(log_noise))


# Smallest output noise, as a share of the variance of y, that second moments can tell
# from their own rounding: the residual is a difference of sums of products.
OUTPUT_FLOOR = 1e-12
# The same for a triangular factor of the rows, whose residual is a sum of squares.
FACTOR_FLOOR = OUTPUT_FLOOR**2


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


def _square_root(S, xy, yy):
    """Square root of second moments, without the rounding of their null space.

    Eigenvalues below their own rounding are zero: left in, they would be information
    as soon as the noise is small enough.
    """
    eigen = scaled_eigen(S, scale=1.0)
    R = eigen.root()
    # y in the coordinates of R, whose rows are orthogonal
    z = (R @ xy) / eigen.known_values
    return SquareRoot(R=R, z=z, rest=max(yy - z @ z, 0.0))


# Where rounding of S_tt / s2 stays below this share of the prior precision, the
# Cholesky factor of the posterior precision is safe; beyond, the square root is used.
_SAFE_ROUNDING = 1e-8
_HALF_DIGITS = np.sqrt(np.finfo(float).eps)


def _posterior_beta(S_tt, S_ty, yy, s2, alpha, square_root, *, always=False):
    """Posterior mean, covariance and log-determinant of beta, and <|y - beta't|^2>.

    ``square_root()`` returns that of the moments; it is asked for only where needed,
    or always.
    """
    prior = 1.0 / np.sqrt(alpha)
    d = prior.size
    A = S_tt * np.outer(prior, prior) / s2
    rounding = np.finfo(float).eps * d * np.diagonal(A).max()
    if rounding < _SAFE_ROUNDING and not always:
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
    root = square_root()
    U, sv, Vt = linalg.svd(root.R * prior, full_matrices=False)
    # Singular values of the size of rounding are zero: with hardly any noise they would
    # be information.
    keep = sv > sv[:1] * max(root.R.shape) * np.finfo(float).eps
    U, sv, Vt = U[:, keep], sv[keep], Vt[keep]
    share = s2 / (s2 + sv**2)
    Uz = U.T @ root.z
    mean = prior * (Vt.T @ (sv / (s2 + sv**2) * Uz))
    cov = (Vt.T * share) @ Vt
    if sv.size < d:
        # The projector on what is left, squared: its diagonal must not be negative.
        others = np.eye(d) - Vt.T @ Vt
        cov += others @ others.T
    cov *= np.outer(prior, prior)
    logdet = np.log(share).sum() - np.log(alpha).sum()
    # In these coordinates the residual is a sum of squares: no cancellation.
    outside = root.z - U @ Uz
    residual = root.rest + outside @ outside
    residual += np.sum((share * Uz) ** 2) + share @ sv**2
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


@dataclass(frozen=True, kw_only=True)
class _Point:
    """A state with all that the next step needs, and its bound."""

    state: CorrelatedState
    logdet: float
    precisions: np.ndarray  # under which the posterior of beta was taken
    sums: LatentSums
    value: float


class _Problem:
    """The moments, and the steps from one state to the next."""

    def __init__(self, S, xy, yy, n, psi, ard_shape, ard_rate, common, root):
        self.S, self.xy, self.yy, self.n = S, xy, yy, n
        self.latent = infer_latent(S, n, psi)
        self.ard_shape, self.ard_rate, self.common = ard_shape, ard_rate, common
        self.d = xy.shape[0]
        self.shared = self.d if common else 1
        # With exact inputs S_tt is S throughout: one decomposition serves all.
        self.root = root if self.latent.exact else None
        self.given = self.root is not None
        self.floor = FACTOR_FLOOR if self.given else OUTPUT_FLOOR

    def root_of(self, sums):
        if not self.latent.exact:
            return _square_root(sums.S_tt, sums.S_ty, self.yy)
        if self.root is None:
            self.root = _square_root(self.S, self.xy, self.yy)
        return self.root

    def start(self, *, fast):
        """Ridge solution with <alpha> = 1, as in the paper, and all of y as noise."""
        return self._start_from(np.ones(self.d), self.yy / self.n, fast=fast)

    def start_from_least_squares(self, *, fast):
        """Posterior with the precisions and the noise of least squares.

        From the ridge solution a direction with a tiny share of the inputs' variance
        is not found, though y may depend on it with hardly any noise.
        """
        sums = LatentSums(S_tt=self.S, S_ty=self.xy, bound=np.nan)
        root = self.root_of(sums)
        beta = np.linalg.lstsq(root.R, root.z, rcond=None)[0]
        left = root.z - root.R @ beta
        square = np.full(self.d, np.mean(beta**2)) if self.common else beta**2
        shape = self.ard_shape + 0.5 * self.shared
        alpha = shape / (self.ard_rate + 0.5 * self.shared * square)
        return self._start_from(alpha, (left @ left + root.rest) / self.n, fast=fast)

    def _start_from(self, alpha, s2, *, fast):
        s2 = max(s2, self.floor)
        shape = self.ard_shape + 0.5 * self.shared
        sums = LatentSums(S_tt=self.S, S_ty=self.xy, bound=np.nan)
        mean, cov, logdet, squares = self._posterior(sums, s2, alpha)
        spread = self.d - alpha @ np.diagonal(cov)
        if fast:
            mean, cov, logdet, s2 = self._joint(mean, cov, logdet, squares, s2, alpha)
        state = CorrelatedState(
            beta_mean=mean,
            beta_cov=cov,
            alpha_shape=shape,
            alpha_rate=shape / alpha,
            psi_y=s2,
        )
        return self._evaluate(state, logdet, alpha, spread)

    def _posterior(self, sums, s2, alpha):
        return _posterior_beta(
            sums.S_tt,
            sums.S_ty,
            self.yy,
            s2,
            alpha,
            lambda: self.root_of(sums),
            always=self.given,
        )

    def _joint(self, mean, cov, logdet, squares, s2, alpha):
        """Maximise over the noise (and with it the mean) at a fixed cov / s2."""
        shape = cov / s2
        penalty = alpha @ np.diagonal(shape)
        if self.latent.exact:
            # tr(cov S) = s2 (d - alpha'diag(cov))
            fit = max(squares - s2 * (self.d - s2 * penalty), 0.0)
            new = noise_given_shape(fit, self.n, self.d, penalty)
        else:
            mean, new = mean_and_noise(
                (self.S, self.xy, self.yy, self.n),
                self.latent.H,
                self.latent.P,
                shape,
                (mean, s2),
                alpha,
            )
        new = max(new, self.floor)
        return mean, shape * new, logdet + self.d * np.log(new / s2), new

    def step(self, point, *, fast):
        """Do the M-steps: beta, the noise, alpha; plain or jointly where possible."""
        state = point.state
        alpha = state.E_alpha
        if fast and not self.common:
            alpha = precisions_given_others(
                state.beta_mean,
                np.diagonal(state.beta_cov),
                point.precisions,
                self.ard_shape,
                self.ard_rate,
            )
        s2 = state.psi_y
        mean, cov, logdet, squares = self._posterior(point.sums, s2, alpha)
        spread = self.d - alpha @ np.diagonal(cov)
        if fast:
            mean, cov, logdet, s2 = self._joint(mean, cov, logdet, squares, s2, alpha)
        else:
            spread *= s2 / max(squares / self.n, self.floor)
            s2 = max(squares / self.n, self.floor)
        square = mean**2 + np.diagonal(cov)
        if self.common:
            square = np.full(self.d, square.sum())
        new = CorrelatedState(
            beta_mean=mean,
            beta_cov=cov,
            alpha_shape=state.alpha_shape,
            alpha_rate=self.ard_rate + 0.5 * square,
            psi_y=s2,
        )
        return self._evaluate(new, logdet, alpha, spread)

    def coordinates(self, point):
        """Return all that the next plain step depends on, log alpha and log s2 first.

        ndarray of shape (d + 1,), or (d + 1 + d * d + d,) with noisy inputs.
        """
        state, sums = point.state, point.sums
        parts = [np.log(state.E_alpha), [np.log(state.psi_y)]]
        if not self.latent.exact:
            parts += [sums.S_tt.ravel() / self.n, sums.S_ty / self.n]
        return np.concatenate(parts)

    def moved(self, point, vector):
        """Return a point with these coordinates, to make a plain step from."""
        d, state = self.d, point.state
        logs = np.clip(vector[: d + 1], -_LARGEST_LOG, _LARGEST_LOG)
        state = replace(
            state,
            alpha_rate=state.alpha_shape * np.exp(-logs[:d]),
            psi_y=max(float(np.exp(logs[d])), self.floor),
        )
        sums = point.sums
        if not self.latent.exact:
            S_tt = vector[d + 1 : d + 1 + d * d].reshape(d, d)
            sums = replace(
                sums, S_tt=self.n * S_tt, S_ty=self.n * vector[d + 1 + d * d :]
            )
        return replace(point, state=state, sums=sums)

    def _evaluate(self, state, logdet, precisions, spread):
        """E-step over T, and the bound."""
        sums = expect_latent(self.S, self.xy, self.yy, self.n, self.latent, state)
        if self.given:
            # The squared residual of the factor instead of a difference of moments,
            # and the identity tr(cov S) = s2 (d - alpha'diag(cov)), in which the huge
            # variances of directions with little information do not cancel.
            left = self.root.z - self.root.R @ state.beta_mean
            data = self.n * (_LOG_2PI + np.log(state.psi_y)) + spread
            data += (left @ left + self.root.rest) / state.psi_y
            sums = replace(sums, bound=-0.5 * float(data))
        value = sums.bound + _prior_bound(
            state, self.ard_shape, self.ard_rate, logdet, self.shared
        )
        return _Point(
            state=state, logdet=logdet, precisions=precisions, sums=sums, value=value
        )

    def resolution(self, point):
        """Return the output variance in units of what cancels in the residual."""
        size = np.linalg.norm(point.state.beta_mean)
        if self.given:
            # The residual itself is rounded, in units of the terms that cancel in it.
            return np.sqrt(point.state.psi_y) / (1.0 + size)
        # Its square is, a difference of products.
        return point.state.psi_y / (1.0 + size**2)


def _has_digits(S):
    """Whether rounding is far below the smallest eigenvalue."""
    values = linalg.eigvalsh(S)
    return bool(values[0] > _HALF_DIGITS * values[-1])


def solve_correlated(
    S,
    xy,
    yy,
    n,
    psi,
    *,
    ard_shape,
    ard_rate,
    max_iter,
    tol,
    common=False,
    root=None,
    accelerate=True,
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
    root : SquareRoot or None
        Square root of the moments where it is known to more digits than they are;
        used with exact inputs.
    accelerate : bool, default=True
        Reach the fixed point in fewer iterations: by maximising the bound jointly over
        what the plain iteration updates in turn, where `root` is given or the moments
        have the digits that this needs in all directions (the smallest eigenvalue of S
        is half their digits above rounding), and by Anderson's extrapolation. A step
        that does not raise the bound is replaced by the plain one. Every evaluation of
        the bound counts as an iteration. False is the iteration to the letter, ended
        by `tol` alone.
        With exact inputs the bound of least squares is looked at in the end: where it
        is higher, the iteration goes on from there.
    """
    problem = _Problem(S, xy, yy, n, psi, ard_shape, ard_rate, common, root)
    joint, climb = False, _climb_plainly
    if accelerate:
        joint = root is not None or (n > xy.shape[0] and _has_digits(S))
        climb = partial(_climb, joint=joint)
    if accelerate and problem.latent.exact and common and n <= xy.shape[0]:
        return _highest_of_two(problem, climb, max_iter, tol, joint=joint)
    found = climb(problem, problem.start(fast=joint), max_iter, tol)
    if not (problem.latent.exact and n > xy.shape[0]):
        return found
    used = found.n_iter + 1
    other = problem.start_from_least_squares(fast=joint)
    if other.value > found.history[-1] and used < max_iter:
        found = climb(problem, other, max_iter - used, tol)
        return replace(found, n_iter=used + found.n_iter - 1)
    return replace(found, n_iter=used)


# Evaluations of the bound after which two ways up are compared.
_GLANCE = 100


def _highest_of_two(problem, climb, max_iter, tol, *, joint):
    """Go up from the exact fit or from the ridge solution, whichever gets higher.

    Fewer samples than inputs can be fitted exactly, or taken for noise altogether;
    often both are maxima, and the way from one to the other is long and flat.
    """
    glance = min(_GLANCE, max_iter)
    exact = climb(problem, problem.start_from_least_squares(fast=joint), glance, tol)
    noisy = climb(problem, problem.start(fast=joint), glance, tol)
    best = exact if exact.history[-1] > noisy.history[-1] else noisy
    used = exact.n_iter + noisy.n_iter
    if best.status != "max_iter" or used >= max_iter:
        return replace(best, n_iter=min(used, max_iter))
    make = problem.start_from_least_squares if best is exact else problem.start
    best = climb(problem, make(fast=joint), max_iter - used, tol)
    return replace(best, n_iter=used + best.n_iter)


# Steps and changes of the step that Anderson's method keeps (its usual number is 5 to
# 20; beyond that its least-squares problem is made of rounding).
_MEMORY = 20
# The iteration has settled where a step moves no precision and no noise by more than
# this share, far below what n samples determine, ...
_SETTLED = 1e-10
# ... or where steps have been no smaller for this many steps than they were: they are
# rounding then.
_PATIENCE = 15
# Longest extrapolation of a precision or the noise, as a logarithm.
_LARGEST_STRETCH = 5.0


class _Anderson:
    """Anderson's extrapolation of a fixed-point iteration (Walker and Ni, 2011)."""

    def __init__(self, n_logs):
        self.n_logs = n_logs
        self.points, self.steps = deque(maxlen=_MEMORY), deque(maxlen=_MEMORY)

    def forget(self):
        """Start again."""
        self.points.clear()
        self.steps.clear()

    def next(self, point, image):
        """Where to evaluate next, after `point` was mapped to `image`."""
        step = image - point
        self.points.append(point)
        self.steps.append(step)
        if len(self.steps) == 1:
            return image
        dx, df = (np.diff(np.array(x), axis=0) for x in (self.points, self.steps))
        share = np.linalg.lstsq(df.T, step, rcond=1e-10)[0]
        further = share @ (dx + df)
        # Coordinates are logarithms: beyond some powers of ten nothing is linear.
        if not np.abs(further[: self.n_logs]).max() < _LARGEST_STRETCH:
            self.forget()
            return image
        return image - further


def _verdict(problem, new, point, tol):
    """Judge a step: whether the bound fell, and whether it gained too little to go on.

    A gain within the residual's rounding is none, whatever `tol` asks for.
    """
    gain = new.value - point.value
    resolution = min(problem.resolution(new), problem.resolution(point))
    fell = not gain >= -rounding_of_bound(new.value, problem.n, resolution)
    return fell, abs(gain) <= problem.n * max(tol, rounding_of_fit(resolution))


def _solution(problem, point, history, used, status, fall=0.0):
    return CorrelatedSolution(
        state=point.state,
        latent=problem.latent,
        history=np.array(history),
        n_iter=used,
        status=status,
        fall=fall,
    )


def _climb_plainly(problem, point, max_iter, tol):
    """Iterate to the letter from one starting point."""
    history = [point.value]
    for used in range(2, max_iter + 1):
        new = problem.step(point, fast=False)
        fell, quiet = _verdict(problem, new, point, tol)
        if fell:
            fall = point.value - new.value
            return _solution(problem, point, history, used, "bound_decreased", fall)
        point = new
        history.append(point.value)
        if quiet:
            return _solution(problem, point, history, used, "converged")
    return _solution(problem, point, history, max_iter, "max_iter")


def _climb(problem, point, max_iter, tol, *, joint):
    """Iterate from one starting point to the fixed point.

    Where the bound gains less than `tol` the ends still differ by the length of a step,
    and rounding decides which step is the last. From there on (and from the start,
    where joint steps would lose digits) the plain iteration is extrapolated until its
    step is rounding: the end is the fixed point, whatever the order of the sums.
    """
    history, used, status = [point.value], 1, "max_iter"
    fast = joint
    anderson, at, smallest, idle = _Anderson(problem.d + 1), None, np.inf, 0
    while used < max_iter:
        start = point if at is None else problem.moved(point, at)
        new = problem.step(start, fast=fast)
        used += 1
        if fast and not new.value >= point.value:
            fast = False  # this once
            continue
        fell, quiet = _verdict(problem, new, point, tol)
        if fell and at is not None:
            # Extrapolated too far: from the best point on again.
            at = None
            anderson.forget()
            continue
        if fell:
            fall = point.value - new.value
            return _solution(problem, point, history, used, "bound_decreased", fall)
        # An extrapolated point may happen to gain nothing, on the way to another.
        status = "converged" if quiet else "max_iter"
        if not joint:
            here, there = problem.coordinates(start), problem.coordinates(new)
            length = np.abs(there - here)[: problem.d + 1].max()
            idle = 0 if length < 0.5 * smallest else idle + 1
            smallest = min(length, smallest)
            at = anderson.next(here, there)
        joint = joint and not quiet
        fast, point = joint, new
        history.append(point.value)
        if quiet and (smallest <= _SETTLED or idle >= _PATIENCE):
            break
    return _solution(problem, point, history, used, status)


def posterior_covariance(S, n, psi, solution, dof=np.inf):
    """Covariance of beta that counts the noise of the inputs' moments too.

    For known psi the corrected estimate has the asymptotic covariance (Fuller 1987,
    eq. 2.2.23, normal errors)

        (v G^-1 + G^-1 (v psi + psi beta beta' psi) G^-1) / n,
        v = psi_y + beta' psi beta,

    G being the covariance of the latent inputs, here with the prior's share added. With
    a psi that was estimated with `dof` degrees of freedom this rises by
    G^-1 (psi beta'psi beta + psi beta beta' psi) G^-1 / dof (the same, theorem 2.2.1).
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
    # Wishart: the covariance of psi beta for an estimated psi, times dof.
    estimated = (beta @ psi_beta) * psi + np.outer(psi_beta, psi_beta)
    cov = (v * G_inv + G_inv @ middle @ G_inv) / n + G_inv @ estimated @ G_inv / dof
    return 0.5 * (cov + cov.T)
