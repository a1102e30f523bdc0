"""Simulated recordings with ground truth."""

from dataclasses import dataclass, replace
from importlib import resources
from typing import ClassVar

import numpy as np
from sklearn.utils import check_random_state

from sklearn_vbjfa.model import (
    import_pinocchio,
    is_prismatic,
    joint_names,
    load_model,
    with_bodies,
)
from sklearn_vbjfa.physical import inertial_parameters, pseudo_inertia
from sklearn_vbjfa.recording._recording import Recording

# Range [rad or m] and speed [per s] where the description has no or wider limits.
_DEFAULT_RANGE = 2.5
_DEFAULT_SPEED = 2.5
# Share of a joint's range and speed that the motion uses.
_RANGE_SHARE = 0.8
# Speed scale of smoothed Coulomb friction, as a share of the joint's largest speed.
_SIGN_SPEED = 0.005
_RIPPLE_PERIOD = np.radians(20.0)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SimulatedRecording(Recording):
    """A simulated recording with its ground truth.

    Parameters
    ----------
    states : ndarray of shape (n_samples, 3 * nv)
        True states [q | v | a].
    tau_clean : ndarray of shape (n_samples, nv)
        Torque channels without noise [N m or N].
    inertial : ndarray of shape (nv, 10)
        True inertial parameters of each body in Pinocchio's order.
    friction : mapping of str to ndarray of shape (nv,)
        True coefficients of the friction columns.
    """

    states: np.ndarray
    tau_clean: np.ndarray
    inertial: np.ndarray
    friction: dict

    WIDTHS: ClassVar = Recording.WIDTHS | {"tau_clean": 1}

    def theta(self, friction):
        """Return the true parameter vector for a choice of friction columns.

        Parameters
        ----------
        friction : tuple of str
            Names of the columns; coefficients that the robot does not have are zero.

        Returns
        -------
        ndarray of shape (nv * (10 + len(friction)),)
            Parameters in the order of `RobotIdentifier`.
        """
        nv = self.inertial.shape[0]
        extra = [self.friction.get(name, np.zeros(nv)) for name in friction]
        return np.column_stack([self.inertial, *extra]).ravel()


def make_robot_recording(
    model=None,
    *,
    duration=30.0,
    dt=0.005,
    frequency=0.7,
    n_harmonics=5,
    n_recordings=1,
    encoder_noise=1e-4,
    torque_noise=0.05,
    friction=("viscous", "coulomb"),
    perturbation=0.3,
    inertial=None,
    undeclared=None,
    base_tilt=(0.0, 0.0),
    joint_zero=None,
    joint_axis=None,
    torque_gain=None,
    random_state=None,
) -> SimulatedRecording:
    """Simulate the recording of a robot: a smooth motion, noisy encoders and torques.

    Parameters
    ----------
    model : str, os.PathLike, pinocchio.Model or None, default=None
        Robot; None is a made-up six-axis arm.
    duration : float, default=30.0
        Length of each recording [s].
    dt : float, default=0.005
        Sample period [s].
    frequency : float, default=0.7
        Highest frequency of the motion [Hz].
    n_harmonics : int, default=5
        Number of sines in each joint.
    n_recordings : int, default=1
        Number of recordings, each with another motion.
    encoder_noise : float, default=1e-4
        Standard deviation of the white position noise [rad or m].
    torque_noise : float, default=0.05
        Standard deviation of the white torque noise, as a share of the standard
        deviation of each joint's torque.
    friction : tuple of {"viscous", "coulomb", "offset", "rotor_inertia"} or dict, \
            default=("viscous", "coulomb")
        Friction of the robot: names, with coefficients drawn at random in proportion
        to the joint's torque; or names with coefficients, arrays of shape (nv,).
    perturbation : float, default=0.3
        Relative deviation of the true inertias from those of the model; zero uses the
        model's.
    inertial : ndarray of shape (nv, 10), default=None
        True inertial parameters, instead of drawing them.
    undeclared : mapping of {"load_friction", "stribeck", "spring", "ripple", \
            "offset"} to (int, float), default=None
        Effects that a rigid-body model with friction does not contain: name -> joint
        (from zero) and size: a share of the load for load_friction, a stiffness
        [N m/rad or N/m] for spring, a torque [N m or N] for the others.
    base_tilt : (float, float), default=(0.0, 0.0)
        Roll and pitch by which gravity is rotated in the frame of the base, which is
        not level [rad].
    joint_zero : mapping of int to float, default=None
        Encoder readings of joints (from zero) at joint position zero [rad or m].
    joint_axis : mapping of int to (float, float, float), default=None
        Rotation vectors by which the origins of joints are turned, in the frame of the
        joint [rad].
    torque_gain : mapping of int to float, default=None
        Ratio of the torque reading to the torque.
    random_state : int, RandomState instance or None, default=None
        Seed of everything that is drawn.

    Returns
    -------
    SimulatedRecording
        Recording with the truth.

    Raises
    ------
    ValueError
        If a recording has fewer than 16 samples, or a friction, an effect or a joint
        is unknown.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import make_robot_recording
    >>> recording = make_robot_recording(duration=2.0, random_state=0)
    >>> recording.q.shape, recording.joint_names[:2]
    ((400, 6), ('joint_1', 'joint_2'))
    """
    rng = check_random_state(random_state)
    urdf = demo_arm_urdf() if model is None else model
    nominal = load_model(urdf)
    if inertial is None:
        inertial = true_inertias(nominal, perturbation, rng)
    n = round(duration / dt)
    if n < 16:
        raise ValueError(
            f"duration={duration} s at dt={dt} s are {n} samples; expected at least 16."
        )
    for joint in {*(joint_zero or ()), *(joint_axis or ()), *(torque_gain or ())}:
        if joint not in range(nominal.nv):
            raise ValueError(
                f"joints are numbered 0 to {nominal.nv - 1}; got {joint!r}."
            )
    motions = [
        _motion(nominal, n, dt, frequency, n_harmonics, rng)
        for _ in range(n_recordings)
    ]
    states = np.concatenate(motions)
    q, v, a = np.split(states, 3, axis=1)
    robot = _rotated(with_bodies(nominal, inertial), base_tilt, joint_axis or {})
    rigid = rigid_torques(robot, states)
    coefficients = _draw_friction(friction, rigid, v, a, rng)
    signal = {"viscous": v, "coulomb": np.sign(v), "offset": 1.0, "rotor_inertia": a}
    clean = rigid + sum(x * signal[name] for name, x in coefficients.items())
    for name, (joint, size) in (undeclared or {}).items():
        if name not in _UNDECLARED_TORQUES:
            raise ValueError(
                f"Unknown undeclared effect {name!r}; expected some of "
                f"{', '.join(_UNDECLARED_TORQUES)}."
            )
        for rows in np.split(np.arange(len(q)), n_recordings):
            arguments = (x[rows, joint] for x in (q - q.mean(axis=0), q, v, rigid))
            clean[rows, joint] += _UNDECLARED_TORQUES[name](float(size), *arguments)
    zeros = np.zeros(nominal.nv)
    for joint, zero in (joint_zero or {}).items():
        zeros[joint] = zero
    for joint, gain in (torque_gain or {}).items():
        clean[:, joint] *= gain
    noise = torque_noise * clean.std(axis=0)
    return SimulatedRecording(
        name="simulated",
        q=q + zeros + encoder_noise * rng.normal(size=q.shape),
        tau=clean + noise * rng.normal(size=clean.shape),
        **recording_fields(nominal, n, n_recordings, dt),
        urdf=urdf if isinstance(urdf, str) else None,
        description="Simulated by sklearn_vbjfa: rigid bodies with friction, white "
        "encoder and torque noise.",
        states=states,
        tau_clean=clean,
        inertial=inertial,
        friction=coefficients,
        torque_noise=noise,
    )


