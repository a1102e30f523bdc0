"""States and torques of a robot, and effects put where they show."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from _undeclared_effects import ADDED, CHANNELS, World, can_carry
from _undeclared_hysteresis import first_order_lag, pieces, two_sided_average
from _undeclared_robots import inverse_dynamics, joint_inertia, length_units
from _undeclared_span import DeclaredSpan, friction_shapes

MAX_RESCALE = 4.0
# With exact sizes: least share of a torque outside the declared span with which it is
# scaled until that part has the size asked for, and what counts as that size.
MIN_SHARE = 0.05
CLOSE = (0.8, 1.25)
DELAYS = (0.0005, 0.04)
# Time constants [s] of filters of a torque that leave half the power at 2 Hz or above.
TIME_CONSTANTS = {"lag": (0.001, 0.08), "smooth": (0.001, 0.05)}
NATURAL_FREQUENCIES = (8.0, 20.0)
# Shaking over the acceleration of the motion: more would be the whole motion.
STRONGEST = 6.0


class Entry(NamedTuple):
    """One undeclared effect."""

    name: str
    joint: int
    parameters: dict
    size: float
    asked: float
    outside: float
    distinct: float
    visible: bool
    contains: tuple


def relative_size(torque, noise):
    return float(np.max(np.sqrt(np.mean(torque**2, axis=0)) / noise))


@dataclass(frozen=True)
class Setting:
    """What is fixed before the states are computed."""

    nominal: object
    model: object
    motions: list
    t: np.ndarray
    groups: np.ndarray
    dt: float
    declared: tuple
    levels: dict


@dataclass(frozen=True)
class Scene:
    """A robot in motion with its noise, to which effects are added."""

    world: World
    friction: dict
    noise: np.ndarray
    span: DeclaredSpan
    elastic: np.ndarray | None = None


def lay_out(setting, soft=None):
    """Compute states, declared torque and noise."""
    model, t = setting.model, setting.t
    parts = pieces(setting.groups)

    def link(shift):
        pairs = zip(setting.motions, parts)
        states = [motion.at(t[rows] + shift) for motion, rows in pairs]
        q, v, a = (np.concatenate(x) for x in zip(*states))
        return q, v, a, inverse_dynamics(model, q, v, a)

    q, v, a, rigid = link(0.0)
    elastic = None
    if soft is not None:
        # The encoder sits at the motor, ahead of the link by torque over stiffness,
        # and the motor has no inertia of its own. The link's motion is known at all
        # times, so five-point differences of its torque have no error to speak of.
        joint, stiffness = soft
        h = 1e-3
        lead, late = (
            [link(k * h)[3][:, joint] for k in ks] for ks in ((-2, -1), (1, 2))
        )
        x = np.array([*lead, rigid[:, joint], *late]) / stiffness
        q[:, joint] += x[2]
        v[:, joint] += np.array([1, -8, 0, 8, -1]) @ x / (12 * h)
        a[:, joint] += np.array([-1, 16, -30, 16, -1]) @ x / (12 * h**2)
        elastic = rigid - inverse_dynamics(model, q, v, a)
    unit, typical = length_units(model), np.sqrt(np.mean(rigid**2, axis=0))
    friction, torque = {}, rigid.copy()
    for name, shape in friction_shapes(setting.declared, v).items():
        share = setting.levels[name]
        friction[name] = share * typical / np.sqrt(np.mean(shape**2, axis=0))
        torque += friction[name] * shape
    noise = setting.levels["noise"] * torque.std(axis=0)
    if elastic is not None:
        torque = torque - elastic
    world = World(
        model=model,
        q=q,
        v=v,
        a=a,
        t=t,
        dt=setting.dt,
        groups=setting.groups,
        rigid=rigid,
        declared_torque=torque,
        declared=setting.declared,
        unit=unit,
    )
    span = DeclaredSpan(setting.nominal, np.hstack([q, v, a]), setting.declared, noise)
    return Scene(world, friction, noise, span, elastic)


def soft_scene(setting, joint, asked, rng):
    """Make a joint elastic and shake it until the size is reached, within limits."""
    t = setting.t[pieces(setting.groups)[0]]
    q, _, a = setting.motions[0].at(t)
    natural = rng.uniform(*NATURAL_FREQUENCIES)
    inertia = joint_inertia(setting.model, q)[joint]
    stiffness = float(inertia * (2 * np.pi * natural) ** 2)
    shaking = natural * np.array([rng.uniform(0.2, 0.3), rng.uniform(0.32, 0.45)])
    phases = rng.uniform(0, 2 * np.pi, size=2)
    acceleration = np.sqrt(np.mean(a[:, joint] ** 2))
    strength, used = 1.0, 1.0
    for _ in range(4):
        used = strength
        amplitude = strength * acceleration / (2 * np.pi * shaking) ** 2
        motions = [
            motion.with_vibration(joint, shaking, amplitude, phases)
            for motion in setting.motions
        ]
        scene = lay_out(replace(setting, motions=motions), soft=(joint, stiffness))
        reached = _outside_size(scene.elastic, scene) / used
        strength = float(np.clip(asked / max(reached, 1e-12), 0.05, STRONGEST))
    parameters = {
        "stiffness": stiffness,
        "frequency": float(natural),
        "shaking": tuple(shaking.tolist()),
    }
    return scene, parameters


def _delayed(torque, world, delay):
    from scipy.interpolate import PchipInterpolator

    late = torque.copy()
    for rows in pieces(world.groups):
        t = world.t[rows]
        late[rows] = PchipInterpolator(t, torque[rows])(np.maximum(t - delay, t[0]))
    return late


def _filtered(torque, world, kind, time_constant):
    out = torque.copy()
    make = {"lag": first_order_lag, "smooth": two_sided_average}[kind]
    for rows in pieces(world.groups):
        out[rows] = make(torque[rows], world.dt, time_constant)
    return out


def _enough(size, outside, asked, exact):
    if exact:
        return CLOSE[0] <= outside / asked <= CLOSE[1]
    # Only bounded effects can be smaller than asked; below half the noise they are
    # no effect at all.
    return outside >= 0.499 * min(asked, size) and size >= 0.999 * min(asked, 0.5)


def _on_joint(torque, j, nv):
    if torque.ndim == 2:
        return torque
    out = np.zeros((torque.size, nv))
    out[:, j] = torque
    return out


def describe(
    name, joint, parameters, torque, scene, asked, contains=(), *, exact=False
):
    """Measure an effect and make its entry."""
    size = relative_size(torque, scene.noise)
    outside = scene.span.share(torque) * size
    return Entry(
        name=name,
        joint=int(joint),
        parameters=parameters,
        size=size,
        asked=float(asked),
        outside=outside,
        distinct=outside,
        visible=_enough(size, outside, asked, exact),
        contains=contains,
    )


def _plain(x):
    return x.item() if isinstance(x, np.generic) else x


def _boost(share):
    """Factor that brings the part outside the declared span to half the size."""
    return float(np.clip(0.5 / max(share, 1e-12), 1.0, MAX_RESCALE))


def _outside_size(torque, scene):
    return scene.span.share(torque) * relative_size(torque, scene.noise)


def _value_of_size(make, asked, scene, limits):
    """Value, between limits, with which a torque has a size outside the span."""
    low, high = limits
    for _ in range(14):
        middle = float(np.sqrt(low * high))
        if _outside_size(make(middle), scene) < asked:
            low = middle
        else:
            high = middle
    return float(np.sqrt(low * high))


def _delay(j, scene, present, asked):
    world, nv = scene.world, scene.noise.size
    whole = sum(present, world.declared_torque)[:, j]

    def shifted(delay):
        return _on_joint(_delayed(whole, world, delay) - whole, j, nv)

    delay = _value_of_size(shifted, asked, scene, DELAYS)
    torque = shifted(delay)
    named = {"delay": delay}
    return describe("delay", j, named, torque, scene, asked, exact=True), torque


def _torque_filter(j, scene, present, asked, rng):
    world, nv = scene.world, scene.noise.size
    whole = sum(present, world.declared_torque)[:, j]
    kind = str(rng.choice(["lag", "smooth"]))

    def changed(time_constant):
        return _on_joint(_filtered(whole, world, kind, time_constant) - whole, j, nv)

    limits = TIME_CONSTANTS[kind]
    time_constant = _value_of_size(changed, asked, scene, limits)
    torque = changed(time_constant)
    named = {"time_constant": time_constant, "kind": kind}
    entry = describe("torque_filter", j, named, torque, scene, asked, exact=True)
    return entry, torque


def _added(name, j, scene, asked, rng, exact):
    make = ADDED.get(name) or CHANNELS[name]
    drawn = make(scene.world, j, rng)
    torque = _on_joint(drawn.torque, j, scene.noise.size)
    share = scene.span.share(torque)
    boost = 1.0 / max(share, MIN_SHARE) if exact else _boost(share)
    amplitude = asked * boost / max(relative_size(torque, scene.noise), 1e-300)
    parameters = {key: amplitude * x for key, x in drawn.scaled.items()} | drawn.fixed
    parameters = {key: _plain(x) for key, x in parameters.items()}
    torque = amplitude * torque
    contains = drawn.contains
    entry = describe(name, j, parameters, torque, scene, asked, contains, exact=exact)
    return entry, torque


def place(name, joints, scene, present, asked, rng, exact=False):
    """Put an effect on the first joint where it is visible, or where it is most so."""
    best = None
    for j in map(int, joints):
        if not can_carry(name, scene.world, j):
            continue
        if name == "delay":
            found = _delay(j, scene, present, asked)
        elif name == "torque_filter":
            found = _torque_filter(j, scene, present, asked, rng)
        else:
            found = _added(name, j, scene, asked, rng, exact)
        if found[0].visible:
            return found
        if best is None or found[0].outside > best[0].outside:
            best = found
    return best


def apart(entries, torques, scene):
    """Measure what of each effect neither the model nor the other effects mimic."""
    out = []
    for i, entry in enumerate(entries):
        others = [x for k, x in enumerate(torques) if k != i]
        distinct = scene.span.share(torques[i], others) * entry.size
        visible = entry.visible and distinct >= 0.5 * entry.outside
        out.append(entry._replace(distinct=distinct, visible=visible))
    return out
