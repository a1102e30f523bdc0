"""Gravity compensation: correct a description from poses and slow motion."""

import warnings
from collections import namedtuple

import numpy as np
from sklearn.model_selection import KFold
from sklearn.utils import Bunch

from sklearn_vbjfa.design import Clearance
from sklearn_vbjfa.effects import elements
from sklearn_vbjfa.equations import RigidBodyFeatures
from sklearn_vbjfa.fit import FitOptions, RobotIdentifier
from sklearn_vbjfa.fit._bodies import DESCRIBED, BodyPrior
from sklearn_vbjfa.inspection import inspect_recording
from sklearn_vbjfa.model import (
    import_pinocchio,
    load_model,
    nominal_parameters,
    position_range,
    solid_bodies,
)
from sklearn_vbjfa.recording._recording import check_dt
from sklearn_vbjfa.robot._channels import HALF_WIDTH

__all__ = ["correct_gravity", "gravity_poses"]
# Samples: length of a window [s], share of the fastest speed that is rest, torque of
# motion over that of gravity, way over the range after which friction is full, and
# share of it that counts as full.
_WINDOW, _REST, _DYNAMIC, _WAY, _FULL = 0.2, 0.02, 0.2, 0.003, 0.9
# Speed [rad/s or m/s] that stands for the direction of friction at rest.
_DIRECTION = 1e-4
# Folds, contiguous in time; least samples; range [rad or m] of one pose; deviations
# that decide; error of a payload over that of corrected links that explains as much.
_FOLDS, _FEW, _ONE_POSE, _SURE, _AS_WELL = 4, 5, 0.2, 3.0, 1.1
# Random poses that are compared, most that are counted, way [rad or m] of an approach,
# and noise of a torque over gravity where nobody has measured it.
_CANDIDATES, _MOST, _APPROACH, _NOISE = 300, 100, 0.05, 0.02
_PROPOSED = "`sklearn-vbjfa design --urdf ROBOT.urdf --for gravity` proposes poses"
# Rows that are fitted; `weight` (n, nv) is zero where a joint does not count.
_Samples = namedtuple("_Samples", "q tau states weight")


def correct_gravity(recording, model):
    """Correct the masses of a description by poses and slow motion.

    Parameters
    ----------
    recording : Recording
        Positions and torques, with held poses or slow motion.
    model : str or os.PathLike
        URDF or MJCF file of the robot.

    Returns
    -------
    Bunch
        With the attributes

        - ``identifier``: `RobotIdentifier` fitted to all samples, which exports the
          corrected description; ``n_samples``: number of poses and windows;
        - ``error_before``, ``error_after`` (nv,): root mean square errors of the torque
          at held-out samples [N m or N] as described and as corrected, friction fitted
          in both; nan for a joint without samples;
        - ``gravity_before``, ``gravity``, ``interval`` (nv,): root mean squares over
          random poses of the gravity torque as described and as corrected, and of the
          half width of its 90 % interval [N m or N]; zero for a vertical axis. That of
          a joint is the moment of all links beyond it;
        - ``interval_at``: function that returns the half widths at poses q (n, nv);
        - ``poses_enough``: further poses after which no interval exceeds the noise of
          one pose; None if 100 are not enough;
        - ``friction_known`` (nv,): joints that moved in both directions; of the others
          friction and a constant offset of the torque are not separable;
        - ``payload``: mass of a payload at the last link and its standard deviation
          [kg], if it explains the torques as well as the corrected links; or None.

    Raises
    ------
    ValueError
        If there are no poses, or one only; the torques contain no weight; or the
        description has no masses.

    Notes
    -----
    Sample k is a pose, or a window of 0.2 s in which parabolas give q, v, a and tau:

    tau_kj = Phi_j(q, v, a) pi + r_j a_kj + d_j v_kj + f_j s_kj + o_j + e_kj.

    Masses and first moments in pi have the prior of ``bodies="prior"``, see
    `RobotIdentifier`; inertias about the centres of mass stay as described. Rotor
    inertia r_j and viscous friction d_j are fitted if all joints move. The state s_kj
    of dry friction, -1 or 1, is the direction of the last motion, at rest too: that of
    a stop operator of 0.3 % of the range. If it never changes, s is 0 and friction is
    part of the offset o_j. A sample counts for joints whose state of friction is known
    and whose torque of motion is at most a fifth of that of gravity.
    """
    features, _ = _described(model)
    samples = static_samples(recording, features)
    for one in inspect_recording(recording, model):
        if one.kind == "no_gravity":
            raise ValueError(one.message)
    with warnings.catch_warnings():
        # Poses are few rows, and nothing is filtered.
        warnings.simplefilter("ignore", UserWarning)
        before, after = _held_out(samples, model)
        _, found = _fitted(samples, model)
        payload = _payload(found, samples, features)
    _keep_inertias(found)
    q = _random_poses(model)
    described, gravity = _rms(_torques(features, q)), _rms(found.robot_.gravity(q))
    loaded = gravity > 1e-6 * gravity.max()
    noise = np.maximum(found.output_noise_, 1e-9 * gravity.max())
    rows, covariance = _gravity_rows(found.features_, q), _covariance(found)
    _, stds = _best_poses(rows, covariance, noise, _MOST)
    enough = np.flatnonzero((HALF_WIDTH * stds <= noise).all(axis=1))

    def interval_at(q):
        rows = _gravity_rows(found.features_, np.asarray(q, dtype=float))
        variance = np.einsum("kjp,kjp->kj", rows @ covariance, rows)
        return HALF_WIDTH * np.sqrt(np.maximum(variance, 0.0))

    return Bunch(
        identifier=found,
        n_samples=len(samples.q),
        error_before=before,
        error_after=after,
        gravity_before=described * loaded,
        gravity=gravity * loaded,
        interval=HALF_WIDTH * stds[0] * loaded,
        interval_at=interval_at,
        poses_enough=int(enough[0]) if enough.size else None,
        # Without reversals the speed is zero.
        friction_known=np.split(samples.states, 3, axis=1)[1].any(axis=0),
        payload=payload,
    )


