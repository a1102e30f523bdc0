"""Recordings of simulated robots that move under a low-gain controller."""

import os
from dataclasses import dataclass, replace

import numpy as np
from sklearn.utils import check_random_state

from sklearn_vbjfa.datasets._paper_robots import RATES, paper_robot_urdf
from sklearn_vbjfa.datasets._plant import (
    EFFECTS,
    Plant,
    SineMotion,
    draw_motion,
    draw_plant,
    rigid_torques,
)
from sklearn_vbjfa.datasets._robots import _load
from sklearn_vbjfa.datasets._simulation import ClosedLoop, Gains, low_gains
from sklearn_vbjfa.recording._recording import Recording

# Rows that are simulated at once: nothing but the recording itself grows with it.
CHUNK = 4096
_TORQUES = ("measured", "commanded")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ClosedLoopRecording(Recording):
    """A recording of a simulated robot under control, and what it came from.

    Only what a robot would record is in it: no states, and torques with noise.

    Parameters
    ----------
    plant : Plant
        The robot as it is: ``plant.theta(friction)`` are the true parameters of the
        columns of `RobotIdentifier`, ``plant.inertial`` the bodies' alone, and
        ``plant.inverse_dynamics(states)`` the torques with all effects.
    nominal : pinocchio.Model
        The robot as declared, whose inverse dynamics were fed forward.
    motions : tuple of SineMotion
        What was asked of the robot in each recording: ``motions[k].states(t)``.
    gains : Gains
        ``gains.stiffness`` and ``gains.damping`` of the feedback, arrays of shape
        (nv,).
    encoder_noise : float
        Standard deviation of the position noise [rad or m].
    torque_noise : ndarray of shape (nv,)
        Standard deviation of the torque noise [N m or N].

    See Also
    --------
    make_closed_loop_recording : Make one.
    """

    plant: Plant
    nominal: object
    motions: tuple[SineMotion, ...]
    gains: Gains
    encoder_noise: float
    torque_noise: np.ndarray

    def select(self, *names_or_labels):
        """Keep some of the recordings, with their motions; see `Recording.select`."""
        kept = super().select(*names_or_labels)
        labels = [self.group_names.index(name) for name in kept.group_names]
        return replace(kept, motions=tuple(self.motions[label] for label in labels))

    def robot_model(self):
        """Return a copy of `nominal`; see `Recording.robot_model`."""
        return self.nominal.copy()


def resolve_model(model):
    """Path (None for a model without one), nominal model and rate of the paper."""
    urdf = model if isinstance(model, (str, os.PathLike)) else None
    rate = RATES.get(str(urdf), RATES["arm"])
    if urdf is not None:
        urdf = paper_robot_urdf(urdf) if urdf in RATES else os.fspath(urdf)
    return urdf, _load(model if urdf is None else urdf), rate


