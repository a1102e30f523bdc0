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
    view : RecordingView
        Recording.
    motion : Motion
        Its signals.
    effects : sequence of Effect
        All that are to be looked at.
    precision : ndarray of shape (nv,)
        Weights of the joints.
    """

    def __init__(self, view, motion, effects, precision):
        self._robot, self._precision = view.robot, precision
        self._effects = tuple(effects)
        equations = view.equations
        columns = [view.in_equations(effect, motion) for effect in self._effects]
        Phi = np.concatenate([equations.Phi, *columns], axis=2)
        widths = [equations.Phi.shape[2], *(c.shape[2] for c in columns)]
        self._edges = np.cumsum(widths)
        label = stretches(view.blocks, view.origin)
        self._moments = [
            joint_moments(Phi[rows], equations.tau[rows], equations.weight[rows])
            for rows in (label == k for k in np.unique(label))
        ]

    def squares(self, effects):
        """Squared errors (n_stretches, nv) of the model with some of the effects.

        Each stretch is predicted by a fit to the others.
        """
        there = {id(effect) for effect in effects}
        pieces = [np.arange(self._edges[0])]
        for i, effect in enumerate(self._effects):
            if id(effect) in there:
                pieces.append(np.arange(self._edges[i], self._edges[i + 1]))
        chosen = np.concatenate(pieces)
        moments = [one.columns(chosen) for one in self._moments]
        out = []
        for k, kept in enumerate(moments):
            others = [one for i, one in enumerate(moments) if i != k]
            total = sum(others[1:], start=others[0])
            theta = _consistent_parameters(total, self._precision, self._robot)
            out.append(kept.residual_squares(theta))
        return np.array(out)


def _consistent_parameters(moments, precision, robot):
    """Physically consistent parameters of a declared model from second moments."""
    features = robot.features_
    zeros = unexcited_entries(moments, features.n_parameters_)
    found = estimate(moments.zeroed(zeros), joint_weights=precision)
    return project(found, robot.projector, features).theta
