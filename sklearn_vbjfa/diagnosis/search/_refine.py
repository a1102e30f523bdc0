"""Shape parameters of effects between the points of their grid."""

from dataclasses import dataclass

import numpy as np
from scipy import optimize
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._view import variants

# The search of shape parameters ends where the evidence rises by less [nats], or after
# this many trials.
_WORTH, _MOST_TRIALS = 0.01, 100
# Sizes of the simplex, in shares of the way to the neighbours: it is begun once more,
# as it may have become flat.
_SIMPLEX = 0.25, 0.05
# Points of the grid from which several parameters are searched: two of them may trade
# against each other.
_STARTS = 3
# Instants from the best of which a jump is searched, in this share of the way to the
# grid's next ones on both sides.
_INSTANTS, _AROUND = 9, 0.1
# Rows left out: so many times as long as between two rows.
_GAP = 1.5
# A parameter that does nothing at a value stays there unless so much is gained [nats].
_NEUTRAL = 2.0


@dataclass(frozen=True)
class Bracket:
    """A shape parameter between the grid's next points on both sides."""

    # bounds; of the logarithm where that is searched
    low: float
    high: float
    # ends of the whole grid; infinite for an angle
    lowest: float = -np.inf
    highest: float = np.inf
    logarithmic: bool = False  # whether the logarithm is searched
    turn: float = 0.0  # period of an angle; zero for what is none
    # (n,) of a jump: times of rows, and the instant shared since the row before
    instants: tuple | None = None

    @classmethod
    def of(cls, effect, name, motion):
        """Return the bounds of a parameter; None where the grid has no neighbours."""
        value = getattr(effect, name)
        same = [v for v in variants(effect, motion) if v.key() == effect.key()]
        values = np.unique([getattr(v, name) for v in same])
        if name in effect.cyclic and values.size > 1:
            turn = 2 * np.pi
            around = np.concatenate([values - turn, values, values + turn])
            at = int(np.argmin(np.abs(around - value)))
            return cls(around[at - 1], around[at + 1], turn=turn)
        values = values[np.sign(values) == np.sign(value)]
        if value == 0 or values.size < 2:
            return None
        at = int(np.argmin(np.abs(values - value)))
        if name in effect.jumping:
            step = _AROUND * np.diff(values).max()
            ends = value - step, value + step, values[0], values[-1]
            return cls(*ends, instants=_instants(motion))
        positive = bool((values > 0).all())
        scaled = np.log(values) if positive else values
        low, high = scaled[max(at - 1, 0)], scaled[min(at + 1, values.size - 1)]
        return cls(low, high, scaled[0], scaled[-1], positive)

    def value(self, u):
        """Return the parameter at a place between the bounds."""
        if self.turn:
            return float(u % self.turn)
        value = float(np.exp(u) if self.logarithmic else u)
        if self.instants:
            times, shared = self.instants
            return float(shared[np.searchsorted(times[:-1], value)])
        return value

    def place(self, value):
        """Return the place of a parameter."""
        return np.log(value) if self.logarithmic else value


def _instants(motion):
    """Return times of rows and the instants before them: of recordings, the start."""
    times = np.asarray(motion.t, dtype=float)
    shared = times.copy()
    for row, instant, _ in _between(motion):
        shared[row] = instant
    return times, shared


def _between(motion):
    """List (row, instant before it, how many that is) where rows are not neighbours."""
    # The instant at which a recording begins, or the middle of what is left out.
    times = np.asarray(motion.t, dtype=float)
    step = np.diff(times)
    usual = np.median(step) if step.size else 1.0
    found = {
        int(row): (0.5 * (times[row - 1] + times[row]), step[row - 1] / usual)
        for row in np.flatnonzero(step > _GAP * usual) + 1
    }
    # As probably as at all instants within a recording.
    rows = np.searchsorted(times, motion.later)
    found |= {int(r): (float(s), times.size) for r, s in zip(rows, motion.later)}
    return [(row, *found[row]) for row in sorted(found)]


def refined(candidates, evidence, motion):
    """Search shape parameters on between the points of the grid."""
    found = max((_searched(one, evidence, motion) for one in candidates), key=evidence)
    for values, least in _plainer(found, motion):
        plain = clone(found).set_params(**values)
        if evidence(found) - evidence(plain) < least:
            return plain
    return found


def _plainer(effect, motion):
    """Parameters that need a reason to be left, and how good a one [nats]."""
    if effect.neutral:
        return [(dict(effect.neutral), _NEUTRAL)]
    between = _between(motion)
    found = []
    for name in effect.jumping:
        at = np.searchsorted([s for _, s, _ in between], getattr(effect, name))
        found += [
            ({name: float(s)}, np.log(width))
            for _, s, width in between[max(at - 1, 0) : at + 1]
        ]
    return found


def _searched(effect, evidence, motion):
    """Search from one shape."""
    brackets = {n: Bracket.of(effect, n, motion) for n in effect.continuous}
    brackets = {n: bracket for n, bracket in brackets.items() if bracket is not None}
    if not brackets:
        return effect

    def at(places):
        values = {n: b.value(u) for (n, b), u in zip(brackets.items(), places)}
        return clone(effect).set_params(**values)

    search = _along if len(brackets) == 1 else _downhill
    start = [b.place(getattr(effect, n)) for n, b in brackets.items()]
    own = list(brackets.values())
    place, value = search(lambda u: -evidence(at(u)), start, own)
    return at(place) if -value > evidence(effect) else effect


def _along(cost, start, brackets):
    """Search one parameter between its bounds: where, and the cost there."""
    (bracket,) = brackets
    low, high = bracket.low, bracket.high
    if bracket.instants:
        at = np.linspace(low, high, _INSTANTS)
        best = int(np.argmin([cost([u]) for u in at]))
        low, high = at[max(best - 1, 0)], at[min(best + 1, _INSTANTS - 1)]
    found = optimize.minimize_scalar(
        lambda u: cost([u]),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 3e-3 * (high - low)},
    )
    return [found.x], found.fun


def _downhill(cost, start, brackets):
    """Search several parameters, which may trade against each other, as `_along`."""
    # Nelder and Mead's simplex follows a narrow valley; it may leave the neighbours
    # of the start behind, but not what the parameter can be.
    width = np.array([b.high - b.low for b in brackets])
    for share in _SIMPLEX:
        simplex = np.vstack([start, start + share * np.diag(width)])
        found = optimize.minimize(
            cost,
            start,
            method="Nelder-Mead",
            bounds=[(b.lowest, b.highest) for b in brackets],
            options={
                "initial_simplex": simplex,
                "xatol": 1e-3 * width.min(),
                "fatol": _WORTH,
                "maxfev": _MOST_TRIALS,
            },
        )
        start = found.x
    return found.x, found.fun


def starts(effects, evidence, best):
    """Return the shapes of a grid to search on from, of one use of an effect."""
    # A single parameter is searched around its best value; two may trade against each
    # other, with several peaks, none of which lies beside a better one.
    same = [i for i, e in enumerate(effects) if e.key() == best.key()]
    order = sorted(same, key=lambda i: -evidence[i])
    names = best.continuous
    if len(names) < 2:
        return [best]
    apart = []
    for name in names:
        values, place = np.unique(
            [getattr(e, name) for e in effects], return_inverse=True
        )
        steps = np.abs(place[:, None] - place)
        if name in best.cyclic:
            steps = np.minimum(steps, values.size - steps)
        apart.append(steps)
    near = np.max(apart, axis=0) <= 1
    found = []
    for i in order:
        if not near[i, found].any():
            found.append(i)
    return [effects[i] for i in found[:_STARTS]]
