"""State, updates and bound of the independent-latent model, each a pure function.

The dense matrices of eqs. 17 to 25 are diagonal plus rank one; with
``s = psi_y + 1'M1`` (Sherman-Morrison on eq. 17) every posterior mean is

    <z_m> = c_m x_m + M_m e / s,    <t_m> = h_m x_m + r_m M_m e / s,

where ``e = y - c'x`` and c is the regression coefficient for noisy inputs of the
current state. All sample sums then follow from S_xx c, S_xy and S_yy.
Tags such as [eq. 12] are equations of the paper, [B1] to [B4] those of the guide for
the bound, which keeps all its constants: for JFA it is the log-likelihood itself.
"""

from collections import namedtuple
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import digamma, gammaln


@dataclass(frozen=True, kw_only=True)
class LatentState:
    """Everything an iteration changes."""

    # Loadings are Gaussian with diagonal covariance; zero variances are point estimates
    # (JFA). All quantities are in standardised units.

    # (n_features,): posterior mean and variance of the loadings t -> z. [eqs. 8, 9]
    w_z_mean: np.ndarray
    w_z_var: np.ndarray
    # (n_features,): posterior mean and variance of the loadings t -> x. [eqs. 10, 11]
    w_x_mean: np.ndarray
    w_x_var: np.ndarray
    alpha_shape: float  # shape of the Gamma posterior of each precision. [eq. 12]
    alpha_rate: np.ndarray  # (n_features,): its rate. [eq. 13]
    psi_y: float  # output-noise variance. [eq. 14]
    # (n_features,): variances of z given t, and of the input noise. [eqs. 15, 16]
    psi_z: np.ndarray
    psi_x: np.ndarray

    @property
    def E_alpha(self):
        return self.alpha_shape / self.alpha_rate


@dataclass(frozen=True, kw_only=True)
class HiddenExpectations:
    """Sample sums of the posterior moments of z and t, and their ingredients."""

    # (n_features,): sum over samples of <z_m t_m>, <t_m^2>, x_m <t_m>
    S_zt: np.ndarray
    S_tt: np.ndarray
    S_xt: np.ndarray
    S_rr: float  # sum over samples of <(y - 1'z)^2>
    # (n_features,): sum of x_m e and e^2, with e = y - c'x
    S_xe: np.ndarray
    S_ee: float
    y_var: float  # variance of y given x
    x_var: np.ndarray  # (n_features,): marginal variance of x
    # (n_features,): prior precision of t, raised by the uncertainty of the loadings
    t_precision: np.ndarray
    # (n_features,): <t_m> = t_gain_m x_m + t_step_m e / y_var
    t_gain: np.ndarray
    t_step: np.ndarray
    t_var: np.ndarray  # (n_features,): posterior variance of t_m


@dataclass(frozen=True, kw_only=True)
class Prior:
    """Prior assumptions; noise is in standardised units."""

    # loadings have ARD priors (VB-JFA); otherwise they are point estimates (JFA)
    ard: bool = False
    # alpha_m is shared by w_zm and w_xm, as in the paper; otherwise w_xm is a point
    coupled: bool = True
    # gamma prior of the precisions
    ard_shape: float = 1e-6
    ard_rate: float = 1e-6
    # (n_features,) or None, which estimates them: known input-noise variances
    psi_x_fixed: np.ndarray | None = None
    # weight, in samples, of the inverse-gamma prior on psi_x; 0 is none
    psi_x_weight: float = 0.0
    psi_x_mode: np.ndarray | None = None  # (n_features,) or None: mode of that prior


# Answer to one kind of query, in standardised units: coefficients (d,), their
# covariance (d, d), the variance of y given the query, and by how much that may be
# larger where the input noise is unknown.
LinearModel = namedtuple("LinearModel", "coef cov noise open_noise", defaults=[0.0])


def coefficients_noisy(state):
    """Coefficient of E[y | x] for noisy x: eq. 27 with point estimates."""
    # Input by input, it is w_z w_x / (w_x^2 + psi_x).
    w_x = state.w_x_mean
    return state.w_z_mean * w_x / (w_x**2 + state.psi_x)  # [eq. 27]


def coefficients_noiseless(state, retained):
    """Coefficient of E[y | t] for noiseless inputs, zero where not retained."""
    # The prefactor of eq. 29 cancels: beta = w_z / w_x. For an input switched off by
    # the ARD prior both loadings vanish and their ratio is meaningless.
    beta = np.zeros_like(state.w_z_mean)
    beta[retained] = state.w_z_mean[retained] / state.w_x_mean[retained]  # [eq. 29]
    return beta


# Smallest variance, as a share of the variance of its own (standardised) column, that
# the sums can resolve in floating point. A noise estimate that falls to it is a
# Heywood case; the solver reports which.
VARIANCE_FLOOR = float(np.finfo(float).eps)

