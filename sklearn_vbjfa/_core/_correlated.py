"""Regression with correlated latent inputs and known input-noise covariance.

t ~ N(0, Sigma_t),  x = t + e_x,  e_x ~ N(0, Psi),  y = beta't + b'e_x + e_y,
e_y ~ N(0, psi_y),  beta_m ~ N(0, 1/alpha_m),  alpha_m ~ Gamma,

with Psi and b known and the posterior q(T) q(beta) q(alpha), from n, S_xx, S_xy and
S_yy at O(d^3) an iteration. Psi = 0 is Bayesian linear regression with automatic
relevance determination; b is what noise of the inputs does to the output directly,
b = 0 unless they have noise in common. Tags such as [C6] are equations of the guide.
"""

import functools
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.linalg import lapack
from scipy.special import digamma

from sklearn_vbjfa._core._linear_systems import ROUNDING, scaled_eigen, svd
from sklearn_vbjfa._core._moments import SquareRoot
from sklearn_vbjfa._core._solver import (
    ENOUGH,
    LARGEST_LOG,
    PlainSteps,
    Solution,
    climb,
    rounding_of_bound,
    rounding_of_fit,
)
from sklearn_vbjfa._core._updates import LOG_2PI, precision_bound


@dataclass(frozen=True, kw_only=True)
class Latent:
    """Gaussian of the latent inputs: H, P, Sigma_t and more, all (d, d)."""

    # E[t | x] = H x, Cov[t | x] = P, Cov[t] = Sigma_t. With ``exact`` the noise is zero
    # and t is x; ``clipped`` are the eigenvalues of S/n - Psi that were negative.

    H: np.ndarray
    P: np.ndarray
    Sigma_t: np.ndarray
    exact: bool
    clipped: np.ndarray


def infer_latent(S, n, psi, floor=1e-12):
    """Split the scatter (d, d) of x into latent and noise, [C1] to [C3]."""
    # No latent signal is left in directions where psi exceeds S.
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
    eigen = scaled_eigen(covariance - psi, 0.0, scale=1.0)
    clipped = eigen.values[eigen.values < -floor * max(eigen.values[-1], 0.0)]
    Sigma_t = eigen.matrix()  # [C1]
    total = Sigma_t + psi
    # Exactly redundant columns make `total` singular; the pseudo-inverse is restricted
    # to the span of the data, which always contains x.
    H = Sigma_t @ scaled_eigen(total, floor, scale=1.0).inverse()  # [C2]
    P = Sigma_t - H @ Sigma_t  # [C3]
    P = 0.5 * (P + P.T)
    return Latent(H=H, P=P, Sigma_t=Sigma_t, exact=False, clipped=clipped)


@dataclass(frozen=True, kw_only=True)
class LatentSums:
    """Sums of <tt'> (d, d), <t> y (d,) and y^2, and the data part of the bound."""

    # y: the output without its share of the noise of the inputs

    S_tt: np.ndarray
    S_ty: np.ndarray
    yy: float
    bound: float


def _given_beta(latent, cov, s2=1.0):
    """H, P (d, d) and log det(I + P_0 C / psi_y), beta of covariance C (d, d), [C4]."""
    d = cov.shape[0]
    A = latent.P @ cov / s2
    A[np.diag_indices(d)] += 1.0
    # SciPy's own function checks for longer than such small systems take.
    lu, _, both, failed = lapack.dgesv(A, np.hstack([latent.H, latent.P]))  # [C4]
    if failed:
        raise linalg.LinAlgError("the precision of the latent inputs is singular")
    H, P = both[:, :d], both[:, d:]
    logdet = np.log(np.abs(np.diagonal(lu))).sum()
    return H, 0.5 * (P + P.T), logdet