def load_demo_recording() -> SimulatedRecording:
    """Simulate the recording of a made-up six-axis arm that comes with the package.

    Simulated on the spot and always the same: two motions of 20 s up to 1 Hz at 200 Hz,
    encoder noise of 1e-4 rad, torque noise of 5 %, viscous and Coulomb friction,
    inertias that differ from those in the URDF by about 30 %. Joint 2 also has friction
    of 0.11 times its load, which a model of rigid bodies with viscous and Coulomb
    friction lacks.

    Returns
    -------
    SimulatedRecording
        Recording with the truth; ``recording.urdf`` is the robot description.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> load_demo_recording()
    Recording 'demo': 8000 samples, 6 joints, dt = 0.005 s, 2 recordings
    """
    recording = make_robot_recording(
        duration=20.0,
        frequency=1.0,
        n_recordings=2,
        undeclared={"load_friction": (1, 0.11)},
        random_state=20110,
    )
    return replace(recording, name="demo")


# -- motion and friction ---------------------------------------------------------------


def _rotated(model, base_tilt, joint_axis):
    """Copy a model and rotate gravity, and joint origins in their own frames."""
    pin = import_pinocchio()
    robot = model.copy()
    gravity = robot.gravity.copy()
    gravity.linear = pin.rpy.rpyToMatrix(*base_tilt, 0.0) @ gravity.linear
    robot.gravity = gravity
    for joint, turn in joint_axis.items():
        placement = robot.jointPlacements[joint + 1]
        placement.rotation = placement.rotation @ pin.exp3(np.array(turn))
    return robot


def _motion(model, n, dt, frequency, n_harmonics, rng):
    """Draw states (n, 3 * nv) of sums of sines in all joints, within the limits."""
    t, states = np.arange(n) * dt, np.zeros((3, n, model.nv))
    (centre, reach), speed = joint_range(model), speed_limit(model)
    for j in range(model.nv):
        # Frequencies from a tenth of the highest one up to it.
        f = frequency * (0.1 + 0.9 * rng.uniform(size=n_harmonics))
        f[0] = frequency * rng.uniform(0.85, 1.0)
        w = 2 * np.pi * f
        amp = rng.uniform(0.3, 1.0, size=n_harmonics) / f
        phase = rng.uniform(0, 2 * np.pi, size=n_harmonics)
        s, c = np.sin(np.outer(t, w) + phase), np.cos(np.outer(t, w) + phase)
        largest = np.abs(s @ amp).max(), np.abs(c @ (amp * w)).max()
        amp *= min(
            _RANGE_SHARE * reach[j] / largest[0], _RANGE_SHARE * speed[j] / largest[1]
        )
        states[:, :, j] = centre[j] + s @ amp, c @ (amp * w), -s @ (amp * w**2)
    return np.hstack(list(states))


