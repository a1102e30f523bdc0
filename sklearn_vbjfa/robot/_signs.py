"""Signs of torques of which only the sizes were recorded, by EM."""

from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from sklearn_vbjfa.model import nominal_parameters
from sklearn_vbjfa.robot._equations import derivative
from sklearn_vbjfa.robot._fit import fit_robot

# Rows of a joint with which its first signs are looked for.
_LOOKED_AT = 20_000
# Dry friction to begin with, in root mean squares of the rigid bodies' torque.
_STARTS = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, np.inf)
# Rounds of one joint, and of the whole robot; they end when less than this share of
# the torque moves.
_ROUNDS, _PASSES, _SETTLED = 50, 30, 1e-4
# Signs of a joint are doubtful where more than this share of its power is left.
_DOUBTFUL = 0.05
# A variance below this share of the largest squared torque is rounding.
_EXACT = 1e-16


def with_signs(recipe, robot, source, before):
    """Return the `Source` of a fit whose torques have both signs."""
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
    asked = robot.prepare_recording(replace(recording, weight=None)).noiseless(
        robot.plan
    )
    tau = expected(recording.tau, robot.torques(asked))
    return replace(recording, tau=tau, command=tau)


def expected(sizes, predicted):
    """Mean torques (n, nv) of sizes, over both signs beside predictions."""
    variance = ((sizes - np.abs(predicted)) ** 2).mean(axis=0)
    variance = np.maximum(variance, np.finfo(float).tiny + _EXACT * sizes.max() ** 2)
    return sizes * np.tanh(sizes * predicted / variance)


def _first(features, source, bodies):
    """Torques (n, nv) with likely signs, and joints (nv,) that these explain badly."""
    sizes = source.recording.tau
    lengths = [part.stop - part.start for part in source.recording.segments]
    own = [
        np.hstack([derivative(states, slice(0, n), k) for k in range(3)])
        for states, n in zip(source.states.own, lengths)
    ]
    made = signed_columns(features, np.vstack(own), bodies)
    found = [most_explaining(x, sizes[:, j]) for j, x in enumerate(made)]
    predicted = np.column_stack([x @ coef for x, coef in zip(made, found)])
    left = ((sizes - np.abs(predicted)) ** 2).sum(axis=0)
    doubtful = left > _DOUBTFUL * (sizes**2).sum(axis=0)
    return np.where(predicted < 0, -sizes, sizes), doubtful


def signed_columns(features, states, bodies=None):
    """Make the columns that torques may consist of, nv arrays (n, 5)."""
    # Rigid bodies (nv, 10), by default as described, dry and viscous friction, inertia,
    # and an offset.
    bodies = nominal_parameters(features.model_) if bodies is None else bodies
    q, v, a = np.split(states, 3, axis=1)
    rigid = features.torques(q, v, a, np.ascontiguousarray(bodies))
    one = np.ones_like(v)
    columns = rigid, np.sign(v), v, a, one
    return [np.column_stack([x[:, j] for x in columns]) for j in range(v.shape[1])]


def most_explaining(columns, sizes):
    """Coefficients of columns with which signs explain most of sizes (n,), by EM."""
    # columns: see `signed_columns`. A few thousand rows tell as much as all.
    some = slice(None, None, max(len(sizes) // _LOOKED_AT, 1))
    columns, sizes = columns[some], sizes[some]
    # All of them but the offset are positive by nature: with the other sign of all,
    # a torque has the same size.
    unit = np.sqrt((columns[:, 0] ** 2).mean()) or 1.0
    both = np.column_stack([columns, -columns[:, -1]])
    size = np.sqrt((both**2).sum(axis=0))
    both = both / np.where(size > 0, size, 1.0)
    found = []
    for share in _STARTS:
        start = columns[:, 1] if np.isinf(share) else columns[:, 0]
        if 0 < share < np.inf:
            start = start + share * unit * columns[:, 1]
        signs = np.where(start < 0, -1.0, 1.0)
        for _ in range(_ROUNDS):
            coef = nnls(both, signs * sizes)[0] / np.where(size > 0, size, 1.0)
            coef = np.append(coef[:-2], coef[-2] - coef[-1])
            new = np.where(columns @ coef < 0, -1.0, 1.0)
            if (new == signs).all():
                break
            signs = new
        found.append((((signs * sizes - columns @ coef) ** 2).sum(), len(found), coef))
    return min(found)[2]
