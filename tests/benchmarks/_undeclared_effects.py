"""Effects a declared robot model may lack, by their own physics.

Each function draws the shape of one effect on one joint and returns its torque for an
amplitude of one. Friction jumps with the sign of the speed, hysteresis is integrated in
time and the gas spring is made of its attachment points: what looks for the effects has
other formulas than what makes them.
"""

from dataclasses import dataclass, field

import numpy as np
from _undeclared_hysteresis import first_order_lag, lugre, maxwell_slip, pieces, play
from _undeclared_robots import is_prismatic, own_inertia, regressor


@dataclass(frozen=True)
class World:
    """A robot in motion, before anything undeclared is added."""

    model: object
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    t: np.ndarray
    dt: float
    groups: np.ndarray
    rigid: np.ndarray
    declared_torque: np.ndarray
    declared: tuple
    unit: np.ndarray


@dataclass(frozen=True)
class Draw:
    """Torque of one effect for an amplitude of one."""

    torque: np.ndarray
    scaled: dict
    fixed: dict = field(default_factory=dict)
    contains: tuple = ()


def _unless_declared(world, *names):
    return tuple(name for name in names if name not in world.declared)


def _rms(x):
    return float(np.sqrt(np.mean(x**2)))


def viscous(world, j, rng):
    """Draw Fv v."""
    return Draw(world.v[:, j], {"Fv": 1.0})


def coulomb(world, j, rng):
    """Draw Fc sign(v)."""
    return Draw(np.sign(world.v[:, j]), {"Fc": 1.0})


def asymmetric_friction(world, j, rng):
    """Draw more friction forwards than backwards."""
    v = world.v[:, j]
    share = rng.uniform(0.2, 0.6) if "coulomb" in world.declared else 0.0
    forwards = 0.5 * (1.0 + np.sign(v))
    Fv = (1.0 - share) / _rms(v)
    torque = forwards * (Fv * v + share * np.sign(v))
    contains = ("offset",) if share else ()
    return Draw(torque, {"Fv_difference": Fv, "Fc_difference": share}, {}, contains)


def stribeck(world, j, rng):
    """Draw Fs exp(-|v / vs|^k) sign(v)."""
    vs = rng.uniform(0.08, 0.4) * world.unit[j]
    k = int(rng.integers(1, 3))
    torque = np.exp(-(np.abs(world.v[:, j] / vs) ** k)) * np.sign(world.v[:, j])
    contains = _unless_declared(world, "coulomb")
    return Draw(torque, {"Fs": 1.0}, {"vs": vs, "k": k}, contains)


def viscous_quadratic(world, j, rng):
    """Draw F2 v |v|."""
    v = world.v[:, j]
    return Draw(v * np.abs(v), {"F2": 1.0})


def load_friction(world, j, rng):
    """Draw mu |torque of the rigid bodies| sign(v)."""
    torque = np.abs(world.rigid[:, j]) * np.sign(world.v[:, j])
    return Draw(torque, {"mu": 1.0}, {}, _unless_declared(world, "coulomb"))


def maxwell_slip_or_lugre(world, j, rng):
    """Draw friction that builds up over a displacement after each reversal."""
    z = np.exp(rng.uniform(np.log(0.005), np.log(0.05))) * world.unit[j]
    torque = np.zeros(world.t.size)
    kind = str(rng.choice(["lugre", "maxwell_slip"]))
    if kind == "lugre":
        lag, rise = rng.uniform(0.0, 0.003), rng.uniform(0.0, 0.15)
        speed = rng.uniform(0.05, 0.15) * world.unit[j]
        for rows in pieces(world.groups):
            torque[rows] = lugre(
                world.v[rows, j],
                world.dt,
                displacement=z,
                lag=lag,
                rise=rise,
                speed=speed,
            )
    else:
        thresholds = np.linspace(0.2, 2.0, 8)
        stiffness = rng.uniform(0.3, 1.0, size=8) / thresholds**0.5
        thresholds *= z * stiffness.sum() / (stiffness @ thresholds)
        for rows in pieces(world.groups):
            torque[rows] = maxwell_slip(world.q[rows, j], thresholds, stiffness)
    fixed = {"displacement": z, "model": kind}
    return Draw(torque, {"Fc": 1.0}, fixed, _unless_declared(world, "coulomb"))


def backlash(world, j, rng):
    """Draw a spring on a part that the joint pushes through a gap."""
    width = rng.uniform(0.1, 0.5) * world.unit[j]
    torque = np.zeros(world.t.size)
    for rows in pieces(world.groups):
        torque[rows] = play(world.q[rows, j], width)
    rest = float(world.q[:, j].mean())
    fixed = {"width": width, "rest": rest}
    return Draw(torque - rest, {"k": 1.0}, fixed, ("spring", "offset"))


def offset(world, j, rng):
    """Draw a constant torque of either direction."""
    value = float(rng.choice([-1.0, 1.0]))
    return Draw(np.full(world.t.size, value), {"offset": value})


def spring(world, j, rng):
    """Draw k (q - q0)."""
    q = world.q[:, j]
    rest = float(q.mean() + rng.uniform(-0.5, 0.5) * q.std())
    return Draw(q - rest, {"k": 1.0}, {"q0": rest}, ("offset",))


