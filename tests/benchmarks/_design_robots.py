"""Robots with one undeclared effect, which a low-gain controller takes along a motion.

Forward dynamics in steps of a millisecond: positions live at the steps and velocities
half way between, friction is implicit at the middle of the step. The error is of
second order. Effects are functions of one state, with a memory where they have one;
their amplitudes and parameters are drawn by ``_undeclared_effects.py``. Nothing here
uses the code of the package: what is judged must not make its own exam.

An elastic joint is left out, because that of the other studies has a motor without
inertia; a delay, because it is the channel's and not the robot's; a payload and a
drift, because the clock shows them and no motion does.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from _design_motions import Limits, random_motion, rigid
from _undeclared_effects import ADDED, STEEP, Draw, can_carry
from _undeclared_hysteresis import lugre, maxwell_slip
from _undeclared_robots import (
    feels_gravity,
    inverse_dynamics,
    joint_inertia,
    nominal_robot,
    true_robot,
)
from _undeclared_scene import Setting, lay_out

# Declared where the effect is no friction that they contain.
KINDS = (
    "coulomb",
    "asymmetric_friction",
    "stribeck",
    "viscous_quadratic",
    "load_friction",
    "presliding",
    "backlash",
    "offset",
    "spring",
    "counterbalance",
    "ripple",
    "rotor_inertia",
    "coupling",
)
JOINTS = (2, 3)
REACH = (1.0, 1.6)  # rad, half the range
SPEED = (2.0, 3.0)  # rad/s
# Time in which a joint reaches its full speed [s].
RUN_UP = (0.2, 0.4)
# Torque limit over the largest torque of states drawn evenly within the other limits,
# and over that of standing still, to which friction at full speed is added; torque of a
# drive at its peak over that limit, so that there is room for what is not declared.
TORQUE_SHARE, HOLDING, PEAK = 0.7, 1.3, 1.5
STATES = 300
# Least share of an effect that the declared columns cannot absorb: the rest is hidden,
# and may not be the larger part of what the drives do.
LEAST_SHARE = 0.25
# A robot that its drives cannot take along the reference motion is drawn anew.
MOST_SATURATED = 0.02
# Reference motion, which says how large friction, noise and effect are: as long and
# with as many harmonics as follows.
REFERENCE = 20.0
HARMONICS = 10
RATE = 100.0
# The first recording: half of the range, a quarter of the speed.
POOR = {"range_share": 0.5, "speed_share": 0.25, "acceleration_share": 0.1}

ENCODER_NOISE = 3e-5  # rad
SUBSTEPS = 10
# Error at which the feedback alone gives a joint's typical torque [rad], and cut-off
# of the derivative of the error [Hz].
SOFTNESS, DAMPING_RATIO, CUTOFF = 0.1, 0.7, 20.0
ATTEMPTS = 200


# -- effects, one state at a time ------------------------------------------------------
#
# Each takes the parameters of an effect and a joint, and returns a function
# (q, v, a, load) -> (torque, size of dry friction): lists of all joints, that of the
# load the torque of the rigid bodies in the step before. Dry friction is multiplied by
# the sign of the joint's speed, smooth within a very small speed.


def _sign(v):
    return math.tanh(v / STEEP)


def _coulomb(p, j):
    return lambda q, v, a, load: (0.0, p["Fc"])


def _asymmetric(p, j):
    Fv, Fc = 0.5 * p["Fv_difference"], 0.5 * p["Fc_difference"]

    def torque(q, v, a, load):
        s = _sign(v[j])
        return (1.0 + s) * Fv * v[j] + Fc * s * s, Fc

    return torque


def _stribeck(p, j):
    Fs, vs, k = p["Fs"], p["vs"], p["k"]
    return lambda q, v, a, load: (0.0, Fs * math.exp(-(abs(v[j] / vs) ** k)))


def _quadratic(p, j):
    return lambda q, v, a, load: (p["F2"] * v[j] * abs(v[j]), 0.0)


def _load_friction(p, j):
    return lambda q, v, a, load: (0.0, p["mu"] * abs(load[j]))


def _presliding(p, j):
    return {"lugre": _lugre, "maxwell_slip": _slip}[p["model"]](p, j)


def _lugre(p, j):
    h, z, lag = p["period"], p["displacement"], p["lag"]
    rise, speed, state = p["rise"], p["speed"], 0.0

    def torque(q, v, a, load):
        nonlocal state
        w = v[j]
        way = math.copysign(1.0, w) if w else 0.0
        g = 1.0 + rise * math.exp(-((w / speed) ** 2))
        state = way * g + (state - way * g) * math.exp(-abs(w) / z / g * h)
        return p["Fc"] * (state + lag * w / z * (1.0 - way * state / g)), 0.0

    return torque


def _slip(p, j):
    thresholds, stiffness = np.array(p["thresholds"]), np.array(p["stiffness"])
    level = float(stiffness @ thresholds)
    last, deflection = None, np.zeros(thresholds.size)

    def torque(q, v, a, load):
        nonlocal last, deflection
        if last is not None:
            deflection = np.minimum(
                np.maximum(deflection + (q[j] - last), -thresholds), thresholds
            )
        last = q[j]
        return p["Fc"] * float(stiffness @ deflection) / level, 0.0

    return torque


def _backlash(p, j):
    half, follower = 0.5 * p["width"], None

    def torque(q, v, a, load):
        nonlocal follower
        x = q[j]
        follower = x if follower is None else min(max(follower, x - half), x + half)
        return p["k"] * (follower - p["rest"]), 0.0

    return torque


def _offset(p, j):
    return lambda q, v, a, load: (p["offset"], 0.0)


def _spring(p, j):
    return lambda q, v, a, load: (p["k"] * (q[j] - p["q0"]), 0.0)


def _counterbalance(p, j):
    d, r, turn = p["a"], p["r"], p["beta"] - p["alpha"]

    def torque(q, v, a, load):
        angle = q[j] + turn
        length = math.sqrt(d * d + r * r - 2.0 * d * r * math.cos(angle))
        force = p["F0"] + p["stiffness"] * (d + r - length)
        return -force * d * r * math.sin(angle) / length, 0.0

    return torque


def _ripple(p, j):
    w = 2.0 * math.pi / p["period"]
    return lambda q, v, a, load: (p["A"] * math.cos(w * q[j] + p["phase"]), 0.0)


def _nothing(p, j):
    return lambda q, v, a, load: (0.0, 0.0)


def _coupling(p, j):
    k, own = p["partner"], float(p["differential"])

    def torque(q, v, a, load):
        w = p["ratio"] * v[k] + own * v[j]
        smooth = p["Fv"] * w + p["Ir"] * p["ratio"] * a[k]
        return smooth + p["Fc"] * _sign(w), 0.0

    return torque


LAWS = {
    "coulomb": _coulomb,
    "asymmetric_friction": _asymmetric,
    "stribeck": _stribeck,
    "viscous_quadratic": _quadratic,
    "load_friction": _load_friction,
    "presliding": _presliding,
    "backlash": _backlash,
    "offset": _offset,
    "spring": _spring,
    "counterbalance": _counterbalance,
    "ripple": _ripple,
    "rotor_inertia": _nothing,  # goes to the rotors
    "coupling": _coupling,
}


def law(kind, parameters, joint, period):
    """Make the torque of an effect as a function of one state after the other."""
    if kind == "presliding":
        parameters = {**parameters, "period": period}
    return LAWS[kind](parameters, joint)


def _draw_presliding(world, j, rng):
    """Draw as ``presliding`` of the other studies does, with all that it is made of."""
    z = float(np.exp(rng.uniform(np.log(0.005), np.log(0.05))))
    kind = str(rng.choice(["lugre", "maxwell_slip"]))
    if kind == "lugre":
        fixed = {
            "lag": rng.uniform(0.0, 0.003),
            "rise": rng.uniform(0.0, 0.15),
            "speed": rng.uniform(0.05, 0.15),
        }
        torque = lugre(world.v[:, j], world.dt, displacement=z, **fixed)
    else:
        thresholds = np.linspace(0.2, 2.0, 8)
        stiffness = rng.uniform(0.3, 1.0, size=8) / thresholds**0.5
        thresholds *= z * stiffness.sum() / (stiffness @ thresholds)
        fixed = {"thresholds": thresholds.tolist(), "stiffness": stiffness.tolist()}
        torque = maxwell_slip(world.q[:, j], thresholds, stiffness)
    contains = () if "coulomb" in world.declared else ("coulomb",)
    return Draw(
        torque, {"Fc": 1.0}, {"displacement": z, "model": kind, **fixed}, contains
    )


# -- robots ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Truth:
    """The undeclared effect.

    Parameters
    ----------
    name : str
        One of `KINDS`.
    joint : int
        Joint, from zero.
    parameters : dict
        What it is made of, in SI units.
    contains : tuple of str
        Plainer effects of which it has a part.
    outside : float
        Root mean square, along the reference motion, of the part that the declared
        columns cannot absorb, over the torque noise.
    """

    name: str
    joint: int
    parameters: dict
    contains: tuple
    outside: float


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot and its limits.

    Parameters
    ----------
    nominal, model : pinocchio.Model
        Robot as declared, and the true one.
    declared : tuple of str
        Declared friction.
    friction : dict of str to ndarray of shape (nv,)
        Its true coefficients.
    truth : Truth or None
        What is not declared.
    limits : Limits
        Limits of every motion.
    stiffness, damping : ndarray of shape (nv,)
        Gains of the controller.
    torque_noise : ndarray of shape (nv,)
        Standard deviation of the torque channels' noise [N m].
    """

    nominal: object
    model: object
    declared: tuple
    friction: dict
    truth: Truth | None
    limits: Limits
    stiffness: np.ndarray
    damping: np.ndarray
    torque_noise: np.ndarray


