"""Stepwise search for the most probable model: add, refine, drop, exchange effects."""

from dataclasses import replace

import numpy as np
import scipy

from sklearn_vbjfa._core._runtime import say
from sklearn_vbjfa.diagnosis.search._candidates import Candidates
from sklearn_vbjfa.diagnosis.search._held_out import HeldOut, HeldOutFit
from sklearn_vbjfa.diagnosis.search._problem import (
    Columns,
    Fit,
    Problem,
    fit_uniform,
    spectral_fit,
    spectrum_of,
    with_joint_weights,
)
from sklearn_vbjfa.diagnosis.search._refine import (
    best_shape,
    search_shapes,
    step_shapes,
    with_shape,
)
from sklearn_vbjfa.effects import Bank, InModel, OnAllJoints, Sudden, closure
from sklearn_vbjfa.equations._plan import joints_at_rest
from sklearn_vbjfa.fit._bodies import DESCRIBED
from sklearn_vbjfa.model import nominal_parameters
from sklearn_vbjfa.robot._posterior import body_indices

# Rounds of the search; each updates load, noise spectrum and geometry.
_ROUNDS = 2
# Shapes are refitted until the log evidence changes by less than this [nats], or for so
# many iterations without improvement, as load and shapes may alternate.
_CONVERGED, _PATIENCE = 2.0, 4
# Share of the motion's power below its highest frequency.
_POWER_SHARE = 0.9
# Candidates above this share of the largest log odds are added in the same step.
_ODDS_SHARE = 0.2
# Effects in the model need this share of the gain that reported ones need.
ENTRY_SHARE = 0.5
# Log odds within which effects count as equivalent [nats].
_TIE = 0.5
# Geometric effects with this share of the largest log odds may be equivalent to it.
_SIMILAR = 0.9


