"""Simulated recordings with effects that the declared robot model lacks.

`simulate` makes one recording, `draw_cases` many. The declared model is the inertial
parameters of every body and the friction named in `declared`; everything else in the
torque is listed in `truth`. Nothing here uses the code that has to find the effects.

What the declared parameters can mimic cannot show in a residual (a rotor inertia in
the span of the link inertias). The part of an effect outside the declared span, from a
least-squares projection with the true states, weighted by the torque noise, has to
reach half the size asked for; a weaker effect is made up to `MAX_RESCALE` times
larger, and if that is not enough it goes to another joint, then into another robot and
motion. Only where nothing helps the entry stays with ``visible=False``.

Two effects have bounded parameters and may stay smaller than asked: the delay (2 to
15 ms) and the elasticity (8 to 20 Hz, shaken by two small sines on top of the motion,
since a slow motion does not show it). Their entries are visible if half of what they
do lies outside the declared span; `size` is what was reached. A payload and an elastic
joint are felt by other joints too (`felt_by`), every other effect by its own joint.
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
from _undeclared_scene import (
    Setting,
    apart,
    describe,
    lay_out,
    place,
    soft_scene,
)
from _undeclared_span import DeclaredSpan
from _undeclared_strangers import STRANGERS

# Viscous friction is declared unless asked otherwise, so it is not drawn.
LIBRARY = (*(name for name in ADDED if name != "viscous"), "elastic", "delay")
# What every model has, declared or not: there is nothing to name.
PLAIN = ("viscous", "coulomb", "offset", "rotor_inertia")
OUTSIDE = tuple(STRANGERS)
# Not drawn unless asked for: a lag of one channel has several names.
CHANNELS = ("jerk", "torque_filter")

ATTEMPTS = 12
# Robots tried for a size that has to be exact; one that no robot shows is given up.
EXACT_ATTEMPTS = 4
ENCODER_NOISE = (0.0, 3e-5, 1e-4, 3e-4)
# Warm-up and payload are told from the time since the start, so there is one start.
ONE_RECORDING = {"drift", "payload", "random_walk", "fading_gain"}
# A change of the Coulomb friction shows only beside a declared one.
NEEDS_COULOMB = {"drift", "cogged_belt"}
ROBOTS = {"serial": 0.5, "prismatic": 0.15, "tree": 0.15, "demo": 0.2}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class UndeclaredRecording:
    """A recording and what is in it."""

    q: np.ndarray
    tau: np.ndarray
    t: np.ndarray
    dt: float
    groups: np.ndarray
    model: object
    declared: tuple
    truth: tuple
    robot: str
    states: np.ndarray
    tau_clean: np.ndarray
    contributions: tuple
    inertial: np.ndarray
    friction: dict
    torque_noise: np.ndarray
    encoder_noise: np.ndarray

    def __repr__(self):
        n, nv = self.q.shape
        names = ", ".join(f"{entry.name} {entry.joint}" for entry in self.truth)
        return f"UndeclaredRecording({self.robot}, n={n}, nv={nv}: {names or 'clean'})"

    @property
    def visible(self):
        """Whether every undeclared effect is visible."""
        return all(entry.visible for entry in self.truth)

    @property
    def unit(self):
        """Size of a radian in each joint's own unit."""
        return length_units(self.model)

    def span(self):
        """Return what the declared columns can explain."""
        return DeclaredSpan(self.model, self.states, self.declared, self.torque_noise)


def _choose_declared(kinds, rng):
    if "coulomb" in kinds:
        return ("viscous",)
    if NEEDS_COULOMB & set(kinds) or rng.uniform() < 0.5:
        return ("viscous", "coulomb")
    return ("viscous",)


def _draw_setting(kinds, robot, declared, duration, rate, n_recordings, rng):
    kind = robot or str(rng.choice(list(ROBOTS), p=list(ROBOTS.values())))
    duration = duration or rng.uniform(30.0, 60.0)
    rate = rate or float(rng.choice([100.0, 125.0, 200.0]))
    if n_recordings is None:
        n_recordings = 1 if ONE_RECORDING & set(kinds) else int(rng.integers(1, 3))
    n = round(duration * rate / n_recordings)
    t = np.arange(n) / rate
    # short recordings hold fewer reversals
    reversals = min(10, int(0.2 * t[-1]))
    while True:
        nominal = nominal_robot(kind, rng)
        unit = length_units(nominal)
        frequency = rng.uniform(0.3, 1.0)
        motions = [
            draw_motion(unit, frequency, t, rng, reversals=reversals)
            for _ in range(n_recordings)
        ]
        if feels_gravity(nominal, motions[0].at(t[::20])[0]):
            break
    levels = {
        "viscous": rng.uniform(0.05, 0.3, size=unit.size),
        "coulomb": rng.uniform(0.05, 0.25, size=unit.size),
        "noise": rng.uniform(0.02, 0.05, size=unit.size),
    }
    setting = Setting(
        nominal=nominal,
        model=true_robot(nominal, rng),
        motions=motions,
        t=np.tile(t, n_recordings),
        groups=np.repeat(np.arange(n_recordings), n),
        dt=1.0 / rate,
        declared=declared,
        levels=levels,
    )
    return kind, setting