def _draw_limits(nominal, rng):
    nv = nominal.nv
    centre, reach = rng.uniform(-1.0, 1.0, size=nv), rng.uniform(*REACH, size=nv)
    velocity = rng.uniform(*SPEED, size=nv)
    acceleration = velocity / rng.uniform(*RUN_UP, size=nv)
    x = rng.uniform(-1.0, 1.0, size=(3, STATES, nv))
    q, v, a = centre + reach * x[0], velocity * x[1], acceleration * x[2]
    moving = np.abs(inverse_dynamics(nominal, q, v, a)).max(axis=0)
    still = np.abs(inverse_dynamics(nominal, q, 0 * v, 0 * a)).max(axis=0)
    return Limits(
        position=np.column_stack([centre - reach, centre + reach]),
        velocity=velocity,
        acceleration=acceleration,
        torque=np.maximum(TORQUE_SHARE * moving, HOLDING * still),
    )


def _place(kind, scene, size, rng):
    """Put an effect on a joint on which it can have the size; None if there is none."""
    nv = scene.noise.size
    for j in map(int, rng.permutation(nv)):
        if not can_carry(kind, scene.world, j):
            continue
        draw = _draw_presliding if kind == "presliding" else ADDED[kind]
        drawn = draw(scene.world, j, rng)
        torque = np.zeros((drawn.torque.size, nv))
        torque[:, j] = drawn.torque
        share = scene.span.share(torque)
        if share < LEAST_SHARE:
            continue
        rms = np.sqrt(np.mean(drawn.torque**2)) / scene.noise[j]
        factor = size / (share * rms)
        scaled = {key: float(factor * x) for key, x in drawn.scaled.items()}
        return Truth(kind, j, {**drawn.fixed, **scaled}, drawn.contains, float(size))
    return None