def expect_latent(moments, latent, state):
    """E-step over T: the sums and the data part of the bound, [C4] to [C7], [C12]."""
    n, xy, yy = moments.n, moments.xy, moments.yy
    S, beta, s2 = moments.S, state.beta_mean, state.psi_y
    if latent.exact:
        residual = yy - 2 * beta @ xy + beta @ S @ beta
        spread = float(np.einsum("ij,ji->", state.beta_cov, S))
        value = -0.5 * (n * (LOG_2PI + np.log(s2)) + (residual + spread) / s2)  # [C12]
        return LatentSums(S_tt=S, S_ty=xy, yy=yy, bound=value)
    # The uncertainty of beta acts as additional precision beta_cov / s2 on t.
    H, P, logdet = _given_beta(latent, state.beta_cov, s2)
    P_beta = P @ beta
    q = s2 + beta @ P_beta  # [C5]
    k = P_beta / q  # [C5]
    c = H.T @ beta  # [C5]
    S_c = S @ c
    S_xe = xy - S_c
    S_ee = yy - 2 * c @ xy + c @ S_c
    HS = H @ S
    H_xe = H @ S_xe
    # Half of it, and the other half is its transpose.
    half = 0.5 * (HS @ H.T + n * P)
    half += np.outer(H_xe + 0.5 * (S_ee - n * q) * k, k)
    S_tt = half + half.T  # [C6]
    S_ty = H @ xy + k * (yy - c @ xy)  # [C7]
    cost = np.vdot(state.beta_cov, HS @ latent.H.T) / s2
    value = -0.5 * (n * (LOG_2PI + np.log(q) + logdet) + S_ee / q + cost)  # [C12]
    return LatentSums(S_tt=S_tt, S_ty=S_ty, yy=yy, bound=float(value))


# Newton steps to the joint maximum of mean and noise; it is close from the second
# iteration on, and the outer loop continues where this one stops.
_NEWTON_STEPS = 20


def precisions_given_others(mean, variance, alpha, shape0, rate0):
    """E[alpha_m] (d,) to which the updates of alpha_m and beta_m converge, [C14]."""
    # mean, variance (d,): posterior of beta under `alpha` (d,), which give s and q
    # (Tipping and Faul, 2003). The plain update increases with alpha, so it converges
    # to the nearest root in the direction in which it moves: that is returned.
    total = 2 * shape0 + 1.0
    # An uninformative input has s = 0, to rounding.
    s = np.maximum(1.0 / variance - alpha, np.finfo(float).eps / variance)
    strength = (mean / variance) ** 2 / s
    rate = 2 * rate0 * s
    # [C14] in v = s / alpha: total v^3 = (rate + strength + 1 - 2 total) v^2
    #                                    + (2 rate - 2 a0) v + rate
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
    """Best output noise when the covariance of beta scales with it, [C15]."""
    # squares: squared residual at the mean; penalty: sum of alpha_m cov_mm / psi_y.
    half = 0.5 * (n - d)
    root = np.sqrt(half * half + penalty * squares)  # [C15]
    if half > 0:
        return squares / (half + root)
    return (root - half) / penalty


def mean_and_noise(moments, latent, G, start, alpha, centre=0.0):
    """Best mean (d,) of beta and output noise together, q(T) at its optimum, [C16]."""
    # centre: of the prior, a number or (d,).
    # Given G = cov / psi_y (d, d). Newton's method in (beta, log psi_y) with the
    # magnitudes of the eigenvalues, which makes each step an ascent; `start` is a mean
    # and a noise, `alpha` (d,) the precisions of the prior.
    n, xy, yy = moments.n, moments.xy, moments.yy
    mean, noise = start
    d = mean.size
    H, P, _ = _given_beta(latent, G)
    K, k = H @ moments.S @ H.T, H @ xy
    penalty = alpha @ np.diagonal(G)

    def value(mean, log_noise):
        s2 = np.exp(log_noise)
        q = s2 + mean @ P @ mean
        if not q > 0:  # rounding of P, where there is hardly any noise
            return -np.inf
        squares = yy - 2 * mean @ k + mean @ K @ mean
        data = n * np.log(q) + squares / q
        prior = alpha @ (mean - centre) ** 2 + penalty * s2
        return -0.5 * (data + prior - d * log_noise)  # [C16]

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
            on_q * w + r / q - alpha * (mean - centre),
            on_q * s2 + 0.5 * (d - penalty * s2),
        )
        cross = np.outer(w, r) / q**2
        curvature[:d, :d] = K / q - 2 * on_q * P - on_qq * np.outer(w, w)
        curvature[:d, :d] += cross + cross.T + np.diag(alpha)
        curvature[:d, d] = curvature[d, :d] = s2 * (r / q**2 - on_qq * w)
        curvature[d, d] = 0.5 * penalty * s2 - on_q * s2 - on_qq * s2**2
        unit = np.sqrt(np.append(np.diagonal(K) / q + alpha, 0.5 * n))
        step = scaled_eigen(curvature, scale=unit).by_magnitude().solve(gradient)
        promised = gradient @ step
        # The exponential of the log noise must not overflow.
        length = min(1.0, LARGEST_LOG / max(abs(step[d]), 1.0))
        while True:
            trial = mean + length * step[:d], log_noise + length * step[d]
            new = value(*trial)
            if new >= best + ENOUGH * length * promised:
                break
            length *= 0.5
            if length * promised <= np.finfo(float).eps * n:
                return mean, float(np.exp(log_noise))
        (mean, log_noise), best = trial, new
    return mean, float(np.exp(log_noise))


