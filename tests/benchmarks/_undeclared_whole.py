"""Whole robots: friction in every joint, further effects in some, real channels.

A serial robot of six revolute joints, drawn at random, moves three times within the
same limits of position and speed: two motions are recorded, the third one is to be
predicted. Every joint has viscous and Coulomb friction. One to three joints also have
bristles (LuGre or Maxwell slip, integrated in time over each motion) or a Stribeck
hump, and three further effects of different kinds sit on random joints. Positions are
those of an encoder of 17 bits, the torque noise is an autoregression in time. Nothing
here uses the code that has to find the effects.
"""

from dataclasses import dataclass, replace

import numpy as np
from _undeclared_effects import World
from _undeclared_hysteresis import pieces
from _undeclared_robots import (
    Motion,
    feels_gravity,
    inverse_dynamics,
    length_units,
    nominal_robot,
    true_robot,
)
from _undeclared_scene import Scene, apart, describe, place
from _undeclared_span import DeclaredSpan, friction_shapes

NV = 6
RATE = 200.0
MOTIONS = 3
FRICTION = ("viscous", "coulomb")
SLOW = ("maxwell_slip", "stribeck")
FURTHER = (
    "asymmetric_friction",
    "viscous_quadratic",
    "load_friction",
    "backlash",
    "offset",
    "spring",
    "counterbalance",
    "ripple",
    "rotor_inertia",
    "coupling",
)
# Size of an effect over the torque noise, that noise over the spread of the torque of
# bodies and friction, its correlation from sample to sample.
SIZES = (2.0, 8.0)
NOISE = 0.02
MEMORY = 0.8
# Part of an effect, over the torque noise, that nothing else in the robot can take
# over and that has to be there for the effect to be missed.
VISIBLE = 0.5
BITS = 17
TOP_SPEED = 3.0


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class WholeRobot:
    """Two recordings to fit and a motion to predict."""

    model: object
    dt: float
    q: np.ndarray
    tau: np.ndarray
    groups: np.ndarray
    states: np.ndarray
    tau_clean: np.ndarray
    truth: tuple
    torque_noise: np.ndarray

    def __repr__(self):
        names = ", ".join(f"{e.name} {e.joint}" for e in self.truth[2 * NV :])
        return f"WholeRobot(n={len(self.q)}: {names})"


def _limited_motions(t, rng, count):
    """Draw motions that all fill the same positions up to the same speed."""
    centre = rng.uniform(-1.0, 1.0, size=NV)
    reach = rng.uniform(0.8, 1.8, size=NV)
    top = rng.uniform(0.3, 1.0)
    motions = []
    while len(motions) < count:
        frequency = top * rng.uniform(0.15, 1.0, size=(NV, 5))
        frequency[:, 0] = top * rng.uniform(0.85, 1.0, size=NV)
        amplitude = rng.uniform(0.3, 1.0, size=(NV, 5)) / frequency
        phase = rng.uniform(0.0, 2.0 * np.pi, size=(NV, 5))
        motion = Motion(np.zeros(NV), amplitude, frequency, phase)
        q, v, _ = motion.at(t)
        scale = np.minimum(
            reach / np.abs(q).max(axis=0), TOP_SPEED / np.abs(v).max(axis=0)
        )
        if np.min(np.sum(v[1:] * v[:-1] < 0, axis=0)) >= min(6, t[-1] / 5):
            motions.append(
                replace(motion, centre=centre, amplitude=amplitude * scale[:, None])
            )
    return motions


