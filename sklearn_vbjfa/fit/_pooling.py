"""Parameters that joints of the same drive share, or that recordings differ in."""

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
    body_places,
    covariance_inverse,
    of_effects,
)

# What tells one leg, arm or finger from another in the names of joints, beside numbers.
_SIDES = frozenset(
    "l r left right fl fr rl rr hl hr bl br lf rf lh rh lr rm lm ml mr lb rb "
    "front rear back hind mid middle".split()
)
_WORDS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")
# What is known so many times worse than the same value of another joint is not told.
_SILENT = 1e6
# Masses and moments of inertia that are equal but for the digits of a description.
_EQUAL = 1e-4


@dataclass(frozen=True, kw_only=True)
class AlikeValue:
    """A value that joints have in common, but for some scatter."""

    group: str  # what the joints are called
    parameter: str  # such as "rotor_inertia"
    joints: tuple[str, ...]  # that share the value
    places: tuple[int, ...]  # where their values are in `RobotIdentifier.theta_`
    value: float  # mean of the joints
    std: float  # standard deviation of that mean
    unit: str
    # standard deviation between the joints, as a share of the mean; nan where the mean
    # may as well be zero
    scatter: float

    def at(self, theta):
        """Return the value with the mean of the fitted parameters (p,)."""
        return replace(self, value=float(theta[list(self.places)].mean()))


# -- which joints ----------------------------------------------------------------------


def alike_joints(settings):
    """Return the groups of joints with the same drive, pairs of name and joints."""
    alike = settings.fit_options.alike
    if alike not in ("auto", None):
        raise ValueError(f"alike must be 'auto' or None; got {alike!r}.")
    # Channels with unknown factors are not compared, and a regressor is on its own.
    apart = settings.asked_gains is not None or settings.regressor is not None
    return () if alike is None or apart else _found(settings.features_.nominal_)


def _found(model):
    """Return groups whose names differ in leg or number alone, of equal bodies."""
    names, slides = joint_names(model), is_prismatic(model)
    solid = solid_bodies(nominal_parameters(model))
    groups = {}
    for j in np.flatnonzero(solid):
        words = [word.lower() for word in _WORDS.findall(names[j])]
        key = tuple("" if w in _SIDES or w.isdigit() else w for w in words)
        if "" in key:
            groups.setdefault((key, bool(slides[j])), []).append(int(j))
    equal = [part for own in groups.values() for part in _equal(own, model)]
    # Drives of a chain, in which joints carry others, differ in size.
    carried = [{i - 1 for i in list(s)[:-1]} for s in list(model.supports)[1:]]
    equal = [own for own in equal if not any(carried[k] & {*own} for k in own)]
    return _named([own for own in equal if len(own) > 1], names)


def _equal(joints, model):
    """Split joints into those whose bodies have the same mass and inertias."""
    parts = []
    for j in joints:
        body = model.inertias[j + 1]
        own = np.append(body.mass, np.linalg.eigvalsh(body.inertia))
        for first, part in parts:
            if np.allclose(own, first, rtol=_EQUAL, atol=0.0):
                part.append(j)
                break
        else:
            parts.append((own, [j]))
    return [tuple(part) for _, part in parts]


def _named(groups, names):
    called = [_common([names[j] for j in joints]) for joints in groups]
    return tuple(
        (
            name if called.count(name) == 1 else _listed([names[j] for j in joints]),
            joints,
        )
        for name, joints in zip(called, groups)
    )


def _common(names):
    words = [_WORDS.findall(name) for name in names]
    common = [w for w in words[0] if all(w in other for other in words)]
    kept = [w for w in common if w.lower() not in {"joint", *_SIDES}]
    return " ".join(kept or common) or _listed(names)


def _listed(names):
    return "/".join([*names[:2], "..."] if len(names) > 2 else names)


# -- which values ----------------------------------------------------------------------


def _shared_values(groups, robot, std):
    """Values of alike joints: group, parameter, and where it is joint by joint."""
    # Those of drives, which have neither sign nor place.
    # Without those of which deviations (p,) say that nothing tells: what a joint stood
    # still for is not shared.
    features, joints = robot.features_, {}
    per_joint = features.n_parameters_ // features.n_joints_
    held = excluded_columns(features, robot.effects_)
    for j in range(features.n_joints_):
        for k, name in enumerate(features.friction_):
            place = j * per_joint + 10 + k
            if declared(name).alike and place not in held:
                joints.setdefault((name,), {})[j] = place
    for effect, at in effect_indices(robot.effects_, features.n_parameters_):
        for place, name in zip(at, effect.coefficients):
            if effect.alike:
                shape = tuple(sorted(effect.shape().items()))
                key = (f"{effect.name}:{name}", type(effect), shape)
                joints.setdefault(key, {})[effect.joint] = place
    found = []
    for name, alike in groups:
        for key, places in joints.items():
            own = np.array([places[j] for j in alike if j in places], dtype=int)
            known = np.isfinite(std[own]) & (std[own] > 0)
            own = own[known]
            own = own[std[own] < _SILENT * std[own].min(initial=np.inf)]
            if own.size > 1:
                found.append((name, key[0], own))
    return found


