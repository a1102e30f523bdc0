"""Checks of the controller and the reference of a recorded closed loop."""

import numpy as np

from sklearn_vbjfa.simulation import PositionController


def check_reference(controller, reference, y, dt):
    """Return the reference (n, nv) of a closed loop, refusing what does not suit it."""
    n, nv = y.shape
    if controller is None:
        if reference is not None:
            raise ValueError(
                "reference is given without a controller: set controller to a "
                "PositionController with criterion='simulation'."
            )
        return None
    if not isinstance(controller, PositionController):
        raise ValueError(
            f"controller must be a PositionController or None; got {controller!r}."
        )
    controller.gains(nv)
    controller.updates(dt)
    if reference is None:
        raise ValueError(
            "controller needs the commanded positions: give fit(..., reference=), one "
            f"row per sample, shape ({n}, {nv})."
        )
    reference = np.asarray(reference, dtype=float)
    if reference.ndim == 1 and nv == 1:
        reference = reference[:, None]
    if reference.shape != (n, nv):
        raise ValueError(
            f"reference must hold one row per sample and one column per joint, shape "
            f"({n}, {nv}); got {reference.shape}."
        )
    bad = np.argwhere(~np.isfinite(reference))
    if bad.size:
        raise ValueError(
            f"reference holds {reference[tuple(bad[0])]} in row {bad[0][0]}, joint "
            f"{bad[0][1]}."
        )
    return reference
