"""Candidate effects of each joint given a model, with their probabilities."""

import functools
import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logit
from sklearn.base import clone

from sklearn_vbjfa._core._groups import Overdispersion
from sklearn_vbjfa._core._runtime import counted
from sklearn_vbjfa.diagnosis.search._problem import Columns
from sklearn_vbjfa.diagnosis.search._refine import jump
from sklearn_vbjfa.effects import Bank, InModel, Shaped, Sudden, closure

# Share of the error that its mirror image saves of what an effect with a direction
# saves: more is nothing with a direction.
_MIRROR = 0.5
# Log odds below which nothing of the geometry is a candidate.
_GEOMETRY_ODDS = -20.0
# Half square sum [nats] by which a joint's weighted residual has to change for the
# joint to be looked at again, when nothing else is left and before.
_CHANGED, _CHANGED_MUCH = 0.5, 10.0


@dataclass(frozen=True, eq=False)
class Family:
    """A use of an effect on a joint, with its shapes."""

    columns: Columns  # of all effects of the joint with as many columns
    at: slice  # its shapes among these

    @functools.cached_property
    def effects(self):
        """Effect with each of the shapes, tuple of Effect."""
        return self.columns.effects[self.at]

    @functools.cached_property
    def keys(self):
        """Keys of the effects."""
        return tuple(effect.key() for effect in self.effects)

    @functools.cached_property
    def opposite_keys(self):
        """Keys of their opposites, empty where they have none."""
        if self.effects[0].opposite() is None:
            return ()
        return tuple(effect.opposite().key() for effect in self.effects)

    def groups(self, fit):
        """Second moments beside a model, `Groups`."""
        return fit.groups(self.columns).part(self.at)

    def member(self, c, scale):
        """Return the effect with one of the shapes as a `SelectedEffect`."""
        return self.columns.member(self.at.start + c, scale)