# Smallest output noise, as a share of the variance of y, that second moments resolve
# above rounding: the residual is a difference of sums of products.
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
    """Prior part of the bound, [C13]."""
    shape, rate = state.alpha_shape, state.alpha_rate
    E_alpha, E_log = state.E_alpha, digamma(shape) - np.log(rate)
    square = state.beta_mean**2 + np.diagonal(state.beta_cov)
    loadings = 0.5 * (E_log - E_alpha * square + 1.0)
    precisions = precision_bound(shape, rate, shape0, rate0)
    # A precision that `shared` coefficients have in common counts once.
    return float((loadings + precisions / shared).sum()) + 0.5 * logdet_cov  # [C13]


def square_root(S, xy, yy):
    """Square root of second moments, without the rounding of their null space."""
    # What is left of the diagonal below rounding is set to zero: otherwise it would act
    # as information once the noise is small enough.
    d = xy.size
    largest = np.abs(np.diagonal(S)).max(initial=0.0)
    # With pivots, what rounding leaves comes last.
    factor, pivots, rank, _ = lapack.dpstrf(S, tol=d * ROUNDING * largest)
    order = pivots - 1
    R = np.empty((rank, d))
    R[:, order] = np.triu(factor[:rank])
    z = linalg.solve_triangular(factor[:rank, :rank], xy[order[:rank]], trans="T")
    return SquareRoot(R=R, z=z, rest=max(yy - z @ z, 0.0))


# Where rounding of S_tt / s2 stays below this share of the prior precision, the
# Cholesky factor of the posterior precision is safe.
_SAFE_ROUNDING = 1e-8
_HALF_DIGITS = np.sqrt(np.finfo(float).eps)


@dataclass(frozen=True, kw_only=True)
class BetaPosterior:
    """Mean (d,), covariance (d, d), its log-determinant, and <|y - beta't|^2>."""

    mean: np.ndarray
    cov: np.ndarray
    logdet: float
    squares: float


def posterior_beta(S_tt, S_ty, yy, s2, alpha, square_root, *, always=False):
    """Posterior of beta from the sums over t, [C8], [C9], [C11]."""
    # ``square_root()`` returns that of the moments; it is called only if needed, or
    # always.
    prior = 1.0 / np.sqrt(alpha)
    d = prior.size
    largest = (np.diagonal(S_tt) / alpha).max() / s2
    if np.finfo(float).eps * d * largest < _SAFE_ROUNDING and not always:
        A = S_tt * np.outer(prior, prior) / s2
        A[np.diag_indices_from(A)] += 1.0
        factor, failed = lapack.dpotrf(A)
        if failed:
            raise linalg.LinAlgError(f"leading minor {failed} is not positive definite")
        scaled = prior[:, None] * lapack.dtrtri(factor)[0]
        cov = scaled @ scaled.T  # [C8]
        mean = scaled @ (scaled.T @ S_ty) / s2  # [C9]
        logdet = -2 * np.log(np.diagonal(factor)).sum() - np.log(alpha).sum()
        squares = yy - 2 * mean @ S_ty + mean @ S_tt @ mean
        squares += np.einsum("ij,ij->", cov, S_tt)  # [C11]
    else:
        # The same in the singular coordinates of R, where nothing cancels.
        root = square_root()
        U, sv, Vt = svd(root.R * prior, full_matrices=False)
        # Singular values at rounding level are set to zero: with hardly any noise they
        # would act as information.
        keep = sv > sv[:1] * max(root.R.shape) * np.finfo(float).eps
        U, sv, Vt = U[:, keep], sv[keep], Vt[keep]
        share = s2 / (s2 + sv**2)
        Uz = U.T @ root.z
        mean = prior * (Vt.T @ (sv / (s2 + sv**2) * Uz))  # [C9]
        cov = (Vt.T * share) @ Vt
        if sv.size < d:
            # The projector onto the rest, squared: its diagonal must not be negative.
            others = np.eye(d) - Vt.T @ Vt
            cov += others @ others.T
        cov *= np.outer(prior, prior)  # [C8]
        logdet = np.log(share).sum() - np.log(alpha).sum()
        outside = root.z - U @ Uz
        squares = root.rest + outside @ outside
        squares += np.sum((share * Uz) ** 2) + share @ sv**2  # [C11]
    return BetaPosterior(
        mean=mean, cov=cov, logdet=float(logdet), squares=float(squares)
    )


