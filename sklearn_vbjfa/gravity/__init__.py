"""Gravity compensation: correct a description from poses and slow motion."""

import warnings
from dataclasses import replace
from itertools import islice

import numpy as np
from sklearn.model_selection import KFold
from sklearn.utils import Bunch

from sklearn_vbjfa.design import Clearance
from sklearn_vbjfa.effects import elements
from sklearn_vbjfa.equations import RigidBodyFeatures
from sklearn_vbjfa.fit import FitOptions, RobotIdentifier
from sklearn_vbjfa.fit._bodies import DESCRIBED, BodyPrior
from sklearn_vbjfa.fit._estimate import apply_description
from sklearn_vbjfa.inspection import Signals, inspect_as, refusal
from sklearn_vbjfa.model import (
    DoubtWarning,
    import_pinocchio,
    nominal_parameters,
    position_range,
)
from sklearn_vbjfa.recording._recording import check_dt
from sklearn_vbjfa.robot._channels import HALF_WIDTH

__all__ = ["correct_gravity", "gravity_poses"]
# Samples: window length [s]; speed at rest over maximum speed; maximum dynamic over
# gravity torque; travel over range after which friction is fully developed, and the
# share that counts as full; speed [rad/s or m/s] that encodes the direction of friction
# at rest; minimum period [s] of rows that are single poses.
_WINDOW, _REST, _DYNAMIC, _TRAVEL, _FULL, _DIRECTION = 0.2, 0.02, 0.2, 0.003, 0.9, 1e-4
_POSE_PERIOD = 1.0
# Folds, contiguous in time; minimum samples; range [rad or m] of one pose; standard
# deviations of a significant payload, and its maximum error over corrected links.
_FOLDS, _MIN_SAMPLES, _ONE_POSE, _SIGNIFICANT, _MAX_ERROR = 4, 5, 0.2, 3.0, 1.1
# Number of random poses, maximum `poses_enough`, torque noise over gravity before any
# measurement, and way points [rad or m] around a pose.
_CANDIDATES, _LIMIT, _NOISE = 300, 100, 0.02
_WAY_POINTS = 0.05 * np.array([[-1.0], [0.0], [1.0], [0.0]])
_HINT = "`sklearn-vbjfa design --urdf ROBOT.urdf --for gravity` proposes poses."


