"""What may have been done to a log, judged by one likelihood, and the best of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._reading import Change
from sklearn_vbjfa.inspection._sentences import finding


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A change that a hypothesis proposes, with the facts of its sentence.

    One that is not clear explains the torques better than the log as it is, but leaves
    errors that are too large to report it; no less probable one is reported either.
    """

    joints: tuple
    log_odds: float
    change: Change = field(default_factory=Change)
    fall: float = 0.0  # sum over joints of the fall of the log squared errors
    clear: bool = True
    kind: str = ""  # of the sentence and the severity, if not the hypothesis's
    severity: str = ""
    value: float = np.nan
    remedy: Mapping | None = None
    facts: Mapping = field(default_factory=dict)


@dataclass(frozen=True)
class Hypothesis:
    """What may have been done to a log, in terms of a `Reading`."""

    name: str
    severity: str
    propose: Callable  # returns the best candidate for a reading, or None
    applies: Callable = lambda reading: True  # whether a reading can show it
    # Whether it is looked for only if torques agree badly with the description, or
    # another hypothesis is probable; and whether its change undoes what was done.
    if_poor: bool = False
    repairs: bool = True
    unclear: str = ""  # kind of the warning if a candidate is probable but not clear

    def candidate(self, reading):
        """Return the best candidate if it is probable, or None."""
        found = self.propose(reading) if self.applies(reading) else None
        return found if found and found.log_odds > number.DECISIVE else None

    def finding(self, reading, candidate, rivals=()):
        """Return the finding; rivals: names of hypotheses that are as probable."""
        return finding(
            candidate.kind or self.name,
            reading.names,
            candidate.joints,
            candidate.severity or self.severity,
            value=candidate.value,
            remedy=candidate.remedy,
            rivals=rivals,
            odds=candidate.log_odds,
            fall=np.exp(candidate.fall / reading.robot.joints.size),
            **candidate.facts,
        )

    def warning(self, reading, candidate):
        """Return what is said of a candidate that is not clear."""
        facts, joints = candidate.facts, candidate.joints
        args = self.unclear, reading.names, joints, "warning"
        return finding(*args, odds=candidate.log_odds, **facts)


def odds(fit, now, variants=1):
    """Log odds of a fit against the log as it is, if one of several is right."""
    return fit.evidence - now.evidence + number.PRIOR - np.log(max(variants, 1))


def judged(reading, change, least=-np.inf, *, variants=1, joints=None, **others):
    """Return the `Candidate` of a change, clear if squared errors fall by `least`."""
    fit, now = reading.tried(change), reading.robot.now
    if fit is None:
        return None
    return Candidate(
        change=change,
        joints=change.joints if joints is None else joints,
        log_odds=odds(fit, now, variants),
        fall=fit.fall(now),
        clear=fit.fall(now) >= least,
        **others,
    )


def best_of(reading, changes, least):
    """Return the most probable of several changes."""
    # least: returns the fall of squared errors that a change must bring. Those whose
    # errors fall in a rough score are tried, in a part of the rows.
    rough = reading.rough().sum()
    falls = [rough - reading.rough(change).sum() for change in changes]
    likely = np.argsort(falls)[::-1][: number.MOST_LIKELY]
    best, chosen = reading.few.now.evidence, None
    for k in likely:
        if falls[k] <= 0:
            break
        fit = reading.tried(changes[k], few=True, least=best)
        if fit is not None and fit.evidence > best:
            best, chosen = fit.evidence, changes[k]
    if chosen is None:
        return None
    return judged(reading, chosen, least(chosen), variants=len(changes))


def clear(change):
    """Fall of log squared errors that a change of some joints must bring."""
    return number.CLEAR_OF_JOINT * len(change.joints)
