"""A log that is read in one way, how probable that is, and hypotheses about it."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._likelihood import Bodies, DescribedRobot
from sklearn_vbjfa.inspection._signals import Change, filtered
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.recording import ChannelFinding


class Reading:
    """A log, its filtered signals and the described robot in its motion."""

    # usable (n, nv): samples without known faults; commanded: whether torques are what
    # motors were commanded.

    def __init__(self, model, names, q, tau, dt, parts, usable, *, commanded=False):
        self.model, self.names, self.commanded = model, tuple(names), commanded
        self.q, self.tau, self.dt = q, tau, dt
        self.parts, self.usable = parts, usable

    @property
    def nv(self):
        """Number of joints."""
        return self.model.nv

    @functools.cached_property
    def slides(self):
        """Which joints are prismatic, (nv,) of bool."""
        return is_prismatic(self.model)

    @functools.cached_property
    def signals(self):
        """Filtered signals; None if the log is too short."""
        return filtered(self.q, self.tau, self.dt, self.parts, self.usable)

    @functools.cached_property
    def bodies(self):
        """Bodies of the description."""
        return Bodies(self.model)

    @functools.cached_property
    def robot(self):
        """The described robot in the motion."""
        return DescribedRobot(self.bodies, self.signals)

    @functools.cached_property
    def few(self):
        """The described robot in fewer rows, for hypotheses with many variants."""
        return DescribedRobot(self.bodies, self.signals, most=number.MOST_TRIED)

    @functools.cached_property
    def now(self):
        """Score of the unchanged log."""
        return score_of(self.robot)

    @functools.cached_property
    def now_in_few(self):
        """Score of the unchanged log, in fewer rows."""
        return score_of(self.few)

    def tell_nothing(self):
        """Whether torques or description are such that nothing can be compared."""
        if self.signals is None or not self.signals.informative().any():
            return True
        return self.bodies.massless or not self.robot.joints.size

    def tried(self, change, *, few=False):
        """Score of a change that keeps the description; None if it fails."""
        other, base = self.robot_at(change, few=few), self.few if few else self.robot
        return score_of(other) if other.joints.size == base.joints.size else None

    def robot_at(self, change, *, few=False):
        """Return the described robot in the motion of a change."""
        base = self.few if few else self.robot
        most = number.MOST_TRIED if few else number.MOST_FITTED
        signals = change.signals(base.signals)
        same = signals.states is base.signals.states
        entries = base.entries if same else None
        return DescribedRobot(self.bodies, signals, base.times, most, entries)

    def changed(self, change):
        """Return the log after a change, filtered again."""
        q, tau, dt = change.arrays(self.q, self.tau, self.dt)
        usable = self.usable
        if change.positions is not None:
            usable = usable[:, change.positions]
        if change.lag:
            tau, usable = late(tau, change.lag, self.parts, usable)
        known = self.parts, usable
        return Reading(
            change.model(self.model),
            self.names,
            q,
            tau,
            dt,
            *known,
            commanded=self.commanded,
        )


def late(tau, samples, parts, usable):
    """Torques that are read some samples later, and the samples that remain usable."""
    tau, usable = tau.copy(), usable.copy()
    first, last = max(0, -samples), max(0, samples)
    for part in parts:
        tau[part] = np.roll(tau[part], -samples, axis=0)
        usable[part][:first] = False
        usable[part][len(tau[part]) - last :] = False
    return tau, usable


@dataclass(frozen=True)
class Score:
    """How well a reading agrees with the description."""

    # logarithm of the marginal likelihood of torques in units of their deviations, so
    # that readings in other units and orders can be compared
    evidence: float
    left: np.ndarray  # (n_joints,): log of the share of each torque that is left

    def fall(self, other):
        """Sum over joints by which the log squared errors are below another's."""
        return float(np.sum(other.left - self.left))


def score_of(robot, fit=None):
    """`Score` of a described robot, or of one of its fits."""
    fit = robot.fit() if fit is None else fit
    size = np.log(robot.variance)
    return Score(
        evidence=fit.evidence + 0.5 * float(robot.information @ size),
        left=np.log(fit.noise) - size,
    )


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A change that a hypothesis proposes, with what its message names."""

    change: Change
    joints: tuple
    log_odds: float
    fall: float = 0.0  # sum over joints of the fall of the log squared errors
    values: Mapping = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Hypothesis:
    """What may have been done to a log.

    Attributes
    ----------
    name : str
        Kind of the finding.
    severity : {"error", "doubt", "warning"}
        Severity of the finding, unless a candidate's values have a different one.
    applies : callable
        Whether a `Reading` can show it.
    propose : callable
        Returns the best `Candidate` for a `Reading`, or None.
    message : callable
        Writes the finding of a `Reading` and a `Candidate`, remedy included.
    remedy : callable
        Options of `read_recording` that undo it, a dict; empty for none.
    repairs : bool
        Whether the change undoes it, so that the rest can be looked at.
    """

    name: str
    severity: str
    applies: Callable
    propose: Callable
    message: Callable
    remedy: Callable = lambda reading, candidate: {}
    repairs: bool = True

    def finding(self, reading, candidate):
        """Return the finding."""
        values = candidate.values
        return ChannelFinding(
            values.get("name", self.name),
            candidate.joints,
            values.get("severity", self.severity),
            self.message(reading, candidate),
            value=values.get("seconds", np.nan),
            remedy=self.remedy(reading, candidate),
        )


def every(reading):
    """All joints."""
    return tuple(range(reading.nv))


def of(score, now, variants, prior=number.PRIOR):
    """Log odds of a score against the unchanged log, if one of several is right."""
    return score.evidence - now.evidence + prior - np.log(max(variants, 1))
