"""The search for effects that a model lacks: add, refine, prune, replace, withdraw."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._common_start import earned
from sklearn_vbjfa.diagnosis.search._evidence import (
    SMALLEST_GAIN,
    Candidate,
    Rule,
    Step,
    compare,
    no_worse,
)
from sklearn_vbjfa.diagnosis.search._model import Judge, SearchModel
from sklearn_vbjfa.diagnosis.search._shapes import (
    refined,
    retuned,
    tuned_before,
    tuned_family,
)
from sklearn_vbjfa.diagnosis.search._transfer import Transfer
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.effects._library import closure

# A joint whose out-of-sample error is within this factor of its noise floor lacks
# nothing that could be named.
AT_FLOOR = 1.15
# An effect stays as long as leaving it out would cost this share of the error.
_SUPERFLUOUS = 0.01
# What is found must hold beyond the data that it was found in: fitted to this first
# share of the blocks it is tried on the rest.
_FORWARD = 0.75
# What begins late is fitted to this first share of where it acts.
_LATE = 0.5
# What changes slowly acts in blocks that have this share of its largest power.
_FADED = 0.01
# Blocks on either side of that border in which it acts, at the least: fewer cannot tell
# it from chance.
_ACTIVE = 3
# A plain effect that saves this share of what one that contains it saves goes first.
_CONTAINED = 0.5
# Effects of one kind on one joint, with different settings (drift of this and that).
_MOST_ROUNDS_PER_JOINT = 6

# Rules by which a step is taken, as they are reported.
STEP_UP = "Benjamini-Hochberg over the candidates of the round"
CONTAINED = "plainer than a candidate that passed, and saves most of what it does"
LATER = "an effect of time must help on later data"
TOO_LATE = "acts in too few blocks to be tried on later data"
HARM = "does harm on later data, beyond one standard error"
SUPERFLUOUS = "leaving it out costs no more than chance, or less than 1 %"
MOST = "fewer effects were asked for"
UNNATURAL = "took a sign that it cannot have"
ELSEWHERE = "does harm on motion that it was not fitted to"
BETTER = "better than what it replaces"
SIMPLER = "simpler than what it replaces, and no worse"


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """What a search found.

    Attributes
    ----------
    model : SearchModel
        The declared model with the accepted effects.
    evidence : tuple of Evidence
        For each accepted effect, what leaving it out would cost.
    steps : tuple of Step
        What was added, replaced, dropped, refused or withdrawn.
    threshold : float
        Level of significance of the last round.
    n_tests : int
        Tests among which it was shared out; 0 if nothing was tried.
    library : tuple of Effect
        Effects that were tried on every joint.
    """

    model: SearchModel
    evidence: tuple
    steps: tuple
    threshold: float
    n_tests: int
    library: tuple

    @property
    def effects(self):
        """Accepted effects, tuple of Effect."""
        return self.model.effects


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """An accepted effect beside the others, its shape chosen inside each fold.

    Attributes
    ----------
    base : SearchModel
        The others with the ridge that suits them.
    beside : SearchModel
        The same, or with the ridge of the whole model, if the effect does better
        beside that: either may hide the one or the other in the others' span.
    squares : ndarray of shape (n_blocks, nv)
        Squared out-of-sample residuals with the effect.
    columns : ndarray of shape (nj, m, c, k)
        Columns of its shapes.
    """

    base: SearchModel
    beside: SearchModel
    squares: np.ndarray
    columns: np.ndarray

    @classmethod
    def of(cls, effect, model):
        """Score an effect of a model beside the others."""
        joints, columns = model.view.joints_of(effect), tuned_family(effect, model)
        rest = model.without(effect)
        bases = [model.beside(rest, ridge) for ridge in (None, "same")]
        scores = [base.fitted.score(joints, columns).squares for base in bases]
        best = int(np.argmin([(s @ model.precision).sum() for s in scores]))
        return cls(
            base=bases[0], beside=bases[best], squares=scores[best], columns=columns
        )


def candidates_of(joint, library, model):
    """Effects of a library that can be looked for on a joint, list of Effect."""
    found = [clone(effect).set_params(joint=joint) for effect in library]
    declared, motion = model.view.declared, model.motion
    return [e for e in found if e.name not in declared and not e.applies(motion)]


@dataclass(kw_only=True, eq=False)
class EffectSearch:
    """Greedy search with pruning, from the second moments of blocks of time.

    Attributes
    ----------
    view : RecordingView
        Recording.
    library : tuple of Effect
        Effects to try, on every joint.
    alpha : float
        Level of significance, over all candidates on all joints.
    max_effects : int or None
        Most effects to accept.
    on_progress : callable or None
        Called with (round, text).
    model : SearchModel or None
        The model as it is now; None before the first fit.
    steps : list of Step
        What was done.
    refused : set
        Keys of effects that did not hold on later data, beside the model as it is.
    refusals : dict
        How often each effect was refused, by its key.
    threshold, n_tests : float and int
        Level of the last round, and among how many tests it was shared out.
    """

    view: RecordingView
    library: tuple
    alpha: float
    max_effects: int | None = None
    on_progress: Callable | None = None
    model: SearchModel | None = None
    steps: list = field(default_factory=list)
    refused: set = field(default_factory=set)
    refusals: dict = field(default_factory=dict)
    threshold: float | None = None
    n_tests: int = 0

    def __post_init__(self):
        if self.threshold is None:
            self.threshold = self.alpha

    # -- the loop -------------------------------------------------------------------

    def run(self):
        """Search from the declared model, and return what was `Found`."""
        self.explore()
        return self.settle()

    def resume(self, names, found):
        """Go on from a search beside plain terms of these names: what was `Found`."""
        self.model, self.steps = earned(
            self.view, names, found, self.library, self.alpha
        )
        self.steps += found.steps
        self.threshold, self.n_tests = found.threshold, found.n_tests
        self.prune()
        return self.settle()

    def settle(self):
        """Keep what also holds elsewhere, as much as is wanted: what was `Found`."""
        self.withdraw()
        self._limit()
        return self.found()

    def explore(self):
        """Search until nothing is significant."""
        self.accept(())
        number, most = 0, _MOST_ROUNDS_PER_JOINT * self.view.nv
        found = True
        while found:
            while number < most and not self._is_full() and self._round(number):
                number += 1
            found = False
            if self.model.effects:
                self._polish()
                # What was hidden by shapes that were not yet tuned may show now.
                if number < most and not self._is_full():
                    found = self._round(number)
                    number += 1

    def found(self):
        """Return what is `Found` as it is now."""
        return Found(
            model=self.model,
            evidence=tuple(self.evidence_of(effect) for effect in self.model.effects),
            steps=tuple(self.steps),
            threshold=self.threshold,
            n_tests=self.n_tests,
            library=self.library,
        )

    def accept(self, effects):
        """Take effects for what the declared model lacks."""
        self.model = SearchModel.of(self.view, effects, self.model)

    def _is_full(self):
        """Whether as many effects are accepted as may be."""
        return (
            self.max_effects is not None and len(self.model.effects) >= self.max_effects
        )

    def _round(self, number):
        """Add or refuse one effect; whether there was one."""
        model = self.model
        quiet = self.at_floor(model.squares) | (model.precision == 0)
        tried = {}
        for joint in range(self.view.nv):
            if self.on_progress is not None:
                self.on_progress(number, f"joint {joint + 1} of {self.view.nv}")
            if model.precision[joint] > 0 and not quiet.all():
                tried[joint], _ = self.try_joint(joint, model, quiet[joint])
        self._set_threshold(tried)
        gain = _weighted_gain(model)
        offers = []
        for joint, candidates in tried.items():
            found, others = self.eligible(candidates, joint, model.effects)
            if found:
                chosen, rivals = self.best_of(found, others)
                offers.append((gain(chosen), chosen, rivals, others))
        if not offers:
            return False
        _, chosen, rivals, others = max(offers, key=lambda offer: offer[0])
        effect = refined(chosen.effect, model)
        case, refusal = self._later(effect, model)
        if refusal is not None:
            self._refuse(effect, case, rivals, others, refusal)
            return True
        # Beside another model they may hold.
        self.refused.clear()
        self._step(
            "add",
            effect,
            [*model.effects, effect],
            evidence=chosen.evidence,
            rivals=rivals,
            tried=others,
            rule=self._rule(chosen),
        )
        self.prune(effect)
        self.model = retuned(self.model, effect.joint)
        self.compete(effect.joint)
        return True

    def _step(self, action, effect, effects, *, rivals=(), tried=(), **given):
        """Go on to a model with other effects, and note it."""
        before = self.model.squares.sum(axis=0)
        if effects is not None:
            self.accept(effects)
        self.steps.append(
            Step(
                action=action,
                effect=effect,
                rivals=tuple(rivals),
                tried=tuple(sorted(tried, key=lambda c: -c.evidence.gain)),
                squares_before=before,
                squares_after=self.model.squares.sum(axis=0),
                **given,
            )
        )

    def _refuse(self, effect, case, rivals, tried, rule):
        """Note that an effect does not hold; every trial counts, see `_evidence`."""
        self.refused.add(effect.key())
        self.refusals[effect.key()] = self.refusals.get(effect.key(), 0) + 1
        self._step(
            "refuse",
            effect,
            None,
            evidence=case,
            rivals=rivals,
            tried=tried,
            rule=rule,
        )

    def at_floor(self, squares):
        """Joints whose error noise alone explains."""
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = squares.sum(axis=0) / self.view.rows
        return mean < AT_FLOOR**2 * self.view.floor

    # -- candidates -----------------------------------------------------------------

    def candidates_of(self, joint):
        """Effects of the library on a joint that can be looked for."""
        return candidates_of(joint, self.library, self.model)

    def score(self, effect, base):
        """Try an effect beside a model: a Candidate, and its family's columns.

        None of both if there is nothing new. The evidence has no p-value yet.
        """
        taken = {e.key() for e in base.effects} | self.refused
        family = base.family(effect).where(lambda one: one.key() not in taken)
        if not family.effects:
            return None, None
        score = base.fitted.score(self.view.joints_of(effect), family.columns)
        best = family.effects[score.best]
        if not best.plausible(score.coef):
            return None, None
        evidence = compare(*base.relevant(effect, base.squares, score.squares))
        candidate = Candidate(
            effect=best,
            evidence=replace(evidence, p_value=1.0),
            squares=score.squares,
            white=score.squares * base.precision,
        )
        return candidate, family.columns

    def try_joint(self, joint, base, quiet=False):
        """Try all effects on a joint beside a model, name -> Candidate, plainer first.

        All are judged on rows from which the memory is taken out that the residual has
        with the best of them; the `Judge` is returned as well, None if none is worth a
        name. A quiet joint lacks nothing of its own, but may be where something acts
        that others feel.
        """
        everything = self.candidates_of(joint)
        if quiet:
            everything = [effect for effect in everything if effect.whole_robot]
        tried, columns = {}, {}
        for effect in sorted(everything, key=lambda e: len(closure(e, everything))):
            candidate, own = self.score(effect, base)
            if candidate is not None:
                tried[effect.name], columns[effect.name] = candidate, own
        worth = [n for n, c in tried.items() if c.evidence.gain >= SMALLEST_GAIN]
        if not worth:
            return tried, None
        best = max((tried[name] for name in worth), key=_weighted_gain(base))
        larger = self.model.beside([*base.effects, best.effect])
        judge = Judge(base, larger.residuals())
        for name in worth:
            one = tried[name]
            white = judge.score(self.view.joints_of(one.effect), columns[name])
            evidence = self._evidence(
                one.effect, (base.squares, one.squares), (judge.squares, white)
            )
            tried[name] = replace(one, white=white, evidence=evidence)
        return tried, judge

    def eligible(self, tried, joint, accepted):
        """Candidates that may be added to a joint, and all that beat chance.

        An effect that contains a plainer one which explains most of what it explains
        itself would win by that alone. The plain one is offered in its place; the
        other may come in a later round, beside it.
        """
        present = set(self.view.declared) | {
            e.name for e in accepted if e.joint == joint
        }
        library = [candidate.effect for candidate in tried.values()]
        significant = [
            c for c in tried.values() if c.evidence.significant(self.threshold)
        ]
        found = {}
        for candidate in significant:
            plain = [
                tried[name]
                for name in closure(candidate.effect, library) - present
                if name in tried
                and tried[name].evidence.significant(self.alpha)
                and tried[name].evidence.gain > _CONTAINED * candidate.evidence.gain
            ]
            offered = max(plain, key=lambda c: c.evidence.gain, default=candidate)
            found[id(offered)] = offered
        return list(found.values()), significant

    def best_of(self, candidates, others):
        """Return the simplest of the best candidates, and all that compare with it.

        Among `others`, all that beat chance, those that contain the chosen one and
        explain no more are its rivals as well.
        """
        everything = list({id(c): c for c in [*candidates, *others]}.values())
        whole = any(c.effect.whole_robot for c in everything)
        joint = candidates[0].effect.joint
        error = {
            id(c): c.white.sum(axis=1) if whole else c.white[:, joint]
            for c in everything
        }
        best = min(candidates, key=lambda c: error[id(c)].sum())
        close = [c for c in candidates if no_worse(error[id(best)], error[id(c)])]
        simplest = min(close, key=lambda c: (c.effect.complexity, error[id(c)].sum()))
        rivals = tuple(
            c
            for c in everything
            if c is not simplest and no_worse(error[id(best)], error[id(c)])
        )
        return simplest, rivals

    # -- levels ---------------------------------------------------------------------

    def _set_threshold(self, tried):
        """Set the level of this round, after Benjamini and Hochberg.

        On a robot that lacks nothing it is Bonferroni's: one false alarm in 1 / alpha
        recordings. On one that lacks much, a short recording could not reach that
        level for any effect. Only the best effect is added, so that a level that many
        true ones have raised falls again before a false one is the best.
        """
        p_values = np.sort(
            [c.evidence.p_value for t in tried.values() for c in t.values()]
        )
        if p_values.size == 0:
            return
        self.n_tests = m = p_values.size
        rank = np.arange(1, m + 1)
        passing = rank[p_values <= self.alpha * rank / m]
        self.threshold = self.alpha / m * max(int(passing.max(initial=1)), 1)

    def _rule(self, candidate):
        """Rule by which a candidate is added in this round."""
        if candidate.evidence.significant(self.threshold):
            return Rule(name=STEP_UP, level=self.threshold, n_tests=self.n_tests)
        return self._one_test(CONTAINED)

    def _one_test(self, name):
        return Rule(name=name, level=self.alpha, n_tests=1)

    # -- evidence -------------------------------------------------------------------

    def _evidence(self, effect, squares, white):
        """Evidence for a change on an effect's joint, p-value from whitened rows.

        Each time that the effect was refused before doubles it.
        """
        if effect.whole_robot:
            white = [s.sum(axis=1) for s in white]
        else:
            white = [s[:, effect.joint] for s in white]
        evidence = compare(*self.model.relevant(effect, *squares), white=white)
        trials = 2.0 ** self.refusals.get(effect.key(), 0)
        return replace(evidence, p_value=min(1.0, trials * evidence.p_value))

    def evidence_of(self, effect):
        """Evidence for an accepted effect: what leaving it out would cost.

        Its shape is chosen inside each fold, so that what was tuned on all rows is
        not judged on them.
        """
        place, residual = Place.of(effect, self.model), self.model.residuals()
        judge = Judge(place.base, residual)
        before = judge.squares
        if place.beside is not place.base:
            judge = Judge(place.beside, residual)
        white = judge.score(self.view.joints_of(effect), place.columns)
        return self._evidence(
            effect, (place.base.squares, place.squares), (before, white)
        )

    def _later(self, effect, base):
        """Try an effect on later data: Evidence, and the Rule that refuses it or None.

        Both models are fitted and judged in rows without the residual's memory: slow
        noise that goes on from where it was would decide otherwise.
        """
        view = self.view
        joints, own = view.joints_of(effect), base.columns_of(effect)
        # Of the little that is later, all that is independent has to count.
        blocks = view.blocks.divided(max(1.0 / view.robot.cutoff_, view.step))
        power = blocks.sums((own**2).sum(axis=(0, 2)))
        acts = power > (_FADED * power.max() if effect.slow else 0.0)
        where = np.flatnonzero(acts)
        if where.size < 2 * _ACTIVE:
            nothing = np.zeros(1)
            return compare(nothing, nothing), Rule(name=TOO_LATE)
        border = where[int(_FORWARD * where.size)]
        late = where[0] > 0.5 * border
        if late:
            # It has to be fitted where it acts, and tried there as well.
            border = where[int(_LATE * where.size)]
        larger = self.model.beside([*base.effects, effect])
        judge = Judge(base, larger.residuals())
        if effect.slow or late:
            early = blocks.label < border
            own = base.columns_of(tuned_before(effect, base, early))
        squares = judge.forward(joints, own, blocks, border)
        if effect.slow:
            # Where it has faded it cannot be tried: all it does there is to leave
            # other parameters alone.
            squares = [s[acts[border:]] for s in squares]
        if not effect.whole_robot:
            squares = [s[:, [effect.joint]] for s in squares]
        case = compare(*(s.sum(axis=1) for s in squares))
        if effect.slow or late:
            # Whatever changes slowly can be fitted by a function of time, and
            # whatever happened once by what begins late.
            if case.gain > 0 and case.p_value < self.alpha:
                return case, None
            return case, self._one_test(LATER)
        return case, None if case.gain > -case.gain_std else Rule(name=HARM)

    # -- second thoughts --------------------------------------------------------------

    def prune(self, newest=None):
        """Drop what became superfluous or took a wrong sign, the least useful first."""
        while True:
            worst, evidence, rule = None, None, None
            for effect in self.model.effects:
                if effect is newest:
                    continue
                case = self.evidence_of(effect)
                natural = effect.natural(self.model.coefficients(effect))
                if natural and case.significant(self.alpha, _SUPERFLUOUS):
                    continue
                if evidence is None or case.gain < evidence.gain:
                    worst, evidence = effect, case
                    rule = self._one_test(SUPERFLUOUS)
                    if not natural:
                        rule = Rule(name=UNNATURAL)
            if worst is None:
                return
            rest = self.model.without(worst)
            self._step("drop", worst, rest, evidence=evidence, rule=rule)

    def _limit(self):
        """Drop the least useful until no more are left than are wanted."""
        while self.max_effects is not None and (
            len(self.model.effects) > self.max_effects
        ):
            cases = [(self.evidence_of(e), e) for e in self.model.effects]
            evidence, least = min(cases, key=lambda case: case[0].gain)
            rest = self.model.without(least)
            self._step("drop", least, rest, evidence=evidence, rule=Rule(name=MOST))

    def withdraw(self):
        """Drop what makes the error larger on motion that it was not fitted to."""
        while self.model.effects:
            model = self.model
            transfer = Transfer(self.view, model.motion, model.effects, model.precision)
            with_all, worst, evidence = transfer.squares(model.effects), None, None
            for effect in model.effects:
                rest = transfer.squares(model.without(effect))
                case = compare(*model.relevant(effect, rest, with_all))
                # A single stretch that differs from the others decides nothing.
                harmful = case.gain < -case.gain_std
                if harmful and (evidence is None or case.gain < evidence.gain):
                    worst, evidence = effect, case
            if worst is None:
                return
            rest, rule = model.without(worst), Rule(name=ELSEWHERE)
            self._step("withdraw", worst, rest, evidence=evidence, rule=rule)
            # What only made up for it, or shared its place with it, goes as well.
            self.prune()

    def compete(self, joint):
        """Let rivals compete for the place of each effect of the joint."""
        for effect in [e for e in self.model.effects if e.joint == joint]:
            place = Place.of(effect, self.model)
            base = place.base
            tried, judge = self.try_joint(joint, base)
            found, others = self.eligible(tried, joint, base.effects)
            if not found:
                continue
            best, rivals = self.best_of(found, others)
            if best.effect.key() == effect.key():
                continue
            if place.beside is not base:
                judge = Judge(place.beside, judge.residual)
            white = judge.score(self.view.joints_of(effect), place.columns)
            case = self._evidence(
                best.effect, (place.squares, best.squares), (white, best.white)
            )
            simpler = best.effect.complexity < effect.complexity
            better = case.significant(self.alpha)
            if not better and not (simpler and case.gain > 0):
                continue
            successor = refined(best.effect, base)
            later, refusal = self._later(successor, base)
            if refusal is not None:
                self._refuse(successor, later, rivals, others, refusal)
                continue
            self._step(
                "replace",
                successor,
                [*base.effects, successor],
                replaced=effect,
                evidence=case,
                rivals=rivals,
                tried=others,
                rule=self._one_test(BETTER) if better else Rule(name=SIMPLER),
            )

    def _polish(self):
        """Tune all shapes once more beside each other, and prune once more."""
        for joint in sorted({e.joint for e in self.model.effects}):
            self.model = retuned(self.model, joint)
        self.prune()


def _weighted_gain(model):
    """Return what a candidate takes off a log-likelihood, to compare joints."""
    rows, before = model.view.rows, model.squares.sum(axis=0)

    def gain(candidate):
        after = candidate.squares.sum(axis=0)
        used = (before > 0) & (after > 0)
        return float((rows[used] * np.log(before[used] / after[used])).sum())

    return gain
