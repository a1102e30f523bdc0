"""Robots like those of the paper, simulated under a controller.

Head and arm are made up after sections 5.2 and 5.3 of Ting, D'Souza and Schaal (2011):
sizes and masses are plausible, not those of the robots. A step evaluates the dynamics
once: positions live at the sample times and velocities half way between (leapfrog),
friction is implicit at the middle of the step.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from sklearn.utils import check_random_state

from sklearn_vbjfa.datasets import (
    Recording,
    joint_range,
    recording_fields,
    rigid_torques,
    speed_limit,
    true_inertias,
)
from sklearn_vbjfa.model import load_model, nominal_parameters, with_bodies

# Rate of the controller of either robot in the paper [Hz].
RATES = {"head": 420.0, "arm": 480.0}
# Size of each effect as a share of the standard deviation of the joint's rigid-body
# torque, times 0.5 to 1.5: at typical speed, elongation (hardening: twice that) and
# acceleration, and half way from where the shell touches to the end of the motion.
_SHARES = {
    "viscous": 0.15,
    "coulomb": 0.10,
    "stiction": 0.05,
    "cable_spring": 0.10,
    "cable_hardening": 0.05,
    "cable_hysteresis": 0.05,
    "shell": 0.25,
    "rotor_inertia": 0.15,
}
# Speed at which Coulomb friction is fully there, in units of the typical speed.
_CREEP = 0.04
# Elongation over which a cable's hysteresis turns round, in units of the typical one.
_TURN = 0.15
# Arm of a cable at the next joint of the chain, for joints of the same torque.
_COUPLING = 0.3
# The shell touches beyond this share of the way from the centre to the limit.
_SHELL_GAP = 0.2
# Time constant of the actuators [s].
_LAG = 0.004
# Largest value of r / (1 + r^2), which shapes the extra friction at creeping speed.
STRIBECK_PEAK = 0.5
# Share of a joint's range and speed that a motion uses at most.
_RANGE_SHARE = 0.6
_SPEED_SHARE = 0.5
_PERTURBATION = 0.25  # of the inertias, relative
_ENCODER_NOISE = 1e-4  # [rad]
_TORQUE_NOISE = 0.02  # as a share of the torque
# Error at which feedback alone gives the joint's typical torque [rad or m]. Low gains:
# an industrial controller's is a hundredth of it.
_SOFTNESS = 0.1
_DAMPING_RATIO = 0.7
# Cut-off of the derivative of the position error [Hz].
_DERIVATIVE_CUTOFF = 20.0
# Rows that are simulated at once: nothing but the recording itself grows with it.
_CHUNK = 4096
# Rows between two looks at whether a robot that tracks a motion is still in hand.
_TRACKING_CHUNK = 512
# A joint that goes faster than this times its speed limit counts as run away.
_SPEEDING = 2.0
# Time at the start that does not count [s].
_SETTLE = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SineMotion:
    """Sum of sines in all joints, as long as one likes."""

    # centre (nv,) [rad or m]; amplitude [rad or m], frequency [Hz], phase [rad]: (nv,
    # n_harmonics).

    centre: np.ndarray
    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray

    def states(self, t):
        """Return the states (n, 3 * nv), [q | v | a], at times t (n,) [s]."""
        w = 2 * np.pi * self.frequency
        angle = t[:, None, None] * w + self.phase
        s, c = np.sin(angle), np.cos(angle)
        q = self.centre + (self.amplitude * s).sum(axis=-1)
        v = (self.amplitude * w * c).sum(axis=-1)
        a = -(self.amplitude * w**2 * s).sum(axis=-1)
        return np.hstack([q, v, a])


def draw_motion(model, frequency, n_harmonics, rng):
    """Draw a motion of sines in all joints."""
    # Frequencies [Hz] go from a tenth of the highest up to it; whenever the sines meet,
    # the motion stays within 60 % of the range and half the speed limit.
    shape = (model.nv, n_harmonics)
    centre, reach = joint_range(model)
    f = frequency * rng.uniform(0.1, 1.0, size=shape)
    f[:, 0] = frequency * rng.uniform(0.85, 1.0, size=model.nv)
    size = rng.uniform(0.3, 1.0, size=shape) / f
    phase = rng.uniform(0, 2 * np.pi, size=shape)
    room = np.minimum(
        _RANGE_SHARE * reach / size.sum(axis=1),
        _SPEED_SHARE * speed_limit(model) / (2 * np.pi * f * size).sum(axis=1),
    )
    return SineMotion(
        centre=centre, amplitude=size * room[:, None], frequency=f, phase=phase
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Plant:
    """A robot with all that its declared model lacks."""

    # model: true inertias, with rotor inertias [kg m^2 or kg] in its ``armature``;
    # torque_size (nv,): root mean square of the torque in a typical motion [N m or N];
    # viscous (nv,) [N m s/rad or N s/m]; coulomb, stiction (nv,): friction at speed,
    # and how much more of it there is at creeping speed [N m]; creep_speed (nv,): where
    # friction has reached 71 % of its size; lag: time constant of the actuators [s],
    # zero for torques at once.
    # routing (n_cables, nv): elongation of each cable by each joint; cable_rest (nv,):
    # position in which no cable pulls; cable_spring, cable_hardening (n_cables,):
    # linear and cubic stiffness [N m/rad, N m/rad^3]; cable_hysteresis (n_cables,):
    # torque when turned round [N m], over an elongation of cable_turn [rad].
    # shell_side (nv,): +1 or -1, towards which limit the shell is in the way; shell_gap
    # (nv,): where it begins to touch, ``shell_side * q``; shell_stiffness (nv,): torque
    # over squared deformation [N m/rad^2].

    model: pin.Model
    torque_size: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    stiction: np.ndarray
    creep_speed: np.ndarray
    routing: np.ndarray
    cable_rest: np.ndarray
    cable_spring: np.ndarray
    cable_hardening: np.ndarray
    cable_hysteresis: np.ndarray
    cable_turn: np.ndarray
    shell_side: np.ndarray
    shell_gap: np.ndarray
    shell_stiffness: np.ndarray
    lag: float

    @property
    def inertial(self):
        """True inertial parameters of each body, ndarray of shape (nv, 10)."""
        return nominal_parameters(self.model)

    def theta(self, friction=("viscous",)):
        """Return the true parameters of a declared model, (nv (10 + n_friction),)."""
        # What the robot does not have is zero.
        known = {
            "viscous": self.viscous,
            "coulomb": self.coulomb,
            "offset": np.zeros_like(self.viscous),
            "rotor_inertia": np.asarray(self.model.armature),
        }
        extra = [known[name] for name in friction]
        return np.column_stack([self.inertial, *extra]).ravel()

    def friction_torque(self, v):
        """Torque that friction takes at speeds v [N m]."""
        r = v / self.creep_speed
        w = 1.0 / (1.0 + r * r)
        extra = self.stiction / STRIBECK_PEAK
        return self.viscous * v + r * (self.coulomb * np.sqrt(w) + extra * w)

    def cable_torque(self, q):
        """Torque that the cables take along positions q, ndarray of shape (n, nv)."""
        # The hysteresis is neutral in the first row and follows the rows in order.
        e = (q - self.cable_rest) @ self.routing.T
        z = np.zeros_like(e)
        for k in range(1, len(e)):
            de = e[k] - e[k - 1]
            c = 0.5 * np.abs(de) / self.cable_turn
            z[k] = (z[k - 1] * (1 - c) + de) / (1 + c)
        force = e * (self.cable_spring + self.cable_hardening * e * e)
        return (force + self.cable_hysteresis * z / self.cable_turn) @ self.routing

    def shell_torque(self, q):
        """Torque that the shells take at positions q [N m]."""
        deep = np.maximum(self.shell_side * q - self.shell_gap, 0.0)
        return self.shell_side * self.shell_stiffness * deep**2

    def inverse_dynamics(self, states):
        """Torques (n, nv) behind the actuators for states (n, 3 nv), row after row."""
        q, v, _ = np.split(states, 3, axis=1)
        rigid = rigid_torques(self.model, states)
        return (
            rigid
            + self.friction_torque(v)
            + self.cable_torque(q)
            + self.shell_torque(q)
        )


def draw_plant(nominal, motion, rng):
    """Draw a robot that differs from its nominal model."""
    # `motion` gives typical torques, speeds and accelerations.
    model = with_bodies(nominal, true_inertias(nominal, _PERTURBATION, rng))
    nv = model.nv
    # A minute of the slowest motion, densely enough for its standard deviations.
    states = motion.states(np.linspace(0.0, 60.0, 1201))
    q, v, a = np.split(states, 3, axis=1)
    size = rigid_torques(model, states).std(axis=0)
    speed, acceleration = v.std(axis=0), a.std(axis=0)

    def draw(name, unit):
        return rng.uniform(0.5, 1.5, size=nv) * _SHARES[name] * size / unit

    # A cable runs along each joint and the first one that follows it.
    routing = np.eye(nv)
    for j in range(nv):
        children = [i for i in range(nv) if model.parents[i + 1] == j + 1]
        # Its arm at a weak joint is short, or it would be the stronger of the two.
        weaker = np.minimum(size[children[:1]] / size[j], 1.0)
        routing[j, children[:1]] = _COUPLING * weaker
    centre, reach = joint_range(model)
    rest = centre + 0.2 * reach * rng.uniform(-1, 1, size=nv)
    stretch = ((q - rest) @ routing.T).std(axis=0)
    side = rng.choice([-1.0, 1.0], size=nv)
    depth = 0.5 * (_RANGE_SHARE - _SHELL_GAP) * reach
    model.armature = draw("rotor_inertia", acceleration)
    plant = Plant(
        model=model,
        torque_size=size,
        viscous=draw("viscous", speed),
        coulomb=draw("coulomb", 1.0),
        stiction=draw("stiction", 1.0),
        creep_speed=_CREEP * speed,
        routing=routing,
        cable_rest=rest,
        cable_spring=draw("cable_spring", stretch),
        cable_hardening=draw("cable_hardening", (2 * stretch) ** 3),
        cable_hysteresis=draw("cable_hysteresis", 1.0),
        cable_turn=_TURN * stretch,
        shell_side=side,
        shell_gap=side * centre + _SHELL_GAP * reach,
        shell_stiffness=draw("shell", depth**2),
        lag=_LAG,
    )
    torques = plant.inverse_dynamics(states)
    return replace(plant, torque_size=np.sqrt(np.mean(torques**2, axis=0)))


# -- the simulator ---


@dataclass(frozen=True, kw_only=True, eq=False)
class Gains:
    """Gains of the feedback, (nv,) each."""

    stiffness: np.ndarray  # torque over position error [N m/rad]
    damping: np.ndarray  # torque over velocity error [N m s/rad]


def low_gains(plant: Plant) -> Gains:
    """Return low gains: an error of 0.1 rad gives a joint's typical torque."""
    model = plant.model
    middle, _ = joint_range(model)
    inertia = np.diag(pin.crba(model, model.createData(), middle))
    stiffness = plant.torque_size / _SOFTNESS
    damping = 2 * _DAMPING_RATIO * np.sqrt(stiffness * inertia)
    return Gains(stiffness=stiffness, damping=damping)


