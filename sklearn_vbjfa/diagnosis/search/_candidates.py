"""Candidate effects of each joint given a model, with their probabilities."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logit
from sklearn.base import clone

from sklearn_vbjfa._core._groups import Overdispersion
from sklearn_vbjfa._core._runtime import counted
from sklearn_vbjfa.diagnosis.search._problem import Columns
from sklearn_vbjfa.effects import InModel, OnAllJoints, Shaped, closure

# Least log odds of geometric candidates.
_GEOMETRY_ODDS = -20.0
# Candidates of a joint are updated if half the squared change of its weighted residual
# exceeds this [nats]: the first if no other joint has candidates, else the second.
_CHANGED, _CHANGED_MUCH = 0.5, 10.0


def _uses(effects):
    """Split the shapes of an effect by their causes, see `Shaped.split_by`, lists."""
    uses = {}
    for effect in effects:
        kinds = effect.split_by if isinstance(effect, Shaped) else ()
        use = tuple(getattr(effect, name) for name in kinds)
        uses.setdefault(use, []).append(effect)
    return list(uses.values())


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A candidate effect given a model."""

    columns: Columns  # of all of its shapes
    best: int  # index of the best shape
    log_odds: float  # posterior log odds that the model lacks it, averaged over shapes
    coef: np.ndarray  # (k,): of the best shape
    # whether its evidence is discounted, see `Fit.overdispersion`; else an upper bound
    discounted: bool = False
    # the same for comparisons of candidates, see `Overdispersion.as_usual`
    usual_odds: float = 0.0

    @property
    def effect(self):
        """Effect with the best shape."""
        return self.columns.effects[self.best]