def gravity_poses(model, n_poses=20, *, fitted=None, random_state=0):
    """Choose poses that determine the gravity torque of a described robot.

    Parameters
    ----------
    model : str or os.PathLike
        URDF or MJCF file. Poses lie inside its joint limits; links do not touch if it
        has collision geometry.
    n_poses : int, default=20
        Number of poses.
    fitted : RobotIdentifier, default=None
        The robot as corrected by earlier poses, whose widest interval each pose
        narrows most. None: as uncertain as descriptions usually are.
    random_state : int, default=0
        Seed of the candidates.

    Returns
    -------
    q : ndarray of shape (4 * n_poses, nv)
        Way points [rad or m], the best pose first: for each pose a point before it, the
        pose, a point beyond it, and the pose again: joints come from both sides.
    hold : ndarray of shape (4 * n_poses,)
        Time [s] to stay at each way point: 1 s at the poses, 0 s elsewhere.

    Raises
    ------
    ValueError
        If the description has no masses, or no poses are asked for.
    """
    if n_poses < 1:
        raise ValueError(f"n_poses must be at least 1; got {n_poses}.")
    features, bodies = _described(model)
    q = _random_poses(model, random_state)
    if fitted is None:
        covariance = np.zeros(2 * [features.n_parameters_])
        inverse, at = DESCRIBED * np.linalg.inv(bodies.root), bodies.places
        covariance[at[:, :, None], at[:, None]] = inverse @ inverse.transpose(0, 2, 1)
        torque = _rms(_torques(features, q))
        noise = _NOISE * np.maximum(torque, 0.01 * torque.max())
    else:
        features, noise = fitted.features_, fitted.output_noise_
        covariance = _covariance(fitted)
    best, _ = _best_poses(_gravity_rows(features, q), covariance, noise, n_poses)
    way = np.repeat(q[best], 4, axis=0)
    way[0::4] -= _APPROACH
    way[2::4] += _APPROACH
    return way, np.tile([0.0, 1.0, 0.0, 1.0], n_poses)


def _described(model):
    """Return features and bodies of a description; refuse one without masses."""
    friction = "coulomb", "offset", "viscous"
    features = RigidBodyFeatures(model, friction).load()
    bodies = BodyPrior.of(features.model_, 10 + len(friction))
    if bodies is None:
        raise ValueError(
            "The description has no link with mass and inertia to correct. Add "
            "<inertial> to its links, with rough masses at least."
        )
    return features, bodies


def _rms(torques):
    """Root mean squares over the first axis."""
    return np.sqrt((torques**2).mean(axis=0))


def _torques(features, q, v=0.0, a=0.0):
    """Torques (n, nv) of the described bodies, by default of gravity alone."""
    still, bodies = np.zeros_like(q), nominal_parameters(features.model_)
    return features.torques(q, still + v, still + a, bodies)


def _gravity_rows(features, q):
    """Gravity torques at poses by all parameters, (n, nv, p); friction has none."""
    rows = features.matrices(np.hstack([q, 0.0 * q, 0.0 * q]))
    rows.reshape(*q.shape, q.shape[1], -1)[..., 10:] = 0.0
    return rows