@dataclass(frozen=True, kw_only=True)
class CorrelatedPoint:
    """A state with everything the next step needs, and its bound."""

    state: CorrelatedState
    logdet: float
    precisions: np.ndarray  # under which the posterior of beta was taken
    sums: LatentSums
    value: float


class CorrelatedProblem:
    """The moments, and the steps from one state to the next."""

    # With exact inputs the square root of the moments is used if there is one: it is
    # more accurate. psi (d, d) is the input-noise covariance; ard_shape and ard_rate
    # are the Gamma prior of the precisions; `common`: one precision for all
    # coefficients. direct (d,): b above, or None. With y - b'x in place of y it is the
    # same problem for beta - b, up to the prior.

    def __init__(self, moments, psi, *, ard_shape, ard_rate, common, direct=None):
        self.moments, self.n, self.rest = moments, moments.n, moments
        self.direct = np.zeros(moments.xy.size) if direct is None else direct
        if self.direct.any():
            self.rest = moments.less(self.direct)
        self.latent = infer_latent(moments.S, moments.n, psi)
        self.ard_shape, self.ard_rate, self.common = ard_shape, ard_rate, common
        self.d = moments.xy.shape[0]
        self.shared = self.d if common else 1
        # With exact inputs S_tt is S throughout: one decomposition serves all.
        self.root = moments.root if self.latent.exact else None
        self.given = self.root is not None
        self.floor = FACTOR_FLOOR if self.given else OUTPUT_FLOOR

    def root_of(self, sums):
        """Square root of the latent moments, made once where the inputs are exact."""
        if not self.latent.exact:
            return square_root(sums.S_tt, sums.S_ty, sums.yy)
        if self.root is None:
            m = self.moments
            self.root = square_root(m.S, m.xy, m.yy)
        return self.root

    def start(self, *, fast):
        """Ridge solution with <alpha> = 1, as in the paper, and all of y as noise."""
        return self._start_from(np.ones(self.d), self.moments.yy / self.n, fast=fast)

    def start_from_least_squares(self, *, fast):
        """Posterior with the precisions and the noise of least squares."""
        # From the ridge solution, directions with a tiny share of the inputs' variance
        # are not found, even if y depends on them with hardly any noise.
        root = self.root_of(self._observed())
        beta = np.linalg.lstsq(root.R, root.z, rcond=None)[0]
        left = root.z - root.R @ beta
        square = np.full(self.d, np.mean(beta**2)) if self.common else beta**2
        shape = self.ard_shape + 0.5 * self.shared
        alpha = shape / (self.ard_rate + 0.5 * self.shared * square)
        return self._start_from(alpha, (left @ left + root.rest) / self.n, fast=fast)

    def _observed(self):
        """Return sums with the observed inputs in place of the latent ones."""
        m = self.moments
        return LatentSums(S_tt=m.S, S_ty=m.xy, yy=m.yy, bound=np.nan)

    def _expected(self, state):
        """E-step over T, [C21]."""
        if not self.direct.any():
            return expect_latent(self.moments, self.latent, state)
        beyond = replace(state, beta_mean=state.beta_mean - self.direct)
        found = expect_latent(self.rest, self.latent, beyond)
        S_ty = found.S_ty + found.S_tt @ self.direct  # [C21]
        return replace(found, S_ty=S_ty, yy=self._yy(found.S_tt, S_ty))

    def _yy(self, S_tt, S_ty):
        """Square sum of the output without its share of the inputs' noise, [C21]."""
        b = self.direct
        return self.rest.yy + 2 * b @ S_ty - b @ S_tt @ b

    def _start_from(self, alpha, s2, *, fast):
        s2 = max(s2, self.floor)
        shape = self.ard_shape + 0.5 * self.shared  # [C10]
        beta = self._posterior(self._observed(), s2, alpha)
        spread = self.d - alpha @ np.diagonal(beta.cov)
        if fast:
            beta, s2 = self._joint(beta, s2, alpha)
        state = CorrelatedState(
            beta_mean=beta.mean,
            beta_cov=beta.cov,
            alpha_shape=shape,
            alpha_rate=shape / alpha,
            psi_y=s2,
        )
        return self.evaluate(state, beta.logdet, alpha, spread)

    def _posterior(self, sums, s2, alpha):
        return posterior_beta(
            sums.S_tt,
            sums.S_ty,
            sums.yy,
            s2,
            alpha,
            lambda: self.root_of(sums),
            always=self.given,
        )

    def _joint(self, beta, s2, alpha):
        """Maximise over the noise, and with it the mean, at a fixed cov / psi_y."""
        G, mean = beta.cov / s2, beta.mean
        penalty = alpha @ np.diagonal(G)
        if self.latent.exact:
            # tr(cov S) = s2 (d - alpha'diag(cov))
            fit = max(beta.squares - s2 * (self.d - s2 * penalty), 0.0)
            new = noise_given_shape(fit, self.n, self.d, penalty)
        else:
            start, centre = (mean - self.direct, s2), -self.direct
            mean, new = mean_and_noise(self.rest, self.latent, G, start, alpha, centre)
            mean = mean + self.direct
        new = max(new, self.floor)
        logdet = beta.logdet + self.d * np.log(new / s2)
        return replace(beta, mean=mean, cov=G * new, logdet=logdet), new

    def step(self, point, *, fast=False):
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
        beta = self._posterior(point.sums, s2, alpha)
        spread = self.d - alpha @ np.diagonal(beta.cov)
        if fast:
            beta, s2 = self._joint(beta, s2, alpha)
        else:
            spread *= s2 / max(beta.squares / self.n, self.floor)
            s2 = max(beta.squares / self.n, self.floor)  # [C11]
        square = beta.mean**2 + np.diagonal(beta.cov)
        if self.common:
            square = np.full(self.d, square.sum())
        new = CorrelatedState(
            beta_mean=beta.mean,
            beta_cov=beta.cov,
            alpha_shape=state.alpha_shape,
            alpha_rate=self.ard_rate + 0.5 * square,  # [C10]
            psi_y=s2,
        )
        return self.evaluate(new, beta.logdet, alpha, spread)

    def evaluate(self, state, logdet, precisions, spread):
        """E-step over T, and the bound."""
        # logdet: of the covariance of beta, which was taken under `precisions` (d,);
        # spread: tr(cov S) / psi_y with exact inputs.
        sums = self._expected(state)
        if self.given:
            # The squared residual of the factor instead of a difference of moments,
            # and the identity tr(cov S) = s2 (d - alpha'diag(cov)), in which the huge
            # variances of directions with little information do not cancel.
            left = self.root.z - self.root.R @ state.beta_mean
            data = self.n * (LOG_2PI + np.log(state.psi_y)) + spread
            data += (left @ left + self.root.rest) / state.psi_y
            sums = replace(sums, bound=-0.5 * float(data))  # [C12]
        value = sums.bound + _prior_bound(
            state, self.ard_shape, self.ard_rate, logdet, self.shared
        )
        return CorrelatedPoint(
            state=state, logdet=logdet, precisions=precisions, sums=sums, value=value
        )

    def judge(self, point, new, tol):
        """Whether a step lowered the bound, and whether its gain was negligible."""
        # A gain within the residual's rounding is negligible, whatever `tol`.
        gain = new.value - point.value
        resolution = min(self._resolution(new), self._resolution(point))
        fell = not gain >= -rounding_of_bound(new.value, self.n, resolution)
        return fell, abs(gain) <= self.n * max(tol, rounding_of_fit(resolution))

    def _resolution(self, point):
        """Output variance relative to the terms that cancel in the residual."""
        size = np.linalg.norm(point.state.beta_mean)
        if self.given:
            # The residual itself is rounded, in units of the terms that cancel in it.
            return np.sqrt(point.state.psi_y) / (1.0 + size)
        # Its square is, a difference of products.
        return point.state.psi_y / (1.0 + size**2)

    def coordinates(self, point):
        """Return what the next plain step depends on, log alpha and log s2 first."""
        # (d + 1,), or (d + 1 + d (d + 1) / 2 + d,) with noisy inputs: each entry of the
        # upper triangle with the length of both that it stands for.
        state, sums = point.state, point.sums
        parts = [np.log(state.E_alpha), [np.log(state.psi_y)]]
        if not self.latent.exact:
            places, length = self._triangle
            upper = sums.S_tt.ravel()[places] * (length / self.n)
            parts += [upper, sums.S_ty / self.n]
        return np.concatenate(parts)

    @functools.cached_property
    def _triangle(self):
        """Places of the upper triangle in a flat (d, d), and lengths of its entries."""
        i, j = np.triu_indices(self.d)
        return i * self.d + j, np.where(i == j, 1.0, np.sqrt(2.0))

    def moved(self, point, vector):
        """Return a point with these coordinates, to make a plain step from."""
        d, state = self.d, point.state
        logs = np.clip(vector[: d + 1], -LARGEST_LOG, LARGEST_LOG)
        state = replace(
            state,
            alpha_rate=state.alpha_shape * np.exp(-logs[:d]),
            psi_y=max(float(np.exp(logs[d])), self.floor),
        )
        sums = point.sums
        if not self.latent.exact:
            places, length = self._triangle
            S_tt = np.zeros((d, d))
            S_tt.ravel()[places] = vector[d + 1 : -d] * (self.n / length)
            S_tt += np.triu(S_tt, 1).T
            S_ty = self.n * vector[-d:]
            sums = replace(sums, S_tt=S_tt, S_ty=S_ty, yy=self._yy(S_tt, S_ty))
        return replace(point, state=state, sums=sums)


