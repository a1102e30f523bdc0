"""Regression with correlated latent inputs and known input-noise covariance.

    t ~ N(0, Sigma_t),  x = t + e_x,  e_x ~ N(0, Psi),  y = beta't + e_y,
    e_y ~ N(0, psi_y),  beta_m ~ N(0, 1/alpha_m),  alpha_m ~ Gamma,

with Psi known and Sigma_t = psd(S - Psi) from the scatter S of x. Variational
posterior q(T) q(beta) q(alpha); everything follows from n, S, S_xy and S_yy, at
O(d^3) an iteration. With Psi = 0, t is x and this is Bayesian linear regression with
automatic relevance determination.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.special import digamma, gammaln

from sklearn_vbjfa._core._conditional import (
    mean_and_noise,
    noise_given_shape,
    precisions_given_others,
)
from sklearn_vbjfa._core._latent import (
    Latent,
    LatentSums,
    expect_latent,
    infer_latent,
)
from sklearn_vbjfa._core._solver import rounding_of_bound, rounding_of_fit
from sklearn_vbjfa._core._stats import SquareRoot

_LOG_2PI = float(np.log(2 * np.pi))

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
    values, vectors = linalg.eigh(S)
    keep = values > values[-1] * values.size * 4 * np.finfo(float).eps
    R = np.sqrt(values[keep])[:, None] * vectors[:, keep].T
    # y in the coordinates of R, whose rows are orthogonal
    z = (R @ xy) / np.einsum("ij,ij->i", R, R)
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
    accelerate=None,
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
    accelerate : bool, default=None
        Maximise the bound jointly over what the plain iteration updates in turn. A
        joint step that does not raise the bound is replaced by the plain one. Every
        evaluation of the bound counts as an iteration. None does so where `root` is
        given or the moments have the digits that joint steps need in all directions:
        where the smallest eigenvalue of S is half their digits above rounding.
        With exact inputs the bound of least squares is looked at in the end: where it
        is higher, the iteration goes on from there.
    """
    if accelerate is None:
        accelerate = root is not None or (n > xy.shape[0] and _has_digits(S))
    problem = _Problem(S, xy, yy, n, psi, ard_shape, ard_rate, common, root)
    found = _climb(problem, problem.start(fast=accelerate), max_iter, tol, accelerate)
    if not (problem.latent.exact and n > xy.shape[0]):
        return found
    used = found.n_iter + 1
    other = problem.start_from_least_squares(fast=accelerate)
    if other.value > found.history[-1] and used < max_iter:
        found = _climb(problem, other, max_iter - used, tol, accelerate)
        return replace(found, n_iter=used + found.n_iter - 1)
    return replace(found, n_iter=used)


def _climb(problem, point, max_iter, tol, accelerate):
    """Iterate from one starting point."""
    history, used = [point.value], 1
    status, fall = "max_iter", 0.0
    fast = accelerate
    while used < max_iter:
        new = problem.step(point, fast=fast)
        used += 1
        gain = new.value - point.value
        if fast and not gain >= 0:
            fast = False  # this once
            continue
        resolution = min(problem.resolution(new), problem.resolution(point))
        if gain < -rounding_of_bound(new.value, problem.n, resolution):
            status, fall = "bound_decreased", -gain
            break
        point, fast = new, accelerate
        history.append(point.value)
        # A gain within the residual's rounding is none, whatever `tol` asks for.
        if abs(gain) <= problem.n * max(tol, rounding_of_fit(resolution)):
            status = "converged"
            break
    return CorrelatedSolution(
        state=point.state,
        latent=problem.latent,
        history=np.array(history),
        n_iter=used,
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
