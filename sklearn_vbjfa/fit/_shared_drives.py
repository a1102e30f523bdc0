"""Partial pooling of parameters over joints with the same drive."""

import functools
import re
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from sklearn_vbjfa.effects import declared
from sklearn_vbjfa.equations._equations import excluded_columns
from sklearn_vbjfa.equations._plan import effect_indices
from sklearn_vbjfa.fit._bodies import DESCRIBED, Site, floored_inverse, propagate_sites
from sklearn_vbjfa.fit._estimate import uninflated_covariance, with_prior
from sklearn_vbjfa.model import (
    is_prismatic,
    joint_names,
    nominal_parameters,
    solid_bodies,
)
from sklearn_vbjfa.robot._channels import HALF_WIDTH

# Words, besides numbers, that distinguish legs, arms or fingers in joint names.
_SIDES = frozenset(
    "l r left right fl fr rl rr hl hr bl br lf rf lh rh lr rm lm ml mr lb rb "
    "front rear back hind mid middle".split()
)
_WORDS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")
# Ratio of standard deviations to the best joint above which a value is undetermined.
_MAX_RATIO = 1e6
# Relative tolerance of equal masses and moments of inertia in a description.
_EQUAL = 1e-4


@dataclass(frozen=True, kw_only=True)
class AlikeValue:
    """A parameter that joints share, with some scatter."""

    group: str  # name of the group of joints
    parameter: str  # such as "rotor_inertia"
    joints: tuple[str, ...]  # that share the value
    indices: tuple[int, ...]  # of their values in `RobotIdentifier.theta_`
    value: float  # mean of the joints
    std: float  # standard deviation of that mean
    unit: str
    # standard deviation between the joints over the mean; nan if that may be zero
    scatter: float

    def at(self, theta):
        """Return the value with the mean of the fitted parameters (p,)."""
        return replace(self, value=float(theta[list(self.indices)].mean()))


def shared_drives(identifier):
    """Return groups of joints with the same drive, pairs of name and joints."""
    alike = identifier.fit_options.alike
    if alike not in ("auto", None):
        raise ValueError(f"alike must be 'auto' or None; got {alike!r}.")
    # Not with unknown gains, nor with a custom regressor.
    off = identifier.used_gains is not None or identifier.regressor is not None
    return () if alike is None or off else _group_joints(identifier.features_.nominal_)


def _group_joints(model):
    """Group joints whose names differ only in side or number, with equal bodies."""
    names, slides = joint_names(model), is_prismatic(model)
    solid = solid_bodies(nominal_parameters(model))
    groups = {}
    for j in np.flatnonzero(solid):
        words = [word.lower() for word in _WORDS.findall(names[j])]
        key = tuple("" if w in _SIDES or w.isdigit() else w for w in words)
        if "" in key:
            groups.setdefault((key, bool(slides[j])), []).append(int(j))
    equal = [part for group in groups.values() for part in _equal_bodies(group, model)]
    # Joints of one chain, which carry each other, have drives of different size.
    carried = [{i - 1 for i in list(s)[:-1]} for s in list(model.supports)[1:]]
    equal = [group for group in equal if not any(carried[k] & {*group} for k in group)]
    return _name_groups([group for group in equal if len(group) > 1], names)


def _equal_bodies(joints, model):
    """Split joints into groups of equal mass and principal moments of inertia."""
    parts = []
    for j in joints:
        body = model.inertias[j + 1]
        inertias = np.append(body.mass, np.linalg.eigvalsh(body.inertia))
        for reference, part in parts:
            if np.allclose(inertias, reference, rtol=_EQUAL, atol=0.0):
                part.append(j)
                break
        else:
            parts.append((inertias, [j]))
    return [tuple(part) for _, part in parts]


def _name_groups(groups, names):
    labels = [_common_words([names[j] for j in joints]) for joints in groups]
    unique = [
        name if labels.count(name) == 1 else _join([names[j] for j in joints])
        for name, joints in zip(labels, groups)
    ]
    return tuple(zip(unique, groups))


def _common_words(names):
    words = [_WORDS.findall(name) for name in names]
    common = [w for w in words[0] if all(w in other for other in words)]
    kept = [w for w in common if w.lower() not in {"joint", *_SIDES}]
    return " ".join(kept or common) or _join(names)


def _join(names):
    return "/".join([*names[:2], "..."] if len(names) > 2 else names)


def _shared_values(groups, robot, std):
    """Return group, parameter and indices of the values that joints share."""
    # Only drive parameters that depend neither on direction nor on position. std (p,):
    # values without information, such as those of a joint at rest, are left out.
    features, joints = robot.features_, {}
    per_joint = features.n_parameters_ // features.n_joints_
    excluded = excluded_columns(features, robot.effects_)
    for j in range(features.n_joints_):
        for k, name in enumerate(features.friction_):
            index = j * per_joint + 10 + k
            if declared(name).alike and index not in excluded:
                joints.setdefault((name,), {})[j] = index
    for effect, span in effect_indices(robot.effects_, features.n_parameters_):
        for index, name in zip(span, effect.coefficients):
            if effect.alike:
                shape = tuple(sorted(effect.shape().items()))
                key = (f"{effect.name}:{name}", type(effect), shape)
                joints.setdefault(key, {})[effect.joint] = index
    values = []
    for name, alike in groups:
        for key, by_joint in joints.items():
            index = np.array([by_joint[j] for j in alike if j in by_joint], dtype=int)
            determined = np.isfinite(std[index]) & (std[index] > 0)
            index = index[determined]
            index = index[std[index] < _MAX_RATIO * std[index].min(initial=np.inf)]
            if index.size > 1:
                values.append((name, key[0], index))
    return values


