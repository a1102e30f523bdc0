"""Reported effects: settings, posterior odds, and the rules of reporting."""

from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np
from scipy.special import expit, ndtr, ndtri
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._held_out import (
    CrossValidatedGain,
    HeldOut,
    HeldOutFit,
)
from sklearn_vbjfa.diagnosis.search._problem import Fit
from sklearn_vbjfa.diagnosis.search._stepwise import (
    ENTRY_SHARE,
    StepwiseSearch,
    relinearise,
)
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.effects import Bank, Effect, InModel, Motion, OfChannel, Sudden
from sklearn_vbjfa.equations._plan import joints_at_rest


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """Constants of the search for effects.

    None has a unit of the robot: torques are relative to the joint's torque, evidence
    is in nats (natural logarithms of odds).

    Parameters
    ----------
    expected : float, default=1.0
        Prior expectation of the number of missing effects. The prior odds of each
        candidate (a joint and an effect) are this number over that of all candidates.
    scale : float, default=0.1
        Scale of the half-Cauchy prior of an effect's size: its torque over the standard
        deviation of the joint's torque.
    rivals : float, default=3.0
        An effect that could replace another within so many nats is its rival.
    min_probability : float, default=0.5
        Least probability of an effect of the model; it is listed as possible up to
        ``1 - alpha``, and reported from there on.
    spectrum_roughness : float, default=1.0
        Prior standard deviation of the change of the logarithmic slope of the
        residual's spectrum from one band of frequency to the next.
    significance : float, default=1.645
        Standard errors by which a reported effect must reduce the cross-validated
        error, and within which spectral weights may differ from least squares.
    min_gain : float, default=0.02
        Share of the cross-validated squared error of the friction terms that a reported
        effect saves in addition to the others.
    known : float, default=3.0
        Standard deviations by which a correction (a zero, a tilt, a gain) must differ
        from zero to be reported, negative friction to be set to zero, and residuals at
        rest to be unexplained by friction with memory that the motion does not show.
    above_motion : float, default=2.0
        A filter of a channel is reported only if its corner is above so many times the
        frequency below which 90 % of the motion's power lies.
    most : int, default=6
        Maximum number of effects of one joint that are tried together.

    Examples
    --------
    >>> from sklearn_vbjfa.diagnosis import SearchSettings
    >>> SearchSettings(expected=0.1).expected
    0.1
    """

    expected: float = 1.0
    scale: float = 0.1
    rivals: float = 3.0
    min_probability: float = 0.5
    spectrum_roughness: float = 1.0
    significance: float = 1.645
    min_gain: float = 0.02
    known: float = 3.0
    above_motion: float = 2.0
    most: int = 6

    def __post_init__(self):
        fraction = Real, 1, "positive and below 1"
        rules = {"min_probability": fraction, "min_gain": fraction}
        rules["most"] = Integral, np.inf, "a positive integer"
        for name, value in vars(self).items():
            kind, limit, expected = rules.get(name, (Real, np.inf, "positive"))
            valid = isinstance(value, kind) and not isinstance(value, bool)
            if not (valid and 0 < value < limit):
                raise ValueError(
                    f"{name} of SearchSettings must be {expected}; got {value!r}."
                )


@dataclass(frozen=True, kw_only=True)
class Evidence(CrossValidatedGain):
    """Evidence for an effect given the other effects of its model."""

    log_odds: float  # logarithm of the posterior odds that the model lacks it

    @property
    def probability(self):
        """Posterior probability, at most that of a cross-validated improvement."""
        return float(min(expit(self.log_odds), ndtr(self.errors)))


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundEffect:
    """An effect of the most probable model."""

    effect: Effect  # with its shape
    evidence: Evidence
    rivals: tuple = ()  # effects that could replace it, the best first
    warning: str = ""  # why it is not reported, "" if it is


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchResult:
    """Most probable model of a recording."""

    findings: tuple  # effects of the model, reported ones first
    view: RecordingView  # recording, with the corrected robot
    motion: Motion  # signals, with the load of the model
    # (nv, m): cross-validated residuals, times the square roots of the weights
    residual: np.ndarray
    n_candidates: int  # number of pairs of joint and effect, for the prior odds
    needed: float  # least log odds of a reported effect
    settings: SearchSettings
    library: tuple  # effects that were tried on every joint
    fit: Fit | None = None  # None after a search branch by branch
    candidates: dict | None = None  # `Columns` of candidate effects, lists by joint
    branches: tuple = ()  # pairs of branch and result of a search branch by branch

    @property
    def effects(self):
        """Effects of the most probable model, in the order of the findings."""
        return tuple(finding.effect for finding in self.findings)

    @property
    def changes(self):
        """Times [s] at which effects of the model begin or end, list of float."""
        sudden = (e for e in self.effects if isinstance(e, Sudden))
        return [t for effect in sudden for t, _ in effect.changes]


