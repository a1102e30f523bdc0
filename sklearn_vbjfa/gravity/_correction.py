"""Correction of a description by the torques of poses and slow motion."""

import warnings
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.gravity._poses import (
    chosen_poses,
    described,
    gravity_rows,
    random_poses,
)
from sklearn_vbjfa.gravity._samples import static_samples
from sklearn_vbjfa.recording import Recording
from sklearn_vbjfa.robot import RigidBodyFeatures, RobotIdentifier
from sklearn_vbjfa.robot._gains import HALF_WIDTH

# Folds of the cross-validation, contiguous in time.
_FOLDS = 4
# Positions of less than this range [rad or m] are one pose.
_ONE_POSE = 0.2
# Torques whose weight is this share of the described one, at most, contain none.
_NO_WEIGHT = 0.3
# Deviations and nats that decide: of the weight, and of a payload as a rival.
_SURE, _RIVAL = 3.0, 3.0
# Poses that are proposed, and the share of the largest gravity torque that is none.
_PROPOSED, _NONE = 5, 1e-6
_FRICTION = ("coulomb", "offset")


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
    interval : ndarray of shape (nv,)
        Half width of the 90 % interval of the gravity torque [N m or N], over random
        poses.
    friction_known : ndarray of shape (nv,), bool
        Joints that came to their poses from both sides. Where they did not, friction
        and a constant offset of the torque cannot be separated.
    payload : tuple of float or None
        Mass of a payload at the last link and its standard deviation [kg], if it
        explains the torques as well as the corrected links do.
    next_poses : ndarray of shape (5, nv)
        Poses [rad or m] to record next, in the order of what they add.
    next_interval : ndarray of shape (5, nv)
        `interval` after each of them.
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
        """Half width of the 90 % interval of the gravity torque at poses.

        Parameters
        ----------
        q : array-like of shape (n, nv)
            Positions [rad or m].

        Returns
        -------
        ndarray of shape (n, nv)
            Torques [N m] or forces [N].
        """
        q = np.asarray(q, dtype=float)
        rows = gravity_rows(self.identifier.features_, q)
        variance = np.einsum("kjp,pr,kjr->kj", rows, self.covariance, rows)
        return HALF_WIDTH * np.sqrt(np.maximum(variance, 0.0))


