"""What one step at a time cannot reach: pairs, swaps, and a last pass backwards.

A greedy search stops where no single effect is worth its name, although two would be,
and it keeps what it took early for two others, or two for one. The shape of what a
joint has is tuned to what it lacked, so that whatever is tried beside it has to be
judged with that shape free again.
"""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.diagnosis.search._evidence import (
    Candidate,
    Evidence,
    Rule,
    compare,
    no_worse,
)
from sklearn_vbjfa.diagnosis.search._model import Judge, SearchModel
from sklearn_vbjfa.diagnosis.search._shapes import retuned, settled, tuned

# Effects of a joint that a second one is tried beside, the best ones alone.
_FIRST = 3
# Where the error is this many times the noise floor, one effect may not be enough.
_ABOVE = 1.15
# A simpler effect is tried in another's place if it leaves less than this many times
# the error before it is linearised anew.
_NEAR = 1.5
# Rules by which a step is taken, as they are reported.
PAIR = "Bonferroni over the pairs of the joint, where no single effect passed"
FOR_TWO = "Bonferroni over the pairs of the joint, in place of what they replace"
SIMPLER_CLASS = "simpler than what it replaces, and no worse on all joints"
FOR_ONE = "one effect in place of two, simpler and no worse"
BACKWARDS = "last pass from the full model backwards"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pair:
    """The best two effects of a joint beside a model, shapes tuned with each other.

    Attributes
    ----------
    effects : tuple of Effect
        The two.
    evidence : Evidence
        For the model with them, against the present one.
    model : SearchModel
        That model.
    n_tests : int
        Pairs that were tried.
    """

    effects: tuple
    evidence: Evidence
    model: SearchModel
    n_tests: int


def exchange(search):
    """Try pairs and swaps on every joint; whether anything was changed.

    Of an `EffectSearch` in which no single effect passes any more.
    """
    if _of_class(search):
        return True
    model = search.model
    above = (model.precision > 0) & ~search.at_floor(model.squares, _ABOVE)
    for joint in np.flatnonzero(model.precision > 0).tolist():
        own = [e for e in model.effects if e.joint == joint and not e.everywhere]
        if _two_for_one(search, joint, own):
            return True
        if not above[joint] or search.is_full():
            continue
        if _pair(search, joint, None):
            return True
        # Only a shape that is tuned to what is missing stands in the way.
        if any(_pair(search, joint, effect) for effect in own if effect.continuous):
            return True
    return False


def _of_class(search):
    """Put a simpler effect of the geometry in the place of another, of any joint.

    Returns whether that was done.
    """
    # What was found first had to stand for those that came later as well.
    model = search.model
    for effect in [e for e in model.effects if e.in_model and e.whole_robot]:
        base = model.beside(model.without(effect), None)
        rank = _rank(effect)
        error = model.squares @ model.precision
        offers = []
        for joint in np.flatnonzero(model.precision > 0).tolist():
            for other in search.candidates_of(joint):
                if not (other.in_model and other.whole_robot and _rank(other) < rank):
                    continue
                candidate, _ = search.score(other, base)
                if candidate is not None:
                    own = (candidate.squares @ model.precision).sum()
                    offers.append((_rank(other), own, candidate.effect))
        offers = [one for one in offers if one[1] < _NEAR * error.sum()]
        for _, _, other in sorted(offers, key=lambda one: one[:2])[:_FIRST]:
            trial = settled(other, base.effects, model)
            found = trial.squares @ model.precision
            if not no_worse(error, found):
                continue
            evidence = compare(error, found)
            rule = Rule(name=SIMPLER_CLASS)
            search.step(
                "replace",
                trial.effects[-1],
                list(trial.effects),
                replaced=effect,
                evidence=evidence,
                rule=rule,
                # They do not differ by more than chance.
                rivals=[
                    Candidate(
                        effect=effect,
                        evidence=evidence,
                        squares=model.squares,
                        white=model.squares,
                    )
                ],
            )
            search.prune()
            return True
    return False


def _rank(effect):
    """Order of effects by how much they are: fewer coefficients, then precedence."""
    return (effect.complexity, effect.precedence)


def _pair(search, joint, replaced):
    """Add two effects, in place of one where that is given; whether that was done."""
    pair = _best_pair(search, joint, replaced)
    if pair is None:
        return False
    level = search.alpha / (pair.n_tests * max(int((search.view.rows > 0).sum()), 1))
    if not pair.evidence.significant(level):
        return False
    beside = replace(search, model=pair.model, steps=[])
    for effect in pair.effects:
        # Each has to earn its place beside the other.
        if not beside.evidence_of(effect).significant(search.alpha):
            return False
        base = pair.model.beside(pair.model.without(effect))
        _, refusal = search.later(effect, base)
        if refusal is not None:
            return False
    rest = [e for e in search.model.effects if e is not replaced]
    rule = Rule(
        name=PAIR if replaced is None else FOR_TWO, level=level, n_tests=pair.n_tests
    )
    first, second = pair.effects
    search.step(
        "add" if replaced is None else "replace",
        first,
        [*rest, first],
        evidence=pair.evidence,
        replaced=replaced,
        rule=rule,
    )
    search.step(
        "add", second, list(pair.model.effects), evidence=pair.evidence, rule=rule
    )
    return True


