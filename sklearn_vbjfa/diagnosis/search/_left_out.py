"""What leaving out effects of a model would cost, all of them from one fit."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.search._evidence import Evidence, compare
from sklearn_vbjfa.diagnosis.search._model import Judge
from sklearn_vbjfa.effects import Effect


@dataclass(frozen=True, kw_only=True, eq=False)
class LeftOut:
    """An effect of a model, and what leaving it out would cost.

    Attributes
    ----------
    effect : Effect
        The effect, of one joint and without a shape that is tuned.
    evidence : Evidence
        For the model with it, against the same without it.
    squares : ndarray of shape (2, nv)
        Sums of squared out-of-sample residuals without the effect and with it.
    """

    effect: Effect
    evidence: Evidence
    squares: np.ndarray


def can_be_left_out(effect):
    """Whether its columns are all that is fitted of an effect, on its own joint."""
    return not (effect.whole_robot or effect.continuous or effect.tangent)


def left_out(model, effects):
    """Leave out each of some effects of a `SearchModel` alone, list of LeftOut.

    Weights, load and ridge stay those of the model.
    """
    if not effects:
        return []
    judge = Judge(model, model.residuals())
    columns = {
        id(effect): np.arange(place.start, place.stop)
        for effect, place in zip(model.effects, model.places())
    }
    total = model.squares.sum(axis=0)
    found = []
    for joint in sorted({effect.joint for effect in effects}):
        own = [effect for effect in effects if effect.joint == joint]
        groups = [columns[id(effect)] for effect in own]
        without = model.fitted.squares_without(joint, groups)
        white = judge.without(joint, groups)
        for k, effect in enumerate(own):
            evidence = compare(
                without[:, k],
                model.squares[:, joint],
                white=(white[:, k], judge.squares[:, joint]),
            )
            before = total.copy()
            before[joint] = without[:, k].sum()
            found.append(
                LeftOut(
                    effect=effect,
                    evidence=evidence,
                    squares=np.array([before, total]),
                )
            )
    return found
