"""Simulated recordings whose robot is not as its model says, or whose channels are not.

An arm of six or seven joints (`_undeclared_arms.py`) moves along sums of sines for one
to two minutes, in one or two recordings, at 100 to 500 Hz. Viscous, Coulomb and offset
friction are in every joint and are declared. The torque noise is white, 2 % of each
joint's spread; positions come from encoders of 17 to 20 bits, or have white noise.

Kinds: "tilt", "zero", "axis" and "gain" put one fault of `_undeclared_faults.py` in,
"two" puts two of different kinds in, "friction" one of them and one friction that is
not declared, "signal" lets the friction of a joint fall by 40 % over a recorded
temperature, "none" adds nothing.

A fault counts where what it adds to the torques is at least `LEAST` times the noise on
some joint, and where the part of it that bodies, friction and the other faults cannot
take over is at least `VISIBLE` times the noise; sizes, joints and in the end robots
are drawn anew until it does. Faults that explain the same torque are one class
(`_undeclared_told_apart.py`). Nothing here uses the code of the package.
"""

from dataclasses import dataclass, replace

import numpy as np
from _undeclared_arms import ARMS, arm, is_aligned
from _undeclared_effects import ADDED, World
from _undeclared_faults import (
    NAMES,
    Fault,
    gains_of,
    rigid_torque,
    with_faults,
    zeros_of,
)
from _undeclared_robots import draw_motion, inverse_dynamics, true_robot
from _undeclared_span import friction_shapes
from _undeclared_told_apart import Teller

KINDS = ("tilt", "zero", "axis", "gain", "two", "friction", "signal", "none")
FRICTION = ("viscous", "coulomb", "offset")
# Not declared, and told from what is by its shape.
FURTHER = ("load_friction", "stribeck", "asymmetric_friction", "viscous_quadratic")
RATES = (100.0, 125.0, 200.0, 250.0, 500.0)
DURATION = (60.0, 120.0)
NOISE = 0.02
BITS = (17, 18, 19, 20)
WHITE = (1e-5, 1e-4)
# What counts: torque of a fault over the noise, and its part that nothing takes over.
LEAST = 3.0
VISIBLE = 0.5
ANGLE = np.deg2rad((1.5, 8.0))
GAIN = (0.6, 1.6)
# A gain closer to one than this share is no fault.
SMALLEST_GAIN = 0.07
FALL = 0.4
SIZES = (3.0, 8.0)
DRAWS = 15
ROBOTS = 6


@dataclass(frozen=True)
class Entry:
    """One thing that the declared model lacks."""

    name: str
    joint: int
    parameters: dict
    size: float
    outside: float
    rivals: dict
    std: tuple = ()

    @property
    def visible(self):
        """Whether it is large enough to be missed."""
        return self.outside >= VISIBLE


@dataclass(frozen=True, kw_only=True, eq=False)
class GeometryRecording:
    """A recording and what is wrong with its robot and channels."""

    kind: str
    arm: str
    model: object
    dt: float
    q: np.ndarray
    tau: np.ndarray
    groups: np.ndarray
    signals: dict
    faults: tuple
    truth: tuple
    states: np.ndarray
    tau_clean: np.ndarray
    further: np.ndarray
    torque_noise: np.ndarray

    @property
    def visible(self):
        """Whether all that is wrong can be seen."""
        return all(entry.visible for entry in self.truth)

    def teller(self):
        """Return what tells apart the explanations of this recording."""
        further = [self.further] if np.any(self.further) else []
        return Teller(
            self.model,
            self.states,
            self.tau_clean,
            self.torque_noise,
            FRICTION,
            further,
        )

    def put_right(self):
        """Right model, positions and torques (n, nv): the noise is left."""
        nv = self.model.nv
        tau = self.tau / gains_of(self.faults, nv) - self.further
        return (
            with_faults(self.model, self.faults),
            self.q - zeros_of(self.faults, nv),
            tau,
        )


def draw_fault(kind, model, rng, joints=None):
    """Draw a fault of a kind: its joint and its size."""
    # what an axis that is none of its frame's is off about has no name
    known = range(model.nv) if joints is None else joints
    known = [j for j in known if kind != "axis" or is_aligned(model, j)]
    joint = 0 if kind == "tilt" else int(rng.choice(known))
    angle = rng.uniform(*ANGLE)
    if kind == "zero":
        values = (float(rng.choice([-1.0, 1.0]) * angle),)
    elif kind == "gain":
        gain = 1.0
        while abs(gain - 1.0) < SMALLEST_GAIN:
            gain = float(np.exp(rng.uniform(*np.log(GAIN))))
        values = (gain,)
    else:
        way = rng.uniform(0.0, 2.0 * np.pi)
        values = (float(angle * np.cos(way)), float(angle * np.sin(way)))
    return Fault(NAMES[kind], joint, values)


