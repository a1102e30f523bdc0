"""Regression with correlated latent inputs and known input-noise covariance.

t ~ N(0, Sigma_t),  x = t + e_x,  e_x ~ N(0, Psi),  y = beta't + b'e_x + e_y,
e_y ~ N(0, psi_y),  beta_m ~ N(0, 1/alpha_m),  alpha_m ~ Gamma,

with Psi and b known and the posterior q(T) q(beta) q(alpha), from n, S_xx, S_xy and
S_yy at O(d^3) an iteration. Psi = 0 is Bayesian linear regression with automatic
relevance determination; b is the direct gain from the noise of the inputs to the
output, zero unless both share noise. Tags such as [C6] are equations of the guide.
"""

import functools
from collections import deque, namedtuple
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.linalg import lapack
from scipy.special import digamma

from sklearn_vbjfa._core._linear_systems import ROUNDING, scaled_eigen, svd
from sklearn_vbjfa._core._moments import OUTPUT_FLOOR, square_root
from sklearn_vbjfa._core._solver import (
    LARGEST_LOG,
    PlainSteps,
    Solution,
    climb,
    rounding_of_bound,
    rounding_of_fit,
)
from sklearn_vbjfa._core._updates import LOG_2PI, precision_bound

# Gaussian of the latent inputs, E[t | x] = H x, Cov[t | x] = P, Cov[t] = Sigma_t, all
# (d, d). With ``exact`` the noise is zero and t is x.
Latent = namedtuple("Latent", "H P Sigma_t exact")


# Eigenvalue, as a share of the largest, below which a direction has no data.
_SPAN = 1e-12


def infer_latent(S, n, psi):
    """Split the scatter (d, d) of x into latent and noise, [C1] to [C3]."""
    # No latent signal is left in directions where psi exceeds S.
    covariance = S / n
    d = covariance.shape[0]
    if not psi.any():
        return Latent(H=np.eye(d), P=np.zeros((d, d)), Sigma_t=covariance, exact=True)
    eigen = scaled_eigen(covariance - psi, 0.0, scale=1.0)
    Sigma_t = eigen.matrix()  # [C1]
    total = Sigma_t + psi
    # Exactly redundant columns make `total` singular; the pseudo-inverse is restricted
    # to the span of the data, which always contains x.
    H = Sigma_t @ scaled_eigen(total, _SPAN, scale=1.0).inverse()  # [C2]
    P = Sigma_t - H @ Sigma_t  # [C3]
    P = 0.5 * (P + P.T)
    return Latent(H=H, P=P, Sigma_t=Sigma_t, exact=False)


def _given_beta(latent, G):
    """`Latent` and log det(I + P_0 G), with beta of covariance psi_y G, [C4]."""
    if latent.exact:
        return latent, 0.0
    # The uncertainty of beta acts as additional precision G on t.
    d = G.shape[0]
    A = latent.P @ G
    A[np.diag_indices(d)] += 1.0
    lu, _, HP, failed = lapack.dgesv(A, np.hstack([latent.H, latent.P]))  # [C4]
    if failed:
        raise linalg.LinAlgError("the precision of the latent inputs is singular")
    P = HP[:, d:]
    logdet = np.log(np.abs(np.diagonal(lu))).sum()
    P = 0.5 * (P + P.T)
    return Latent(HP[:, :d], P, latent.Sigma_t, latent.exact), logdet


def likely_noise(squares, through, n, d, penalty, floor):
    """Output noise that maximises the bound for some mean and G, [C11]."""
    # squares: S_ee; through: beta'P beta; penalty: sum of alpha_m G_mm.
    square = np.array([1.0, 2 * through, through**2])
    cubic = penalty * np.append(square, 0.0) - d * np.append(0.0, square)
    roots = np.roots(cubic + [0.0, n, n * through - squares, 0.0])
    # The highest bound is at one of the real roots, or at the floor.
    s2 = np.maximum(roots.real, floor)
    q = s2 + through
    cost = n * np.log(q) + squares / q + penalty * s2 - d * np.log(s2)
    return float(s2[np.argmin(cost)])


