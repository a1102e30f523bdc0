"""The way to the most probable model: add, refine, drop, exchange by one posterior."""

from dataclasses import replace

import numpy as np
import scipy

from sklearn_vbjfa._core._runtime import say
from sklearn_vbjfa.diagnosis.search._candidates import Candidates
from sklearn_vbjfa.diagnosis.search._held_out import HeldOut
from sklearn_vbjfa.diagnosis.search._problem import (
    Columns,
    Fit,
    Problem,
    declared_weights,
    reweighted,
    spectrum_of,
)
from sklearn_vbjfa.diagnosis.search._refine import (
    best_shape,
    gauss_newton,
    search_shapes,
    with_shape,
)
from sklearn_vbjfa.effects import Bank, InModel, OnAllJoints, Sudden, closure

# Times that load, spectrum and geometry are made anew.
_ROUNDS = 2
# A model is tuned on another recording until its evidence [nats] stays, or for so many
# times without a better one: load and shapes may go to and fro.
_CONVERGED, _PATIENCE = 0.5, 4
# Share of a motion's power below the frequency up to which it is said to reach.
_POWER_SHARE = 0.9
# Share of the log odds of the most probable candidate from which others come with it.
_ODDS_SHARE = 0.2
# Share of what a name must save that an effect must save to be in the model.
ENTRY_SHARE = 0.5
# Nats within which the first in precedence gives its name to equal columns.
_TIE = 0.5


