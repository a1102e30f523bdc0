"""Shape parameters of effects between the points of their grid."""

from dataclasses import dataclass, replace

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._problem import Columns, Fit
from sklearn_vbjfa.effects import Bank, Effect, Sudden

# A search ends where a step promises less [nats], or after this many steps; a shape
# whose own step promises less stays.
MIN_GAIN, MOST_STEPS = 0.05, 4
# Shares of a step that are taken until one leads up.
STEP_SHARES = (1.0, 0.5, 0.25)
# Step of the derivatives in shares of the way between the grid's next points: of smooth
# columns, and of those that change in single rows.
_DERIVATIVE, _COARSE = 0.01, 0.1
# Instants at which a jump is tried, twice, in this share of the way to the grid's next
# ones on both sides.
_INSTANTS, _AROUND = 9, 0.1
# Instants of a jump that are looked at more closely.
_JUMPS = 3
# Rows left out: so many times as long as between two rows.
_GAP = 1.5
# Prior deviation of a step, over the way between the grid's points: none.
_FLAT_PRIOR = 1e3
# Period of an angle.
_PERIOD = 2 * np.pi


def _bracket(effect, name, motion):
    """Place of a shape parameter, its bounds, those of its grid, whether logarithms."""
    # None where the grid has no neighbours.
    value, searched_on = getattr(effect, name), {*effect.continuous}
    grid = np.unique(
        [
            shape.get(name, value)
            for shape in effect.shapes(motion)
            if all(shape[k] == getattr(effect, k) for k in shape.keys() - searched_on)
        ]
    )
    if name in effect.cyclic and grid.size > 1:
        grid = np.concatenate([grid - _PERIOD, grid, grid + _PERIOD])
        at = int(np.argmin(np.abs(grid - value)))
        return value, grid[at - 1], grid[at + 1], -np.inf, np.inf, False
    grid = grid[np.sign(grid) == np.sign(value)]
    if value == 0 or grid.size < 2:
        return None
    at, positive = int(np.argmin(np.abs(grid - value))), bool(value > 0)
    if positive:
        value, grid = np.log(value), np.log(grid)
    low, high = grid[max(at - 1, 0)], grid[min(at + 1, grid.size - 1)]
    return value, low, high, grid[0], grid[-1], positive


@dataclass(frozen=True, kw_only=True)
class ShapePoint:
    """An effect among its shapes, and how far a step may lead."""

    effect: Effect
    names: tuple  # of the d shape parameters that are searched
    # (d,) each: places of these, the grid's next points on both sides, and the ends of
    # the grid, infinite for an angle; of the logarithm where that is searched
    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray
    logarithmic: np.ndarray  # (d,), bool

    @classmethod
    def of(cls, effect, motion):
        """Return that of an effect; None if its shapes have no neighbours or slopes."""
        smooth = () if isinstance(effect, Bank) else effect.continuous
        found = {name: _bracket(effect, name, motion) for name in smooth}
        found = {name: one for name, one in found.items() if one is not None}
        if not found:
            return None
        kinds = ("values", "low", "high", "lowest", "highest", "logarithmic")
        columns = dict(zip(kinds, map(np.array, zip(*found.values()))))
        return cls(effect=effect, names=tuple(found), **columns)

    @property
    def width(self):
        """Way between the grid's next points, (d,)."""
        return self.high - self.low

    @property
    def steps(self):
        """Steps of the derivatives, (d,)."""
        coarse = [name in self.effect.coarse for name in self.names]
        step = np.where(coarse, _COARSE, _DERIVATIVE) * self.width
        return np.where(self.values + step > self.highest, -step, step)

    def at(self, values):
        """Return the effect elsewhere."""
        shape = {}
        for name, u, is_log in zip(self.names, values.tolist(), self.logarithmic):
            value = float(np.exp(u)) if is_log else u
            shape[name] = value % _PERIOD if name in self.effect.cyclic else value
        return clone(self.effect).set_params(**shape)

    def around(self):
        """Return the effect, and with each parameter changed a little."""
        return [self.effect, *map(self.at, self.values + np.diag(self.steps))]

    def moved(self, step):
        """Return the place after a step (d,), as far as that may lead."""
        # A single parameter stays between its neighbours; one of several, which may
        # trade against each other, may leave them behind.
        alone = len(self.names) == 1
        ends = (self.low, self.high) if alone else (self.lowest, self.highest)
        step = np.clip(step, -self.width / 2, self.width / 2)
        values = np.clip(self.values + step, *ends)
        return replace(self, effect=self.at(values), values=values)

    def with_derivatives(self, member, around, coef):
        """Return a member whose columns are followed by their derivatives (d,)."""
        # around: `Columns` of the shapes of that name.
        change = around.values[:, :, 1:] - around.values[:, :, :1]
        slopes = change @ coef / self.steps
        values = np.concatenate([around.values[:, :, 0], slopes], axis=2)
        free = np.full(self.values.size, _FLAT_PRIOR / member.scale) * self.width
        unit = np.concatenate([member.unit, free])[None]
        known = [member.effect], member.joints, values[:, :, None], unit, around.edges
        return replace(member, columns=Columns(*known))


