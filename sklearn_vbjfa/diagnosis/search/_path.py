"""The way to the most probable model: add, refine, drop, exchange by one posterior."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logit
from sklearn.base import clone

from sklearn_vbjfa._core._groups import Overdispersion
from sklearn_vbjfa._core._progress import counted, say
from sklearn_vbjfa.diagnosis.search._held_out import HeldOut
from sklearn_vbjfa.diagnosis.search._problem import (
    Family,
    Fit,
    Problem,
    declared_alone,
    rescaled,
    spectrum_of,
    stacked,
    together,
    weighed,
)
from sklearn_vbjfa.diagnosis.search._refine import (
    MOST_STEPS,
    SHARES,
    WORTH,
    Place,
    refined,
    starts,
)
from sklearn_vbjfa.diagnosis.search._view import variants
from sklearn_vbjfa.effects import Shaped, closure

# Times that load, spectrum and geometry are made anew.
_TURNS = 2
# Times that a model is tuned on another recording, until its evidence [nats] stays.
_CLOSER, _STAYS = 20, 0.1
# Share of the error that its mirror image saves of what an effect with a direction
# saves: more is nothing with a direction.
_MIRROR = 0.5
# Share of a motion's power below the frequency up to which it is said to reach.
_MOTION = 0.9
# Instants of a jump that are looked at more closely.
_JUMPS = 3
# Log odds below which nothing of the geometry is a candidate.
_NO_CHANCE = -20.0
# Nats within which the first in precedence gives its name to equal columns.
_EQUAL = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A candidate effect given a model."""

    family: Family  # all of its shapes
    best: int  # the best of them
    log_odds: float  # posterior log odds that the model lacks it, shapes averaged
    coef: np.ndarray  # (k,): of the best shape
    # whether its evidence has been tempered by its scatter in time, see `Fit.excess`;
    # it is an upper bound before
    tempered: bool = False
    # log odds by which it compares with others, see `Overdispersion.as_usual`
    order: float = 0.0

    @property
    def effect(self):
        """Effect with the best shape."""
        return self.family.effects[self.best]


@dataclass(frozen=True, kw_only=True, eq=False)
class Trials:
    """Shapes of an effect given a fit, see `refined`."""

    path: object
    fit: Fit

    def evidence(self, effects):
        """Log evidence (c,) of several shapes."""
        family, scale = self.path._shaped(effects), self.path.settings.scale
        return self.fit.groups(family).evidence(scale)

    def climbed(self, place, evidence):
        """Follow the derivatives of columns: the best effect and its evidence."""
        family, scale = self.path._shaped([place.effect]), self.path.settings.scale
        best = float(self.fit.groups(family).best_scale(scale)[0])
        fit, last = self.fit.beside(family.member(0, best)), len(self.fit.members)
        fit = self.path._stepped(fit, [last])
        found = fit.members[last].effect
        now = float(self.evidence([found])[0])
        return (found, now) if now > evidence else (place.effect, evidence)