class StepwiseSearch:
    """Search for the most probable set of effects, at most `max_effects`."""

    # library: effects to try on every joint.

    def __init__(self, view, library, settings, max_effects=None):
        self.view, self.library, self.settings = view, library, settings
        self.max_effects, self._held_out = max_effects, None

    # -- search -----------------------------------------------------------------------

    def fit_declared(self):
        """Fit the declared columns alone, and compute the load from that fit."""
        fit = fit_uniform(Problem(self.view), self.view.precision)
        problem = fit.problem.changed(motion=self.view.motion(fit.theta))
        return Fit(fit.base.on(problem))

    def run(self):
        """Run the search and return the final `Fit`."""
        fit, previous = self.fit_declared(), None
        for k in range(_ROUNDS):
            say(f"round {k + 1}")
            self.candidates = Candidates(fit.problem, self.library, self.settings)
            fit = noise = spectrum_of(fit.with_zeros(False), self.settings)
            if previous is None:
                noise = self._with_many_effects(fit)
            self.candidates.noise = noise
            fit = self._climb(self.scaled(Fit(noise.base, fit.members)))
            keys = effect_keys(fit)
            if keys == previous or not fit.members:
                break
            previous = keys
            fit = relinearise(fit)
        return fit

    def forward_selection(self):
        """Add the best candidates to the declared columns, joint by joint."""
        fit = with_joint_weights(self.fit_declared())
        self.candidates = Candidates(fit.problem, self.library, self.settings)
        self.candidates.noise, visited = fit, {effect_keys(fit)}
        while (new := self._forward_step(fit, visited)) is not None:
            fit = new
            visited.add(effect_keys(fit))
        return fit

    def _with_many_effects(self, fit):
        """Add too many effects, so that the residual is noise."""
        candidates = self.candidates
        for _ in range(self.settings.most):
            # Unmodelled torque that repeats would resemble many effects.
            added, candidates.noise = [], fit if self.view.repetition else None
            for joint, columns in candidates.columns.items():
                say(f"noise, joint {joint + 1} of {self.view.nv}")
                # Prior of `expected` effects on each joint.
                least = np.log(max(len(columns), 1) / self.settings.expected)
                least += candidates.log_prior
                probable = [c for c in candidates.on(fit, joint) if c.log_odds > least]
                best = candidates.best_discounted(fit, probable)[:1]
                if best and best[0].log_odds > least:
                    best = best[0]
                    member = best.columns.member(best.best, self.settings.scale)
                    is_jump = isinstance(best.effect, Sudden)
                    added.append(self._member(fit, best) if is_jump else member)
            if not added:
                break
            share, fit = fit.base.share, Fit(fit.base, [*fit.members, *added])
            fit = spectral_fit(self.scaled(fit), self.settings, share, rounds=1)
        return spectrum_of(fit, self.settings)

    def _climb(self, fit):
        """Add, drop, refine and exchange until nothing is more probable."""
        visited, refined = {effect_keys(fit)}, frozenset()
        # `context_key` of members for which no exchange is more probable.
        self._compared, patterns = set(), set()
        while True:
            # Many candidates would compensate for friction that is fixed at zero.
            new = None if patterns else self._forward_step(fit, visited)
            if new is None and fit.members and effect_keys(fit) != refined:
                # Shapes were fitted without later members of the same joints.
                joints = {joint for _, joint, _ in effect_keys(fit) ^ refined}
                refined = effect_keys(fit)
                new = self._pruned(self.refined(fit, joints))
            if new is None:
                new = self._exchanged(fit, visited)
            if new is None:
                # As in the robot's fit, declared friction must dissipate energy.
                new = fit.with_valid_signs(self.settings.known)
                if new is fit:
                    return fit
                new = self._pruned(self.scaled(new))
                pattern = new.problem.at_zero.tobytes(), effect_keys(new)
                if pattern in patterns:
                    return fit
                if not patterns:
                    # Earlier models had other friction terms.
                    visited, self._compared = set(), set()
                patterns.add(pattern)
            fit = new
            visited.add(effect_keys(fit))

    # -- moves ------------------------------------------------------------------------

    def _forward_step(self, fit, visited):
        """Add the best candidate of each joint; None if there is none."""
        while candidates := self._next_candidates(fit):
            new = self._with_candidates(fit, candidates)
            revisited = effect_keys(new) in visited
            present = {(m.effect.name, m.effect.joint) for m in new.members}
            for candidate in candidates:
                key = candidate.effect.name, candidate.effect.joint
                if revisited or key not in present:
                    # It was rejected or dropped, or led to an earlier model.
                    self.candidates.reject(candidate)
            if not revisited:
                return new
        return None

    def _next_candidates(self, fit):
        """Select the candidates to add in one step."""
        best = self.candidates.best(fit)
        most = np.inf if self.max_effects is None else self.max_effects
        if not best or len(fit.members) >= most:
            return []
        deferred = [self.candidates.is_deferred(fit, c) for c in best]
        if not all(deferred):
            best = [c for c, is_deferred in zip(best, deferred) if not is_deferred]
        best.sort(key=lambda c: -c.usual_odds)
        first = best[0]
        # Much less probable candidates may only compensate for the first one.
        best = [c for c in best if c.usual_odds > _ODDS_SHARE * first.usual_odds]
        if isinstance(first.effect, InModel):
            return [self._simplest_geometry(fit, first)]
        if isinstance(first.effect, OnAllJoints):
            return [first]
        # Effects on all joints are added one at a time.
        single = [c for c in best if not isinstance(c.effect, (InModel, OnAllJoints))]
        return single[: int(min(most - len(fit.members), len(single)))]

    def _simplest_geometry(self, fit, first):
        """Return the first in precedence of equivalent geometric effects."""
        similar = [
            c
            for c in self.candidates.probable()
            if isinstance(c.effect, InModel)
            and c.usual_odds > _SIMILAR * first.usual_odds
        ]
        if len(similar) == 1:
            return first
        # Large corrections differ in the second order: compare their exact models.
        evidence = []
        for candidate in similar:
            new = fit.with_member(self._member(fit, candidate))
            for _ in range(_ROUNDS):
                new = self.scaled(relinearise(new))
            evidence.append(new.log_evidence() + _log_prior_of_size(new))
        pairs = [(c, x) for c, x in zip(similar, evidence) if x > max(evidence) - _TIE]
        return min(pairs, key=lambda pair: (pair[0].effect.precedence, -pair[1]))[0]

    def _with_candidates(self, fit, candidates):
        """Add candidates to a fit and drop members that become improbable."""
        first = len(fit.members)
        fit = Fit(fit.base, [*fit.members, *(self._member(fit, c) for c in candidates)])
        added = range(first, len(fit.members))
        new = self.scaled(step_shapes(fit, added))
        validation, (probable, updated) = self.validate(new), self._updated(new, first)
        # New members must reduce the cross-validated error.
        least = ENTRY_SHARE * self.settings.min_gain
        kept = [i for i in added if probable[i - first] and validation.helps(i, least)]
        if len(kept) < len(candidates):
            members = [*new.members[:first], *(new.members[i] for i in kept)]
            new = self.scaled(Fit(new.base, members))
        elif isinstance(candidates[0].effect, InModel):
            # Terms of second order would resemble further effects.
            new = updated
        for k in range(len(kept)):
            new = self._without_similar(new, first + k)
        return self._pruned(new)

    def _member(self, fit, candidate):
        """Return a candidate with its best shape and scale as a member."""
        scale = self.settings.scale
        effect = best_shape(fit, candidate.effect, scale)
        if effect is candidate.effect:
            member = candidate.columns.member(candidate.best, scale)
        else:
            member = fit.problem.columns([effect]).member()
        best = fit.groups(member.columns).best_scale(scale)[0]
        return replace(member, scale=float(best))

    def _updated(self, fit, first):
        """Return which members from `first` on remain probable after an update."""
        # Also returns the updated fit. Linearised effects may fail at their full size:
        # the derivative by a poorly identifiable gain resembles any missing effect. The
        # bodies may take over the torque of load-dependent friction. The next round
        # checks other members.
        probable = [True] * (len(fit.members) - first)
        tested = [
            i
            for i, m in enumerate(fit.members[first:], first)
            if "load" in m.effect.depends or isinstance(m.effect, InModel)
        ]
        is_geometric = any(isinstance(fit.members[i].effect, InModel) for i in tested)
        for _ in range(_ROUNDS if is_geometric else len(tested[:1])):
            fit = self.scaled(relinearise(fit))
            odds = self.candidates.log_odds(fit)
            for i in tested:
                natural = fit.members[i].effect.natural(fit.coefficients(i))
                probable[i - first] &= bool(odds[i] > self.candidates.least and natural)
            if not any(probable):
                break
        return probable, fit

    def _without_similar(self, fit, i):
        """Drop effects like a member if it does as well without them."""
        # Its shape was fitted to the residual of these effects: those that it contains,
        # and those that depend on the same.
        if i >= len(fit.members):
            return fit
        member = fit.members[i]
        names, joint = closure(member.effect, self.library), member.effect.joint
        depends = member.effect.depends
        others = [m for m in fit.members if m is not member]
        similar = [
            m
            for m in others
            if m.effect.joint == joint
            and (m.effect.name in names or (depends and m.effect.depends == depends))
        ]
        if not similar:
            return fit
        contained = all(m.effect.name in names for m in similar)
        base = Fit(fit.base, [m for m in others if m not in similar])
        for columns in self.candidates.columns[joint]:
            if columns.effects[0].name != member.effect.name:
                continue
            candidate = self.candidates.candidate(base, columns)
            if candidate is None:
                continue
            alone = base.with_member(self._member(base, candidate))
            alone = self.scaled(step_shapes(alone, [len(base.members)]))
            alone_error, error, base_error = (
                self.validate(model).error_of(joint) for model in (alone, fit, base)
            )
            # Alone it must save nearly as much as together with what it contains, else
            # as much.
            tolerance = self.settings.min_gain * contained
            if alone_error - error <= tolerance * (base_error - error):
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
        """Drop a member."""
        effect = fit.members[i].effect
        fit = self.scaled(fit.without(i))
        # Undo its correction of the robot.
        return relinearise(fit) if isinstance(effect, InModel) else fit

    def refined(self, fit, joints=None):
        """Refit the shapes of members, on all joints or some."""
        indices = [
            i
            for i, member in enumerate(fit.members)
            if joints is None or member.effect.joint in joints
        ]
        return self.scaled(search_shapes(fit, indices, self.settings.scale))

    def scaled(self, fit):
        """Set the most probable prior scale of each member."""
        scale = self.settings.scale
        scales = (float(groups.best_scale(scale)[0]) for groups in fit.member_groups)
        members = [replace(m, scale=x) for m, x in zip(fit.members, scales)]
        fit = Fit(fit.base, members)
        # Elements of banks have positive coefficients.
        for i, member in enumerate(fit.members):
            used = fit.coefficients(i) > 0
            if isinstance(member.effect, Bank) and used.any() and not used.all():
                return self.scaled(with_shape(fit, i, member.effect.only(used)))
        return fit

    def _exchanged(self, fit, visited):
        """Replace a member by a more probable candidate; None if there is none."""
        candidates = self.candidates
        odds = candidates.log_odds(fit, usual=True)
        for i in np.argsort(odds):
            member, base = fit.members[i], fit.without(i)
            key = context_key(fit, i)
            if key in self._compared:
                continue
            self._compared.add(key)
            rivals = [
                c
                for c in candidates.rivals(fit, i)
                if c.log_odds > candidates.least
                and not isinstance(c.effect, InModel)
                and c.effect.key() != member.effect.key()
            ]
            for candidate in rivals[:3]:
                new = base.with_member(self._member(base, candidate))
                new = self.scaled(step_shapes(new, [len(base.members)]))
                *others, new_odds = candidates.log_odds(new, usual=True)
                # A candidate that contains the member must replace others, too; fewer
                # effects need not be better.
                worst = min([0.0, *others])
                contains = member.effect.name in closure(candidate.effect, self.library)
                same = candidate.effect.name == member.effect.name
                simpler = same and candidate.effect.simple > member.effect.simple
                tie = self.settings.rivals if simpler else _TIE if contains else -_TIE
                if new_odds - worst < odds[i] - tie or (contains and worst == 0.0):
                    continue
                new = self._pruned(new)
                limit = self.validate(fit).error() + max(tie, 0.0)
                better = simpler or self.validate(new).error() <= limit
                if better and effect_keys(new) not in visited:
                    return new
        return None

    # -- evaluation -------------------------------------------------------------------

    def refitted_odds(self, fit, cache):
        """Compute log odds of members, refitting the spectrum without each of them."""
        # Slow effects compete with coloured noise. cache: log odds by `context_key`.
        fit, scale = spectrum_of(fit, self.settings), self.settings.scale
        total, share, log_odds = fit.log_evidence(), fit.base.share, []
        rows = zip(fit.members, fit.member_groups, fit.overdispersions(fit))
        for i, (member, groups, overdispersion) in enumerate(rows):
            key = context_key(fit, i)
            if key in cache:
                log_odds.append(cache[key])
                continue
            rounds = 3 if member.effect.slow else 1
            reduced = spectral_fit(fit.without(i), self.settings, share, rounds)
            gain = total + float(groups.integrated(scale, member.scale)[0])
            gain -= reduced.log_evidence()
            evidence = min(
                float(groups.discounted(overdispersion).evidence(scale)[0]),
                overdispersion.discounted(gain, member.width),
            )
            prior = self.candidates.log_prior - np.log(self.candidates.shapes(member))
            log_odds.append(evidence + prior)
            cache[key] = log_odds[-1]
        return np.array(log_odds)

    def validate(self, fit):
        """Cross-validate a fit, `HeldOutFit`."""
        view = fit.problem.view
        if self._held_out is None or self._held_out.view is not view:
            self._held_out = HeldOut(view)
        return HeldOutFit(self._held_out, fit)

    def above_motion(self, fit, effect):
        """Check whether a channel filter's corner is above the motion's frequencies."""
        v, rate = fit.problem.motion.v[:, effect.joint], 1.0 / self.view.dt
        parts = (v[part] for part in self.view.parts)
        psd = [scipy.signal.periodogram(part, rate, detrend=False) for part in parts]
        frequency, power = np.concatenate(psd, axis=1)
        order = np.argsort(frequency, kind="stable")
        share = np.cumsum(power[order])
        highest = frequency[order][np.searchsorted(share, _POWER_SHARE * share[-1])]
        return effect.corner > self.settings.above_motion * highest

    def fit_effects(self, effects):
        """Fit a model with given effects, including the load that they imply."""
        fit, scale = self.fit_declared(), self.settings.scale
        for _ in range(_ROUNDS):
            members = [fit.problem.columns([e]).member(scale=scale) for e in effects]
            fit = relinearise(self.scaled(with_joint_weights(Fit(fit.base, members))))
            effects = [m.effect for m in fit.members]
        return self.scaled(with_joint_weights(fit))


