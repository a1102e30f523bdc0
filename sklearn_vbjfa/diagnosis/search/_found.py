"""What a search found: the most probable model, and what each effect of it is worth."""

from dataclasses import dataclass, field

import numpy as np
from scipy.special import expit, ndtr

from sklearn_vbjfa.diagnosis.search._held_out import CrossValidatedGain
from sklearn_vbjfa.diagnosis.search._problem import Fit
from sklearn_vbjfa.diagnosis.search._settings import SearchSettings
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.effects import Effect, Motion


@dataclass(frozen=True, kw_only=True)
class Evidence(CrossValidatedGain):
    """What speaks for an effect beside the others of its model."""

    log_odds: float  # logarithm of the posterior odds that the model lacks it

    @property
    def probability(self):
        """Probability: the posterior one, or that it helps elsewhere, if less."""
        return float(min(expit(self.log_odds), ndtr(self.errors)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Rival:
    """What would take the place of an effect."""

    effect: Effect  # with its best shape
    log_odds: float  # in that place


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """An effect of the most probable model."""

    effect: Effect  # with its shape
    evidence: Evidence  # what speaks for it
    # what would take its place within the rivals' nats, the best first
    rivals: tuple = ()
    warning: str = ""  # why it has no name, "" for a name


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """One step of the path to the most probable model."""

    action: str
    # what came or went, and what it replaced
    effect: Effect
    log_odds: float  # of the effect beside the others then
    replaced: Effect | None = None
    rivals: tuple = ()  # what would have come in its place


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundModel:
    """The most probable model on the rows of the search."""

    view: RecordingView  # recording, with the robot as its effects correct it
    effects: tuple  # those beside the four plain terms
    motion: Motion  # signals, with the load of the model
    # (nv, m): residuals of rows that were not fitted, scaled by the root of the weights
    residual: np.ndarray
    fit: Fit | None = None  # None for a robot that was searched branch by branch


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """What a search found."""

    model: FoundModel  # the most probable
    findings: tuple  # its effects, those that have a name first
    steps: tuple  # the path to it
    # candidates (a joint and an effect) among which prior odds are shared out
    n_candidates: int
    needed: float  # log odds from which on an effect has a name
    settings: SearchSettings
    library: tuple  # effects that were tried on every joint
    # what was found on each, of a robot that was searched branch by branch
    branches: tuple = field(default=())

    @property
    def effects(self):
        """Effects of the most probable model, in the order of the findings."""
        return tuple(finding.effect for finding in self.findings)

    @property
    def named(self):
        """Findings that have a name."""
        return tuple(f for f in self.findings if not f.warning)