def _best_pair(search, joint, replaced):
    """Best two effects of a joint in place of one or none, a `_Pair` or None."""
    model = search.model
    rest = [e for e in model.effects if e is not replaced]
    base = model if replaced is None else model.beside(rest, None)
    singles = search.scored(joint, base, -np.inf)
    if not singles:
        return None
    singles.sort(key=lambda one: one.squares[:, joint].sum())
    best, n_tests = None, 0
    tried = set()
    for one in singles[:_FIRST]:
        beside = base.beside([*rest, one.effect])
        for other in search.scored(joint, beside):
            names = frozenset((one.effect.key(), other.effect.key()))
            n_tests += names not in tried
            tried.add(names)
            error = other.squares[:, joint].sum()
            if best is None or error < best[0]:
                best = error, one.effect, other.effect
    if best is None or best[0] >= model.squares[:, joint].sum():
        return None
    _, first, second = best
    larger = retuned(SearchModel.of(model.view, [*rest, first, second], model), joint)
    return _Pair(
        effects=larger.effects[-2:],
        evidence=compare(
            *_squares(model, larger, [joint]), white=_white(model, larger, [joint])
        ),
        model=larger,
        n_tests=n_tests,
    )


def _two_for_one(search, joint, own):
    """Put one effect in the place of two of a joint; whether that was done."""
    model = search.model
    for i, first in enumerate(own):
        for second in own[i + 1 :]:
            rest = [e for e in model.effects if e is not first and e is not second]
            base = model.beside(rest, None)
            both = model.squares[:, joint]
            fit = [
                one
                for one in search.scored(joint, base)
                if one.effect.complexity < first.complexity + second.complexity
                and no_worse(both, one.squares[:, joint])
            ]
            if not fit:
                continue
            best = min(
                fit,
                key=lambda one: (one.effect.complexity, one.squares[:, joint].sum()),
            )
            if best.effect.key() in {first.key(), second.key()}:
                # Then the other one is superfluous, for which there is a rule.
                continue
            if _put(search, best, base, (first, second)):
                return True
    return False


def _put(search, candidate, base, replaced):
    """Put a candidate in the place of two effects unless later data refuse it."""
    successor = tuned(candidate.effect, base)
    _, refusal = search.later(successor, base)
    if refusal is not None:
        return False
    evidence = compare(
        *base.relevant(successor, search.model.squares, candidate.squares)
    )
    rule = Rule(name=FOR_ONE)
    first, second = replaced
    search.step(
        "replace",
        successor,
        [*base.effects, second, successor],
        replaced=first,
        evidence=evidence,
        rule=rule,
    )
    search.step(
        "drop", second, [*base.effects, successor], evidence=evidence, rule=rule
    )
    return True


def backwards(search):
    """Prune once more from all that was ever accepted or a rival of it.

    What a step replaced or dropped was judged beside the model of that time. Taken
    together again and dropped one by one, the least useful first, the effects end at a
    set that does not depend on the order in which they were found; it is taken if it is
    better than the present one, or simpler and no worse.
    """
    present = {effect.key() for effect in search.model.effects}
    taken = search.refused.union(*(e.excludes() for e in search.model.effects))
    again = {}
    for step in search.steps:
        offered = [step.effect, step.replaced, *(c.effect for c in step.rivals)]
        for effect in offered:
            if effect is not None and effect.key() not in taken:
                again[effect.key()] = effect
    if not again or search.max_effects is not None:
        return
    model = search.model
    full = SearchModel.of(search.view, [*model.effects, *again.values()], model)
    trial = replace(search, model=full, steps=[])
    trial.prune()
    other = trial.model
    ends = {effect.key(): effect for effect in other.effects}
    joints = sorted({e[1] for e in present ^ ends.keys()})
    new = [effect for key, effect in ends.items() if key not in present]
    if not joints or any(
        search.later(e, other.beside(other.without(e)))[1] for e in new
    ):
        return
    raw = _squares(model, other, joints)
    evidence = compare(*raw, white=_white(model, other, joints))
    level = search.alpha / len(again)
    simpler = _complexity(other) < _complexity(model)
    if not evidence.significant(level) and not (simpler and no_worse(*raw)):
        return
    rule = Rule(name=BACKWARDS, level=level, n_tests=len(again))
    effects = list(model.effects)
    for effect in new:
        effects.append(effect)
        search.step("add", effect, effects, evidence=evidence, rule=rule)
    for effect in [e for e in model.effects if e.key() not in ends]:
        effects = [e for e in effects if e is not effect]
        search.step("drop", effect, effects, evidence=evidence, rule=rule)


def _squares(model, other, joints):
    """Squared errors (n_blocks,) of some joints by two models, in units of noise."""
    return [m.squares[:, joints] @ model.precision[joints] for m in (model, other)]


def _white(model, other, joints):
    """Return the same in rows without the memory that the second model leaves."""
    residual = other.residuals()
    return [Judge(m, residual).squares[:, joints].sum(axis=1) for m in (model, other)]


def _complexity(model):
    return sum(effect.complexity for effect in model.effects)
