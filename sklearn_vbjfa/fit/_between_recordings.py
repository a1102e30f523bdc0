"""Variance of parameters between recordings of one robot."""

import numpy as np

from sklearn_vbjfa._core._groups import Groups
from sklearn_vbjfa._core._linear_systems import block_variance, scaled_eigen
from sklearn_vbjfa.effects import InModel, OfTime
from sklearn_vbjfa.equations._joint_moments import weighted_parts
from sklearn_vbjfa.fit._bodies import DESCRIBED
from sklearn_vbjfa.fit._estimate import IDENTIFIABLE, noise_variance
from sklearn_vbjfa.robot._posterior import (
    BetweenRecordings,
    body_indices,
    covariance_inverse,
    effect_mask,
)

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
        return Groups(H=np.array(H), q=np.array(q), norms=self._power.T, unit=unit)


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