def counterbalance(world, j, rng):
    """Draw a gas spring between a point of the frame and one of the moving body."""
    q = world.q[:, j]
    # a crank nearly as long as the distance has strong harmonics beside gravity's
    a = rng.uniform(0.2, 0.6)
    r = a * rng.uniform(0.4, 0.85)
    alpha, beta = rng.uniform(-np.pi, np.pi, size=2)
    angle = q + beta - alpha
    L = np.sqrt(a**2 + r**2 - 2.0 * a * r * np.cos(angle))
    growth = rng.uniform(0.5, 3.0)
    force = 1.0 + growth * (a + r - L)
    torque = -force * a * r * np.sin(angle) / L
    fixed = {"a": a, "r": r, "alpha": alpha, "beta": beta}
    return Draw(torque, {"F0": 1.0, "stiffness": growth}, fixed, ("spring", "offset"))


def ripple(world, j, rng):
    """Draw A cos(2 pi q / period + phase)."""
    period = np.deg2rad(rng.uniform(5.0, 40.0)) * world.unit[j]
    phase = rng.uniform(-np.pi, np.pi)
    torque = np.cos(2.0 * np.pi * world.q[:, j] / period + phase)
    return Draw(torque, {"A": 1.0}, {"period": period, "phase": phase})


def rotor_inertia(world, j, rng):
    """Draw Ir a."""
    return Draw(world.a[:, j], {"Ir": 1.0})


def coupling(world, j, rng):
    """Draw friction and inertia of a neighbour's motion felt by the joint."""
    nv = world.unit.size
    k = int(rng.choice([i for i in (j - 1, j + 1) if 0 <= i < nv]))
    both = bool(rng.integers(2))
    # the neighbour's motion in the joint's own unit
    ratio = world.unit[j] / world.unit[k]
    v, a = ratio * world.v[:, k], ratio * world.a[:, k]
    if both:
        v = v + world.v[:, j]
    Fv, Ir = rng.uniform(0.2, 0.8, size=2) * rng.integers(2, size=2)
    Fv, Ir = Fv / _rms(v), Ir / _rms(a)
    torque = np.sign(v) + Fv * v + Ir * a
    scaled = {"Fc": 1.0, "Fv": Fv, "Ir": Ir}
    fixed = {"partner": k, "differential": both, "ratio": float(ratio)}
    contains = _unless_declared(world, "coulomb") if both else ()
    return Draw(torque, scaled, fixed, contains)


def drift(world, j, rng):
    """Draw a Coulomb friction that decays as the joint warms up."""
    time_constant = rng.uniform(0.2, 1.0) * float(world.t[-1])
    torque = np.exp(-world.t / time_constant) * np.sign(world.v[:, j])
    fixed = {"time_constant": time_constant}
    return Draw(torque, {"Fc": 1.0}, fixed, _unless_declared(world, "coulomb"))


def payload(world, j, rng):
    """Draw a mass that the last body carries from an instant on."""
    n, nv = world.q.shape
    point = rng.normal(size=3)
    point *= rng.uniform(0.03, 0.15) / np.linalg.norm(point)
    duration = float(world.t[-1])
    instant = float(rng.uniform(1.0 / 3.0, 2.0 / 3.0) * duration)
    x, y, z = point
    squares = [y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y]
    after = world.t >= instant
    torque = np.zeros((n, nv))
    columns = regressor(world.model, world.q[after], world.v[after], world.a[after])
    torque[after] = columns[:, :, -10:] @ np.array([1.0, *point, *squares])
    fixed = {"instant": instant, "x": x, "y": y, "z": z}
    return Draw(torque, {"mass": 1.0}, fixed)


def jerk(world, j, rng):
    """Draw the inertia behind a coupling that lags, or an encoder that lags."""
    time_constant = rng.uniform(0.002, 0.02)
    a = world.a[:, j]
    behind = np.empty_like(a)
    for rows in pieces(world.groups):
        behind[rows] = first_order_lag(a[rows], world.dt, time_constant)
    inertia = own_inertia(world.model, world.q, j)
    way = float(rng.choice([-1.0, 1.0]))
    torque = way * inertia / inertia.mean() * (a - behind) / time_constant
    fixed = {"time_constant": time_constant}
    return Draw(torque, {"J": way}, fixed, ("rotor_inertia",))


def can_carry(name, world, j):
    """Whether an effect has a meaning on a joint."""
    if name == "coupling":
        return world.unit.size > 1
    if name == "payload":
        return j == world.unit.size - 1
    return name != "counterbalance" or not is_prismatic(world.model)[j]


ADDED = {
    "viscous": viscous,
    "coulomb": coulomb,
    "asymmetric_friction": asymmetric_friction,
    "stribeck": stribeck,
    "viscous_quadratic": viscous_quadratic,
    "load_friction": load_friction,
    "maxwell_slip": maxwell_slip_or_lugre,
    "backlash": backlash,
    "offset": offset,
    "spring": spring,
    "counterbalance": counterbalance,
    "ripple": ripple,
    "rotor_inertia": rotor_inertia,
    "coupling": coupling,
    "drift": drift,
    "payload": payload,
}

# Effects of channels; the filter of a torque is made where that torque is known.
CHANNELS = {"jerk": jerk}
