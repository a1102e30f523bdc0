"""A log-normal prior on rotor inertias, which are positive."""

import numpy as np

from sklearn_vbjfa.effects import CommandDelay
from sklearn_vbjfa.fit._estimate import widening, with_prior

# Standard deviation of the logarithm of a rotor inertia around its reference: a factor
# of two, as descriptions differ from what is measured.
WIDTH = np.log(2.0)
# A rotor inertia below this many deviations may be zero by the torques alone.
_CERTAIN = 2.0
# Newton's method, each step of which leaves at least a quarter of the value.
_STEPS, _SHRINK, _SETTLED = 50, 0.25, 1e-9


def with_positive_rotors(found, robot):
    """Return an `Estimate` whose rotor inertias are near their references."""
    at, references = _references(found, robot)
    if not at.size or found.covariance is None:
        return found
    C, ratio = widening(found)
    known = np.isfinite(found.std[at]) & (np.diagonal(C)[at] > 0)
    at, references = at[known], references[known]
    S = C[np.ix_(at, at)] * np.outer(ratio[at], ratio[at])
    y = found.theta_unconstrained[at]
    mean, variance, centre = most_probable(y, S, references)
    gain = np.linalg.solve(S + np.diag(variance), S).T
    less = gain @ S / np.outer(ratio[at], ratio[at])
    prior = np.diag(1.0 / variance)
    return with_prior(found, at, mean - y, less, prior, centre / variance)


def most_probable(y, S, references):
    """Mode of values that data have for normal, and a normal prior with the same one.

    y (k,), S (k, k): means and covariance by the data; references (k,): medians of the
    log-normal prior. Returns the mode (k,), and variances and means (k,) of the prior.
    """
    x = np.where(y > 0, y, references)
    for _ in range(_STEPS):
        # The logarithm is replaced by its tangent at the present value.
        variance, centre = (WIDTH * x) ** 2, x * (1.0 + np.log(references / x))
        new = y + S @ np.linalg.solve(S + np.diag(variance), centre - y)
        new = np.clip(new, _SHRINK * x, x / _SHRINK)
        moved, x = np.abs(new - x), new
        if (moved <= _SETTLED * x).all():
            break
    return x, variance, centre


def _references(found, robot):
    """Places of rotor inertias among the parameters, and what they are near to."""
    features, joints = robot.features_, robot.features_.n_joints_
    if "rotor_inertia" not in features.friction_:
        return np.empty(0, dtype=int), np.empty(0)
    per_joint = features.n_parameters_ // joints
    first = 10 + features.friction_.index("rotor_inertia")
    at = per_joint * np.arange(joints) + first
    theta, std = found.theta_unconstrained[at], found.std[at]
    certain = np.isfinite(std) & (theta > _CERTAIN * std)
    references = np.array(features.nominal_.armature, dtype=float)
    for group in found.alike:
        places = np.flatnonzero(np.isin(at, group.places))
        sure = places[certain[places]]
        if group.parameter == "rotor_inertia" and sure.size:
            mean = np.exp(np.log(theta[sure]).mean())
            unknown = places[~(references[places] > 0)]
            references[unknown] = mean
    used = references > 0
    if not any(isinstance(effect, CommandDelay) for effect in robot.effects_):
        # A delay, which is not part of these deviations, trades against all of them.
        used &= ~certain
    return at[used], references[used]
