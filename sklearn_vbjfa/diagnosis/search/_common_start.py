"""One start for every search, whatever friction was declared.

A greedy search from a poor model goes where that model leads it: a Coulomb friction
smoothed over the whole range of speeds stands for the viscous one that is missing, and
load friction is told from chance only beside the right inertia. Viscous and Coulomb
friction, a constant and the rotor's inertia are what every robot is asked for first;
they are one column each, linear, and cost little. So the search begins with all of them
on every joint, declared or not, and what was not declared has to earn its place at the
end, beside the effects that were found.
"""

from dataclasses import dataclass

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._evidence import (
    SMALLEST_GAIN,
    Evidence,
    Rule,
    Step,
    compare,
)
from sklearn_vbjfa.diagnosis.search._model import Judge, SearchModel
from sklearn_vbjfa.effects import Effect
from sklearn_vbjfa.effects._declared import available

# Rule by which a plain term stays, as it is reported.
PLAIN = "Benjamini-Hochberg over plain terms and candidates, beside all that was found"


def plain_terms(declared, library):
    """Names of effects of a library that a robot could have declared and did not."""
    there = {effect.name for effect in library}
    return tuple(n for n in available() if n in there and n not in declared)


@dataclass(frozen=True, kw_only=True, eq=False)
class Term:
    """A plain term of a model.

    Attributes
    ----------
    effect : Effect
        The term.
    evidence : Evidence
        For the model with the term, against the same without it.
    squares : ndarray of shape (2, nv)
        Sums of squared out-of-sample residuals without the term and with it.
    """

    effect: Effect
    evidence: Evidence
    squares: np.ndarray

    def step(self, level, n_tests):
        """Step that adds the term."""
        return Step(
            action="add",
            effect=self.effect,
            evidence=self.evidence,
            rule=Rule(name=PLAIN, level=level, n_tests=n_tests),
            squares_before=self.squares[0],
            squares_after=self.squares[1],
        )


def earned(view, names, found, library, alpha):
    """Return the model with the plain terms that earn their place, and their steps.

    Parameters
    ----------
    view : RecordingView
        The recording, with the declared model.
    names : tuple of str
        Plain terms that are not declared.
    found : Found
        What the search found beside them all, on the view that declares them.
    library : tuple of Effect
        Effects that were searched.
    alpha : float
        Level of significance, shared out among the terms and the last candidates.

    Returns
    -------
    model : SearchModel
        Plain terms that stay, then the effects.
    steps : list of Step
        One for each of these terms, the most useful first.
    """
    by_name = {effect.name: effect for effect in library}
    plain = [
        clone(by_name[name]).set_params(joint=joint)
        for joint in np.flatnonzero(view.precision > 0).tolist()
        for name in names
    ]
    n_tests = len(plain) + found.n_tests
    model = SearchModel.on(view, [*plain, *found.effects], found.model)
    while True:
        terms = _judged(model, plain)
        level = _level([t.evidence.p_value for t in terms], n_tests, alpha)
        worst = {}
        for term in terms:
            joint = term.effect.joint
            natural = term.effect.natural(model.coefficients(term.effect))
            if natural and term.evidence.significant(level, SMALLEST_GAIN):
                continue
            # One a joint at a time: of two that stand for each other one stays.
            if joint not in worst or _gain(term) < _gain(worst[joint]):
                worst[joint] = term
        if not worst:
            break
        gone = {id(term.effect) for term in worst.values()}
        plain = [effect for effect in plain if id(effect) not in gone]
        rest = [effect for effect in model.effects if id(effect) not in gone]
        model = SearchModel.of(view, rest, model)
    terms = sorted(terms, key=lambda term: -_gain(term))
    return model, [term.step(level, n_tests) for term in terms]


def _gain(term):
    return term.evidence.gain


def _judged(model, plain):
    """What leaving out each plain term would cost, list of Term."""
    if not plain:
        return []
    judge = Judge(model, model.residuals())
    place = {id(e): p.start for e, p in zip(model.effects, model.places())}
    total = model.squares.sum(axis=0)
    found = []
    for joint in sorted({effect.joint for effect in plain}):
        own = [effect for effect in plain if effect.joint == joint]
        columns = [place[id(effect)] for effect in own]
        without = model.fitted.squares_without(joint, columns)
        white = judge.without(joint, columns)
        for k, effect in enumerate(own):
            evidence = compare(
                without[:, k],
                model.squares[:, joint],
                white=(white[:, k], judge.squares[:, joint]),
            )
            before = total.copy()
            before[joint] = without[:, k].sum()
            squares = np.array([before, total])
            found.append(Term(effect=effect, evidence=evidence, squares=squares))
    return found


def _level(p_values, n_tests, alpha):
    """Level after Benjamini and Hochberg, of the terms among all tests."""
    p_values = np.sort(p_values)
    rank = np.arange(1, p_values.size + 1)
    passing = rank[p_values <= alpha * rank / n_tests]
    return alpha / n_tests * max(int(passing.max(initial=1)), 1)
