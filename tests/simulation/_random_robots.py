"""Random `IdentifiedRobot`s: bodies, effects and motions."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa import IdentifiedRobot, RigidBodyFeatures
from sklearn_vbjfa.effects import Motion, resolve
from sklearn_vbjfa.equations import Plan, is_load_free
from tests.model._robots import random_body
from tests.model._trees import ALIGNED, OBLIQUE, build

DT = 0.01
FRICTION = ("viscous", "coulomb", "offset", "rotor_inertia")


def random_shape(effect, rng, nv, length):
    """Return plausible shape parameters of an effect of the library."""
    others = [j for j in range(nv) if j != effect.joint]
    values = {
        "falling": (float(rng.choice([0.02, 0.05, 0.3])),),
        "element": str(rng.choice(["stop", "bristle"])),
        "vs": rng.uniform(0.05, 0.5),
        "k": int(rng.integers(1, 3)),
        "displacements": (0.02, rng.uniform(0.01, 0.3)),
        "loaded": (0.1,),
        "width": rng.uniform(0.01, 0.3),
        "form": str(rng.choice(["harmonics", "linkage"])),
        "ratio": rng.uniform(0.2, 0.8),
        "angle": rng.uniform(-3, 3),
        "period": rng.uniform(0.1, 1.0),
        "other": int(rng.choice(others)) if others else 0,
        "delay": float(rng.choice([-1, 1, 1, 1]) * rng.choice([0.003, 0.01, 0.034])),
        "kind": str(rng.choice(["lag", "lag", "smooth"])),
        "signal": "warmth",
        "reference": rng.normal(),
        "instant": rng.uniform(0, length) * DT,
        "centre": tuple(rng.normal(size=3) * 0.1),
        "gain": rng.uniform(0.8, 1.2),
        "zero": 0.1 * rng.normal(),
        "about_x": 0.1 * rng.normal(),
        "about_y": 0.1 * rng.normal(),
        "roll": 0.1 * rng.normal(),
        "pitch": 0.1 * rng.normal(),
        "time_constant": rng.uniform(0.005, 0.1),
    }
    if effect.name in {"drift", "signal"}:
        values["of"] = str(rng.choice(["coulomb", "offset", "viscous"]))
        values["time_constant"] = rng.uniform(0.5, 5.0)
    elif effect.name == "coupling":
        values["ratio"] = float(rng.choice([0.0, 1.0, -1.0, 0.6]))
    else:
        values["of"] = str(rng.choice(["torque", "position"]))
    parameters = effect.get_params(deep=False)
    return {name: values[name] for name in parameters if name in values}


def random_effect(name, rng, nv, prismatic, length):
    """Return an effect on a random joint, or None if it does not apply."""
    (effect,) = resolve([name])
    joint = int(rng.integers(nv))
    if name == "payload":
        joint = nv - 1
    if name == "base_tilt":
        joint = 0
    effect.set_params(joint=joint)
    if nv == 1 and name in {"coupling", "coupling_spring", "torque_gain"}:
        return None
    still = np.zeros((1, nv))
    motion = Motion(q=still, v=still, a=still, prismatic=np.array(prismatic))
    if "prismatic" in effect.applies(motion):
        return None
    return effect.set_params(**random_shape(effect, rng, nv, length))


def random_predictor(rng, nv, names, *, since=0.0, length=200, gravity=None):
    """Return the `IdentifiedRobot` of a random tree with the named effects."""
    kinds = rng.choice([*ALIGNED, *OBLIQUE], size=nv)
    model = build(rng, kinds, gravity=gravity)
    features = RigidBodyFeatures(model, FRICTION).load()
    prismatic = [kind.startswith("P") for kind in kinds]
    effects = [random_effect(name, rng, nv, prismatic, length) for name in names]
    effects = tuple(effect for effect in effects if effect is not None)
    plan = Plan(
        dt=DT,
        state_estimator=None,
        cutoff=float(rng.choice([20.0, np.inf])),
        standstill=rng.choice([-1.0, 0.0, 0.05, 0.2], size=nv),
        effects=effects,
        fastest_period=rng.uniform(0.5, 2.0, size=nv),
    )
    if plan.timed:
        plan = replace(plan, time=(since, since + DT * (length - 1)))

    def parameters():
        bodies = np.array([random_body(rng) for _ in range(nv)])
        friction = rng.uniform(0, 2, size=(nv, len(FRICTION)))
        return np.hstack([bodies, friction]).ravel()

    def coefficients(only=None):
        made = [
            0.3 * rng.normal(size=len(effect.coefficients))
            for effect in effects
            if only is None or only(effect)
        ]
        return np.concatenate([np.empty(0), *made])

    return IdentifiedRobot(
        features_=features.corrected(effects),
        plan=plan,
        theta_=np.r_[parameters(), coefficients()],
        load_parameters=np.r_[parameters(), coefficients(is_load_free)],
    )


def random_motion(rng, nv, length=200):
    """Return states (length, 3 nv) with reversals and a standstill."""
    t = DT * np.arange(length)
    frequency = rng.uniform(1, 8, size=nv)
    phase = rng.uniform(0, 6, size=nv)
    angle = np.outer(t, frequency) + phase
    size = rng.uniform(0.3, 1.0, size=nv)
    q, v, a = (
        size * np.sin(angle),
        size * frequency * np.cos(angle),
        -size * frequency**2 * np.sin(angle),
    )
    joint, start = rng.integers(nv), int(rng.integers(length // 2))
    stop = start + length // 4
    q[start:stop, joint] = q[start, joint]
    v[start:stop, joint] = a[start:stop, joint] = 0.0
    return np.hstack([q, v, a])


def with_effects(predictor, effects, coef, load=()):
    """Return the predictor with further effects and their coefficients."""
    return replace(
        predictor,
        plan=replace(predictor.plan, effects=(*predictor.effects_, *effects)),
        theta_=np.r_[predictor.theta_, coef],
        load_parameters=np.r_[predictor.load_parameters, load],
    )


def without(predictor, left_out):
    """Return the predictor without the effects at some indices."""
    effects, at = [], predictor.features_.n_parameters_
    theta, load = [predictor.theta_[:at]], [predictor.load_parameters[:at]]
    begin = begin_load = at
    for k, effect in enumerate(predictor.effects_):
        end = begin + len(effect.coefficients)
        end_load = begin_load + len(effect.coefficients) * is_load_free(effect)
        if k not in left_out:
            effects.append(effect)
            theta.append(predictor.theta_[begin:end])
            load.append(predictor.load_parameters[begin_load:end_load])
        begin, begin_load = end, end_load
    return replace(
        predictor,
        plan=replace(predictor.plan, effects=tuple(effects)),
        theta_=np.concatenate(theta),
        load_parameters=np.concatenate(load),
    )