class Path:
    """Search for the most probable set of effects, at most `max_effects`."""

    # library: what to try on every joint; forgetful: see `Candidates`.

    def __init__(self, view, library, settings, max_effects=None, forgetful=()):
        self.view, self.library, self.settings = view, library, settings
        self.max_effects, self.turn, self.forgetful = max_effects, 0, forgetful
        self._held = None

    # -- the whole ------------------------------------------------------------------

    def begin(self):
        """Fit the declared columns alone, with the load that they give."""
        fit = Fit(declared_weights(Problem(self.view)))
        problem = fit.problem.changed(motion=self.view.motion(fit.theta))
        return Fit(fit.base.on(problem))

    def run(self):
        """Search; returns the last `Fit`."""
        fit, seen = self.begin(), None
        for self.turn in range(_ROUNDS):
            say(f"round {self.turn + 1}")
            self.candidates = self._candidates(fit)
            base = self._spectrum(fit.with_held(False))
            fit = self._climb(self.scaled(Fit(base, fit.members)))
            names = effect_keys(fit)
            if names == seen or not fit.members:
                break
            seen = names
            fit = relinearise(fit)
        return fit

    def _candidates(self, fit):
        return Candidates(fit.problem, self.library, self.settings, self.forgetful)

    def forward_selection(self):
        """Add the best candidates to the declared columns, joint by joint."""
        fit = reweighted(self.begin())
        self.candidates = self._candidates(fit)
        self.candidates.noise, been = fit, {effect_keys(fit)}
        while (new := self._forward_step(fit, been)) is not None:
            fit = new
            been.add(effect_keys(fit))
        return fit

    def _spectrum(self, fit):
        """Weights by the spectrum of what a model with too many effects leaves."""
        fit, candidates = spectrum_of(fit, self.settings), self.candidates
        for _ in range(self.settings.most):
            added, candidates.noise = [], fit
            for joint, families in candidates.families.items():
                say(f"round {self.turn + 1}, joint {joint + 1} of {self.view.nv}")
                # One is expected of each joint here.
                least = np.log(max(len(families), 1) / self.settings.expected)
                least += candidates.log_prior
                near = [o for o in candidates.on(fit, joint) if o.log_odds > least]
                if self.view.repetition:
                    # What comes again with each phase would all be taken for effects.
                    near = candidates.best_discounted(fit, near)
                best = candidates.most_probable(fit, near)
                if best is not None and best.log_odds > least:
                    one = best.family.member(best.best, self.settings.scale)
                    jumps = isinstance(best.effect, Sudden)
                    added.append(self._member(fit, best) if jumps else one)
            if not added:
                break
            share, fit = fit.base.share, Fit(fit.base, [*fit.members, *added])
            fit = spectrum_of(self.scaled(fit), self.settings, 1, share)
        fit = spectrum_of(fit, self.settings)
        candidates.noise = fit
        return fit.base

    def _climb(self, fit):
        """Add, drop, refine and exchange until nothing is more probable."""
        been, refined, again = {effect_keys(fit)}, frozenset(), True
        # Members and others of their joints beside which nothing is more probable.
        self._compared, held = set(), set()
        while True:
            # What is held judges what is there: much would make up for it.
            new = None if held else self._forward_step(fit, been)
            if new is None and fit.members and effect_keys(fit) != refined:
                # Shapes that were found before the others of their joints were there.
                joints = {joint for _, joint, _ in effect_keys(fit) ^ refined}
                refined = effect_keys(fit)
                new = self._pruned(self.refined(fit, joints))
            elif new is None and self.candidates.rejected and again:
                # What was refused beside another model.
                again = False
                self.candidates.reset()
                continue
            if new is None:
                new = self._exchanged(fit, been)
            if new is None:
                # The fit of the robot has no friction that would drive either.
                new = fit.with_valid_signs(self.settings.known)
                if new is fit:
                    return fit
                new = self._pruned(self.scaled(new))
                pattern = new.problem.held.tobytes(), effect_keys(new)
                if pattern in held:
                    return fit
                if not held:
                    # Models beside other friction.
                    been, self._compared = set(), set()
                held.add(pattern)
            fit = new
            been.add(effect_keys(fit))

    # -- moves ------------------------------------------------------------------------

    def _forward_step(self, fit, been):
        """Add the best candidate of every joint; None if there is none."""
        while chosen := self._next_candidates(fit):
            new = self._with_candidates(fit, chosen)
            again = effect_keys(new) in been
            there = {(m.effect.name, m.effect.joint) for m in new.members}
            for candidate in chosen:
                own = candidate.effect.name, candidate.effect.joint
                if again or own not in there:
                    # What was refused, has gone again, or led back.
                    self.candidates.reject(candidate)
            if not again:
                return new
        return None

    def _next_candidates(self, fit):
        """Candidates that come into the model together."""
        best = self.candidates.best(fit)
        most = np.inf if self.max_effects is None else self.max_effects
        if not best or len(fit.members) >= most:
            return []
        waiting = [self.candidates.is_deferred(fit, o) for o in best]
        if not all(waiting):
            best = [o for o, waits in zip(best, waiting) if not waits]
        best.sort(key=lambda o: -o.order)
        first = best[0]
        # What is far less probable may stand for what the first one lacks.
        best = [o for o in best if o.order > _ODDS_SHARE * first.order]
        if isinstance(first.effect, InModel):
            # The first in precedence of those of the geometry that say the same.
            near = [
                o
                for o in self.candidates.probable()
                if isinstance(o.effect, InModel) and o.order > first.order - _TIE
            ]
            return [min(near, key=lambda o: (o.effect.precedence, -o.order))]
        if isinstance(first.effect, OnAllJoints):
            return [first]
        # What acts on the other joints as well comes alone.
        own = [o for o in best if not isinstance(o.effect, (InModel, OnAllJoints))]
        return own[: int(min(most - len(fit.members), len(own)))]

    def _with_candidates(self, fit, chosen):
        """Return a fit with candidates, without what becomes improbable by that."""
        first = len(fit.members)
        fit = Fit(fit.base, [*fit.members, *(self._member(fit, o) for o in chosen)])
        numbers = range(first, len(fit.members))
        new = self.scaled(gauss_newton(fit, numbers))
        left_out, stands = self.held_out(new), self._remain_probable(new, first)
        # What predicts other motion no better is refused beside this model.
        least = ENTRY_SHARE * self.settings.min_gain
        kept = [i for i in numbers if stands[i - first] and left_out.helps(i, least)]
        if len(kept) < len(chosen):
            members = [*new.members[:first], *(new.members[i] for i in kept)]
            new = self.scaled(Fit(new.base, members))
        for k in range(len(kept)):
            new = self._without_contained(new, first + k)
        return self._pruned(new)

    def _member(self, fit, candidate):
        """Return a candidate as a member."""
        scale = self.settings.scale
        found = best_shape(fit, candidate.effect, scale)
        if found is candidate.effect:
            member = candidate.family.member(candidate.best, scale)
        else:
            member = fit.problem.shaped([found]).member()
        own = fit.groups(member.columns).best_scale(scale)[0]
        return replace(member, scale=float(own))

    def _remain_probable(self, fit, first):
        """Which of the last members remain probable after a refit, a list."""
        # What its first derivative promises need not hold: a gain that is hidden looks
        # like whatever the joint lacks. And bodies take the load from friction that
        # depends on it; of the other members the next round asks that.
        sure = [True] * (len(fit.members) - first)
        asked = [
            i
            for i, m in enumerate(fit.members[first:], first)
            if "load" in m.effect.depends or isinstance(m.effect, InModel)
        ]
        turns = max(
            (1 + isinstance(fit.members[i].effect, InModel) for i in asked), default=0
        )
        for _ in range(turns):
            fit = relinearise(fit)
            odds = self.candidates.log_odds(fit)
            for i in asked:
                natural = fit.members[i].effect.natural(fit.coefficients(i))
                sure[i - first] &= bool(odds[i] > self.candidates.least and natural)
            if not any(sure):
                break
        return sure

    def _without_contained(self, fit, i):
        """Leave out what a member contains if that does as well alone."""
        # Its shape was found beside them, where it stood for what they had left over.
        if i >= len(fit.members):
            return fit
        member = fit.members[i]
        names, joint = closure(member.effect, self.library), member.effect.joint
        rest = [
            m
            for m in fit.members
            if m.effect.joint != joint or m.effect.name not in names
        ]
        if len(rest) == len(fit.members):
            return fit
        base = Fit(fit.base, [m for m in rest if m is not member])
        for family in self.candidates.families[joint]:
            if family.effects[0].name != member.effect.name:
                continue
            candidate = self.candidates.candidate(base, family)
            if candidate is None:
                continue
            alone = base.beside(self._member(base, candidate))
            alone = self.scaled(gauss_newton(alone, [len(base.members)]))
            own, both, none = (
                self.held_out(one).error_of(joint) for one in (alone, fit, base)
            )
            # Most of what both save.
            if own - both <= self.settings.min_gain * (none - both):
                return alone
        return fit

    def _pruned(self, fit):
        """Drop improbable members, the least probable first."""
        while fit.members:
            odds = self.candidates.log_odds(fit)
            i = int(np.argmin(odds))
            if odds[i] > self.candidates.least:
                break
            fit = self.dropped(fit, i)
        return fit

    def dropped(self, fit, i):
        """Return a fit without a member."""
        effect = fit.members[i].effect
        fit = self.scaled(fit.without(i))
        # The robot is not corrected by it any more.
        return relinearise(fit) if isinstance(effect, InModel) else fit

    def refined(self, fit, joints=None):
        """Search the shapes of members again, of all joints or some."""
        shaped = [
            i
            for i, member in enumerate(fit.members)
            if (isinstance(member.effect, (Bank, Sudden)) or member.effect.continuous)
            and (joints is None or member.effect.joint in joints)
        ]
        return self.scaled(search_shapes(fit, shaped, self.settings.scale))

    def scaled(self, fit):
        """Return a fit with the most probable scale of each member."""
        fit = fit.rescaled(self.settings.scale)
        # Banks have no element of negative size.
        for i, member in enumerate(fit.members):
            used = fit.coefficients(i) > 0
            if isinstance(member.effect, Bank) and used.any() and not used.all():
                less = fit.problem.only(member.columns, used)
                return self.scaled(with_shape(fit, i, less.effects[0]))
        return fit

    def _exchanged(self, fit, been):
        """Put what is more probable in the place of a member; None if nothing is."""
        candidates = self.candidates
        odds = candidates.log_odds(fit, usual=True)
        for i in np.argsort(odds):
            member, base = fit.members[i], fit.without(i)
            among = context_key(fit, i)
            if among in self._compared:
                continue
            self._compared.add(among)
            near = [
                o
                for o in candidates.rivals(fit, i)
                if o.log_odds > candidates.least
                and not isinstance(o.effect, InModel)
                and o.effect.key() != member.effect.key()
            ]
            for candidate in near[:3]:
                new = base.beside(self._member(base, candidate))
                new = self.scaled(gauss_newton(new, [len(base.members)]))
                *others, own = candidates.log_odds(new, usual=True)
                # What contains a member takes its place only with that of others, which
                # it makes improbable.
                worst = min([0.0, *others])
                contains = member.effect.name in closure(candidate.effect, self.library)
                if own - worst < odds[i] + _TIE or (contains and worst == 0.0):
                    continue
                new = self._pruned(new)
                better = self.held_out(new).error() <= self.held_out(fit).error()
                if better and effect_keys(new) not in been:
                    return new
        return None

    # -- what is asked of a model ---------------------------------------------------

    def member_odds(self, fit, known):
        """Posterior log odds of each member, with the spectrum that each model has."""
        # What is slow may be noise: without an effect the spectrum takes its place.
        # known: those of members among the same others of their joints, which stay.
        fit, scale = spectrum_of(fit, self.settings), self.settings.scale
        whole, share, found = fit.log_evidence(), fit.base.share, []
        both = zip(fit.members, fit.member_groups, fit.overdispersions(fit))
        for i, (member, groups, excess) in enumerate(both):
            among = context_key(fit, i)
            if among in known:
                found.append(known[among])
                continue
            rounds = 3 if member.effect.slow else 1
            rest = spectrum_of(fit.without(i), self.settings, rounds, share)
            more = float(groups.integrated(scale, member.scale)[0])
            evidence = min(
                float(groups.discounted(excess).evidence(scale)[0]),
                excess.discounted(whole + more - rest.log_evidence(), member.width),
            )
            prior = self.candidates.log_prior - np.log(self.candidates.shapes(member))
            found.append(evidence + prior)
            known[among] = found[-1]
        return np.array(found)

    def held_out(self, fit):
        """Leave out folds of time; see `HeldOut.fitted`."""
        view = fit.problem.view
        if self._held is None or self._held.view is not view:
            self._held = HeldOut(view)
        return self._held.fitted(fit)

    def above_motion(self, fit, effect):
        """Whether a filter of a channel acts above the motion of its joint."""
        v, rate = fit.problem.motion.v[:, effect.joint], 1.0 / self.view.dt
        parts = (v[part] for part in self.view.parts)
        found = [scipy.signal.periodogram(part, rate, detrend=False) for part in parts]
        frequency, power = np.concatenate(found, axis=1)
        order = np.argsort(frequency, kind="stable")
        share = np.cumsum(power[order])
        highest = frequency[order][np.searchsorted(share, _POWER_SHARE * share[-1])]
        return effect.corner > self.settings.above_motion * highest

    def fit_effects(self, effects):
        """Return the most probable model with given effects, on the load they give."""
        fit, scale = self.begin(), self.settings.scale
        for _ in range(_ROUNDS):
            members = [fit.problem.shaped([e]).member(scale=scale) for e in effects]
            fit = relinearise(self.scaled(reweighted(Fit(fit.base, members))))
            effects = [m.effect for m in fit.members]
        return self.scaled(reweighted(fit))


