"""Unknown gains of several torque channels, relative to one of them."""

# The channel of joint j reads y_j = g_j Phi_j theta. Joints share the bodies that they
# move: the ratios of the gains are in their couplings, the common factor is in theta
# and in no recording. Least squares for the inverse gains takes noise of the torques
# for signal: the likelihood is maximised over the logarithms of the gains by Gauss and
# Newton, from the second moments of the joints' equations.

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa.effects import Payload, TorqueGain
from sklearn_vbjfa.equations._plan import effect_indices
from sklearn_vbjfa.fit._estimate import IDENTIFIABLE, LOST, noise_weights
from sklearn_vbjfa.model._trees import body_names
from sklearn_vbjfa.robot._channels import HALF_WIDTH, LIMIT, CommonGain

# ... so that two of them differ by its square at most.
_WIDEST = LIMIT**2
# Standard deviation of the logarithm of a gain about which nothing is known.
_UNKNOWN = np.log(1e4)
# Steps to the gains, the largest of them, and halvings of one that does harm.
_STEPS = 60
_STEP = np.log(3.0)
_HALVINGS = 6
# The logarithm of the likelihood is at its maximum where a step adds less.
_SETTLED = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class RelativeGains:
    """Gains of torque channels as the moments of a recording show them."""

    # (nv,): relative to that of the reference; 1 where they are not seen
    gains: np.ndarray
    # (nv,): joint whose channel is the unit of each: itself for a reference, and for a
    # joint whose gain is not seen relative to any other
    reference: np.ndarray

    @property
    def held(self):
        """Joints (nv,), bool, whose gain is fixed."""
        return self.reference == np.arange(self.reference.size)

    @property
    def references(self):
        """Joints whose channels are the units of others, a sorted list of int."""
        return np.unique(self.reference[~self.held]).tolist()


