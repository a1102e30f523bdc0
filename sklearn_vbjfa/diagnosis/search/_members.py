"""Members of one family of effects that the data cannot tell apart.

A round offers the best member of each family, its shape chosen fold by fold. For most
families the shape is a matter of tuning. Where it is what an engineer asks for, such as
which of several recorded signals, the others are rivals of the best one.
"""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa.diagnosis.search._evidence import Candidate, compare, no_worse
from sklearn_vbjfa.diagnosis.search._model import Judge

# Members that are judged, those that explain most: a logger may have a hundred columns.
_MOST = 8


def alike(chosen, base, taken=()):
    """Return members of the chosen candidate's family that do as well beside a model.

    Those that differ in what sets members apart (`Effect.apart`), judged like the
    candidates of a round, in rows without the memory of the residual that the chosen
    one leaves; the best first. A tuple of `Candidate`, whose evidence has no p-value.

    taken : keys of effects that cannot be offered.
    """
    effect = chosen.effect
    if not effect.apart:
        return ()
    view, joints = base.view, base.view.joints_of(effect)
    others = base.family(effect).where(
        lambda one: one.key() != effect.key() and one.key() not in taken
    )
    if others.effects:
        drops = base.fitted.score(joints, others.columns).drop
        first = {others.effects[k].key() for k in np.argsort(-drops)[:_MOST]}
        others = others.where(lambda one: one.key() in first)
    judge = Judge(base, base.beside([*base.effects, effect]).residuals())

    def candidate(one, columns):
        squares = base.fitted.score(joints, columns).squares
        evidence = compare(*base.relevant(one, base.squares, squares))
        return Candidate(
            effect=one,
            evidence=replace(evidence, p_value=1.0),
            squares=squares,
            white=judge.score(joints, columns),
        )

    best = candidate(effect, view.columns_of(effect, base.motion)[:, :, None])
    found = [
        candidate(one, others.columns[:, :, [k]])
        for k, one in enumerate(others.effects)
    ]

    def error(one):
        return base.relevant(effect, one.white)[0]

    close = [one for one in found if no_worse(error(best), error(one))]
    return tuple(sorted(close, key=lambda one: error(one).sum()))