class Candidates:
    """Candidates on all joints given a fit, cached for unchanged joints."""

    # columns: of each effect, by joint; rejected: keys of rejected effects; noise: the
    # fit whose residual is the noise (None: evidence is not discounted, but that of
    # banks is exact).

    def __init__(self, problem, library, settings):
        self.library, self.settings = library, settings
        self.noise, self.rejected = None, set()
        self.columns = {int(j): [] for j in np.flatnonzero(problem.used_joints)}
        uses = []
        for j, effect in itertools.product(range(problem.view.nv), library):
            new = clone(effect).set_params(joint=j)
            # A joint without samples may have effects on the torques of others.
            excluded = j not in self.columns and not isinstance(effect, OnAllJoints)
            if excluded or new.name in problem.view.declared:
                continue
            if not new.applies(problem.motion):
                uses += _uses(problem.shapes(new, first=True))
        for use in counted(uses, "candidate", len(uses)):
            self.columns.setdefault(use[0].joint, []).append(problem.columns(use))
        self.count = len(uses)
        self.log_prior = np.log(settings.expected / max(self.count, 1))
        # Log odds above which an effect is in the model.
        self.least = float(logit(settings.min_probability))
        self._cache = {}

    def candidate(self, fit, columns, overdispersion=None):
        """Return the best shape of an effect given a fit as a `Candidate`, or None."""
        # Rivals are within `rivals` nats; noise spectra use one candidate per joint.
        scale, least = self.settings.scale, -np.log(len(self.columns))
        least = min(least, -self.settings.rivals)
        if isinstance(columns.effects[0], InModel):
            least = _GEOMETRY_ODDS
        threshold, groups = least - self.log_prior, fit.groups(columns)
        if overdispersion is None:
            # At any scale the likelihood ratio of the best coefficients is larger; for
            # banks, whose evidence takes long to compute, it suffices here.
            evidence = 0.5 * groups.gain()
            if evidence.max() > threshold and not groups.positive:
                evidence = groups.evidence(scale)
        else:
            groups = groups.discounted(overdispersion)
            evidence = groups.evidence(scale)
        if not evidence.max() > threshold:
            return None
        excluded = self.rejected | fit.excluded
        eligible = groups.shown() & [key not in excluded for key in columns.keys]
        eligible &= evidence > threshold
        coefs = groups.coefficients()
        for c in np.flatnonzero(eligible):
            effect = columns.effects[c]
            eligible[c] = effect.plausible(coefs[c, : len(effect.coefficients)])
        if not eligible.any():
            return None
        evidence = np.where(eligible, evidence, -np.inf)
        best, total = int(np.argmax(evidence)), np.logaddexp.reduce(evidence)
        simple = np.where(columns.simple, evidence, -np.inf)
        if simple.max() > evidence[best] - self.settings.rivals:
            best = int(np.argmax(simple))
        log_odds = float(total - np.log(eligible.size) + self.log_prior)
        return Candidate(
            columns=columns,
            best=best,
            log_odds=log_odds,
            usual_odds=log_odds,
            coef=coefs[best],
        )

    def discounted(self, fit, candidate):
        """Discount the evidence of a candidate by its overdispersion; may be None."""
        if candidate.discounted:
            return candidate
        columns, overdispersion = candidate.columns, Overdispersion()
        if self.noise is not None:
            shape = candidate.best, candidate.coef
            overdispersion = fit.overdispersion(columns, *shape, self.noise)
        usual = self.candidate(fit, columns, overdispersion.as_usual())
        if usual is None or not np.isfinite(overdispersion.freedom):
            return usual and replace(usual, discounted=True)
        strict = self.candidate(fit, columns, overdispersion)
        return strict and replace(strict, discounted=True, usual_odds=usual.usual_odds)

    def shapes(self, member):
        """Count the shapes from which a member was selected."""
        for columns in self.columns.get(member.effect.joint, ()):
            if columns.effects[0].name == member.effect.name:
                return len(columns.effects)
        return 1

    def on(self, fit, joint):
        """Return the candidates on a joint given a fit, list."""
        members = [m.effect for m in fit.members if m.effect.joint == joint]
        contained = set().union(*(closure(effect, self.library) for effect in members))
        candidates = (
            self.candidate(fit, columns)
            for columns in self.columns[joint]
            if columns.effects[0].name not in contained
        )
        return [candidate for candidate in candidates if candidate is not None]

    def reject(self, candidate):
        """Exclude an effect."""
        self.rejected.update(candidate.columns.keys)
        self._cache.pop(candidate.effect.joint, None)

    def best(self, fit):
        """Return the best discounted candidate of each joint that has one, list."""
        # Joints with little change are updated if no joint has a candidate.
        for changed in (_CHANGED_MUCH, _CHANGED):
            candidates = [self._best_on(fit, j, changed) for j in self.columns]
            candidates = [x for x in candidates if x is not None]
            if candidates:
                break
        return candidates

    def probable(self):
        """Return all probable cached candidates, list."""
        candidates = [c for _, _, cached in self._cache.values() for c in cached]
        return [c for c in candidates if c.log_odds > self.least]

    def is_deferred(self, fit, candidate):
        """Check if the model has an effect that a candidate contains."""
        # Such a candidate is added only if there is no other.
        names, joint = closure(candidate.effect, self.library), candidate.effect.joint
        present = {m.effect.name for m in fit.members if m.effect.joint == joint}
        return bool(names & present)

    def _best_on(self, fit, joint, changed):
        """Return the best discounted candidate of a joint, None if none is probable."""
        # The residual of a joint without samples is zero.
        joints = [joint] if fit.problem.used_joints[joint] else slice(None)
        white = fit.residual[joints] * np.sqrt(fit.base.weights[joints])
        members = {m.effect.key() for m in fit.members if joint in m.joints}
        if joint in self._cache:
            old, keys, _ = self._cache[joint]
            if keys != members or 0.5 * ((white - old) ** 2).sum() > changed:
                del self._cache[joint]
        if joint not in self._cache:
            self._cache[joint] = white, members, self.on(fit, joint)
        candidates = self._cache[joint][2]
        while probable := [c for c in candidates if c.log_odds > self.least]:
            best = min(
                probable, key=lambda c: (self.is_deferred(fit, c), -c.usual_odds)
            )
            if best.discounted:
                return self._simpler(fit, best, candidates)
            candidates.remove(best)
            if (discounted := self.discounted(fit, best)) is not None:
                candidates.append(discounted)
        return None

    def _simpler(self, fit, best, candidates):
        """Return an effect that a candidate contains, if that is probable alone."""
        # The containing effect may follow: a heredity prior (H. Chipman, "Bayesian
        # variable selection with related predictors", Canadian J. of Statistics 24(1),
        # 1996, doi 10.2307/3315687).
        names = closure(best.effect, self.library)
        parts = [
            c for c in candidates if c.effect.name in names and c.log_odds > self.least
        ]
        alone = [c for c in self.best_discounted(fit, parts) if c.log_odds > self.least]
        return alone[0] if alone else best

    def best_discounted(self, fit, candidates, margin=0.0):
        """Return discounted candidates within a margin of the best, the best first."""
        # Discounting only lowers evidence: skip candidates below the best discounted.
        discounted, remaining = [], sorted(candidates, key=lambda c: c.usual_odds)
        best = -np.inf
        while remaining and remaining[-1].usual_odds > best - margin:
            candidate = self.discounted(fit, remaining.pop())
            if candidate is not None:
                discounted.append(candidate)
                best = max(best, candidate.usual_odds)
        discounted = [c for c in discounted if c.usual_odds > best - margin - 1e-9]
        return sorted(discounted, key=lambda c: -c.usual_odds)

    def rivals(self, fit, i):
        """Return candidates that could replace a member, the best first."""
        member, base = fit.members[i], fit.without(i)
        # Bodies of other sizes may make up for a correction of another joint.
        everywhere = isinstance(member.effect, InModel)
        joints = [j for j in self.columns if everywhere or j in member.joints]
        candidates = [c for j in joints for c in self.on(base, j)]
        same_joints = [c for c in candidates if c.effect.joint in member.joints]
        rivals = self.best_discounted(base, same_joints, self.settings.rivals)
        if isinstance(member.effect, InModel):
            # Also geometric effects with the same correction and more parameters.
            keys = {c.effect.key() for c in rivals}
            equivalent = self._equivalent_geometry(base, candidates, member)
            rivals += [c for c in equivalent if c.effect.key() not in keys]
        return rivals

    def _equivalent_geometry(self, base, candidates, member):
        """Return geometric effects that explain as much as a member."""
        geometric = (c for c in candidates if isinstance(c.effect, InModel))
        gains = {
            c: 0.5 * base.groups(c.columns).gain()[c.best]
            for c in (self.discounted(base, x) for x in geometric)
            if c is not None
        }
        same = [g for c, g in gains.items() if c.effect.key() == member.effect.key()]
        threshold = max(same, default=np.inf) - self.settings.rivals
        return [c for c, gain in gains.items() if gain > threshold]

    def log_odds(self, fit, usual=False):
        """Compute the posterior log odds of each member given the others."""
        # usual: for comparisons, see `Overdispersion.as_usual`.
        log_odds, scale = [], self.settings.scale
        rows = zip(fit.members, fit.member_groups, fit.overdispersions(self.noise))
        for member, groups, overdispersion in rows:
            if usual:
                overdispersion = overdispersion.as_usual()
            discounted = groups.discounted(overdispersion)
            evidence = float(discounted.evidence(scale)[0])
            log_odds.append(evidence - np.log(self.shapes(member)))
        return np.array(log_odds) + self.log_prior
