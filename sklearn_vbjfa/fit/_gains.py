"""Unknown gains of several torque channels, relative to one of them."""

# The channel of joint j reads y_j = g_j Phi_j theta. Joints share the bodies that they
# move: ratios of gains follow from these couplings; a common factor is absorbed by
# theta. Least squares for the inverse gains is biased by torque noise: instead,
# Gauss-Newton steps maximise the likelihood over the log gains, from second moments.

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from sklearn.base import clone

from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa.effects import Payload, TorqueGain
from sklearn_vbjfa.equations._plan import effect_indices
from sklearn_vbjfa.fit._estimate import IDENTIFIABLE, NULL_SHARE, noise_weights
from sklearn_vbjfa.model._trees import body_names
from sklearn_vbjfa.robot._channels import HALF_WIDTH, LIMIT, CommonGain

# Standard deviation of the logarithm of an unknown gain.
_UNKNOWN_STD = np.log(1e4)
# Maximum number and size of Gauss-Newton steps, and of halvings in the line search.
_MAX_STEPS = 60
_MAX_STEP = np.log(3.0)
_MAX_HALVINGS = 6
# Increase of the log likelihood at convergence.
_TOLERANCE = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class RelativeGains:
    """Relative gains of torque channels, from the moments of a recording."""

    # (nv,): relative to the reference; 1 if not identifiable
    gains: np.ndarray
    # (nv,): joint whose channel is the unit of each: itself for a reference, and for a
    # joint whose gain is not identifiable relative to any other
    reference: np.ndarray

    @property
    def fixed(self):
        """Joints (nv,), bool, whose gain is fixed."""
        return self.reference == np.arange(self.reference.size)

    def vague(self, gains, std):
        """Return the joints (nv,), bool, whose fitted gain is not identifiable."""
        return ~self.fixed & ~(HALF_WIDTH * std < np.log(LIMIT) * gains)

    @property
    def references(self):
        """Reference joints of at least one other joint, a sorted list of int."""
        return np.unique(self.reference[~self.fixed]).tolist()


def relative_gains(moments, references=()):
    # moments: JointMoments; references: joints to use as references of their groups;
    # other groups choose one, see `_assign_references`.
    used = np.flatnonzero((moments.n > 0) & (moments.yy > 0))
    nv = moments.n.size
    logs, optimum = _maximise_likelihood(moments, used)
    variances, strength = np.full((nv, nv), np.inf), np.zeros(nv)
    if used.size:
        variances[np.ix_(used, used)] = _ratio_variances(optimum)
        strength[used] = optimum.size
    reference = _assign_references(variances, strength, references)
    return RelativeGains(gains=np.exp(logs - logs[reference]), reference=reference)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Likelihood:
    """Profile likelihood of the log gains of k joints, all else at its maximum."""

    cost: float  # minus its logarithm, up to a constant
    score: np.ndarray  # (k,): gradient of the log likelihood
    information: np.ndarray  # (k, k): Fisher's
    # (k,): its diagonal with all other parameters known: (torque over noise)^2
    size: np.ndarray

    @classmethod
    def at(cls, moments, logs, used):
        """Evaluate the likelihood at log gains (nv,) of joints `used`."""
        gains = np.exp(logs)
        scaled = replace(
            moments,
            G=tuple((at, x**2 * gram) for x, (at, gram) in zip(gains, moments.G)),
            g=moments.g * gains[:, None],
            noise=None,
            blocks=None,
        )
        weight = noise_weights(scaled)
        total = scaled.total(weight)
        metric = scaled_eigen(total.S_xx, IDENTIFIABLE)
        theta = metric.solve(total.S_xy)
        torque = np.zeros(scaled.g.shape)
        for row, (at, gram) in zip(torque, scaled.G):
            row[at] = gram @ theta[at]
        torque = (weight[:, None] * torque)[used]
        size = torque @ theta
        residual = scaled.residual_squares(theta)[used] / scaled.yy[used]
        information = np.diag(size) - torque @ metric.solve(torque.T)
        return cls(
            cost=float(0.5 * scaled.n_rows[used] @ np.log(residual)),
            score=weight[used] * (scaled.g[used] @ theta) - size,
            information=0.5 * (information + information.T),
            size=size,
        )