# Smallest output noise, as a share of the variance of y, that a triangular factor of
# the rows resolves above rounding: its residual is a sum of squares.
_FACTOR_FLOOR = OUTPUT_FLOOR**2


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


# Where rounding of S_tt / s2 stays below this share of the prior precision, the
# Cholesky factor of the posterior precision is safe.
_SAFE_ROUNDING = 1e-8


def inverse_factor(A, prior, noise=1.0):
    """L with L L' = (A / noise + diag(1 / prior^2))^-1, and log det(L L' / prior^2)."""
    B = A * np.outer(prior, prior) / noise
    B[np.diag_indices_from(B)] += 1.0
    # SciPy's own functions check for longer than such small systems take.
    factor, failed = lapack.dpotrf(B)
    if failed:
        raise linalg.LinAlgError(f"leading minor {failed} is not positive definite")
    logdet = -2 * np.log(np.diagonal(factor)).sum()
    return prior[:, None] * lapack.dtrtri(factor)[0], float(logdet)


def _posterior_of_root(root, s2, prior):
    """Compute the same in the singular coordinates of a root, where nothing cancels."""
    d = prior.size
    U, sv, Vt = svd(root.R * prior, full_matrices=False)
    # Singular values at rounding level are set to zero: with hardly any noise they
    # would act as information.
    keep = sv > sv[:1] * max(root.R.shape) * np.finfo(float).eps
    U, sv, Vt = U[:, keep], sv[keep], Vt[keep]
    share = s2 / (s2 + sv**2)
    mean = prior * (Vt.T @ (sv / (s2 + sv**2) * (U.T @ root.z)))  # [C9]
    cov = (Vt.T * share) @ Vt
    if sv.size < d:
        # The projector onto the rest, squared: its diagonal must not be negative.
        others = np.eye(d) - Vt.T @ Vt
        cov += others @ others.T
    cov *= np.outer(prior, prior)  # [C8]
    logdet = np.log(share).sum() + 2 * np.log(prior).sum()
    return mean, cov, float(logdet)


# A state with its bound, and the sums of <tt'> (d, d) and <t> y (d,) that the next step
# needs.
CorrelatedPoint = namedtuple("CorrelatedPoint", "state value S_tt S_ty")


