"""Names from odds: which effects of the most probable model are named."""

import numpy as np
from scipy.special import expit, ndtr, ndtri

from sklearn_vbjfa.diagnosis.search._found import (
    Evidence,
    Finding,
    Found,
    FoundModel,
    Rival,
)
from sklearn_vbjfa.diagnosis.search._held_out import HeldOut
from sklearn_vbjfa.diagnosis.search._path import Path
from sklearn_vbjfa.effects import OfChannel

# Why an effect that is probable has no name; what its values say is in `explain`.
UNDECIDED = "undecided"
CHANCE = "lowers no error on other stretches of time beyond chance"
SMALL = "saves too little to be named"
SLOW_FILTER = "a filter within the motion's own frequencies"


def search(view, library, settings, alpha, max_effects=None):
    """Find the most probable effects of a recording, and say which are named."""
    path = Path(view, library, settings, max_effects)
    needed = float(np.log((1.0 - alpha) / alpha))
    fit, odds, worths = _settled(path, path.run())
    usual = path.log_odds(fit, usual=True)
    findings = []
    for i, (member, own, worth) in enumerate(zip(fit.members, odds, worths)):
        evidence = Evidence(log_odds=float(own), **vars(worth))
        rivals = tuple(
            Rival(effect=o.effect, log_odds=o.order)
            for o in path.rivals(fit, i)
            if (o.effect.in_model or o.order > usual[i] - settings.rivals)
            and o.effect.key() != member.effect.key()
        )
        warning = _warning(member, evidence, settings, needed, path)
        findings.append(
            Finding(
                effect=member.effect, evidence=evidence, rivals=rivals, warning=warning
            )
        )
    order = sorted(range(len(findings)), key=lambda i: bool(findings[i].warning))
    model = FoundModel(
        view=path.view,
        effects=tuple(m.effect for m in fit.members),
        motion=path.motion,
        # As the held-out part is: stretches between others.
        residual=HeldOut(path.view, path.view.blocks.fold)
        .fitted(fit, path.motion)
        .residual,
        fit=fit,
    )
    return Found(
        model=model,
        findings=tuple(findings[i] for i in order),
        steps=tuple(path.steps),
        n_candidates=path.n_candidates,
        needed=needed,
        settings=settings,
        library=tuple(library),
    )


def _settled(path, fit):
    """Drop what speaks against the whole; the rest with log odds and gains."""
    # What the spectrum of the whole model makes improbable goes, what predicts other
    # motion worse, and what has a sign or size that it cannot have.
    while True:
        odds, left_out = path.own_odds(fit), path.held_out(fit)
        worths = [left_out.gain_of(i) for i in range(odds.size)]
        if not worths:
            return fit, odds, worths
        worst = int(np.argmin(odds))
        if odds[worst] > path.least:
            gains = [
                own.gain
                if member.effect.natural(fit.coefficients(i))
                # In most blocks as well, or nobody would call it probable.
                and ndtr(own.errors) >= path.settings.undecided
                else -np.inf
                for i, (member, own) in enumerate(zip(fit.members, worths))
            ]
            worst = int(np.argmin(gains))
            if gains[worst] > 0:
                return fit, odds, worths
        fit = path.dropped(fit, worst, float(odds[worst]))


def _warning(member, evidence, settings, needed, path):
    """Say why an effect is not named; "" for one that is."""
    if evidence.log_odds < needed:
        return UNDECIDED
    if not evidence.errors > max(settings.chance, ndtri(expit(needed))):
        return CHANCE
    if not evidence.gain > settings.worth:
        return SMALL
    filters = isinstance(member.effect, OfChannel) and member.effect.corner is not None
    if filters and not path.above_motion(member.effect):
        return SLOW_FILTER
    return ""
