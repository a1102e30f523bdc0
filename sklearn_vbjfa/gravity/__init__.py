"""Gravity compensation: correct a description from poses and slow motion."""

import warnings
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.design import Clearance
from sklearn_vbjfa.effects import stops
from sklearn_vbjfa.equations import RigidBodyFeatures, StateEstimator
from sklearn_vbjfa.fit import FitOptions, RobotIdentifier
from sklearn_vbjfa.fit._bodies import DESCRIBED, BodyPrior
from sklearn_vbjfa.model import load_model, nominal_parameters, position_range
from sklearn_vbjfa.recording import Recording
from sklearn_vbjfa.robot._channels import HALF_WIDTH

__all__ = ["correct_gravity", "gravity_poses"]
# Samples: length of a window [s], share of the fastest speed that is rest, torque of
# motion over that of gravity, way over the range after which friction is full, and
# share of it that counts as full.
_WINDOW, _REST, _DYNAMIC, _WAY, _FULL = 0.2, 0.02, 0.2, 0.003, 0.9
# Speed [rad/s or m/s] that stands for a direction: its Coriolis torques are nothing.
_DIRECTION = 1e-4
# Folds, contiguous in time; range [rad or m] of one pose; share of the described weight
# in torques without any; deviations and nats that decide.
_FOLDS, _ONE_POSE, _NO_WEIGHT, _SURE, _RIVAL = 4, 0.2, 0.3, 3.0, 3.0
# Random poses that are compared, those that are proposed, way [rad or m] of an
# approach, and noise of the torque over gravity where nobody has measured it.
_CANDIDATES, _PROPOSED, _APPROACH, _NOISE = 300, 5, 0.05, 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class GravityCorrection:
    """Gravity torque of a robot as described and as corrected.

    Attributes
    ----------
    identifier : RobotIdentifier
        Fitted to all samples; exports the corrected description.
    samples : Recording
        Poses and slow motion that were fitted, one row each.
    error_before, error_after : ndarray of shape (nv,)
        Root mean square error of the torque at held-out samples [N m or N], friction
        fitted in both cases; nan for fewer than two poses.
    gravity : ndarray of shape (nv,)
        Root mean square of the corrected gravity torque [N m or N]; zero for a
        vertical axis.
    interval, next_interval : ndarray of shape (nv,)
        Half width of the 90 % interval of the gravity torque [N m or N] over random
        poses, now and after `next_poses`.
    next_poses : ndarray of shape (5, nv)
        Poses [rad or m] to record next.
    friction_known : ndarray of shape (nv,), bool
        Joints that came to their poses from both sides; of the others friction and a
        constant offset of the torque cannot be separated.
    payload : tuple of float or None
        Mass of a payload at the last link and its standard deviation [kg], if it
        explains the torques as well as the corrected links do.
    covariance : ndarray of shape (10 nv, 10 nv)
        Of the inertial parameters.
    """

    identifier: RobotIdentifier
    samples: Recording
    error_before: np.ndarray
    error_after: np.ndarray
    gravity: np.ndarray
    interval: np.ndarray
    friction_known: np.ndarray
    payload: tuple | None
    next_poses: np.ndarray
    next_interval: np.ndarray
    covariance: np.ndarray

    def interval_at(self, q):
        """Half width (n, nv) of the 90 % interval of the gravity torque at poses q."""
        rows = gravity_rows(self.identifier.features_, np.asarray(q, dtype=float))
        return HALF_WIDTH * np.sqrt(_variances(rows, rows @ self.covariance))