def _log_prior_of_size(fit):
    """Return the log prior of the common size of the bodies over the described one."""
    # A Cauchy prior of the logarithm. Gains of two joints may differ in the size only.
    view, theta = fit.problem.view, fit.problem.view.back @ fit.theta
    bodies, at = np.zeros((2, theta.size)), body_indices(view.robot)[: view.nv]
    bodies[:, at] = theta[at], nominal_parameters(view.robot.features_.nominal_)
    scale = view.root * np.sqrt(view.precision)
    fitted, described = (view.equations.torques(x) * scale for x in bodies)
    size, norm = (fitted * described).sum(), (described**2).sum()
    return -np.log1p((np.log(size / norm) / DESCRIBED) ** 2) if size > 0 else 0.0


def relinearise(fit):
    """Linearise effects at their estimates, correct the robot and update the load."""
    members, coefs = [], [fit.coefficients(i) for i in range(len(fit.members))]
    for member, coef in zip(fit.members, coefs):
        effect, columns = member.effect, member.columns
        if effect.natural(coef) and (new := effect.linearised_at(coef)) is not effect:
            unchanged = columns.joints, columns.values, columns.unit, columns.edges
            member = replace(member, columns=Columns([new], *unchanged))
        members.append(member)
    linear = [i for i, m in enumerate(members) if not isinstance(m.effect, InModel)]
    problem, base, theta = fit.problem, fit.base, fit.theta
    view = problem.view.corrected(tuple(m.effect for m in members))
    corrected = view is not problem.view
    if corrected:
        problem = Problem(view, problem.cosines)
        base = base.on(problem)
        theta = Fit(base, [members[i] for i in linear]).theta
    motion = view.motion(
        theta,
        [members[i].effect for i in linear],
        np.concatenate([np.empty(0), *(coefs[i] for i in linear)]),
    )
    problem = problem.changed(motion=motion)
    # Columns change with the load or the robot only.
    updated = [
        problem.columns([m.effect]).member(scale=m.scale)
        if corrected or "load" in m.effect.needs
        else m
        for m in members
    ]
    return Fit(base.on(problem), updated)


def tune_shapes(view, effects, settings):
    """Refit the shapes of effects to another recording, tuple of Effect."""
    if not effects:
        return ()
    stepwise = StepwiseSearch(view.with_rest(joints_at_rest(effects)), (), settings)
    # One weight per joint, as in the fit of the robot.
    fit, previous = stepwise.fit_effects(effects), -np.inf
    best, most, stalled = fit, -np.inf, 0
    while stalled < _PATIENCE:
        fit = with_joint_weights(relinearise(stepwise.refined(fit)))
        evidence, stalled = fit.log_evidence(), stalled + 1
        if evidence > most + _CONVERGED:
            best, most, stalled = fit, evidence, 0
        if abs(evidence - previous) < _CONVERGED:
            best = fit
            break
        previous = evidence
    return tuple(member.effect.completed() for member in best.members)


def context_key(fit, i):
    """Return the keys of a member and of all members on the same joints."""
    joints = fit.members[i].joints
    keys = [m.effect.key() for m in fit.members if m.joints == joints]
    return fit.members[i].effect.key(), frozenset(keys)


def effect_keys(fit):
    """Return the keys of a fit's effects, a frozenset."""
    return frozenset(m.effect.key() for m in fit.members)
