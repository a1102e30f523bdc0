"""The loop: start, iterate, watch the bound, stop."""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._core._bound import bound
from sklearn_vbjfa._core._coordinates import from_vector, slope, to_vector
from sklearn_vbjfa._core._highest import at_highest_likelihood
from sklearn_vbjfa._core._state import HiddenExpectations, State
from sklearn_vbjfa._core._stats import GramMoments, exact_fit
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
    return _RELATIVE_FALL * max(abs(value), n) + n * rounding_of_fit(output_variance)


def rounding_of_fit(output_variance):
    """Return the bound's rounding per sample from that of the squared residual."""
    return 64 * np.finfo(float).eps / output_variance


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


@dataclass(frozen=True, kw_only=True)
class _Point:
    """A state with its bound, and the iteration's next state."""

    state: State
    value: float
    hidden: HiddenExpectations

    def plain_step(self, moments, prior):
        new = update_loadings(self.state, self.hidden, prior)
        new = update_precisions(new, prior)
        return update_noise(moments, self.state, new, self.hidden, prior)


def _evaluate(moments, state, prior):
    hidden = expect_hidden(moments, state)
    return _Point(
        state=state, value=bound(moments, state, hidden, prior), hidden=hidden
    )


def iterate(moments, state, prior):
    """Do one whole iteration; return the new state and the bound of the old one."""
    point = _evaluate(moments, state, prior)
    return point.plain_step(moments, prior), point.value


# Pairs of steps and changes of the gradient that are kept: the usual number of
# limited-memory quasi-Newton methods (Nocedal and Wright, 2006, section 7.2).
_MEMORY = 10
# Share of the gain that the slope promises which a step must bring (their c1).
_ENOUGH = 1e-4
# Trials along one direction before the plain step is taken instead.
_TRIALS = 4


# Points of the search lie on a grid of this share of the output's deviation. A
# quasi-Newton method multiplies the rounding of the sums from step to step; on the grid
# it is rounded away, and the same data in another order give the same estimate. What
# the grid costs of the bound, some 1e-12 per sample and input, is far below `tol`.
_GRID = 2.0**-20


def _on_grid(vector, point):
    """Round coordinates to the grid of a point, whose width is a power of two."""
    deviation = np.sqrt(min(point.hidden.y_var, 1.0))
    width = _GRID * 2.0 ** np.floor(np.log2(deviation))
    return np.round(vector / width) * width


class _Curvature:
    """Inverse curvature of the bound: that of an EM step, corrected by past steps.

    The quasi-Newton acceleration of EM by Jamshidian and Jennrich (1997), with the
    two-loop recursion in place of a matrix.
    """

    def __init__(self):
        self.steps, self.changes = deque(maxlen=_MEMORY), deque(maxlen=_MEMORY)

    def learn(self, step, before, after):
        """Add a pair, unless the bound is not concave along it."""
        change = before.gradient - after.gradient
        along = step @ change
        size = np.sqrt(
            (change @ (after.scale * change)) * (step @ (step / after.scale))
        )
        if along > np.sqrt(np.finfo(float).eps) * size:
            self.steps.append(step)
            self.changes.append(change)

    def forget(self):
        """Start again."""
        self.steps.clear()
        self.changes.clear()

    def direction(self, slope):
        """Newton's direction with what is known, or None if nothing is."""
        if not self.steps:
            return None
        rest, parts = slope.gradient.copy(), []
        for step, change in zip(reversed(self.steps), reversed(self.changes)):
            parts.append((step @ rest) / (step @ change))
            rest -= parts[-1] * change
        step, change = self.steps[-1], self.changes[-1]
        length = (step @ change) / (change @ (slope.scale * change))
        found = length * slope.scale * rest
        for step, change in zip(self.steps, self.changes):
            found += step * (parts.pop() - (change @ found) / (step @ change))
        found[slope.gradient == 0.0] = 0.0  # variances that rest on their floor
        return found if found @ slope.gradient > 0 else None


def _search(moments, point, start, direction, promised, prior, trials):
    """Return the first point along the direction that gains enough, and the trials."""
    length = 1.0
    for k in range(trials):
        vector = _on_grid(start + length * direction, point)
        state = from_vector(vector, point.state, prior)
        trial = _evaluate(moments, state, prior)
        if trial.value >= point.value + _ENOUGH * length * promised:
            return trial, k + 1
        # The parabola through both values and the slope, within [0.1, 0.5].
        short = 2 * (point.value + length * promised - trial.value)
        share = length * promised / short if np.isfinite(short) else 0.1
        length *= min(max(share, 0.1), 0.5)
    return None, trials


