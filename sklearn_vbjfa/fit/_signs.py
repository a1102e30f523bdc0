"""Signs of unsigned torques, by EM."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa.fit._fit import fit_robot
from sklearn_vbjfa.inspection import most_explaining, signed_columns
from sklearn_vbjfa.model import nominal_parameters

# Rounds of the whole robot; they end when less than this share of the torque moves.
_PASSES, _SETTLED = 30, 1e-4
# Signs of a joint are doubtful where more than this share of its power is left.
_DOUBTFUL = 0.05
# A variance below this share of the largest squared torque is rounding.
_EXACT = 1e-16


def with_signs(recipe, robot, source, before):
    """Return the `FitData` of a fit whose torques have both signs."""
    # robot: declared, its parameters not known; before: as for `fit_robot`.
    recording = source.recording
    sizes, weight = recording.tau, recording.weight

    def fitted(tau, weight=weight):
        changed = replace(recording, tau=tau, weight=weight)
        return fit_robot(
            recipe, robot, replace(source, recording=changed), before
        ).robot

    bodies = nominal_parameters(robot.features_.model_)
    tau, doubtful = _first(robot.features_, source, bodies)
    if doubtful.any() and not doubtful.all():
        # What they move, the joints before them have moved as well.
        sure = np.ones(sizes.shape) if weight is None else weight
        bodies = fitted(tau, np.where(doubtful, 0.0, sure)).inertial()
        again, _ = _first(robot.features_, source, bodies)
        tau = np.where(doubtful, again, tau)
    for _ in range(_PASSES):
        new = signed(fitted(tau), recording).tau
        moved = np.sqrt(((new - tau) ** 2).mean(axis=0))
        tau = new
        if (moved <= _SETTLED * np.sqrt((sizes**2).mean(axis=0))).all():
            break
    return replace(source, recording=replace(recording, tau=tau, command=tau))


def signed(robot, recording):
    """Give sizes of torques their mean sign beside what a fitted robot predicts."""
    asked = robot.prepare_recording(replace(recording, weight=None))
    rest = robot.plan.rest(robot.plan.state_estimator)
    predicted = robot.torques(replace(asked, rest=rest))
    tau = expected(recording.tau, predicted)
    return replace(recording, tau=tau, command=tau)


def expected(sizes, predicted):
    """Mean torques (n, nv) of sizes, over both signs beside predictions."""
    variance = ((sizes - np.abs(predicted)) ** 2).mean(axis=0)
    variance = np.maximum(variance, np.finfo(float).tiny + _EXACT * sizes.max() ** 2)
    return sizes * np.tanh(sizes * predicted / variance)


def _first(features, source, bodies):
    """Torques (n, nv) with likely signs, and joints (nv,) that these explain badly."""
    sizes = source.recording.tau
    own = np.vstack([states[slice(None)] for states in source.states.full])
    made = signed_columns(own, features.torques(*np.split(own, 3, axis=1), bodies))
    found = [most_explaining(x, sizes[:, j]) for j, x in enumerate(made)]
    predicted = np.column_stack([x @ coef for x, coef in zip(made, found)])
    left = ((sizes - np.abs(predicted)) ** 2).sum(axis=0)
    doubtful = left > _DOUBTFUL * (sizes**2).sum(axis=0)
    return np.where(predicted < 0, -sizes, sizes), doubtful