def draw_robot(kind, size, seed, n_joints=JOINTS):
    """Draw a robot with one undeclared effect.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    size : float
        Its size along the reference motion; see `Truth`.
    seed : int
        Seed.
    n_joints : tuple of int, default=JOINTS
        Numbers of joints to draw from.

    Returns
    -------
    Robot
        Robot.
    """
    for rng in np.random.default_rng(seed).spawn(ATTEMPTS):
        nominal = nominal_robot("serial", rng, nv=int(rng.choice(n_joints)))
        limits = _draw_limits(nominal, rng)
        nv, t = nominal.nv, np.arange(round(REFERENCE * RATE)) / RATE
        reference = random_motion(rigid(nominal), limits, REFERENCE, HARMONICS, rng)
        if not feels_gravity(nominal, reference.at(t[::20])[0]):
            continue
        with_coulomb = kind != "coulomb" and rng.uniform() < 0.5
        setting = Setting(
            nominal=nominal,
            model=true_robot(nominal, rng),
            motions=[reference],
            t=t,
            groups=np.zeros(t.size, dtype=int),
            dt=1.0 / RATE,
            declared=("viscous", "coulomb") if with_coulomb else ("viscous",),
            levels={
                "viscous": rng.uniform(0.05, 0.3, size=nv),
                "coulomb": rng.uniform(0.05, 0.25, size=nv),
                "noise": rng.uniform(0.02, 0.05, size=nv),
            },
        )
        scene = lay_out(setting)
        truth = _place(kind, scene, size, rng)
        if truth is None:
            continue
        friction = scene.friction["viscous"] * limits.velocity
        friction = friction + scene.friction.get("coulomb", 0.0)
        limits = replace(limits, torque=limits.torque + friction)
        typical = np.sqrt(np.mean(scene.world.declared_torque**2, axis=0))
        stiffness = typical / SOFTNESS
        inertia = joint_inertia(nominal, scene.world.q)
        robot = Robot(
            nominal=nominal,
            model=setting.model,
            declared=setting.declared,
            friction=scene.friction,
            truth=truth,
            limits=limits,
            stiffness=stiffness,
            damping=2.0 * DAMPING_RATIO * np.sqrt(stiffness * inertia),
            torque_noise=scene.noise,
        )
        if _is_in_hand(robot, reference):
            return robot
    raise ValueError(f"No robot has {kind} of the size {size:g} with the seed {seed}.")


