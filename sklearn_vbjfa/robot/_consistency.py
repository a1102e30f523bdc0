"""From estimated parameters to a robot: projection, and what the data determine."""

import numpy as np
from scipy import linalg
from sklearn.base import clone

from sklearn_vbjfa.physical import PhysicalProjector, body_scales, min_eigenvalue
from sklearn_vbjfa.robot import _friction
from sklearn_vbjfa.robot._anchor import consistent_anchor

# Directions of parameter space that the data determine less than this, relative to
# the best determined one in scaled columns, count as not identifiable.
_IDENTIFIABLE = 1e-9


def fit_projector(projector, model, theta, metric, friction):
    """Fit a projector to an estimate; what the user left open follows the robot.

    Parameters
    ----------
    projector : "default" or PhysicalProjector
        The user's choice.
    model : pinocchio.Model
        Robot.
    theta : ndarray of shape (p,)
        Estimate.
    metric : ndarray of shape (p, p)
        De-noised Gram matrix of the estimation (eq. 35).
    friction : tuple of str
        Friction columns.
    """
    default = isinstance(projector, str)
    if default and projector != "default":
        raise ValueError(
            "projector must be 'default', a PhysicalProjector or None; got "
            f"{projector!r}."
        )
    per_joint = 10 + len(friction)
    nonnegative = [
        j * per_joint + 10 + k
        for j in range(model.nv)
        for k, name in enumerate(friction)
        if _friction.nonnegative(name)
    ]
    settings = {
        "metric": (metric, None),
        "parameters_per_joint": (per_joint, "auto"),
        "nonnegative": (nonnegative, "auto"),
        "anchor": (consistent_anchor(model, theta, metric, per_joint), None),
    }
    fitted = PhysicalProjector() if default else clone(projector)
    given = fitted.get_params()
    fitted.set_params(
        **{
            key: value
            for key, (value, unset) in settings.items()
            if key in given and (given[key] is unset or _same(given[key], unset))
        }
    )
    return fitted.fit(theta[None])


def _same(value, unset):
    return isinstance(value, str) and value == unset


def identifiable(metric):
    """Parameters whose unit vector lies in the span that the data determine."""
    scale = np.sqrt(np.diagonal(metric))
    moved = scale > 0
    result = np.zeros(scale.size, dtype=bool)
    if not moved.any():
        return result
    unit = scale[moved]
    values, vectors = linalg.eigh(metric[np.ix_(moved, moved)] / np.outer(unit, unit))
    null = vectors[:, values < _IDENTIFIABLE * values[-1]]
    result[moved] = (null**2).sum(axis=1) < 1e-6
    return result


def min_eigenvalues(theta, per_joint):
    """Smallest pseudo-inertia eigenvalue of each body, in the bodies' own scales."""
    bodies = theta.reshape(-1, per_joint)[:, :10]
    mass, length = body_scales(bodies)
    return min_eigenvalue(bodies, mass_scale=mass, length_scale=length)
