"""Iteration of all models, and the steps of the independent-latent model."""

from collections import deque, namedtuple
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core._updates import (
    VARIANCE_FLOOR,
    LatentState,
    coefficients_noisy,
    data_bound,
    expect_hidden,
    prior_bound,
    update_loadings,
    update_noise,
    update_precisions,
)

# -------------------------------------------------------------------------- the loop

_RELATIVE_FALL = 1e-9


def rounding_of_bound(value, n, output_variance, relative=_RELATIVE_FALL):
    """Return the largest fall of the bound that rounding can explain."""
    # A fraction of the bound itself, plus the effect of rounding of the squared
    # residual (a difference of terms of size 1 per sample, in standardised units),
    # which matters when the residual is tiny.
    return relative * max(abs(value), n) + n * rounding_of_fit(output_variance)


def rounding_of_fit(output_variance):
    """Return the bound's rounding per sample from that of the squared residual."""
    return 64 * np.finfo(float).eps / output_variance


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Result of the iteration."""

    # ``status`` is "converged", "max_iter" or "bound_decreased"; ``fall`` is the size
    # of the decrease.

    state: object
    history: np.ndarray
    n_iter: int
    status: str
    fall: float = 0.0


def climb(steps, point, max_iter):
    """Increase the bound from an evaluated point until the gain is negligible."""
    # steps: ``propose(point, budget)`` returns a new point, or None, and the number of
    # evaluations; ``judge(point, new)`` whether the bound fell and whether its gain was
    # negligible; ``retry()`` whether there is an alternative after a fall;
    # ``accept(point, new, quiet)`` takes the step and returns whether it is the last;
    # ``converged`` is True if the last gain met the tolerance.
    history, used, fall = [point.value], 1, 0.0
    while used < max_iter:
        new, spent = steps.propose(point, max_iter - used)
        used += spent
        if new is None:
            continue
        fell, quiet = steps.judge(point, new)
        if fell:
            if steps.retry():
                continue
            fall = point.value - new.value
            break
        last = steps.accept(point, new, quiet)
        point = new
        history.append(point.value)
        if last:
            break
    status = "converged" if steps.converged else "max_iter"
    return Solution(
        state=point.state,
        history=np.array(history),
        n_iter=used,
        status="bound_decreased" if fall else status,
        fall=fall,
    )


class PlainSteps:
    """The updates as printed in the paper, one after the other."""

    def __init__(self, problem, tol):
        self.problem, self.tol, self.converged = problem, tol, False

    def propose(self, point, budget):
        return self.problem.step(point), 1

    def judge(self, point, new):
        return self.problem.judge(point, new, self.tol)

    def retry(self):
        return False

    def accept(self, point, new, quiet):
        self.converged = quiet
        return quiet


# ------------------------------------------------- plain steps of independent latents


# A state with its bound and its `HiddenExpectations`.
Point = namedtuple("Point", "state value hidden")


class IndependentProblem:
    """The moments and the prior, and the step from one state to the next."""

    def __init__(self, moments, prior):
        self.moments, self.prior = moments, prior

    def evaluate(self, state):
        """Do the E-step and the bound of a state."""
        hidden = expect_hidden(self.moments, state)
        value = data_bound(self.moments, hidden) + prior_bound(state, self.prior)
        return Point(state, value, hidden)

    def update(self, point):
        """Do the M-steps: the state after a point."""
        new = update_loadings(point.state, point.hidden, self.prior)
        new = update_precisions(new, self.prior)
        return update_noise(self.moments, point.state, new, point.hidden, self.prior)

    def step(self, point):
        """Point of the state after the M-steps."""
        return self.evaluate(self.update(point))

    def judge(self, point, new, tol):
        """Whether a step lowered the bound, and whether its gain was negligible."""
        n, gain = self.moments.n, new.value - point.value
        fell = gain < -rounding_of_bound(new.value, n, new.state.psi_y)
        return fell, abs(gain) <= tol * n


def start(moments, prior, input_noise):
    """Return the documented starting point."""
    # Shares `input_noise` (d,) of the inputs' variances start as noise. The loadings to
    # z start along the covariance with y, with the step that fits y best (one component
    # of PLS); the rest of y is split between the noise of y and of the z.
    n, d = moments.n, moments.xx.shape[0]
    psi_x = input_noise if prior.psi_x_fixed is None else prior.psi_x_fixed
    w_x = np.sqrt(np.maximum(1.0 - psi_x, VARIANCE_FLOOR))
    direction = moments.xy
    curvature = ((moments.R @ direction) ** 2).sum()
    step = (direction @ direction) / curvature if curvature > 0 else 0.0
    w_z = step * direction / w_x
    explained = step * (direction @ direction)
    rest = max(moments.yy - explained, VARIANCE_FLOOR * moments.yy) / n
    shape = prior.ard_shape + (1.0 if prior.coupled else 0.5)
    variance = np.full(d, 1.0 / n) if prior.ard else np.zeros(d)
    return LatentState(
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


# ---------------------------------------------------------------- quasi-Newton steps

_TINY = float(np.finfo(float).tiny)
# Largest logarithm: its exponential must not overflow.
LARGEST_LOG = 300.0


def _blocks(prior):
    """Names of the free blocks in order; psi_y comes last."""
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
    # Loadings as they are, variances as logarithms, so that any real vector is a state.
    # The precisions alpha are left out: at their explicit optimum they do not
    # contribute to the gradient.
    parts = [
        values if name.endswith("mean") else np.log(np.maximum(values, _TINY))
        for name in _blocks(prior)
        for values in (getattr(state, name),)
    ]
    return np.concatenate([*parts, [np.log(state.psi_y)]])


def from_vector(vector, like, prior):
    """State with these coordinates; the rest is taken from `like`."""
    names = _blocks(prior)
    rows = vector[:-1].reshape(len(names), -1)
    values = {}
    for name, row in zip(names, rows):
        if not name.endswith("mean"):
            row = np.exp(np.clip(row, -LARGEST_LOG, LARGEST_LOG))
        values[name] = np.maximum(row, VARIANCE_FLOOR) if name[:3] == "psi" else row
    psi_y = np.exp(np.clip(vector[-1], -LARGEST_LOG, LARGEST_LOG))
    values["psi_y"] = max(float(psi_y), VARIANCE_FLOOR)
    return update_precisions(replace(like, **values), prior)


# Gradient of the bound, and the inverse curvature implied by an EM step: ``scale *
# gradient`` is that step to first order in the logarithms. The gradient is zero where a
# variance is at its floor and would decrease further.
Slope = namedtuple("Slope", "gradient scale")


def slope(moments, state, hidden, prior):
    """Gradient of the bound at `state`, whose alpha is at its optimum."""
    # With q(Z, T) at its optimum the bound has the gradient of the expected
    # log-likelihood alone (Fisher's identity): each entry is the residual of the
    # stationarity condition that the update of the same name solves.
    n, S_tt, weight = moments.n, hidden.S_tt, prior.psi_x_weight
    alpha = state.E_alpha if prior.ard else 0.0
    alpha_x = alpha if prior.ard and prior.coupled else 0.0
    # Without a change of loadings the updates are eqs. 14 to 16 at this state.
    new = update_noise(moments, state, state, hidden, replace(prior, psi_x_weight=0.0))
    on_z, on_x = S_tt / state.psi_z + alpha, S_tt / state.psi_x + alpha_x

    def falling(name):
        now = getattr(state, name)
        on = 0.5 * n * (getattr(new, name) / now - 1.0)
        if name == "psi_x" and weight:
            on = on + 0.5 * weight * (prior.psi_x_mode / now - 1.0)
        return np.where((now <= VARIANCE_FLOOR) & (on < 0), 0.0, on)

    parts = {
        "w_z_mean": (
            (hidden.S_zt - state.w_z_mean * S_tt) / state.psi_z
            - alpha * state.w_z_mean,
            1.0 / on_z,
        ),
        "w_x_mean": (
            (hidden.S_xt - state.w_x_mean * S_tt) / state.psi_x
            - alpha_x * state.w_x_mean,
            1.0 / on_x,
        ),
        "psi_z": (falling("psi_z"), 2.0 / n),
        "psi_x": (falling("psi_x"), 2.0 / (n + weight)),
        "w_z_var": (0.5 * (1.0 - state.w_z_var * on_z), 2.0),
        "w_x_var": (0.5 * (1.0 - state.w_x_var * on_x), 2.0),
        "psi_y": (falling("psi_y"), 2.0 / n),
    }
    pairs = [np.broadcast_arrays(*parts[name]) for name in [*_blocks(prior), "psi_y"]]
    return Slope(*(np.hstack(side) for side in zip(*pairs)))


# Pairs of steps and changes of the gradient that are kept: the usual number of
# limited-memory quasi-Newton methods (Nocedal and Wright, 2006, section 7.2).
_MEMORY = 10
# Share of the gain predicted by the slope that a step must achieve (c1 there).
ENOUGH = 1e-4
# Trials along one direction before the plain step is taken instead.
_TRIALS = 4


# Search points lie on a grid of this share of the output's deviation. A quasi-Newton
# method amplifies rounding of the sums from step to step; the grid removes it, so that
# the same data in another order give the same estimate. The loss of bound, some 1e-12
# per sample and input, is far below `tol`.
_GRID = 2.0**-20


def _on_grid(vector, point):
    """Round coordinates to the grid of a point, whose width is a power of two."""
    deviation = np.sqrt(min(point.hidden.y_var, 1.0))
    width = _GRID * 2.0 ** np.floor(np.log2(deviation))
    return np.round(vector / width) * width


class QuasiNewtonSteps(PlainSteps):
    """Quasi-Newton steps where they raise the bound, else the plain one."""

    # The plain iteration converges slowly along flat directions: its step is a Newton
    # step with a diagonal curvature that is much too large. Correcting it by past steps
    # takes far fewer iterations: the quasi-Newton acceleration of EM by Jamshidian and
    # Jennrich (1997), with the two-loop recursion in place of a matrix.

    def __init__(self, problem, tol):
        super().__init__(problem, tol)
        self.steps, self.changes = deque(maxlen=_MEMORY), deque(maxlen=_MEMORY)
        self.here, self.quiet = None, 0

    def propose(self, point, budget):
        prior, spent = self.problem.prior, 0
        # Near an exact fit gradients are rounding, more than the grid absorbs.
        if self.here is not None and rounding_of_fit(point.hidden.y_var) <= _GRID:
            direction = self._direction()
            if direction is not None:
                new, spent = self._search(point, direction, min(_TRIALS, budget))
                if new is not None or spent >= budget:
                    return new, spent
        self.steps.clear()
        self.changes.clear()
        plain = self.problem.update(point)
        vector = _on_grid(to_vector(plain, prior), point)
        new = self.problem.evaluate(from_vector(vector, plain, prior))
        if new.value >= point.value:
            return new, spent + 1
        return self.problem.evaluate(plain), spent + 2

    def _learn(self, step, after):
        """Add a pair, unless the bound is not concave along it."""
        change = self.here.gradient - after.gradient
        along = step @ change
        size = np.sqrt(
            (change @ (after.scale * change)) * (step @ (step / after.scale))
        )
        if along > np.sqrt(np.finfo(float).eps) * size:
            self.steps.append(step)
            self.changes.append(change)

    def _direction(self):
        """Quasi-Newton direction, or None without any pair."""
        if not self.steps:
            return None
        slope = self.here
        rest, parts = slope.gradient.copy(), []
        for step, change in zip(reversed(self.steps), reversed(self.changes)):
            parts.append((step @ rest) / (step @ change))
            rest -= parts[-1] * change
        step, change = self.steps[-1], self.changes[-1]
        length = (step @ change) / (change @ (slope.scale * change))
        ascent = length * slope.scale * rest
        for step, change in zip(self.steps, self.changes):
            ascent += step * (parts.pop() - (change @ ascent) / (step @ change))
        ascent[slope.gradient == 0.0] = 0.0  # variances at their floor
        return ascent if ascent @ slope.gradient > 0 else None

    def _search(self, point, direction, trials):
        """First point along the direction that gains enough, and the trials."""
        prior = self.problem.prior
        start = to_vector(point.state, prior)
        promised = direction @ self.here.gradient
        length = 1.0
        for k in range(trials):
            vector = _on_grid(start + length * direction, point)
            trial = self.problem.evaluate(from_vector(vector, point.state, prior))
            if trial.value >= point.value + ENOUGH * length * promised:
                return trial, k + 1
            # The parabola through both values and the slope, within [0.1, 0.5].
            short = 2 * (point.value + length * promised - trial.value)
            share = length * promised / short if np.isfinite(short) else 0.1
            length *= min(max(share, 0.1), 0.5)
        return None, trials

    def judge(self, point, new):
        fell, _ = self.problem.judge(point, new, self.tol)
        return fell, new.value - point.value <= self.tol * self.problem.moments.n

    def accept(self, point, new, quiet):
        """Update the curvature; converged after two negligible gains in a row."""
        prior = self.problem.prior
        there = slope(self.problem.moments, new.state, new.hidden, prior)
        if self.here is not None:
            step = to_vector(new.state, prior) - to_vector(point.state, prior)
            self._learn(step, there)
        self.here = there
        self.quiet = self.quiet + 1 if quiet else 0
        self.converged = self.quiet == 2
        return self.converged


# --------------------------------------------------- the highest likelihood, explicit


def at_highest_likelihood(moments, state, prior):
    """State of highest likelihood that keeps the noise split of `state`, or None."""
    # With z and t integrated out, x_m ~ N(0, V_m) and y | x ~ N(c'x, s), where V_m =
    # w_xm^2 + psi_xm, c_m = w_zm w_xm / V_m, o_m = psi_xm / w_xm^2 and s = psi_y +
    # sum(psi_z) + sum(c_m^2 V_m o_m). Unless the input noise alone exceeds s, the
    # maximum has V_m the variance of x_m, c the least-squares solution and s its
    # residual variance; EM approaches it slowly where inputs are correlated. Unknown
    # noise keeps its ratio to the signal, or all ratios are lowered by one factor, so
    # that their share of the output noise is that in `state`.
    n, variance = moments.n, moments.xx / moments.n
    if prior.psi_x_fixed is None:
        share = state.psi_x / (state.psi_x + state.w_x_mean**2)
    else:
        share = np.minimum(prior.psi_x_fixed / variance, 1.0)
    signal = np.maximum(1.0 - share, 0.0)
    used = signal > VARIANCE_FLOOR
    odds = np.where(used, share / np.where(used, signal, 1.0), 0.0)

    c = np.where(used, coefficients_noisy(state), 0.0)
    # The shortest step to least squares in the inputs in use.
    left = moments.z - moments.R @ c
    c[used] += linalg.lstsq(moments.R[:, used], left)[0]
    s = moments.residual(c)[1] / n
    through = c**2 * variance @ odds
    if through > s:
        if prior.psi_x_fixed is not None:
            return None
        old = coefficients_noisy(state) ** 2 @ (
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


def _end(problem, solution):
    """Move to the maximum of the likelihood if it has a closed form."""
    moments, prior = problem.moments, problem.prior
    solution = replace(solution, n_iter=solution.n_iter + 1)
    highest = at_highest_likelihood(moments, solution.state, prior)
    if highest is None:
        return solution
    reached, top = problem.evaluate(solution.state), problem.evaluate(highest)
    slack = rounding_of_bound(reached.value, moments.n, reached.hidden.y_var)
    if not top.value >= reached.value - slack:
        return solution
    best = max(top.value, solution.history[-1])  # to rounding
    return replace(solution, state=highest, history=np.append(solution.history, best))


# ----------------------------------------------------------------- independent latents


def solve(moments, state, prior, *, max_iter, tol):
    """Iterate until the bound gains less than `tol` per sample."""
    # A step that does not raise the bound is replaced by the plain one: the bound never
    # falls, and the fixed points are the same. Without priors the last step goes to the
    # closed-form maximum, unless the input noise is known to be large.
    if prior.psi_x_fixed is not None:
        prior = replace(
            prior, psi_x_fixed=np.maximum(prior.psi_x_fixed, VARIANCE_FLOOR)
        )
        state = replace(state, psi_x=prior.psi_x_fixed)
    problem = IndependentProblem(moments, prior)
    # Without a prior the likelihood of an exact fit (residuals are rounding) has no
    # maximum, and an extrapolation would follow rounding errors.
    if not prior.ard and moments.rest <= VARIANCE_FLOOR * moments.yy:
        solution = climb(PlainSteps(problem, tol), problem.evaluate(state), max_iter)
        if solution.status == "bound_decreased":
            return solution
        # The last expectations allow one more update.
        return replace(solution, state=problem.update(problem.evaluate(solution.state)))
    # Along flat directions the last digits of the moments decide where within `tol` a
    # quasi-Newton method stops; they must not depend on the order of the rows.
    rounded = IndependentProblem(moments.without_last_digits(), prior)
    steps = QuasiNewtonSteps(rounded, tol)
    solution = climb(steps, rounded.evaluate(state), max_iter)
    if solution.status != "converged" or prior.ard:
        return solution
    # The last step counts as an iteration.
    if solution.n_iter == max_iter:
        return replace(solution, status="max_iter")
    return _end(problem, solution)