# -- their estimate --------------------------------------------------------------------


@functools.cache
def _contrasts(n):
    """Orthonormal differences between n values, (n - 1, n)."""
    return linalg.helmert(n)


@dataclass(frozen=True, eq=False)
class _AlikeProblem:
    """Values as the data tell them one by one, y and S, in parts that are alike."""

    # Each value is in units of the mean of its part, which is free.

    y: np.ndarray
    S: np.ndarray
    parts: tuple

    def precision(self, sites):
        """Precision (k, k) that sites say of all values."""
        precision = np.zeros(self.S.shape)
        for part, site in zip(self.parts, sites):
            root = _contrasts(part.size)
            precision[np.ix_(part, part)] += root.T @ site.precision @ root
        return precision

    def solve(self, sites):
        """Mean and covariance of all values."""
        root = np.zeros((self.y.size - len(self.parts), self.y.size))
        spread, aim, at = np.zeros((len(root), len(root))), [], 0
        for part, site in zip(self.parts, sites):
            rows = slice(at, at := at + part.size - 1)
            root[rows, part] = _contrasts(part.size)
            spread[rows, rows] = np.linalg.inv(site.precision)
            aim.append(spread[rows, rows] @ site.right)
        across = self.S @ root.T
        gain = np.linalg.solve(root @ across + spread, across.T).T
        covariance = self.S - gain @ across.T
        mean = self.y + gain @ (np.concatenate(aim) - root @ self.y)
        return mean, 0.5 * (covariance + covariance.T)

    def sites(self):
        """Sites of the parts, see `propagate_sites`."""

        def marginals(sites):
            mean, covariance = self.solve(sites)
            for part in self.parts:
                root = _contrasts(part.size)
                inverse = floored_inverse(
                    root @ covariance[np.ix_(part, part)] @ root.T
                )
                yield inverse, inverse @ root @ mean[part]

        usual = [Site.of_scale(DESCRIBED, part.size - 1) for part in self.parts]
        return propagate_sites(usual, marginals)

    def centre(self, sites, mean):
        """Values (k,) that sites have for the most probable ones, at some means."""
        out = np.zeros(self.y.size)
        for part, site in zip(self.parts, sites):
            away = np.linalg.solve(site.precision, site.right)
            out[part] = mean[part].mean() + _contrasts(part.size).T @ away
        return out


def _unit(y, S):
    """Size of the mean that values of a covariance have if they are equal."""
    inverse = floored_inverse(S)
    total = inverse.sum()
    return np.sqrt((inverse.sum(axis=0) @ y / total) ** 2 + 1.0 / total)


def beside_each_other(found, groups, robot):
    """Return an `Estimate` in which values of alike joints are near each other."""
    shared = _shared_values(groups, robot, found.std)
    if not shared:
        return found
    C, ratio = uninflated_covariance(found)
    wide, theta = C * np.outer(ratio, ratio), found.theta_unconstrained
    at = np.concatenate([places for *_, places in shared])
    ends = np.cumsum([places.size for *_, places in shared])
    parts = tuple(np.split(np.arange(at.size), ends[:-1]))
    # In units of the mean of their part, as well known as their deviations say.
    unit = np.empty(at.size)
    for part in parts:
        unit[part] = _unit(theta[at[part]], wide[np.ix_(at[part], at[part])])
    scale = ratio[at] / unit
    S = C[np.ix_(at, at)] * np.outer(scale, scale)
    problem = _AlikeProblem(theta[at] / unit, S, parts)
    sites = problem.sites()
    mean, covariance = problem.solve(sites)
    less = (S - covariance) / np.outer(scale, scale)
    precision = problem.precision(sites)
    beside = with_prior(
        found,
        at,
        unit * (mean - problem.y),
        less,
        precision / np.outer(unit, unit),
        precision @ problem.centre(sites, mean) / unit,
    )
    labels = [robot.parameter_names_[i].partition(":")[0] for i in at]
    values = tuple(
        AlikeValue(
            group=group,
            parameter=parameter,
            joints=tuple(labels[i] for i in part),
            places=tuple(at[part].tolist()),
            **_spread(mean[part], covariance[np.ix_(part, part)], unit[part]),
            unit=robot.parameter_units_[places[0]],
        )
        for (group, parameter, places), part in zip(shared, parts)
    )
    return replace(beside, alike=values)