def _maximise_likelihood(moments, used):
    """Return the log gains (nv,) of maximum likelihood, and the `_Likelihood` there."""
    # A weak prior sets gains that are not identifiable to the mean of the others. Both
    # begin at channels of equal size: a start with other units may not converge.
    logs, k = np.zeros(moments.n.size), used.size
    logs[used] = start = 0.5 * np.log(moments.yy[used] / moments.n[used])
    prior = (np.eye(k) - 1.0 / max(k, 1)) / np.log(LIMIT) ** 2
    best = _Likelihood.at(moments, logs, used)
    for _ in range(_MAX_STEPS if k else 0):
        x = logs[used] - start
        cost = best.cost + 0.5 * x @ prior @ x
        # The likelihood is invariant to a common factor: take the minimum-norm step.
        step = linalg.pinvh(best.information + prior) @ (best.score - prior @ x)
        step -= step.mean()
        step /= max(np.abs(step).max() / _MAX_STEP, 1.0)
        for halving in range(_MAX_HALVINGS):
            trial = x + 0.5**halving * step
            trial_logs = logs.copy()
            trial_logs[used] = start + trial
            new = _Likelihood.at(moments, trial_logs, used)
            gain = cost - new.cost - 0.5 * trial @ prior @ trial
            if gain > 0:
                logs, best = trial_logs, new
                break
        if gain < _TOLERANCE:
            break
    return logs, best


def _ratio_variances(optimum):
    """Return variances (k, k) of log gain ratios; large if not identifiable."""
    scale = np.sqrt(optimum.size)
    eigen = scaled_eigen(optimum.information, IDENTIFIABLE, scale=scale, relative=False)
    values = np.where(eigen.known, eigen.values, 1.0)
    variance = np.where(eigen.known, 1.0 / values, (_UNKNOWN_STD * scale.max()) ** 2)
    roots = eigen.vectors / scale[:, None] * np.sqrt(variance)
    return ((roots[:, None] - roots) ** 2).sum(axis=2)


def _assign_references(variances, strength, references):
    """Choose each joint's reference (nv,) from the variances of ratios (nv, nv)."""
    # Joints are in one group if their ratio is known better than the plausible range.
    # The reference minimises the sum of the variances of the others; of several, it has
    # the largest torque over noise (`strength`).
    nv = strength.size
    with np.errstate(invalid="ignore"):
        related = HALF_WIDTH * np.sqrt(variances) < np.log(LIMIT)
    related |= np.eye(nv, dtype=bool)
    reference = np.arange(nv)
    remaining = set(range(nv))
    while remaining:
        group, front = set(), {min(remaining)}
        while front:
            group |= front
            neighbours = related[sorted(front)].any(axis=0)
            front = set(np.flatnonzero(neighbours).tolist()) - group
        remaining -= group
        members = np.array(sorted(group))
        chosen = [j for j in members if j in references]
        if not chosen:
            sums = variances[np.ix_(members, members)]
            sums = np.where(np.eye(members.size, dtype=bool), 0.0, sums).sum(axis=0)
            best = members[sums <= sums.min() * (1 + 1e-6)]
            chosen = [best[np.argmax(strength[best])]]
        reference[members] = chosen[0]
    return reference


def declared_gains(effects, nv):
    """Return effects with a gain of 1 on every channel; added gains come first."""
    used = {e.joint for e in effects if isinstance(e, TorqueGain)}
    added = [TorqueGain(joint=j) for j in range(nv) if j not in used]
    return with_gains((*added, *effects), np.ones(nv))


def with_gains(effects, gains):
    """Return the effects with these gains (nv,) of the channels, without limits."""
    return tuple(
        clone(e).set_params(gain=float(gains[e.joint]), limit=None)
        if isinstance(e, TorqueGain)
        else e
        for e in effects
    )