class CorrelatedProblem:
    """The moments, and the steps from one state to the next."""

    # psi (d, d) is the input-noise covariance; ard_shape and ard_rate are the Gamma
    # prior of the precisions; `common`: one precision for all coefficients. direct
    # (d,): b above, or None. With y - b'x in place of y it is the same problem for
    # beta - b, up to the prior. floor: least variance of the output noise.

    def __init__(
        self, moments, psi, *, ard_shape, ard_rate, common, direct=None, floor=0.0
    ):
        self.moments, self.n, self.rest = moments, moments.n, moments
        self.direct = np.zeros(moments.xy.size) if direct is None else direct
        if self.direct.any():
            self.rest = replace(moments, z=moments.z - moments.R @ self.direct)
        self.latent = infer_latent(moments.S, moments.n, psi)
        self.exact = self.latent.exact
        self.ard_shape, self.ard_rate, self.common = ard_shape, ard_rate, common
        self.d = moments.xy.shape[0]
        self.shared = self.d if common else 1
        self.floor = max(_FACTOR_FLOOR if self.exact else OUTPUT_FLOOR, floor)

    def start(self):
        """Ridge solution with <alpha> = 1, as in the paper, and all of y as noise."""
        return self._start_from(np.ones(self.d), self.moments.yy / self.n)

    def start_from_least_squares(self):
        """Posterior with the precisions and the noise of least squares."""
        # The ridge solution misses directions with a tiny share of the inputs' variance
        # even if y depends on them with very little noise.
        m = self.moments
        beta = np.linalg.lstsq(m.R, m.z, rcond=None)[0]
        square = np.full(self.d, np.mean(beta**2)) if self.common else beta**2
        shape = self.ard_shape + 0.5 * self.shared
        alpha = shape / (self.ard_rate + 0.5 * self.shared * square)
        return self._start_from(alpha, m.residual(beta)[1] / self.n)

    def _start_from(self, alpha, s2):
        s2 = max(s2, self.floor)
        shape = self.ard_shape + 0.5 * self.shared  # [C10]
        m = self.moments
        mean, cov, logdet = self._posterior(m.S, m.xy, s2, alpha)
        prior = {"alpha_shape": shape, "alpha_rate": shape / alpha, "psi_y": s2}
        state = CorrelatedState(beta_mean=mean, beta_cov=cov, **prior)
        return self.evaluate(state, logdet, self._spread(cov, alpha))

    def _posterior(self, S_tt, S_ty, s2, alpha):
        """Mean, covariance and its log-determinant of beta, [C8], [C9]."""
        prior = 1.0 / np.sqrt(alpha)
        largest = (np.diagonal(S_tt) / alpha).max() / s2
        if np.finfo(float).eps * self.d * largest >= _SAFE_ROUNDING:
            exact = self.exact
            root = self.moments if exact else square_root(self.n, S_tt, S_ty, 0.0)
            return _posterior_of_root(root, s2, prior)
        half, logdet = inverse_factor(S_tt, prior, s2)
        logdet -= np.log(alpha).sum()
        return half @ (half.T @ S_ty) / s2, half @ half.T, logdet

    def _spread(self, cov, alpha):
        """Return tr(cov S_tt) / psi_y of a posterior under precisions (d,)."""
        # Huge variances of directions with little information do not cancel in it.
        return self.d - alpha @ np.diagonal(cov)

    def step(self, point):
        """Do the M-steps: beta, the noise with the covariance of beta, alpha."""
        alpha, before = point.state.E_alpha, point.state.psi_y
        mean, cov, logdet = self._posterior(point.S_tt, point.S_ty, before, alpha)
        G, beta = cov / before, mean - self.direct
        given = latent, _ = _given_beta(self.latent, G)
        s2 = likely_noise(
            self.rest.residual(latent.H.T @ beta)[1],
            beta @ latent.P @ beta,
            self.n,
            self.d,
            alpha @ np.diagonal(G),
            self.floor,
        )
        square = mean**2 + s2 * np.diagonal(G)
        if self.common:
            square = np.full(self.d, square.sum())
        state = replace(
            point.state,
            beta_mean=mean,
            beta_cov=s2 * G,
            alpha_rate=self.ard_rate + 0.5 * square,  # [C10]
            psi_y=s2,
        )
        logdet = logdet + self.d * np.log(s2 / before)
        return self.evaluate(state, logdet, self._spread(cov, alpha), given)

    def evaluate(self, state, logdet, spread, given=None):
        """E-step over T, and the bound."""
        # logdet: of the covariance of beta; spread: see `_spread`; given: result of
        # `_given_beta`, or None.
        if self.exact:
            m, s2 = self.moments, state.psi_y
            squares = m.residual(state.beta_mean)[1]
            value = -0.5 * (self.n * (LOG_2PI + np.log(s2)) + squares / s2 + spread)
            S_tt, S_ty, value = m.S, m.xy, float(value)  # [C12]
        else:
            given = given or _given_beta(self.latent, state.beta_cov / state.psi_y)
            S_tt, S_ty, value = self._expected(state, *given)
        value += _prior_bound(state, self.ard_shape, self.ard_rate, logdet, self.shared)
        return CorrelatedPoint(state, value, S_tt, S_ty)

    def _expected(self, state, latent, logdet):
        """E-step over T with noisy inputs, [C5] to [C7], [C12], [C18]."""
        n, m, H = self.n, self.rest, latent.H
        beta, s2 = state.beta_mean - self.direct, state.psi_y
        P_beta = latent.P @ beta
        q = s2 + beta @ P_beta  # [C5]
        k = P_beta / q  # [C5]
        c = H.T @ beta  # [C5]
        S_xe, S_ee = m.residual(c)
        HS = H @ m.S
        # Half of it, and the other half is its transpose.
        half = 0.5 * (HS @ H.T + n * latent.P)
        half += np.outer(H @ S_xe + 0.5 * (S_ee - n * q) * k, k)
        S_tt = half + half.T  # [C6]
        S_ty = H @ m.xy + k * (m.yy - c @ m.xy)  # [C7]
        cost = np.vdot(state.beta_cov, HS @ self.latent.H.T) / s2
        value = n * (LOG_2PI + np.log(q) + logdet) + S_ee / q + cost
        # [C18], [C12]
        return S_tt, S_ty + S_tt @ self.direct, -0.5 * float(value)

    def judge(self, point, new, tol, **slack):
        """Whether a step lowered the bound, and whether its gain was negligible."""
        # A gain within the residual's rounding is negligible, whatever `tol`.
        gain = new.value - point.value
        resolution = min(self._resolution(new), self._resolution(point))
        fell = not gain >= -rounding_of_bound(new.value, self.n, resolution, **slack)
        return fell, abs(gain) <= self.n * max(tol, rounding_of_fit(resolution))

    def _resolution(self, point):
        """Output variance relative to the terms that cancel in the residual."""
        size = np.linalg.norm(point.state.beta_mean)
        if self.exact:
            # The residual itself is rounded, in units of the terms that cancel in it.
            return np.sqrt(point.state.psi_y) / (1.0 + size)
        # Its square is, a difference of products.
        return point.state.psi_y / (1.0 + size**2)

    def coordinates(self, point):
        """Return what the next step depends on, log alpha and log s2 first."""
        # (d + 1,), or (d + 1 + d (d + 1) / 2 + d,) with noisy inputs: each entry of the
        # upper triangle with the length of both that it stands for.
        parts = [np.log(point.state.E_alpha), [np.log(point.state.psi_y)]]
        if not self.exact:
            places, length = self._triangle
            upper = point.S_tt.ravel()[places] * (length / self.n)
            parts += [upper, point.S_ty / self.n]
        return np.concatenate(parts)

    @functools.cached_property
    def _triangle(self):
        """Places of the upper triangle in a flat (d, d), and lengths of its entries."""
        i, j = np.triu_indices(self.d)
        return i * self.d + j, np.where(i == j, 1.0, np.sqrt(2.0))

    def moved(self, point, vector):
        """Return a point with these coordinates, to make a step from."""
        d, state = self.d, point.state
        logs = np.clip(vector[: d + 1], -LARGEST_LOG, LARGEST_LOG)
        state = replace(
            state,
            alpha_rate=state.alpha_shape * np.exp(-logs[:d]),
            psi_y=max(float(np.exp(logs[d])), self.floor),
        )
        if self.exact:
            return CorrelatedPoint(state, point.value, point.S_tt, point.S_ty)
        places, length = self._triangle
        S_tt = np.zeros((d, d))
        S_tt.ravel()[places] = vector[d + 1 : -d] * (self.n / length)
        S_tt += np.triu(S_tt, 1).T
        return CorrelatedPoint(state, point.value, S_tt, self.n * vector[-d:])


