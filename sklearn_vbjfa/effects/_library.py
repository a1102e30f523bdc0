"""The library of effects by name, and the terms that a robot can declare."""

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.effects import (
    _channels,
    _drive,
    _friction,
    _in_model,
    _memory,
    _position,
    _varying,
)
from sklearn_vbjfa.effects._base import Effect
from sklearn_vbjfa.effects._motion import Motion

_LIBRARY = {
    effect.name: effect
    for effect in (
        _friction.Viscous,
        _friction.Coulomb,
        _friction.AsymmetricFriction,
        _friction.Stribeck,
        _friction.ViscousQuadratic,
        _friction.LoadFriction,
        _friction.GearLoss,
        _memory.MaxwellSlip,
        _memory.Backlash,
        _friction.Offset,
        _position.Spring,
        _position.Counterbalance,
        _position.Ripple,
        _position.FrictionByPosition,
        _friction.RotorInertia,
        _drive.Coupling,
        _drive.CouplingSpring,
        _drive.Elastic,
        _channels.Delay,
        _channels.TorqueFilter,
        _channels.Jerk,
        _varying.Signal,
        _varying.Drift,
        _varying.Payload,
        _in_model.BaseTilt,
        _in_model.JointZero,
        _in_model.JointAxis,
        _in_model.TorqueGain,
    )
}


def closure(effect, library):
    """Return the names of all effects that an effect contains, also indirectly."""
    contained = [part for part in library if part.name in effect.contains]
    others = [part for part in library if part not in contained]
    return set(effect.contains).union(*(closure(part, others) for part in contained))


def available():
    """Names of the effects of the library.

    Returns
    -------
    tuple of str
        Names, plain effects before those that contain them.

    Examples
    --------
    >>> from sklearn_vbjfa import effects
    >>> effects.available()[:3]
    ('viscous', 'coulomb', 'asymmetric_friction')
    """
    return tuple(_LIBRARY)


def resolve(effects="all"):
    """Return effects, without duplicates, from names, classes, instances or "all"."""
    if isinstance(effects, str) and effects == "all":
        return tuple(effect() for effect in _LIBRARY.values())
    if isinstance(effects, (str, Effect, type)):
        effects = (effects,)
    resolved = tuple(_resolve_one(effect) for effect in effects)
    names = [effect.name for effect in resolved]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ValueError(f"effects names {', '.join(repeated)} twice.")
    return resolved


def _resolve_one(effect):
    if isinstance(effect, str):
        if effect not in _LIBRARY:
            raise ValueError(
                f"Unknown effect {effect!r}; expected one of "
                f"{', '.join(_LIBRARY)}, or an instance of Effect."
            )
        return _LIBRARY[effect]()
    if isinstance(effect, type) and issubclass(effect, Effect):
        return effect()
    if isinstance(effect, Effect):
        return clone(effect)
    raise ValueError(
        "effects must hold names of the library, classes or instances of Effect; got "
        f"{effect!r}."
    )


_DECLARED = {
    e.name: e for e in resolve(["viscous", "coulomb", "offset", "rotor_inertia"])
}


def declarable():
    """Names of the effects that can be declared, tuple of str."""
    return tuple(_DECLARED)


def declared(name):
    return _DECLARED[name]


def check_declared(friction):
    """Return names of declared effects, a tuple; refuse unknown and repeated ones."""
    names = (friction,) if isinstance(friction, str) else tuple(friction)
    unknown = [name for name in names if name not in _DECLARED]
    if unknown:
        raise ValueError(
            f"Unknown friction column(s) {unknown}; expected some of {list(_DECLARED)}."
        )
    if len(set(names)) < len(names):
        raise ValueError(f"friction names a column twice: {list(names)}.")
    return names


def declared_columns(names, v, a, rest=None):
    """Columns of all joints, (n, nv, len(names)), with mean signs given a `Rest`."""
    out = np.zeros((*np.shape(v), len(names)))
    motion = Motion(q=v, v=v, a=a, rest=rest)
    for k, name in enumerate(names):
        for joint in range(out.shape[1]):
            effect = type(_DECLARED[name])(joint)
            out[:, [joint], k] = effect.columns(motion)
    return out