# Steps kept by Anderson's method (usually 5 to 20; with more, rounding dominates its
# least-squares problem).
_MEMORY = 20
# The iteration has settled where a step moves no precision and no noise by more than
# this share, far below what n samples determine, ...
_SETTLED = 1e-10
# ... or where steps have not shrunk for this many iterations: they are rounding.
_PATIENCE = 15
# Largest extrapolation of a precision or the noise, as a logarithm.
_LARGEST_STRETCH = 5.0


class _Anderson:
    """Anderson's extrapolation of a fixed-point iteration (Walker and Ni, 2011)."""

    def __init__(self, n_logs):
        self.n_logs, self.last = n_logs, None
        # Differences of images and of steps, from one to the next.
        self.images, self.steps = deque(maxlen=_MEMORY - 1), deque(maxlen=_MEMORY - 1)

    def forget(self):
        """Start again."""
        self.last = None
        self.images.clear()
        self.steps.clear()

    def next(self, point, image):
        """Return the next point to evaluate, after `point` was mapped to `image`."""
        step, before = image - point, self.last
        self.last = image, step
        if before is None:
            return image
        self.images.append(image - before[0])
        self.steps.append(step - before[1])
        share = np.linalg.lstsq(np.array(self.steps).T, step, rcond=1e-10)[0]
        further = share @ np.array(self.images)
        # Coordinates are logarithms: over many decades the map is not linear.
        if not np.abs(further[: self.n_logs]).max() < _LARGEST_STRETCH:
            self.forget()
            return image
        return image - further


