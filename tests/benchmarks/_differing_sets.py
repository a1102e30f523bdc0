"""Simulated recordings of one robot, which differ by friction, offset, gain or load.

An arm of two joints, its bodies other than described (`true_robot`), moves for 25 s at
50 Hz; viscous and Coulomb friction are 10 and 15 % of its torque. From recording to
recording friction, the gain of one joint or the mass of the last body are multiplied by
exp(s N), or the offsets grow by s N times the torque, with a deviation s of 0, 10 or
25 %; or nothing differs and the model lacks friction that depends on the position (3 %
of the torque). Noise is 2 % of the torque and 20 urad.
"""

import warnings

import numpy as np
from _undeclared_robots import draw_motion, inverse_dynamics, nominal_robot, true_robot

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

KINDS = ("friction", "offset", "gain", "payload")
CELLS = (("nothing", 0.0), ("model fault", 0.0))
CELLS += tuple((kind, size) for kind in KINDS for size in (0.1, 0.25))
COUNTS, KEYS = (1, 2, 4), ("kind", "size", "count", "seed")
NV, DT, SECONDS = 2, 0.02, 25.0


def simulated(kind, size, count, seed):
    """Make a description, and (q, tau) of recordings to fit and of one more."""
    rng = np.random.default_rng([seed, count, CELLS.index((kind, size))])
    nominal = nominal_robot("serial", rng, NV)
    robot, t = true_robot(nominal, rng), np.arange(0.0, SECONDS, DT)
    made = []
    for _ in range(count + 1):
        motion = draw_motion(np.ones(NV), 0.8, t, rng).at(t)
        x, factor = size * rng.standard_normal(NV), np.ones(NV)
        loaded = robot.copy()
        if kind == "payload":
            body = loaded.inertias[NV].toDynamicParameters() * np.exp(x[0])
            loaded.inertias[NV] = type(robot.inertias[NV]).FromDynamicParameters(body)
        if not made:
            still = inverse_dynamics(robot, *motion).std(axis=0)
            damping = 0.10 * still / motion[1].std(axis=0)
        q, v, _ = motion
        friction = damping * v + 0.15 * still * np.sign(v)
        tau = inverse_dynamics(loaded, *motion)
        tau += friction * (np.exp(x[0]) if kind == "friction" else 1.0)
        if kind == "offset":
            tau += still * x
        if kind == "gain":
            factor[0] = np.exp(x[0])
        if kind == "model fault":
            tau += 0.03 * still * np.sin(5 * q) * np.sign(v)
        noise = 0.02 * still * rng.standard_normal(q.shape)
        made.append((q + 2e-5 * rng.standard_normal(q.shape), tau * factor + noise))
    return nominal, made


def tasks(seeds):
    """List the sets of all cells, seed by seed."""
    return [
        {"kind": kind, "size": size, "count": count, "seed": seed}
        for seed in seeds
        for kind, size in CELLS
        for count in COUNTS
    ]


def judge(task):
    """Promise, truth and differences of a set."""
    model, made = simulated(**task)
    count = task["count"]
    q, tau = (np.concatenate(x) for x in zip(*made[:count]))
    identifier = RobotIdentifier(model, dt=DT, friction=("viscous", "coulomb"))
    loop = EffectDiscovery(identifier, random_state=0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            loop.fit(q, tau, groups=np.repeat(np.arange(count), len(made[0][0])))
            left = loop.identifier_.residuals(*made[count]).rms()
    except ValueError as error:  # counted and shown, the study goes on
        return {**task, "error": str(error)}
    found = loop.report_.outcome.findings
    *joints, mean = loop.report_.outcome.facts_of("next recording")
    error = left / loop.torque_std_
    low, high = np.array([one.interval for one in joints]).T
    return {
        **task,
        "promised": mean.value,
        "interval": list(mean.interval),
        "true": float(error.mean()),
        "joints": float(((error >= low) & (error <= high)).mean()),
        "differ": [one.cause for one in found["contradictions"]],
        "named": [effect.name for effect in loop.effects_],
    }