def _is_in_hand(robot, motion):
    """Whether a controller can take a robot along a motion."""
    try:
        made = execute(robot, motion, REFERENCE, 1.0 / RATE, np.random.default_rng(0))
    except Unstable:
        return False
    return made.saturated <= MOST_SATURATED


class Unstable(ValueError):
    """A robot that its controller cannot hold."""


# -- motions, executed -----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Execution:
    """What a robot did and what was recorded of it.

    Parameters
    ----------
    q, tau : ndarray of shape (n, nv)
        Encoders [rad] and torque channels [N m], with their noise.
    states : ndarray of shape (n, 3 nv)
        True [q | v | a].
    torque : ndarray of shape (n, nv)
        True torques.
    tracking : float
        Root mean square of the position error [rad].
    saturated : float
        Share of the time in which a drive was at the limit of its torque.
    """

    q: np.ndarray
    tau: np.ndarray
    states: np.ndarray
    torque: np.ndarray
    tracking: float
    saturated: float


def execute(robot, motion, duration, dt, rng, *, undeclared=True):
    """Take a robot along a motion with nominal feedforward and low gains.

    Parameters
    ----------
    robot : Robot
        Robot.
    motion : object
        With ``at(t)`` -> (q, v, a), as `Series`.
    duration, dt : float
        Length and period of the recording [s]; the controller runs `SUBSTEPS` times
        as fast, and sees the encoders with their noise.
    rng : numpy.random.Generator
        Source of the noise.
    undeclared : bool, default=True
        Whether the robot has its undeclared effect.

    Returns
    -------
    Execution
        Motion as it was, and the recording.
    """
    n, h = round(duration / dt), dt / SUBSTEPS
    asked = motion.at(np.arange(n * SUBSTEPS) * h)
    forward = inverse_dynamics(robot.nominal, *asked)
    noise = ENCODER_NOISE * rng.normal(size=forward.shape)
    with np.errstate(all="ignore"):
        q, v, a, torque = _simulate(robot, asked, forward, noise, h, undeclared)
    peak = PEAK * robot.limits.torque
    if not np.isfinite(q).all():
        raise Unstable("The simulated robot is unstable under its controller.")
    rows = slice(None, None, SUBSTEPS)
    error = robot.torque_noise * rng.normal(size=(n, robot.model.nv))
    return Execution(
        q=q[rows] + noise[rows],
        tau=torque[rows] + error,
        states=np.hstack([q[rows], v[rows], a[rows]]),
        torque=torque[rows],
        tracking=float(np.sqrt(np.mean((q - asked[0]) ** 2))),
        saturated=float(np.mean(np.any(np.abs(torque) >= peak, axis=1))),
    )


