"""Physically consistent bodies that complete what the data cannot tell."""

import numpy as np

from sklearn_vbjfa.robot._model import nominal_parameters, solid_bodies


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
