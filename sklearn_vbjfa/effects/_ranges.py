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
    """What an effect was fitted on: ranges of its joint's signals in the fit.

    The signals are those behind the low-pass of the fit, in rows with weight in which
    the joint moves. A range is (lowest, highest), (nan, nan) where it is not known.

    Attributes
    ----------
    name : str
        Effect.
    joint : int
        Joint, from zero.
    position : tuple of (float, float)
        Positions [rad or m].
    speed : tuple of (float, float)
        Speeds in either direction, the slowest and the fastest [rad/s or m/s].
    load : tuple of (float, float)
        Torques of the rigid bodies [N m or N].
    direction : tuple of (float, float)
        Directions of motion, -1 is backward and 1 forward: (-1, 1) is both, (0, 1) or
        (1, 1) forward only.
    depends : tuple of {"position", "speed", "load", "direction"}
        Those of them that the effect's columns go on changing with. A prediction
        follows them up to the `margin`, beyond which the torque stays as at its end,
        see `within`, unless the effect is `bounded`: that one goes on by its law. A
        direction that was not fitted is predicted all the same.
    curved : bool
        Whether they do so in another way than along a straight line.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa.effects import EffectRange
    >>> spring = EffectRange(
    ...     name="spring", joint=0, position=(-1.0, 1.0), speed=(0.1, 2.0),
    ...     load=(0.0, 9.0), depends=("position",),
    ... )
    >>> spring.excess("position", [-1.5, 0.0, 1.1]).round(6)
    array([0.5, 0. , 0.1])
    >>> np.round(spring.ends("position"), 6), spring.ends("load")
    (array([-1.4,  1.4]), (-inf, inf))
    """

    name: str
    joint: int
    position: tuple
    speed: tuple
    load: tuple
    direction: tuple = (-1.0, 1.0)
    depends: tuple = ()
    curved: bool = False

    def ends(self, quantity):
        """Between which values the effect follows a signal of its joint.

        Parameters
        ----------
        quantity : {"position", "speed", "load"}
            Which signal; a speed stands for the velocity.

        Returns
        -------
        tuple of (float, float)
            Range of the fit, of velocities and loads up to the largest both ways, and
            the `margin` on both sides, so that what is held counts as outside; infinite
            where the range is not known or the effect does not depend on the signal.
        """
        low, high = getattr(self, quantity)
        if quantity not in self.depends or np.isnan(high - low):
            return -np.inf, np.inf
        margin = self.margin(quantity)
        if quantity == "position":
            return low - margin, high + margin
        largest = max(abs(low), abs(high)) + margin
        return -largest, largest

    def within(self, motion):
        """Hold the signals that the effect depends on between its `ends`.

        Parameters
        ----------
        motion : Motion
            Signals of all joints.

        Returns
        -------
        Motion
            The same, with position, velocity or load of the effect's joint at the
            nearest end where they lie beyond: the effect's columns from it stay as they
            are there.
        """
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
        """How far values lie outside the range of a quantity.

        Parameters
        ----------
        quantity : {"position", "speed", "load", "direction"}
            What they are.
        values : array-like of shape (n,)
            Values, in the unit of the range.

        Returns
        -------
        ndarray of shape (n,)
            Distance from the range; zero within it, and where it is not known.
        """
        low, high = getattr(self, quantity)
        values = np.asarray(values, dtype=float)
        beyond = np.maximum(low - values, values - high)
        return np.where(np.isfinite(beyond), np.maximum(beyond, 0.0), 0.0)

    def margin(self, quantity):
        """How far outside a prediction still counts as inside, and follows the law.

        Parameters
        ----------
        quantity : {"position", "speed", "load", "direction"}
            Of which range.

        Returns
        -------
        float
            A fifth of the width of the range, a tenth if the effect is `curved`, in the
            unit of the range; nan where it is not known. Speeds have both directions,
            and their range counts twice.
        """
        low, high = getattr(self, quantity)
        share = CURVED if self.curved else STRAIGHT
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


@dataclass(frozen=True, kw_only=True, eq=False)
class RangeFacts:
    """How much of a signal lies outside the range of an effect; recordings add up."""

    effect: EffectRange
    quantity: str
    n: int  # rows that are judged
    n_far: int  # those that lie outside by more than the margin
    # whether one of them is beyond an end: slower motion and the other direction are
    # outside, but not beyond
    beyond: bool
    farthest: np.ndarray  # (k,): values of the farthest of them, the nearest first

    @classmethod
    def of(cls, effect, quantity, values, keep):
        """Judge values (n,) by an effect's range."""
        # keep: `n_farthest` of all recordings together.
        excess, (low, high) = effect.excess(quantity, values), effect.ends(quantity)
        far = values[excess > effect.margin(quantity)]
        return cls(
            effect=effect,
            quantity=quantity,
            n=excess.size,
            n_far=far.size,
            beyond=bool(((far < low) | (far > high)).any()),
            farthest=_farthest(effect, quantity, far, keep),
        )

    def said(self, holds):
        """Return the `OutsideRange`, None of a motion inside."""
        # holds: whether predictions hold the effect within its range.
        if not self.n_far > OUTLIERS * self.n:
            return None
        return OutsideRange(
            names=(self.effect.name,),
            joint=self.effect.joint,
            quantity=self.quantity,
            fitted=getattr(self.effect, self.quantity),
            reached=float(self.farthest[-n_farthest(self.n)]),
            share=self.n_far / self.n,
            held=(self.effect.name,) if holds and self.beyond else (),
        )


def n_farthest(n):
    """Return how many of n rows are outliers, or the first that is none."""
    return int(OUTLIERS * n) + 1


def _farthest(effect, quantity, values, keep):
    """Return the values (k,) farthest from a range, the nearest first."""
    # Of two on either side, equally far, the larger one, whichever came first.
    order = np.lexsort((values, effect.excess(quantity, values)))
    return values[order[-keep:]]


def range_facts(ranges, signals, keep):
    """Judge signals by the ranges of effects; a tuple of `RangeFacts` for each."""
    # signals: (n,) in the rows to judge, by quantity (positions, speeds, loads) and
    # joint.
    return [
        tuple(
            RangeFacts.of(one, quantity, signals[quantity, one.joint], keep)
            for quantity in one.depends
        )
        for one in ranges
    ]


def outside(facts, held):
    """Find what lies outside the ranges of effects, a tuple of `OutsideRange`."""
    # facts: `range_facts`; held: whether predictions hold each effect within its range.
    found = {}
    for several, holds in zip(facts, held, strict=True):
        for one in several:
            said = one.said(holds)
            if said is not None:
                found.setdefault((said.joint, said.quantity), []).append(said)
    return tuple(
        replace(
            max(several, key=lambda one: one.share),
            names=tuple(dict.fromkeys(name for one in several for name in one.names)),
            held=tuple(dict.fromkeys(name for one in several for name in one.held)),
        )
        for _, several in sorted(found.items())
    )
