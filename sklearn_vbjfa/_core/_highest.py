"""Highest likelihood of the model without priors, which is explicit.

With z and t integrated out, x_m ~ N(0, V_m) and y | x ~ N(c'x, s), where

    V_m = w_xm^2 + psi_xm,   c_m = w_zm w_xm / V_m,
    s = psi_y + sum(psi_z) + sum(c_m^2 V_m o_m),   o_m = psi_xm / w_xm^2,

and nothing else of the parameters counts. Where the input noise alone does not make
more of s than least squares leaves, the highest likelihood has the variance of x_m as
V_m, least squares as c and its residual variance as s. EM creeps towards it where
inputs are strongly correlated: the gain of an iteration says little of what is left.
"""

from dataclasses import replace

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core._updates import VARIANCE_FLOOR


def at_highest_likelihood(moments, state, prior):
    """State of highest likelihood that keeps what it can of the split of `state`.

    Known input noise stays as it is; None is returned where it makes more output noise
    than there is, since V and c then depend on each other. Unknown noise has the odds
    to the signal that it has in `state`; where these would make too much output noise,
    all are lowered by one factor, so that they make the share that they make there.

    Parameters
    ----------
    moments : GramMoments
        Standardised moments.
    state : State
        Where EM has led.
    prior : Prior
        Without an ARD layer.
    """
    n, variance = moments.n, moments.xx / moments.n
    if prior.psi_x_fixed is None:
        share = state.psi_x / (state.psi_x + state.w_x_mean**2)
    else:
        share = np.minimum(prior.psi_x_fixed / variance, 1.0)
    signal = np.maximum(1.0 - share, 0.0)
    used = signal > VARIANCE_FLOOR
    odds = np.where(used, share / np.where(used, signal, 1.0), 0.0)

    c = np.where(used, _coefficients(state), 0.0)
    c = c + _least_squares_step(moments, c, used)
    s = moments.residual(c)[1] / n
    through = c**2 * variance @ odds
    if through > s:
        if prior.psi_x_fixed is not None:
            return None
        old = _coefficients(state) ** 2 @ (
            state.psi_x * (state.w_x_mean**2 + state.psi_x) / state.w_x_mean**2
        )
        part = old / (old + state.psi_y + state.psi_z.sum())
        odds = odds * (part * s / through)
        through = part * s
    rest = (s - through) / (state.psi_y + state.psi_z.sum())
    psi_x = prior.psi_x_fixed
    w_x = np.sqrt(variance / (1.0 + odds)) * np.where(state.w_x_mean < 0, -1.0, 1.0)
    if psi_x is None:
        psi_x = np.maximum(variance * odds / (1.0 + odds), VARIANCE_FLOOR)
    w_x = np.where(used, w_x, state.w_x_mean)
    w_z = np.where(used, c * variance / np.where(used, w_x, 1.0), 0.0)
    return replace(
        state,
        w_z_mean=w_z,
        w_x_mean=w_x,
        psi_x=psi_x,
        psi_y=max(rest * state.psi_y, VARIANCE_FLOOR),
        psi_z=np.maximum(rest * state.psi_z, VARIANCE_FLOOR),
    )


def _coefficients(state):
    """Coefficients of E[y | x], (d,)."""
    w_x = state.w_x_mean
    return state.w_z_mean * w_x / (w_x**2 + state.psi_x)  # [eq. 27]


def _least_squares_step(moments, c, used):
    """Shortest step (d,) from coefficients to least squares in the inputs in use."""
    step = np.zeros_like(c)
    if moments.root is not None:
        R = moments.root.R[:, used]
        left = moments.root.z - moments.root.R @ c
        step[used] = linalg.lstsq(R, left)[0]
        return step
    values, vectors = linalg.eigh(moments.S[np.ix_(used, used)])
    keep = values > values[-1] * values.size * 4 * np.finfo(float).eps
    left = (moments.xy - moments.dot(c))[used]
    V = vectors[:, keep]
    # Once more with what is left, whose rounding is smaller.
    for _ in range(2):
        step[used] += V @ ((V.T @ left) / values[keep])
        left = (moments.xy - moments.dot(c + step))[used]
    return step
