"""Robots under nominal feedforward and a low-gain controller, in forward dynamics.

One evaluation of the dynamics a step: positions live at the sample times and velocities
half way between (leapfrog), friction is implicit at the middle of the step. The error
is of second order, and friction is stable at any step. Without actuator dynamics a jump
of the torques counts as half a step earlier: a torque belongs to the middle of the time
for which it is held.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from sklearn_vbjfa.datasets._robots import (
    EFFECTS,
    RATES,
    STRIBECK_PEAK,
    Plant,
    SineMotion,
    draw_motion,
    draw_plant,
    joint_range,
    recording_fields,
    resolve_model,
    rigid_torques,
)
from sklearn_vbjfa.recording import Recording

# Error at which feedback alone gives the joint's typical torque [rad or m]. Low gains:
# an industrial controller's is a hundredth of it.
_SOFTNESS = 0.1
_DAMPING_RATIO = 0.7
# Cut-off of the derivative of the position error [Hz].
_DERIVATIVE_CUTOFF = 20.0
# Rows that are simulated at once: nothing but the recording itself grows with it.
CHUNK = 4096
# Rows between two looks at whether a robot that tracks a motion is still in hand.
_TRACKING_CHUNK = 512
# A joint that goes faster than this times its speed limit counts as run away.
_SPEEDING = 2.0
_TORQUES = ("measured", "commanded")


# -- the simulator ---------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Gains:
    """Gains of the feedback, (nv,) each."""

    # stiffness: torque over position error [N m/rad or N/m]; damping: over velocity
    # error [N m s/rad or N s/m].

    stiffness: np.ndarray
    damping: np.ndarray


def low_gains(plant: Plant) -> Gains:
    """Return low gains: an error of 0.1 rad gives a joint's typical torque."""
    import pinocchio as pin

    model = plant.model
    middle, _ = joint_range(model)
    inertia = np.diag(pin.crba(model, model.createData(), middle))
    stiffness = plant.torque_size / _SOFTNESS
    damping = 2 * _DAMPING_RATIO * np.sqrt(stiffness * inertia)
    return Gains(stiffness=stiffness, damping=damping)


class Response(NamedTuple):
    """What the robots did, ndarrays of shape (n, n_copies, nv)."""

    # True positions and velocities, torques behind the actuators, commands to them.

    q: np.ndarray
    v: np.ndarray
    torque: np.ndarray
    command: np.ndarray


