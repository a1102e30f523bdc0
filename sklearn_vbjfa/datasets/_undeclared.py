"""Torques that a simulated robot has and its declared model lacks.

Written apart from the library of effects, so that what finds them is not what made
them: a smooth sign where the library has a sharp one, elements that slip one by one
where it has Dahl's equation.
"""

import numpy as np

# Speed over which friction turns, as a share of the joint's fastest.
_TURN = 0.005
# Elements of the slip model: displacements at which they begin to slip [rad or m].
_SLIPS = (0.004, 0.01, 0.02)
_RIPPLE_PERIOD = np.radians(20.0)


def _turn(v):
    return np.tanh(v / (_TURN * np.abs(v).max()))


def _load_friction(size, q, v, load):
    return size * np.abs(load) * _turn(v)


def _stribeck(size, q, v, load):
    slow = 0.1 * np.abs(v).max()
    return size / np.cosh(v / slow) * _turn(v)


def _spring(size, q, v, load):
    return size * (q - q.mean())


def _ripple(size, q, v, load):
    return size * np.sin(2 * np.pi * q / _RIPPLE_PERIOD)


def _offset(size, q, v, load):
    return np.full(q.shape, float(size))


def _presliding(size, q, v, load):
    """Maxwell's slip model: springs that slide when stretched too far."""
    total = np.zeros_like(q)
    for slip in _SLIPS:
        stretch = np.zeros_like(q)
        for i in range(1, q.size):
            moved = stretch[i - 1] + q[i] - q[i - 1]
            stretch[i] = min(max(moved, -slip), slip)
        total += stretch / slip
    return size * total / len(_SLIPS)


_TORQUES = {
    "load_friction": _load_friction,
    "stribeck": _stribeck,
    "spring": _spring,
    "ripple": _ripple,
    "offset": _offset,
    "presliding": _presliding,
}


def undeclared_torque(undeclared, q, v, rigid):
    """Sum the torques of undeclared effects.

    Parameters
    ----------
    undeclared : mapping of str to (int, float)
        Name -> joint (from zero) and size.
    q, v, rigid : ndarray of shape (n, nv)
        Positions, velocities, torques of the rigid bodies, of one recording.

    Returns
    -------
    ndarray of shape (n, nv)
        Torques.
    """
    total = np.zeros_like(q)
    for name, entry in undeclared.items():
        if name not in _TORQUES:
            raise ValueError(
                f"Unknown undeclared effect {name!r}; expected some of "
                f"{', '.join(_TORQUES)}."
            )
        try:
            joint, size = entry
            total[:, joint] += _TORQUES[name](
                float(size), q[:, joint], v[:, joint], rigid[:, joint]
            )
        except (TypeError, IndexError) as error:
            raise ValueError(
                f"undeclared[{name!r}] must be (joint, size) with a joint of 0 to "
                f"{q.shape[1] - 1}; got {entry!r}."
            ) from error
    return total
