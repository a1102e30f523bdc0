"""The loop: start, iterate, watch the bound, stop."""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._core._bound import bound
from sklearn_vbjfa._core._state import State
from sklearn_vbjfa._core._updates import (
    VARIANCE_FLOOR,
    expect_hidden,
    update_loadings,
    update_noise,
    update_precisions,
)

_RELATIVE_FALL = 1e-9


def rounding_of_bound(value, n, output_variance):
    """Return the largest fall of the bound that rounding can explain.

    A share of the bound's own size, and what the rounding of the squared residual
    (a difference of terms of size 1 per sample, in standardised units) does to the
    bound when the residual itself is tiny.
    """
    residual = 64 * np.finfo(float).eps / output_variance
    return _RELATIVE_FALL * max(abs(value), n) + n * residual


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Where the iteration ended, and how.

    ``status`` is "converged", "max_iter" or "bound_decreased"; ``fall`` is the size of
    that decrease; ``at_floor`` names the variances at their floor (Heywood cases).
    """

    state: State
    history: np.ndarray
    n_iter: int
    status: str
    fall: float
    at_floor: dict


def start(moments, prior, input_noise):
    """Return the documented starting point.

    The inputs start with the share `input_noise` of their variance as noise. The
    loadings to z start along the covariance with y with the step that fits y best
    (one component of PLS); the rest of y is shared by y's own noise and the z's.

    Parameters
    ----------
    moments : Moments
        Standardised moments.
    prior : Prior
        Says whether there is an ARD layer, and which noise is fixed.
    input_noise : ndarray of shape (n_features,)
        Input-noise variances to start from, as shares of the inputs' variances.
    """
    n, d = moments.n, moments.xx.shape[0]
    psi_x = input_noise if prior.psi_x_fixed is None else prior.psi_x_fixed
    w_x = np.sqrt(np.maximum(1.0 - psi_x, VARIANCE_FLOOR))
    direction = moments.xy
    curvature = direction @ moments.dot(direction)
    step = (direction @ direction) / curvature if curvature > 0 else 0.0
    w_z = step * direction / w_x
    explained = step * (direction @ direction)
    rest = max(moments.yy - explained, VARIANCE_FLOOR * moments.yy) / n
    shape = prior.ard_shape + (1.0 if prior.coupled else 0.5)
    variance = np.full(d, 1.0 / n) if prior.ard else np.zeros(d)
    return State(
        w_z_mean=w_z,
        w_z_var=variance,
        w_x_mean=w_x,
        w_x_var=variance if prior.coupled else np.zeros(d),
        # The paper's initial value: <alpha> = 1.
        alpha_shape=shape,
        alpha_rate=np.full(d, shape),
        psi_y=max(0.5 * rest, VARIANCE_FLOOR),
        psi_z=np.full(d, max(0.5 * rest / d, VARIANCE_FLOOR)),
        psi_x=np.maximum(psi_x, VARIANCE_FLOOR),
    )


def iterate(moments, state, prior):
    """Do one whole iteration; return the new state and the bound of the old one."""
    hidden = expect_hidden(moments, state)
    value = bound(moments, state, hidden, prior)
    new = update_loadings(state, hidden, prior)
    new = update_precisions(new, prior)
    new = update_noise(moments, state, new, hidden, prior)
    return new, value


def _coordinates(state):
    """State as one vector in which any real values make a state."""
    return np.concatenate(
        [
            state.w_z_mean,
            state.w_x_mean,
            np.log(np.maximum(state.w_z_var, _TINY)),
            np.log(np.maximum(state.w_x_var, _TINY)),
            np.log(state.alpha_rate),
            np.log(state.psi_z),
            np.log(state.psi_x),
            [np.log(state.psi_y)],
        ]
    )


_TINY = float(np.finfo(float).tiny)
# Largest extrapolation: exp of it must stay a number.
_LARGEST_LOG = 300.0


def _from_coordinates(vector, like):
    """Return the state with these coordinates; zero variances stay zero."""
    d = like.w_z_mean.size
    w_z, w_x, z_var, x_var, rate, psi_z, psi_x = vector[: 7 * d].reshape(7, d)
    clip = np.clip(vector[-1], -_LARGEST_LOG, _LARGEST_LOG)

    def positive(log):
        return np.exp(np.clip(log, -_LARGEST_LOG, _LARGEST_LOG))

    return replace(
        like,
        w_z_mean=w_z,
        w_x_mean=w_x,
        w_z_var=np.where(like.w_z_var > 0, positive(z_var), 0.0),
        w_x_var=np.where(like.w_x_var > 0, positive(x_var), 0.0),
        alpha_rate=positive(rate),
        psi_z=np.maximum(positive(psi_z), VARIANCE_FLOOR),
        psi_x=np.maximum(positive(psi_x), VARIANCE_FLOOR),
        psi_y=max(float(np.exp(clip)), VARIANCE_FLOOR),
    )


# Longest extrapolation. Longer ones save iterations, but multiply the rounding of the
# sums by their square each time: the same data in another order would end elsewhere.
_LONGEST_STEP = 4.0


def _extrapolate(before, between, after):
    """SQUAREM step (S3 of Varadhan and Roland, 2008) from three successive states.

    Returns None where the iteration stands still.
    """
    x0, x1, x2 = (_coordinates(state) for state in (before, between, after))
    r = x1 - x0
    v = x2 - x1 - r
    size = np.linalg.norm(v)
    if size == 0:
        return None
    length = min(max(np.linalg.norm(r) / size, 1.0), _LONGEST_STEP)
    if length == 1.0:
        return None
    return _from_coordinates(x0 + 2 * length * r + length**2 * v, after)


def solve(moments, state, prior, *, max_iter, tol, accelerate=True):
    """Iterate until the bound gains less than `tol` per sample.

    The plain iteration crawls along flat directions. Between every two plain steps and
    the next, the state is extrapolated (SQUAREM); an extrapolated state is kept only
    if its bound is not lower, so that the bound never falls and the fixed points are
    those of the plain iteration.

    The loop holds nothing of the size of the data beyond `moments`.
    """
    if prior.psi_x_fixed is not None:
        prior = replace(
            prior, psi_x_fixed=np.maximum(prior.psi_x_fixed, VARIANCE_FLOOR)
        )
    history = []
    status, fall = "max_iter", 0.0
    used = 0
    before = state  # the state of the last bound in `history`
    recent = [state]  # since the last extrapolation
    cycle_start = -np.inf
    while used < max_iter:
        new_state, value = iterate(moments, state, prior)
        used += 1
        if history:
            gain = value - history[-1]
            if gain < -rounding_of_bound(value, moments.n, state.psi_y):
                status, fall = "bound_decreased", -gain
                state = before
                break
        history.append(value)
        before, state = state, new_state
        recent.append(state)
        if not accelerate:
            if len(history) > 1 and abs(gain) <= tol * moments.n:
                status = "converged"
                break
            continue
        if len(recent) < 3:
            continue
        # Two plain steps since the last check: their gain and the extrapolation's.
        if value - cycle_start <= tol * moments.n:
            status = "converged"
            break
        cycle_start = value
        trial = _extrapolate(*recent)
        recent = [state]
        if trial is None or used >= max_iter:
            continue
        trial_next, trial_value = iterate(moments, trial, prior)
        used += 1
        if np.isfinite(trial_value) and trial_value >= value:
            history.append(trial_value)
            before, state = trial, trial_next
            recent = [state]
    floor = 2 * VARIANCE_FLOOR
    fixed = prior.psi_x_fixed is not None
    at_floor = {
        "psi_y": np.flatnonzero(np.atleast_1d(state.psi_y) <= floor),
        "psi_x": np.flatnonzero(state.psi_x <= floor)
        if not fixed
        else np.array([], dtype=int),
    }
    return Solution(
        state=state,
        history=np.array(history),
        n_iter=used,
        status=status,
        fall=fall,
        at_floor={name: where for name, where in at_floor.items() if where.size},
    )