def relative_gains(moments, references=()):
    # moments: JointMoments; references: joints whose channels are to be the units, for
    # groups of joints in which one of them is; the others' are chosen, see `_grouped`.
    used = np.flatnonzero((moments.n > 0) & (moments.yy > 0))
    nv = moments.n.size
    logs, found = _most_likely(moments, used)
    spread, strength = np.full((nv, nv), np.inf), np.zeros(nv)
    if used.size:
        spread[np.ix_(used, used)] = _spread(found)
        strength[used] = found.size
    reference = _grouped(spread, strength, references)
    own = np.exp(logs - logs[reference])
    return RelativeGains(
        gains=np.clip(own, 1.01 / _WIDEST, 0.99 * _WIDEST), reference=reference
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Likelihood:
    """Likelihood of logarithms of gains of k joints, everything else fitted."""

    cost: float  # minus its logarithm, up to a constant
    score: np.ndarray  # (k,): slope of the logarithm
    information: np.ndarray  # (k, k): Fisher's
    # (k,): its diagonal where nothing else has to be fitted: (torque over noise)^2
    size: np.ndarray

    @classmethod
    def at(cls, moments, logs, used):
        """Evaluate it at logarithms (nv,), for joints `used`, from `JointMoments`."""
        gains = np.exp(logs)
        read = replace(
            moments,
            G=tuple((at, x**2 * one) for x, (at, one) in zip(gains, moments.G)),
            g=moments.g * gains[:, None],
            noise=None,
            blocks=None,
        )
        weight = noise_weights(read)
        total = read.total(weight)
        metric = scaled_eigen(total.S_xx, IDENTIFIABLE)
        theta = metric.solve(total.S_xy)
        torque = np.zeros(read.g.shape)
        for own, (at, one) in zip(torque, read.G):
            own[at] = one @ theta[at]
        torque = (weight[:, None] * torque)[used]
        size = torque @ theta
        rest = read.residual_squares(theta)[used] / read.yy[used]
        left = np.diag(size) - torque @ metric.solve(torque.T)
        return cls(
            cost=float(0.5 * read.n_rows[used] @ np.log(rest)),
            score=weight[used] * (read.g[used] @ theta) - size,
            information=0.5 * (left + left.T),
            size=size,
        )


def _most_likely(moments, used):
    """Return the most likely logarithms of gains (nv,), and the `_Likelihood` there."""
    # Those that are not seen are as the others are, by a prior that is weak beside
    # anything that is seen.
    logs, k = np.zeros(moments.n.size), used.size
    prior = (np.eye(k) - 1.0 / max(k, 1)) / np.log(LIMIT) ** 2
    now = _Likelihood.at(moments, logs, used)
    for _ in range(_STEPS if k else 0):
        own = logs[used]
        cost = now.cost + 0.5 * own @ prior @ own
        # Nothing changes if all gains do; the step is the smallest one.
        step = linalg.pinvh(now.information + prior) @ (now.score - prior @ own)
        step -= step.mean()
        step /= max(np.abs(step).max() / _STEP, 1.0)
        for halving in range(_HALVINGS):
            moved = own + 0.5**halving * step
            there = logs.copy()
            there[used] = moved
            new = _Likelihood.at(moments, there, used)
            better = cost - new.cost - 0.5 * moved @ prior @ moved
            if better > 0:
                logs, now = there, new
                break
        if better < _SETTLED:
            break
    return logs, now


def _spread(found):
    """Variances (k, k) of the logarithms of ratios of gains; large if not seen."""
    scale = np.sqrt(found.size)
    seen = scaled_eigen(found.information, IDENTIFIABLE, scale=scale, relative=False)
    values = np.where(seen.known, seen.values, 1.0)
    variance = np.where(seen.known, 1.0 / values, (_UNKNOWN * scale.max()) ** 2)
    roots = seen.vectors / scale[:, None] * np.sqrt(variance)
    return ((roots[:, None] - roots) ** 2).sum(axis=2)


def _grouped(spread, strength, references):
    """Find each joint's reference (nv,) from the variances of ratios (nv, nv)."""
    # Joints belong together whose ratio is known better than that it is plausible. The
    # reference is the one from which the others are known best, in any order; of two,
    # the one with more torque over noise (`strength`).
    nv = strength.size
    with np.errstate(invalid="ignore"):
        sees = HALF_WIDTH * np.sqrt(spread) < np.log(LIMIT)
    sees |= np.eye(nv, dtype=bool)
    reference = np.arange(nv)
    left = set(range(nv))
    while left:
        group, front = set(), {min(left)}
        while front:
            group |= front
            near = sees[sorted(front)].any(axis=0)
            front = set(np.flatnonzero(near).tolist()) - group
        left -= group
        members = np.array(sorted(group))
        chosen = [j for j in members if j in references]
        if not chosen:
            sums = spread[np.ix_(members, members)]
            sums = np.where(np.eye(members.size, dtype=bool), 0.0, sums).sum(axis=0)
            best = members[sums <= sums.min() * (1 + 1e-6)]
            chosen = [best[np.argmax(strength[best])]]
        reference[members] = chosen[0]
    return reference


def declared_gains(effects, nv):
    """Effects with a gain of 1 on every channel, those that had none come first."""
    own = {e.joint for e in effects if isinstance(e, TorqueGain)}
    added = [TorqueGain(joint=j, limit=_WIDEST) for j in range(nv) if j not in own]
    return (*added, *with_gains(effects, np.ones(nv)))


def with_gains(effects, gains):
    """Effects with these gains (nv,) of the channels."""
    return tuple(
        e.with_values([gains[e.joint]]) if isinstance(e, TorqueGain) else e
        for e in effects
    )


def gain_places(effects, n_rigid):
    """Where the gains of all joints are among the parameters, ndarray of int."""
    every = effect_indices(effects, n_rigid)
    gains = {e.joint: at.start for e, at in every if isinstance(e, TorqueGain)}
    return np.array([gains[joint] for joint in sorted(gains)], dtype=int)


def check_gains(gains, joint_names):
    """Refuse recordings without information on the gains of the channels."""
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


# -- the common gain, from known masses ------------------------------------------------

PAYLOAD = "payload"


def check_masses(masses, gains, model):
    """Return known masses as a dict; reject what is not a mass of a body."""
    # masses: dict of str to float [kg]; gains: the identifier's parameter.
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


def _mass_places(masses, robot):
    """Where known masses are among the parameters, a list of (name, mass, place)."""
    # A payload that is picked up and put down is there twice.
    features, found = robot.features_, []
    bodies, width = body_names(features.model_), features.n_parameters_
    for name, mass in masses.items():
        if name in bodies:
            found.append((name, mass, bodies.index(name) * (width // len(bodies))))
    for effect, at in effect_indices(robot.effects_, width):
        if isinstance(effect, Payload) and PAYLOAD in masses:
            found.append((PAYLOAD, masses[PAYLOAD], at.start))
    return found


def common_gain(masses, robot, relative, estimate):
    # Returns a `CommonGain`, and the covariance (p,) of its factor with the parameters,
    # or None if nothing fixes it. Each sum of known masses that is determined is one
    # equation. masses: dict of str to float; estimate: `PlainEstimate` with the gains.
    nothing, theta = (CommonGain(masses=masses), None), robot.theta_
    places = _mass_places(masses, robot)
    # Gains of joints that share nothing have no common factor.
    if not places or len(relative.references) != 1:
        return nothing
    names, expected, at = (np.array(x) for x in zip(*places))
    # What is put down is a change by minus its mass; of magnitudes, as those given.
    sign = np.where(names == PAYLOAD, np.sign(theta[at]), 1.0)
    covariance = estimate.covariance[np.ix_(at, at)] * np.outer(sign, sign)
    # Sums that the data determine: their direction has nothing in the null space.
    outside = estimate.eigen.null_space[at]
    values, vectors = linalg.eigh(outside @ outside.T)
    sums = vectors[:, values <= LOST] * (estimate.eigen.scale[at] * sign)[:, None]
    if not sums.size:
        return nothing
    y, x = expected @ sums, (theta[at] * sign) @ sums
    inverse = linalg.pinvh(sums.T @ covariance @ sums)
    information = float(y @ inverse @ y)
    if not information > 0:
        return nothing
    weight = inverse @ y / information
    factor, std = float(weight @ x), 1.0 / np.sqrt(information)
    # A mass that may as well be none says nothing of the scale.
    if not factor > HALF_WIDTH * std:
        return nothing
    common = CommonGain(factor=factor, std=std, masses=masses)
    return common, estimate.covariance[:, at] @ (sums @ weight * sign)