def _uses(effects):
    """Shapes of each separate use, see `Shaped.split_by`, lists."""
    uses = {}
    for effect in effects:
        kinds = effect.split_by if isinstance(effect, Shaped) else ()
        use = tuple(getattr(effect, name) for name in kinds)
        uses.setdefault(use, []).append(effect)
    return list(uses.values())


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A candidate effect given a model."""

    family: Family  # all of its shapes
    best: int  # the best of them
    log_odds: float  # posterior log odds that the model lacks it, shapes averaged
    coef: np.ndarray  # (k,): of the best shape
    # whether its evidence is discounted, see `Fit.overdispersion`; else an upper bound
    discounted: bool = False
    # log odds by which it compares with others, see `Overdispersion.as_usual`
    order: float = 0.0

    @property
    def effect(self):
        """Effect with the best shape."""
        return self.family.effects[self.best]


class Candidates:
    """Candidates on all joints given a fit; unchanged joints keep theirs."""

    # families: of all effects, by joint; noise: the fit whose residual is noise;
    # rejected: keys of refused effects; forgetful: joints without friction with memory.

    def __init__(self, problem, library, settings, forgetful=()):
        self.library, self.settings = library, settings
        self.noise, self.rejected = None, set()
        self.families = {int(j): [] for j in np.flatnonzero(problem.used_joints)}
        asked = [
            (j, effect)
            for j in self.families
            for effect in library
            if not (isinstance(effect, Bank) and j in forgetful)
        ]
        kinds = {}
        for j, effect in asked:
            one = clone(effect).set_params(joint=j)
            if one.name in problem.view.declared or one.applies(problem.motion):
                continue
            if shapes := problem.shapes(one, first=True):
                width = max(len(shape.coefficients) for shape in shapes)
                loaded = any("load" in shape.needs for shape in shapes)
                joints = tuple(one.acts_on(problem.view.nv))
                kind = j, joints, width, isinstance(one, Bank), loaded
                kinds.setdefault(kind, []).extend(_uses(shapes))
        # Side by side, so that moments beside a model are made at once; what does not
        # depend on the load for itself, as it stays.
        for (j, *_), uses in counted(kinds.items(), "candidate", len(kinds)):
            columns = problem.shaped(list(itertools.chain(*uses)))
            ends = np.cumsum([0, *map(len, uses)]).tolist()
            slices = itertools.starmap(slice, itertools.pairwise(ends))
            self.families[j] += [Family(columns, at) for at in slices]
        self.count = sum(map(len, self.families.values()))
        self.log_prior = np.log(settings.expected / max(self.count, 1))
        # Log odds above which an effect is in the model.
        self.least = float(logit(settings.min_probability))
        self._cache = {}

    # -- of one family --------------------------------------------------------------

    def candidate(self, fit, family, excess=None):
        """Return the best shape of a family given a fit as a `Candidate`, or None."""
        scale, least = self.settings.scale, self._min_evidence(family)
        if excess is None:
            evidence = fit.evidence(family.columns, scale)[family.at]
            if not evidence.max() > least:
                return None
        groups, taken = family.groups(fit), self.rejected | fit.excluded
        if excess is not None:
            groups = groups.discounted(excess)
            evidence = groups.evidence(scale)
        free = groups.shown() & [key not in taken for key in family.keys]
        free &= evidence > least
        coefs = groups.coefficients()
        for c in np.flatnonzero(free):
            effect = family.effects[c]
            free[c] = effect.plausible(coefs[c, : len(effect.coefficients)])
        if family.opposite_keys:
            free &= _is_directed(family, groups.gain(), free)
        if not free.any():
            return None
        evidence = np.where(free, evidence, -np.inf)
        best, whole = int(np.argmax(evidence)), np.logaddexp.reduce(evidence)
        log_odds = float(whole - np.log(free.size) + self.log_prior)
        return Candidate(
            family=family,
            best=best,
            log_odds=log_odds,
            order=log_odds,
            coef=coefs[best],
        )

    def _min_evidence(self, family):
        """Log evidence of a shape up to which an effect decides nothing."""
        # Rivals are within so many nats of a member, spectra take one of each joint.
        near = -max(self.settings.rivals, np.log(len(self.families)))
        least = _GEOMETRY_ODDS if isinstance(family.effects[0], InModel) else near
        return least - self.log_prior

    def discounted(self, fit, candidate):
        """Discount the evidence of a candidate by its scatter in time; or None."""
        if candidate.discounted:
            return candidate
        family, coef = candidate.family, candidate.coef
        if isinstance(candidate.effect, Sudden):
            # Beside its instant a jump leaves a residual of its own size.
            scale = self.settings.scale
            near = fit.problem.shaped([jump(fit, candidate.effect, scale, near=True)])
            coef = fit.groups(near).coefficients()[0]
            excess = fit.overdispersion(near, 0, coef, self.noise)
        else:
            place = family.at.start + candidate.best
            excess = fit.overdispersion(family.columns, place, coef, self.noise)
        usual = self.candidate(fit, candidate.family, excess.as_usual())
        if usual is None or not np.isfinite(excess.freedom):
            return usual and replace(usual, discounted=True)
        strict = self.candidate(fit, candidate.family, excess)
        return strict and replace(strict, discounted=True, order=usual.order)

    def shapes(self, member):
        """Count the shapes among which a member was chosen."""
        for family in self.families.get(member.effect.joint, ()):
            if family.effects[0].name == member.effect.name:
                return len(family.effects)
        return 1

    # -- of one joint ---------------------------------------------------------------

    def on(self, fit, joint):
        """Candidates on a joint given a fit, list."""
        own = [m.effect for m in fit.members if m.effect.joint == joint]
        within = set().union(*(closure(effect, self.library) for effect in own))
        found = (
            self.candidate(fit, family)
            for family in self.families[joint]
            if family.effects[0].name not in within
        )
        return [candidate for candidate in found if candidate is not None]

    def reset(self):
        """Look at all joints again, and at what was refused."""
        self.rejected, self._cache = set(), {}

    def reject(self, candidate):
        """Leave out an effect until all are looked at again."""
        self.rejected.update(candidate.family.keys)
        self._cache.pop(candidate.effect.joint, None)

    def best(self, fit):
        """Best tempered candidate of each joint that has a probable one, list."""
        # Joints that others have hardly changed are looked at once nothing is left.
        for changed in (_CHANGED_MUCH, _CHANGED):
            found = [self._best_on(fit, j, changed) for j in self.families]
            found = [one for one in found if one is not None]
            if found:
                break
        return found

    def probable(self):
        """All that is probable on the joints as they were last looked at, list."""
        own = [o for _, _, known in self._cache.values() for o in known]
        return [o for o in own if o.log_odds > self.least]

    def is_deferred(self, fit, candidate):
        """Whether something that a candidate contains is in the model already."""
        # Then it comes when nothing else does.
        names, joint = closure(candidate.effect, self.library), candidate.effect.joint
        own = {m.effect.name for m in fit.members if m.effect.joint == joint}
        return bool(names & own)

    def _best_on(self, fit, joint, changed):
        """Best tempered candidate of a joint, None if nothing is probable."""
        white = fit.residual[joint] * np.sqrt(fit.base.weights[joint])
        members = {m.effect.key() for m in fit.members if joint in m.joints}
        if joint in self._cache:
            before, there, _ = self._cache[joint]
            if there != members or 0.5 * ((white - before) ** 2).sum() > changed:
                del self._cache[joint]
        if joint not in self._cache:
            self._cache[joint] = white, members, self.on(fit, joint)
        known = self._cache[joint][2]
        while True:
            probable = [o for o in known if o.log_odds > self.least]
            if not probable:
                return None
            best = min(probable, key=lambda o: (self.is_deferred(fit, o), -o.order))
            if best.discounted:
                return self._simpler(fit, best, known)
            known.remove(best)
            if (sure := self.discounted(fit, best)) is not None:
                known.append(sure)

    def _simpler(self, fit, best, candidates):
        """Plainer effect that a candidate contains, if that is probable alone."""
        # What contains it comes beside it: a prior of heredity (H. Chipman, "Bayesian
        # variable selection with related predictors", Canadian J. of Statistics 24(1),
        # 1996, doi 10.2307/3315687).
        names = closure(best.effect, self.library)
        within = [
            o for o in candidates if o.effect.name in names and o.log_odds > self.least
        ]
        sure = [o for o in self.best_discounted(fit, within) if o.log_odds > self.least]
        return sure[0] if sure else best

    def best_discounted(self, fit, candidates, margin=0.0):
        """Return tempered candidates within a margin of the best, the best first."""
        # Tempering takes evidence only, so that what is below the best of those that
        # are tempered need not be.
        found, open_ = [], sorted(candidates, key=lambda o: o.order)
        best = -np.inf
        while open_ and open_[-1].order > best - margin:
            candidate = self.discounted(fit, open_.pop())
            if candidate is not None:
                found.append(candidate)
                best = max(best, candidate.order)
        found = [o for o in found if o.order > best - margin - 1e-9]
        return sorted(found, key=lambda o: -o.order)

    def most_probable(self, fit, candidates):
        """Return the most probable candidate, None if there is none."""
        # Banks have an upper bound, which is made exact where it leads.
        best = None
        for candidate in sorted(candidates, key=lambda o: -o.log_odds):
            if best is not None and candidate.log_odds <= best.log_odds:
                break
            if isinstance(candidate.effect, Bank) and not candidate.discounted:
                candidate = self.candidate(fit, candidate.family, Overdispersion())
            if best is None or (candidate and candidate.log_odds > best.log_odds):
                best = candidate
        return best

    # -- of members -----------------------------------------------------------------

    def rivals(self, fit, i):
        """Candidates that would take the place of a member, the best first."""
        member, base = fit.members[i], fit.without(i)
        joints = [j for j in member.joints if j in self.families]
        found = [o for j in joints for o in self.on(base, j)]
        near = self.best_discounted(base, found, self.settings.rivals)
        if isinstance(member.effect, InModel):
            # What turns the robot alike with more values than are needed.
            known = {o.effect.key() for o in near}
            as_well = self._equivalent_geometry(base, found, member)
            near += [o for o in as_well if o.effect.key() not in known]
        return near

    def _equivalent_geometry(self, base, candidates, member):
        """Effects of the geometry that explain as much as a member does."""
        candidates = [
            self.discounted(base, o)
            for o in candidates
            if isinstance(o.effect, InModel)
        ]
        gains = {
            o: 0.5 * o.family.groups(base).gain()[o.best]
            for o in candidates
            if o is not None
        }
        own = [g for o, g in gains.items() if o.effect.key() == member.effect.key()]
        least = max(own, default=np.inf) - self.settings.rivals
        return [o for o, gain in gains.items() if gain > least]

    def log_odds(self, fit, usual=False):
        """Posterior log odds of each member given the others."""
        # As `usual` those by which they compare, see `Overdispersion.as_usual`.
        found, scale = [], self.settings.scale
        both = zip(fit.members, fit.member_groups, fit.overdispersions(self.noise))
        for member, groups, excess in both:
            tempered = groups.discounted(excess.as_usual() if usual else excess)
            evidence = float(tempered.evidence(scale)[0])
            found.append(evidence - np.log(self.shapes(member)))
        return np.array(found) + self.log_prior


def _is_directed(family, gain, free):
    """Which shapes are of a direction that their mirror image does not share."""
    best = {}
    for key, own, allowed in zip(family.keys, gain, free):
        if allowed:
            best[key] = max(best.get(key, 0.0), own)
    pairs = zip(family.keys, family.opposite_keys)
    return np.array(
        [best.get(other, 0.0) <= _MIRROR * best.get(key, 0.0) for key, other in pairs]
    )