class ClosedLoop:
    """Copies of a robot with actuators and controller, stepped together."""

    # The controller sees encoder readings: its command is the feedforward plus
    # stiffness times position error plus damping times the low-passed derivative of
    # that error. states (n_copies, 3 nv): [q | v | a] at first; torques (n_copies, nv):
    # behind the actuators then; substeps: of the integration in a period `dt` [s] of
    # controller and recording.

    def __init__(self, plant, gains, dt, states, torques, substeps=1):
        self.plant, self.gains, self.dt = plant, gains, dt
        self._n, self._h = substeps, dt / substeps
        q, v, a = (np.array(x, dtype=float) for x in np.split(states, 3, axis=1))
        self._q, self._a = q, a
        self._u = v - 0.5 * self._h * a  # velocity half a step earlier
        self._tau = np.array(torques, dtype=float)
        self._e = (q - plant.cable_rest) @ plant.routing.T
        self._z = np.zeros_like(self._e)  # hysteresis, an elongation
        self._past = np.zeros_like(q)  # low-pass of the controller
        self._first_speed = v

    def run(self, reference, feedforward, noise) -> Response:
        """Go on for as many periods as there are rows."""
        # Desired positions [rad or m], feedforward [N m or N] and errors of the
        # encoders [rad or m] are (n, n_copies, nv) each.
        out = np.empty((4, *reference.shape))
        # A robot that runs away ends in infinities and nan, which callers look for.
        with np.errstate(all="ignore"):
            if self._first_speed is not None:
                self._set_out(reference[:1] - noise[:1], feedforward[:1])
            self._advance(reference - noise, feedforward, self._n, *out)
        return Response(*out)

    def _set_out(self, seen, feedforward):
        """Find the velocity half a step before the start."""
        # The acceleration that it takes is not the one asked for but the one that the
        # torques give, and friction makes that depend on the velocity in turn.
        state = (self._q, self._u, self._a, self._tau, self._e, self._z, self._past)
        start = [part.copy() for part in state]
        for _ in range(3):
            self._advance(seen, feedforward, 1, *np.empty((4, *seen.shape)))
            a = self._a.copy()
            for part, value in zip(state, start):
                part[:] = value
            self._a[:] = a
            self._u[:] = self._first_speed - 0.5 * self._h * a
        self._first_speed = None

    def _advance(self, seen, feedforward, substeps, q_out, v_out, tau_out, u_out):
        # Python takes half a microsecond for every operation below, whatever its size:
        # they are in place, what is constant is multiplied beforehand, and copies of
        # the robot share them.
        import pinocchio as pin

        plant, h = self.plant, self._h
        model = plant.model.copy()  # its armature changes in every step
        data, aba = model.createData(), pin.aba
        multiply, subtract, maximum = np.multiply, np.subtract, np.maximum

        share = 1 - np.exp(-2 * np.pi * _DERIVATIVE_CUTOFF * self.dt)
        on_error = self.gains.stiffness + self.gains.damping * share / self.dt
        on_past = self.gains.damping * share**2 / self.dt
        high = np.where(model.effortLimit > 0, model.effortLimit, np.inf)
        low = -high
        lagged = plant.lag > 0
        gain = 1 - np.exp(-h / plant.lag) if lagged else 1.0

        inverse_speed = 1 / plant.creep_speed
        coulomb = plant.coulomb * inverse_speed
        extra = plant.stiction / STRIBECK_PEAK * inverse_speed
        viscous, rotor = plant.viscous, np.array(plant.model.armature)
        routing, onto = plant.routing, np.ascontiguousarray(plant.routing.T)
        at_rest = routing @ plant.cable_rest
        turn = 0.5 / plant.cable_turn
        spring, hardening = plant.cable_spring, plant.cable_hardening
        hysteresis = plant.cable_hysteresis / plant.cable_turn
        side, gap = plant.shell_side, plant.shell_gap
        shell = plant.shell_side * plant.shell_stiffness

        q, u, a, tau = self._q, self._u, self._a, self._tau
        e, z, past = self._e, self._z, self._past
        v, error, command, s, t, rhs = (np.empty_like(q) for _ in range(6))
        x, y, w = (np.empty_like(e) for _ in range(3))
        copies = list(zip(q, v, rhs, s, a))
        for k in range(len(seen)):
            # controller
            subtract(seen[k], q, error)
            multiply(error, on_error, command)
            command -= multiply(past, on_past, t)
            command += feedforward[k]
            np.minimum(command, high, out=command)
            maximum(command, low, out=command)
            past *= 1 - share
            past += error
            if not lagged:
                tau[:] = command
            q_out[k], tau_out[k], u_out[k] = q, tau, command
            for i in range(substeps):
                # velocity at the time of q, extrapolated
                multiply(a, 0.5 * h, v)
                v += u
                if i == 0:
                    v_out[k] = v
                # friction: s is its torque over the speed
                multiply(v, inverse_speed, t)
                t *= t
                t += 1.0
                np.reciprocal(t, t)
                np.sqrt(t, s)
                s *= coulomb
                t *= extra
                s += t
                s += viscous
                subtract(tau, multiply(s, u, t), rhs)
                # cables: elongation, hysteresis at the middle of its step, force
                np.dot(q, onto, x)
                x -= at_rest
                subtract(x, e, y)
                e[:] = x
                np.abs(y, x)
                x *= turn
                y -= multiply(x, z, w)
                z += y
                x += 1.0
                z /= x
                multiply(e, e, x)
                x *= hardening
                x += spring
                x *= e
                x += multiply(z, hysteresis, y)
                rhs -= np.dot(x, routing, t)
                # shell
                multiply(q, side, t)
                t -= gap
                maximum(t, 0.0, out=t)
                t *= t
                t *= shell
                rhs -= t
                # Implicit friction: its slope counts as inertia.
                s *= 0.5 * h
                s += rotor
                for q_row, v_row, rhs_row, s_row, a_row in copies:
                    model.armature = s_row
                    a_row[:] = aba(model, data, q_row, v_row, rhs_row)
                u += multiply(a, h, t)
                q += multiply(u, h, t)
                if lagged:
                    subtract(command, tau, t)
                    t *= gain
                    tau += t


# -- recordings ------------------------------------------------------------------------


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


