"""Ranges of signals in the fitted rows, and of the effects that depend on them."""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.effects import HELD, resolve

# A prediction is out of range if it leaves the range of the fit by more than this share
# of its width: there the standard deviation of a straight line through evenly spread
# data is 1.31 times that at the end of the range (Legendre polynomials).
_MARGIN = 0.2
# Share of rows that may lie farther out: peaks of a random motion, and outliers.
_OUTLIERS = 0.005
# Relative difference of two computations of the same motion.
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class SignalRanges:
    """Lowest and highest values of signals in the rows of each joint with weight."""

    # (k, nv): of k signals of each joint; inf and -inf, respectively, without such rows
    lowest: np.ndarray
    highest: np.ndarray

    @classmethod
    def of(cls, signals, counts):
        """Ranges of signals (k arrays of shape (n, nv)) in rows `counts` (n, nv)."""
        return cls(
            lowest=-np.array([_highest(-x, counts) for x in signals]),
            highest=np.array([_highest(x, counts) for x in signals]),
        )

    def pairs(self):
        """Return (lowest, highest) by signal and joint; nan without rows."""
        return [
            [
                (float(low), float(high)) if low <= high else _UNKNOWN
                for low, high in zip(lows, highs)
            ]
            for lows, highs in zip(self.lowest, self.highest)
        ]


_UNKNOWN = (float("nan"), float("nan"))


def _highest(values, counts):
    # Contiguous columns: twice as fast.
    columns = np.ascontiguousarray(np.where(counts, values, -np.inf).T)
    return columns.max(axis=1, initial=-np.inf)


def sum_ranges(ranges):
    """Merge `SignalRanges`; None if one of them is unknown."""
    if any(x is None for x in ranges):
        return None
    return SignalRanges(
        lowest=np.min([x.lowest for x in ranges], axis=0),
        highest=np.max([x.highest for x in ranges], axis=0),
    )


@dataclass(frozen=True, kw_only=True)
class EffectRange:
    """Ranges (lowest, highest) of the joint signals that an effect was fitted on."""

    # Of signals in the band of the fit, in rows with weight in which the joint moves;
    # speed: absolute values; direction: from -1 (backward) to 1 (forward).
    name: str
    joint: int
    position: tuple[float, float]
    speed: tuple[float, float]
    load: tuple[float, float]
    direction: tuple[float, float] = (-1.0, 1.0)
    depends: tuple[str, ...] = ()

    def ends(self, quantity):
        """Return the limits to which a signal of the effect is clipped."""
        # The margin is included, so that every clipped value counts as out of range.
        low, high = getattr(self, quantity)
        if quantity not in self.depends or np.isnan(high - low):
            return -np.inf, np.inf
        margin = self.margin(quantity)
        if quantity == "position":
            return low - margin, high + margin
        largest = max(abs(low), abs(high)) + margin
        return -largest, largest

    def within(self, motion):
        """Return a `Motion` with the signals of the joint clipped to the `ends`."""
        clipped = {}
        for quantity, name in HELD.items():
            low, high = self.ends(quantity)
            values = getattr(motion, name)
            if values is None or low == -np.inf == -high:
                continue
            clipped[name] = values.copy()
            clipped[name][:, self.joint] = np.clip(values[:, self.joint], low, high)
        return replace(motion, **clipped, _speeds={}) if clipped else motion

    def excess(self, quantity, values):
        """Distance of values (n,) from the range; zero inside, or if it is unknown."""
        low, high = getattr(self, quantity)
        values = np.asarray(values, dtype=float)
        beyond = np.maximum(low - values, values - high)
        return np.where(np.isfinite(beyond), np.maximum(beyond, 0.0), 0.0)

    def margin(self, quantity):
        """Distance from the range up to which a law is extrapolated; nan if unknown."""
        low, high = getattr(self, quantity)
        # A range of speeds counts twice, for both directions.
        sides = 2.0 if quantity == "speed" else 1.0
        return _MARGIN * sides * (high - low) + _ROUNDING * max(abs(low), abs(high))


def clipped_motions(effects, ranges, motion):
    """Return the `Motion` of each effect, clipped to its range if it has one."""
    limits = ranges or [None] * len(effects)
    return [motion if x is None else x.within(motion) for x in limits]


@dataclass(frozen=True, kw_only=True)
class OutsideRange:
    """Motion outside the range that effects of a joint were fitted on."""

    names: tuple  # effects that were not fitted there
    joint: int  # joint, from zero
    quantity: str  # signal that is out of range
    fitted: tuple  # range of the fit
    reached: float  # farthest value, without the farthest half per cent of the rows
    share: float  # share of rows outside by more than the margin, see `EffectRange`
    # those of `names` whose torque is constant beyond the margin; others extrapolate
    clipped: tuple = ()


def outside(ranges, signals, clips):
    """Find signals outside the ranges of effects, a tuple of `OutsideRange`."""
    # signals: (n,) in the rows to check, by quantity and joint; clips: whether
    # predictions clip each effect to its range.
    violations = {}
    for effect, clip in zip(ranges, clips, strict=True):
        for quantity in effect.depends:
            key = effect.joint, quantity
            new = _violation(effect, quantity, signals[quantity, effect.joint], clip)
            if new is not None:
                violations.setdefault(key, []).append(new)
    return tuple(
        replace(
            max(same_key, key=lambda x: x.share),
            names=tuple(dict.fromkeys(name for x in same_key for name in x.names)),
            clipped=tuple(dict.fromkeys(name for x in same_key for name in x.clipped)),
        )
        for _, same_key in sorted(violations.items())
    )


def _violation(effect, quantity, values, clip):
    """Return the `OutsideRange` of one effect and signal (n,), None if it is inside."""
    far = values[effect.excess(quantity, values) > effect.margin(quantity)]
    outliers = int(_OUTLIERS * values.size)
    if not far.size > _OUTLIERS * values.size:
        return None
    # Slower motion and the other direction are out of range, but not clipped. Of two
    # values equally far on either side, the larger one counts.
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
        clipped=(effect.name,) if clip and beyond else (),
    )


def effect_ranges(friction, effects, motion, load=None):
    """Return an `EffectRange` for each joint's declared friction, then each effect."""
    # friction: declared columns; effects: tuple of Effect; motion: `SignalRanges` of
    # positions, speeds and directions; load: that of the loads, or None.
    positions, speeds, directions = motion.pairs()
    nv = len(positions)
    loads = nv * [_UNKNOWN] if load is None else load.pairs()[0]
    declared = resolve(friction) if friction else ()
    pairs = [(effect, joint) for joint in range(nv) for effect in declared]
    pairs += [(effect, effect.joint) for effect in effects]
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
        for effect, joint in pairs
    )
