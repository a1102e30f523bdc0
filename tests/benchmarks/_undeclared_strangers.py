"""Effects that no library of joint effects has: a name for them would be wrong."""

import numpy as np
from _undeclared_effects import Draw, sign
from _undeclared_hysteresis import pieces


def cogged_belt(world, j, rng):
    """Draw Coulomb friction with the position, F (1 + 0.5 cos(q + phase)) sign(v)."""
    phase = rng.uniform(-np.pi, np.pi)
    angle = world.q[:, j] / world.unit[j] + phase
    torque = (1.0 + 0.5 * np.cos(angle)) * sign(world, j)
    return Draw(torque, {"F": 1.0}, {"phase": phase}, ("coulomb",))


def chirp(world, j, rng):
    """Draw a disturbance in time whose frequency rises."""
    low, high = rng.uniform(0.2, 0.6), rng.uniform(2.0, 5.0)
    t, phase = world.t, rng.uniform(-np.pi, np.pi)
    rate = (high - low) / float(t[-1])
    torque = np.sin(2.0 * np.pi * (low + 0.5 * rate * t) * t + phase)
    return Draw(torque, {"A": 1.0}, {"low": low, "high": high})


def cross_product(world, j, rng):
    """Draw c v_j q_k."""
    k = int(rng.choice([i for i in range(world.unit.size) if i != j]))
    angle = world.q[:, k] - world.q[:, k].mean()
    return Draw(world.v[:, j] * angle, {"c": 1.0}, {"partner": k})


def random_walk(world, j, rng):
    """Draw a torque that wanders in time, as of a dragged cable."""
    torque = np.zeros(world.t.size)
    for rows in pieces(world.groups):
        steps = rng.normal(size=torque[rows].size) * np.sqrt(world.dt)
        torque[rows] = np.cumsum(steps)
        torque[rows] -= torque[rows].mean()
    return Draw(torque, {"step": 1.0}, {}, ("drift", "offset"))


def squared_torque(world, j, rng):
    """Draw the square of another joint's torque, without its mean."""
    k = int(rng.choice([i for i in range(world.unit.size) if i != j]))
    square = world.declared_torque[:, k] ** 2
    return Draw(square - square.mean(), {"c": 1.0}, {"partner": k})


def collisions(world, j, rng):
    """Draw half-sine pulses at random instants, one every few seconds."""
    torque = np.zeros(world.t.size)
    count = 0
    for rows in pieces(world.groups):
        t = world.t[rows]
        for _ in range(rng.poisson(t[-1] / 3.0) + 3):
            start, width = rng.uniform(0.0, t[-1]), rng.uniform(0.05, 0.25)
            x = (t - start) / width
            pulse = np.where((x > 0) & (x < 1), np.sin(np.pi * np.clip(x, 0, 1)), 0.0)
            torque[rows] += rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5) * pulse
            count += 1
    return Draw(torque, {"A": 1.0}, {"count": count})


def fading_gain(world, j, rng):
    """Draw a torque constant that falls as the magnets warm up."""
    time_constant = rng.uniform(0.2, 0.6) * float(world.t[-1])
    torque = world.declared_torque[:, j] * np.exp(-world.t / time_constant)
    return Draw(torque, {"gain": 1.0}, {"time_constant": time_constant})


STRANGERS = {
    "cogged_belt": cogged_belt,
    "chirp": chirp,
    "cross_product": cross_product,
    "random_walk": random_walk,
    "squared_torque": squared_torque,
    "collisions": collisions,
    "fading_gain": fading_gain,
}


def has_partner(name, world):
    """Whether the robot has the second joint that an effect needs."""
    return name not in ("cross_product", "squared_torque") or world.unit.size > 1