def closed_loop_chunks(
    plant, nominal, motions, *, n, dt, encoder_noise, rng, gains=None, substeps=1
):
    """Simulate recordings of one length side by side and yield them piece by piece.

    The first second or so shows how the robot settles: it begins in the desired
    state, with the torque that the nominal model says.

    Parameters
    ----------
    plant : Plant
        Robot.
    nominal : pinocchio.Model
        Model whose inverse dynamics are fed forward.
    motions : sequence of SineMotion
        Desired motion of each recording.
    n : int
        Number of samples of each.
    dt : float
        Sample period [s].
    encoder_noise : float
        Standard deviation of the position noise [rad or m].
    rng : RandomState
        Source of the noise.
    gains : Gains, default=None
        Feedback; None takes low ones.
    substeps : int, default=1
        Steps of the integration in a sample period.

    Yields
    ------
    q, torque, command : ndarray of shape (n_rows, n_recordings, nv)
        Encoder readings, torques behind the actuators and commands.
    """
    gains = low_gains(plant) if gains is None else gains
    nv, loop = nominal.nv, None
    step = max(1, CHUNK // len(motions))
    for first in range(0, n, step):
        t = np.arange(first, min(first + step, n)) * dt
        states = np.stack([motion.states(t) for motion in motions], axis=1)
        feedforward = rigid_torques(nominal, states.reshape(-1, 3 * nv))
        feedforward = feedforward.reshape(*states.shape[:2], nv)
        noise = encoder_noise * rng.normal(size=feedforward.shape)
        if loop is None:
            loop = ClosedLoop(plant, gains, dt, states[0], feedforward[0], substeps)
        q, _, torque, command = loop.run(states[..., :nv], feedforward, noise)
        if not np.isfinite(q).all():
            raise ValueError(
                "The simulated robot is unstable under its nominal feedforward and "
                f"low gains, {t[0]:.1f} s after the start; lower perturbation, "
                "effect_size, frequency or dt."
            )
        yield q + noise, torque, command


def make_closed_loop_recording(
    model="arm",
    *,
    duration=60.0,
    dt=None,
    frequency=1.0,
    n_harmonics=3,
    n_recordings=1,
    perturbation=0.25,
    effects="all",
    effect_size=1.0,
    encoder_noise=1e-4,
    torque_noise=0.02,
    torque="measured",
    plant=None,
    random_state=None,
) -> ClosedLoopRecording:
    """Simulate a robot with more dynamics than its model, moved by a controller.

    As in the experiments of [1]_: sinusoids in all joints are tracked by the inverse
    dynamics of the nominal model and a low-gain feedback from the encoders, so that
    the robot moves near to but not as it was asked to, and encoder noise enters the
    torques. The robot differs from its model in its inertias and in effects that no
    rigid-body model has.

    Parameters
    ----------
    model : {"head", "arm"}, str, os.PathLike or pinocchio.Model, default="arm"
        Robot: one of those of [1]_, a URDF file or a model.
    duration : float, default=60.0
        Length of each recording [s].
    dt : float, default=None
        Period of controller and recording [s]. None: 1/420 for "head", as in [1]_,
        and 1/480 otherwise.
    frequency : float, default=1.0
        Highest frequency of the motion [Hz].
    n_harmonics : int, default=3
        Number of sines in each joint.
    n_recordings : int, default=1
        Number of recordings, each with another motion.
    perturbation : float, default=0.25
        How far the true inertias are from those of the model, relative.
    effects : "all" or tuple of str, default="all"
        What the robot has beyond rigid bodies and viscous friction, see Notes:
        "actuator", "cables", "friction", "rotor_inertia", "shell".
    effect_size : float, default=1.0
        Factor on all of them but "actuator".
    encoder_noise : float, default=1e-4
        Standard deviation of the white position noise [rad or m].
    torque_noise : float, default=0.02
        Standard deviation of the white torque noise, as a share of the root mean
        square of each joint's torque.
    torque : {"measured", "commanded"}, default="measured"
        What is recorded as `tau`: the torque behind the actuators with noise, or the
        command to them, which has none.
    plant : Plant, default=None
        ``recording.plant`` of an earlier recording, to move the same robot again;
        `perturbation`, `effects` and `effect_size` are not used then.
    random_state : int, RandomState instance or None, default=None
        Seed of everything that is drawn; an int means one robot and one first motion,
        whatever `duration`, `dt` and `n_recordings` are.

    Returns
    -------
    ClosedLoopRecording
        Recording with the truth.

    Raises
    ------
    ImportError
        If Pinocchio 3 is not installed.
    ValueError
        If an option is unknown, there are fewer than 16 samples, or the robot does
        not follow the motion.

    See Also
    --------
    make_robot_recording : Motions as planned, without dynamics in forward direction.

    Notes
    -----
    The effects are drawn in proportion to the torques of each joint:

    - "actuator": torques lag commands by a first order of 4 ms;
    - "cables": a hardening spring with hysteresis along each joint and the next one
      (10 % and 5 % of the joint's torque);
    - "friction": Coulomb friction (10 %), larger at creeping speed (Stribeck, 5 %);
    - "rotor_inertia": inertia of the drive (15 %);
    - "shell": a cover that touches over 20 % of the way to one limit, with a torque
      that grows with the square of its deformation (25 % half way from there to the
      end of the motion).

    The feedback gives a joint's typical torque for an error of 0.1 rad.

    The forward dynamics are integrated by a leapfrog of second order with one
    evaluation a sample; several recordings, side by side, take less time than one of
    the same number of samples. Only the recording grows with the number of samples.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import make_closed_loop_recording
    >>> make_closed_loop_recording("head", duration=2.0, random_state=0)
    Recording 'head': 840 samples, 7 joints, dt = 0.00238095 s, 1 recording
    """
    if torque not in _TORQUES:
        raise ValueError(f"torque must be one of {_TORQUES}, got {torque!r}.")
    if n_recordings < 1:
        raise ValueError(f"n_recordings must be at least 1, got {n_recordings}.")
    rng = check_random_state(random_state)
    urdf, nominal, rate = resolve_model(model)
    dt = 1.0 / rate if dt is None else dt
    n = round(duration / dt)
    if n < 16:
        raise ValueError(
            f"duration={duration} s at dt={dt} s are {n} samples; expected at least 16."
        )
    # The robot comes before the other motions: however many there are, a seed means
    # one robot.
    motions = [draw_motion(nominal, frequency, n_harmonics, rng)]
    if plant is None:
        plant = draw_plant(
            nominal,
            perturbation=perturbation,
            effects=EFFECTS if effects == "all" else effects,
            effect_size=effect_size,
            motion=motions[0],
            rng=rng,
        )
    while len(motions) < n_recordings:
        motions.append(draw_motion(nominal, frequency, n_harmonics, rng))
    gains = low_gains(plant)
    sensor = torque_noise * plant.torque_size * (torque == "measured")
    q, tau = (np.empty((n_recordings, n, nominal.nv)) for _ in range(2))
    row = 0
    for seen, behind, command in closed_loop_chunks(
        plant,
        nominal,
        motions,
        n=n,
        dt=dt,
        encoder_noise=encoder_noise,
        rng=rng,
        gains=gains,
    ):
        rows = slice(row, row + len(seen))
        row = rows.stop
        if torque == "measured":
            command = behind + sensor * rng.normal(size=behind.shape)
        q[:, rows], tau[:, rows] = seen.swapaxes(0, 1), command.swapaxes(0, 1)
    kinds = [joint.shortname() for joint in nominal.joints[1:]]
    prismatic = [kind.startswith("JointModelP") for kind in kinds]
    return ClosedLoopRecording(
        name=model if isinstance(model, str) and model in RATES else "closed_loop",
        q=q.reshape(-1, nominal.nv),
        tau=tau.reshape(-1, nominal.nv),
        t=np.tile(np.arange(n) * dt, n_recordings),
        dt=float(dt),
        groups=np.repeat(np.arange(n_recordings), n),
        group_names=tuple(f"motion_{k + 1}" for k in range(n_recordings)),
        joint_names=tuple(nominal.names)[1:],
        position_units=tuple("m" if p else "rad" for p in prismatic),
        torque_units=tuple("N" if p else "N m" for p in prismatic),
        urdf=urdf,
        description="Simulated by sklearn_vbjfa: forward dynamics under nominal "
        "feedforward and low-gain feedback, with effects that the model lacks.",
        licence="BSD-3-Clause",
        plant=plant,
        nominal=nominal,
        motions=tuple(motions),
        gains=gains,
        encoder_noise=float(encoder_noise),
        torque_noise=sensor,
    )