class Path:
    """Search for the most probable set of effects, at most `max_effects`."""

    # library: what to try on every joint.

    def __init__(self, view, library, settings, max_effects=None):
        self.view, self.library, self.settings = view, library, settings
        self.max_effects, self.turn = max_effects, 0
        self._grids = {}
        self._cached, self._outdated, self._rejected = {}, set(), set()
        self._held = None
        # Log odds above which an effect is in the model.
        self.least = float(logit(settings.undecided))

    # -- candidates -----------------------------------------------------------------

    def _make_families(self):
        """Families of all effects on all joints, by joint."""
        found = {j: [] for j in np.flatnonzero(self.problem.used_joints)}
        asked = [(j, effect) for j in found for effect in self.library]
        for j, effect in counted(asked, "candidates"):
            one = clone(effect).set_params(joint=int(j))
            if one.name in self.view.declared or one.applies(self.motion):
                continue
            family = self.problem.family(one, self.motion)
            if family is not None:
                found[j] += family.split()
        self.families = {j: stacked(own) for j, own in found.items()}
        count = sum(map(len, found.values()))
        self.n_candidates = count
        self.log_prior = np.log(self.settings.expected / max(count, 1))

    def _candidate(self, fit, family, taken, excess=None):
        """Return the best shape of a family given a fit as a `Candidate`, or None."""
        scale, least = self.settings.scale, self._no_chance(family)
        if excess is None:
            evidence = fit.evidence(family, scale)
            if not evidence.max() > least:
                return None
        groups = fit.groups(family)
        if excess is not None:
            groups = groups.discounted(excess)
            evidence = groups.evidence(scale)
        free = groups.shown() & [key not in taken for key in family.keys]
        if not free.any() or evidence[free].max() <= least:
            return None
        coefs = groups.coefficients()
        for c in np.flatnonzero(free):
            effect = family.effects[c]
            free[c] = effect.plausible(coefs[c, : len(effect.coefficients)])
        if not free.any():
            return None
        if family.opposite_keys:
            free &= self._one_sided(family, groups.gain(), free)
            if not free.any():
                return None
        evidence = np.where(free, evidence, -np.inf)
        whole = np.logaddexp.reduce(evidence)
        log_odds = float(whole - np.log(free.size) + self.log_prior)
        return Candidate(
            family=family,
            best=int(np.argmax(evidence)),
            log_odds=log_odds,
            coef=coefs[int(np.argmax(evidence))],
            order=log_odds,
        )

    def _no_chance(self, family):
        """Log evidence of a shape up to which an effect decides nothing."""
        # Rivals are within so many nats of a member, spectra take one of each joint.
        near = -max(self.settings.rivals, np.log(len(self.families)))
        return (_NO_CHANCE if family.effects[0].in_model else near) - self.log_prior

    def _tempered(self, fit, candidate):
        """Discount the evidence of a candidate by its scatter in time."""
        if candidate.tempered:
            return candidate
        family, best, coef = candidate.family, candidate.best, candidate.coef
        if isinstance(candidate.effect, Shaped) and candidate.effect.jumping:
            # Beside its instant a jump leaves a residual of its own size.
            family, best = self._single(self._best_shape(fit, candidate)), 0
            coef = fit.groups(family).coefficients()[0]
        excess = fit.excess(family, best, coef, self._noise)
        taken = self._taken(fit)
        usual = self._candidate(fit, candidate.family, taken, excess.as_usual())
        if usual is None:
            return None
        if not np.isfinite(excess.freedom):
            return replace(usual, tempered=True)
        strict = self._candidate(fit, candidate.family, taken, excess)
        if strict is None:
            return None
        return replace(strict, tempered=True, order=usual.order)

    def _most_probable(self, fit, candidates):
        """Return the most probable candidate, None if there is none."""
        # Banks have an upper bound, which is made exact where it leads.
        best = None
        for candidate in sorted(candidates, key=lambda o: -o.log_odds):
            if best is not None and candidate.log_odds <= best.log_odds:
                break
            if candidate.effect.bank and not candidate.tempered:
                known = candidate.family, self._taken(fit), Overdispersion()
                candidate = self._candidate(fit, *known)
            if best is None or (candidate and candidate.log_odds > best.log_odds):
                best = candidate
        return best

    def _surest(self, fit, candidates, margin=0.0):
        """Return tempered candidates within a margin of the best, the best first."""
        # Tempering takes evidence only, so that what is below the best of those that
        # are tempered need not be.
        found, open_ = [], sorted(candidates, key=lambda o: o.order)
        best = -np.inf
        while open_ and open_[-1].order > best - margin:
            candidate = self._tempered(fit, open_.pop())
            if candidate is not None:
                found.append(candidate)
                best = max(best, candidate.order)
        found = [o for o in found if o.order > best - margin - 1e-9]
        return sorted(found, key=lambda o: -o.order)

    def _one_sided(self, family, gain, free):
        """Which shapes are of a direction that their mirror image does not share."""
        best = {}
        for key, own, allowed in zip(family.keys, gain, free):
            if allowed:
                best[key] = max(best.get(key, 0.0), own)
        return np.array(
            [
                best.get(opposite, 0.0) <= _MIRROR * best.get(key, 0.0)
                for key, opposite in zip(family.keys, family.opposite_keys)
            ]
        )

    def _taken(self, fit):
        """Keys of effects that a fit excludes, a set."""
        return self._rejected.union(*(m.effect.excludes() for m in fit.members))

    def _contained(self, fit, joint):
        """Names of effects that a member of a joint contains, a set."""
        own = [m.effect for m in fit.members if m.effect.joint == joint]
        return set().union(*(closure(effect, self.library) for effect in own))

    def _candidates(self, fit, joint):
        """Candidates on a joint given a fit."""
        self._say(fit, joint)
        taken = self._taken(fit)
        within = self._contained(fit, joint)
        found = (
            self._candidate(fit, family, taken)
            for family in self.families[joint]
            if family.effects[0].name not in within
        )
        return [candidate for candidate in found if candidate is not None]

    # -- moves ------------------------------------------------------------------------

    def _best(self, fit):
        """Best candidate on any joint; unchanged joints keep their candidates."""
        # What contains an effect of the model comes when nothing else does.
        for joint in self.families:
            if joint not in self._cached:
                self._cached[joint] = self._candidates(fit, joint)
        there = {(m.effect.name, m.effect.joint) for m in fit.members}

        def waits(candidate):
            names = closure(candidate.effect, self.library)
            return any((name, candidate.effect.joint) in there for name in names)

        while True:
            probable = [
                o for k in self._cached.values() for o in k if o.log_odds > self.least
            ]
            if not probable:
                if not self._outdated:
                    return None
                for j in self._outdated:
                    self._cached[j] = self._candidates(fit, j)
                self._outdated = set()
                continue
            best = min(probable, key=lambda o: (waits(o), -o.order))
            joint = best.effect.joint
            if joint in self._outdated:
                self._cached[joint] = self._candidates(fit, joint)
                self._outdated.discard(joint)
            elif not best.tempered:
                sure = self._tempered(fit, best)
                rest = [o for o in self._cached[joint] if o is not best]
                self._cached[joint] = rest if sure is None else [*rest, sure]
            else:
                plain = self._plainer(fit, best, self._cached[joint])
                return self._first(best, probable) if plain is best else plain

    def _plainer(self, fit, best, candidates):
        """Plainer effect that a candidate contains, if that is probable alone."""
        # What contains it comes beside it: a prior of heredity (H. Chipman, "Bayesian
        # variable selection with related predictors", Canadian J. of Statistics 24(1),
        # 1996, doi 10.2307/3315687).
        names = closure(best.effect, self.library)
        within = [
            o for o in candidates if o.effect.name in names and o.log_odds > self.least
        ]
        sure = [o for o in self._surest(fit, within) if o.log_odds > self.least]
        return sure[0] if sure else best

    def _first(self, best, candidates):
        """First in precedence of those of the geometry that say the same."""
        if not best.effect.in_model:
            return best
        near = [
            o for o in candidates if o.effect.in_model and o.order > best.order - _EQUAL
        ]
        return min(near, key=lambda o: (o.effect.precedence, -o.order))

    def _refused(self, candidate):
        """Make the candidates of a joint again without one that was refused."""
        self._cached.pop(candidate.effect.joint, None)
        self._outdated.discard(candidate.effect.joint)

    def _moved(self, joints=None):
        """Note that the model of some joints, or of all, has changed."""
        if joints is None or len(joints) > 1:
            self._cached.clear()
            self._outdated = set()
        else:
            for joint in joints:
                self._cached.pop(joint, None)
            self._outdated = set(self._cached)

    def scaled(self, fit):
        """Return a fit with the most probable scale of each member."""
        return self._trimmed(rescaled(fit, self.settings.scale))

    def _trimmed(self, fit):
        """Return a fit whose banks have no element of negative size."""
        for i, member in enumerate(fit.members):
            used = fit.coefficients(i) > 0
            if member.effect.bank and used.any() and not used.all():
                kept = self._single(member.effect.only(used)).member(0, member.scale)
                members = (*fit.members[:i], kept, *fit.members[i + 1 :])
                return self._trimmed(Fit(fit.base, members))
        return fit

    def _bank(self, fit, effect):
        """Return a bank with the elements of positive size given a fit."""
        family = self._family(effect)
        groups = fit.groups(family)
        best = int(np.argmax(groups.evidence(self.settings.scale)))
        found = family.effects[best]
        if found.continuous:
            found, best = self._refined(fit, [found]), 0
            groups = fit.groups(self._single(found))
        used = groups.coefficients()[best, : len(found.coefficients)] > 0
        if not used.any():
            return effect
        found = found.only(used).finer()
        return found.only(fit.groups(self._single(found)).coefficients()[0] > 0)

    def _member(self, fit, candidate):
        """Return a candidate as a member, its shape searched between the grid's."""
        family = self._single(self._best_shape(fit, candidate))
        best = fit.groups(family).best_scale(self.settings.scale)[0]
        return family.member(0, float(best))

    def _best_shape(self, fit, candidate):
        """Effect of a candidate, its shape searched between the grid's."""
        effect, family = candidate.effect, candidate.family
        if effect.bank:
            return self._bank(fit, effect)
        if not _searched_on(effect):
            return effect
        if effect.jumping:
            return self._refined(fit, [effect, *self._instants(fit, effect, family)])
        evidence = fit.evidence(family, self.settings.scale)
        return self._refined(fit, starts(family.effects, evidence, effect))

    def _instants(self, fit, effect, family):
        """Return an effect that jumps with the most probable instants of all rows."""
        # What its columns have in common with the residual is a sum over the rows after
        # the jump; their Gram matrix hardly changes between two instants of the grid.
        (name,) = effect.jumping
        grid = np.array([getattr(e, name) for e in family.effects])
        order, beside = np.argsort(grid), fit.groups(family)
        always = clone(effect).set_params(**{name: -np.inf})
        columns = self.view.columns([always], self.motion)[:, :, 0]
        rest = fit.weighted_rows[list(self.view.joints_of(effect))]
        products = np.einsum("jmk,jm->mk", columns, rest)
        after = np.cumsum(products[::-1], axis=0)[::-1]
        t = self.motion.t[self.view.index]
        at = np.interp(t, grid[order], np.arange(order.size))
        low = np.minimum(at.astype(int), max(order.size - 2, 0))
        share = (at - low)[:, None, None]
        H = beside.H[order]
        H = (1 - share) * H[low] + share * H[np.minimum(low + 1, order.size - 1)]
        near = order[np.round(at).astype(int)]
        own = {"own": beside.own[near], "unit": beside.unit[near]}
        evidence = replace(beside, H=H, q=after, **own).evidence(self.settings.scale)
        found, apart = [], np.diff(grid[order]).max(initial=0.0) / 4
        for _ in range(_JUMPS):
            best = int(np.argmax(evidence))
            found.append(clone(effect).set_params(**{name: float(t[best])}))
            evidence = np.where(np.abs(t - t[best]) < apart, -np.inf, evidence)
        return found

    def _family(self, effect):
        """Shapes of the grid of an effect."""
        if effect.key() not in self._grids:
            effects = variants(effect, self.motion)
            columns = self.view.columns(effects, self.motion)
            self._grids[effect.key()] = Family.of(self.problem, effects, columns)
        return self._grids[effect.key()]

    def _single(self, effect):
        """Family of one shape."""
        return self._shaped([effect])

    def _shaped(self, effects):
        """Family of some shapes of an effect."""
        columns = self.view.columns(effects, self.motion)
        return Family.of(self.problem, effects, columns)

    def _refined(self, fit, effects):
        """Search the shape of an effect given a fit, from one or several."""
        return refined(effects, Trials(path=self, fit=fit), self.motion)

    def refined(self, fit, joints=None):
        """Search the shapes of members again, of all joints or some."""
        shaped = [
            i
            for i, member in enumerate(fit.members)
            if (member.effect.bank or _searched_on(member.effect))
            and (joints is None or member.effect.joint in joints)
        ]
        fit = self._stepped(fit, shaped)
        for i in shaped:
            effect, rest = fit.members[i].effect, fit.without(i)
            if effect.bank:
                found = self._bank(rest, effect)
            elif effect.jumping:
                found = self._refined(rest, [effect])
                again = self._instants(rest, found, self._family(found))
                found = self._refined(rest, [found, *again])
            else:
                continue
            members = list(fit.members)
            members[i] = self._single(found).member(0, members[i].scale)
            fit = Fit(fit.base, members)
        self._moved()
        return self.scaled(fit)

    def _stepped(self, fit, numbers):
        """Search the shapes of members, which trade against each other, at once."""
        places = {
            i: Place.of(fit.members[i].effect, self.motion)
            for i in numbers
            if not (fit.members[i].effect.jumping or fit.members[i].effect.bank)
        }
        places = {i: place for i, place in places.items() if place is not None}
        families = {i: self._shaped(place.around()) for i, place in places.items()}
        for _ in range(MOST_STEPS if places else 0):
            members = list(fit.members)
            for i, place in places.items():
                known = members[i], families[i], fit.coefficients(i)
                members[i] = place.with_derivatives(*known)
            linear = Fit(fit.base, members)
            if linear.explained - fit.explained < WORTH:
                break
            for share in SHARES:
                moved, new = {}, list(fit.members)
                for i, place in places.items():
                    step = linear.coefficients(i)[fit.members[i].width :]
                    moved[i] = place.moved(share * step)
                made = {i: self._shaped(place.around()) for i, place in moved.items()}
                for i, family in made.items():
                    new[i] = family.member(0, new[i].scale)
                again = Fit(fit.base, new)
                if again.log_evidence() > fit.log_evidence():
                    break
            else:
                break
            fit, places, families = again, moved, made
        return fit

    def log_odds(self, fit, usual=False):
        """Posterior log odds of each member given the others."""
        # As `usual` those by which they compare, see `Overdispersion.as_usual`.
        found = []
        for member, groups, excess in zip(
            fit.members, fit.own_groups(), fit.excesses(self._noise)
        ):
            tempered = groups.discounted(excess.as_usual() if usual else excess)
            evidence = float(tempered.evidence(self.settings.scale)[0])
            found.append(evidence - np.log(self._shapes(member)))
        return np.array(found) + self.log_prior

    def own_odds(self, fit):
        """Posterior log odds of each member, with the spectrum that each model has."""
        # What is slow may be noise: without an effect the spectrum takes its place.
        fit = spectrum_of(fit, self.settings)
        whole, share, found = fit.log_evidence(), fit.base.share, []
        both = zip(fit.members, fit.own_groups(), fit.excesses(fit))
        for i, (member, groups, excess) in enumerate(both):
            rest = spectrum_of(fit.without(i), self.settings, share=share)
            scale = self.settings.scale
            more = float(groups.integrated(scale, member.scale)[0])
            evidence = min(
                float(groups.discounted(excess).evidence(scale)[0]),
                excess.discounted(whole + more - rest.log_evidence(), member.width),
            )
            found.append(evidence - np.log(self._shapes(member)) + self.log_prior)
        return np.array(found)

    def _shapes(self, member):
        """Count the shapes among which a member was chosen."""
        for family in self.families.get(member.effect.joint, ()):
            if family.effects[0].name == member.effect.name:
                return len(family.effects)
        return 1

    def _pruned(self, fit):
        """Drop improbable members, the least probable first."""
        while fit.members:
            odds = self.log_odds(fit)
            i = int(np.argmin(odds))
            if odds[i] > self.least:
                break
            self._moved(fit.members[i].joints)
            fit = self.dropped(fit, i)
        return fit

    def dropped(self, fit, i):
        """Return a fit without a member."""
        effect = fit.members[i].effect
        fit = self.scaled(fit.without(i))
        # The robot is not corrected by it any more.
        return self._anew(fit) if effect.in_model else fit

    def above_motion(self, effect):
        """Whether a filter of a channel acts above the motion of its joint."""
        frequency, power = [], []
        for part in self.view.parts:
            speed = self.motion.v[part, effect.joint]
            frequency.append(np.fft.rfftfreq(speed.size, self.view.dt))
            power.append(np.abs(np.fft.rfft(speed)) ** 2 / speed.size)
        frequency, power = np.concatenate(frequency), np.concatenate(power)
        order = np.argsort(frequency, kind="stable")
        share = np.cumsum(power[order])
        highest = frequency[order][np.searchsorted(share, _MOTION * share[-1])]
        return effect.corner > self.settings.above_motion * highest

    def held_out(self, fit):
        """Leave out folds of time; see `HeldOut.fitted`."""
        if self._held is None or self._held.view is not self.view:
            self._held = HeldOut(self.view)
        return self._held.fitted(fit, self.motion)

    def _climb(self, fit):
        """Add, drop, refine and exchange until nothing is more probable."""
        self._moved()
        been, tuned, self._rejected = {keys_of(fit)}, frozenset(), set()
        tried = fit
        while True:
            full = self.max_effects is not None and len(fit.members) >= self.max_effects
            candidate = None if full else self._best(fit)
            if candidate is not None:
                new = self._added(fit, candidate)
                if keys_of(new) in been:
                    # What came was refused, has gone again, or led back.
                    self._rejected.update(candidate.family.keys)
                    self._refused(candidate)
                    continue
            elif fit.members and keys_of(fit) != tuned:
                # Shapes that were found before the others of their joints were there.
                joints = {joint for _, joint, _ in keys_of(fit) ^ tuned}
                tuned = keys_of(fit)
                new = self._pruned(self.refined(fit, joints))
            elif self._rejected and tried is not fit:
                # What was refused beside another model.
                self._rejected, tried = set(), fit
                self._moved()
                continue
            else:
                new = self._exchanged(fit, been)
                if new is None and (self.turn or not fit.members):
                    new = self._together(fit, been)
            if new is None:
                return fit
            fit = new
            been.add(keys_of(fit))

    def _added(self, fit, candidate):
        """Return a fit with a candidate, without what becomes improbable by that."""
        member = self._member(fit, candidate)
        new = self.scaled(fit.beside(member))
        if not self.held_out(new).gain_of(len(fit.members)).helps:
            # What predicts other motion no better is refused beside this model.
            return fit
        if not self._settles(new):
            return fit
        self._moved(member.joints)
        return self._pruned(self._absorbed(new))

    def _absorbed(self, fit):
        """Leave out what the last member contains if that does as well alone."""
        # Its shape was found beside them, where it stood for what they had left over.
        last = fit.members[-1]
        names, joint = closure(last.effect, self.library), last.effect.joint
        rest = [
            m
            for m in fit.members[:-1]
            if m.effect.joint != joint or m.effect.name not in names
        ]
        if len(rest) == len(fit.members) - 1:
            return fit
        base = Fit(fit.base, rest)
        candidates = [
            candidate
            for family in self.families[joint]
            if family.effects[0].name == last.effect.name
            for candidate in [self._candidate(base, family, self._taken(base))]
            if candidate is not None
        ]
        for candidate in candidates:
            alone = self.scaled(base.beside(self._member(base, candidate)))
            own, both, none = (
                self.held_out(one).error_of(joint) for one in (alone, fit, base)
            )
            # Most of what both save.
            if own - both <= self.settings.worth * (none - both):
                return alone
        return fit

    def _settles(self, fit):
        """Whether a fit stands once the robot is corrected and its load made anew."""
        # What its first derivative promises need not hold: a gain that is hidden looks
        # like whatever the joint lacks. And bodies take the load from friction that
        # depends on it; of the other members the next round asks that.
        last = len(fit.members) - 1
        effect = fit.members[last].effect
        if not ("load" in effect.depends or effect.in_model):
            return True
        before = self.view, self.problem, self.motion
        for _ in range(_TURNS):
            fit = self._anew(fit)
            sure = self.log_odds(fit)[last] > self.least
            if not sure:
                break
        natural = fit.members[last].effect.natural(fit.coefficients(last))
        self.view, self.problem, self.motion = before
        return sure and natural

    def rivals(self, fit, i):
        """Candidates that would take the place of a member, the best first."""
        member, base = fit.members[i], fit.without(i)
        found = []
        for joint in self.families:
            if joint in member.joints:
                found += self._candidates(base, joint)
        near = self._surest(base, found, self.settings.rivals)
        if member.effect.in_model:
            # What turns the robot alike with more values than are needed.
            known = {o.effect.key() for o in near}
            near += [
                o
                for o in self._as_well(base, found, member)
                if o.effect.key() not in known
            ]
        return near

    def _as_well(self, base, candidates, member):
        """Effects of the geometry that explain as much as a member does."""
        candidates = [self._tempered(base, o) for o in candidates if o.effect.in_model]
        gains = {
            o: 0.5 * base.groups(o.family).gain()[o.best]
            for o in candidates
            if o is not None
        }
        own = [g for o, g in gains.items() if o.effect.key() == member.effect.key()]
        least = max(own, default=np.inf) - self.settings.rivals
        return [o for o, gain in gains.items() if gain > least]

    def _exchanged(self, fit, been):
        """Put what is more probable in the place of a member; None if nothing is."""
        odds = self.log_odds(fit, usual=True)
        for i in np.argsort(odds):
            member, base = fit.members[i], fit.without(i)
            near = [
                o
                for o in self.rivals(fit, i)
                if o.order > odds[i] - self.settings.rivals
                and o.log_odds > self.least
                and not o.effect.in_model
                and o.effect.key() != member.effect.key()
                and member.effect.name not in closure(o.effect, self.library)
            ]
            for candidate in near[:3]:
                other = self._member(base, candidate)
                new = self.scaled(base.beside(other))
                own = self.log_odds(new, usual=True)[-1]
                if own < odds[i] + _EQUAL or keys_of(new) in been:
                    continue
                if self.held_out(new).error() > self.held_out(fit).error():
                    continue
                self._moved()
                return new
        return None

    def _together(self, fit, been):
        """Begin with everything on a joint and drop what is not needed, or None."""
        # What hides another, or shows beside it alone, does not come one by one.
        for joint in self.families:
            new = self._needed(fit, joint)
            # One that comes alone, or in place of another, was asked before.
            if keys_of(new) in been or len(keys_of(new) - keys_of(fit)) < 2:
                continue
            been.add(keys_of(new))
            new = self._pruned(self.refined(new, {joint}))
            if len(keys_of(new) - keys_of(fit)) < 2 or self._excluded(new):
                continue
            if self.max_effects is not None and len(new.members) > self.max_effects:
                continue
            before, left_out = keys_of(fit), self.held_out(new)
            surest = min(
                own
                for own, m in zip(self.log_odds(new), new.members)
                if m.effect.key() not in before
            )
            if surest < self.least + self.settings.rivals:
                continue
            if left_out.error() > self.held_out(fit).error():
                continue
            if all(left_out.gain_of(i).helps for i in range(len(new.members))):
                self._moved()
                return new
        return None

    def _needed(self, fit, joint):
        """Return a fit with what is probable of a joint beside all the rest."""
        self._say(fit, joint)
        taken, within = self._taken(fit), self._contained(fit, joint)
        scale, members = self.settings.scale, []
        for family in self.families[joint]:
            first = family.effects[0]
            if first.in_model or first.whole_robot or first.bank:
                continue
            if first.name in within:
                continue
            free = fit.groups(family).shown() & [k not in taken for k in family.keys]
            if free.any():
                evidence = np.where(free, fit.evidence(family, scale), -np.inf)
                members.append(family.member(int(np.argmax(evidence)), scale))
        others = [m for m in fit.members if m.joints != (joint,)]
        members += [m for m in fit.members if m.joints == (joint,)]
        rest = Fit(fit.base, others)
        odds = self.log_prior - np.log([self._shapes(m) for m in members])
        kept = together(rest, members, odds - self.least, scale)
        return self.scaled(Fit(fit.base, [*others, *kept]))

    def _excluded(self, fit):
        """Whether a member of a fit excludes another."""
        return any(
            m.effect.key() in self._taken(fit.without(i))
            for i, m in enumerate(fit.members)
        )

    # -- the whole ------------------------------------------------------------------

    def _spectrum(self, fit):
        """Weights by the spectrum of what a model with too many effects leaves."""
        fit = spectrum_of(fit, self.settings)
        for _ in range(self.settings.most):
            self._moved()
            added, self._noise = [], fit
            for joint in self.families:
                candidates = self._candidates(fit, joint)
                # One is expected of each joint here.
                count = max(len(self.families[joint]), 1)
                least = self.log_prior - np.log(self.settings.expected / count)
                candidates = [o for o in candidates if o.log_odds > least]
                if self.view.repetition:
                    # What comes again with each phase would all be taken for effects.
                    candidates = self._surest(fit, candidates)
                best = self._most_probable(fit, candidates)
                if best is not None and best.log_odds > least:
                    found = best.family.member(best.best, self.settings.scale)
                    jumps = isinstance(best.effect, Shaped) and best.effect.jumping
                    added.append(self._member(fit, best) if jumps else found)
            if not added:
                break
            fit = Fit(fit.base, [*fit.members, *added])
            fit = spectrum_of(self.scaled(fit), self.settings)
        self._noise = fit
        return fit.base

    def begin(self):
        """Fit the declared columns alone, with the load that they give."""
        fit = declared_alone(self.view)
        self.problem = fit.problem
        self.motion = self.view.motion(fit.theta)
        return fit

    def placed(self, effects):
        """Return the most probable model with given effects, on the load they give."""
        fit = self.begin()
        for _ in range(_TURNS):
            members = [self._single(e).member(0, self.settings.scale) for e in effects]
            fit = self._anew(self.scaled(weighed(Fit(fit.base, members))))
            effects = [m.effect for m in fit.members]
        return self.scaled(weighed(fit))

    def _say(self, fit, joint):
        """Tell which joint is looked at, beside how many effects."""
        count = len(fit.members)
        say(
            f"round {self.turn + 1}, joint {joint + 1} of {self.view.target.shape[0]}, "
            f"{count} effect{'' if count == 1 else 's'}"
        )

    def run(self):
        """Search; returns the last `Fit`."""
        fit, seen = self.begin(), None
        self._make_families()
        for self.turn in range(_TURNS):
            say(f"round {self.turn + 1}")
            if self.turn:
                self._make_families()
            start = [self._again(m) for m in fit.members]
            base = self._spectrum(Fit(fit.base, start))
            fit = self._climb(self.scaled(Fit(base, start)))
            names = keys_of(fit)
            if names == seen or not fit.members:
                break
            seen = names
            fit = self._anew(fit)
        return fit

    def _again(self, member):
        """Return a member whose columns are made from the present motion."""
        return self._single(member.effect).member(0, member.scale)

    def _anew(self, fit):
        """Linearise effects where they are found, correct the robot, take its load."""
        effects, coefs = [], []
        members = []
        for i, member in enumerate(fit.members):
            own, coef = member.effect, fit.coefficients(i)
            if own.natural(coef):
                own = own.linearised_at(coef)
            members.append(replace(member, effect=own))
            effects.append(own)
            coefs.append(coef)
        theta, base, before = fit.theta, fit.base, self.view
        self.view = before.corrected(tuple(effects))
        if self.view is not before:
            self.problem = Problem(self.view, self.problem.cosines)
            base = base.on(self.problem)
            plain = [m for m in members if not m.effect.in_model]
            theta = Fit(base, plain).theta
        self.motion = self.view.motion(
            theta,
            tuple(e for e in effects if not e.in_model),
            np.concatenate(
                [np.empty(0), *(c for e, c in zip(effects, coefs) if not e.in_model)]
            ),
        )
        # Columns that neither the load nor the robot has changed stay.
        moved = self.view is not before
        again = [
            self._again(m) if moved or "load" in m.effect.needs else m for m in members
        ]
        return Fit(base, again)


def tuned_on(view, effects, settings):
    """Return effects with shapes that suit another recording, tuple of Effect."""
    if not effects:
        return ()
    path = Path(view, (), settings)
    # In the weights in which the model is fitted to it.
    fit, before = path.placed(effects), -np.inf
    for _ in range(_CLOSER):
        fit = weighed(path._anew(path.refined(fit)))
        now = fit.log_evidence()
        if abs(now - before) < _STAYS:
            break
        before = now
    return tuple(member.effect.completed(path.motion) for member in fit.members)


def _searched_on(effect):
    """Whether an effect has shapes between those of its grid."""
    return isinstance(effect, Shaped) and bool(effect.continuous)


def keys_of(fit):
    """Keys of a fit's effects, a frozenset."""
    return frozenset(m.effect.key() for m in fit.members)