def _draw_friction(friction, rigid, v, a, rng):
    """Draw friction coefficients in proportion to each joint's torque."""
    size = rigid.std(axis=0)
    share = {
        "viscous": 0.15 * size / v.std(axis=0),
        "coulomb": 0.15 * size,
        "offset": 0.05 * size,
        "rotor_inertia": 0.15 * size / a.std(axis=0),
    }
    if unknown := sorted(set(friction) - share.keys()):
        raise ValueError(f"Unknown friction {unknown}; expected some of {[*share]}.")
    if isinstance(friction, dict):
        return {
            name: np.broadcast_to(np.asarray(value, dtype=float), size.shape)
            for name, value in friction.items()
        }
    return {
        name: share[name] * rng.uniform(0.5, 1.5, size=size.shape) for name in friction
    }


# -- torques that are missing from the declared model ----------------------------------


def _sign(v):
    return np.tanh(v / (_SIGN_SPEED * np.abs(v).max()))


# Name -> function that returns the torque from the size of the effect, the position
# relative to its mean (where springs are at rest), and position, speed and load.
_UNDECLARED_TORQUES = {
    "load_friction": lambda size, away, q, v, load: size * np.abs(load) * _sign(v),
    "stribeck": lambda size, away, q, v, load: (
        size / np.cosh(v / (0.1 * np.abs(v).max())) * _sign(v)
    ),
    "spring": lambda size, away, q, v, load: size * away,
    "ripple": lambda size, away, q, v, load: (
        size * np.sin(2 * np.pi * q / _RIPPLE_PERIOD)
    ),
    "offset": lambda size, away, q, v, load: np.full(q.shape, size),
}


# -- robots ----------------------------------------------------------------------------


def demo_arm_urdf() -> str:
    """Return the path of the URDF of a made-up six-axis arm."""
    robots = resources.files("sklearn_vbjfa.datasets").joinpath("robots")
    return str(robots.joinpath("demo_arm.urdf"))


def joint_range(model):
    """Return centre and half width of each joint's range; a default if unlimited."""
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    # No limits are read as zeros or the largest float, hence halved first.
    reach, centre = 0.5 * high - 0.5 * low, 0.5 * high + 0.5 * low
    unlimited = ~((reach > 0) & (reach <= _DEFAULT_RANGE))
    return np.where(unlimited, 0.0, centre), np.where(unlimited, _DEFAULT_RANGE, reach)


def speed_limit(model):
    """Return the speed limit (nv,) of each joint; a default if there is none."""
    limit = model.velocityLimit
    return np.where((limit > 0) & (limit < 1e3), limit, _DEFAULT_SPEED)


def rigid_torques(model, states):
    """Return the inverse dynamics of a Pinocchio model for rows [q | v | a]."""
    rnea, data = import_pinocchio().rnea, model.createData()
    rows = zip(*np.split(states, 3, axis=1))
    return np.array([rnea(model, data, *row) for row in rows])


def true_inertias(model, perturbation, rng):
    """Draw physically consistent inertial parameters (nv, 10) near the nominal ones."""
    # The pseudo-inertia J of each body is multiplied from both sides by the exponential
    # of a random symmetric matrix, which keeps it positive definite.
    from scipy.linalg import expm

    bodies = []
    for inertia in model.inertias[1:]:
        J = pseudo_inertia(inertia.toDynamicParameters())
        E = rng.normal(scale=0.5 * perturbation, size=(4, 4))
        E = 0.5 * (E + E.T)
        length = np.sqrt(max(np.trace(J[:3, :3]) / max(J[3, 3], 1e-12), 1e-12))
        S = np.diag([length, length, length, 1.0])
        T = S @ expm(E) @ np.linalg.inv(S)
        bodies.append(inertial_parameters(T @ J @ T.T))
    return np.array(bodies)


def recording_fields(model, n, n_recordings, dt):
    """Return the `Recording` fields common to simulations of n rows per motion."""
    slides = is_prismatic(model)
    return {
        "t": np.tile(np.arange(n) * dt, n_recordings),
        "dt": float(dt),
        "groups": np.repeat(np.arange(n_recordings), n),
        "group_names": tuple(f"motion_{k + 1}" for k in range(n_recordings)),
        "joint_names": joint_names(model),
        "position_units": tuple("m" if slide else "rad" for slide in slides),
        "torque_units": tuple("N" if slide else "N m" for slide in slides),
        "licence": "BSD-3-Clause",
    }