def step_shapes(fit, numbers):
    """Search the shapes of members, which trade against each other, at once."""
    # By Gauss and Newton: the derivatives of the columns are further columns.
    problem, motion = fit.problem, fit.problem.motion
    places = {i: ShapePoint.of(fit.members[i].effect, motion) for i in numbers}
    places = {i: place for i, place in places.items() if place is not None}
    families = {i: problem.shaped(p.around()) for i, p in places.items()}
    for _ in range(MOST_STEPS):
        members = list(fit.members)
        for i, place in places.items():
            known = members[i], families[i], fit.coefficients(i)
            members[i] = place.with_derivatives(*known)
        linear = Fit(fit.base, members)
        ways = {i: _newton_step(linear, i, fit.members[i].width) for i in places}
        ways = {i: way for i, (way, promised) in ways.items() if promised > MIN_GAIN}
        if not ways or linear.explained - fit.explained < MIN_GAIN:
            break
        places = {i: places[i] for i in ways}
        for share in STEP_SHARES:
            moved = {i: place.moved(share * ways[i]) for i, place in places.items()}
            made = {i: problem.shaped(p.around()) for i, p in moved.items()}
            new = list(fit.members)
            for i, family in made.items():
                new[i] = family.member(0, new[i].scale)
            again = Fit(fit.base, new)
            if again.log_evidence() > fit.log_evidence():
                break
        else:
            break
        fit, places, families = again, moved, made
    return fit


def _newton_step(linear, i, width):
    """Step (d,) of a member's shape, and what that takes off the error [nats]."""
    place = linear.slices[i]
    rows = slice(place.start + width, place.stop)
    way = linear.coefficients(i)[width:]
    return way, 0.5 * way @ np.linalg.solve(linear.covariance[rows, rows], way)


# -- shapes of an effect that comes into a model, and of the members again


def best_shape(fit, effect, scale):
    """Return an effect, its shape searched between those of its grid."""
    # Smooth parameters are left to the steps with all that comes beside it.
    if isinstance(effect, Bank):
        return bank(fit, effect, fit.problem.shapes(effect), scale)
    if isinstance(effect, Sudden):
        return jump(fit, effect, scale)
    return effect


def search_shapes(fit, numbers, scale):
    """Search the shapes of members again, all at once or one by one."""
    fit = step_shapes(fit, numbers)
    for i in numbers:
        effect, rest = fit.members[i].effect, fit.without(i)
        if isinstance(effect, Bank):
            found = bank(rest, effect, fit.problem.shapes(effect), scale)
        elif isinstance(effect, Sudden):
            found = jump(rest, effect, scale)
        else:
            forms = (with_shape(fit, i, form) for form in effect.forms())
            forms = [step_shapes(form, [i]) for form in forms]
            fit = max([fit, *forms], key=Fit.log_evidence)
            continue
        fit = with_shape(fit, i, found)
    return fit


def with_shape(fit, i, effect):
    """Return a fit with another shape of a member."""
    members = list(fit.members)
    members[i] = fit.problem.shaped([effect]).member(scale=members[i].scale)
    return Fit(fit.base, members)


def bank(fit, effect, shapes, scale):
    """Return the best of banks with the elements of positive size given a fit."""
    # Those that do not depend on the load stay when that changes.
    problem, kinds, best = fit.problem, {}, []
    for shape in shapes:
        kinds.setdefault(shape.needs, []).append(shape)
    for some in kinds.values():
        groups = fit.groups(problem.shaped(some))
        evidence = groups.evidence(scale)
        c = int(np.argmax(evidence))
        best.append((evidence[c], some[c], groups.coefficients()[c]))
    _, found, coef = max(best, key=lambda one: one[0])
    used = coef[: len(found.coefficients)] > 0
    if used.any():
        finer = problem.shaped([found.only(used).finer()])
        used = fit.groups(finer).coefficients()[0] > 0
    return problem.only(finer, used).effects[0] if used.any() else effect


