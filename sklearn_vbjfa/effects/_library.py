"""The library of effects by name."""

from sklearn.base import clone

from sklearn_vbjfa.effects._base import Effect
from sklearn_vbjfa.effects._channels import Delay, Jerk, TorqueFilter
from sklearn_vbjfa.effects._drive import Coupling, Elastic, RotorInertia
from sklearn_vbjfa.effects._friction import (
    AsymmetricFriction,
    Coulomb,
    LoadFriction,
    Stribeck,
    Viscous,
    ViscousQuadratic,
)
from sklearn_vbjfa.effects._hysteresis import Backlash, Presliding
from sklearn_vbjfa.effects._in_model import BaseTilt, JointAxis, JointZero, TorqueGain
from sklearn_vbjfa.effects._position import Counterbalance, Offset, Ripple, Spring
from sklearn_vbjfa.effects._signals import Signal
from sklearn_vbjfa.effects._time import Drift, Payload

_LIBRARY = {
    effect.name: effect
    for effect in (
        Viscous,
        Coulomb,
        AsymmetricFriction,
        Stribeck,
        ViscousQuadratic,
        LoadFriction,
        Presliding,
        Backlash,
        Offset,
        Spring,
        Counterbalance,
        Ripple,
        RotorInertia,
        Coupling,
        Elastic,
        Delay,
        TorqueFilter,
        Jerk,
        Signal,
        Drift,
        Payload,
        BaseTilt,
        JointZero,
        JointAxis,
        TorqueGain,
    )
}


def closure(effect, library):
    """Names, a set, of all effects that an effect contains, directly or not."""
    by_name = {e.name: e for e in library}
    found, open_ = set(), list(effect.contains)
    while open_:
        name = open_.pop()
        if name not in found:
            found.add(name)
            open_ += by_name[name].contains if name in by_name else ()
    return found


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
    """Turn names, classes and instances into effects, one of each.

    Parameters
    ----------
    effects : "all", str, Effect or iterable of these, default="all"
        What to look for.

    Returns
    -------
    tuple of Effect
        Effects.

    Raises
    ------
    ValueError
        If a name is unknown or comes twice.

    Examples
    --------
    >>> from sklearn_vbjfa import effects
    >>> effects.resolve(["coulomb", effects.Spring])
    (Coulomb(), Spring())
    """
    if isinstance(effects, str) and effects == "all":
        return tuple(effect() for effect in _LIBRARY.values())
    if isinstance(effects, (str, Effect, type)):
        effects = (effects,)
    found = tuple(_one(effect) for effect in effects)
    names = [effect.name for effect in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"effects names {', '.join(twice)} twice.")
    return found


def _one(effect):
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
