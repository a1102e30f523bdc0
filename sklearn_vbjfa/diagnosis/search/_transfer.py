"""What effects found in some stretches of motion are worth on the others.

Blocks that alternate between fitting and judging tell effects from noise, but each of
them lies between neighbours that were fitted. What a shape fits to the motion at hand
and to no other shows only where long stretches are left out. There a regression without
constraints extrapolates its own noise, which hides everything else; the physically
consistent one does not.
"""

import numpy as np

from sklearn_vbjfa.robot._equations import unexcited_entries
from sklearn_vbjfa.robot._estimate import estimate, project
from sklearn_vbjfa.robot._joint_moments import joint_moments

# Stretches that are left out in turn.
_STRETCHES = 3


def stretches(blocks, recording):
    """Return the stretch of each row: every recording's first third, second, last.

    What only one recording has (a payload, a warm start) is known from its other
    thirds. No block of time is cut in two.
    """
    label = np.empty(blocks.label.size, dtype=int)
    for number in np.unique(recording):
        rows = np.flatnonzero(recording == number)
        own, place = np.unique(blocks.label[rows], return_inverse=True)
        if own.size < _STRETCHES:
            # Too short to be cut: left out as a whole, in turns.
            label[rows] = number % _STRETCHES
            continue
        label[rows] = place * _STRETCHES // own.size
    return label


class Transfer:
    """Errors on stretches of motion that were not fitted.

    Parameters
    ----------
    model : SearchModel
        With all effects that are to be looked at.
    """

    def __init__(self, model):
        self._model, self._precision = model, model.precision
        self._effects = model.effects
        self._label = stretches(model.view.blocks, model.view.origin)
        self._moments = {}

    def _moments_of(self, view):
        """Moments of each stretch, with all effects, and the columns' edges."""
        if view not in self._moments:
            equations, motion = view.equations, self._model.motion
            columns = [view.in_equations(effect, motion) for effect in self._effects]
            Phi = np.concatenate([equations.Phi, *columns], axis=2)
            edges = np.cumsum([equations.Phi.shape[2], *(c.shape[2] for c in columns)])
            found = [
                joint_moments(Phi[rows], equations.tau[rows], equations.weight[rows])
                for rows in (self._label == k for k in np.unique(self._label))
            ]
            self._moments[view] = found, edges
        return self._moments[view]

    def squares(self, effects):
        """Squared errors (n_stretches, nv) of the model with some of the effects.

        Each stretch is predicted by a fit to the others.
        """
        view = self._model.view.corrected(effects)
        moments, edges = self._moments_of(view)
        there = {id(effect) for effect in effects}
        pieces = [np.arange(edges[0])]
        for i, effect in enumerate(self._effects):
            if id(effect) in there:
                pieces.append(np.arange(edges[i], edges[i + 1]))
        chosen = np.concatenate(pieces)
        moments = [one.columns(chosen) for one in moments]
        out = []
        for k, kept in enumerate(moments):
            others = [one for i, one in enumerate(moments) if i != k]
            total = sum(others[1:], start=others[0])
            theta = _consistent_parameters(total, self._precision, view.robot)
            out.append(kept.residual_squares(theta))
        return np.array(out)


def _consistent_parameters(moments, precision, robot):
    """Physically consistent parameters of a declared model from second moments."""
    features = robot.features_
    zeros = unexcited_entries(moments, features.n_parameters_)
    found = estimate(moments.zeroed(zeros), joint_weights=precision)
    return project(found, robot.projector, features).theta