def closed_loop_chunks(
    plant, nominal, motions, *, n, dt, encoder_noise, rng, gains=None, substeps=1
):
    """Simulate recordings of n rows side by side, yield them piece by piece."""
    # Each begins in the desired state of its motion, with the torque that the nominal
    # model says; in the first second or so it settles. Yields encoder readings, torques
    # behind the actuators and commands, (n_rows, n_recordings, nv) each.
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
        made = loop.run(states[..., :nv], feedforward, noise)
        if not np.isfinite(made.q).all():
            raise ValueError(
                "The simulated robot is unstable under its nominal feedforward and "
                f"low gains, {t[0]:.1f} s after the start; lower perturbation, "
                "effect_size, frequency or dt."
            )
        yield made.q + noise, made.torque, made.command


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

    As in the experiments of [1]_, sinusoids in all joints are tracked with the inverse
    dynamics of the nominal model and low-gain feedback from the encoders: the robot
    moves roughly but not exactly as asked, and encoder noise enters the torques. The
    robot differs from its model in its inertias and in effects that no rigid-body model
    has.

    Parameters
    ----------
    model : {"head", "arm"}, str, os.PathLike or pinocchio.Model, default="arm"
        Robot: one of those of [1]_, a URDF or MJCF file, or a model.
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
        ``recording.plant`` of an earlier recording, to move the same robot again; then
        `perturbation`, `effects` and `effect_size` are ignored.
    random_state : int, RandomState instance or None, default=None
        Seed of everything that is drawn; an int gives the same robot and the same first
        motion whatever `duration`, `dt` and `n_recordings` are.

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
    make_robot_recording : Motions exactly as planned, without forward dynamics.

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
    Recording 'head': 840 samples, 7 joints, dt = 0.00238095 s
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
    return ClosedLoopRecording(
        name=model if isinstance(model, str) and model in RATES else "closed_loop",
        q=q.reshape(-1, nominal.nv),
        tau=tau.reshape(-1, nominal.nv),
        **recording_fields(nominal, n, n_recordings, dt),
        urdf=urdf,
        description="Simulated by sklearn_vbjfa: forward dynamics under nominal "
        "feedforward and low-gain feedback, with effects that the model lacks.",
        plant=plant,
        nominal=nominal,
        motions=tuple(motions),
        gains=gains,
        encoder_noise=float(encoder_noise),
        torque_noise=sensor,
    )


# -- tracking --------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class TrackingResult:
    """How well a motion was followed.

    Parameters
    ----------
    position_rmse : ndarray of shape (nv,)
        Root mean square of desired minus true position [rad or m]; nan if failed.
    velocity_rmse : ndarray of shape (nv,)
        The same of the velocity [rad/s or m/s].
    feedback_rms : ndarray of shape (nv,)
        Root mean square of the feedback command [N m or N].
    failure : str
        What stopped the robot; empty if nothing did.
    duration : float
        How long it ran [s].
    """

    position_rmse: np.ndarray
    velocity_rmse: np.ndarray
    feedback_rms: np.ndarray
    failure: str
    duration: float

    @property
    def failed(self):
        """Whether the robot had to be stopped."""
        return bool(self.failure)

    def averages(self):
        """Position, velocity and feedback, averaged over the joints as in the paper.

        Returns
        -------
        tuple of float
            Averages [rad, rad/s, N m]; nan if failed.
        """
        return tuple(
            float(np.mean(x))
            for x in (self.position_rmse, self.velocity_rmse, self.feedback_rms)
        )


