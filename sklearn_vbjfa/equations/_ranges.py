"""Ranges of signals in the rows that were fitted, and of the effects made of them."""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.effects import HELD, resolve

# A prediction is outside where it leaves the range of the fit by more than this share
# of its width: there the standard deviation of a straight line through evenly spread
# data is 1.31 times that at the end of the range (Legendre polynomials).
_MARGIN = 0.2
# Share of the rows that may be farther out: peaks of a random motion, and outliers.
_OUTLIERS = 0.005
# Share of a value by which two computations of the same motion may differ.
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class SignalRanges:
    """Lowest and highest values of signals in the rows of each joint that count."""

    # (k, nv): of k signals of each joint; infinite, of the wrong order, without a row
    lowest: np.ndarray
    highest: np.ndarray

    @classmethod
    def of(cls, signals, counts):
        """Ranges of signals (k arrays of shape (n, nv)) in rows that count, (n, nv)."""
        return cls(
            lowest=-np.array([_highest(-x, counts) for x in signals]),
            highest=np.array([_highest(x, counts) for x in signals]),
        )

    def pairs(self):
        """Return (lowest, highest) by signal and joint; nan where there is no row."""
        return [
            [
                (float(low), float(high)) if low <= high else _UNKNOWN
                for low, high in zip(lows, highs)
            ]
            for lows, highs in zip(self.lowest, self.highest)
        ]


_UNKNOWN = (float("nan"), float("nan"))


def _highest(values, counts):
    # Joint by joint, which is twice as fast.
    columns = np.ascontiguousarray(np.where(counts, values, -np.inf).T)
    return columns.max(axis=1, initial=-np.inf)


def sum_ranges(several):
    """Merge `SignalRanges`; None if one of them is not known."""
    if any(one is None for one in several):
        return None
    return SignalRanges(
        lowest=np.min([one.lowest for one in several], axis=0),
        highest=np.max([one.highest for one in several], axis=0),
    )


@dataclass(frozen=True, kw_only=True)
class EffectRange:
    """Ranges (lowest, highest) of its joint's signals that an effect was fitted on."""

    # Of signals in the band of the fit, in rows with weight in which the joint moves;
    # the speed in either direction; directions from -1, backward, to 1, forward.
    name: str
    joint: int
    position: tuple[float, float]
    speed: tuple[float, float]
    load: tuple[float, float]
    direction: tuple[float, float] = (-1.0, 1.0)
    depends: tuple[str, ...] = ()

    def ends(self, quantity):
        """Between which velocities, positions or loads the effect follows a signal."""
        # With the margin, so that what is held counts as outside.
        low, high = getattr(self, quantity)
        if quantity not in self.depends or np.isnan(high - low):
            return -np.inf, np.inf
        margin = self.margin(quantity)
        if quantity == "position":
            return low - margin, high + margin
        largest = max(abs(low), abs(high)) + margin
        return -largest, largest

    def within(self, motion):
        """Return a `Motion` with the signals of the joint held within the `ends`."""
        held = {}
        for quantity, name in HELD.items():
            low, high = self.ends(quantity)
            values = getattr(motion, name)
            if values is None or low == -np.inf == -high:
                continue
            held[name] = values.copy()
            held[name][:, self.joint] = np.clip(values[:, self.joint], low, high)
        return replace(motion, **held, _speeds={}) if held else motion

    def excess(self, quantity, values):
        """How far values (n,) are outside a range; zero where it is not known."""
        low, high = getattr(self, quantity)
        values = np.asarray(values, dtype=float)
        beyond = np.maximum(low - values, values - high)
        return np.where(np.isfinite(beyond), np.maximum(beyond, 0.0), 0.0)

    def margin(self, quantity):
        """How far outside a range a prediction follows the law; nan if unknown."""
        low, high = getattr(self, quantity)
        # A range of speeds counts twice, for both directions.
        sides = 2.0 if quantity == "speed" else 1.0
        return _MARGIN * sides * (high - low) + _ROUNDING * max(abs(low), abs(high))


def clipped_motions(effects, ranges, motion):
    """Return the `Motion` that each effect's columns are made from, in its range."""
    held = ranges or [None] * len(effects)
    return [motion if one is None else one.within(motion) for one in held]


@dataclass(frozen=True, kw_only=True)
class OutsideRange:
    """Motion outside the range that effects of a joint were fitted on."""

    names: tuple  # effects that were not fitted there
    joint: int  # joint, from zero
    quantity: str  # what is outside
    fitted: tuple  # range of the fit
    reached: float  # farthest value, but for the farthest half per cent of the rows
    share: float  # rows that lie outside by more than the margin, see `EffectRange`
    # those of them whose torque is held beyond the margin; others go on by their law
    held: tuple = ()


def outside(ranges, signals, held):
    """Find what lies outside the ranges of effects, a tuple of `OutsideRange`."""
    # signals: (n,) in the rows to judge, by quantity and joint; held: whether
    # predictions hold each effect within its range.
    found = {}
    for one, holds in zip(ranges, held, strict=True):
        for quantity in one.depends:
            place = one.joint, quantity
            judged = _judged(one, quantity, signals[quantity, one.joint], holds)
            if judged is not None:
                found.setdefault(place, []).append(judged)
    return tuple(
        replace(
            max(several, key=lambda one: one.share),
            names=tuple(dict.fromkeys(name for one in several for name in one.names)),
            held=tuple(dict.fromkeys(name for one in several for name in one.held)),
        )
        for _, several in sorted(found.items())
    )


def _judged(effect, quantity, values, holds):
    """Return the `OutsideRange` of one effect and signal (n,), None if it is inside."""
    excess = effect.excess(quantity, values)
    far = values[excess > effect.margin(quantity)]
    outliers = int(_OUTLIERS * values.size)
    if not far.size > _OUTLIERS * values.size:
        return None
    # Slower motion and the other direction are outside, but not beyond an end. Of two
    # values on either side, equally far, the larger one counts.
    low, high = effect.ends(quantity)
    beyond = bool(((far < low) | (far > high)).any())
    farthest = far[np.lexsort((far, effect.excess(quantity, far)))]
    return OutsideRange(
        names=(effect.name,),
        joint=effect.joint,
        quantity=quantity,
        fitted=getattr(effect, quantity),
        reached=float(farthest[-1 - outliers]),
        share=far.size / values.size,
        held=(effect.name,) if holds and beyond else (),
    )


def effect_ranges(friction, effects, motion, load=None):
    """Return an `EffectRange` for each joint's declared friction, then each effect."""
    # friction: names of the declared columns; effects: tuple of Effect; motion:
    # `SignalRanges` of positions, speeds and directions; load: that of the loads, if it
    # is known.
    positions, speeds, directions = motion.pairs()
    nv = len(positions)
    loads = nv * [_UNKNOWN] if load is None else load.pairs()[0]
    declared = resolve(friction) if friction else ()
    used = [(effect, joint) for joint in range(nv) for effect in declared]
    used += [(effect, effect.joint) for effect in effects]
    return tuple(
        EffectRange(
            name=effect.name,
            joint=joint,
            position=positions[joint],
            speed=speeds[joint],
            load=loads[joint],
            direction=directions[joint],
            depends=effect.depends,
        )
        for effect, joint in used
    )
