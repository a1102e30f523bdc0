"""Unknown gains of several torque channels, relative to one of them.

The channel of joint j reads y_j = g_j Phi_j theta. Joints share the bodies that they
move: the ratios of the gains are in their couplings, the common factor is in theta and
in no recording. Least squares for the inverse gains, which is linear, takes noise of
the torques for signal, and they come out much too small. The likelihood is therefore
maximised over the logarithms of the gains by Gauss and Newton, from the second moments
of the joints' equations.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core._scaled_eigen import scaled_eigen
from sklearn_vbjfa.effects import TorqueGain
from sklearn_vbjfa.robot._estimate import IDENTIFIABLE
from sklearn_vbjfa.robot._weights import noise_weights

# Gains are plausible within this factor of those of the other channels, and known if
# their 90 % interval is narrower than that ...
LIMIT = 5.0
# ... so that two of them differ by its square at most.
_WIDEST = LIMIT**2
# Half width of a 90 % interval in standard deviations.
HALF_WIDTH = 1.645
# An exactly fitted joint would get infinite weight.
_LEAST_NOISE = 1e-12
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
    std: np.ndarray  # (nv,): of the logarithms, for residuals independent in time

    @property
    def held(self):
        """Joints (nv,), bool, whose gain stays as it is."""
        return self.reference == np.arange(self.reference.size)

    @property
    def references(self):
        """Joints whose channels are the units of others, a sorted list of int."""
        return np.unique(self.reference[~self.held]).tolist()

    def vague(self, found):
        """Joints (nv,), bool, whose interval is wider than what is plausible."""
        # found: ModelValues.
        n_rigid = found.estimate.theta.size - sum(
            len(effect.coefficients) for effect in found.effects
        )
        at = np.searchsorted(found.places, gain_places(found.effects, n_rigid))
        value, std = found.values_of(found.effects)[at], found.std[at]
        half = HALF_WIDTH * std
        middle = [
            np.median(value[self.reference == reference])
            for reference in self.reference
        ]
        with np.errstate(invalid="ignore"):
            # As a factor, and beside the gains of the others: a large gain whose
            # interval holds all that is plausible is known as a factor alone.
            narrow = half / value < np.log(LIMIT)
            narrow &= 2 * half < (LIMIT - 1 / LIMIT) * np.array(middle)
        return ~self.held & ~narrow

    def without(self, joints):
        """Give up the gains of joints (nv,), bool, which are not seen after all."""
        own = np.arange(self.reference.size)
        return RelativeGains(
            gains=np.where(joints, 1.0, self.gains),
            reference=np.where(joints, own, self.reference),
            std=np.where(joints, np.inf, self.std),
        )


def relative_gains(moments, references=()):
    """Gains from the moments of equations with gains of 1."""
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
        gains=np.clip(own, 1.01 / _WIDEST, 0.99 * _WIDEST),
        reference=reference,
        std=np.sqrt(spread[np.arange(nv), reference]),
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
        square = gains[:, None, None] ** 2
        read = replace(
            moments,
            G=moments.G * square,
            g=moments.g * gains[:, None],
            noise=None,
            blocks=None,
        )
        weight = noise_weights(read)
        total = read.total(weight)
        metric = scaled_eigen(total.S_xx, IDENTIFIABLE)
        theta = metric.solve(total.S_xy)
        torque = (weight[:, None] * (read.G @ theta))[used]
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
    known = np.where(seen.known, seen.values, 1.0)
    variance = np.where(seen.known, 1.0 / known, (_UNKNOWN * scale.max()) ** 2)
    roots = seen.vectors / scale[:, None] * np.sqrt(variance)
    return ((roots[:, None] - roots) ** 2).sum(axis=2)


def _grouped(spread, strength, references):
    """Find each joint's reference (nv,) from the variances of ratios (nv, nv)."""
    # Joints belong together whose ratio is known better than that it is plausible. Of
    # them the one is the reference from which the others are known best, whatever
    # their order; of two, which know each other equally well, the one with more
    # torque over noise (`strength`).
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
    places, at = {}, n_rigid
    for effect in effects:
        if isinstance(effect, TorqueGain):
            places[effect.joint] = at
        at += len(effect.coefficients)
    return np.array([places[joint] for joint in sorted(places)], dtype=int)