def _spread(y, S, unit):
    """Mean of values, its deviation, and what they scatter by as a share of it."""
    n = y.size
    mean, size = y.mean(), unit[0]
    # Expected variance between them: of their means, and of what is not known.
    about = np.eye(n) - 1.0 / n
    between = (y @ about @ y + np.trace(about @ S)) / max(n - 1, 1)
    std = np.sqrt(S.sum()) / n
    significant = abs(mean) > HALF_WIDTH * std
    return {
        "value": float(size * mean),
        "std": float(size * std),
        "scatter": float(np.sqrt(between) / abs(mean)) if significant else np.nan,
    }


# Standard deviation of the logarithm of a rotor inertia around its reference: a factor
# of two, as descriptions differ from what is measured.
WIDTH = np.log(2.0)
# A rotor inertia below this many deviations may be zero by the torques alone.
_CERTAIN = 2.0
# Newton's method, each step of which leaves at least a quarter of the value.
_STEPS, _SHRINK, _TOLERANCE = 50, 0.25, 1e-9


def with_positive_rotors(found, robot):
    """Return an `Estimate` whose rotor inertias are near their references."""
    at, references = _references(found, robot)
    if not at.size or found.covariance is None:
        return found
    C, ratio = uninflated_covariance(found)
    seen = np.isfinite(found.std[at]) & (np.diagonal(C)[at] > 0)
    at, references = at[seen], references[seen]
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
        if (moved <= _TOLERANCE * x).all():
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


# -- variance between recordings, by their moments -------------------------------------

# How far values of a drive are expected to be off from one recording to another, as a
# share of the value: half-Cauchy, as descriptions are around bodies. Scales that are
# summed over, the largest that of a value that scatters about nothing.
_SHARE, _SCALES = DESCRIBED, np.geomspace(1e-4, 2.0, 61)
# Passes over all values, and the change of a logarithm of a scale that ends them.
_MAX_PASSES, _MAX_CHANGE = 30, 0.02
# Least noise of a fit, as a share of the mean squared torque.
_EXACT = 1e-12
# Eigenvalues of a correlation below this are rounding.
_ROUNDING = 1e-14


def between_recordings(found, robot):
    """Estimate it from the moments of recordings; None where there are not two."""
    # found: `Estimate`, in which a value in the model is the correction to it; robot:
    # its parameters are the sizes of the values.
    places, values = _places(robot), robot.theta_
    stats, weight = found.moments, found.joint_weights
    if not stats.recordings or found.covariance is None:
        return None
    keys, grams, scores = weighted_parts(stats, stats.recordings, weight, found.theta)
    power = grams[:, places, places]
    places = places[(power > 0).sum(axis=0) > 1]
    if not places.size:
        return None
    noise = _noise_within(found, keys, grams, scores, places)
    # Not less than rounding, of torques that are fitted exactly.
    noise = max(noise, _EXACT * (weight @ stats.yy) / stats.n[weight > 0].sum())
    if not noise > 0:
        return None
    prior = 0.0 if found.bodies is None else found.bodies.prior
    effects = _RecordingEffects(grams / noise, scores / noise, values, prior, places)
    # The values that were fitted are off, too: by a mean of those of recordings.
    spread = np.sqrt(keys[:, 1].max() + effects.shares)
    size, weights = effects.unit * spread, effects.solve()
    return BetweenRecordings(
        count=1 if stats.blocks is None else grams.shape[0],
        places=places,
        size=size,
        weights=weights,
        scales=_SCALES,
    )