def _world(duration, rng):
    """Return the robot as declared and the true one in its three motions."""
    t = np.arange(round(duration * RATE)) / RATE
    while True:
        nominal = nominal_robot("serial", rng, NV)
        motions = _limited_motions(t, rng, MOTIONS)
        if feels_gravity(nominal, motions[0].at(t[::20])[0]):
            break
    model = true_robot(nominal, rng)
    q, v, a = (np.concatenate(x) for x in zip(*(motion.at(t) for motion in motions)))
    rigid = inverse_dynamics(model, q, v, a)
    world = World(
        model=model,
        q=q,
        v=v,
        a=a,
        t=np.tile(t, MOTIONS),
        dt=1.0 / RATE,
        groups=np.repeat(np.arange(MOTIONS), t.size),
        rigid=rigid,
        declared_torque=rigid,
        declared=FRICTION,
        unit=length_units(model),
    )
    return nominal, world


def coloured_noise(shape, memory, rng):
    """Autoregression of the first order with a variance of one, along the rows."""
    from scipy.signal import lfilter

    white = rng.normal(size=shape)
    white[1:] *= np.sqrt(1.0 - memory**2)
    return lfilter([1.0], [1.0, -memory], white, axis=0)


def _extra_kinds(rng):
    """Draw (kind, joint or None): slow friction on some joints, three further kinds."""
    slow = rng.choice(NV, size=int(rng.integers(1, 4)), replace=False)
    kinds = [(str(rng.choice(SLOW)), int(j)) for j in slow]
    return kinds + [(str(k), None) for k in rng.choice(FURTHER, 3, replace=False)]


def whole_robot(seed, duration=30.0):
    """Draw a whole robot."""
    rng = np.random.default_rng([seed, 17])
    nominal, world = _world(duration, rng)
    q, v, a = world.q, world.v, world.a
    typical = np.sqrt(np.mean(world.rigid**2, axis=0))
    # friction comes to some per cent of a joint's torque
    levels = {
        "viscous": rng.uniform(0.05, 0.3, size=NV),
        "coulomb": rng.uniform(0.05, 0.25, size=NV),
    }
    torques, owners, friction = [], [], {}
    for name, shape in friction_shapes(FRICTION, v).items():
        friction[name] = levels[name] * typical / np.sqrt(np.mean(shape**2, axis=0))
        for j in range(NV):
            torque = np.zeros_like(q)
            torque[:, j] = friction[name][j] * shape[:, j]
            torques.append(torque)
            owners.append((name, j, {"level": float(friction[name][j])}))
    world = replace(world, declared_torque=world.rigid + sum(torques))
    noise = NOISE * world.declared_torque.std(axis=0)
    # what shows is what shows in the first two motions: the rows of the span
    fitted = world.groups < MOTIONS - 1
    states = np.hstack([q, v, a])
    spans = {
        declared: DeclaredSpan(nominal, states[fitted], declared, noise)
        for declared in ((), FRICTION)
    }
    bare = Scene(world, friction, noise, spans[()])
    scene = Scene(world, friction, noise, spans[FRICTION])
    entries = [describe(*who, x, bare, 0.5) for who, x in zip(owners, torques)]
    added, put = [], []
    for kind, joint in _extra_kinds(rng):
        taken = {e.joint for e in added if e.name == kind}
        joints = [j for j in rng.permutation(NV) if j not in taken]
        there = joints if joint is None else [joint]
        asked = float(np.exp(rng.uniform(*np.log(SIZES))))
        entry, torque = place(kind, there, scene, put, asked, rng)
        added.append(entry)
        put.append(torque)
    added = apart(added, put, scene)
    entries = apart(entries + added, torques + put, bare)[: 2 * NV] + added
    entries = [e._replace(visible=e.distinct >= VISIBLE) for e in entries]
    clean = world.declared_torque + sum(put)
    step = 2.0 * np.pi / 2**BITS
    recorded = clean.copy()
    for rows in pieces(world.groups):
        recorded[rows] += noise * coloured_noise(clean[rows].shape, MEMORY, rng)
    return WholeRobot(
        model=nominal,
        dt=world.dt,
        q=(step * np.round(q / step))[fitted],
        tau=recorded[fitted],
        groups=world.groups[fitted],
        states=states[~fitted],
        tau_clean=clean[~fitted],
        truth=tuple(entries),
        torque_noise=noise,
    )