class ClosedLoop:
    """Copies of a robot with actuators and controller, stepped together."""

    # The controller sees encoder readings: its command is the feedforward plus
    # stiffness times position error plus damping times the low-passed derivative of
    # that error. states (n_copies, 3 nv): [q | v | a] at first; torques (n_copies, nv):
    # behind the actuators then.

    def __init__(self, plant, gains, dt, states, torques):
        self.plant, self.gains, self.dt = plant, gains, dt
        q, v, a = (np.array(x, dtype=float) for x in np.split(states, 3, axis=1))
        self._q, self._a = q, a
        self._u = v - 0.5 * dt * a  # velocity half a step earlier
        self._tau = np.array(torques, dtype=float)
        self._e = (q - plant.cable_rest) @ plant.routing.T
        self._z = np.zeros_like(self._e)  # hysteresis, an elongation
        self._past = np.zeros_like(q)  # low-pass of the controller
        self._first_speed = v

    def run(self, reference, feedforward, noise):
        """Return positions, velocities, torques and commands (n, n_copies, nv)."""
        # So large are desired positions, feedforward and errors of the encoders, too.
        out = np.empty((4, *reference.shape))
        # A robot that runs away ends in infinities and nan, which callers look for.
        with np.errstate(all="ignore"):
            if self._first_speed is not None:
                self._set_out(reference[:1] - noise[:1], feedforward[:1])
            self._advance(reference - noise, feedforward, *out)
        return out

    def _set_out(self, seen, feedforward):
        """Find the velocity half a step before the start."""
        # The acceleration that it takes is not the one asked for but the one that the
        # torques give, and friction makes that depend on the velocity in turn.
        state = (self._q, self._u, self._a, self._tau, self._e, self._z, self._past)
        start = [part.copy() for part in state]
        for _ in range(3):
            self._advance(seen, feedforward, *np.empty((4, *seen.shape)))
            a = self._a.copy()
            for part, value in zip(state, start):
                part[:] = value
            self._a[:] = a
            self._u[:] = self._first_speed - 0.5 * self.dt * a
        self._first_speed = None

    def _advance(self, seen, feedforward, q_out, v_out, tau_out, u_out):
        # Python takes half a microsecond for every operation below, whatever its size:
        # they are in place, what is constant is multiplied beforehand, and copies of
        # the robot share them.
        plant, h = self.plant, self.dt
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
            # velocity at the time of q, extrapolated
            multiply(a, 0.5 * h, v)
            v += u
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