def correct_gravity(recording, model):
    """Correct the masses of a description by poses and slow motion.

    Bodies are near those of the description (``bodies="prior"`` of `RobotIdentifier`)
    and physically consistent; Coulomb friction acts against the motion with which a
    joint came to its pose.

    Parameters
    ----------
    recording : Recording
        Positions and torques, with poses held for 0.4 s or longer, or slow motion.
    model : str or os.PathLike
        URDF or MJCF file of the robot.

    Returns
    -------
    GravityCorrection

    Raises
    ------
    ValueError
        If there are no poses, or one only; the torques contain no weight; or the
        description has no masses.
    """
    features, described = _described(model)
    nv = features.n_joints_
    samples = static_samples(recording, features)
    rows = gravity_rows(features, samples.q)
    _check_weight(samples, rows @ described.vector(10 * nv))
    before, after = _held_out(samples, model)
    _, identifier = _fitted(samples, model, slice(None))
    inertial = np.arange(identifier.theta_.size).reshape(nv, -1)[:, :10].ravel()
    covariance = identifier.robot_.prediction_covariance.covariance
    covariance = covariance[np.ix_(inertial, inertial)]
    # What neither torques nor description tell moves no gravity torque.
    covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    poses = _random_poses(model)
    at_poses = gravity_rows(features, poses)
    gravity = np.sqrt(((at_poses @ identifier.theta_[inertial]) ** 2).mean(axis=0))
    # A pose is recorded from both sides.
    noise = np.maximum(identifier.output_noise_, 1e-9 * gravity.max()) / np.sqrt(2.0)
    chosen, now, then = _best_poses(at_poses, covariance, noise, _PROPOSED)
    side = samples.states[:, nv : 2 * nv]
    return GravityCorrection(
        identifier=identifier,
        samples=samples,
        error_before=before,
        error_after=after,
        gravity=np.where(gravity > 1e-6 * gravity.max(), gravity, 0.0),
        interval=HALF_WIDTH * now,
        friction_known=(side > 0).any(axis=0) & (side < 0).any(axis=0),
        payload=_payload(identifier, samples, rows, described.vector(10 * nv)),
        next_poses=poses[chosen],
        next_interval=HALF_WIDTH * then,
        covariance=covariance,
    )


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
        Way points [rad or m] in their order: for each pose a point before it, the pose,
        a point beyond it, and the pose again, so that joints come from both sides.
    hold : ndarray of shape (4 * n_poses,)
        Time [s] to stay at each way point: 1 s at the poses, 0 s elsewhere.

    Raises
    ------
    ValueError
        If the description has no masses.
    """
    features, bodies = _described(model)
    size = 10 * features.n_joints_
    covariance = np.zeros((size, size))
    for places, root in zip(bodies.places, bodies.root):
        inverse = DESCRIBED * np.linalg.inv(root)
        covariance[np.ix_(places, places)] = inverse @ inverse.T
    q = _random_poses(model, random_state, margin=_APPROACH)
    rows = gravity_rows(features, q)
    torque = np.sqrt(((rows @ bodies.vector(size)) ** 2).mean(axis=0))
    noise = _NOISE * np.maximum(torque, 0.01 * torque.max())
    left = list(q[_best_poses(rows, covariance, noise, n_poses)[0]])
    order = [left.pop(0)]
    while left:
        # The nearest comes next.
        near = np.argmin([np.abs(pose - order[-1]).max() for pose in left])
        order.append(left.pop(near))
    way = np.repeat(order, 4, axis=0)
    way[0::4] -= _APPROACH
    way[2::4] += _APPROACH
    return way, np.tile([0.0, 1.0, 0.0, 1.0], n_poses)


def gravity_rows(features, q):
    """Gravity torques by inertial parameters, (n, nv, 10 nv)."""
    rest, (n, nv) = np.zeros_like(q), q.shape
    rows = features.transform(np.hstack([q, rest, rest])).reshape(n, nv, nv, -1)
    return rows[..., :10].reshape(n, nv, -1)


def _described(model):
    """Return features and bodies of a description; refuse one without masses."""
    features = RigidBodyFeatures(model, friction=()).load()
    bodies = BodyPrior.of(features.model_, 10)
    if bodies is None:
        raise ValueError(
            "The description has no link with mass and inertia; gravity compensation "
            "corrects the masses of a description. Add <inertial> to its links, with "
            "rough masses at least."
        )
    return features, bodies


def _random_poses(robot, random_state=0, margin=0.0):
    """Draw positions (n, nv) inside the joint limits in which no links touch."""
    model = load_model(robot)
    low, high = position_range(model)
    random = np.random.default_rng(random_state)
    q = random.uniform(low + margin, high - margin, (2 * _CANDIDATES, model.nv))
    clearance, _ = Clearance.of(robot, model=model)
    if clearance is not None:
        free = np.array([clearance.nearest(one[None])[0] > 0 for one in q])
        q = q[free] if free.any() else q
    return q[:_CANDIDATES]


def _variances(rows, across):
    """Variances (n, nv) of torques from rows (n, nv, p) and rows times covariance."""
    return np.maximum(np.einsum("kjp,kjp->kj", across, rows), 0.0)


def _best_poses(rows, covariance, noise, n):
    """Choose n rows (n, nv, p), each of which narrows the widest interval most.

    Returns their numbers, and the standard deviations (nv,) of the gravity torque over
    all rows before and after.
    """
    chosen, widths = [], []
    while True:
        across = rows @ covariance
        widths.append(np.sqrt(_variances(rows, across).mean(axis=0)))
        if len(chosen) == n:
            return chosen, widths[0], widths[-1]
        gains = across @ rows.transpose(0, 2, 1) + np.diag(noise**2)
        gains = np.linalg.inv(gains)
        # What each pose would take away of the widest variance, summed over all poses.
        shared = across[:, widths[-1].argmax()] @ rows.transpose(0, 2, 1)
        best = int(np.einsum("kmj,kji,kmi->k", shared, gains, shared).argmax())
        covariance = covariance - across[best].T @ gains[best] @ across[best]
        chosen.append(best)


def static_samples(recording, features):
    """Return one row for each pose, and for each window of slow motion."""
    # In place of the velocity `states` has the direction in which each joint came to
    # its pose: the Coulomb column of the identifier is then the friction that holds it.
    # Weights are zero where that direction is unknown.
    inertial, states = nominal_parameters(features.model_), recording.states
    if states is None:
        estimator = StateEstimator(recording.dt)
        states = estimator.fit_transform(recording.q, groups=recording.groups)
    q, v, a = np.split(states, 3, axis=1)
    gravity = features.torques(q, 0 * v, 0 * a, inertial)
    dynamic = features.torques(q, v, a, inertial) - gravity
    size = np.sqrt((gravity**2).mean(axis=0))
    slow = np.abs(dynamic) <= _DYNAMIC * np.maximum(size, 0.1 * size.max())
    still = np.abs(v) <= _REST * np.percentile(np.abs(v), 99.5, axis=0)
    length = max(1, round(_WINDOW / recording.dt)) if recording.dt else 1
    spans = _spans(slow.all(axis=1), still.all(axis=1), recording.segments, length)
    if not spans:
        raise ValueError(
            "The recording holds neither poses nor slow motion: gravity needs poses "
            f"that are held for {2 * _WINDOW:g} s, or motion whose torque is at least "
            f"{1 - _DYNAMIC:.0%} gravity and friction. Record poses, or identify the "
            "robot from this motion without --for gravity."
        )
    # Friction opposes the last motion in full after a way.
    ways = np.maximum(_WAY * np.ptp(q, axis=0), np.finfo(float).tiny)
    came = np.empty_like(q)
    for part in recording.segments:
        for j, way in enumerate(ways):
            came[part, j] = stops(q[part, j], np.array([way]))[:, 0]
    pose, tau, side = (
        np.array([x[a:b].mean(axis=0) for a, b in spans])
        for x in (q, recording.tau - dynamic, came)
    )
    known = np.abs(side) >= _FULL
    side = np.sign(side) * known
    # Friction from one side only is part of the offset.
    side *= (side > 0).any(axis=0) & (side < 0).any(axis=0)
    return replace(
        recording,
        q=pose,
        tau=tau,
        states=np.hstack([pose, _DIRECTION * side, 0 * pose]),
        weight=known.astype(float),
        groups=np.zeros(len(pose), dtype=int),
        group_names=("poses",),
        t=None,
        v=None,
        dt=None,
        signals={},
    )


def _spans(slow, still, parts, length):
    """Find (first, end) of the poses and of the windows of slow motion."""
    found = []
    for part in parts:
        edges = np.flatnonzero(np.diff(np.r_[0, still[part], 0])) + part.start
        # The first half of a window settles.
        poses = [(a + length // 2, b) for a, b in edges.reshape(-1, 2)]
        found += [(a, b) for a, b in poses if b - a >= 2 * length - length // 2]
        for a in range(part.start, part.stop - length + 1, length):
            if (slow & ~still)[a : a + length].all():
                found.append((a, a + length))
    return sorted(found)


def _fitted(samples, model, rows):
    """Fit friction beside the described bodies, and beside corrected ones."""
    # A joint with fewer samples than parameters would fit them exactly: the noise of
    # the joints is that which the described bodies, and then the fitted ones, leave.
    fits, precisions = [], None
    states, tau, weight = samples.states[rows], samples.tau[rows], samples.weight[rows]
    for bodies in ("fixed", "prior", "prior"):
        found = RobotIdentifier(
            model,
            friction=("coulomb", "offset"),
            bodies=bodies,
            options=FitOptions(standstill=None, joint_weights=precisions),
        )
        with warnings.catch_warnings():
            # Poses are few rows, and nothing is filtered.
            warnings.simplefilter("ignore", UserWarning)
            found.fit(states, tau, sample_weight=weight)
        fits.append(found)
        squares = weight * (tau - found.predict(states)) ** 2
        variance = squares.sum(axis=0) / np.maximum(weight.sum(axis=0), 1.0)
        precisions = 1.0 / np.maximum(variance, 1e-9 * variance.max())
    return fits[0], fits[-1]


def _held_out(samples, model):
    """Errors (nv,) of both fits on contiguous folds, each predicted by the rest."""
    n, nv = samples.tau.shape
    if n < 2:
        return np.full((2, nv), np.nan)
    squares = np.zeros((2, n, nv))
    for fold in np.array_split(np.arange(n), min(_FOLDS, n)):
        rows = ~np.isin(np.arange(n), fold)
        for one, found in zip(squares, _fitted(samples, model, rows)):
            one[fold] = (samples.tau[fold] - found.predict(samples.states[fold])) ** 2
    return np.sqrt((samples.weight * squares).sum(axis=1) / samples.weight.sum(axis=0))


def _explained(samples, columns, tau, weight):
    """Fit columns (n, nv, k) beside friction; the first coefficient with its deviation.

    Also returns the weighted square sum of what is left.
    """
    n, nv = tau.shape
    joints, friction = np.arange(nv), np.zeros((n, nv, 2 * nv))
    friction[:, joints, joints] = np.sign(samples.states[:, nv : 2 * nv])
    friction[:, joints, nv + joints] = 1.0
    A = np.concatenate([columns, friction], axis=2) * weight[:, :, None]
    A, y = A.reshape(n * nv, -1), (tau * weight).ravel()
    found = np.linalg.lstsq(A, y)[0]
    squares = ((y - A @ found) ** 2).sum()
    freedom = max(np.count_nonzero(weight) - len(found), 1)
    std = np.sqrt(np.linalg.pinv(A.T @ A)[0, 0] * squares / freedom)
    return float(found[0]), float(std), squares


def _check_weight(samples, gravity):
    """Refuse a single pose, and torques that do not contain the described weight."""
    if (np.ptp(samples.q, axis=0) < _ONE_POSE).all():
        raise ValueError(
            "All poses are the same to 0.2 rad: one pose does not determine masses. "
            "Record poses over the range of the joints; `sklearn-vbjfa design --urdf "
            "ROBOT.urdf --for gravity` proposes some."
        )
    columns = gravity[:, :, None]
    factor, std, _ = _explained(samples, columns, samples.tau, samples.weight)
    if gravity.any() and factor + _SURE * std < _NO_WEIGHT:
        raise ValueError(
            f"The torques contain no weight: {factor:.2f} ± {HALF_WIDTH * std:.2f} "
            "times the described gravity torque. The controller has probably "
            "subtracted its gravity model; record the torques before that."
        )


def _payload(identifier, samples, rows, theta):
    """Mass of a payload and its deviation, if it explains the torques as well."""
    # The description with mass and first moments of something at the last link.
    weight = samples.weight / np.maximum(identifier.output_noise_, 1e-300)
    last = rows[:, :, -10:-6]
    mass, std, squares = _explained(samples, last, samples.tau - rows @ theta, weight)
    predicted = identifier.predict(samples.states)
    other = (((samples.tau - predicted) * weight) ** 2).sum()
    count = np.count_nonzero(weight)
    # The corrected links have more freedom; each direction that the poses determine
    # is worth half the logarithm of their number.
    bodies = ~identifier.from_description_ & (np.abs(identifier.theta_std_) > 0)
    freedom = max(bodies.sum() - 2 * samples.nv - 4, 0)
    behind = 0.5 * count * np.log(squares / other) - 0.5 * freedom * np.log(count)
    return (mass, std) if behind < _RIVAL and mass > _SURE * std else None