def correct_gravity(recording, model):
    """Correct the masses of a description by poses and slow motion.

    Bodies are near those of the description (``bodies="prior"`` of `RobotIdentifier`)
    and physically consistent; Coulomb friction acts against the motion with which a
    joint came to its pose.

    Parameters
    ----------
    recording : Recording
        Positions and torques, with poses that are held for 0.4 s or longer, or slow
        motion.
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
    features = RigidBodyFeatures(model, friction=()).load()
    theta = described(features).vector(10 * features.n_joints_)
    samples = static_samples(recording, features)
    if (np.ptp(samples.q, axis=0) < _ONE_POSE).all():
        raise ValueError(
            "All poses are the same to 0.2 rad: one pose does not determine masses. "
            "Record poses over the range of the joints; "
            "`sklearn-vbjfa design --urdf ROBOT.urdf --for gravity` proposes some."
        )
    factor, std = _weight(samples, gravity_rows(features, samples.q) @ theta)
    if factor + _SURE * std < _NO_WEIGHT:
        raise ValueError(
            f"The torques contain no weight: {factor:.2f} ± {std:.2f} times the "
            "described gravity torque. The controller has probably subtracted its "
            "gravity model; record the torques before that."
        )
    error_before, error_after = _held_out(samples, model)
    _, identifier = _fitted(samples, model, np.ones(samples.n_samples, bool))
    robot = identifier.robot_
    inertial = np.arange(identifier.theta_.size).reshape(features.n_joints_, -1)[:, :10]
    inertial = inertial.ravel()
    covariance = robot.prediction_covariance.covariance[np.ix_(inertial, inertial)]
    # What neither torques nor description tell moves no gravity torque.
    covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    poses = random_poses(model)
    rows = gravity_rows(features, poses)
    gravity = np.sqrt(((rows @ identifier.theta_[inertial]) ** 2).mean(axis=0))
    noise = np.maximum(identifier.output_noise_, 1e-9 * gravity.max())
    # A pose is recorded from both sides.
    numbers, stds = chosen_poses(rows, covariance, noise / np.sqrt(2.0), _PROPOSED)
    side = samples.states[:, features.n_joints_ : 2 * features.n_joints_]
    return GravityCorrection(
        identifier=identifier,
        samples=samples,
        error_before=error_before,
        error_after=error_after,
        gravity=np.where(gravity > _NONE * gravity.max(), gravity, 0.0),
        interval=HALF_WIDTH * stds[0],
        friction_known=(side > 0).any(axis=0) & (side < 0).any(axis=0),
        payload=_payload(identifier, samples, features, theta),
        next_poses=poses[numbers],
        next_interval=HALF_WIDTH * stds[1:],
        covariance=covariance,
    )


def _fitted(samples, model, rows):
    """Fit friction beside the described bodies, and beside corrected ones."""
    # A joint with fewer samples than parameters would fit them exactly: the noise of
    # the joints is that which the described bodies, and then the fitted ones, leave.
    fits, weights = [], None
    for bodies in ("fixed", "prior", "prior"):
        found = RobotIdentifier(
            model,
            friction=_FRICTION,
            bodies=bodies,
            standstill=None,
            joint_weights=weights,
        )
        with warnings.catch_warnings():
            # Poses are few rows, and nothing is filtered.
            warnings.simplefilter("ignore", UserWarning)
            found.fit(
                samples.states[rows],
                samples.tau[rows],
                sample_weight=samples.weight[rows],
            )
        fits.append(found)
        weights = _precisions(samples, rows, found)
    return fits[0], fits[-1]


def _precisions(samples, rows, found):
    """Inverse variances (nv,) of what a fit leaves of the samples."""
    left = samples.tau[rows] - found.predict(samples.states[rows])
    weight = samples.weight[rows]
    variance = (weight * left**2).sum(axis=0) / np.maximum(weight.sum(axis=0), 1.0)
    return 1.0 / np.maximum(variance, 1e-9 * variance.max())


def _held_out(samples, model):
    """Errors (nv,) of both fits on contiguous folds, each predicted by the rest."""
    n = samples.n_samples
    squares = np.zeros((2, *samples.tau.shape))
    for fold in np.array_split(np.arange(n), min(_FOLDS, n)):
        rows = np.ones(n, dtype=bool)
        rows[fold] = False
        if not rows.any():
            return np.full((2, samples.tau.shape[1]), np.nan)
        for one, found in zip(squares, _fitted(samples, model, rows)):
            one[fold] = (samples.tau[fold] - found.predict(samples.states[fold])) ** 2
    return np.sqrt((samples.weight * squares).sum(axis=1) / samples.weight.sum(axis=0))


def _weight(samples, gravity):
    """Factor of the described gravity torque in the torques, and its deviation."""
    nv = gravity.shape[1]
    left = []
    for j, side in enumerate(np.sign(samples.states[:, nv : 2 * nv]).T):
        rows = samples.weight[:, j] > 0
        plain = np.column_stack([side, np.ones(side.size)])[rows]
        pair = np.column_stack([gravity[rows, j], samples.tau[rows, j]])
        left.append(pair - plain @ np.linalg.lstsq(plain, pair)[0])
    described, measured = np.concatenate(left).T
    size = described @ described
    if size == 0:
        return 1.0, np.inf
    factor = described @ measured / size
    return factor, np.sqrt(((measured - factor * described) ** 2).mean() / size)


def _payload(identifier, samples, features, theta):
    """Mass of a payload and its deviation, if it explains the torques as well."""
    # The description with four more parameters, mass and first moments of the last
    # link, by weighted least squares.
    nv = features.n_joints_
    rows = gravity_rows(features, samples.q)
    weight = samples.weight / np.maximum(identifier.output_noise_, 1e-300)
    side = np.sign(samples.states[:, nv : 2 * nv])
    last = rows[:, :, 10 * (nv - 1) : 10 * (nv - 1) + 4]
    friction = np.zeros((*side.shape, 2 * nv))
    for j in range(nv):
        friction[:, j, j], friction[:, j, nv + j] = side[:, j], 1.0
    A = np.concatenate([last, friction], axis=2) * weight[:, :, None]
    A = A.reshape(-1, 4 + 2 * nv)
    y = ((samples.tau - rows @ theta) * weight).ravel()
    found, *_ = np.linalg.lstsq(A, y)
    squares = ((y - A @ found) ** 2).sum()
    predicted = identifier.predict(samples.states)
    other = (((samples.tau - predicted) * weight) ** 2).sum()
    count = np.count_nonzero(samples.weight)
    # The corrected links have more freedom; each direction that the poses determine
    # is worth half the logarithm of their number.
    bodies = ~identifier.from_description_ & (np.abs(identifier.theta_std_) > 0)
    freedom = max(bodies.sum() - 2 * nv - 4, 0)
    behind = 0.5 * count * np.log(squares / other) - 0.5 * freedom * np.log(count)
    std = np.sqrt(np.linalg.pinv(A.T @ A)[0, 0] * squares / max(count - len(found), 1))
    sure = found[0] > _SURE * std
    return (float(found[0]), float(std)) if behind < _RIVAL and sure else None
