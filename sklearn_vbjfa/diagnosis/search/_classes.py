"""Effects of a robot's geometry that one recording cannot tell from each other.

A tilt of the base turns the whole robot, and so does the axis of its first joint; the
zero of a joint is a turn of what it carries, and so is the axis of its neighbour.
Where columns are equal the effects are one class, named by its simplest member.
"""

import itertools

import numpy as np

from sklearn_vbjfa.diagnosis.search._evidence import no_worse
from sklearn_vbjfa.diagnosis.search._regression import LEAST_RIDGE
from sklearn_vbjfa.diagnosis.search._shapes import settled

# Columns are equal if this share of what the model does not explain of them, or less,
# is outside the other's.
_EQUAL = 1e-3


def one_of_class(model, candidates):
    """Return the simplest of the best candidates, and those that compare with it.

    Parameters
    ----------
    model : SearchModel
        Beside which they were tried.
    candidates : list of Candidate
        Effects that act on all joints.
    """
    error = {id(c): c.squares @ model.precision for c in candidates}
    best = min(candidates, key=lambda c: error[id(c)].sum())
    close = [c for c in candidates if no_worse(error[id(best)], error[id(c)])]
    simplest = min(
        close,
        key=lambda c: (c.effect.complexity, c.effect.precedence, error[id(c)].sum()),
    )
    for other in sorted(close, key=lambda c: c.effect.precedence):
        # One that comes before it and says the same, if of more than is needed.
        before = other.effect.precedence < simplest.effect.precedence
        if before and stands_for(model, other.effect, simplest.effect):
            simplest = other
            break
    near = [c for c in close if c is not simplest]
    for other in candidates:
        if other is simplest or other in near:
            continue
        pair = simplest.effect, other.effect
        # What contains the one that is named explains all that it does; a part of it
        # may do as well once the robot is corrected.
        if stands_for(model, *pair[::-1]) or (
            stands_for(model, *pair)
            and no_worse(*(_settled(model, effect) for effect in pair))
        ):
            near.append(other)
    return simplest, tuple(near)


def _settled(model, effect):
    """Errors of blocks (n_blocks,) with an effect whose value has settled."""
    trial = settled(effect, model.effects, model)
    return trial.squares @ model.precision


def inseparable(model, effects):
    """Pairs of effects of which a model can tell only one from everything else.

    Parameters
    ----------
    model : SearchModel
        Beside which they would be.
    effects : list of Effect
        Effects in the robot model, each of which shows.

    Yields
    ------
    effect, other : Effect
        Nothing is left of the columns of the first beside those of the other, which
        comes before it in precedence or in the list.
    """
    if len(effects) < 2:
        return
    columns = [model.columns_on_all(effect) for effect in effects]
    edges = np.cumsum([0, *(own.shape[2] for own in columns)])
    places = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    left = model.fitted.left_gram(np.concatenate(columns, axis=2))
    order = sorted(range(len(effects)), key=lambda i: (effects[i].precedence, i))
    for k, i in enumerate(order):
        a = places[i]
        alone = np.diagonal(left[a, a])
        for b, other in ((places[j], effects[j]) for j in order[:k]):
            inverse = np.linalg.pinv(left[b, b], hermitian=True)
            beside = np.diagonal(left[a, a] - left[a, b] @ inverse @ left[b, a])
            if (beside <= _EQUAL * alone).all():
                yield effects[i], other
                break


def stands_for(model, effect, other):
    """Whether the columns of an effect span those of another beside a model.

    A ridge would leave something of equal columns.
    """
    joints, columns = model.view.joints_of(other), model.columns_of(other)[:, :, None]
    alone, beside = (
        model.beside(effects, LEAST_RIDGE).fitted.outside(joints, columns)
        for effects in (model.effects, [*model.effects, effect])
    )
    return bool((beside <= _EQUAL * alone).all())
