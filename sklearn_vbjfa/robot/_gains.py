"""Unknown gains of several torque channels, relative to one of them.

The channel of joint j reads y_j = g_j Phi_j theta. Joints share the parameters theta of
the bodies that they move, so that the ratios of the gains are in the couplings between
them; their common factor is in theta and in no recording. In the inverse gains h the
equations h_j y_j = Phi_j theta are linear. The torques are then inputs with noise, and
least squares takes their noise for signal: inverse gains come out too small by its
share. With the noise of each channel measured, by a fit of its own that no gain enters,
its share is subtracted, as in generalised total least squares. The smallest eigenvector
of what remains are the inverse gains, and the rest is their information.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core._scaled_eigen import scaled_eigen
from sklearn_vbjfa.effects import TorqueGain
from sklearn_vbjfa.robot._estimate import IDENTIFIABLE, denoised
from sklearn_vbjfa.robot._weights import least_squares

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
# Weights follow from the gains, and these from the weights.
_PASSES = 30
_CONVERGED = 1e-6
# Largest change in one of them.
_STEP = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class RelativeGains:
    """Gains of torque channels as the moments of a recording show them.

    Attributes
    ----------
    gains : ndarray of shape (nv,)
        Gains relative to that of the reference; 1 where they are not seen.
    reference : ndarray of shape (nv,) of int
        Joint whose channel is the unit of each: itself for a reference, and for a joint
        whose gain is not seen relative to any other.
    std : ndarray of shape (nv,)
        Standard deviations of the logarithms, for residuals independent in time.
    """

    gains: np.ndarray
    reference: np.ndarray
    std: np.ndarray

    @property
    def held(self):
        """Joints (nv,), bool, whose gain stays as it is."""
        return self.reference == np.arange(self.reference.size)

    @property
    def references(self):
        """Joints whose channels are the units of others, a sorted list of int."""
        return np.unique(self.reference[~self.held]).tolist()

    def vague(self, found):
        """Joints (nv,), bool, whose interval is wider than what is plausible.

        found : ModelValues.
        """
        n_rigid = found.estimate.theta.size - sum(
            len(effect.coefficients) for effect in found.effects
        )
        at = np.searchsorted(found.places, gain_places(found.effects, n_rigid))
        value, std = found.values_of(found.effects)[at], found.std[at]
        with np.errstate(invalid="ignore"):
            narrow = HALF_WIDTH * std / value < np.log(LIMIT)
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
    """Gains in closed form from the moments of equations with gains of 1.

    moments : JointMoments; references : joints whose channels are to be the units, for
    groups of joints in which one of them is; the others' are chosen, see `_grouped`.
    """
    used = np.flatnonzero((moments.n > 0) & (moments.yy > 0))
    nv = moments.n.size
    noise = channel_noise(moments)
    h = np.ones(nv)
    found = None
    for _ in range(_PASSES):
        found = _information(moments, h, noise, used)
        change = _smallest(found)
        h[used] *= change
        h[used] /= np.exp(np.log(h[used]).mean())
        if np.abs(change - 1).max(initial=0.0) < _CONVERGED:
            break
    spread = np.full((nv, nv), np.inf)
    if used.size:
        spread[np.ix_(used, used)] = _spread(found)
    strength = np.where(noise > 0, moments.yy / np.where(noise > 0, noise, 1.0), 0.0)
    reference = _grouped(spread, strength, references)
    gains = np.clip(h[reference] / h, 1.01 / _WIDEST, 0.99 * _WIDEST)
    return RelativeGains(
        gains=gains,
        reference=reference,
        std=np.sqrt(spread[np.arange(nv), reference]),
    )


def channel_noise(moments):
    """Variance (nv,) of each joint's torque about a fit of its own, free of gains."""
    variance = np.zeros(moments.n.size)
    for j in np.flatnonzero(moments.n > 0):
        own = np.flatnonzero(np.diagonal(moments.G[j]) > 0)
        theta = np.zeros(moments.g.shape[1])
        theta[own] = least_squares(moments.G[j][np.ix_(own, own)], moments.g[j, own])
        squares = moments.residual_squares(theta)[j]
        share = max(moments.n_rows[j] - own.size, 1) / moments.n_rows[j]
        variance[j] = max(squares / share, _LEAST_NOISE * moments.yy[j]) / moments.n[j]
    return variance


