"""Gravity compensation: correct a description from poses and slow motion.

`static_samples` reduces a log to poses and windows of slow motion, each with the side
that friction acts from. `_fitted` fits friction, with bodies as described and then near
their description; `_held_out` compares both. `correct_gravity` states the equation.
"""

import warnings
from collections import namedtuple
from dataclasses import dataclass

import numpy as np
from sklearn.model_selection import KFold

from sklearn_vbjfa.design import Clearance
from sklearn_vbjfa.effects import elements
from sklearn_vbjfa.equations import RigidBodyFeatures
from sklearn_vbjfa.fit import FitOptions, RobotIdentifier
from sklearn_vbjfa.fit._bodies import DESCRIBED, BodyPrior
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
# Folds, contiguous in time; least samples; range [rad or m] of one pose; share of the
# described weight in torques without any; deviations that decide; error of a payload
# over that of the corrected links that explains the torques as well.
_FOLDS, _FEW, _ONE_POSE, _NO_WEIGHT, _SURE, _AS_WELL = 4, 5, 0.2, 0.3, 3.0, 1.1
# Random poses that are compared, most that are counted, way [rad or m] of an approach,
# and noise of a torque over gravity where nobody has measured it.
_CANDIDATES, _MOST, _APPROACH, _NOISE = 300, 100, 0.05, 0.02
_PROPOSED = "`sklearn-vbjfa design --urdf ROBOT.urdf --for gravity` proposes poses"
# Rows that are fitted; `weight` (n, nv) is zero where a joint does not count.
_Samples = namedtuple("_Samples", "q tau states weight")