def _solve_plain(moments, state, prior, max_iter, tol):
    """Do the iteration as it stands."""
    history, before = [], state
    for used in range(1, max_iter + 1):
        new, value = iterate(moments, state, prior)
        gain = value - history[-1] if history else np.inf
        if gain < -rounding_of_bound(value, moments.n, state.psi_y):
            return before, history, used, "bound_decreased", -gain
        history.append(value)
        before, state = state, new
        if abs(gain) <= tol * moments.n:
            return state, history, used, "converged", 0.0
    return state, history, max_iter, "max_iter", 0.0


def _solve_fast(moments, state, prior, max_iter, tol):
    """Do quasi-Newton steps where they raise the bound, else those of the iteration."""
    point, used = _evaluate(moments, state, prior), 1
    history = [point.value]
    curvature, here, quiet = _Curvature(), None, 0
    while used < max_iter:
        new = None
        # An (all but) exact fit: gradients are rounding, more than the grid absorbs.
        known = here is not None and rounding_of_fit(point.hidden.y_var) <= _GRID
        direction = curvature.direction(here) if known else None
        if direction is not None:
            start = to_vector(point.state, prior)
            promised = direction @ here.gradient
            trials = min(_TRIALS, max_iter - used)
            new, spent = _search(
                moments, point, start, direction, promised, prior, trials
            )
            used += spent
        if new is None:
            if used >= max_iter:
                break
            curvature.forget()
            plain = point.plain_step(moments, prior)
            vector = _on_grid(to_vector(plain, prior), point)
            new = _evaluate(moments, from_vector(vector, plain, prior), prior)
            if not new.value >= point.value:
                new = _evaluate(moments, plain, prior)
                used += 1
            used += 1
        gain = new.value - point.value
        if gain < -rounding_of_bound(new.value, moments.n, new.state.psi_y):
            return point.state, history, used, "bound_decreased", -gain
        there = slope(moments, new.state, new.hidden, prior)
        if here is not None:
            step = to_vector(new.state, prior) - to_vector(point.state, prior)
            curvature.learn(step, here, there)
        point, here = new, there
        history.append(point.value)
        # One short step may be a poor direction; two are the end.
        quiet = quiet + 1 if gain <= tol * moments.n else 0
        if quiet == 2:
            return point.state, history, used, "converged", 0.0
    return point.state, history, used, "max_iter", 0.0


def _end(moments, state, prior, history):
    """Go to the highest likelihood where it is explicit; adds it to the history."""
    highest = at_highest_likelihood(moments, state, prior)
    if highest is None:
        return state
    reached, top = (_evaluate(moments, one, prior) for one in (state, highest))
    slack = rounding_of_bound(reached.value, moments.n, reached.hidden.y_var)
    if not top.value >= reached.value - slack:
        return state
    history.append(max(top.value, history[-1]))  # to rounding
    return highest


def solve(moments, state, prior, *, max_iter, tol, accelerate=True):
    """Iterate until the bound gains less than `tol` per sample.

    The plain iteration crawls along flat directions. Its step is that of a Newton
    method with a diagonal curvature that is much too large; correcting that by what
    past steps tell of the bound's curvature (a limited-memory quasi-Newton method)
    takes far fewer iterations. A step is kept only if it raises the
    bound, else the plain one is done: the bound never falls, and the fixed points are
    those of the plain iteration. Without priors the highest bound is explicit (unless
    the input noise is known to be large), and the last step goes there.

    With ``accelerate=False`` the plain iteration is done throughout.

    An iteration, in `max_iter` and `n_iter`, is one evaluation of the bound with its
    expectations, whether or not the step that asked for it is kept. The loop holds
    nothing of the size of the data beyond `moments`.
    """
    if prior.psi_x_fixed is not None:
        prior = replace(
            prior, psi_x_fixed=np.maximum(prior.psi_x_fixed, VARIANCE_FLOOR)
        )
        state = replace(state, psi_x=prior.psi_x_fixed)
    # Without a prior an exact fit has no highest likelihood, and nothing to
    # extrapolate to but rounding.
    exact = not prior.ard and exact_fit(moments, VARIANCE_FLOOR)
    if accelerate and not exact:
        # Along flat directions the last digits of the moments decide where within
        # `tol` a quasi-Newton method stops: they must not depend on the rows' order.
        state, history, used, status, fall = _solve_fast(
            moments.without_last_digits(), state, prior, max_iter, tol
        )
        explicit = not prior.ard and isinstance(moments, GramMoments)
        if status == "converged" and explicit:
            # The last step is an iteration too.
            if used < max_iter:
                state, used = _end(moments, state, prior, history), used + 1
            else:
                status = "max_iter"
    else:
        state, history, used, status, fall = _solve_plain(
            moments, state, prior, max_iter, tol
        )
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