def correct_gravity(recording, model):
    """Correct the masses of a description by poses and slow motion.

    Parameters
    ----------
    recording : Recording
        Positions and torques, with held poses or slow motion.
    model : str or os.PathLike
        URDF or MJCF file.

    Returns
    -------
    Bunch
        With torques (nv,) in N m or N:

        - ``identifier``: `RobotIdentifier` with the corrected bodies; ``n_samples``:
          number of poses and windows;
        - ``error_before``, ``error_after``: RMS errors at held-out samples as described
          and as corrected, with fitted friction; nan for a joint without samples;
        - ``gravity_before``, ``gravity``, ``interval``: RMS over random poses of the
          gravity torque as described and as corrected, and of the half width of its
          90 % interval; zero for a vertical axis;
        - ``interval_at``: function that returns the half widths at poses q (n, nv);
        - ``poses_enough``: further poses after which no interval exceeds the noise of
          one pose; None if 100 are not enough;
        - ``friction_known`` (nv,): joints that moved in both directions, see Notes;
        - ``friction`` (nv,): dry friction; if unknown, the offset or the noise;
        - ``payload``: mass of a payload at the last link and its standard deviation
          [kg], if it explains the torques as well as the corrected links; or None;
        - ``findings``: faults of the channels, as of `inspect_recording`.

    Raises
    ------
    ValueError
        If poses or masses in the description are missing, or a channel is wrong.

    Notes
    -----
    Samples are poses (single rows if `Recording.dt` exceeds 1 s), and windows of
    0.2 s in which parabolas give q, v, a and tau:

    tau_j = Phi_j(q, v, a) pi + r_j a_j + d_j v_j + f_j s_j + o_j + e_j.

    Masses and first moments in pi have the prior of `RobotIdentifier`; rotor inertia
    r_j and viscous friction d_j are fitted if all joints move. The state s_j of dry
    friction is the direction of the last motion, -1 or 1. If it never changes, s_j is 0
    and friction is not separable from the offset o_j.
    """
    features, q, rows, described = _described_robot(model)
    states, tau, weight = samples = static_samples(recording, features)
    sign, row = np.sign(np.split(states, 3, axis=1)[1]), np.arange(len(tau))
    poses = states, sign, tau, 0.0 * tau, 1.0 * weight, 1.0 * weight, row, 0 * row
    findings = inspect_as(recording, model, poses=Signals(*poses, few=_MIN_SAMPLES))
    if fault := refusal(findings, recording.torque_units):
        raise fault
    squares = np.zeros((2, *tau.shape))
    with warnings.catch_warnings():  # of few rows, and without a filter
        warnings.simplefilter("ignore", UserWarning)
        for train, test in KFold(_FOLDS).split(tau):
            fits = _fit_both([x[train] for x in samples], model)
            for item, fit in zip(squares, fits):
                item[test] = (tau[test] - fit.predict(states[test])) ** 2
        _, robot = _fit_both(samples, model)
    with np.errstate(invalid="ignore"):
        before, after = np.sqrt((weight * squares).sum(axis=1) / weight.sum(axis=0))
    per_joint = robot.features_.n_parameters_ // features.n_joints_
    bodies = BodyPrior.of(features.model_, per_joint)
    _restore_inertias(robot, bodies)
    covariance, gravity = _covariance(robot), _rms(robot.robot_.gravity(q))
    loaded = gravity > 1e-6 * gravity.max()
    # Joints without gravity torque need not move.
    findings = [x for x in findings if x.kind != "still_joint" or loaded[x.joints[0]]]
    for text in (x.message for x in findings if x.severity == "warning"):
        warnings.warn(text, DoubtWarning, stacklevel=2)
    noise = np.maximum(robot.output_noise_, 1e-9 * gravity.max())
    stds = [std for _, std in islice(_best_poses(rows, covariance, noise), _LIMIT + 1)]
    half_width = HALF_WIDTH * np.array(stds)
    known = np.split(states, 3, axis=1)[1].any(axis=0)
    coulomb, offset = np.abs(robot.theta_.reshape(-1, per_joint)[:, -2:]).T
    sufficient = np.flatnonzero((half_width <= noise).all(axis=1)).tolist()

    def interval_at(q):
        rows = features.matrices(np.hstack([q, 0.0 * q, 0.0 * q]))
        return HALF_WIDTH * np.sqrt((rows @ covariance * rows).sum(axis=2).clip(0.0))

    return Bunch(
        identifier=robot,
        n_samples=len(tau),
        error_before=before,
        error_after=after,
        gravity_before=described * loaded,
        gravity=gravity * loaded,
        interval=half_width[0] * loaded,
        interval_at=interval_at,
        poses_enough=next(iter(sufficient), None),
        friction_known=known,
        friction=np.where(known, coulomb, np.maximum(offset, robot.output_noise_)),
        payload=_payload(robot, bodies),
        findings=findings,
    )


def gravity_poses(model, n_poses=20, *, fitted=None, random_state=0):
    """Choose poses that determine the gravity torque of a described robot.

    Parameters
    ----------
    model : str or os.PathLike
        URDF or MJCF file, whose joint limits and collision shapes poses respect.
    n_poses : int, default=20
        Number of poses.
    fitted : RobotIdentifier, default=None
        Robot corrected by earlier poses. None: as uncertain as descriptions are.
    random_state : int, default=0
        Seed of the candidates.

    Returns
    -------
    q : ndarray of shape (4 * n_poses, nv)
        Way points [rad or m]: before each pose, at it, beyond it, and at it again. Each
        pose narrows the widest interval most.
    hold : ndarray of shape (4 * n_poses,)
        Time [s] to stay at each way point: 1 s at the poses, 0 s elsewhere.

    Raises
    ------
    ValueError
        If the description has no masses, or no poses are asked for.
    """
    if n_poses < 1:
        raise ValueError(f"n_poses must be at least 1; got {n_poses}.")
    features, q, rows, torque = _described_robot(model, random_state)
    if fitted is None:
        bodies = BodyPrior.of(features.model_, 10)
        covariance = np.zeros(2 * [features.n_parameters_])
        inverse, ix = DESCRIBED * np.linalg.inv(bodies.root), bodies.indices
        covariance[ix[:, :, None], ix[:, None]] = inverse @ inverse.transpose(0, 2, 1)
        noise = _NOISE * np.maximum(torque, 0.01 * torque.max())
    else:
        covariance, noise = _covariance(fitted), fitted.output_noise_
    best = [k for k, _ in islice(_best_poses(rows, covariance, noise), n_poses)]
    path = (q[best, None] + _WAY_POINTS).reshape(4 * n_poses, -1)
    return path, np.tile([0.0, 1.0, 0.0, 1.0], n_poses)