# Loadings switched off by the ARD prior shrink geometrically; below this size they soon
# become denormal, which costs time to no purpose. Zero is a fixed point.
_NEGLIGIBLE_LOADING = 1e-100


def expect_hidden(moments, state):
    """E-step over Z and T, [eqs. 17-25] with eq. 19 in its corrected sign."""
    w_z, w_x = state.w_z_mean, state.w_x_mean
    psi_z, psi_x, psi_y = state.psi_z, state.psi_x, state.psi_y
    n = moments.n

    # The forms below multiply eqs. 21 and 22 through by psi_x, so that an exact
    # input (psi_x -> 0) needs no division by zero: A = B / psi_x.
    t_precision = 1.0 + state.w_z_var / psi_z + state.w_x_var / psi_x
    B = psi_x * t_precision + w_x**2
    D = B * psi_z + w_z**2 * psi_x
    K_inv = psi_x * psi_z / D  # [eq. 21]
    M = psi_z + w_z**2 * psi_x / B  # [eq. 22]
    r = w_z * psi_x / D  # diagonal of W_z Psi_z^-1 K^-1
    rM = w_z * psi_x / B
    s = psi_y + M.sum()  # denominator of [eq. 17]

    c = w_z * w_x / B
    h = w_x / B
    # e = y - c'x and its products with x
    S_xe, S_ee = moments.residual(c)
    b = M / s
    rb = rM / s

    xx = moments.xx
    t_var = K_inv + r * rM - rM * rb  # diagonal of [eq. 18]
    S_tt = h * (h * xx + 2 * rb * S_xe) + rb * rb * S_ee + n * t_var
    S_zt = (
        c * h * xx
        + (c * rb + h * b) * S_xe
        + b * rb * S_ee
        + n * (rM - rM * b)  # [eq. 19], corrected
    )
    S_xt = h * xx + rb * S_xe  # [eq. 24]
    S_rr = (psi_y / s) ** 2 * S_ee + n * psi_y * M.sum() / s
    return HiddenExpectations(
        S_zt=S_zt,
        S_tt=S_tt,
        S_xt=S_xt,
        S_rr=S_rr,
        S_xe=S_xe,
        S_ee=S_ee,
        y_var=s,
        x_var=psi_x + w_x**2 / t_precision,
        t_precision=t_precision,
        t_gain=h,
        t_step=rM,
        t_var=t_var,
    )


def update_loadings(state, hidden, prior):
    """Update the loadings: points for JFA, Gaussian posteriors for VB-JFA."""
    S_tt = hidden.S_tt
    if not prior.ard:
        return replace(state, w_z_mean=hidden.S_zt / S_tt, w_x_mean=hidden.S_xt / S_tt)
    alpha = state.E_alpha
    w_z_scale = 1.0 / (S_tt + alpha * state.psi_z)
    w_z_var = state.psi_z * w_z_scale  # [eq. 8]
    w_z_mean = w_z_scale * hidden.S_zt  # [eq. 9]
    w_x_scale = 1.0 / (S_tt + prior.coupled * alpha * state.psi_x)
    w_x_var = prior.coupled * state.psi_x * w_x_scale  # [eq. 10]
    w_x_mean = w_x_scale * hidden.S_xt  # [eq. 11]
    w_z_mean = np.where(np.abs(w_z_mean) < _NEGLIGIBLE_LOADING, 0.0, w_z_mean)
    w_x_mean = np.where(np.abs(w_x_mean) < _NEGLIGIBLE_LOADING, 0.0, w_x_mean)
    return replace(
        state, w_z_mean=w_z_mean, w_z_var=w_z_var, w_x_mean=w_x_mean, w_x_var=w_x_var
    )


def update_precisions(state, prior):
    """Gamma posterior of alpha."""
    if not prior.ard:
        return state
    square = state.w_z_mean**2 + state.w_z_var
    shape = prior.ard_shape + 0.5
    if prior.coupled:
        square = square + state.w_x_mean**2 + state.w_x_var
        shape = prior.ard_shape + 1.0  # [eq. 12]
    rate = prior.ard_rate + 0.5 * square  # [eq. 13]
    return replace(state, alpha_shape=shape, alpha_rate=rate)