def simulate_tracking(
    plant,
    motion,
    feedforward,
    *,
    duration=20.0,
    dt=1.0 / 480.0,
    gains=None,
    encoder_noise=1e-4,
    settle=1.0,
    substeps=1,
    random_state=None,
) -> TrackingResult:
    """Let a robot follow a motion by feedforward torques and low-gain feedback.

    Computed torque as in section 5.2 of [1]_: the identified model gives the torques of
    the desired motion, which is free of noise; feedback from noisy encoders does the
    rest.

    Parameters
    ----------
    plant : Plant
        The robot as it is, such as ``recording.plant``.
    motion : SineMotion
        Desired motion, such as one of ``recording.motions``.
    feedforward : callable or array-like of shape (n, nv)
        Commands to feed forward [N m or N], or a function that computes them from the
        desired states [q | v | a] of shape (n, 3 * nv), such as ``identifier.predict``.
    duration : float, default=20.0
        Length of the motion [s]; n is ``round(duration / dt)``.
    dt : float, default=1/480
        Period of the controller [s].
    gains : Gains, default=None
        Feedback; None takes low ones.
    encoder_noise : float, default=1e-4
        Standard deviation of the white position noise [rad or m].
    settle : float, default=1.0
        Time at the start that is not counted [s]: the robot begins in the desired
        state, but its cables and actuators have yet to settle.
    substeps : int, default=1
        Steps of the integration in a period.
    random_state : int, RandomState instance or None, default=None
        Seed of the noise.

    Returns
    -------
    TrackingResult
        Errors of each joint, and whether the robot had to be stopped: because a joint
        went beyond its limit or twice its speed limit, or because values diverged.

    Raises
    ------
    ValueError
        If the feedforward does not have the shape of the motion, or no samples are left
        after `settle`.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import (
    ...     make_closed_loop_recording,
    ...     simulate_tracking,
    ... )
    >>> robot = make_closed_loop_recording("head", duration=1.0, random_state=0)
    >>> result = simulate_tracking(
    ...     robot.plant, robot.motions[0], robot.plant.inverse_dynamics,
    ...     duration=3.0, dt=robot.dt, random_state=0,
    ... )
    >>> result.failed, bool(result.averages()[0] < 0.01)
    (False, True)
    """
    rng = check_random_state(random_state)
    n, skipped = round(duration / dt), round(settle / dt)
    if skipped >= n:
        raise ValueError(
            f"duration={duration} s leaves nothing to judge after settle={settle} s."
        )
    nv = plant.model.nv
    states = motion.states(np.arange(n) * dt)
    forward = feedforward(states) if callable(feedforward) else feedforward
    forward = np.asarray(forward, dtype=float)
    if forward.shape != (n, nv):
        raise ValueError(
            f"feedforward must have shape {(n, nv)}, one row of torques a period; got "
            f"{forward.shape}."
        )
    if not np.isfinite(forward).all():
        return _stopped(nv, "feedforward that is not a number", 0.0)
    noise = encoder_noise * rng.normal(size=forward.shape)
    gains = low_gains(plant) if gains is None else gains
    loop = ClosedLoop(plant, gains, dt, states[:1], forward[:1], substeps)
    sums = np.zeros((3, nv))
    for first in range(0, n, _TRACKING_CHUNK):
        rows = slice(first, min(first + _TRACKING_CHUNK, n))
        parts = states[rows, :nv], forward[rows], noise[rows]
        made = loop.run(*(part[:, None] for part in parts))
        q, v = made.q[:, 0], made.v[:, 0]
        row, failure = _first_failure(plant.model, q, v)
        if failure:
            return _stopped(nv, failure, (first + row) * dt)
        counted = slice(max(skipped - first, 0), None)
        errors = (
            q - states[rows, :nv],
            v - states[rows, nv : 2 * nv],
            made.command[:, 0] - forward[rows],
        )
        sums += [np.sum(error[counted] ** 2, axis=0) for error in errors]
    position, velocity, feedback = np.sqrt(sums / (n - skipped))
    return TrackingResult(
        position_rmse=position,
        velocity_rmse=velocity,
        feedback_rms=feedback,
        failure="",
        duration=n * dt,
    )


def _stopped(nv, failure, time):
    nothing = np.full(nv, np.nan)
    return TrackingResult(
        position_rmse=nothing,
        velocity_rmse=nothing,
        feedback_rms=nothing,
        failure=failure,
        duration=float(time),
    )


def _first_failure(model, q, v):
    """Row and description of the first thing that stops a robot; (0, "") if none."""
    limit = model.velocityLimit
    limit = np.where(limit > 0, _SPEEDING * limit, np.inf)
    # Comparisons that are False for nan.
    inside = (q >= model.lowerPositionLimit) & (q <= model.upperPositionLimit)
    slow = np.abs(v) <= limit
    bad = np.flatnonzero(~(inside & slow).all(axis=1))
    if bad.size == 0:
        return 0, ""
    row = int(bad[0])
    joint = int(np.flatnonzero(~(inside & slow)[row])[0])
    name = model.names[joint + 1]
    if not (np.isfinite(q[row]).all() and np.isfinite(v[row]).all()):
        return row, "diverged"
    what = "over speed" if inside[row, joint] else "beyond its limit"
    return row, f"{name} {what}"
