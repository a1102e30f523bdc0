"""Poses that determine the gravity torque of a robot best."""

import numpy as np

from sklearn_vbjfa.design import Clearance
from sklearn_vbjfa.model import load_model, position_range
from sklearn_vbjfa.robot import RigidBodyFeatures
from sklearn_vbjfa.robot._bodies import DESCRIBED, Description

# Random poses that are compared.
_CANDIDATES = 300
# How far before a pose its approach begins [rad or m], and the noise of a torque that
# nobody has measured, as a share of the gravity torque.
_APPROACH, _NOISE = 0.05, 0.02


def random_poses(robot, n=_CANDIDATES, random_state=0, margin=0.0):
    """Draw positions (n, nv) inside the joint limits in which no links touch."""
    model = load_model(robot)
    low, high = position_range(model)
    random = np.random.default_rng(random_state)
    q = random.uniform(low + margin, high - margin, (2 * n, model.nv))
    clearance, _ = Clearance.of(robot, model=model)
    if clearance is not None:
        free = np.array([clearance.smallest(one[None]) > 0 for one in q])
        q = q[free] if free.any() else q
    return q[:n]


def gravity_rows(features, q):
    """Gravity torques by inertial parameters, (n, nv, 10 nv)."""
    rest = np.zeros_like(q)
    rows = features.transform(np.hstack([q, rest, rest]))
    nv = q.shape[1]
    return rows.reshape(len(q), nv, nv, -1)[..., :10].reshape(len(q), nv, -1)


def chosen_poses(rows, covariance, noise, n):
    """Choose n rows (n, nv, p), each of which narrows the widest interval most.

    Returns their numbers, and the standard deviations (n + 1, nv) of the gravity torque
    over all rows, before and after each.
    """
    chosen, widths = [], []
    while True:
        across = rows @ covariance
        variance = np.einsum("kjp,kjp->kj", across, rows).mean(axis=0)
        widths.append(np.sqrt(variance))
        if len(chosen) == n:
            return chosen, np.array(widths)
        spread = across @ rows.transpose(0, 2, 1) + np.diag(noise**2)
        gains = np.linalg.inv(spread)
        # What each pose would take away of the widest variance, summed over all poses.
        shared = across[:, variance.argmax()] @ rows.transpose(0, 2, 1)
        best = int(np.einsum("kmj,kji,kmi->k", shared, gains, shared).argmax())
        told = across[best]
        covariance = covariance - told.T @ gains[best] @ told
        chosen.append(best)


def gravity_poses(model, n_poses=20, *, random_state=0):
    """Choose poses that determine the gravity torque of a described robot.

    Parameters
    ----------
    model : str or os.PathLike
        URDF or MJCF file. Poses lie inside its joint limits; links do not touch if it
        has collision geometry.
    n_poses : int, default=20
        Number of poses.
    random_state : int, default=0
        Seed of the candidates.

    Returns
    -------
    q : ndarray of shape (4 * n_poses, nv)
        Way points [rad or m] in the order in which they are visited: for each pose a
        point before it, the pose, a point beyond it, and the pose again, so that every
        joint comes to it from both sides.
    hold : ndarray of shape (4 * n_poses,)
        Time [s] to stay at each way point: 1 s at the poses, 0 s elsewhere.

    Raises
    ------
    ValueError
        If the description has no masses.
    """
    features = RigidBodyFeatures(model, friction=()).load()
    nv = features.n_joints_
    bodies = described(features)
    covariance = np.zeros((10 * nv, 10 * nv))
    for places, root in zip(bodies.places, bodies.root):
        inverse = DESCRIBED * np.linalg.inv(root)
        covariance[np.ix_(places, places)] = inverse @ inverse.T
    q = random_poses(model, random_state=random_state, margin=_APPROACH)
    rows = gravity_rows(features, q)
    size = np.sqrt(((rows @ bodies.vector(10 * nv)) ** 2).mean(axis=0))
    noise = _NOISE * np.maximum(size, 0.01 * size.max())
    numbers, _ = chosen_poses(rows, covariance, noise, n_poses)
    way = np.repeat(_in_order(q[numbers]), 4, axis=0)
    way[0::4] -= _APPROACH
    way[2::4] += _APPROACH
    return way, np.tile([0.0, 1.0, 0.0, 1.0], n_poses)


def described(features):
    """Return the bodies of a description; refuse one without masses."""
    bodies = Description.of(features.model_, 10)
    if bodies is None:
        raise ValueError(
            "The description has no link with mass and inertia; gravity compensation "
            "corrects the masses of a description. Add <inertial> to its links, with "
            "rough masses at least."
        )
    return bodies


def _in_order(q):
    """Order poses so that each is the nearest of the rest."""
    left, order = list(range(1, len(q))), [0]
    while left:
        near = min(left, key=lambda k: np.abs(q[k] - q[order[-1]]).max())
        left.remove(near)
        order.append(near)
    return q[order]
