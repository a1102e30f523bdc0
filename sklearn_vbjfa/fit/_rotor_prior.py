"""Prior of positive rotor inertias near the described ones."""

import numpy as np

from sklearn_vbjfa.effects import CommandDelay
from sklearn_vbjfa.fit._estimate import uninflated_covariance, with_prior

# A described rotor inertia is that of the drive, within a factor of two (standard
# deviation of the logarithm), or a default of the file without information: then any
# positive value up to two deviations above the estimate. Both have equal odds.
_WIDTH, _SIGNIFICANT = np.log(2.0), 2.0
# Grids of values: logarithms around the description, deviations around the estimate.
_NEAR, _AROUND = np.linspace(-5.0, 5.0, 101), np.linspace(-6.0, 6.0, 241)
# Minimum precision of a site relative to the estimate; maximum passes, tolerance.
_MIN_SITE, _MAX_STEPS, _TOLERANCE = 1e-6, 100, 1e-4


def with_positive_rotors(result, robot):
    """Return an `Estimate` with a prior of positive rotor inertias."""
    index, references = _rotor_references(result, robot)
    if not index.size or result.covariance is None:
        return result
    C, ratio = uninflated_covariance(result)
    determined = np.isfinite(result.std[index]) & (np.diagonal(C)[index] > 0)
    index, references = index[determined], references[determined]
    inflation = np.outer(ratio[index], ratio[index])
    y, S = result.theta_unconstrained[index], C[np.ix_(index, index)] * inflation
    mean, covariance, precision, right = rotor_posterior(y, S, references)
    reduction = (S - covariance) / inflation
    return with_prior(result, index, mean - y, reduction, np.diag(precision), right)


def rotor_posterior(y, S, references):
    """Return mean, covariance, and the prior's precisions and products with means."""
    # y (k,), S (k, k): estimate and covariance. Sites as in `propagate_sites`.
    variance, right = np.diagonal(S), np.zeros(y.size)
    least = precision = _MIN_SITE / variance
    limit = np.maximum(y, 0.0) + _SIGNIFICANT * np.sqrt(variance)
    near = references * np.exp(_WIDTH * _NEAR[:, None])
    for _ in range(_MAX_STEPS):
        gain = np.linalg.solve(S + np.diag(1.0 / precision), S).T
        mean, covariance = y + gain @ (right / precision - y), S - gain @ S
        total = np.diagonal(covariance)
        cavity = 1.0 / np.maximum(1.0 / total - precision, least)
        start = cavity * (mean / total - right)
        x = np.vstack([near, start + np.sqrt(cavity) * _AROUND[:, None]])
        x = np.sort(np.where(x > 0, x, near[0]), axis=0)
        density = np.exp(-0.5 * (np.log(x / references) / _WIDTH) ** 2) / x
        density = density / (_WIDTH * np.sqrt(2 * np.pi)) + (x < limit) / limit
        squares = (x - start) ** 2 / cavity
        weight = density * np.exp(-0.5 * (squares - squares.min(axis=0)))
        weight *= np.gradient(x, axis=0)
        weight /= weight.sum(axis=0)
        target = (weight * x).sum(axis=0)
        spread = (weight * (x - target) ** 2).sum(axis=0)
        if (np.abs(target - mean) <= _TOLERANCE * np.sqrt(spread)).all():
            break
        new = np.maximum(1.0 / spread - 1.0 / cavity, least)
        right = 0.5 * (right + new * target + (target - start) / cavity)
        precision = 0.5 * (precision + new)
    return mean, covariance, precision, right


def _rotor_references(result, robot):
    """Return indices of rotor inertias and the medians of their priors."""
    features, friction = robot.features_, robot.features_.friction_
    if "rotor_inertia" not in friction:
        return np.empty(0, dtype=int), np.empty(0)
    first, per_joint = 10 + friction.index("rotor_inertia"), 10 + len(friction)
    indices = np.arange(first, features.n_parameters_, per_joint)
    theta, std = result.theta_unconstrained[indices], result.std[indices]
    certain = np.isfinite(std) & (theta > _SIGNIFICANT * std)
    references = np.array(features.nominal_.armature, dtype=float)
    for group in result.alike:
        places = np.flatnonzero(np.isin(indices, group.indices))
        sources = places[certain[places]]
        if group.parameter == "rotor_inertia" and sources.size:
            unknown = places[~(references[places] > 0)]
            references[unknown] = np.exp(np.log(theta[sources]).mean())
    used = references > 0
    if not any(isinstance(effect, CommandDelay) for effect in robot.effects_):
        # A delay, which is correlated with all inertias, is not part of `std`.
        used &= ~certain
    return indices[used], references[used]