def _covariance(robot):
    """Covariance (p, p); what nothing determines moves no gravity torque."""
    p = robot.features_.n_parameters_
    covariance = robot.robot_.covariance[:p, :p]
    return np.where(np.isfinite(covariance), covariance, 0.0)


def _random_poses(robot, random_state=0):
    """Draw positions (n, nv) inside the limits; links touch neither there nor near."""
    model = load_model(robot)
    low, high = position_range(model)
    random = np.random.default_rng(random_state)
    shape = 2 * _CANDIDATES, model.nv
    q = random.uniform(low + _APPROACH, high - _APPROACH, shape)
    clearance, _ = Clearance.of(robot, model)
    if clearance is not None:
        way = _APPROACH * np.array([[-1.0], [0.0], [1.0]])
        q = q[[clearance.nearest(one + way)[0] > 0 for one in q]]
        if not len(q):
            raise ValueError(
                f"Links touch in all {2 * _CANDIDATES} poses that were drawn; correct "
                "the collision shapes or the joint limits of the description."
            )
    return q[:_CANDIDATES]


def _best_poses(rows, covariance, noise, n):
    """Choose n poses, each of which narrows the widest interval most."""
    # Also returns the root mean square deviations (n + 1, nv) of the gravity torque
    # over all poses (rows), before the first and after each.
    chosen, stds = [], []
    while True:
        across = rows @ covariance
        torque = across @ rows.transpose(0, 2, 1)
        variance = np.maximum(np.diagonal(torque, axis1=1, axis2=2), 0.0)
        stds.append(np.sqrt(variance.mean(axis=0)))
        if len(chosen) == n:
            return chosen, np.array(stds)
        # A pose is recorded from both sides.
        gains = np.linalg.inv(torque + np.diag(noise**2 / 2))
        # What each pose would take away of the widest variance, summed over all poses.
        shared = across[:, stds[-1].argmax()] @ rows.transpose(0, 2, 1)
        best = int(np.einsum("kmj,kji,kmi->k", shared, gains, shared).argmax())
        covariance = covariance - across[best].T @ gains[best] @ across[best]
        chosen.append(best)


def _windows(recording):
    """Return means over poses and windows of slow motion, (n, nv) each."""
    # States, torques, states of dry friction from -1 to 1, shares of the time at rest.
    dt, parts, side = check_dt(recording.dt), recording.segments, 0.0 * recording.q
    for j, way in enumerate(_WAY * np.ptp(recording.q, axis=0) + 1e-300):
        for part in parts:
            side[part, j] = elements(recording.q[part, j], [way])[:, 0]
    length = max(3, round(_WINDOW / dt))
    first = [np.arange(p.start, p.stop - length + 1, length) for p in parts]
    rows = np.concatenate(first)[:, None] + np.arange(length)
    t = dt * (np.arange(length) - 0.5 * (length - 1))
    parabola = np.linalg.pinv(np.vander(t, 3, increasing=True) * [1.0, 1.0, 0.5])
    q, v, a = np.einsum("sk,mkj->smj", parabola, recording.q[rows])
    still = np.abs(v) <= _REST * np.quantile(np.abs(v), 0.995, axis=0)
    # Windows of one pose are one sample.
    rest = still.all(axis=1)
    label = np.where(rest, recording.groups[rows[:, 0]], -1)
    starts = np.flatnonzero((np.diff(label, prepend=-1) != 0) | (label < 0))
    tau = np.einsum("k,mkj->mj", parabola[0], recording.tau[rows])
    tau[rest] = recording.tau[rows[rest]].mean(axis=1)
    signals = np.stack([q, v, a, tau, side[rows].mean(axis=1), still])
    count = np.diff(np.r_[starts, len(q)])[:, None]
    return np.add.reduceat(signals, starts, axis=1) / count