def _populate(setting, kinds, sizes, joints, rng, exact):
    """Put all effects into one robot and motion; None if a joint is missing."""
    nv = setting.nominal.nv
    entries, torques = [None] * len(kinds), [None] * len(kinds)

    def candidates(i):
        taken = {e.joint for e in entries if e is not None and e.name == kinds[i]}
        wanted = rng.permutation(nv) if joints[i] is None else [joints[i]]
        return [int(j) for j in wanted if j < nv and int(j) not in taken]

    def rank(i):
        # Elasticity changes the states and comes first, a channel has all others.
        return {"elastic": 0, "delay": 2, "torque_filter": 3}.get(kinds[i], 1)

    scene = None
    for i in sorted(range(len(kinds)), key=rank):
        there = candidates(i)
        if not there:
            return None
        if kinds[i] == "elastic":
            scene, parameters = soft_scene(setting, there[0], sizes[i], rng, exact)
            torques[i] = scene.elastic
            entries[i] = describe(
                "elastic",
                there[0],
                parameters,
                scene.elastic,
                scene,
                sizes[i],
                exact=exact,
            )
            continue
        scene = scene or lay_out(setting)
        present = [x for x in torques if x is not None]
        found = place(kinds[i], there, scene, present, sizes[i], rng, exact)
        if found is None:
            return None
        entries[i], torques[i] = found
    scene = scene or lay_out(setting)
    return scene, apart(entries, torques, scene), torques


def simulate(
    kinds=1,
    *,
    size=5.0,
    seed=0,
    joints=None,
    robot=None,
    declared=("viscous",),
    duration=None,
    rate=None,
    n_recordings=None,
    encoder_noise=None,
    exact=False,
):
    """Simulate a robot with undeclared effects."""
    first = np.random.default_rng(seed)
    if isinstance(kinds, (int, np.integer)):
        drawn = set(LIBRARY) - set(declared or ())
        kinds = first.choice(sorted(drawn), size=kinds, replace=False)
    kinds = tuple(str(kind) for kind in kinds)
    declared = _choose_declared(kinds, first) if declared is None else tuple(declared)
    known = {"viscous", *LIBRARY, *CHANNELS, *OUTSIDE} - set(declared)
    if not known.issuperset(kinds) or kinds.count("elastic") > 1:
        raise ValueError(
            f"kinds={kinds} with declared={declared}: expected undeclared effects of "
            f"{sorted(known)}, at most one of them elastic."
        )
    sizes = np.broadcast_to(np.asarray(size, dtype=float), len(kinds)).tolist()
    joints = [None] * len(kinds) if joints is None else list(joints)
    noise = first.choice(ENCODER_NOISE) if encoder_noise is None else encoder_noise
    best = None
    for rng in first.spawn(EXACT_ATTEMPTS if exact else ATTEMPTS):
        kind, setting = _draw_setting(
            kinds, robot, declared, duration, rate, n_recordings, rng
        )
        found = _populate(setting, kinds, sizes, joints, rng, exact)
        if found is None:
            continue
        seen = sum(entry.visible for entry in found[1])
        if best is None or seen > best[0]:
            best = seen, kind, setting, *found
        if seen == len(kinds):
            break
    if best is None:
        raise ValueError(f"No robot has joints={joints} for kinds={kinds}.")
    return _record(*best[1:], float(noise), first)


def _record(kind, setting, scene, entries, torques, encoder_noise, rng):
    world = scene.world
    clean = sum(torques, world.declared_torque)
    noise = encoder_noise * world.unit
    return UndeclaredRecording(
        q=world.q + noise * rng.normal(size=clean.shape),
        tau=clean + scene.noise * rng.normal(size=clean.shape),
        t=world.t,
        dt=world.dt,
        groups=world.groups,
        model=setting.nominal,
        declared=world.declared,
        truth=tuple(entries),
        robot=kind,
        states=np.hstack([world.q, world.v, world.a]),
        tau_clean=clean,
        contributions=tuple(torques),
        inertial=np.array(
            [body.toDynamicParameters() for body in world.model.inertias[1:]]
        ),
        friction=scene.friction,
        torque_noise=scene.noise,
        encoder_noise=noise,
    )


@dataclass(frozen=True)
class Case:
    """A case to simulate when it is needed; cheap to keep and to send to a worker."""

    kinds: tuple
    size: tuple
    seed: tuple
    declared: tuple | None = None

    def simulate(self, **settings):
        """Simulate the case; settings are those of `simulate`."""
        settings = {"declared": self.declared, **settings}
        return simulate(self.kinds, size=self.size, seed=self.seed, **settings)


def draw_cases(
    n, n_effects, size_range=(0.5, 10.0), seed=0, *, kinds=LIBRARY, declared=None
):
    """Draw random cases evenly over the kinds."""
    rng = np.random.default_rng([seed, n_effects])
    if n_effects > len(kinds):
        raise ValueError(f"{n_effects} different effects of {len(kinds)} kinds.")
    pack, cases = [], []
    for i in range(n):
        chosen = []
        while len(chosen) < n_effects:
            fresh = [kind for kind in pack if kind not in chosen]
            if not fresh:
                pack += rng.permutation(list(kinds)).tolist()
                continue
            pack.remove(fresh[0])
            chosen.append(fresh[0])
        low, high = np.log(size_range)
        sizes = np.exp(rng.uniform(low, high, size=n_effects)).tolist()
        cases.append(Case(tuple(chosen), tuple(sizes), (seed, n_effects, i), declared))
    return cases