class FixedPointSteps(PlainSteps):
    """Steps to the fixed point: joint maxima, and extrapolated plain steps."""

    # When the bound gains less than `tol`, end points still differ by the length of a
    # step, and rounding decides which is the last. From there on (or from the start, if
    # joint steps would lose digits) the plain iteration is extrapolated until its steps
    # are rounding: the result is the fixed point, whatever the order of summation.

    def __init__(self, problem, tol, *, joint):
        super().__init__(problem, tol)
        self.joint = self.fast = joint
        self.anderson, self.at = _Anderson(problem.d + 1), None
        self.smallest, self.idle = np.inf, 0

    def propose(self, point, budget):
        """Return a new point, or None where a joint step does not raise the bound."""
        problem = self.problem
        self.start = point if self.at is None else problem.moved(point, self.at)
        new = problem.step(self.start, fast=self.fast)
        if self.fast and not new.value >= point.value:
            self.fast = False  # for this step only
            return None, 1
        return new, 1

    def retry(self):
        """After a fall: the extrapolation overshot, restart from the best point."""
        extrapolated, self.at = self.at is not None, None
        if extrapolated:
            self.anderson.forget()
        return extrapolated

    def accept(self, point, new, quiet):
        """Take a step; return whether it is the last."""
        # An extrapolated point may happen to gain nothing on the way.
        self.converged = quiet
        if not self.joint:
            here = self.problem.coordinates(self.start)
            there = self.problem.coordinates(new)
            length = np.abs(there - here)[: self.problem.d + 1].max()
            self.idle = 0 if length < 0.5 * self.smallest else self.idle + 1
            self.smallest = min(length, self.smallest)
            self.at = self.anderson.next(here, there)
        self.fast = self.joint = self.joint and not quiet
        return quiet and (self.smallest <= _SETTLED or self.idle >= _PATIENCE)