def relinearise(fit):
    """Linearise effects where they are found, correct the robot, take its load."""
    members, coefs = [], [fit.coefficients(i) for i in range(len(fit.members))]
    for member, coef in zip(fit.members, coefs):
        own, columns = member.effect, member.columns
        if own.natural(coef) and (new := own.linearised_at(coef)) is not own:
            known = columns.joints, columns.values, columns.unit, columns.edges
            member = replace(member, columns=Columns([new], *known))
        members.append(member)
    problem, base, theta = fit.problem, fit.base, fit.theta
    view = problem.view.corrected(tuple(m.effect for m in members))
    moved = view is not problem.view
    if moved:
        problem = Problem(view, problem.cosines)
        base = base.on(problem)
        beside = [m for m in members if not isinstance(m.effect, InModel)]
        theta = Fit(base, beside).theta
    both = zip(members, coefs)
    plain = [(m.effect, coef) for m, coef in both if not isinstance(m.effect, InModel)]
    motion = view.motion(
        theta,
        tuple(effect for effect, _ in plain),
        np.concatenate([np.empty(0), *(coef for _, coef in plain)]),
    )
    problem = problem.changed(motion=motion)
    # Columns that neither the load nor the robot has changed stay.
    again = [
        problem.shaped([m.effect]).member(scale=m.scale)
        if moved or "load" in m.effect.needs
        else m
        for m in members
    ]
    return Fit(base.on(problem), again)


def tuned_on(view, effects, settings):
    """Return effects with shapes that suit another recording, tuple of Effect."""
    if not effects:
        return ()
    path = Path(view.with_rest(remembering(effects)), (), settings)
    # In the weights in which the model is fitted to it.
    fit, before = path.fit_effects(effects), -np.inf
    best, most, since = fit, -np.inf, 0
    while since < _PATIENCE:
        fit = reweighted(relinearise(path.refined(fit)))
        now, since = fit.log_evidence(), since + 1
        if now > most + _CONVERGED:
            best, most, since = fit, now, 0
        if abs(now - before) < _CONVERGED:
            best = fit
            break
        before = now
    return tuple(member.effect.completed() for member in best.members)


def remembering(effects):
    """Return the joints whose dry friction has a memory, a set of int."""
    return {effect.joint for effect in effects if isinstance(effect, Bank)}


def context_key(fit, i):
    """Key of a member with those of the others of its joints."""
    joints = fit.members[i].joints
    own = [m.effect.key() for m in fit.members if m.joints == joints]
    return fit.members[i].effect.key(), frozenset(own)


def effect_keys(fit):
    """Keys of a fit's effects, a frozenset."""
    return frozenset(m.effect.key() for m in fit.members)