# Steps kept by Anderson's method (usually 5 to 20; more cost more than they save).
_MEMORY = 10
# The iteration stops if a step changes no precision and no noise by more than this
# share, far below what n samples determine, ...
_SETTLED = 1e-10
# ... or if steps have not shrunk for this many iterations: they are rounding errors.
_PATIENCE = 60
# An extrapolation that lowers the bound by more than this share of it overshot.
_OVERSHOT = 1e-12
# Largest extrapolation of a precision or the noise, as a logarithm.
_LARGEST_STRETCH = 5.0


class FixedPointSteps(PlainSteps):
    """Steps that Anderson's method extrapolates (Walker and Ni, 2011)."""

    # If the iteration stopped when the bound gains less than `tol`, rounding would
    # decide which step is the last. The steps continue down to rounding level, so that
    # the result is the fixed point for any order of summation.

    def __init__(self, problem, tol):
        super().__init__(problem, tol)
        self.n_logs, self.last, self.at = problem.d + 1, None, None
        # More differences than coordinates are linearly dependent: old ones would weigh
        # as much as new ones.
        most = min(_MEMORY, self.n_logs) if problem.exact else _MEMORY
        # Differences of images and of steps, from one to the next.
        self.images, self.steps = deque(maxlen=most - 1), deque(maxlen=most - 1)
        self.smallest, self.idle = np.inf, 0

    def forget(self):
        self.last = None
        self.images.clear()
        self.steps.clear()

    def _extrapolated(self, point, image):
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

    def propose(self, point, budget):
        self.start = point if self.at is None else self.problem.moved(point, self.at)
        return self.problem.step(self.start), 1

    def judge(self, point, new):
        slack = {} if self.at is None else {"relative": _OVERSHOT}
        return self.problem.judge(point, new, self.tol, **slack)

    def retry(self):
        """Restart from the best point if the extrapolation overshot."""
        extrapolated, self.at = self.at is not None, None
        if extrapolated:
            self.forget()
        return extrapolated

    def accept(self, point, new, quiet):
        # An extrapolated step may gain nothing before convergence.
        self.converged = quiet
        here = self.problem.coordinates(self.start)
        there = self.problem.coordinates(new)
        length = np.abs(there - here)[: self.n_logs].max()
        self.idle = 0 if length < 0.5 * self.smallest else self.idle + 1
        self.smallest = min(length, self.smallest)
        self.at = self._extrapolated(here, there)
        return quiet and (self.smallest <= _SETTLED or self.idle >= _PATIENCE)