# -- what a fit says -------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class ChannelGains:
    """Gains of the torque channels of an identified robot."""

    joint_names: tuple
    # (nv,): what each channel reads over the torque: over that in units of the
    # reference channel, or over the torque itself [recorded unit / (N m or N)] where a
    # known mass says how much that is. 1 (relative) where the recording does not show
    # it
    gain: np.ndarray
    # (nv,): 0 for a reference, which is the unit, nan where the gain is not shown
    std: np.ndarray
    # (nv,): joint whose channel each is relative to: itself for a reference and for a
    # joint whose gain is not shown relative to any other
    reference: np.ndarray
    common: object  # what fixes the common factor
    # (2, nv): ends of the 90 % intervals; nan where the gain is not shown
    intervals: np.ndarray = field(init=False)

    def __post_init__(self):
        half = HALF_WIDTH * self.std
        ends = np.stack([self.gain - half, self.gain + half])
        object.__setattr__(self, "intervals", ends)

    @property
    def references(self):
        """Joints (tuple of int) whose channels are the units of others."""
        own = np.arange(self.reference.size)
        return tuple(np.unique(self.reference[self.reference != own]).tolist())

    @property
    def hidden(self):
        """Joints (tuple of int) whose gain is not shown relative to any other."""
        own = np.arange(self.reference.size)
        alone = own[self.reference == own]
        return tuple(np.setdiff1d(alone, self.references).tolist())

    @property
    def doubtful(self):
        """Joints (tuple of int) whose gain is far from those of all others."""
        # By more than is plausible, from the median of those that are relative to one
        # channel.
        found, logs = [], np.log(self.gain)
        for reference in self.references:
            own = np.flatnonzero(self.reference == reference)
            off = np.abs(logs[own] - np.median(logs[own]))
            found += own[off > np.log(LIMIT)].tolist()
        return tuple(sorted(found))

    @property
    def absolute(self):
        """Whether a known mass fixes what a gain of 1 is."""
        return self.common.factor is not None


def channel_gains(robot, relative, common, places):
    """Collect the gains of a fitted identifier, `ChannelGains`."""
    # relative: RelativeGains; common: CommonGain; places: of the gains among the
    # parameters.
    std = robot.theta_std_[places]
    if common.factor is None:
        std[relative.references] = 0.0
    return ChannelGains(
        joint_names=robot.joint_names_,
        gain=robot.theta_[places],
        std=std,
        reference=relative.reference,
        common=common,
    )


def check_gains(gains, joint_names):
    """Refuse what says nothing of the gains of a robot's channels."""
    if gains is None:
        return
    expected = "expected None, 'unknown', or names of joints whose channels are units"
    if isinstance(gains, str):
        if gains != "unknown":
            raise ValueError(f"gains is {gains!r}; {expected}.")
    else:
        for name in gains:
            if name not in joint_names:
                raise ValueError(
                    f"gains names joint {name!r}; {expected}, of "
                    f"{', '.join(joint_names)}."
                )
    if len(joint_names) == 1:
        raise ValueError(
            "gains='unknown' needs several joints that move the same bodies: the gain "
            f"of the only one, {joint_names[0]}, is in every parameter."
        )


def note_of_gains(gains):
    """Say what channels read over the torque in a written file; empty if known."""
    if gains is None:
        return ""
    each = ", ".join(
        f"{name} {gain:.5g}" for name, gain in zip(gains.joint_names, gains.gain)
    )
    told = f"Divide what the torque channels read by: {each}."
    return " ".join(filter(None, [told, note_of_units(gains)]))


def note_of_units(gains):
    """Say what units a written file is in; empty where they are kg and N m."""
    if gains is None or gains.absolute:
        return ""
    names = [gains.joint_names[j] for j in gains.references]
    unit = f"that of {' or '.join(names)}" if names else "each channel"
    return (
        "These gains are relative: masses, inertias and friction in this file are in "
        f"units of {unit}, not in kg and N m."
    )
