"""Continuous refinement of shape parameters between the points of their grid."""

import math
from dataclasses import dataclass, replace

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._problem import Columns, Fit
from sklearn_vbjfa.effects import Bank, Effect, Sudden

# Minimum expected gain of a step of all or one shape [nats]; most steps.
MIN_GAIN, MOST_STEPS = 0.05, 4
# Step lengths of the backtracking line search.
STEP_SHARES = (1.0, 0.5, 0.25)
# Finite-difference step over the distance of the neighbouring grid points: of smooth
# columns, and of columns that change in single rows.
_DERIVATIVE, _COARSE = 0.01, 0.1
# Instants of a jump per refinement, first within this share of the grid on both sides.
_INSTANTS, _AROUND = 9, 0.5
# Number of instants of a jump that are compared; how often each of its two times is
# located given the other.
_JUMPS, _EXCHANGES = 5, 2
# A gap is longer than so many sampling times.
_GAP = 1.5
# Prior standard deviation of a step over the grid spacing: practically flat.
_FLAT_PRIOR = 1e3
# Period of an angle.
_PERIOD = 2 * np.pi


def _bracket(effect, name, motion):
    """Return a shape parameter, its neighbours on the grid, and the grid's ends."""
    # None without neighbours. Logarithms of sizes, except angles.
    value, continuous = getattr(effect, name), {*effect.continuous}
    grid = np.unique(
        [
            shape.get(name, value)
            for shape in effect.shapes(motion)
            if all(shape[k] == getattr(effect, k) for k in shape.keys() - continuous)
        ]
    )
    if name in effect.cyclic:
        grid = np.concatenate([grid - _PERIOD, grid, grid + _PERIOD])
        ends = -np.inf, np.inf
    else:
        grid = grid[np.sign(grid) == np.sign(value)]
        if grid.size < 2:
            return None
        value, grid = np.log(abs(value)), np.sort(np.log(np.abs(grid)))
        ends = grid[0], grid[-1]
    nearest = int(np.argmin(np.abs(grid - value)))
    return (
        value,
        grid[max(nearest - 1, 0)],
        grid[min(nearest + 1, grid.size - 1)],
        *ends,
    )


@dataclass(frozen=True, kw_only=True)
class ShapePoint:
    """An effect with its shape parameters as a point, and their bounds."""

    effect: Effect
    names: tuple  # names of the d continuous shape parameters
    # (d,) each, see `_bracket`
    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray

    @classmethod
    def of(cls, effect, motion):
        """Return the point of an effect; None without continuous parameters."""
        smooth = () if isinstance(effect, Bank) else effect.continuous
        brackets = {name: _bracket(effect, name, motion) for name in smooth}
        brackets = {name: b for name, b in brackets.items() if b is not None}
        if not brackets:
            return None
        arrays = map(np.array, zip(*brackets.values()))
        fields = dict(zip(("values", "low", "high", "lowest", "highest"), arrays))
        return cls(effect=effect, names=tuple(brackets), **fields)

    @property
    def width(self):
        """Distance of the neighbouring grid points, (d,)."""
        return self.high - self.low

    @property
    def steps(self):
        """Finite-difference steps, (d,)."""
        coarse = [name in self.effect.coarse for name in self.names]
        step = np.where(coarse, _COARSE, _DERIVATIVE) * self.width
        return np.where(self.values + step > self.highest, -step, step)

    def at(self, values):
        """Return the effect with other values."""
        shape = {}
        for name, u in zip(self.names, values.tolist()):
            if name in self.effect.cyclic:
                shape[name] = u % _PERIOD
            else:
                shape[name] = math.copysign(math.exp(u), getattr(self.effect, name))
        return clone(self.effect).set_params(**shape)

    def around(self):
        """Return the effect, and its perturbations in each parameter."""
        return [self.effect, *map(self.at, self.values + np.diag(self.steps))]

    def moved(self, step):
        """Return the point after a step (d,), clipped to its bounds."""
        # A single parameter stays between its neighbours; correlated ones may not.
        single = len(self.names) == 1
        bounds = (self.low, self.high) if single else (self.lowest, self.highest)
        step = np.clip(step, -self.width / 2, self.width / 2)
        values = np.clip(self.values + step, *bounds)
        return replace(self, effect=self.at(values), values=values)

    def with_derivatives(self, member, around, coef):
        """Append the derivatives (d,) of a member's columns to these."""
        # around: `Columns` of the effects that `around` returns.
        change = around.values[:, :, 1:] - around.values[:, :, :1]
        slopes = change @ coef / self.steps
        values = np.concatenate([around.values[:, :, 0], slopes], axis=2)
        step_unit = np.full(self.values.size, _FLAT_PRIOR / member.scale) * self.width
        unit = np.concatenate([member.unit, step_unit])[None]
        args = [member.effect], member.joints, values[:, :, None], unit, around.edges
        return replace(member, columns=Columns(*args))


