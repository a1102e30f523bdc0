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
from sklearn_vbjfa.inspection import inspect_recording
from sklearn_vbjfa.model import import_pinocchio, nominal_parameters, position_range
from sklearn_vbjfa.recording._recording import check_dt
from sklearn_vbjfa.robot._channels import HALF_WIDTH

__all__ = ["correct_gravity", "gravity_poses"]
# Samples: length of a window [s], share of the fastest speed that is rest, torque of
# motion over that of gravity, way over the range after which friction is full, and
# share of it that counts as full; speed [rad/s or m/s] for its direction at rest; least
# period [s] of rows that are poses.
_WINDOW, _REST, _DYNAMIC, _WAY, _FULL, _DIRECTION = 0.2, 0.02, 0.2, 0.003, 0.9, 1e-4
_ONE_ROW = 1.0
# Folds, contiguous in time; least samples; range [rad or m] of one pose; deviations
# that decide; error of a payload over that of corrected links that explains as much.
_FOLDS, _FEW, _ONE_POSE, _SURE, _AS_WELL = 4, 5, 0.2, 3.0, 1.1
# Random poses, most poses that are counted, noise of a torque over gravity where nobody
# has measured it, and way points [rad or m] around a pose.
_CANDIDATES, _MOST, _NOISE = 300, 100, 0.02
_AROUND = 0.05 * np.array([[-1.0], [0.0], [1.0], [0.0]])
_PROPOSED = "`sklearn-vbjfa design --urdf ROBOT.urdf --for gravity` proposes poses."


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
        - ``payload``: mass of a payload at the last link and its standard deviation
          [kg], if it explains the torques as well as the corrected links; or None.

    Raises
    ------
    ValueError
        If poses, weight in the torques, or masses in the description are missing.

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
    features, q, rows, described = _described(model)
    states, tau, weight = samples = static_samples(recording, features)
    for one in inspect_recording(recording, model):
        # What balances a single joint of several is likelier a spring.
        if one.kind == "no_gravity" and not len(one.joints) == 1 < features.n_joints_:
            raise ValueError(one.message)
    squares = np.zeros((2, *tau.shape))
    with warnings.catch_warnings():  # of few rows, and without a filter
        warnings.simplefilter("ignore", UserWarning)
        for kept, fold in KFold(_FOLDS).split(tau):
            for one, fit in zip(squares, _fitted([x[kept] for x in samples], model)):
                one[fold] = (tau[fold] - fit.predict(states[fold])) ** 2
        _, found = _fitted(samples, model)
    with np.errstate(invalid="ignore"):
        before, after = np.sqrt((weight * squares).sum(axis=1) / weight.sum(axis=0))
    per_joint = found.features_.n_parameters_ // features.n_joints_
    bodies = BodyPrior.of(features.model_, per_joint)
    _keep_inertias(found, bodies)
    covariance, gravity = _covariance(found), _rms(found.robot_.gravity(q))
    loaded = gravity > 1e-6 * gravity.max()
    noise = np.maximum(found.output_noise_, 1e-9 * gravity.max())
    stds = [std for _, std in islice(_best_poses(rows, covariance, noise), _MOST + 1)]
    half = HALF_WIDTH * np.array(stds)
    enough = np.flatnonzero((half <= noise).all(axis=1)).tolist()

    def interval_at(q):
        rows = features.matrices(np.hstack([q, 0.0 * q, 0.0 * q]))
        return HALF_WIDTH * np.sqrt((rows @ covariance * rows).sum(axis=2).clip(0.0))

    return Bunch(
        identifier=found,
        n_samples=len(tau),
        error_before=before,
        error_after=after,
        gravity_before=described * loaded,
        gravity=gravity * loaded,
        interval=half[0] * loaded,
        interval_at=interval_at,
        poses_enough=next(iter(enough), None),
        friction_known=np.split(states, 3, axis=1)[1].any(axis=0),
        payload=_payload(found, bodies),
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
    features, q, rows, torque = _described(model, random_state)
    if fitted is None:
        bodies = BodyPrior.of(features.model_, 10)
        covariance = np.zeros(2 * [features.n_parameters_])
        inverse, at = DESCRIBED * np.linalg.inv(bodies.root), bodies.places
        covariance[at[:, :, None], at[:, None]] = inverse @ inverse.transpose(0, 2, 1)
        noise = _NOISE * np.maximum(torque, 0.01 * torque.max())
    else:
        covariance, noise = _covariance(fitted), fitted.output_noise_
    best = [k for k, _ in islice(_best_poses(rows, covariance, noise), n_poses)]
    way = (q[best, None] + _AROUND).reshape(4 * n_poses, -1)
    return way, np.tile([0.0, 1.0, 0.0, 1.0], n_poses)


def _described(model, random_state=0):
    """Return features, random poses, their torques by bodies, and the RMS (nv,)."""
    features = RigidBodyFeatures(model, friction=()).load()
    if BodyPrior.of(features.model_, 10) is None:
        raise ValueError("The description has no masses: add <inertial> elements.")
    low, high = position_range(features.model_)
    low, high, size = low - _AROUND.min(), high - _AROUND.max(), 2 * _CANDIDATES
    q = np.random.default_rng(random_state).uniform(low, high, (size, low.size))
    clearance, _ = Clearance.of(model, features.model_)
    if clearance is not None:
        q = q[[clearance.nearest(one + _AROUND[:3])[0] > 0 for one in q]]
    if not len(q):
        raise ValueError("Links touch in all random poses; check the collision shapes.")
    q = q[:_CANDIDATES]
    rows = features.matrices(np.hstack([q, 0.0 * q, 0.0 * q]))
    return features, q, rows, _rms(rows @ nominal_parameters(features.model_).ravel())


def _rms(torques):
    return np.sqrt((torques**2).mean(axis=0))


def _covariance(found):
    """Covariance of all bodies; what nothing determines moves no gravity torque."""
    nv, p = found.features_.n_joints_, found.features_.n_parameters_
    bodies = np.flatnonzero(np.arange(p) % (p // nv) < 10)
    covariance = found.robot_.covariance[np.ix_(bodies, bodies)]
    return np.where(np.isfinite(covariance), covariance, 0.0)


def _best_poses(rows, covariance, noise):
    """Yield poses that narrow the widest interval most, by their place in rows."""
    # With each the root mean square deviations (nv,) of the gravity torque before it.
    while True:
        across = rows @ covariance
        torque = across @ rows.transpose(0, 2, 1)
        variance = np.maximum(np.diagonal(torque, axis1=1, axis2=2), 0.0)
        std = np.sqrt(variance.mean(axis=0))
        # A pose is recorded from both sides.
        gains = np.linalg.inv(torque + np.diag(noise**2 / 2))
        # What each pose would take away of the widest variance, summed over all poses.
        shared = across[:, std.argmax()] @ rows.transpose(0, 2, 1)
        best = int(np.einsum("kmj,kji,kmi->k", shared, gains, shared).argmax())
        yield best, std
        covariance = covariance - across[best].T @ gains[best] @ across[best]


def static_samples(recording, features):
    """Return states, torques and weights, one row for each pose and slow window."""
    dt, parts, side = check_dt(recording.dt), recording.segments, 0.0 * recording.q
    for j, way in enumerate(_WAY * np.ptp(recording.q, axis=0) + 1e-300):
        for part in parts:
            side[part, j] = elements(recording.q[part, j], [way])[:, 0]
    one_row, longest = dt > _ONE_ROW, max(p.stop - p.start for p in parts)
    length = 1 if one_row else min(max(3, round(_WINDOW / dt)), longest)
    first = [np.arange(p.start, p.stop - length + 1, length) for p in parts]
    rows = np.concatenate(first)[:, None] + np.arange(length)
    t = dt * (np.arange(length) - 0.5 * (length - 1))
    parabola = np.linalg.pinv(np.vander(t, 3, increasing=True) * [1.0, 1.0, 0.5])
    q, v, a = np.einsum("sk,mkj->smj", parabola, recording.q[rows])
    still = np.abs(v) <= _REST * np.quantile(np.abs(v), 0.995, axis=0)
    # Windows of one pose are one sample.
    rest = still.all(axis=1)
    label = np.where(rest, recording.groups[rows[:, 0]], -1)
    starts = np.flatnonzero((np.diff(label, prepend=-1) != 0) | (label < 0) | one_row)
    tau = np.einsum("k,mkj->mj", parabola[0], recording.tau[rows])
    tau[rest] = recording.tau[rows[rest]].mean(axis=1)
    signals = np.stack([q, v, a, tau, side[rows].mean(axis=1), still])
    count = np.diff(np.r_[starts, len(q)])[:, None]
    q, v, a, tau, side, still = np.add.reduceat(signals, starts, axis=1) / count
    # How a pose of one row was reached is not known.
    side = np.fix(side / _FULL) * (not one_row)
    bodies = nominal_parameters(features.model_)
    gravity = features.torques(q, 0.0 * v, 0.0 * a, bodies)
    torque, size = features.torques(q, v, a, bodies), _rms(gravity)
    weight = np.abs(torque - gravity) <= _DYNAMIC * np.maximum(size, 0.1 * size.max())
    weight &= (side != 0) | ~side.any(axis=0)
    if weight.sum() < _FEW * weight.shape[1]:
        raise ValueError(
            f"The recording holds fewer than {_FEW} poses or windows of slow motion: "
            f"hold poses for {2 * _WINDOW:g} s, or give one row of each, with dt > "
            f"{_ONE_ROW:g} s. {_PROPOSED}"
        )
    slow = weight.any(axis=1)
    if (np.ptp(q[slow], axis=0) < _ONE_POSE).all():
        raise ValueError(f"All poses are the same to {_ONE_POSE:g} rad. {_PROPOSED}")
    # The direction of the last motion, at rest too; none where it never changes.
    side *= (side > 0).any(axis=0) & (side < 0).any(axis=0)
    v = side * np.where(still > 0, _DIRECTION, np.maximum(np.abs(v), 2 * _DIRECTION))
    # Centrifugal torques of speeds that are replaced.
    tau += features.torques(q, v, a, bodies) - torque
    return np.hstack([q, v, a])[slow], tau[slow], weight[slow]


def _fitted(samples, model):
    """Fit friction with the described bodies, and with corrected ones."""
    states, tau, weight = samples
    speed, count = np.abs(np.split(states, 3, axis=1)[1]), weight.sum(axis=0)
    moves = (weight & (speed > _DIRECTION)).any(axis=0) | (count == 0)
    motion = ("viscous", "rotor_inertia") if moves.all() else ()
    friction, fits, variance = (*motion, "coulomb", "offset"), [], np.ones(count.size)
    # Few samples are fitted exactly: the noise is what the bodies before leave.
    for bodies in ("fixed", "prior", "prior"):
        options = FitOptions(standstill=None, joint_weights=1.0 / variance)
        fit = RobotIdentifier(model, friction=friction, bodies=bodies, options=options)
        fits.append(fit.fit(states, tau, sample_weight=weight))
        squares = (weight * (tau - fit.predict(states)) ** 2).sum(axis=0)
        variance = squares / np.maximum(count, 1)
        variance = np.where(count < _FEW, variance.max(), variance)
        variance = np.maximum(variance, 1e-9 * variance.max())
    return fits[0], fits[-1]


def _payload(found, bodies):
    """Mass of a payload and its deviation, if it explains the torques as well."""
    # All bodies are as described but the last.
    fit, model = found.estimate_, found.features_.nominal_
    mass = found.parameter_names_.index(f"{found.joint_names_[-1]}:m")
    held = bodies.places[:, 0] != mass
    others = replace(bodies, places=bodies.places[held], centre=bodies.centre[held])
    loaded = apply_description(fit, others, "fixed")
    more, std = loaded.theta[mass] - model.inertias[model.nv].mass, loaded.std[mass]
    squares = (fit.moments.residual_squares(one.theta) for one in (loaded, fit))
    with_it, without = (fit.joint_weights @ one for one in squares)
    as_well = with_it <= _AS_WELL**2 * without and more > _SURE * std
    return (float(more), float(std)) if as_well else None


def _keep_inertias(found, bodies):
    """Give bodies their described inertias about the centres of mass."""
    pin = import_pinocchio()
    theta, known = found.theta_.copy(), np.array(found.robot_.known_, dtype=object)
    for described, at in zip(bodies.centre, bodies.places):
        body = pin.Inertia.FromDynamicParameters(theta[at])
        body.inertia = pin.Inertia.FromDynamicParameters(described).inertia
        theta[at], known[at[4:]] = body.toDynamicParameters(), "from the description"
    found.set_parameters(theta, tuple(known))