def _described_robot(model, random_state=0):
    """Return features, random poses, their regressors, and the RMS torque (nv,)."""
    features = RigidBodyFeatures(model, friction=()).load()
    if BodyPrior.of(features.model_, 10) is None:
        raise ValueError("The description has no masses: add <inertial> elements.")
    low, high = position_range(features.model_)
    low, high, size = low - _WAY_POINTS.min(), high - _WAY_POINTS.max(), 2 * _CANDIDATES
    q = np.random.default_rng(random_state).uniform(low, high, (size, low.size))
    clearance, _ = Clearance.of(model, features.model_)
    if clearance is not None:
        q = q[[clearance.nearest(pose + _WAY_POINTS[:3])[0] > 0 for pose in q]]
    if not len(q):
        raise ValueError("Links touch in all random poses; check the collision shapes.")
    q = q[:_CANDIDATES]
    rows = features.matrices(np.hstack([q, 0.0 * q, 0.0 * q]))
    return features, q, rows, _rms(rows @ nominal_parameters(features.model_).ravel())


def _rms(torques):
    return np.sqrt((torques**2).mean(axis=0))


def _covariance(robot):
    """Return the covariance of all bodies; undetermined parameters have zero."""
    nv, p = robot.features_.n_joints_, robot.features_.n_parameters_
    bodies = np.flatnonzero(np.arange(p) % (p // nv) < 10)
    return np.nan_to_num(robot.robot_.covariance[np.ix_(bodies, bodies)], posinf=0.0)


def _best_poses(rows, covariance, noise):
    """Yield poses (row index) that reduce the widest interval most, greedily."""
    # Each with the RMS standard deviation (nv,) of the gravity torque before it.
    while True:
        cross = rows @ covariance
        torque = cross @ rows.transpose(0, 2, 1)
        std = np.sqrt(np.einsum("kjj->j", torque).clip(0.0) / len(rows))
        # A pose is recorded twice, approached from both sides.
        gains = np.linalg.inv(torque + np.diag(noise**2 / 2))
        # Reduction of the largest variance by each pose, summed over all poses.
        change = cross[:, std.argmax()] @ rows.transpose(0, 2, 1)
        best = int(np.einsum("kmj,kji,kmi->k", change, gains, change).argmax())
        yield best, std
        covariance = covariance - cross[best].T @ gains[best] @ cross[best]


def static_samples(recording, features):
    """Return states, torques and weights, a row for each pose or slow window."""
    dt, parts, sign = check_dt(recording.dt), recording.segments, 0.0 * recording.q
    for j, travel in enumerate(_TRAVEL * np.ptp(recording.q, axis=0) + 1e-300):
        for part in parts:
            sign[part, j] = elements(recording.q[part, j], [travel])[:, 0]
    one_row, longest = dt > _POSE_PERIOD, max(p.stop - p.start for p in parts)
    length = 1 if one_row else min(max(3, round(_WINDOW / dt)), longest)
    starts_of_part = [np.arange(p.start, p.stop - length + 1, length) for p in parts]
    rows = np.concatenate(starts_of_part)[:, None] + np.arange(length)
    t = dt * (np.arange(length) - 0.5 * (length - 1))
    parabola = np.linalg.pinv(np.vander(t, 3, increasing=True) * [1.0, 1.0, 0.5])
    q, v, a = np.einsum("sk,mkj->smj", parabola, recording.q[rows])
    still = np.abs(v) <= _REST * np.quantile(np.abs(v), 0.995, axis=0)
    # Friction reverses as joints start to move, before its state in these samples.
    leaving = still & ~np.r_[still[1:], still[-1:]]
    leaving |= (leaving.any(axis=1) & still.all(axis=1))[:, None]
    # Consecutive windows of one pose form one sample.
    resting = (still & ~leaving).all(axis=1)
    labels = np.where(resting, recording.groups[rows[:, 0]], -1)
    starts = np.flatnonzero((np.diff(labels, prepend=-1) != 0) | (labels < 0) | one_row)
    tau = np.einsum("k,mkj->mj", parabola[0], recording.tau[rows])
    tau[resting] = recording.tau[rows[resting]].mean(axis=1)
    sign = sign[rows].mean(axis=1)
    sign *= ~leaving & (still | (sign * v >= 0))
    signals = np.stack([q, v, a, tau, sign, still])
    count = np.diff(np.r_[starts, len(q)])[:, None]
    q, v, a, tau, sign, still = np.add.reduceat(signals, starts, axis=1) / count
    # The direction of approach of a single-row pose is unknown.
    sign = np.fix(sign / _FULL) * (not one_row)
    bodies = nominal_parameters(features.model_)
    gravity = features.torques(q, 0.0 * v, 0.0 * a, bodies)
    torque, rms = features.torques(q, v, a, bodies), _rms(gravity)
    weight = np.abs(torque - gravity) <= _DYNAMIC * np.maximum(rms, 0.1 * rms.max())
    weight &= (sign != 0) | ~sign.any(axis=0)
    if weight.sum() < _MIN_SAMPLES * weight.shape[1]:
        raise ValueError(
            f"The recording holds fewer than {_MIN_SAMPLES} poses or windows of slow "
            f"motion: hold poses for {3 * _WINDOW:g} s, or give one row of each, with "
            f"dt > {_POSE_PERIOD:g} s. {_HINT}"
        )
    slow = weight.any(axis=1)
    if (np.ptp(q[slow], axis=0) < _ONE_POSE).all():
        raise ValueError(f"All poses are the same to {_ONE_POSE:g} rad. {_HINT}")
    # Direction of the last motion, also at rest; zero if it never changes.
    sign *= (sign > 0).any(axis=0) & (sign < 0).any(axis=0)
    v = sign * np.where(still > 0, _DIRECTION, np.maximum(np.abs(v), 2 * _DIRECTION))
    # Compensates the dynamic torques of the replaced speeds.
    tau += features.torques(q, v, a, bodies) - torque
    return np.hstack([q, v, a])[slow], tau[slow], weight[slow]


def _fit_both(samples, model):
    """Fit friction with described bodies, and with corrected bodies."""
    states, tau, weight = samples
    speed, count = np.abs(np.split(states, 3, axis=1)[1]), weight.sum(axis=0)
    moves = (weight & (speed > _DIRECTION)).any(axis=0) | (count == 0)
    motion = ("viscous", "rotor_inertia") if moves.all() else ()
    friction, fits, variance = (*motion, "coulomb", "offset"), [], np.ones(count.size)
    # Few samples are overfitted: the noise is the residual of the previous fit.
    for bodies in ("fixed", "prior", "prior"):
        options = FitOptions(standstill=None, joint_weights=1.0 / variance)
        fit = RobotIdentifier(model, friction=friction, bodies=bodies, options=options)
        fits.append(fit.fit(states, tau, sample_weight=weight))
        squares = (weight * (tau - fit.predict(states)) ** 2).sum(axis=0)
        variance = squares / np.maximum(count, 1)
        variance = np.where(count < _MIN_SAMPLES, variance.max(), variance)
        variance = np.maximum(variance, 1e-9 * variance.max())
    return fits[0], fits[-1]


def _payload(robot, bodies):
    """Return a payload mass and its std, if it explains the torques equally well."""
    # All bodies but the last are fixed to the description.
    fit, model = robot.estimate_, robot.features_.nominal_
    mass = robot.parameter_names_.index(f"{robot.joint_names_[-1]}:m")
    loaded = bodies.part(bodies.indices[:, 0] != mass)
    loaded = apply_description(fit, loaded, "fixed")
    excess, std = loaded.theta[mass] - model.inertias[model.nv].mass, loaded.std[mass]
    squares = (fit.moments.residual_squares(x.theta) for x in (loaded, fit))
    with_it, without = (fit.joint_weights @ x for x in squares)
    plausible = with_it <= _MAX_ERROR**2 * without and excess > _SIGNIFICANT * std
    return (float(excess), float(std)) if plausible else None


def _restore_inertias(robot, bodies):
    """Restore the described inertias about the centres of mass."""
    pin = import_pinocchio()
    theta, status = robot.theta_.copy(), np.array(robot.robot_.known_, dtype=object)
    for described, ix in zip(bodies.centre, bodies.indices):
        body = pin.Inertia.FromDynamicParameters(theta[ix])
        body.inertia = pin.Inertia.FromDynamicParameters(described).inertia
        theta[ix], status[ix[4:]] = body.toDynamicParameters(), "from the description"
    robot.set_parameters(theta, tuple(status))