@dataclass(frozen=True, kw_only=True, eq=False)
class GravityCorrection:
    """Gravity torque of a robot as described and as corrected.

    Attributes
    ----------
    identifier : RobotIdentifier
        Fitted to all samples; exports the corrected description.
    n_samples : int
        Poses and windows of slow motion that were fitted.
    error_before, error_after : ndarray of shape (nv,)
        Root mean square error of the torque at held-out samples [N m or N], friction
        fitted in both cases; nan for a joint without samples.
    gravity_before, gravity, interval : ndarray of shape (nv,)
        Root mean squares over random poses of the gravity torque as described and as
        corrected, and of the half width of its 90 % interval [N m or N]; zero for a
        vertical axis. That of a joint is the moment of all links beyond it.
    poses_enough : int or None
        Further poses after which no interval exceeds the noise of one pose, up to 100.
    friction_known : ndarray of shape (nv,), bool
        Joints that moved in both directions; of the others friction and a constant
        offset of the torque are not separable.
    payload : tuple of float or None
        Mass of a payload at the last link and its standard deviation [kg], if it
        explains the torques as well as the corrected links.
    """

    identifier: RobotIdentifier
    n_samples: int
    error_before: np.ndarray
    error_after: np.ndarray
    gravity_before: np.ndarray
    gravity: np.ndarray
    interval: np.ndarray
    poses_enough: int | None
    friction_known: np.ndarray
    payload: tuple | None

    def interval_at(self, q):
        """Half width (n, nv) of the 90 % interval of the gravity torque at poses q."""
        rows = _gravity_rows(self.identifier.features_, np.asarray(q, dtype=float))
        across = rows @ _covariance(self.identifier)
        variance = np.einsum("kjp,kjp->kj", across, rows)
        return HALF_WIDTH * np.sqrt(np.maximum(variance, 0.0))


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
    GravityCorrection

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
    features, bodies = _described(model)
    samples = static_samples(recording, features)
    rows = _gravity_rows(features, samples.q)
    _check_weight(samples, rows @ bodies.vector(rows.shape[2]))
    with warnings.catch_warnings():
        # Poses are few rows, and nothing is filtered.
        warnings.simplefilter("ignore", UserWarning)
        before, after = _held_out(samples, model)
        _, found = _fitted(samples, model)
        payload = _payload(found, samples, features, bodies)
    _keep_inertias(found)
    at_poses = _gravity_rows(features, _random_poses(model))
    inertial = bodies.vector(at_poses.shape[2]), found.robot_.inertial().ravel()
    described, gravity = (
        np.sqrt(((at_poses @ one) ** 2).mean(axis=0)) for one in inertial
    )
    loaded = gravity > 1e-6 * gravity.max()
    noise = np.maximum(found.output_noise_, 1e-9 * gravity.max())
    _, stds = _best_poses(at_poses, _covariance(found), noise, _MOST)
    enough = np.flatnonzero((HALF_WIDTH * stds <= noise).all(axis=1))
    return GravityCorrection(
        identifier=found,
        n_samples=len(samples.q),
        error_before=before,
        error_after=after,
        gravity_before=described * loaded,
        gravity=gravity * loaded,
        interval=HALF_WIDTH * stds[0] * loaded,
        poses_enough=int(enough[0]) if enough.size else None,
        friction_known=_friction(samples)[:, :, 0].any(axis=0),
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
    rows = _gravity_rows(features, q)
    if fitted is None:
        covariance = np.zeros(2 * rows.shape[2:])
        inverse, at = DESCRIBED * np.linalg.inv(bodies.root), bodies.places
        covariance[at[:, :, None], at[:, None]] = inverse @ inverse.transpose(0, 2, 1)
        torque = np.sqrt(((rows @ bodies.vector(len(covariance))) ** 2).mean(axis=0))
        noise = _NOISE * np.maximum(torque, 0.01 * torque.max())
    else:
        covariance, noise = _covariance(fitted), fitted.output_noise_
    way = np.repeat(q[_best_poses(rows, covariance, noise, n_poses)[0]], 4, axis=0)
    way[0::4] -= _APPROACH
    way[2::4] += _APPROACH
    return way, np.tile([0.0, 1.0, 0.0, 1.0], n_poses)


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


def _gravity_rows(features, q):
    """Gravity torques at poses (n, nv) by inertial parameters, (n, nv, 10 nv)."""
    n, nv = q.shape
    rows = features.transform(np.hstack([q, 0.0 * q, 0.0 * q])).reshape(n, nv, nv, -1)
    return rows[..., :10].reshape(n, nv, -1)


def _covariance(identifier):
    """Covariance (10 nv, 10 nv) of the inertial parameters."""
    nv = len(identifier.joint_names_)
    inertial = np.arange(identifier.theta_.size).reshape(nv, -1)[:, :10].ravel()
    covariance = identifier.robot_.covariance[np.ix_(inertial, inertial)]
    # What neither torques nor description tell moves no gravity torque.
    return np.where(np.isfinite(covariance), covariance, 0.0)


def _random_poses(robot, random_state=0):
    """Draw positions (n, nv) inside the limits; links touch neither there nor near."""
    model = load_model(robot)
    low, high = position_range(model)
    random = np.random.default_rng(random_state)
    shape = 2 * _CANDIDATES, model.nv
    q = random.uniform(low + _APPROACH, high - _APPROACH, shape)
    clearance, _ = Clearance.of(robot, model=model)
    if clearance is not None:
        way = _APPROACH * np.array([[-1.0], [0.0], [1.0]])
        free = np.array([clearance.nearest(one + way)[0] > 0 for one in q])
        q = q[free]
        if not len(q):
            raise ValueError(
                f"Links touch in all {len(free)} poses that were drawn; correct the "
                "collision shapes or the joint limits of the description."
            )
    return q[:_CANDIDATES]


def _best_poses(rows, covariance, noise, n):
    """Choose n rows (n, nv, p), each of which narrows the widest interval most.

    Returns their numbers, and the root mean square deviations (n + 1, nv) of the
    gravity torque over all rows, before the first and after each.
    """
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


def static_samples(recording, features):
    """Return one row for each pose, and for each window of slow motion.

    The speed of a joint at rest is that of its last direction; it is zero if friction
    is a part of the offset.
    """
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
    count = np.diff(np.r_[starts, len(q)])[:, None]
    tau = np.einsum("k,mkj->mj", parabola[0], recording.tau[rows])
    tau[rest] = recording.tau[rows[rest]].mean(axis=1)
    signals = q, v, a, tau, side[rows].mean(axis=1), still
    q, v, a, tau, side, still = (
        np.add.reduceat(x.astype(float), starts) / count for x in signals
    )
    known = np.abs(side) >= _FULL
    side = np.sign(side) * known
    # Friction from one side only is part of the offset.
    side *= (side > 0).any(axis=0) & (side < 0).any(axis=0)
    inertial = nominal_parameters(features.model_)
    gravity = features.torques(q, 0 * v, 0 * a, inertial)
    size = np.sqrt((gravity**2).mean(axis=0))
    torque = features.torques(q, v, a, inertial)
    weight = np.abs(torque - gravity) <= _DYNAMIC * np.maximum(size, 0.1 * size.max())
    weight &= known | ~known.any(axis=0)
    slow = weight.any(axis=1)
    if weight.sum() < _FEW * weight.shape[1]:
        raise ValueError(
            f"The recording holds fewer than {_FEW} poses or windows of slow motion: "
            f"gravity needs poses that are held for {2 * _WINDOW:g} s, or motion whose "
            f"torque is at least {1 - _DYNAMIC:.0%} gravity and friction; {_PROPOSED}."
        )
    v = side * np.where(still > 0, _DIRECTION, np.maximum(np.abs(v), 2 * _DIRECTION))
    # Centrifugal torques of speeds that are replaced.
    tau += features.torques(q, v, a, inertial) - torque
    rows = q, tau, np.hstack([q, v, a]), weight.astype(float)
    return _Samples(*(x[slow] for x in rows))


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


def _explained(columns, y, weight):
    """Fit columns by least squares; the first coefficient, its deviation, squares."""
    A, y = columns * weight[:, None], y * weight
    found = np.linalg.lstsq(A, y)[0]
    squares = ((y - A @ found) ** 2).sum()
    freedom = max(np.count_nonzero(weight) - len(found), 1)
    std = np.sqrt(np.linalg.pinv(A.T @ A)[0, 0] * squares / freedom)
    return float(found[0]), float(std), squares


def _friction(samples):
    """Columns (n, nv, 3) of the friction of each joint."""
    v = np.split(samples.states, 3, axis=1)[1]
    return np.stack([np.sign(v), np.ones_like(v), v], axis=2)


def _check_weight(samples, gravity):
    """Refuse a single pose, and torques that do not contain the described weight."""
    if (np.ptp(samples.q, axis=0) < _ONE_POSE).all():
        raise ValueError(
            "All poses are the same to 0.2 rad: one pose does not determine masses. "
            f"Record poses over the range of the joints; {_PROPOSED}."
        )
    friction, factors = _friction(samples), []
    for j in np.flatnonzero(np.ptp(gravity, axis=0) > 1e-6 * np.ptp(gravity)):
        columns = np.c_[gravity[:, j], friction[:, j]]
        found = _explained(columns, samples.tau[:, j], samples.weight[:, j])
        factors.append((found[0] + _SURE * found[1], *found[:2]))
    # One joint may have a counterbalance.
    if factors and max(factors)[0] < _NO_WEIGHT:
        raise ValueError(
            "The torques contain no weight: {1:.2f} ± {2:.2f} times the described "
            "gravity torque. The controller has probably subtracted its gravity model; "
            "record the torques before that.".format(*max(factors))
        )


def _payload(found, samples, features, bodies):
    """Mass of a payload and its deviation, if it explains the torques as well."""
    # The description with another body at the last link.
    n, nv = samples.tau.shape
    rows = features.transform(samples.states).reshape(n, nv, -1)
    friction = _friction(samples)[:, :, None] * np.eye(nv)[:, :, None]
    columns = np.concatenate([rows[:, :, -10:], friction.reshape(n, nv, -1)], axis=2)
    weight = (np.sqrt(samples.weight) / found.output_noise_).ravel()
    left = samples.tau - rows @ bodies.vector(rows.shape[2])
    columns = columns.reshape(n * nv, -1)
    mass, std, squares = _explained(columns, left.ravel(), weight)
    left = weight * (samples.tau - found.predict(samples.states)).ravel()
    as_well = squares <= _AS_WELL**2 * (left**2).sum()
    return (mass, std) if as_well and mass > _SURE * std else None


def _keep_inertias(found):
    """Give the bodies of a fit their described inertias about the centres of mass."""
    pin, robot, theta = import_pinocchio(), found.robot_, found.theta_.copy()
    model, known = robot.features_.nominal_, np.array(robot.known_, dtype=object)
    solid = solid_bodies(nominal_parameters(model))
    at = np.arange(theta.size).reshape(model.nv, -1)[solid, :10]
    for places, j in zip(at, np.flatnonzero(solid)):
        mass, first = theta[places[0]], theta[places[1:4]]
        body = pin.Inertia(mass, first / mass, model.inertias[int(j) + 1].inertia)
        theta[places] = body.toDynamicParameters()
    known[at[:, 4:]] = "from the description"
    found.set_parameters(theta, tuple(known))