@dataclass(frozen=True, eq=False)
class _Body:
    """A robot in motion with its friction, before anything is wrong."""

    arm: str
    nominal: object
    model: object
    dt: float
    t: np.ndarray
    groups: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    rigid: np.ndarray
    levels: dict

    def friction(self):
        """Return the declared friction, (n, nv)."""
        shapes = friction_shapes(("viscous", "coulomb"), self.v)
        torque = sum(self.levels[name] * shape for name, shape in shapes.items())
        return torque + self.levels["offset"]


def _robot(rng, name, duration, rate):
    name = name or str(rng.choice(list(ARMS)))
    nominal = arm(name, rng)
    nv = nominal.nv
    rate = rate or float(rng.choice(RATES))
    duration = duration or rng.uniform(*DURATION)
    count = int(rng.integers(1, 3))
    n = round(duration * rate / count)
    t = np.arange(n) / rate
    top = rng.uniform(0.3, 1.0)
    motions = [
        draw_motion(np.ones(nv), top, t, rng, reversals=min(10, int(0.2 * t[-1])))
        for _ in range(count)
    ]
    q, v, a = (np.concatenate(x) for x in zip(*(motion.at(t) for motion in motions)))
    model = true_robot(nominal, rng)
    rigid = inverse_dynamics(model, q, v, a)
    typical = np.sqrt(np.mean(rigid**2, axis=0))
    # no joint of an arm runs without the friction of its gear and its seals
    typical = np.maximum(typical, 0.02 * typical.max())
    shapes = friction_shapes(("viscous", "coulomb"), v)
    levels = {
        name: rng.uniform(0.05, 0.25, size=nv)
        * typical
        / np.sqrt(np.mean(shape**2, axis=0))
        for name, shape in shapes.items()
    }
    levels["offset"] = rng.uniform(-0.1, 0.1, size=nv) * typical
    return _Body(
        name,
        nominal,
        model,
        1.0 / rate,
        np.tile(t, count),
        np.repeat(np.arange(count), n),
        q,
        v,
        a,
        rigid,
        levels,
    )


def _relative(torque, noise):
    return float(np.max(np.sqrt(np.mean(torque**2, axis=0)) / noise))


def _channels(body, faults, further):
    """Read out the channels: encoders (n, nv) and torques without noise."""
    nv = body.model.nv
    read = body.q + zeros_of(faults, nv)
    torque = rigid_torque(body.model, read, body.v, body.a, faults)
    torque = torque + body.friction() + further
    return read, gains_of(faults, nv) * torque


