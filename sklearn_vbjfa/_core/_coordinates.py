"""The state as a vector, the bound's gradient in it, and the scale of an EM step.

Loadings stand as they are and variances as logarithms, so that any vector of real
numbers is a state. The precisions alpha do not occur: at their own optimum, which is
explicit, they add nothing to the gradient.
"""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._core._updates import (
    VARIANCE_FLOOR,
    update_noise,
    update_precisions,
)

_TINY = float(np.finfo(float).tiny)
# Largest logarithm: exp of it must stay a number.
_LARGEST_LOG = 300.0


def _blocks(prior):
    """Names of what is free, in their order; psi_y comes last."""
    names = ["w_z_mean", "w_x_mean", "psi_z"]
    if prior.psi_x_fixed is None:
        names.append("psi_x")
    if prior.ard:
        names.append("w_z_var")
        if prior.coupled:
            names.append("w_x_var")
    return names


def to_vector(state, prior):
    """Coordinates of a state, ndarray of shape (n_blocks * d + 1,)."""
    parts = [
        values if name.endswith("mean") else np.log(np.maximum(values, _TINY))
        for name in _blocks(prior)
        for values in (getattr(state, name),)
    ]
    return np.concatenate([*parts, [np.log(state.psi_y)]])


def from_vector(vector, like, prior):
    """State with these coordinates; what is not free is that of `like`."""
    names = _blocks(prior)
    rows = vector[:-1].reshape(len(names), -1)
    values = {}
    for name, row in zip(names, rows):
        if not name.endswith("mean"):
            row = np.exp(np.clip(row, -_LARGEST_LOG, _LARGEST_LOG))
        values[name] = np.maximum(row, VARIANCE_FLOOR) if name[:3] == "psi" else row
    psi_y = np.exp(np.clip(vector[-1], -_LARGEST_LOG, _LARGEST_LOG))
    values["psi_y"] = max(float(psi_y), VARIANCE_FLOOR)
    return update_precisions(replace(like, **values), prior)


@dataclass(frozen=True, kw_only=True)
class Slope:
    """The bound's gradient, and the inverse curvature that an EM step assumes.

    ``scale * gradient`` is the EM step to first order in the logarithms. Both have
    the shape of the coordinates; the gradient is zero where a variance rests on its
    floor and would fall further.
    """

    gradient: np.ndarray
    scale: np.ndarray


def slope(moments, state, hidden, prior):
    """Gradient of the bound at `state`, whose alpha is at its optimum.

    With q(Z, T) at its optimum the bound has the gradient of the expected
    log-likelihood alone (Fisher's identity): each entry is the residual of the
    stationarity condition that the update of the same name solves.
    """
    n, S_tt = moments.n, hidden.S_tt
    alpha = state.E_alpha if prior.ard else 0.0
    alpha_x = alpha if prior.ard and prior.coupled else 0.0
    # Without a change of loadings the updates are eqs. 14 to 16 at this state.
    new = update_noise(moments, state, state, hidden, replace(prior, psi_x_weight=0.0))
    on_z, on_x = S_tt / state.psi_z + alpha, S_tt / state.psi_x + alpha_x
    curvature = np.full(S_tt.size, 0.5 * n)
    gradient = {
        "w_z_mean": (hidden.S_zt - state.w_z_mean * S_tt) / state.psi_z
        - alpha * state.w_z_mean,
        "w_x_mean": (hidden.S_xt - state.w_x_mean * S_tt) / state.psi_x
        - alpha_x * state.w_x_mean,
        "psi_z": 0.5 * n * (new.psi_z / state.psi_z - 1.0),
        "w_z_var": 0.5 * (1.0 - state.w_z_var * on_z),
        "w_x_var": 0.5 * (1.0 - state.w_x_var * on_x),
    }
    scale = {
        "w_z_mean": 1.0 / on_z,
        "w_x_mean": 1.0 / on_x,
        "psi_z": 1.0 / curvature,
        "w_z_var": np.full(S_tt.size, 2.0),
        "w_x_var": np.full(S_tt.size, 2.0),
    }
    if prior.psi_x_fixed is None:
        weight = prior.psi_x_weight
        on_psi_x = 0.5 * n * (new.psi_x / state.psi_x - 1.0)
        if weight:
            on_psi_x = on_psi_x + 0.5 * weight * (prior.psi_x_mode / state.psi_x - 1.0)
        gradient["psi_x"] = on_psi_x
        scale["psi_x"] = 1.0 / (curvature + 0.5 * weight)
    for name in ("psi_z", "psi_x"):
        if name in gradient:
            stuck = (getattr(state, name) <= VARIANCE_FLOOR) & (gradient[name] < 0)
            gradient[name] = np.where(stuck, 0.0, gradient[name])
    on_psi_y = 0.5 * n * (new.psi_y / state.psi_y - 1.0)
    if state.psi_y <= VARIANCE_FLOOR:
        on_psi_y = max(on_psi_y, 0.0)
    names = _blocks(prior)
    return Slope(
        gradient=np.concatenate([*(gradient[name] for name in names), [on_psi_y]]),
        scale=np.concatenate([*(scale[name] for name in names), [2.0 / n]]),
    )