def step_shapes(fit, indices):
    """Refine the shapes of members jointly by the Gauss-Newton method."""
    # The derivatives of the columns are additional columns.
    problem, motion = fit.problem, fit.problem.motion
    points = {i: ShapePoint.of(fit.members[i].effect, motion) for i in indices}
    points = {i: point for i, point in points.items() if point is not None}
    families = {i: problem.columns(p.around()) for i, p in points.items()}
    for _ in range(MOST_STEPS):
        members = list(fit.members)
        for i, point in points.items():
            arguments = members[i], families[i], fit.coefficients(i)
            members[i] = point.with_derivatives(*arguments)
        linear = Fit(fit.base, members)
        steps = {i: _newton_step(linear, i, fit.members[i].width) for i in points}
        steps = {i: step for i, (step, gain) in steps.items() if gain > MIN_GAIN}
        if not steps or linear.explained - fit.explained < MIN_GAIN:
            break
        points = {i: points[i] for i in steps}
        for share in STEP_SHARES:
            moved = {i: point.moved(share * steps[i]) for i, point in points.items()}
            new_families = {i: problem.columns(p.around()) for i, p in moved.items()}
            new_members = list(fit.members)
            for i, family in new_families.items():
                new_members[i] = family.member(0, new_members[i].scale)
            new_fit = Fit(fit.base, new_members)
            if new_fit.log_evidence() > fit.log_evidence():
                break
        else:
            break
        fit, points, families = new_fit, moved, new_families
    return fit


def _newton_step(linear, i, width):
    """Return the step (d,) of a member's shape, and its expected gain [nats]."""
    at = linear.slices[i]
    rows = slice(at.start + width, at.stop)
    step = linear.coefficients(i)[width:]
    return step, 0.5 * step @ np.linalg.solve(linear.covariance[rows, rows], step)


# -- shapes of candidates and of members


def best_shape(fit, effect, scale):
    """Return an effect with its best shape between the grid points."""
    # `step_shapes` refines smooth parameters, jointly with other new members.
    if isinstance(effect, Bank):
        return best_bank(fit, effect, scale)
    if isinstance(effect, Sudden):
        return best_jump(fit, effect, scale)
    return effect


def search_shapes(fit, indices, scale):
    """Refine the shapes of members, jointly where smooth, else one by one."""
    fit = step_shapes(fit, indices)
    for i in indices:
        effect = fit.members[i].effect
        if isinstance(effect, (Bank, Sudden)):
            fit = with_shape(fit, i, best_shape(fit.without(i), effect, scale))
        else:
            forms = (with_shape(fit, i, form) for form in effect.forms())
            forms = (step_shapes(form, [i]) for form in forms)
            fit = max([fit, *forms], key=Fit.log_evidence)
    return fit


def with_shape(fit, i, effect):
    """Return the fit with another shape of a member."""
    members = list(fit.members)
    members[i] = fit.problem.columns([effect]).member(scale=members[i].scale)
    return Fit(fit.base, members)


def best_bank(fit, effect, scale):
    """Return the best bank given a fit, with its elements of positive size."""
    problem, shapes = fit.problem, fit.problem.shapes(effect)
    groups = fit.groups(problem.columns(shapes))
    c = int(np.argmax(groups.evidence(scale)))
    chosen, coef = shapes[c], groups.coefficients()[c]
    used = coef[: len(chosen.coefficients)] > 0
    if used.any():
        chosen = chosen.only(used).finer()
        used = fit.groups(problem.columns([chosen])).coefficients()[0] > 0
    return chosen.only(used) if used.any() else effect


# -- instants of jumps


def best_jump(fit, effect, scale):
    """Return a jump with its most probable times."""

    def evidence(effects):
        return fit.groups(fit.problem.columns(effects)).evidence(scale)

    view, motion = fit.problem.view, fit.problem.motion
    permanent = clone(effect).set_params(until=None)
    started = clone(effect).set_params(instant=-np.inf, until=None)
    rows = view.columns([started], motion)[:, :, 0]
    effects = [effect, *_instants(fit, permanent, rows, scale)]
    values = evidence(effects)
    # It may have ended, or begun, at another instant: each is located given the other.
    time = effects[int(np.argmax(values))].instant
    penalty = np.log(len(effect.shapes(motion)))
    values[0] -= penalty * (effect.until is not None)
    for _ in range(_EXCHANGES):
        columns = fit.problem.columns([clone(permanent).set_params(instant=time)])
        size = fit.groups(columns).best_scale(scale)[0]
        given = fit.with_member(columns.member(scale=float(size)))
        others = _instants(given, permanent, rows, scale, apart=time)
        pairs = [sorted((time, other.instant)) for other in others]
        pulses = [clone(effect).set_params(instant=a, until=b) for a, b in pairs]
        gains = evidence(pulses)
        place = int(np.argmax(gains))
        time = others[place].instant
        effects.append(pulses[place])
        values = np.append(values, gains[place] - penalty)
    best = effects[int(np.argmax(values))]
    for name in best.shape():
        best = refine_instant(best, evidence, motion, name)
    return best


