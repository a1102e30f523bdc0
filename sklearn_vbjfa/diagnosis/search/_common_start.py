"""One start for every search, whatever friction was declared.

A greedy search from a poor model goes where that model leads it: a Coulomb friction
smoothed over the whole range of speeds stands for the viscous one that is missing, and
load friction can be distinguished from chance only beside the right inertia. Viscous
and Coulomb friction, a constant and the rotor's inertia are what every robot is asked
for first; they are one column each, linear, and cost little. So the search begins with
all of them on every joint, declared or not, and what was not declared has to earn its
place at the end, beside the effects that were found.
"""

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._evidence import (
    SMALLEST_GAIN,
    Rule,
    Step,
    step_up,
)
from sklearn_vbjfa.diagnosis.search._left_out import left_out
from sklearn_vbjfa.diagnosis.search._model import SearchModel
from sklearn_vbjfa.effects._declared import available

# Rule by which a plain term stays, as it is reported.
PLAIN = "Benjamini-Hochberg over plain terms and candidates, beside all that was found"


def plain_terms(declared, library):
    """Names of effects of a library that a robot could have declared and did not."""
    there = {effect.name for effect in library}
    return tuple(n for n in available() if n in there and n not in declared)


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
        terms = left_out(model, plain)
        level = step_up([t.evidence.p_value for t in terms], n_tests, alpha)
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
    rule = Rule(name=PLAIN, level=level, n_tests=n_tests)
    return model, [_step(term, rule) for term in terms]


def _gain(term):
    return term.evidence.gain


def _step(term, rule):
    """Step that adds a plain term."""
    before, after = term.squares
    return Step(
        action="add",
        effect=term.effect,
        evidence=term.evidence,
        rule=rule,
        squares_before=before,
        squares_after=after,
    )
