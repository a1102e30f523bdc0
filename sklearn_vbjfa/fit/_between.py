"""Variance of drive parameters between recordings, by their moments."""

import numpy as np

from sklearn_vbjfa._core._groups import Groups
from sklearn_vbjfa._core._linear_systems import block_variance, scaled_eigen
from sklearn_vbjfa.effects import InModel, OfTime
from sklearn_vbjfa.equations._joint_moments import weighted_parts
from sklearn_vbjfa.fit._bodies import DESCRIBED
from sklearn_vbjfa.fit._estimate import IDENTIFIABLE, noise_variance
from sklearn_vbjfa.robot._posterior import (
    BetweenRecordings,
    body_places,
    covariance_inverse,
    of_effects,
)

# How far values of a drive are expected to be off from one recording to another, as a
# share of the value: half-Cauchy, as descriptions are around bodies. Scales that are
# summed over, the largest that of a value that scatters about nothing.
_SHARE, _SCALES = DESCRIBED, np.geomspace(1e-4, 2.0, 61)
# Passes over all values, and the change of a logarithm of a scale that ends them.
_PASSES, _STAYS = 30, 0.02
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
    size, weights = effects.unit * spread, effects.solved()
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

    def solved(self):
        """Return the probabilities (m, k) of scales."""
        typical = _SHARE * self.unit
        for _ in range(_PASSES):
            weights = self._groups(typical).posterior(_SHARE, _SCALES)
            new = np.exp(np.log(_SCALES) @ weights) * self.unit
            moved = np.abs(np.log(new / typical)).max()
            typical = new
            if moved < _STAYS:
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
