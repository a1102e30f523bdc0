"""Signs of unsigned torques by expectation maximisation."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa.fit._fit import fit_robot
from sklearn_vbjfa.inspection import most_explaining, signed_columns
from sklearn_vbjfa.model import nominal_parameters

# Maximum number of fits, and relative change of the torque at convergence.
_MAX_PASSES, _TOLERANCE = 30, 1e-4
# Signs of a joint are uncertain above this share of unexplained power.
_MAX_RESIDUAL = 0.05
# Minimum variance relative to the largest squared torque (rounding).
_ROUNDING = 1e-16


def with_signs(recipe, robot, data, previous):
    """Estimate the signs of unsigned torques; return the signed `FitData`."""
    # robot: without parameters; previous: as for `fit_robot`.
    recording = data.recording
    sizes, weight = recording.tau, recording.weight

    def fitted(tau, weight=weight):
        changed = replace(recording, tau=tau, weight=weight)
        return fit_robot(
            recipe, robot, replace(data, recording=changed), previous
        ).robot

    bodies = nominal_parameters(robot.features_.model_)
    tau, doubtful = _initial_signs(robot.features_, data, bodies)
    if doubtful.any() and not doubtful.all():
        # The joints that carry them determine the bodies of uncertain joints.
        base_weight = np.ones(sizes.shape) if weight is None else weight
        base = fitted(tau, np.where(doubtful, 0.0, base_weight)).torque_model()
        refined, _ = _initial_signs(robot.features_, data, base.bodies)
        tau = np.where(doubtful, refined, tau)
    for _ in range(_MAX_PASSES):
        updated = signed(fitted(tau), recording).tau
        change = np.sqrt(((updated - tau) ** 2).mean(axis=0))
        tau = updated
        if (change <= _TOLERANCE * np.sqrt((sizes**2).mean(axis=0))).all():
            break
    return replace(data, recording=replace(recording, tau=tau, command=tau))


def signed(robot, recording):
    """Replace torque magnitudes by their expectation given a fitted robot."""
    inputs = robot.prepare_recording(replace(recording, weight=None))
    rest = robot.plan.prediction_rest(robot.plan.state_estimator)
    predicted = robot.readings(replace(inputs, rest=rest))
    tau = expected(recording.tau, predicted)
    return replace(recording, tau=tau, command=tau)


def expected(sizes, predicted):
    """Return expected torques (n, nv) over both signs, given predictions."""
    variance = ((sizes - np.abs(predicted)) ** 2).mean(axis=0)
    variance = np.maximum(variance, np.finfo(float).tiny + _ROUNDING * sizes.max() ** 2)
    return sizes * np.tanh(sizes * predicted / variance)


def _initial_signs(features, data, bodies):
    """Return torques (n, nv) with initial signs, and joints (nv,) of uncertain sign."""
    sizes = data.recording.tau
    states = np.vstack([states[slice(None)] for states in data.states.full])
    A = signed_columns(states, features.torques(*np.split(states, 3, axis=1), bodies))
    coefficients = [most_explaining(x, sizes[:, j]) for j, x in enumerate(A)]
    predicted = np.column_stack([x @ coef for x, coef in zip(A, coefficients)])
    residual = ((sizes - np.abs(predicted)) ** 2).sum(axis=0)
    doubtful = residual > _MAX_RESIDUAL * (sizes**2).sum(axis=0)
    return np.where(predicted < 0, -sizes, sizes), doubtful
