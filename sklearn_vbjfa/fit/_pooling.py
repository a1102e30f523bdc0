"""Pooling of parameters over joints with equal drives, and over recordings."""

import functools
import re
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core._groups import Groups
from sklearn_vbjfa._core._linear_systems import block_variance, scaled_eigen
from sklearn_vbjfa.effects import CommandDelay, InModel, OfTime, declared
from sklearn_vbjfa.equations._equations import excluded_columns
from sklearn_vbjfa.equations._joint_moments import weighted_parts
from sklearn_vbjfa.equations._plan import effect_indices
from sklearn_vbjfa.fit._bodies import DESCRIBED, Site, floored_inverse, propagate_sites
from sklearn_vbjfa.fit._estimate import (
    IDENTIFIABLE,
    noise_variance,
    uninflated_covariance,
    with_prior,
)
from sklearn_vbjfa.model import (
    is_prismatic,
    joint_names,
    nominal_parameters,
    solid_bodies,
)
from sklearn_vbjfa.robot._channels import HALF_WIDTH
from sklearn_vbjfa.robot._posterior import (
    BetweenRecordings,
    body_indices,
    covariance_inverse,
    effect_mask,
)

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


def alike_joints(identifier):
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


# Expected relative variation of drive parameters between recordings: scale of a
# half-Cauchy distribution, as for bodies. Grid of scales for integration; the largest
# covers values that scatter about zero.
_SHARE, _SCALES = DESCRIBED, np.geomspace(1e-4, 2.0, 61)
# Maximum passes over all values, and change of a log scale at convergence.
_MAX_PASSES, _MAX_CHANGE = 30, 0.02
# Minimum noise variance relative to the mean squared torque.
_MIN_NOISE = 1e-12
# Eigenvalues of a correlation matrix below this are rounding.
_ROUNDING = 1e-14


def between_recordings(result, robot):
    """Estimate the variance between recordings; None for fewer than two."""
    # result: `Estimate`, in which values in the model are corrections; robot: its
    # parameters are the values themselves.
    index, values = _varying_parameters(robot), robot.theta_
    moments, weight = result.moments, result.joint_weights
    if not moments.recordings or result.covariance is None:
        return None
    keys, grams, scores = weighted_parts(
        moments, moments.recordings, weight, result.theta
    )
    power = grams[:, index, index]
    index = index[(power > 0).sum(axis=0) > 1]
    # Separate draws of values of which only the sum is determined would change it.
    index = index[~np.isinf(robot.theta_std_[index])]
    if not index.size:
        return None
    noise = _noise_within(result, keys, grams, scores, index)
    # At least rounding, if torques are fitted exactly.
    noise = max(noise, _MIN_NOISE * (weight @ moments.yy) / moments.n[weight > 0].sum())
    if not noise > 0:
        return None
    prior = 0.0 if result.bodies is None else result.bodies.prior
    effects = _RecordingEffects(grams / noise, scores / noise, values, prior, index)
    # The fitted values err by a weighted mean of the deviations of the recordings.
    spread = np.sqrt(keys[:, 1].max() + effects.shares)
    size, weights = effects.unit * spread, effects.solve()
    return BetweenRecordings(
        count=1 if moments.blocks is None else grams.shape[0],
        places=index,
        size=size,
        weights=weights,
        scales=_SCALES,
    )


def _noise_within(result, keys, grams, scores, index):
    # Each recording has separate values, whose differences do not count as noise.
    moments, weight = result.moments, result.joint_weights
    selected = scores[:, index]
    inverse = [
        scaled_eigen(G[np.ix_(index, index)], IDENTIFIABLE).inverse() for G in grams
    ]
    explained = sum(s @ inv @ s for s, inv in zip(selected, inverse))
    rank = scaled_eigen(result.metric, IDENTIFIABLE).rank + (selected != 0).sum()
    noise = noise_variance(moments, weight, result.theta, rank, explained)
    if moments.blocks is None:
        # For stretches of one recording, inflation is that of the fit.
        return noise * max(result.pooled, 1.0)
    if not noise > 0:
        return noise
    labels, gram, score = weighted_parts(moments, moments.blocks, weight, result.theta)
    if set(labels[:, 0]) != set(keys[:, 0]):
        # Blocks are phases of a repeated motion, not parts of recordings.
        return noise * max(result.pooled, 1.0)
    gram, score = gram[:, index[:, None], index], score[:, index]
    total = count = 0.0
    for recording, s, inv in zip(keys[:, 0], selected, inverse):
        rows = labels[:, 0] == recording
        if rows.sum() > 1:
            remainder = score[rows] - gram[rows] @ (inv @ s)
            piece = np.arange(len(index)), gram[rows]
            ratio = block_variance([piece], remainder, labels[rows], noise).pooled
            total, count = total + ratio * (rows.sum() - 1), count + rows.sum() - 1
    return noise * max(total / count, 1.0) if count else noise