def _simulate(robot, asked, forward, noise, h, undeclared):
    """States and torques (n, nv) at the controller's steps."""
    import pinocchio as pin

    n, nv = forward.shape
    model = robot.model.copy()
    data, rigid = model.createData(), robot.model.createData()
    none = np.zeros(nv)
    viscous = robot.friction.get("viscous", none)
    declared = robot.friction.get("coulomb", none)
    rotor, effect, j, loaded = np.zeros(nv), None, 0, False
    if undeclared and robot.truth is not None:
        truth = robot.truth
        j, loaded = truth.joint, truth.name == "load_friction"
        effect = law(truth.name, truth.parameters, j, h)
        if truth.name == "rotor_inertia":
            rotor[j] = truth.parameters["Ir"]
    share = 1.0 - math.exp(-2.0 * math.pi * CUTOFF * h)
    on_error = robot.stiffness + robot.damping * share / h
    on_past = robot.damping * share**2 / h
    limit = PEAK * robot.limits.torque
    x = asked[0][0].copy()
    acceleration = asked[2][0].copy()
    speed = asked[1][0] - 0.5 * h * acceleration  # half a step earlier
    past, load = np.zeros(nv), none
    out = np.empty((4, n, nv))
    dry = declared.copy()
    for k in range(n):
        error = asked[0][k] - noise[k] - x
        drive = forward[k] + on_error * error - on_past * past
        drive = np.minimum(np.maximum(drive, -limit), limit)
        past = (1.0 - share) * past + error
        now = speed + 0.5 * h * acceleration
        rest = drive
        if effect is not None:
            if loaded:
                load = pin.rnea(robot.model, rigid, x, now, acceleration)
            smooth, size = effect(x, now, acceleration, load)
            dry[j] = declared[j] + size
            rest = drive.copy()
            rest[j] -= smooth
        # friction over the speed, whose slope counts as inertia
        w = now / STEEP
        slope = np.divide(np.tanh(w), w, out=np.ones(nv), where=np.abs(w) > 1e-6)
        slope = dry * slope / STEEP + viscous
        model.armature = rotor + 0.5 * h * slope
        out[0, k], out[1, k], out[3, k] = x, now, drive
        acceleration = pin.aba(model, data, x, speed, rest - slope * speed).copy()
        out[2, k] = acceleration
        speed = speed + h * acceleration
        x = x + h * speed
    return out


def inverse(robot, execution, dt):
    """Torques (n, nv) that the executed motion takes, by the effects' own laws."""
    q, v, a = np.split(execution.states, 3, axis=1)
    rigid = inverse_dynamics(robot.model, q, v, a)
    torque = rigid + robot.friction.get("viscous", 0.0) * v
    torque += robot.friction.get("coulomb", 0.0) * np.tanh(v / STEEP)
    truth = robot.truth
    if truth is not None:
        effect = law(truth.name, truth.parameters, truth.joint, dt)
        j, Ir = truth.joint, truth.parameters.get("Ir", 0.0)
        for i in range(len(q)):
            smooth, dry = effect(q[i], v[i], a[i], rigid[i])
            torque[i, j] += smooth + dry * _sign(v[i, j])
        if truth.name == "rotor_inertia":
            torque[:, j] += Ir * a[:, j]
    return torque