def _instants(fit, effect, columns, scale, apart=np.inf):
    """Return a jump at the most probable instants of all rows `apart` from one."""
    # columns (nj, m, k): of a jump before all rows. Products with the residual are
    # cumulative sums over the rows after the jump; the Gram matrix is interpolated
    # between the instants of the grid.
    view, motion = fit.problem.view, fit.problem.motion
    shapes = [e for e in fit.problem.shapes(effect) if e.until is None]
    shapes.sort(key=lambda e: e.instant)
    grid = np.array([e.instant for e in shapes])
    groups = fit.groups(fit.problem.columns(shapes))
    residual = fit.weighted_rows[effect.acts_on(view.nv)]
    products = np.einsum("jmk,jm->mk", columns, residual)
    after = np.cumsum(products[::-1], axis=0)[::-1]
    t = motion.t[view.index]
    position = np.interp(t, grid, np.arange(grid.size))
    low = np.minimum(position.astype(int), max(grid.size - 2, 0))
    share = (position - low)[:, None, None]
    H = (1 - share) * groups.H[low]
    H += share * groups.H[np.minimum(low + 1, grid.size - 1)]
    near = np.round(position).astype(int)
    fields = {"norms": groups.norms[near], "unit": groups.unit[near]}
    evidence = replace(groups, H=H, q=after, **fields).evidence(scale)
    spacing, best_effects = np.diff(grid).max(initial=0.0), []
    # Outside the grid the Gram matrix cannot be interpolated.
    unknown = (t < grid[0]) | (t > grid[-1]) | (np.abs(t - apart) < spacing)
    evidence = np.where(unknown, -np.inf, evidence)
    for _ in range(_JUMPS):
        best = int(np.argmax(evidence))
        best_effects.append(clone(effect).set_params(instant=float(t[best])))
        evidence = np.where(np.abs(t - t[best]) < spacing, -np.inf, evidence)
    return best_effects


def refine_instant(estimate, evidence, motion, name="instant"):
    """Refine the instant of a jump, or its end."""

    def moved(instants):
        return [clone(estimate).set_params(**{name: s}) for s in instants.tolist()]

    best_value = float(evidence([estimate])[0])
    grid = np.unique([shape["instant"] for shape in estimate.shapes(motion)])
    instants, prior = _row_instants(motion)
    if grid.size > 1:
        step = _AROUND * np.diff(grid).max()
        low, high = getattr(estimate, name) - step, getattr(estimate, name) + step
        for _ in range(3):
            trials = np.linspace(low, high, _INSTANTS)
            tried = moved(instants[np.searchsorted(motion.t[:-1], trials)])
            values = evidence(tried)
            best = int(np.argmax(values))
            low, high = trials[max(best - 1, 0)], trials[min(best + 1, _INSTANTS - 1)]
        if values[best] > best_value:
            estimate, best_value = tried[best], float(values[best])
    # Prefer an adjacent gap unless the evidence exceeds its prior advantage [nats].
    gaps = np.flatnonzero(prior)
    index = np.searchsorted(instants[gaps], getattr(estimate, name))
    adjacent = gaps[max(index - 1, 0) : index + 1]
    if others := moved(instants[adjacent]):
        for other, advantage, x in zip(others, prior[adjacent], evidence(others)):
            if best_value - x < advantage:
                return other
    return estimate


def _row_instants(motion):
    """Return an instant before each row, and its prior advantage [nats], (n,) each."""
    # A gap counts as its middle, as probable as all missing rows together, the start of
    # a recording as probable as all rows. Skip recordings after the last row.
    instants, prior = motion.t.astype(float), np.zeros(motion.t.size)
    step = np.diff(motion.t) / np.median(np.diff(motion.t))
    after = np.flatnonzero(step > _GAP) + 1
    instants[after] = 0.5 * (motion.t[after - 1] + motion.t[after])
    prior[after] = np.log(step[after - 1])
    starts = motion.later[motion.later <= motion.t[-1]]
    after = np.searchsorted(motion.t, starts)
    instants[after], prior[after] = starts, np.log(motion.t.size)
    return instants, prior
