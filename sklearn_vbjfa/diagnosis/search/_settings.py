"""Every number that decides what a search names."""

from dataclasses import dataclass, fields
from numbers import Integral, Real

import numpy as np


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """Numbers that decide what `EffectDiscovery` names, keeps and predicts.

    None of them has a unit of the robot: torques count in shares of the joint's torque,
    evidence in nats (natural logarithms of odds). The guide has them under "Numbers
    that decide".

    Parameters
    ----------
    expected : float, default=1.0
        Effects that a robot is expected to lack, before its recording is looked at. The
        prior odds of each candidate (a joint and an effect) are this number over that
        of all candidates, so that a larger library asks for more evidence.
    scale : float, default=0.1
        Size of an effect that is expected: its torque over the standard deviation of
        the joint's torque. The scale of the half-Cauchy prior of that ratio, which is
        integrated over.
    rivals : float, default=3.0
        What takes the place of an effect within so many nats is told as its rival.
    undecided : float, default=0.5
        Probability from which on an effect is listed as possible, up to ``1 - alpha``,
        from which on it has a name; what is less probable is not in the model.
    smoothness : float, default=1.0
        How far the residual's spectrum may bend: prior deviation of the change of its
        logarithmic slope from one band of frequency to the next. It says how much of a
        slow residual is expected from faster ones.
    chance : float, default=1.645
        Standard errors within which something is chance: by more of them a name must
        lower the error of stretches of time that were not fitted, and weights by the
        spectrum may not lead farther from least squares.
    worth : float, default=0.02
        Share of the squared error on stretches that were not fitted that a name saves.
    known : float, default=3.0
        Deviations that a correction (a zero, a tilt, a gain) must be away from none to
        be told as "to correct".
    above_motion : float, default=2.0
        A filter of a channel is a name only if it acts above so many times the
        frequency below which 90 % of the motion's power lies.
    most : int, default=6
        Effects of one joint that are tried beside each other, at the most.

    Examples
    --------
    >>> from sklearn_vbjfa.diagnosis import SearchSettings
    >>> SearchSettings(expected=0.1).expected
    0.1
    """

    expected: float = 1.0
    scale: float = 0.1
    rivals: float = 3.0
    undecided: float = 0.5
    smoothness: float = 1.0
    chance: float = 1.645
    worth: float = 0.02
    known: float = 3.0
    above_motion: float = 2.0
    most: int = 6

    def __post_init__(self):
        for field in fields(self):
            value = getattr(self, field.name)
            kind = Integral if field.name == "most" else Real
            if isinstance(value, bool) or not (
                isinstance(value, kind) and 0 < value < np.inf
            ):
                expected = "a positive integer" if kind is Integral else "positive"
                raise ValueError(
                    f"{field.name} of SearchSettings must be {expected}; got {value!r}."
                )
        for name in ("undecided", "worth"):
            if getattr(self, name) >= 1:
                raise ValueError(
                    f"{name} of SearchSettings is a share below 1; got "
                    f"{getattr(self, name)!r}."
                )