# -- recordings ---


def closed_loop_chunks(plant, nominal, motions, n, dt, rng):
    """Simulate recordings of n rows together; yield encoder readings and torques."""
    # Each begins in the desired state of its motion, with the torque of the nominal
    # model; in the first second or so it settles.
    nv, loop = nominal.nv, None
    step = max(1, _CHUNK // len(motions))
    for first in range(0, n, step):
        t = np.arange(first, min(first + step, n)) * dt
        states = np.stack([motion.states(t) for motion in motions], axis=1)
        feedforward = rigid_torques(nominal, states.reshape(-1, 3 * nv))
        feedforward = feedforward.reshape(*states.shape[:2], nv)
        noise = _ENCODER_NOISE * rng.normal(size=feedforward.shape)
        if loop is None:
            loop = ClosedLoop(plant, low_gains(plant), dt, states[0], feedforward[0])
        q, _, torque, _ = loop.run(states[..., :nv], feedforward, noise)
        if not np.isfinite(q).all():
            raise ValueError("The simulated robot is unstable; lower dt.")
        yield q + noise, torque


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ClosedLoopRecording(Recording):
    """A recording of a simulated robot under control, and what it came from."""

    plant: Plant  # the robot as it is
    nominal: object  # its model, whose inverse dynamics were fed forward
    motions: tuple[SineMotion, ...]  # what was asked of the robot in each recording

    def robot_model(self):
        """Return a copy of the model."""
        return self.nominal.copy()


def load_paper_robot(name):
    """Load the model of the "head" (seven joints) or the "arm" (ten)."""
    return load_model(str(Path(__file__).with_name(f"{name}.urdf")))


def make_closed_loop_recording(
    name, *, duration, dt=None, n_recordings=1, plant=None, random_state=None
):
    """Simulate the head or the arm, which differs from its model, under a controller.

    Sinusoids in all joints are tracked with the inverse dynamics of the model and
    low-gain feedback from noisy encoders. The robot has other inertias, rotor inertias,
    dry friction, cables with hysteresis, shells that touch, and actuators with a lag.
    """
    rng = check_random_state(random_state)
    nominal, dt = load_paper_robot(name), 1.0 / RATES[name] if dt is None else dt
    n = round(duration / dt)
    # The robot comes before the other motions: a seed means one robot, however many
    # there are.
    motions = [draw_motion(nominal, 1.0, 3, rng)]
    if plant is None:
        plant = draw_plant(nominal, motions[0], rng)
    while len(motions) < n_recordings:
        motions.append(draw_motion(nominal, 1.0, 3, rng))
    sensor = _TORQUE_NOISE * plant.torque_size
    q, tau = (np.empty((n_recordings, n, nominal.nv)) for _ in range(2))
    row = 0
    for seen, torque in closed_loop_chunks(plant, nominal, motions, n, dt, rng):
        rows = slice(row, row + len(seen))
        row = rows.stop
        torque = torque + sensor * rng.normal(size=torque.shape)
        q[:, rows], tau[:, rows] = seen.swapaxes(0, 1), torque.swapaxes(0, 1)
    return ClosedLoopRecording(
        name=name,
        q=q.reshape(-1, nominal.nv),
        tau=tau.reshape(-1, nominal.nv),
        **recording_fields(nominal, n, n_recordings, dt),
        plant=plant,
        nominal=nominal,
        motions=tuple(motions),
        torque_noise=sensor,
    )


# -- tracking --------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class TrackingResult:
    """Root mean squares (nv,) of errors; nan if the robot was stopped."""

    position_rmse: np.ndarray  # [rad]
    velocity_rmse: np.ndarray  # [rad/s]
    feedback_rms: np.ndarray  # [N m]
    failure: str  # what stopped the robot; empty if nothing did

    def averages(self):
        """Return position, velocity and feedback, averaged over the joints."""
        found = self.position_rmse, self.velocity_rmse, self.feedback_rms
        return tuple(float(np.mean(x)) for x in found)


def simulate_tracking(plant, motion, feedforward, *, duration, dt, random_state=None):
    """Let a robot follow a motion by a feedforward model and low-gain feedback.

    The model computes torques from the desired states [q | v | a], (n, 3 nv), as in
    section 5.2 of the paper. The first second is not counted.
    """
    rng = check_random_state(random_state)
    n, skipped, nv = round(duration / dt), round(_SETTLE / dt), plant.model.nv
    states = motion.states(np.arange(n) * dt)
    forward = np.asarray(feedforward(states), dtype=float)
    if not np.isfinite(forward).all():
        return _stopped(nv, "feedforward that is not a number")
    noise = _ENCODER_NOISE * rng.normal(size=forward.shape)
    loop = ClosedLoop(plant, low_gains(plant), dt, states[:1], forward[:1])
    sums = np.zeros((3, nv))
    for first in range(0, n, _TRACKING_CHUNK):
        rows = slice(first, min(first + _TRACKING_CHUNK, n))
        parts = states[rows, :nv], forward[rows], noise[rows]
        q, v, _, command = (x[:, 0] for x in loop.run(*(x[:, None] for x in parts)))
        failure = _first_failure(plant.model, q, v)
        if failure:
            return _stopped(nv, failure)
        counted = slice(max(skipped - first, 0), None)
        errors = (
            q - states[rows, :nv],
            v - states[rows, nv : 2 * nv],
            command - forward[rows],
        )
        sums += [np.sum(error[counted] ** 2, axis=0) for error in errors]
    position, velocity, feedback = np.sqrt(sums / (n - skipped))
    return TrackingResult(
        position_rmse=position,
        velocity_rmse=velocity,
        feedback_rms=feedback,
        failure="",
    )


def _stopped(nv, failure):
    nothing = np.full(nv, np.nan)
    return TrackingResult(
        position_rmse=nothing,
        velocity_rmse=nothing,
        feedback_rms=nothing,
        failure=failure,
    )


def _first_failure(model, q, v):
    """Return what stops a robot first, empty if nothing does."""
    limit = model.velocityLimit
    limit = np.where(limit > 0, _SPEEDING * limit, np.inf)
    # Comparisons that are False for nan.
    inside = (q >= model.lowerPositionLimit) & (q <= model.upperPositionLimit)
    slow = np.abs(v) <= limit
    bad = np.flatnonzero(~(inside & slow).all(axis=1))
    if bad.size == 0:
        return ""
    row = int(bad[0])
    joint = int(np.flatnonzero(~(inside & slow)[row])[0])
    name = model.names[joint + 1]
    if not (np.isfinite(q[row]).all() and np.isfinite(v[row]).all()):
        return "diverged"
    what = "over speed" if inside[row, joint] else "beyond its limit"
    return f"{name} {what}"
