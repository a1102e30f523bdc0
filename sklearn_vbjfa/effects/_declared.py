"""Effects that a robot declares by name: one column on every joint.

They are the effects of the library that are a `JointEffect`, so that name, column, unit
and sign of a declared coefficient are those of the effect that a search would find.
"""

import numpy as np

from sklearn_vbjfa.effects._base import JointEffect
from sklearn_vbjfa.effects._library import resolve

_DECLARED = {e.name: e for e in resolve("all") if isinstance(e, JointEffect)}


def available():
    """Names of the effects that can be declared, tuple of str."""
    return tuple(_DECLARED)


def check_names(friction):
    """Return the names as a tuple, refusing unknown and repeated ones."""
    names = (friction,) if isinstance(friction, str) else tuple(friction)
    unknown = [name for name in names if name not in _DECLARED]
    if unknown:
        raise ValueError(
            f"Unknown friction column(s) {unknown}; expected some of {list(_DECLARED)}."
        )
    if len(set(names)) < len(names):
        raise ValueError(f"friction names a column twice: {list(names)}.")
    return names


def columns(names, v, a, rest=None):
    """Columns of all joints, (n, nv, len(names)); signs are means with a `Rest`."""
    if not names:
        return np.zeros((*np.shape(v), 0))
    return np.stack([_DECLARED[name].column(v, a, rest) for name in names], axis=-1)


def unit(name, prismatic):
    """Return the unit of the coefficient on a revolute or prismatic joint."""
    (units,) = _DECLARED[name].units
    return units[int(bool(prismatic))]


def nonnegative(name):
    """Whether physics asks for a coefficient that is not negative."""
    return bool(_DECLARED[name].nonnegative)