def gain_indices(effects, n_rigid):
    """Return the indices of the gains of all joints among the parameters."""
    spans = effect_indices(effects, n_rigid)
    gains = {e.joint: at.start for e, at in spans if isinstance(e, TorqueGain)}
    return np.array([gains[joint] for joint in sorted(gains)], dtype=int)


def check_gains(gains, joint_names):
    """Reject invalid references, and a single joint, whose gain is unidentifiable."""
    names = () if isinstance(gains, str) else gains
    if gains != "unknown" and not (names and set(names) <= set(joint_names)):
        raise ValueError(
            f"gains is {gains!r}; expected None, 'unknown', or names of joints whose "
            f"channels are units, of {', '.join(joint_names)}."
        )
    if len(joint_names) == 1:
        raise ValueError(
            "gains='unknown' needs several joints that move the same bodies: the gain "
            f"of {joint_names[0]} alone is not identifiable."
        )


PAYLOAD = "payload"


def check_masses(masses, gains, model):
    """Return known masses as a dict; reject invalid names and values."""
    # masses: dict of str to float [kg]; gains: parameter of the identifier.
    if gains is None:
        raise ValueError(
            "known_masses fixes the common gain of all torque channels and needs "
            "gains='unknown'; got gains=None."
        )
    names = (*body_names(model), PAYLOAD)
    for name, mass in masses.items():
        if name not in names:
            raise ValueError(
                f"known_masses names {name!r}; expected one of {', '.join(names)}."
            )
        if not (np.isscalar(mass) and np.isfinite(mass) and mass > 0):
            raise ValueError(
                f"known_masses must hold positive masses [kg]; got {mass!r} for {name}."
            )
    return {name: float(mass) for name, mass in masses.items()}


def _locate_masses(masses, robot):
    """Return name, mass and parameter index of each known mass, a list."""
    # A payload that is picked up and put down occurs twice.
    features, located = robot.features_, []
    bodies, width = body_names(features.model_), features.n_parameters_
    for name, mass in masses.items():
        if name in bodies:
            located.append((name, mass, bodies.index(name) * (width // len(bodies))))
    for effect, at in effect_indices(robot.effects_, width):
        if isinstance(effect, Payload) and PAYLOAD in masses:
            located.append((PAYLOAD, masses[PAYLOAD], at.start))
    return located


def common_gain(masses, robot, relative, estimate):
    # Returns a `CommonGain`, and the covariance (p,) of its factor with the parameters,
    # or None if it is not identifiable. Each identifiable sum of known masses is one
    # equation. masses: dict of str to float; estimate: `PlainEstimate` with the gains.
    nothing, theta = (CommonGain(masses=masses), None), robot.theta_
    located = _locate_masses(masses, robot)
    # Several groups of joints have no common factor.
    if not located or len(relative.references) != 1:
        return nothing
    names, expected, i = (np.array(x) for x in zip(*located))
    # A payload that is put down changes the mass by minus its value.
    sign = np.where(names == PAYLOAD, np.sign(theta[i]), 1.0)
    covariance = estimate.covariance[np.ix_(i, i)] * np.outer(sign, sign)
    # Identifiable sums have no component in the null space.
    null_part = estimate.eigen.null_space[i]
    values, vectors = linalg.eigh(null_part @ null_part.T)
    sums = vectors[:, values <= NULL_SHARE] * (estimate.eigen.scale[i] * sign)[:, None]
    if not sums.size:
        return nothing
    y, x = expected @ sums, (theta[i] * sign) @ sums
    inverse = linalg.pinvh(sums.T @ covariance @ sums)
    information = float(y @ inverse @ y)
    if not information > 0:
        return nothing
    weight = inverse @ y / information
    factor, std = float(weight @ x), 1.0 / np.sqrt(information)
    # A mass not significantly above zero cannot determine the factor.
    if not factor > HALF_WIDTH * std:
        return nothing
    common = CommonGain(factor=factor, std=std, masses=masses)
    return common, estimate.covariance[:, i] @ (sums @ weight * sign)