@dataclass(frozen=True, kw_only=True)
class CorrelatedSolution(Solution):
    """Result of the iteration, with the latent inputs of the model."""

    latent: Latent
    direct: np.ndarray  # (d,): what noise of the inputs does to the output directly

    @property
    def beyond(self):
        """Coefficients (d,) of the output without that."""
        return self.state.beta_mean - self.direct


def solve_correlated(
    moments,
    psi,
    *,
    max_iter,
    tol,
    common=False,
    cross=None,
    ard_shape=1e-6,
    ard_rate=1e-6,
):
    """Fit the model to standardised moments, with the input noise psi (d, d)."""
    # cross (d,): covariance of the noise of the inputs with that of the output.
    # Joint maximisation over blocks that the plain iteration updates in turn (if the
    # moments have a square root, or S exceeds rounding by half of the digits in all
    # directions) and Anderson extrapolation; a step that does not raise the bound is
    # replaced by the plain one. With exact inputs the bound at least squares is checked
    # at the end; if it is higher, the iteration continues from there.
    problem = CorrelatedProblem(
        moments,
        psi,
        ard_shape=ard_shape,
        ard_rate=ard_rate,
        common=common,
        direct=None if cross is None else direct_share(psi, cross),
    )
    more = moments.n > problem.d  # samples than inputs
    joint = moments.root is not None or (more and _has_digits(moments))

    def up(point, most):
        found = climb(FixedPointSteps(problem, tol, joint=joint), point, most)
        return CorrelatedSolution(
            latent=problem.latent, direct=problem.direct, **vars(found)
        )

    found = up(problem.start(fast=joint), max_iter)
    if not (problem.latent.exact and more):
        return found
    used = found.n_iter + 1
    other = problem.start_from_least_squares(fast=joint)
    if other.value > found.history[-1] and used < max_iter:
        found = up(other, max_iter - used)
        return replace(found, n_iter=used + found.n_iter - 1)
    return replace(found, n_iter=used)


def direct_share(psi, cross):
    """Coefficients (d,) of the inputs' noise in the output, psi b = cross."""
    return scaled_eigen(psi, ROUNDING * cross.size).solve(cross)


def _has_digits(moments):
    """Whether rounding is far below the smallest eigenvalue of S."""
    values = linalg.eigvalsh(moments.S)
    return bool(values[0] > _HALF_DIGITS * values[-1])


def posterior_covariance(n, psi, solution, dof=np.inf):
    """Covariance (d, d) of beta that includes noise in the inputs' moments, [C17]."""
    # psi (d, d) is known, or was estimated with `dof` degrees of freedom. With psi = 0
    # it is the posterior covariance of Bayesian regression.
    state = solution.state
    if solution.latent.exact:
        return state.beta_cov
    beta = solution.beyond
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
    # Wishart: the covariance of psi beta for an estimated psi, times dof. An estimated
    # covariance with the noise of the output adds that noise.
    noise = v if solution.direct.any() else beta @ psi_beta
    estimated = noise * psi + np.outer(psi_beta, psi_beta)
    cov = (v * G_inv + G_inv @ middle @ G_inv) / n
    cov += G_inv @ estimated @ G_inv / dof  # [C17]
    return 0.5 * (cov + cov.T)
