"""A contact: in one interval of the log something else acts on a link."""

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._hypotheses import Candidate, odds
from sklearn_vbjfa.model import import_pinocchio


def contact(reading):
    """Return an interval in which something else acts on the robot."""
    robot, wrenches = reading.few, _wrenches(reading)
    # Torques that are even suit a push of unknown place in a small motion.
    every = np.eye(reading.nv)[None, None] * np.ones((1, len(robot.signals.row), 1, 1))
    found = [_acting(reading, x) for x in (every, wrenches)]
    return max(filter(None, found), key=lambda x: x.log_odds, default=None)


def _wrenches(reading):
    """Torques (nv, n, nv, 6) by a unit force and a unit moment on each link."""
    pin, model, nv = import_pinocchio(), reading.model, reading.nv
    data, world = model.createData(), reading.few.signals.states[:, :nv]
    found = np.zeros((nv, len(world), nv, 6))
    for row, q in enumerate(world):
        pin.computeJointJacobians(model, data, q)
        for j in range(nv):
            frame = pin.LOCAL_WORLD_ALIGNED
            found[j, row] = pin.getJointJacobian(model, data, j + 1, frame).T
    size = np.sqrt((found**2).mean(axis=(1, 2), keepdims=True))
    return found / np.where(size > 0, size, 1.0)


def _acting(reading, pushes):
    """Return the interval in which one of several pushes (k, n, nv, m) acts."""
    robot = reading.few
    rows, inside = robot.signals.row, np.zeros(len(robot.signals.row), dtype=bool)
    for _ in range(number.PASSES):
        before, (place, columns) = inside, _pushed(robot, pushes, inside)
        inside = np.zeros(rows.size, dtype=bool)
        inside[slice(*place)] = True
        if (inside == before).all():
            break
    # A contact makes what is left correlated for as long as it lasts.
    times = robot.correlation_times(inside[:, None].astype(float))
    robot = robot.with_times(np.minimum(robot.times, times))
    size = robot.signals.now[:, robot.joints].std(axis=0)
    columns = columns * inside[:, None, None]
    fit, now = robot.fit(columns=columns, deviation=size.max()), robot.now
    torques = (columns @ fit.factors)[inside][:, robot.joints]
    push = np.sqrt((torques**2).mean(axis=0)) / (size * np.exp(0.5 * fit.left))
    felt = push > number.CONTACT
    # A force on a link loads the joints before it; friction of a single one varies.
    few = felt.sum() < min(robot.joints.size, 2)
    if few or fit.fall(now) < number.CLEAR_OF_JOINT:
        return None
    begin, end = (rows[min(k, rows.size - 1)] * reading.dt for k in place)
    joints = robot.joints[felt]
    each = zip(joints, torques.mean(axis=0)[felt], reading.slides[joints])
    pushes = ", ".join(
        f"{reading.names[j]} {torque:+.2g} {'N' if slides else 'N m'}"
        for j, torque, slides in each
    )
    return Candidate(
        joints=tuple(joints.tolist()),
        log_odds=odds(fit, now, rows.size),
        facts={"begin": begin, "end": end, "pushes": pushes},
    )


def _pushed(robot, pushes, inside):
    """Rows between which a push explains most of what bodies leave, and its columns."""
    # inside (n,): rows with which the bodies are not fitted.
    left = robot.residual(without=inside)[:, robot.joints]
    size = np.sqrt(np.maximum((left[~inside] ** 2).mean(axis=0), 1e-300))
    n, best, found = len(left), -np.inf, None
    ends = np.arange(0, n + 1, max(1, n // number.CONTACT_ENDS))
    first, last = np.nonzero(
        (ends - ends[:, None] >= n // number.SHORTEST_CONTACT)
        & (ends - ends[:, None] <= n // 2)
    )
    for columns in pushes:
        X = columns[:, robot.joints] / size[:, None]
        X = X / max(np.sqrt((X**2).mean()), 1e-300)
        gram, cross = (
            np.concatenate([np.zeros_like(x[:1]), x.cumsum(axis=0)])[ends]
            for x in (np.einsum("njk,njl->nkl", X, X), _products(X, left / size))
        )
        gram, cross = gram[last] - gram[first], cross[last] - cross[first]
        gram = gram + 0.1 * np.eye(gram.shape[-1])
        gain = (np.linalg.solve(gram, cross[..., None])[..., 0] * cross).sum(axis=-1)
        if gain.max() > best:
            k = int(np.argmax(gain))
            best, found = gain[k], ((ends[first[k]], ends[last[k]]), columns)
    return found


def _products(X, y):
    return np.einsum("njk,nj->nk", X, y)