# Why a probable effect is not reported; `explain` has reasons from its values.
UNDECIDED = "undecided"
CHANCE = "lowers no error on other stretches of time beyond chance"
SMALL = "saves too little to be named"
SLOW_FILTER = "a filter within the motion's own frequencies"


def search(view, library, settings, alpha, max_effects=None):
    """Find the most probable effects of a recording, and the reported ones."""
    needed = float(np.log((1.0 - alpha) / alpha))
    resting = _friction_at_rest(view, library, settings)
    while True:
        view = view.with_rest(resting)
        stepwise = StepwiseSearch(view, library, settings, max_effects)
        fit, odds, gains = _final_model(stepwise, stepwise.run())
        bank_joints = joints_at_rest(member.effect for member in fit.members)
        if resting <= bank_joints:
            break
        # Rows at rest need presliding friction.
        resting &= bank_joints
    large = _sufficient_gains(stepwise.validate(fit), settings.min_gain)
    gains |= large
    log_odds = stepwise.candidates.log_odds(fit, usual=True)
    view, findings = fit.problem.view, []
    for i, (member, entry) in enumerate(zip(fit.members, odds)):
        evidence = Evidence(log_odds=float(entry), **vars(gains[i]))
        rivals = tuple(
            c.effect
            for c in stepwise.candidates.rivals(fit, i)
            if c.effect.key() != member.effect.key()
            and _can_replace(stepwise, c, fit, i, log_odds[i])
        )
        warning = _warning(fit, member, evidence, needed, stepwise)
        warning = warning or ("" if i in large else SMALL)
        effect = member.effect.completed()
        if isinstance(effect, Bank):
            # In few stops, as before a motion, any torque may hold a joint.
            effect = clone(effect).set_params(at_rest=effect.joint in resting)
        entry = {"effect": effect, "evidence": evidence}
        findings.append(FoundEffect(**entry, rivals=rivals, warning=warning))
    return SearchResult(
        findings=sort_findings(findings),
        view=view,
        motion=fit.problem.motion,
        residual=_residual(fit),
        fit=fit,
        candidates=stepwise.candidates.columns,
        n_candidates=stepwise.candidates.count,
        needed=needed,
        settings=settings,
        library=tuple(library),
    )


def _can_replace(stepwise, candidate, fit, i, log_odds):
    """Check if a rival is as probable in place of a member, without its torque."""
    member, other = fit.members[i].effect, candidate.effect
    geometry = [isinstance(x, InModel) for x in (member, other)]
    # A rival that equals the member in a limit of its shape must be more probable.
    equal = member.name in other.contains and other.coefficients == member.coefficients
    threshold = log_odds - (0.0 if equal else stepwise.settings.rivals)
    if geometry == [False, True] and candidate.usual_odds > threshold:
        # Geometric columns are derivatives of a torque that includes the member's.
        reduced = relinearise(fit.without(i))
        columns = reduced.problem.columns(candidate.columns.effects)
        candidate = stepwise.candidates.candidate(reduced, columns)
        candidate = candidate and stepwise.candidates.discounted(reduced, candidate)
    return all(geometry) or bool(candidate and candidate.usual_odds > threshold)