def static_samples(recording, features):
    """Return one row for each pose, and for each window of slow motion."""
    # The speed of a joint at rest is that of its last direction; it is zero if friction
    # is a part of the offset.
    q, v, a, tau, side, still = _windows(recording)
    side = np.sign(side) * (np.abs(side) >= _FULL)
    known = side != 0
    side *= (side > 0).any(axis=0) & (side < 0).any(axis=0)
    gravity, torque = _torques(features, q), _torques(features, q, v, a)
    size = _rms(gravity)
    weight = np.abs(torque - gravity) <= _DYNAMIC * np.maximum(size, 0.1 * size.max())
    weight &= known | ~known.any(axis=0)
    if weight.sum() < _FEW * weight.shape[1]:
        raise ValueError(
            f"The recording holds fewer than {_FEW} poses or windows of slow motion: "
            f"gravity needs poses that are held for {2 * _WINDOW:g} s, or motion whose "
            f"torque is at least {1 - _DYNAMIC:.0%} gravity and friction; {_PROPOSED}."
        )
    v = side * np.where(still > 0, _DIRECTION, np.maximum(np.abs(v), 2 * _DIRECTION))
    # Centrifugal torques of speeds that are replaced.
    tau += _torques(features, q, v, a) - torque
    rows, slow = (q, tau, np.hstack([q, v, a]), weight * 1.0), weight.any(axis=1)
    samples = _Samples(*(x[slow] for x in rows))
    if (np.ptp(samples.q, axis=0) < _ONE_POSE).all():
        raise ValueError(
            "All poses are the same to 0.2 rad: one pose does not determine masses. "
            f"Record poses over the range of the joints; {_PROPOSED}."
        )
    return samples


def _payload(found, samples, features):
    """Mass of a payload and its deviation, if it explains the torques as well."""
    # The description with another body at the last link.
    n, nv = samples.tau.shape
    rows = features.matrices(samples.states).reshape(n, nv, nv, -1)
    columns = [rows[:, :, -1, :10], rows[..., 10:].reshape(n, nv, -1)]
    weight = (np.sqrt(samples.weight) / found.output_noise_).ravel()
    A = weight[:, None] * np.concatenate(columns, axis=2).reshape(n * nv, -1)
    described = _torques(features, *np.split(samples.states, 3, axis=1))
    y = weight * (samples.tau - described).ravel()
    fit = np.linalg.lstsq(A, y)[0]
    squares = ((y - A @ fit) ** 2).sum()
    variance = squares / max(np.count_nonzero(weight) - fit.size, 1)
    mass, std = float(fit[0]), float(np.sqrt(np.linalg.pinv(A.T @ A)[0, 0] * variance))
    left = weight * (samples.tau - found.predict(samples.states)).ravel()
    as_well = squares <= _AS_WELL**2 * (left**2).sum()
    return (mass, std) if as_well and mass > _SURE * std else None


def _fitted(samples, model):
    """Fit friction with the described bodies, and with corrected ones."""
    _, tau, states, weight = samples
    speed, count = np.abs(np.split(states, 3, axis=1)[1]), weight.sum(axis=0)
    moves = (weight * (speed > _DIRECTION)).any(axis=0) | (count == 0)
    motion = ("viscous", "rotor_inertia") if moves.all() else ()
    friction = (*motion, "coulomb", "offset")
    fits, variance = [], np.ones(count.size)
    # Few samples are fitted exactly: the noise is that which the described bodies, and
    # then the corrected ones, leave.
    for bodies in ("fixed", "prior", "prior"):
        options = FitOptions(standstill=None, joint_weights=1.0 / variance)
        fit = RobotIdentifier(model, friction=friction, bodies=bodies, options=options)
        fits.append(fit.fit(states, tau, sample_weight=weight))
        squares = (weight * (tau - fit.predict(states)) ** 2).sum(axis=0)
        variance = squares / np.maximum(count, 1.0)
        variance = np.where(count < _FEW, variance.max(), variance)
        variance = np.maximum(variance, 1e-9 * variance.max())
    return fits[0], fits[-1]


def _held_out(samples, model):
    """Errors (nv,) of both fits on contiguous folds, each predicted by the rest."""
    _, tau, states, weight = samples
    squares = np.full((2, *tau.shape), np.nan)
    for rows, fold in KFold(_FOLDS).split(tau):
        fits = _fitted(_Samples(*(x[rows] for x in samples)), model)
        for one, found in zip(squares, fits):
            one[fold] = (tau[fold] - found.predict(states[fold])) ** 2
    with np.errstate(invalid="ignore"):
        return np.sqrt((weight * squares).sum(axis=1) / weight.sum(axis=0))


def _keep_inertias(found):
    """Give the bodies of a fit their described inertias about the centres of mass."""
    pin, robot, theta = import_pinocchio(), found.robot_, found.theta_.copy()
    model, known = robot.features_.nominal_, np.array(robot.known_, dtype=object)
    at = np.arange(robot.features_.n_parameters_).reshape(model.nv, -1)[:, :10]
    for j in np.flatnonzero(solid_bodies(nominal_parameters(model))):
        body = pin.Inertia.FromDynamicParameters(theta[at[j]])
        body.inertia = model.inertias[int(j) + 1].inertia
        theta[at[j]] = body.toDynamicParameters()
        known[at[j, 4:]] = "from the description"
    found.set_parameters(theta, tuple(known))
