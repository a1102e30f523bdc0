"""A base that is free in the description, as of a quadruped: held in one orientation.

A recording of joints says nothing of a base that moves. Where it is does not matter to
the torques, its orientation does, by gravity.
"""

import numpy as np

from sklearn_vbjfa.model._pinocchio import import_pinocchio

# Sine of the angle from the vertical below which a base is called level.
_LEVEL = 1e-6


def free_root(free, carriers):
    """Name of the only free joint if it carries all other joints; None otherwise."""
    # carriers: for each joint the one that carries it, None for the world.
    on_world = [name for name, above in carriers.items() if above is None]
    # A body that carries nothing is no base.
    return free[0] if len(free) == 1 and on_world == free != [*carriers] else None


def rotation_of(orientation):
    """Rotation (3, 3) of a quaternion w, x, y, z, of any length."""
    try:
        given = np.asarray(orientation, dtype=float)
    except (TypeError, ValueError):
        given = np.empty(0)
    length = np.linalg.norm(given) if given.shape == (4,) else 0.0
    if not 0 < length < np.inf:
        raise ValueError(
            "base_orientation must be a quaternion of four finite numbers w, x, y, z, "
            f"not all zero; got {orientation!r}."
        )
    w, x, y, z = given / length
    return import_pinocchio().Quaternion(w, x, y, z).toRotationMatrix()


def check_free(name, orientation, robot):
    """Refuse an orientation for a base that is not free."""
    # name: free joint at the root, None without one; robot: how messages call it.
    if name is None and orientation is not None:
        raise ValueError(
            f"{robot} has no free joint that alone carries all other joints, so that "
            "its base stands as described; leave base_orientation out."
        )


def said_of(name, rotation):
    """Say how the base is held; rotation : of the base in the world (3, 3)."""
    if np.linalg.norm(rotation[2, :2]) < _LEVEL and rotation[2, 2] > 0:
        how = "level"
    else:
        angles = np.rad2deg(import_pinocchio().rpy.matrixToRpy(rotation))
        # No minus in front of zero.
        listed = " ".join(f"{x:.4g}" for x in np.round(angles, 4) + 0.0)
        how = f"turned by rpy {listed} degrees"
    return (
        f"the base, which {name} leaves free, is held {how} (base_orientation or "
        "--base-orientation turns it, the effect base_tilt finds a few degrees more)"
    )
