"""The ranges of motion that an effect was fitted on, and what lies outside of them."""

from dataclasses import dataclass, replace

import numpy as np

# A prediction is outside where it leaves the range of the fit by more than this share
# of its width. The standard deviation of a straight line through evenly spread data is
# 1.31 times that at the end of the range there, that of a parabola 1.46 times (Legendre
# polynomials), and both grow from there on, the latter with the square.
STRAIGHT, CURVED = 0.2, 0.1
# Share of the rows that may be farther out: peaks of a random motion, and outliers.
OUTLIERS = 0.005
# Share of a value by which two computations of the same motion may differ.
ROUNDING = 1e-9
# Signals of a motion that are held within ranges.
HELD = {"position": "q", "speed": "v", "load": "load"}


@dataclass(frozen=True, kw_only=True)
class EffectRange:
    """Ranges (lowest, highest) of its joint's signals that an effect was fitted on."""

    # Of signals in the band of the fit, in rows with weight in which the joint moves;
    # the speed in either direction; directions from -1, backward, to 1, forward.
    name: str
    joint: int
    position: tuple
    speed: tuple
    load: tuple
    direction: tuple = (-1.0, 1.0)
    depends: tuple = ()
    curved: bool = False

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
        share = CURVED if self.curved else STRAIGHT
        # A range of speeds counts twice, for both directions.
        sides = 2.0 if quantity == "speed" else 1.0
        return share * sides * (high - low) + ROUNDING * max(abs(low), abs(high))


def own_motions(effects, ranges, motion):
    """Return the `Motion` that each effect's columns are made from, in its range."""
    held = ranges or [None] * len(effects)
    pairs = zip(effects, held, strict=True)
    return [motion if one is None else one.within(motion) for _, one in pairs]


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
    outliers = int(OUTLIERS * values.size)
    if not far.size > OUTLIERS * values.size:
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
