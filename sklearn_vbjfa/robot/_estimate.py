"""From estimated parameters to a robot: projection, and what the data determine.

Physically consistent bodies that complete what the data cannot tell.
"""

import numpy as np
from scipy import linalg
from sklearn.base import clone

from sklearn_vbjfa.effects import _declared as _friction
from sklearn_vbjfa.model._loading import nominal_parameters, solid_bodies
from sklearn_vbjfa.physical import PhysicalProjector, body_scales, min_eigenvalue


def consistent_anchor(model, theta, metric, per_joint):
    """Return a consistent parameter vector near the model's own, in the data's unit.

    Directions that the torques do not depend on are free; a projection needs a point
    to complete them from. The inertias in the robot description serve, and where it
    holds none a solid ball of the links' mean mass and the robot's length. They are
    scaled as a whole to the data, so that torques in another unit give the same robot
    in that unit.

    Parameters
    ----------
    model : pinocchio.Model
        Robot.
    theta : ndarray of shape (p,)
        Estimated parameters.
    metric : ndarray of shape (p, p)
        Gram matrix of the estimation.
    per_joint : int
        Parameters per joint.
    """
    bodies = _complete(nominal_parameters(model), _robot_length(model))
    anchor = theta.reshape(-1, per_joint).copy()
    anchor[:, 10:] = np.maximum(anchor[:, 10:], 0.0)
    inertial = np.zeros((bodies.shape[0], per_joint), dtype=bool)
    inertial[:, :10] = True
    at = np.flatnonzero(inertial.ravel())
    block = metric[np.ix_(at, at)]
    nominal, estimate = bodies.ravel(), theta[at]
    seen = nominal @ block @ nominal
    factor = 1.0
    if seen > 0:
        factor = (nominal @ block @ estimate) / seen
        if not factor > 0:
            factor = np.sqrt(max(estimate @ block @ estimate, 0.0) / seen) or 1.0
    anchor[:, :10] = factor * bodies
    return anchor.ravel()


def _robot_length(model):
    """Mean distance [m] between joints; 1 m where all coincide."""
    distances = [
        np.linalg.norm(placement.translation) for placement in model.jointPlacements[1:]
    ]
    distances = [d for d in distances if d > 0]
    return float(np.mean(distances)) if distances else 1.0


def _complete(bodies, length):
    """Replace bodies that no mass distribution has by solid balls."""
    good = solid_bodies(bodies)
    ball_mass = bodies[good, 0].mean() if good.any() else 1.0
    radius = 0.25 * length
    moment = 0.4 * ball_mass * radius**2
    ball = np.array([ball_mass, 0, 0, 0, moment, 0, moment, 0, 0, moment])
    return np.where(good[:, None], bodies, ball)


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
    theta : ndarray of shape (p + n_effects,)
        Estimate; effects come last and are free of constraints.
    metric : ndarray of shape (p + n_effects, p + n_effects)
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
    p = model.nv * per_joint
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
    }
    if theta.size > p:
        settings["body_starts"] = np.arange(0, p, per_joint), None
    fitted = PhysicalProjector() if default else clone(projector)
    given = fitted.get_params()
    if given["anchor"] is None:
        anchor = consistent_anchor(model, theta[:p], metric[:p, :p], per_joint)
        settings["anchor"] = np.concatenate([anchor, theta[p:]]), None
    elif theta.size > p:
        fitted.set_params(anchor=np.concatenate([given["anchor"], theta[p:]]))
    fitted.set_params(
        **{
            key: value
            for key, (value, unset) in settings.items()
            if given[key] is unset or _same(given[key], unset)
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


def project_beside(projector, model, theta, metric, friction):
    """Project the bodies while the effects' coefficients, which come last, follow.

    The distance (eq. 35) is minimised over both. In a metric of the user's own, which
    is one of the bodies, the bodies are projected first, and the effects go to their
    best beside them.

    Returns
    -------
    projector : PhysicalProjector
        Fitted projector.
    theta : ndarray of shape (p,)
        Projected parameters.
    """
    p = model.nv * (10 + len(friction))
    own = getattr(projector, "metric", None) is not None
    if theta.size == p or not own:
        fitted = fit_projector(projector, model, theta, metric, friction)
        return fitted, fitted.transform(theta[None])[0]
    rigid = theta[:p]
    fitted = fit_projector(projector, model, rigid, metric[:p, :p], friction)
    projected = fitted.transform(rigid[None])[0]
    follow = _pseudo_solve(metric[p:, p:], metric[p:, :p])
    return fitted, np.concatenate([projected, theta[p:] - follow @ (projected - rigid)])


def _pseudo_solve(A, B):
    """Minimum-norm A^-1 B for a Gram matrix A, in columns of unit length."""
    scale = np.sqrt(np.diagonal(A))
    unit = np.where(scale > 0, scale, 1.0)
    inverse = linalg.pinvh(A / np.outer(unit, unit))
    return inverse @ (B / unit[:, None]) / unit[:, None]


def min_eigenvalues(bodies):
    """Smallest pseudo-inertia eigenvalue of each body, in the bodies' own scales.

    Parameters
    ----------
    bodies : ndarray of shape (nv, k)
        Inertial parameters of each body in the first ten columns.
    """
    mass, length = body_scales(bodies[:, :10])
    return min_eigenvalue(bodies[:, :10], mass_scale=mass, length_scale=length)