@functools.cache
def _contrasts(n):
    """Return orthonormal contrasts of n values, (n - 1, n)."""
    return linalg.helmert(n)


@dataclass(frozen=True, eq=False)
class _AlikeProblem:
    """Estimates y with covariance S, in groups (`parts`) that share a mean."""

    # Each value is in units of the mean of its part, which has no prior.

    y: np.ndarray
    S: np.ndarray
    parts: tuple

    def precision(self, sites):
        """Return the prior precision (k, k) of all values with some sites."""
        precision = np.zeros(self.S.shape)
        for part, site in zip(self.parts, sites):
            root = _contrasts(part.size)
            precision[np.ix_(part, part)] += root.T @ site.precision @ root
        return precision

    def solve(self, sites):
        """Return the posterior mean and covariance of all values."""
        D = np.zeros((self.y.size - len(self.parts), self.y.size))
        V, targets, start = np.zeros((len(D), len(D))), [], 0
        for part, site in zip(self.parts, sites):
            rows = slice(start, start := start + part.size - 1)
            D[rows, part] = _contrasts(part.size)
            V[rows, rows] = np.linalg.inv(site.precision)
            targets.append(V[rows, rows] @ site.right)
        cross = self.S @ D.T
        gain = np.linalg.solve(D @ cross + V, cross.T).T
        covariance = self.S - gain @ cross.T
        mean = self.y + gain @ (np.concatenate(targets) - D @ self.y)
        return mean, 0.5 * (covariance + covariance.T)

    def sites(self):
        """Return the sites of the parts, see `propagate_sites`."""

        def marginals(sites):
            mean, covariance = self.solve(sites)
            for part in self.parts:
                root = _contrasts(part.size)
                inverse = floored_inverse(
                    root @ covariance[np.ix_(part, part)] @ root.T
                )
                yield inverse, inverse @ root @ mean[part]

        initial = [Site.of_scale(DESCRIBED, part.size - 1) for part in self.parts]
        return propagate_sites(initial, marginals)

    def centre(self, sites, mean):
        """Return the prior means (k,) of the sites around the means of the parts."""
        out = np.zeros(self.y.size)
        for part, site in zip(self.parts, sites):
            difference = np.linalg.solve(site.precision, site.right)
            out[part] = mean[part].mean() + _contrasts(part.size).T @ difference
        return out


def pool_joint_values(result, groups, robot):
    """Return an `Estimate` with partial pooling over joints of the same drive."""
    shared = _shared_values(groups, robot, result.marginal_std)
    if not shared:
        return result
    C, ratio = uninflated_covariance(result)
    wide, theta = C * np.outer(ratio, ratio), result.theta_unconstrained
    index = np.concatenate([indices for *_, indices in shared])
    ends = np.cumsum([indices.size for *_, indices in shared])
    parts = tuple(np.split(np.arange(index.size), ends[:-1]))
    # In units of the mean of their part, with covariance inflated as in `std`.
    unit = np.empty(index.size)
    for part in parts:
        # Magnitude of the generalised mean.
        inverse = floored_inverse(wide[np.ix_(index[part], index[part])])
        mean, total = inverse.sum(axis=0) @ theta[index[part]], inverse.sum()
        unit[part] = np.sqrt((mean / total) ** 2 + 1.0 / total)
    scale = ratio[index] / unit
    S = C[np.ix_(index, index)] * np.outer(scale, scale)
    problem = _AlikeProblem(theta[index] / unit, S, parts)
    sites = problem.sites()
    mean, covariance = problem.solve(sites)
    reduction = (S - covariance) / np.outer(scale, scale)
    precision = problem.precision(sites)
    pooled = with_prior(
        result,
        index,
        unit * (mean - problem.y),
        reduction,
        precision / np.outer(unit, unit),
        precision @ problem.centre(sites, mean) / unit,
    )
    labels = [robot.parameter_names_[i].partition(":")[0] for i in index]
    values = tuple(
        AlikeValue(
            group=group,
            parameter=parameter,
            joints=tuple(labels[i] for i in part),
            indices=tuple(index[part].tolist()),
            **_mean_and_scatter(mean[part], covariance[np.ix_(part, part)], unit[part]),
            unit=robot.parameter_units_[indices[0]],
        )
        for (group, parameter, indices), part in zip(shared, parts)
    )
    return replace(pooled, alike=values)


def _mean_and_scatter(y, S, unit):
    """Return the mean of values, its deviation, and their relative scatter."""
    n, mean, scale = y.size, y.mean(), unit[0]
    # Expected variance between the values, posterior covariance included.
    centring = np.eye(n) - 1.0 / n
    between = (y @ centring @ y + np.trace(centring @ S)) / max(n - 1, 1)
    std = np.sqrt(S.sum()) / n
    significant = abs(mean) > HALF_WIDTH * std
    return {
        "value": float(scale * mean),
        "std": float(scale * std),
        "scatter": float(np.sqrt(between) / abs(mean)) if significant else np.nan,
    }
