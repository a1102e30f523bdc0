"""Changes of a log that a hypothesis proposes, judged by the likelihood."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._reading import Change


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A change that a hypothesis proposes, with the facts of its sentence.

    One that is not clear explains the torques better than the log as it is, but leaves
    errors that are too large to report it; no less probable one is reported either.
    """

    joints: tuple
    log_odds: float  # against the log as it is, before the prior odds
    change: Change | None = None  # which undoes what was done
    fall: float = 0.0  # sum over joints of the fall of the log squared errors
    clear: bool = True
    kind: str = ""  # of the sentence and the severity, if not the hypothesis's
    severity: str = ""
    value: float = np.nan
    remedy: Mapping | None = None
    facts: Mapping = field(default_factory=dict)


def judged(reading, change, least=-np.inf, *, variants=1, joints=None, **others):
    """Return the `Candidate` of a change, clear if squared errors fall by `least`."""
    # variants: changes of which one is right.
    fit, now = reading.tried(change), reading.robot.now
    if fit is None:
        return None
    return Candidate(
        change=change,
        joints=change.joints if joints is None else joints,
        log_odds=fit.evidence - now.evidence - np.log(max(variants, 1)),
        fall=fit.fall(now),
        clear=fit.fall(now) >= least,
        **others,
    )


def best_of(reading, changes, least=None):
    """Return the most probable of several changes that a rough score prefers."""
    # least: fall of squared errors that a change must bring, or that of its joints.
    rough = reading.rough().sum()
    falls = np.array([rough - reading.rough(change).sum() for change in changes])
    likely = np.argsort(-falls)[: number.MOST_LIKELY]
    return most_probable(
        judged(
            reading,
            changes[k],
            clear(changes[k]) if least is None else least,
            variants=len(changes),
        )
        for k in likely
        if falls[k] > 0
    )


def most_probable(candidates):
    """Return the candidate of the greatest odds; None if there is none."""
    found = [one for one in candidates if one is not None]
    return max(found, key=lambda one: one.log_odds, default=None)


def clear(change):
    """Fall of log squared errors that a change of some joints must bring."""
    return number.CLEAR_OF_JOINT * len(change.joints)


def clear_of_all(reading):
    """Fall of log squared errors that a change of the whole log must bring."""
    return number.CLEAR * reading.robot.joints.size