def _friction_at_rest(view, library, settings):
    """Return the joints with presliding friction at rest, a set."""
    # Dry friction holds a joint by any torque within its limits, which presliding
    # friction explains in part. Unless the motion shows it, too, it must leave little
    # more torque at rest than in motion.
    banks = [effect for effect in library if isinstance(effect, Bank)]
    resting = set(view.at_rest()) if banks else set()
    if not resting:
        return resting
    moving = StepwiseSearch(view, banks, settings).forward_selection()
    shown = joints_at_rest(member.effect for member in moving.members)
    noise = (_residual(moving) ** 2).sum(axis=1) / np.maximum(view.rows, 1.0)
    while uncertain := resting - shown:
        rested = view.with_rest(resting)
        fit = StepwiseSearch(rested, banks, settings).forward_selection()
        found = joints_at_rest(member.effect for member in fit.members)
        weight = rested.root.T**2
        at_rest = 1.0 - view.root.T**2 / np.where(weight > 0, weight, 1.0)
        left = (at_rest * _residual(fit) ** 2).sum(axis=1)
        usual = settings.known**2 * noise * (rested.rows - view.rows)
        excess = left / np.maximum(usual, np.finfo(float).tiny)
        worst = max(uncertain, key=lambda j: (j not in found, excess[j]))
        if worst in found and excess[worst] <= 1.0:
            break
        resting.remove(worst)
    return resting


def _residual(fit):
    """Return cross-validated residuals, times the square roots of the weights."""
    # Folds interleaved in time, as the held-out part is.
    view = fit.problem.view
    return HeldOutFit(HeldOut(view, view.blocks.fold), fit).residual


def sort_findings(findings):
    """Sort findings: reported ones first, then by decreasing gain."""
    return tuple(sorted(findings, key=lambda f: (bool(f.warning), -f.evidence.gain)))


def _final_model(stepwise, fit):
    """Drop unsupported members one by one; return fit, log odds and gains."""
    # Unsupported: improbable given the spectrum of the whole model, no cross-validated
    # gain, or an impossible sign or size.
    cache = {}
    while True:
        exact = not cache
        odds, validation = stepwise.refitted_odds(fit, cache), stepwise.validate(fit)
        gains = {i: validation.gain_of(i) for i in range(odds.size)}
        if not gains:
            return fit, odds, gains
        worst = int(np.argmin(odds))
        if odds[worst] > stepwise.candidates.least:
            scores = [
                gain.gain
                if member.effect.natural(fit.coefficients(i))
                # It must help in most blocks to be called probable.
                and ndtr(gain.errors) >= stepwise.settings.min_probability
                and validation.share_of(i) > ENTRY_SHARE * stepwise.settings.min_gain
                else -np.inf
                for i, (member, gain) in enumerate(zip(fit.members, gains.values()))
            ]
            worst = int(np.argmin(scores))
            if scores[worst] > 0:
                if exact:
                    return fit, odds, gains
                cache = {}
                continue
        fit = stepwise.dropped(fit, worst)


def _sufficient_gains(validation, min_gain):
    """Return the gains of members with a sufficient gain given the others, by index."""
    # Eliminate the smallest gain and refit the others, until each saves a share of the
    # error that the friction terms leave on at least one joint.
    kept, absent = list(range(len(validation.fit.members))), []
    members = tuple(kept)
    while kept:
        shares = [validation.share_of(i, absent, members) for i in kept]
        worst = int(np.argmin(shares))
        if shares[worst] > min_gain:
            break
        absent.append(kept.pop(worst))
    return {i: validation.gain_of(i, absent) for i in kept}


def _warning(fit, member, evidence, needed, stepwise):
    """Return why an effect is not reported apart from a small gain, "" if it is."""
    if evidence.log_odds < needed:
        return UNDECIDED
    if not evidence.errors > max(stepwise.settings.significance, ndtri(expit(needed))):
        return CHANCE
    filters = isinstance(member.effect, OfChannel) and member.effect.corner is not None
    if filters and not stepwise.above_motion(fit, member.effect):
        return SLOW_FILTER
    return ""