@dataclass(frozen=True, kw_only=True)
class CorrelatedSolution(Solution):
    """Result of the iteration, with the latent inputs of the model."""

    latent: Latent
    direct: np.ndarray  # (d,): direct gain from noise of the inputs to the output

    @property
    def beyond(self):
        """Coefficients (d,) of the output without the direct gain."""
        return self.state.beta_mean - self.direct


def solve_correlated(
    moments,
    psi,
    *,
    max_iter,
    tol,
    common=False,
    cross=None,
    floor=0.0,
    ard_shape=1e-6,
    ard_rate=1e-6,
):
    """Fit the model to standardised moments, with the input noise psi (d, d)."""
    # cross (d,): covariance of the noise of the inputs with that of the output. With
    # exact inputs the bound at least squares is checked at the end; if it is higher,
    # the iteration continues from there.
    problem = CorrelatedProblem(
        moments,
        psi,
        ard_shape=ard_shape,
        ard_rate=ard_rate,
        common=common,
        direct=None if cross is None else direct_share(psi, cross),
        floor=floor,
    )

    def up(point, most):
        solution = climb(FixedPointSteps(problem, tol), point, most)
        return CorrelatedSolution(
            latent=problem.latent, direct=problem.direct, **vars(solution)
        )

    solution = up(problem.start(), max_iter)
    if not (problem.exact and moments.n > problem.d):
        return solution
    used = min(solution.n_iter + 1, max_iter)
    other = problem.start_from_least_squares()
    if other.value > solution.history[-1] and used < max_iter:
        solution = up(other, max_iter - used)
        return replace(solution, n_iter=used + solution.n_iter - 1)
    return replace(solution, n_iter=used)


def direct_share(psi, cross):
    """Direct gain b (d,) from the inputs' noise to the output, psi b = cross."""
    return scaled_eigen(psi, ROUNDING * cross.size).solve(cross)


def posterior_covariance(n, psi, solution, dof=np.inf):
    """Covariance (d, d) of beta that includes noise in the inputs' moments, [C14]."""
    # psi (d, d) is known, or was estimated with `dof` degrees of freedom. With psi = 0
    # it is the posterior covariance of Bayesian regression.
    state = solution.state
    if solution.latent.exact:
        return state.beta_cov
    beta = solution.beyond
    v = state.psi_y + beta @ psi @ beta
    prior = 1.0 / np.sqrt(v * state.E_alpha / n)
    half, _ = inverse_factor(solution.latent.Sigma_t, prior)
    G_inv = half @ half.T
    psi_beta = psi @ beta
    middle = v * psi + np.outer(psi_beta, psi_beta)
    # Wishart: the covariance of psi beta for an estimated psi, times dof. An estimated
    # covariance with the noise of the output adds that noise.
    noise = v if solution.direct.any() else beta @ psi_beta
    estimated = noise * psi + np.outer(psi_beta, psi_beta)
    cov = (v * G_inv + G_inv @ middle @ G_inv) / n
    cov += G_inv @ estimated @ G_inv / dof  # [C14]
    return 0.5 * (cov + cov.T)