def _noise_within(found, keys, grams, scores, places):
    # With values of their own in all recordings: what they differ by is no noise.
    stats, weight = found.moments, found.joint_weights
    own = scores[:, places]
    inverse = [
        scaled_eigen(G[np.ix_(places, places)], IDENTIFIABLE).inverse() for G in grams
    ]
    taken = sum(s @ inner @ s for s, inner in zip(own, inverse))
    rank = scaled_eigen(found.metric, IDENTIFIABLE).rank + (own != 0).sum()
    noise = noise_variance(stats, weight, found.theta, rank, taken)
    if stats.blocks is None:
        # Of stretches the scatter in time is that of the fit.
        return noise * max(found.pooled, 1.0)
    if not noise > 0:
        return noise
    place, inner, each = weighted_parts(stats, stats.blocks, weight, found.theta)
    if set(place[:, 0]) != set(keys[:, 0]):
        # Blocks are phases of one motion, in which recordings are alike.
        return noise * max(found.pooled, 1.0)
    inner, each = inner[:, places[:, None], places], each[:, places]
    total = counted = 0.0
    for number, s, back in zip(keys[:, 0], own, inverse):
        rows = place[:, 0] == number
        if rows.sum() > 1:
            left = each[rows] - inner[rows] @ (back @ s)
            part = np.arange(len(places)), inner[rows]
            share = block_variance([part], left, place[rows], noise).pooled
            total, counted = total + share * (rows.sum() - 1), counted + rows.sum() - 1
    return noise * max(total / counted, 1.0) if counted else noise


class _RecordingEffects:
    """Random effects of recordings on some parameters, everything else shared."""

    # With y_r = Phi_r (theta + E u_r) + noise and independent u_rk ~ N(0, s_k^2), where
    # s_k is half-Cauchy around a share of the value. For the others as last estimated
    # the evidence of each s_k is that of a group of columns, one for each recording.

    def __init__(self, grams, scores, values, prior, places):
        self._inner = grams[:, places[:, None], places]
        self._cross = grams[:, places]
        self._scores, self._own = scores, scores[:, places]
        self._total = grams.sum(axis=0) + prior
        power = np.diagonal(self._inner, axis1=1, axis2=2)
        # (k,): size of the values; of those about nothing, that of their scatter
        with np.errstate(divide="ignore", invalid="ignore"):
            squares = np.where(power > 0, self._own**2 / power, 0.0).sum(axis=0)
        beyond = np.maximum(squares - (power > 0).sum(axis=0), 1.0)
        scatter = beyond / power.sum(axis=0)
        self.unit = np.sqrt(values[places] ** 2 + scatter / _SHARE**2)
        self._power = power
        # (k,): sums of the squared shares of recordings in the values that were fitted
        inverse = scaled_eigen(self._total, _ROUNDING).inverse()[places]
        self.shares = (np.einsum("kp,rkp->rk", inverse, self._cross) ** 2).sum(axis=0)

    def solve(self):
        """Return the probabilities (m, k) of scales."""
        typical = _SHARE * self.unit
        for _ in range(_MAX_PASSES):
            weights = self._groups(typical).posterior(_SHARE, _SCALES)
            new = np.exp(np.log(_SCALES) @ weights) * self.unit
            moved = np.abs(np.log(new / typical)).max()
            typical = new
            if moved < _MAX_CHANGE:
                break
        return weights

    def _groups(self, typical):
        # in units of the scales, where no eigenvalue of the sum with the prior is below
        # one, however large the others are
        both = np.outer(typical, typical)
        values, vectors = np.linalg.eigh(self._inner * both)
        shares = vectors / (1.0 + np.maximum(values, 0.0))[:, None, :]
        own = shares @ vectors.transpose(0, 2, 1) * both
        gain = own @ self._cross
        rest = self._total - np.tensordot(self._cross, gain, ((0, 1), (0, 1)))
        shared = scaled_eigen(0.5 * (rest + rest.T), _ROUNDING)
        # theta moves as well, by what the effects leave of the scores
        moved = self._scores.sum(axis=0) - np.einsum("rkp,rk->p", gain, self._own)
        alone = (own @ self._own[:, :, None])[:, :, 0]
        mean = alone - gain @ shared.solve(moved)
        root = gain @ shared.inverse_root()
        H, q = [], []
        for k, scale in enumerate(typical):
            covariance = root[:, k] @ root[:, k].T + np.diag(own[:, k, k])
            # in units of the scale, of which the prior itself is taken out
            inverse = covariance_inverse(covariance / scale**2)
            H.append((inverse - np.eye(inverse.shape[0])) / scale**2)
            q.append(inverse @ mean[:, k] / scale**2)
        unit = np.tile(self.unit[:, None], self._power.shape[0])
        return Groups(H=np.array(H), q=np.array(q), own=self._power.T, unit=unit)


def _places(robot):
    """Parameters that may differ between recordings of the same robot, (k,)."""

    # Values of drives. Bodies do not, nor what may stand for them, and effects of time
    # say themselves how they do.
    def stays(effect):
        return isinstance(effect, OfTime) or (
            isinstance(effect, InModel) and effect.of_bodies
        )

    rest = ~of_effects(robot, stays)
    rest[body_places(robot)] = False
    return np.flatnonzero(rest)