def _size(body, fault, faults, further, noise):
    """Return what a fault adds to the torques at the same readings, in noises."""
    nv = body.model.nv
    some = slice(None, None, max(1, len(body.q) // 1500))
    v, a = body.v[some], body.a[some]
    read = body.q[some] + zeros_of(faults, nv)
    sides = []
    for given in (faults, [f for f in faults if f is not fault]):
        torque = rigid_torque(body.model, read, v, a, given)
        torque = torque + body.friction()[some] + further[some]
        sides.append(gains_of(given, nv) * torque)
    return _relative(sides[0] - sides[1], noise)


def _fault_kinds(kind, rng):
    single = list(NAMES)
    if kind in single:
        return [kind]
    if kind == "two":
        return [str(k) for k in rng.choice(single, size=2, replace=False)]
    return [str(rng.choice(single))] if kind == "friction" else []


def _further(kind, body, rng):
    """Name, joint, parameters, torque (n, nv), signals of what is no fault."""
    nv = body.model.nv
    torque = np.zeros_like(body.q)
    if kind == "friction":
        noise = NOISE * (body.rigid + body.friction()).std(axis=0)
        name, j = str(rng.choice(FURTHER)), int(rng.integers(nv))
        world = World(
            model=body.model,
            q=body.q,
            v=body.v,
            a=body.a,
            t=body.t,
            dt=body.dt,
            groups=body.groups,
            rigid=body.rigid,
            declared_torque=body.rigid + body.friction(),
            declared=FRICTION,
            unit=np.ones(nv),
        )
        drawn = ADDED[name](world, j, rng)
        size = np.exp(rng.uniform(*np.log(SIZES)))
        factor = size * noise[j] / np.sqrt(np.mean(drawn.torque**2))
        torque[:, j] = factor * drawn.torque
        parameters = {key: float(factor * x) for key, x in drawn.scaled.items()}
        return name, j, parameters, torque, {}
    if kind == "signal":
        j = int(rng.integers(nv))
        n = len(body.q)
        whole = np.arange(n) / n
        # a warm-up that never ends, seen by a sensor with noise and a resolution
        rise = (1.0 - np.exp(-whole / rng.uniform(0.3, 1.0))) * rng.uniform(15, 35)
        start = rng.uniform(18.0, 28.0)
        factor = -FALL * rise / rise.max()
        torque[:, j] = factor * (body.friction()[:, j] - body.levels["offset"][j])
        sensed = np.round((start + rise + 0.05 * rng.normal(size=n)) / 0.1) * 0.1
        return "signal", j, {"fall": FALL}, torque, {"temperature": sensed}
    return None


def simulate(kind, *, seed, arm_name=None, duration=None, rate=None):
    """Simulate a recording."""
    if kind not in KINDS:
        raise ValueError(f"kind={kind!r}: expected one of {KINDS}.")
    best = None
    for rng in np.random.default_rng(seed).spawn(ROBOTS):
        body = _robot(rng, arm_name, duration, rate)
        for _ in range(DRAWS if kind != "none" else 1):
            found = _record(kind, body, rng)
            if found is None:
                continue
            if best is None or _least(found) > _least(best):
                best = found
            if best.visible:
                return _judged(best)
    if best is None:
        raise ValueError(f"Nothing of kind={kind!r} was large enough, seed={seed}.")
    return _judged(best)


def _least(recording):
    return min((entry.outside for entry in recording.truth), default=np.inf)


def _record(kind, body, rng):
    """One draw of what is wrong; None if a fault is smaller than `LEAST`."""
    faults = [draw_fault(k, body.nominal, rng) for k in _fault_kinds(kind, rng)]
    other = _further(kind, body, rng)
    further = np.zeros_like(body.q) if other is None else other[3]
    signals = {} if other is None else other[4]
    read, clean = _channels(body, faults, further)
    noise = NOISE * clean.std(axis=0)
    sizes = [_size(body, fault, faults, further, noise) for fault in faults]
    if any(size < LEAST for size in sizes):
        return None
    states = np.hstack([read, body.v, body.a])
    entries = []
    teller = Teller(
        body.nominal,
        states,
        clean,
        noise,
        FRICTION,
        [further] if other is not None else [],
    )
    for fault, size in zip(faults, sizes):
        rest = [f for f in faults if f is not fault]
        left = teller.explain([f.key for f in rest], start=rest).rms
        entries.append(Entry(fault.name, fault.joint, fault.parameters, size, left, {}))
    if other is not None:
        name, j, parameters, torque, _ = other
        bare = Teller(body.nominal, states, clean, noise, FRICTION)
        left = bare.explain([f.key for f in faults], start=faults).rms
        entries.append(Entry(name, j, parameters, _relative(torque, noise), left, {}))
    if rng.uniform() < 0.5:
        step = 2.0 * np.pi / 2 ** int(rng.choice(BITS))
        q = step * np.round(read / step)
    else:
        deviation = np.exp(rng.uniform(*np.log(WHITE)))
        q = read + deviation * rng.normal(size=read.shape)
    return GeometryRecording(
        kind=kind,
        arm=body.arm,
        model=body.nominal,
        dt=body.dt,
        q=q,
        tau=clean + noise * rng.normal(size=clean.shape),
        groups=body.groups,
        signals=signals,
        faults=tuple(faults),
        truth=tuple(entries),
        states=states,
        tau_clean=clean,
        further=further,
        torque_noise=noise,
    )


def _judged(recording):
    """Add the classes of the faults, and how well their values are told."""
    teller = recording.teller()
    faults = recording.faults
    known = teller.explain([f.key for f in faults], start=faults)
    entries = list(recording.truth)
    for i, fault in enumerate(faults):
        rest = [f for f in faults if f is not fault]
        entries[i] = replace(
            entries[i],
            rivals=teller.rivals(fault, rest),
            std=tuple(map(float, known.std[i])),
        )
    return replace(recording, truth=tuple(entries))
