"""Joint-torque columns of friction and drive, one set per joint."""

import numpy as np

from sklearn_vbjfa.effects._rest import mean_sign

# name -> (function of (v, a, rest), unit for a revolute joint, for a prismatic joint,
# whether physics asks for a non-negative coefficient)
_COLUMNS = {
    "viscous": (lambda v, a, rest: v, "N m s/rad", "N s/m", True),
    "coulomb": (mean_sign, "N m", "N", True),
    "offset": (lambda v, a, rest: np.ones_like(v), "N m", "N", False),
    "rotor_inertia": (lambda v, a, rest: a, "kg m^2", "kg", True),
}


def available():
    """Names of the friction columns."""
    return tuple(_COLUMNS)


def check_names(friction):
    """Return the names as a tuple, refusing unknown and repeated ones."""
    names = (friction,) if isinstance(friction, str) else tuple(friction)
    unknown = [name for name in names if name not in _COLUMNS]
    if unknown:
        raise ValueError(
            f"Unknown friction column(s) {unknown}; expected some of {list(_COLUMNS)}."
        )
    if len(set(names)) < len(names):
        raise ValueError(f"friction names a column twice: {list(names)}.")
    return names


def columns(names, v, a, rest=None):
    """Return the columns, ndarray of shape (n, nv, len(names)).

    With a `Rest` the sign of the velocity is its mean.
    """
    if not names:
        return np.zeros((*np.shape(v), 0))
    return np.stack([_COLUMNS[name][0](v, a, rest) for name in names], axis=-1)


def unit(name, prismatic):
    """Return the unit of the coefficient."""
    return _COLUMNS[name][2 if prismatic else 1]


def nonnegative(name):
    """Whether physics asks for a non-negative coefficient."""
    return _COLUMNS[name][3]
