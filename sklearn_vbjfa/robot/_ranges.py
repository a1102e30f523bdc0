"""Ranges of a robot's signals in the rows of a fit, and those of each effect."""

import functools
import operator
import warnings
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.effects import (
    OUTLIERS,
    POSITION,
    ROUNDING,
    SPEED,
    STRAIGHT,
    TORQUE,
    EffectRange,
    resolve,
)

_UNITS = {"position": POSITION, "speed": SPEED, "load": TORQUE}
_WAYS = ("forward motion", "backward motion")
_PLURALS = {"position": "positions", "speed": "speeds", "load": "loads"}


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
            lowest=np.array([_extreme(np.min, x, counts, np.inf) for x in signals]),
            highest=np.array([_extreme(np.max, x, counts, -np.inf) for x in signals]),
        )

    def __add__(self, other):
        """Merge the ranges of disjoint rows."""
        return SignalRanges(
            lowest=np.minimum(self.lowest, other.lowest),
            highest=np.maximum(self.highest, other.highest),
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


def _extreme(function, values, counts, nothing):
    if values.size and counts.all():
        return function(values, axis=0)
    return function(values, axis=0, where=counts, initial=nothing)


def sum_ranges(several):
    """Merge `SignalRanges`; None if one of them is not known."""
    several = list(several)
    if any(one is None for one in several):
        return None
    return functools.reduce(operator.add, several)


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
            curved=effect.growth != "straight",
        )
        for effect, joint in used
    )


def ends(signals):
    """Lowest and highest value of each recorded signal, a dict of (float, float)."""
    return {name: (float(x.min()), float(x.max())) for name, x in signals.items()}


def signals_outside_text(fitted, signals):
    """Say which recorded signals leave what was fitted, a list of str."""
    # fitted: `ends` of each in the fit; effects are straight lines in a signal.
    said = []
    for name, (low, high) in fitted.items():
        values = signals[name]
        margin = STRAIGHT * (high - low) + ROUNDING * max(abs(low), abs(high))
        excess = np.maximum(low - values, values - high)
        share = float((excess > margin).mean())
        if share > OUTLIERS:
            reached = values[np.argmax(excess)]
            said.append(
                f"The recorded signal {name}: to {reached:.3g}, fitted on {low:.3g} to "
                f"{high:.3g} ({100 * share:.2g} % of the rows)"
            )
    return said


def outside_text(found, names, prismatic):
    """Say what lies outside the ranges of a fit; `found` are `OutsideRange`."""
    said = []
    for one in found:
        share = round(100 * one.share, 0 if one.share > 0.02 else 1)
        rows = f"({', '.join(one.names)}; {share:g} % of the rows)"
        if one.quantity == "direction":
            way, other = _WAYS if one.reached > 0 else _WAYS[::-1]
            said.append(f"{names[one.joint]}: {way}, fitted on {other} only {rows}")
            continue
        unit = _UNITS[one.quantity][int(prismatic[one.joint])]
        low, high = one.fitted
        said.append(
            f"{names[one.joint]}: {_PLURALS[one.quantity]} to {one.reached:.3g} {unit},"
            f" fitted on {low:.3g} to {high:.3g} {unit} {rows}"
        )
    return ". ".join(filter(None, ["; ".join(said), held_text(found)]))


def held_text(found, label=str):
    """Say which effects are held and which go on; empty for directions."""
    # label: name of an effect -> what to call it.
    found = [one for one in found if one.quantity != "direction"]
    held = [name for one in found for name in one.held]
    others = [name for one in found for name in one.names if name not in one.held]
    told = {"Held beyond the margin": held, "Going on by the law": others}
    return ". ".join(
        f"{what}: {', '.join(label(name) for name in dict.fromkeys(names))}"
        for what, names in told.items()
        if names
    )


def warn_outside(messages, stacklevel):
    """Warn of a prediction outside the range of the fit, once for all that is said."""
    if messages:
        warnings.warn(
            f"Predicted outside what the fit has seen. {'. '.join(messages)}.",
            UserWarning,
            stacklevel=stacklevel + 1,
        )