@dataclass(frozen=True, kw_only=True, eq=False)
class _Information:
    """Information (k, k) on the logarithms of inverse gains.

    `size` is its diagonal (k,) where nothing else has to be fitted.
    """

    matrix: np.ndarray
    size: np.ndarray


def _information(moments, h, noise, used):
    """Information on the inverse gains around h (nv,), for the joints that are used.

    The squares that are left when everything else is fitted, less those of the noise.
    """
    weight = np.zeros(moments.n.size)
    weight[used] = 1.0 / (h[used] ** 2 * noise[used])
    total, of_inputs = moments.total(weight), moments.total_noise(weight)
    metric = total.S_xx if of_inputs is None else denoised(total, of_inputs)
    coupled = (moments.g * (weight * h)[:, None])[used].T
    size = moments.yy[used] / noise[used]
    left = np.diag(size) - coupled.T @ scaled_eigen(metric, IDENTIFIABLE).solve(coupled)
    left = 0.5 * (left + left.T)
    rows = moments.n[used]
    share = linalg.eigh(left, np.diag(rows), eigvals_only=True, subset_by_index=[0, 0])
    return _Information(matrix=left - np.diag(share * rows), size=size)


def _smallest(found):
    """Inverse gains (k,) of the least information, about 1; those not seen stay."""
    k = found.size.size
    # Those that are not seen are as the others are, and nothing else.
    alike = (np.eye(k) - 1.0 / k) / np.log(LIMIT) ** 2
    vectors = linalg.eigh(found.matrix + alike, subset_by_index=[0, 0])[1]
    h = vectors[:, 0] / (vectors[:, 0].mean() or 1.0)
    return np.clip(h, 1 / _STEP, _STEP)


def _spread(found):
    """Variances (k, k) of the logarithms of ratios of gains; large if not seen."""
    scale = np.sqrt(found.size)
    seen = scaled_eigen(found.matrix, IDENTIFIABLE, scale=scale, relative=False)
    known = np.where(seen.known, seen.values, 1.0)
    variance = np.where(seen.known, 1.0 / known, (_UNKNOWN * scale.max()) ** 2)
    roots = seen.vectors / scale[:, None] * np.sqrt(variance)
    return ((roots[:, None] - roots) ** 2).sum(axis=2)


def _grouped(spread, strength, references):
    """Find each joint's reference (nv,) from the variances of ratios (nv, nv).

    Joints belong together whose ratio is known better than that it is plausible. Of
    them the one is the reference from which the others are known best, whatever their
    order; of two, which know each other equally well, the one with more torque over
    noise (`strength`).
    """
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
    """Gains of the torque channels of an identified robot.

    Attributes
    ----------
    joint_names : tuple of str
        Joints.
    gain : ndarray of shape (nv,)
        What each channel reads over the torque: over that in units of the reference
        channel, or over the torque itself [recorded unit / (N m or N)] where a known
        mass says how much that is. 1 (relative) where the recording does not show it.
    std : ndarray of shape (nv,)
        Standard deviations; 0 for a reference, which is the unit, nan where the
        recording does not show the gain.
    reference : ndarray of shape (nv,) of int
        Joint whose channel each is relative to: itself for a reference and for a joint
        whose gain is not shown relative to any other.
    common : CommonGain
        What fixes the common factor.
    intervals : ndarray of shape (2, nv)
        Ends of the 90 % intervals; nan where the recording does not show the gain.
    """

    joint_names: tuple
    gain: np.ndarray
    std: np.ndarray
    reference: np.ndarray
    common: object
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
    def absolute(self):
        """Whether a known mass fixes what a gain of 1 is."""
        return self.common.factor is not None


def channel_gains(robot, relative, common, places):
    """Collect the gains of a fitted identifier, `ChannelGains`.

    relative : RelativeGains; common : CommonGain; places : of the gains among the
    parameters.
    """
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
    if gains.absolute:
        return told
    names = [gains.joint_names[j] for j in gains.references]
    unit = f"that of {' or '.join(names)}" if names else "each channel"
    return (
        f"{told} These gains are relative: masses, inertias and friction in this file "
        f"are in units of {unit}, not in kg and N m."
    )