# -- instants of jumps


def jump(fit, effect, scale, near=False):
    """Return an effect that jumps with its most probable instant, or one near it."""

    def evidence(effects):
        return fit.groups(fit.problem.shaped(effects)).evidence(scale)

    tried = [effect, *_instants(fit, effect, scale)]
    if near:
        return tried[int(np.argmax(evidence(tried)))]
    return instant(tried, evidence, fit.problem.motion)


def _instants(fit, effect, scale):
    """Return an effect that jumps with the most probable instants of all rows."""
    # What its columns have in common with the residual is a sum over the rows after
    # the jump; their Gram matrix hardly changes between two instants of the grid.
    view, motion = fit.problem.view, fit.problem.motion
    shapes = [e for e in fit.problem.shapes(effect) if e.key() == effect.key()]
    shapes.sort(key=lambda e: e.instant)
    grid = np.array([e.instant for e in shapes])
    beside = fit.groups(fit.problem.shaped(shapes))
    always = clone(effect).set_params(instant=-np.inf)
    columns = view.columns([always], motion)[:, :, 0]
    rest = fit.weighted_rows[effect.acts_on(view.nv)]
    products = np.einsum("jmk,jm->mk", columns, rest)
    after = np.cumsum(products[::-1], axis=0)[::-1]
    t = motion.t[view.index]
    at = np.interp(t, grid, np.arange(grid.size))
    low = np.minimum(at.astype(int), max(grid.size - 2, 0))
    share = (at - low)[:, None, None]
    H = (1 - share) * beside.H[low]
    H += share * beside.H[np.minimum(low + 1, grid.size - 1)]
    near = np.round(at).astype(int)
    own = {"own": beside.own[near], "unit": beside.unit[near]}
    evidence = replace(beside, H=H, q=after, **own).evidence(scale)
    found, apart = [], np.diff(grid).max(initial=0.0) / 4
    for _ in range(_JUMPS):
        best = int(np.argmax(evidence))
        found.append(clone(effect).set_params(instant=float(t[best])))
        evidence = np.where(np.abs(t - t[best]) < apart, -np.inf, evidence)
    return found


def instant(effects, evidence, motion):
    """Search the instant of a jump on, around the best of some."""
    known = evidence(effects)
    found, most = effects[int(np.argmax(known))], float(known.max())
    grid = np.unique([shape["instant"] for shape in found.shapes(motion)])
    between, value = _gaps(motion), found.instant
    if grid.size > 1:
        step = _AROUND * np.diff(grid).max()
        low, high = value - step, value + step
        for _ in range(2):
            places = np.linspace(low, high, _INSTANTS)
            shared = _representative_instants(motion, between, places)
            tried = [clone(found).set_params(instant=float(s)) for s in shared]
            known = evidence(tried)
            best = int(np.argmax(known))
            low, high = places[max(best - 1, 0)], places[min(best + 1, _INSTANTS - 1)]
        if known[best] > most:
            found, most = tried[best], float(known[best])
    # Instants that need no reason, and how good a one others need [nats].
    at = np.searchsorted([s for _, s, _ in between], found.instant)
    plain = between[max(at - 1, 0) : at + 1]
    others = [clone(found).set_params(instant=float(s)) for _, s, _ in plain]
    if others:
        for other, (_, _, width), own in zip(others, plain, evidence(others)):
            if most - own < np.log(width):
                return other
    return found


def _representative_instants(motion, between, places):
    """Instants (c,) that represent others: those of rows, or between recordings."""
    times = np.asarray(motion.t, dtype=float)
    shared = times.copy()
    for row, value, _ in between:
        shared[row] = value
    return shared[np.searchsorted(times[:-1], places)]


def _gaps(motion):
    """List (row, instant before it, how many that is) where rows are not neighbours."""
    # The instant at which a recording begins, or the middle of what is left out.
    times = np.asarray(motion.t, dtype=float)
    step = np.diff(times)
    usual = np.median(step) if step.size else 1.0
    found = {
        int(row): (0.5 * (times[row - 1] + times[row]), step[row - 1] / usual)
        for row in np.flatnonzero(step > _GAP * usual) + 1
    }
    # As probably as at all instants within a recording; of the last, all rows may be
    # left out.
    later = motion.later[motion.later <= times[-1]]
    rows = np.searchsorted(times, later)
    found |= {int(r): (float(s), times.size) for r, s in zip(rows, later)}
    return [(row, *found[row]) for row in sorted(found)]
