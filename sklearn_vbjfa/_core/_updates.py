"""The updates of the paper, each a pure function of statistics and state.

The dense matrices of eqs. 17 to 25 are diagonal plus rank one; with
``s = psi_y + 1'M1`` (Sherman-Morrison on eq. 17) every posterior mean is

    <z_m> = c_m x_m + M_m e / s,    <t_m> = h_m x_m + r_m M_m e / s,

where ``e = y - c'x`` and c is the regression coefficient for noisy inputs of the
current state. All sample sums then follow from S_xx c, S_xy and S_yy.
"""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa._core._state import HiddenExpectations

# Smallest variance, as a share of the variance of its own (standardised) column, that
# the sums can resolve in floating point. A noise estimate that falls to it is a
# Heywood case; the solver reports which.
VARIANCE_FLOOR = float(np.finfo(float).eps)

# Loadings that the ARD prior has switched off shrink geometrically; below this size
# they are denormal soon, which costs time and says nothing. Zero is a fixed point.
_NEGLIGIBLE_LOADING = 1e-100


def expect_hidden(moments, state):
    """E-step over Z and T: the sample sums that all other updates need.

    [eqs. 17-25], with eq. 19 in its corrected sign.
    """
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
        coef=c,
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
    if prior.coupled:
        w_x_scale = 1.0 / (S_tt + alpha * state.psi_x)
        w_x_var = state.psi_x * w_x_scale  # [eq. 10]
        w_x_mean = w_x_scale * hidden.S_xt  # [eq. 11]
    else:
        w_x_var = state.w_x_var
        w_x_mean = hidden.S_xt / S_tt
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
    """Noise variances, from the residuals z - w_z t and x - w_x t.

    Eqs. 15 and 16 are differences of sums that cancel when the noise is small. With
    the forms of the module's docstring the residuals themselves are small:

        <z> - w_z <t> = -d_z h x + (psi_z - d_z r M) e / s,
        x - w_x <t> = (psi_x a / B - d_x h) x - w_x r M e / s,

    where d_z, d_x are the changes of the loadings since the E-step (at state `old`),
    and Cov(z - w_z t) follows from Cov(z - w_z_old t) = psi_z - psi_z^2 / s.
    """
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
