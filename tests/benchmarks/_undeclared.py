"""Simulated recordings with effects that the declared robot model lacks.

`simulate` makes one recording, `draw_cases` draws what is in many. The declared model
is the inertial parameters of every body and viscous friction; everything else in the
torque is listed in `truth`. Nothing here uses the code that has to find the effects.

What the declared parameters can mimic cannot show in a residual (a rotor inertia in
the span of the link inertias). The size of an effect is that of its part outside the
declared span, from a least-squares projection with the true states, over the torque
noise. An effect that cannot have the size asked for goes to another joint, then into
another robot and motion. Only where nothing helps the entry has ``visible=False``.
"""

from dataclasses import dataclass

import numpy as np
from _undeclared_effects import ADDED
from _undeclared_robots import (
    draw_motion,
    feels_gravity,
    length_units,
    nominal_robot,
    true_robot,
)
from _undeclared_scene import Setting, apart, describe, lay_out, place, soft_scene

# Viscous friction is declared, so it is not drawn.
LIBRARY = (*(name for name in ADDED if name != "viscous"), "elastic", "delay")
# What every model has, declared or not: there is nothing to name.
PLAIN = ("viscous", "coulomb", "offset", "rotor_inertia")
# A lag of one channel has several names.
CHANNELS = ("jerk", "torque_filter")
DECLARED = ("viscous",)
# Robots tried for a size; one that no robot shows is given up.
ATTEMPTS = 4
ENCODER_NOISE = (0.0, 3e-5, 1e-4, 3e-4)
# Warm-up and payload are told from the time since the start, so there is one start.
ONE_RECORDING = {"drift", "payload"}
ROBOTS = {"serial": 0.5, "prismatic": 0.15, "tree": 0.15, "demo": 0.2}


@dataclass(frozen=True, kw_only=True, eq=False)
class UndeclaredRecording:
    """A recording and what is in it."""

    q: np.ndarray
    tau: np.ndarray
    dt: float
    groups: np.ndarray
    model: object
    declared: tuple
    truth: tuple

    @property
    def visible(self):
        """Whether every undeclared effect is visible."""
        return all(entry.visible for entry in self.truth)


def _draw_setting(kinds, rng):
    kind = str(rng.choice(list(ROBOTS), p=list(ROBOTS.values())))
    duration = rng.uniform(30.0, 60.0)
    rate = float(rng.choice([100.0, 125.0, 200.0]))
    count = 1 if ONE_RECORDING & set(kinds) else int(rng.integers(1, 3))
    n = round(duration * rate / count)
    t = np.arange(n) / rate
    # short recordings hold fewer reversals
    reversals = min(10, int(0.2 * t[-1]))
    while True:
        nominal = nominal_robot(kind, rng)
        unit = length_units(nominal)
        frequency = rng.uniform(0.3, 1.0)
        motions = [
            draw_motion(unit, frequency, t, rng, reversals=reversals)
            for _ in range(count)
        ]
        if feels_gravity(nominal, motions[0].at(t[::20])[0]):
            break
    levels = {
        "viscous": rng.uniform(0.05, 0.3, size=unit.size),
        "coulomb": rng.uniform(0.05, 0.25, size=unit.size),
        "noise": rng.uniform(0.02, 0.05, size=unit.size),
    }
    return Setting(
        nominal=nominal,
        model=true_robot(nominal, rng),
        motions=motions,
        t=np.tile(t, count),
        groups=np.repeat(np.arange(count), n),
        dt=1.0 / rate,
        declared=DECLARED,
        levels=levels,
    )


def _populate(setting, kinds, sizes, rng):
    """Put all effects into one robot and motion; None if no joint carries one."""
    nv = setting.nominal.nv
    entries, torques = [None] * len(kinds), [None] * len(kinds)

    def candidates(i):
        taken = {e.joint for e in entries if e is not None and e.name == kinds[i]}
        return [int(j) for j in rng.permutation(nv) if int(j) not in taken]

    def rank(i):
        # Elasticity changes the states and comes first, a channel has all others.
        return {"elastic": 0, "delay": 2, "torque_filter": 3}.get(kinds[i], 1)

    scene = None
    for i in sorted(range(len(kinds)), key=rank):
        there = candidates(i)
        if not there:
            return None
        if kinds[i] == "elastic":
            scene, parameters = soft_scene(setting, there[0], sizes[i], rng)
            torques[i] = scene.elastic
            what = "elastic", there[0], parameters, scene.elastic, scene, sizes[i]
            entries[i] = describe(*what, exact=True)
            continue
        scene = scene or lay_out(setting)
        present = [x for x in torques if x is not None]
        found = place(kinds[i], there, scene, present, sizes[i], rng, exact=True)
        if found is None:
            return None
        entries[i], torques[i] = found
    scene = scene or lay_out(setting)
    return scene, apart(entries, torques, scene), torques


def simulate(kinds, *, size, seed):
    """Simulate a robot with undeclared effects, at most one of them elastic."""
    first = np.random.default_rng(seed)
    sizes = np.broadcast_to(np.asarray(size, dtype=float), len(kinds)).tolist()
    noise = float(first.choice(ENCODER_NOISE))
    best = None
    for rng in first.spawn(ATTEMPTS):
        setting = _draw_setting(kinds, rng)
        found = _populate(setting, kinds, sizes, rng)
        if found is None:
            continue
        seen = sum(entry.visible for entry in found[1])
        if best is None or seen > best[0]:
            best = seen, setting, *found
        if seen == len(kinds):
            break
    if best is None:
        raise ValueError(f"No robot carries kinds={kinds}.")
    _, setting, scene, entries, torques = best
    world = scene.world
    clean = sum(torques, world.declared_torque)
    return UndeclaredRecording(
        q=world.q + noise * world.unit * first.normal(size=clean.shape),
        tau=clean + scene.noise * first.normal(size=clean.shape),
        dt=world.dt,
        groups=world.groups,
        model=setting.nominal,
        declared=world.declared,
        truth=tuple(entries),
    )


def draw_cases(n, n_effects, size_range, seed, kinds):
    """Draw kinds and sizes of random cases, evenly over the kinds."""
    rng = np.random.default_rng([seed, n_effects])
    pack, cases = [], []
    for _ in range(n):
        chosen = []
        while len(chosen) < n_effects:
            fresh = [kind for kind in pack if kind not in chosen]
            if not fresh:
                pack += rng.permutation(list(kinds)).tolist()
                continue
            pack.remove(fresh[0])
            chosen.append(fresh[0])
        sizes = np.exp(rng.uniform(*np.log(size_range), size=n_effects))
        cases.append((chosen, sizes.tolist()))
    return cases
