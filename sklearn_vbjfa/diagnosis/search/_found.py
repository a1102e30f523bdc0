"""What a search found: the most probable model, and what each effect of it is worth."""

from dataclasses import dataclass, field

import numpy as np
from scipy.special import expit, ndtr

from sklearn_vbjfa.diagnosis.search._held_out import Worth
from sklearn_vbjfa.diagnosis.search._problem import Fit
from sklearn_vbjfa.diagnosis.search._settings import SearchSettings
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.effects import Effect, Motion


@dataclass(frozen=True, kw_only=True)
class Evidence(Worth):
    """What speaks for an effect beside the others of its model.

    Attributes
    ----------
    log_odds : float
        Logarithm of the posterior odds that the model lacks it.
    """

    log_odds: float

    @property
    def probability(self):
        """Probability: the posterior one, or that it helps elsewhere, if less."""
        return float(min(expit(self.log_odds), ndtr(self.errors)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Rival:
    """What would take the place of an effect.

    Attributes
    ----------
    effect : Effect
        With its best shape.
    log_odds : float
        Of it in that place.
    """

    effect: Effect
    log_odds: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """An effect of the most probable model.

    Attributes
    ----------
    effect : Effect
        With its shape.
    evidence : Evidence
        What speaks for it.
    rivals : tuple of Rival
        What would take its place within the rivals' nats, the best first.
    doubt : str
        Why it has no name, "" for a name.
    """

    effect: Effect
    evidence: Evidence
    rivals: tuple = ()
    doubt: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """One step of the path to the most probable model.

    Attributes
    ----------
    action : {"add", "drop", "replace"}
        What was done.
    effect, replaced : Effect and Effect or None
        What came or went, and what it replaced.
    log_odds : float
        Of the effect beside the others then.
    rivals : tuple of Rival
        What would have come in its place.
    """

    action: str
    effect: Effect
    log_odds: float
    replaced: Effect | None = None
    rivals: tuple = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundModel:
    """The most probable model on the rows of the search.

    Attributes
    ----------
    view : RecordingView
        Recording, with the robot as its effects correct it.
    effects : tuple of Effect
        Effects beside the four plain terms.
    motion : Motion
        Signals, with the load of the model.
    residual : ndarray of shape (nv, m)
        Residuals of rows that were not fitted, scaled by the root of the weights.
    fit : Fit or None
        The regression; None for a robot that was searched branch by branch.
    """

    view: RecordingView
    effects: tuple
    motion: Motion
    residual: np.ndarray
    fit: Fit | None = None

    def memory_seconds(self):
        """How long the residual of each joint stays correlated, list [s]."""
        memories = self.view.whitening(self.residual).memory
        return [memory.time for memory in memories]


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """What a search found.

    Attributes
    ----------
    model : FoundModel
        The most probable model.
    findings : tuple of Finding
        Its effects, those that have a name first.
    steps : tuple of Step
        The path to it.
    n_candidates : int
        Candidates (a joint and an effect) among which prior odds are shared out.
    needed : float
        Log odds from which on an effect has a name.
    settings : SearchSettings
        Numbers that decided.
    library : tuple of Effect
        Effects that were tried on every joint.
    branches : tuple of (Branch, Found)
        What was found on each branch of a robot that was searched branch by branch.
    """

    model: FoundModel
    findings: tuple
    steps: tuple
    n_candidates: int
    needed: float
    settings: SearchSettings
    library: tuple
    branches: tuple = field(default=())

    @property
    def effects(self):
        """Effects of the most probable model, in the order of the findings."""
        return tuple(finding.effect for finding in self.findings)

    @property
    def named(self):
        """Findings that have a name."""
        return tuple(f for f in self.findings if not f.doubt)