class _RecordingEffects:
    """Random effects of recordings on some parameters; all others are shared."""

    # y_r = Phi_r (theta + E u_r) + noise, independent u_rk ~ N(0, s_k^2), half-Cauchy
    # s_k relative to the value. With all other scales fixed, the evidence of s_k is
    # that of a group of columns, one for each recording.

    def __init__(self, grams, scores, values, prior, index):
        self._inner = grams[:, index[:, None], index]
        self._cross = grams[:, index]
        self._scores, self._right = scores, scores[:, index]
        self._total = grams.sum(axis=0) + prior
        power = np.diagonal(self._inner, axis1=1, axis2=2)
        # (k,): magnitude of the values; that of their scatter for values near zero
        with np.errstate(divide="ignore", invalid="ignore"):
            squares = np.where(power > 0, self._right**2 / power, 0.0).sum(axis=0)
        excess = np.maximum(squares - (power > 0).sum(axis=0), 1.0)
        scatter = excess / power.sum(axis=0)
        self.unit = np.sqrt(values[index] ** 2 + scatter / _SHARE**2)
        self._power = power
        # (k,): sum of squared weights of the recordings in the fitted values
        inverse = scaled_eigen(self._total, _ROUNDING).inverse()[index]
        self.shares = (np.einsum("kp,rkp->rk", inverse, self._cross) ** 2).sum(axis=0)

    def solve(self):
        """Return the posterior probabilities (m, k) of the scales."""
        typical = _SHARE * self.unit
        for _ in range(_MAX_PASSES):
            weights = self._groups(typical).posterior(_SHARE, _SCALES)
            new = np.exp(np.log(_SCALES) @ weights) * self.unit
            change = np.abs(np.log(new / typical)).max()
            typical = new
            if change < _MAX_CHANGE:
                break
        return weights

    def _groups(self, typical):
        # In units of the scales no eigenvalue of the posterior precision is below one.
        units = np.outer(typical, typical)
        values, vectors = np.linalg.eigh(self._inner * units)
        shares = vectors / (1.0 + np.maximum(values, 0.0))[:, None, :]
        inner = shares @ vectors.transpose(0, 2, 1) * units
        gain = inner @ self._cross
        schur = self._total - np.tensordot(self._cross, gain, ((0, 1), (0, 1)))
        eigen = scaled_eigen(0.5 * (schur + schur.T), _ROUNDING)
        # The change of theta, with the random effects eliminated.
        score = self._scores.sum(axis=0) - np.einsum("rkp,rk->p", gain, self._right)
        separate = (inner @ self._right[:, :, None])[:, :, 0]
        mean = separate - gain @ eigen.solve(score)
        root = gain @ eigen.inverse_root()
        H, q = [], []
        for k, scale in enumerate(typical):
            covariance = root[:, k] @ root[:, k].T + np.diag(inner[:, k, k])
            # Likelihood alone: subtract the prior, in units of the scale.
            inverse = covariance_inverse(covariance / scale**2)
            H.append((inverse - np.eye(inverse.shape[0])) / scale**2)
            q.append(inverse @ mean[:, k] / scale**2)
        unit = np.tile(self.unit[:, None], self._power.shape[0])
        return Groups(H=np.array(H), q=np.array(q), own=self._power.T, unit=unit)


def _varying_parameters(robot):
    """Return parameters (k,) that may vary between recordings of the same robot."""

    # Not bodies and geometry, nor effects of time, which model their variation.
    def excluded(effect):
        return isinstance(effect, OfTime) or (
            isinstance(effect, InModel) and effect.of_bodies
        )

    varying = ~effect_mask(robot, excluded)
    varying[body_indices(robot)] = False
    return np.flatnonzero(varying)