def update_noise(moments, old, state, hidden, prior):
    """Noise variances, from the residuals z - w_z t and x - w_x t, [eqs. 15, 16]."""
    # These are differences of sums that cancel when the noise is small. In the forms of
    # the module's docstring the residuals themselves are small:
    #     <z> - w_z <t> = -d_z h x + (psi_z - d_z r M) e / s,
    #     x - w_x <t> = (psi_x a / B - d_x h) x - w_x r M e / s,
    # where d_z, d_x are the changes of the loadings since the E-step (at state `old`),
    # and Cov(z - w_z t) follows from Cov(z - w_z_old t) = psi_z - psi_z^2 / s.
    n, s = moments.n, hidden.y_var
    h, step, t_var = hidden.t_gain, hidden.t_step, hidden.t_var
    S_xe, S_ee, S_tt = hidden.S_xe, hidden.S_ee, hidden.S_tt
    psi_y = hidden.S_rr / n  # [eq. 14]

    d_z = state.w_z_mean - old.w_z_mean
    on_x, on_e = -d_z * h, (old.psi_z - d_z * step) / s
    spread = old.psi_z * (s - old.psi_z + 2 * d_z * step) / s + d_z**2 * t_var
    squares = on_x * (on_x * moments.xx + 2 * on_e * S_xe) + on_e**2 * S_ee
    psi_z = (squares + n * spread + state.w_z_var * S_tt) / n  # [eq. 15]

    if prior.psi_x_fixed is not None:
        psi_x = prior.psi_x_fixed
    else:
        B = old.psi_x * hidden.t_precision + old.w_x_mean**2
        d_x = state.w_x_mean - old.w_x_mean
        on_x = old.psi_x * hidden.t_precision / B - d_x * h
        on_e = -state.w_x_mean * step / s
        squares = on_x * (on_x * moments.xx + 2 * on_e * S_xe) + on_e**2 * S_ee
        spread = state.w_x_mean**2 * t_var
        total = squares + n * spread + state.w_x_var * S_tt
        psi_x = total / n  # [eq. 16]
        if prior.psi_x_weight:
            weight = prior.psi_x_weight
            psi_x = (total + weight * prior.psi_x_mode) / (n + weight)
    return replace(
        state,
        psi_y=max(psi_y, VARIANCE_FLOOR),
        psi_z=np.maximum(psi_z, VARIANCE_FLOOR),
        psi_x=np.maximum(psi_x, VARIANCE_FLOOR),
    )


LOG_2PI = float(np.log(2 * np.pi))


def data_bound(moments, hidden):
    """Return the expected log-likelihood plus the entropy of q(Z, T), [B1]."""
    # With q(Z, T) at its optimum these add up to the log-normaliser of one Gaussian,
    # x_m ~ N(0, psi_x + w_x^2 / a_m) and y | x ~ N(c'x, s), a_m being `t_precision`;
    # each sample then also pays -log(a_m) / 2.
    n = moments.n
    x_part = n * (LOG_2PI + np.log(hidden.x_var) + np.log(hidden.t_precision))
    x_part = x_part + moments.xx / hidden.x_var
    y_part = n * (LOG_2PI + np.log(hidden.y_var)) + hidden.S_ee / hidden.y_var
    return -0.5 * float(x_part.sum() + y_part)  # [B1]


def prior_bound(state, prior):
    """Return minus the divergence of q(w_z) q(w_x) q(alpha) from the prior, [eq. 5]."""
    # Its second line is p(w_x | alpha). The inverse-gamma prior on psi_x enters through
    # its density on log(psi_x), without its constant, so that its maximum is at the
    # documented mode.
    total = 0.0
    if prior.psi_x_weight and prior.psi_x_fixed is None:
        ratio = prior.psi_x_mode / state.psi_x
        total += 0.5 * prior.psi_x_weight * float((np.log(ratio) - ratio).sum())  # [B2]
    if not prior.ard:
        return total
    shape, rate = state.alpha_shape, state.alpha_rate
    E_alpha, E_log_alpha = shape / rate, digamma(shape) - np.log(rate)
    square = state.w_z_mean**2 + state.w_z_var
    terms = loading_bound(E_alpha, E_log_alpha, square, state.w_z_var)
    if prior.coupled:
        square = state.w_x_mean**2 + state.w_x_var
        terms = terms + loading_bound(E_alpha, E_log_alpha, square, state.w_x_var)
    terms = terms + precision_bound(shape, rate, prior.ard_shape, prior.ard_rate)
    return total + float(terms.sum())


def loading_bound(E_alpha, E_log_alpha, square, variance):
    """Part (d,) of the bound due to loadings of these squares and variances."""
    quadratic = E_log_alpha - E_alpha * square + 1.0
    return 0.5 * (quadratic + np.log(variance))  # [B3]


def precision_bound(shape, rate, shape0, rate0):
    """Part (d,) of the bound due to Gamma posteriors under a Gamma prior, [B4]."""
    E_alpha, E_log = shape / rate, digamma(shape) - np.log(rate)
    prior = shape0 * np.log(rate0) - gammaln(shape0) + (shape0 - 1) * E_log
    entropy = shape - np.log(rate) + gammaln(shape) + (1 - shape) * digamma(shape)
    return prior - rate0 * E_alpha + entropy  # [B4]
