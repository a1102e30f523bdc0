"""Ranges of signals in the rows that were fitted, and of the effects made of them."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.effects import EffectRange, resolve


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
