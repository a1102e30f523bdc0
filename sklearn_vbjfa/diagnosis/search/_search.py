"""The search for effects that a model lacks: add, refine, prune, replace, withdraw."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._classes import one_of_class
from sklearn_vbjfa.diagnosis.search._evidence import (
    SMALLEST_GAIN,
    Candidate,
    Rule,
    Step,
    compare,
    no_worse,
    step_up,
)
from sklearn_vbjfa.diagnosis.search._exchange import backwards, exchange
from sklearn_vbjfa.diagnosis.search._left_out import can_be_left_out, left_out
from sklearn_vbjfa.diagnosis.search._members import alike
from sklearn_vbjfa.diagnosis.search._model import Judge, SearchModel
from sklearn_vbjfa.diagnosis.search._regression import LEAST_RIDGE
from sklearn_vbjfa.diagnosis.search._shapes import (
    absorbing,
    plainest,
    retuned,
    settled,
    tuned,
    tuned_before,
    tuned_family,
)
from sklearn_vbjfa.diagnosis.search._symmetry import one_sided
from sklearn_vbjfa.diagnosis.search._transfer import Transfer
from sklearn_vbjfa.diagnosis.search._values import p_of_value
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.effects import JointEffect
from sklearn_vbjfa.effects._library import closure

# A joint whose mean squared error is this many of its standard deviations above the
# noise floor, or less, lacks nothing that could be named: 5 % of those are that lack
# nothing.
AT_FLOOR = 1.645
# An effect stays as long as leaving it out would cost this share of the error.
_SUPERFLUOUS = 0.01
# What is found must hold beyond the data that it was found in: fitted to this first
# share of the blocks it is tried on the rest.
_FORWARD = 0.75
# What begins late is fitted to this first share of where it acts.
_LATE = 0.5
# What changes slowly acts in blocks that have this share of its largest power.
_FADED = 0.01
# It must still act after this share of all blocks, and save this share there of what it
# saves of the whole: with its law a drift or payload saves more there, where the model
# without it was not fitted.
_MIDDLE, _HOLDS = 0.5, 0.5
# Blocks on either side of that border in which it acts, at the least: fewer cannot tell
# it from chance.
_ACTIVE = 3
# Candidates of a joint that are judged with its other shapes tuned anew.
_ANEW = 4
# A plain effect that saves this share of what one that contains it saves goes first.
_CONTAINED = 0.5
# A plain term that saves this share of a joint's error needs no other motion to judge.
_CLEAR = 0.5
# Effects of one kind on one joint, with different settings (drift of this and that).
_MOST_ROUNDS_PER_JOINT = 6

# Rules by which a step is taken, as they are reported.
STEP_UP = "Benjamini-Hochberg over the candidates of the round"
CONTAINED = "plainer than a candidate that passed, and saves most of what it does"
LATER = "what changes slowly must help on later data"
FADED = "has faded before there is later data to try it on"
TOO_LATE = "acts in too few blocks to be tried on later data"
HARM = "does harm on later data, beyond one standard error"
SUPERFLUOUS = "leaving it out costs no more than chance, or less than 1 %"
ABSORBED = "the effect that contains it does as well alone, with another shape"
MOST = "fewer effects were asked for"
UNSETTLED = "saves less than 2 % once the robot is corrected"
UNNATURAL = "took a sign or size that it cannot have"
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
    branches : tuple of (Branch, Found)
        What was found on each branch of a robot that was searched branch by branch.
    """

    model: SearchModel
    evidence: tuple
    steps: tuple
    threshold: float
    n_tests: int
    library: tuple
    branches: tuple = ()

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
    joints, columns : list of int and ndarray of shape (nj, m, c, k)
        Columns of its shapes; none for an effect that is in the model.
    model : SearchModel
        The model with the effect.
    """

    base: SearchModel
    beside: SearchModel
    squares: np.ndarray
    joints: list
    columns: np.ndarray | None
    model: SearchModel

    @classmethod
    def of(cls, effect, model):
        """Score an effect of a model beside the others."""
        if effect.in_model:
            # Each fold has its own correction of the value, which all rows gave.
            base = model.beside(model.without(effect), None)
            return cls(
                base=base,
                beside=base,
                squares=model.squares,
                joints=[],
                columns=None,
                model=model,
            )
        joints, columns = model.view.joints_of(effect), tuned_family(effect, model)
        rest = model.without(effect)
        bases = [model.beside(rest, ridge) for ridge in (None, "same")]
        scores = [base.fitted.score(joints, columns).squares for base in bases]
        best = int(np.argmin([(s @ model.precision).sum() for s in scores]))
        return cls(
            base=bases[0],
            beside=bases[best],
            squares=scores[best],
            joints=joints,
            columns=columns,
            model=model,
        )

    def white(self, judge):
        """Squared residuals with the effect as a judge of the base sees them."""
        if self.columns is None:
            return Judge(self.model, judge.residual).squares
        if self.beside is not self.base:
            judge = Judge(self.beside, judge.residual)
        return judge.score(self.joints, self.columns)


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
    been : set
        Sets of keys of effects that were accepted together: a replacement must not lead
        back to one, or the search goes in circles.
    tried : dict
        By joint, the model that candidates were last tried beside, and what they were.
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
    been: set = field(default_factory=set)
    tried: dict = field(default_factory=dict)
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

    def settle(self):
        """Keep what also holds elsewhere, as much as is wanted: what was `Found`."""
        self.withdraw()
        self._try_again()
        self._limit()
        return self.found()

    def explore(self):
        """Search until nothing is significant."""
        self.accept(())
        number, most = 0, _MOST_ROUNDS_PER_JOINT * self.view.nv
        found, seen = True, set()
        while found:
            while number < most and not self.is_full() and self._round(number):
                number += 1
            found = False
            if self.model.effects:
                self._polish()
                # What was hidden by shapes that were not yet tuned may show now.
                if number < most and not self.is_full():
                    found = self._round(number)
                    number += 1
            # Each set of effects is looked at once: swaps must not go in circles.
            names = keys_of(self.model.effects)
            if not found and names not in seen and number < most:
                seen.add(names)
                found = exchange(self)
                number += found
        backwards(self)

    def found(self):
        """Return what is `Found` as it is now."""
        cases = self.all_evidence()
        return Found(
            model=self.model,
            evidence=tuple(cases[id(effect)] for effect in self.model.effects),
            steps=tuple(self.steps),
            threshold=self.threshold,
            n_tests=self.n_tests,
            library=self.library,
        )

    def accept(self, effects):
        """Take effects for what the declared model lacks."""
        self.model = SearchModel.of(self.view, effects, self.model)
        self.been.add(keys_of(effects))

    def is_full(self):
        """Whether as many effects are accepted as may be."""
        return (
            self.max_effects is not None and len(self.model.effects) >= self.max_effects
        )

    def _round(self, number):
        """Add or refuse one effect; whether there was one."""
        model = self.model
        offer = self._best_offer(number)
        if offer is None:
            return False
        chosen, rivals, others = offer
        chosen, rivals = self._judged_anew(chosen, rivals, others)
        rivals = (*alike(chosen, model, self.taken(model)), *rivals)
        effect = tuned(chosen.effect, model)
        case, refusal = self.later(effect, model)
        if refusal is None and effect.in_model:
            effect, case, refusal = self._settled(effect)
        if refusal is not None:
            self._refuse(effect, case, rivals, others, refusal)
            return True
        # Beside another model they may hold.
        self.tried = {j: t for j, t in self.tried.items() if j not in self._refusing()}
        self.refused.clear()
        self.step(
            "add",
            effect,
            [*model.effects, effect],
            evidence=chosen.evidence,
            rivals=rivals,
            tried=others,
            rule=self._rule(chosen),
        )
        if self.on_progress is not None:
            self.on_progress(number + 1, f"shapes on joint {effect.joint + 1}")
        effect = self.absorb(effect)
        self.prune(effect)
        self.model = retuned(self.model, effect.joint)
        self.compete(effect.joint)
        return True

    def _settled(self, effect):
        """Linearise an effect in the model beside the others until its value stays.

        Returns the effect with its value, Evidence for the model with it, and
        the Rule that refuses it or None.
        """
        # What its columns promise need not hold for the corrected robot.
        model = self.model
        trial = settled(effect, model.effects, model)
        own = trial.effects[-1]
        case = compare(*model.relevant(effect, model.squares, trial.squares))
        if not own.natural(trial.coefficients(own)):
            return own, case, Rule(name=UNNATURAL)
        if case.gain < SMALLEST_GAIN:
            return own, case, Rule(name=UNSETTLED)
        return own, case, None

    def _best_offer(self, number):
        """Best candidate that may be added, its rivals and all that beat chance.

        None if there is none.
        """
        # What one joint gains changes little on the others, so that only the joint of
        # the best candidate is tried again beside the model as it is; all of them are
        # before it is said that there is nothing. M. Minoux, "Accelerated greedy
        # algorithms for maximizing submodular set functions", Optimization Techniques,
        # Springer, 1978, doi 10.1007/BFb0006528.
        model = self.model
        quiet = self.at_floor(model.squares) | (model.precision == 0)
        joints = np.flatnonzero(model.precision > 0).tolist()
        if quiet.all():
            return None
        while True:
            best = max(self._offers(), key=lambda offer: offer[0], default=None)
            stale = [
                j
                for j in joints
                if j not in self.tried or self.tried[j][0] is not model
            ]
            if best is not None and best[1] not in stale:
                chosen = best[2]
                if chosen.effect.in_model and chosen.effect.whole_robot:
                    return self._one_class(best[2:], joints)
                return best[2:]
            for joint in stale if best is None else [best[1]]:
                if self.on_progress is not None:
                    self.on_progress(number, f"joint {joint + 1} of {self.view.nv}")
                found, _ = self.try_joint(joint, model, quiet[joint])
                self.tried[joint] = model, found
            if best is None and not stale:
                return None

    def _offers(self):
        """Yield (gain, joint, candidate, rivals, others) of joints as last tried."""
        self._set_threshold({j: found for j, (_, found) in self.tried.items()})
        for joint, (model, found) in self.tried.items():
            offered, others = self.eligible(found, joint, self.model.effects)
            if offered:
                chosen, rivals = self.best_of(offered, others)
                yield _weighted_gain(model)(chosen), joint, chosen, rivals, others

    def _one_class(self, offer, joints):
        """Let all effects of the robot's geometry compete with the one on offer.

        Returns the simplest of the best, with those that compare with it as
        rivals.
        """
        # They act on all joints, so that one may stand for another of any joint.
        model, (chosen, rivals, others) = self.model, offer
        for joint in joints:
            if joint not in self.tried or self.tried[joint][0] is not model:
                self.tried[joint] = model, self.try_joint(joint, model)[0]
        offered = {chosen.effect.key(): chosen}
        for joint, (_, found) in self.tried.items():
            for one in self.eligible(found, joint, model.effects)[0]:
                if one.effect.in_model and one.effect.whole_robot:
                    offered.setdefault(one.effect.key(), one)
        simplest, close = one_of_class(model, list(offered.values()))
        near = (*close, *(c for c in rivals if c.effect.key() not in offered))
        return simplest, tuple(c for c in near if c is not simplest), others

    def step(self, action, effect, effects, *, rivals=(), tried=(), **given):
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
        self.tried.pop(effect.joint, None)
        self.refusals[effect.key()] = self.refusals.get(effect.key(), 0) + 1
        self.step(
            "refuse",
            effect,
            None,
            evidence=case,
            rivals=rivals,
            tried=tried,
            rule=rule,
        )

    def _refusing(self):
        """Joints on which something was refused beside the present model."""
        return {joint for _, joint, *_ in self.refused}

    def at_floor(self, squares, factor=1.0):
        """Joints whose error noise alone explains, but for a factor."""
        rows = self.view.rows
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = squares.sum(axis=0) / rows
            chance = 1.0 + AT_FLOOR * np.sqrt(2.0 / rows)
        return mean < factor**2 * chance * self.view.floor

    # -- candidates -----------------------------------------------------------------

    def candidates_of(self, joint):
        """Effects of the library on a joint that can be looked for."""
        return candidates_of(joint, self.library, self.model)

    def taken(self, base):
        """Keys of effects that may not come beside a model, a set."""
        return self.refused.union(*(e.excludes() for e in base.effects))

    def score(self, effect, base, finely=True):
        """Try an effect beside a model: a Candidate, and its family's columns.

        None of both if there is nothing new. The evidence has no p-value yet. See
        `plainest`.
        """
        taken = self.taken(base)
        family = base.family(effect).where(lambda one: one.key() not in taken)
        if not family.effects:
            return None, None
        joints = self.view.joints_of(effect)
        family, score = plainest(base, effect, family, finely)
        if effect.opposite() is not None:
            family, score = one_sided(base, family, joints, score)
            if family is None:
                return None, None
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

    def scored(self, joint, base, smallest=SMALLEST_GAIN):
        """Effects on a joint alone that save a share beside a model, scored."""
        found = []
        for effect in self.candidates_of(joint):
            if not effect.everywhere:
                candidate, _ = self.score(effect, base, finely=False)
                if candidate and candidate.evidence.gain >= smallest:
                    found.append(candidate)
        return found

    def try_joint(self, joint, base, quiet=False):
        """Try all effects on a joint beside a model, name -> Candidate, plainer first.

        All are judged on rows from which the memory is taken out that the residual has
        with the best of them; the `Judge` is returned as well, None if none is worth a
        name. A quiet joint lacks nothing of its own, but may be where something acts
        that others feel.
        """
        everything = self.candidates_of(joint)
        if quiet:
            everything = [effect for effect in everything if effect.everywhere]
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
                one.effect, (base.squares, one.squares), (judge.squares, white), base
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
        whole = any(c.effect.everywhere for c in everything)
        joint = candidates[0].effect.joint
        error = {
            id(c): c.white.sum(axis=1) if whole else c.white[:, joint]
            for c in everything
        }
        best = min(candidates, key=lambda c: error[id(c)].sum())

        def compares(one):
            return self.compares(best, one, error[id(best)], error[id(one)])

        close = [c for c in candidates if compares(c)]
        simplest = min(
            close,
            key=lambda c: (
                c.effect.complexity,
                c.effect.precedence,
                error[id(c)].sum(),
            ),
        )
        rivals = tuple(c for c in everything if c is not simplest and compares(c))
        return simplest, rivals

    def compares(self, best, other, error_best, error_other):
        """Whether blocks (n_blocks,) leave open which of two candidates is better.

        A function of time imitates whatever changes slowly: against a recorded cause
        it has to be better beyond chance, not by a standard error.
        """
        if best.effect.slow and other.effect.recorded:
            return compare(error_other, error_best).p_value >= self.alpha
        return no_worse(error_best, error_other)

    def _judged_anew(self, chosen, rivals, others):
        """Judge the best candidates of a joint with its other shapes tuned beside them.

        Returns the chosen candidate, and its rivals.
        """
        # A shape that was tuned to what the joint lacked may hide what is right.
        joint, model = chosen.effect.joint, self.model
        shaped = any(e.joint == joint and e.continuous for e in model.effects)
        if not shaped or chosen.effect.everywhere:
            return chosen, rivals
        first = sorted(
            (c for c in others if c is not chosen and not c.effect.everywhere),
            key=lambda c: c.white[:, joint].sum(),
        )
        error = {}
        for one in [chosen, *first[: _ANEW - 1]]:
            effects = [*model.effects, tuned(one.effect, model)]
            with_it = retuned(SearchModel.of(self.view, effects, model), joint)
            error[id(one)] = one, with_it.squares[:, joint]
        best, least = min(error.values(), key=lambda x: x[1].sum())
        close = [(c, e) for c, e in error.values() if self.compares(best, c, least, e)]
        simplest, _ = min(close, key=lambda x: (x[0].effect.complexity, x[1].sum()))
        near = [c for c, _ in close] + [c for c in rivals if id(c) not in error]
        return simplest, tuple(c for c in near if c is not simplest)

    # -- levels ---------------------------------------------------------------------

    def _set_threshold(self, tried):
        """Set the level of this round, after Benjamini and Hochberg."""
        # On a robot that lacks nothing it is Bonferroni's: one false alarm in 1 /
        # alpha recordings. On one that lacks much, a short recording could not reach
        # that level for any effect. Only the best effect is added, so that a level
        # that many true ones have raised falls again before a false one is the best.
        p_values = [c.evidence.p_value for t in tried.values() for c in t.values()]
        if p_values:
            self.n_tests = len(p_values)
            self.threshold = step_up(p_values, self.n_tests, self.alpha)

    def _rule(self, candidate):
        """Rule by which a candidate is added in this round."""
        if candidate.evidence.significant(self.threshold):
            return Rule(name=STEP_UP, level=self.threshold, n_tests=self.n_tests)
        return self.one_test(CONTAINED)

    def one_test(self, name):
        return Rule(name=name, level=self.alpha, n_tests=1)

    # -- evidence -------------------------------------------------------------------

    def _evidence(self, effect, squares, white, model=None):
        """Evidence for a change on an effect's joint, p-value from whitened rows."""
        # That of an effect in the robot model is of its value, in the model given or
        # beside it, see `p_of_value`. Each time that the effect was refused before
        # doubles it.
        if effect.everywhere:
            white = [s.sum(axis=1) for s in white]
        else:
            white = [s[:, effect.joint] for s in white]
        evidence = compare(*self.model.relevant(effect, *squares), white=white)
        if effect.in_model and model is not None and evidence.gain > 0:
            evidence = replace(evidence, p_value=p_of_value(model, effect))
        trials = 2.0 ** self.refusals.get(effect.key(), 0)
        return replace(evidence, p_value=min(1.0, trials * evidence.p_value))

    def evidence_of(self, effect):
        """Evidence for an accepted effect: what leaving it out would cost.

        Its shape is chosen inside each fold, so that what was tuned on all rows is
        not judged on them.
        """
        place = Place.of(effect, self.model)
        judge = Judge(place.base, self.model.residuals())
        return self._evidence(
            effect,
            (place.base.squares, place.squares),
            (judge.squares, place.white(judge)),
            self.model,
        )

    def all_evidence(self):
        """Evidence for all accepted effects, a dict by the effect's id."""
        own = self.model.effects
        linear = [effect for effect in own if can_be_left_out(effect)]
        cases = {id(x.effect): x.evidence for x in left_out(self.model, linear)}
        for effect in own:
            if id(effect) not in cases:
                cases[id(effect)] = self.evidence_of(effect)
        return cases

    def later(self, effect, base):
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
        nothing = np.zeros(1)
        if where.size < 2 * _ACTIVE:
            return compare(nothing, nothing), Rule(name=TOO_LATE)
        if effect.slow and (where >= _MIDDLE * acts.size).sum() < _ACTIVE:
            # Whatever happens once at the beginning looks like a decay.
            return compare(nothing, nothing), Rule(name=FADED)
        late = where[0] > 0.5 * where[int(_FORWARD * where.size)]
        # What begins late has to be fitted where it acts, and tried there as well. A
        # trend goes on for another quarter more often than for another half.
        trend = effect.slow or effect.trend
        shares = [_LATE] if late else [_LATE, _FORWARD] if trend else [_FORWARD]
        larger = self.model.beside([*base.effects, effect])
        if not effect.natural(larger.coefficients(effect)):
            # Between the points of the grid it became something else.
            return compare(nothing, nothing), Rule(name=UNNATURAL)
        judge = Judge(base, larger.residuals())
        least = 0.0
        if trend:
            whole = compare(*base.relevant(effect, base.squares, larger.squares))
            least = max(_HOLDS * whole.gain, 0.0)
        for share in shares:
            border = where[int(share * where.size)]
            if trend or late:
                early = blocks.label < border
                own = base.columns_of(tuned_before(effect, base, early))
            # What little the bodies leave of a value in the model a ridge would take.
            ridge = LEAST_RIDGE if effect.in_model else None
            squares = judge.forward(joints, own, blocks, border, ridge)
            if effect.slow:
                # Where it has faded it cannot be tried: all it does there is to leave
                # other parameters alone.
                squares = [s[acts[border:]] for s in squares]
            if not effect.everywhere:
                squares = [s[:, [effect.joint]] for s in squares]
            case = compare(*(s.sum(axis=1) for s in squares))
            if trend or late:
                # Whatever changes slowly can be fitted by a function of time or of a
                # slow signal, and whatever happened once by what begins late.
                if not (case.gain > least and case.p_value < self.alpha):
                    return case, self.one_test(LATER)
        if trend or late:
            return case, None
        return case, None if case.gain > -case.gain_std else Rule(name=HARM)

    # -- second thoughts --------------------------------------------------------------

    def absorb(self, effect):
        """Drop plainer effects that a new one stands for if it takes another shape.

        The plainest form of it that is no worse is taken. Returns the effect as it is
        then.
        """
        names = closure(effect, self.library)
        plain = [
            one
            for one in self.model.effects
            if one.joint == effect.joint and one.name in names
        ]
        forms = (one.complexity for one in self.model.family(effect).effects)
        if effect.complexity <= min(forms, default=effect.complexity) and not (
            plain and effect.continuous
        ):
            return effect
        for trial in absorbing(effect, plain, self.model):
            now, then = (
                trial.relevant(effect, m.squares)[0] for m in (self.model, trial)
            )
            if not no_worse(now, then):
                continue
            case = compare(then, now)
            for one in plain:
                rest = self.model.without(one)
                self.step("drop", one, rest, evidence=case, rule=Rule(name=ABSORBED))
            self.model = trial
            return trial.effects[-1]
        return effect

    def prune(self, newest=None):
        """Drop what became superfluous or took a wrong sign, the least useful first."""
        while True:
            worst, evidence, rule = None, None, None
            cases = self.all_evidence()
            for effect in self.model.effects:
                if effect is newest:
                    continue
                case = cases[id(effect)]
                natural = effect.natural(self.model.coefficients(effect))
                if natural and case.significant(self.alpha, _SUPERFLUOUS):
                    continue
                if evidence is None or case.gain < evidence.gain:
                    worst, evidence = effect, case
                    rule = self.one_test(SUPERFLUOUS)
                    if not natural:
                        rule = Rule(name=UNNATURAL)
            if worst is None:
                return
            if rule.name == UNNATURAL:
                self.refusals[worst.key()] = self.refusals.get(worst.key(), 0) + 1
            rest = self.model.without(worst)
            self.step("drop", worst, rest, evidence=evidence, rule=rule)

    def _try_again(self):
        """Refuse effects of time that do not hold as they were tuned in the end."""
        for effect in [e for e in self.model.effects if e.slow]:
            rest = self.model.without(effect)
            case, refusal = self.later(effect, self.model.beside(rest))
            if refusal is not None:
                self.step("refuse", effect, rest, evidence=case, rule=refusal)
                # What only made up for it goes as well.
                self.prune()

    def _limit(self):
        """Drop the least useful until no more are left than are wanted."""
        while self.max_effects is not None and (
            len(self.model.effects) > self.max_effects
        ):
            cases = self.all_evidence()
            least = min(self.model.effects, key=lambda e: cases[id(e)].gain)
            evidence = cases[id(least)]
            rest = self.model.without(least)
            self.step("drop", least, rest, evidence=evidence, rule=Rule(name=MOST))

    def withdraw(self):
        """Drop what makes the error larger on motion that it was not fitted to."""
        while self.model.effects:
            model = self.model
            transfer = Transfer(model)
            with_all, worst, evidence = None, None, None
            for effect in self._doubtful():
                if with_all is None:
                    with_all = transfer.squares(model.effects)
                rest = transfer.squares(model.without(effect))
                case = compare(*model.relevant(effect, rest, with_all))
                # A single stretch that differs from the others decides nothing.
                harmful = case.gain < -case.gain_std
                if harmful and (evidence is None or case.gain < evidence.gain):
                    worst, evidence = effect, case
            if worst is None:
                return
            rest, rule = model.without(worst), Rule(name=ELSEWHERE)
            self.step("withdraw", worst, rest, evidence=evidence, rule=rule)
            # What only made up for it, or shared its place with it, goes as well.
            self.prune()

    def _doubtful(self):
        """Effects that other motion may speak against."""
        # Plain friction that takes most of a joint's error off block by block does so
        # in other motion as well; it is a straight line or a step in the velocity.
        cases = self.all_evidence()
        return [
            effect
            for effect in self.model.effects
            if not (isinstance(effect, JointEffect) and cases[id(effect)].gain > _CLEAR)
        ]

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
            rivals = (*alike(best, base, self.taken(base)), *rivals)
            white = place.white(judge)
            case = self._evidence(
                best.effect, (place.squares, best.squares), (white, best.white)
            )
            simpler = best.effect.complexity < effect.complexity
            better = case.significant(self.alpha)
            if not better and not (simpler and case.gain > 0):
                continue
            successor = tuned(best.effect, base)
            if keys_of([*base.effects, successor]) in self.been:
                continue
            later, refusal = self.later(successor, base)
            if refusal is not None:
                self._refuse(successor, later, rivals, others, refusal)
                continue
            if successor.in_model:
                trial = settled(successor, base.effects, self.model)
                now, then = (
                    base.relevant(successor, m.squares)[0] for m in (self.model, trial)
                )
                if not no_worse(now, then):
                    continue
                successor = trial.effects[-1]
            self.step(
                "replace",
                successor,
                [*base.effects, successor],
                replaced=effect,
                evidence=case,
                rivals=rivals,
                tried=others,
                rule=self.one_test(BETTER) if better else Rule(name=SIMPLER),
            )

    def _polish(self):
        """Tune all shapes once more beside each other, and prune once more."""
        for joint in sorted({e.joint for e in self.model.effects}):
            self.model = retuned(self.model, joint)
        self.prune()


def keys_of(effects):
    """Keys of some effects, whatever their order, a frozenset."""
    return frozenset(effect.key() for effect in effects)


def _weighted_gain(model):
    """Return what a candidate takes off a log-likelihood, to compare joints."""
    rows, before = model.view.rows, model.squares.sum(axis=0)

    def gain(candidate):
        after = candidate.squares.sum(axis=0)
        used = (before > 0) & (after > 0)
        return float((rows[used] * np.log(before[used] / after[used])).sum())

    return gain
