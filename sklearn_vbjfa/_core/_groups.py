"""Evidence for a group of columns: integrated over its scale, averaged over shapes."""

import functools
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls
from scipy.special import log_ndtr, softmax

from sklearn_vbjfa._core._linear_systems import or_one

# Grid of the scale integral: torque of a group over that of its joint.
_SCALES = np.geomspace(1e-4, 1e2, 25)
# Share of its power that a direction keeps after projecting out the model, at least.
_SPAN = 1e-7


@dataclass(frozen=True, kw_only=True)
class Overdispersion:
    """Overdispersion of the score between time blocks."""

    # variance of the score over the variance by its second moments, at least one
    ratio: float = 1.0
    # degrees of freedom of that variance; infinite if there are many
    freedom: float = np.inf
    # ratio for effects that do not depend on time, for comparisons with those that do
    usual: float = 1.0

    def as_usual(self):
        """Return the same as for effects that are not functions of time."""
        return Overdispersion(ratio=self.usual, usual=self.usual)

    def discounted(self, evidence, width):
        """Discount a log Bayes factor of `width` columns."""
        evidence = evidence / self.ratio
        if evidence > 0 and np.isfinite(self.freedom):
            evidence = student(evidence, self.freedom, width)
        return evidence


def student(gain, freedom, width):
    """Log likelihood ratio of Student's t for `width` coefficients."""
    # gain: log likelihood ratio of the normal distribution.
    return 0.5 * (freedom + width) * np.log1p(2 * gain / freedom)


def log_orthant(mean, covariance):
    """Log probabilities (...) that normal vectors (..., k) have no negative element."""
    # The elements are truncated one by one, the most negative first, and the others are
    # approximated as normal with the moments of the truncated distribution (Mendell and
    # Elston, Biometrics 30, 1974, doi 10.2307/2529616). The error is below half a nat
    # for probabilities above about e^-10; smaller ones come out too large.
    # Each step computes the diagonal and one column of the covariance only.
    mean = np.array(mean)
    shape, k = mean.shape[:-1], mean.shape[-1]
    mean, covariance = mean.reshape(-1, k), covariance.reshape(-1, k, k)
    rows, done = np.arange(len(mean)), np.zeros(covariance.shape)
    variance = np.diagonal(covariance, axis1=1, axis2=2).copy()
    left, total = np.ones(mean.shape, dtype=bool), np.zeros(len(mean))
    for i in range(k):
        deviation = np.sqrt(np.maximum(variance, np.finfo(float).tiny))
        ratio = np.where(left, mean / deviation, np.inf)
        at = np.argmin(ratio, axis=1)
        z, past = ratio[rows, at], done[rows, :i, at]
        column = covariance[rows, at] - (past[:, None] @ done[:, :i])[:, 0]
        column /= deviation[rows, at][:, None]
        log_share = log_ndtr(z)
        moved = np.exp(-0.5 * z**2 - 0.5 * np.log(2 * np.pi) - log_share)
        total += log_share
        mean += moved[:, None] * column
        column *= np.sqrt(np.maximum(moved * (moved + z), 0.0))[:, None]
        done[:, i] = column
        variance -= column**2
        left[rows, at] = False
    return total.reshape(shape)


@dataclass(frozen=True, kw_only=True, eq=False)
class Groups:
    """Second moments of c groups of k columns given a model."""

    # (c, k, k): Gram matrices after projecting out the model, in units of the noise
    H: np.ndarray
    q: np.ndarray  # (c, k): products of their columns with the residual
    norms: np.ndarray  # (c, k): squared norms of the columns before the projection
    # (c, k): coefficients that scale each column to the torque of its joint
    unit: np.ndarray
    # degrees of freedom of the noise: Student's t in place of the normal
    freedom: float = np.inf
    positive: bool = False  # whether no coefficient may be negative

    def evidence(self, scale):
        """Logarithms of Bayes factors (c,) against the model without the group."""
        # The coefficients have a normal prior with deviation `unit` times a scale, and
        # the scale a half-Cauchy prior with scale `scale` (Polson and Scott, doi
        # 10.1214/12-BA730). For one scale s the factor is prod_k (1 + s^2
        # lambda_k)^(-1/2) exp(q_k^2 s^2 / (2 (1 + s^2 lambda_k))) over the eigenvalues
        # of the group's block (Tipping and Faul, AISTATS 2003).
        return np.logaddexp.reduce(self._along(scale), axis=0)

    def discounted(self, overdispersion):
        """Return the moments of a likelihood discounted for overdispersion."""
        (value, rest, vectors), ratio = self._spectral, overdispersion.ratio
        spectral = value / ratio, rest / ratio, vectors
        moments = {x: getattr(self, x) / ratio for x in ("H", "q", "norms")}
        groups = replace(self, **moments, freedom=overdispersion.freedom)
        groups.__dict__["_spectral"] = spectral
        return groups

    def integrated(self, scale, fixed):
        """Log evidence (c,) over that with the prior deviation `fixed`."""
        value, rest, _ = self._spectral
        s2 = fixed**2
        at = 0.5 * rest**2 * s2 / (1 + s2 * value) - 0.5 * np.log1p(s2 * value)
        return self.evidence(scale) - at.sum(axis=1)

    def posterior(self, scale, scales):
        """Probabilities (n_scales, c) of scales in equal steps of their logarithm."""
        along = self._along(scale, scales)
        along[[0, -1]] -= np.log(2.0)  # the trapezoidal rule
        return softmax(along, axis=0)

    def best_scale(self, scale):
        """Scale of the largest posterior density, of each group (c,)."""
        return _SCALES[np.argmax(self._along(scale), axis=0)]

    def _along(self, scale, scales=_SCALES):
        """Log evidence times prior at each scale, (n_scales, c)."""
        value, rest, _ = self._spectral
        s2 = (scales**2)[:, None, None]
        power = s2 * value
        gain = (0.5 * rest**2 * s2 / (1 + power)).sum(axis=2)
        if np.isfinite(self.freedom):
            gain = student(gain, self.freedom, (value > 0).sum(axis=1))
        ratio = scales / scale
        prior = ratio / (1 + ratio**2)
        total = gain - 0.5 * np.log1p(power).sum(axis=2)
        if self.positive:
            # The prior density of positive coefficients is 2^k times as large. The best
            # coefficients bound the evidence where the approximation fails.
            total = np.minimum(total + self._log_orthant(scales), 0.5 * self.gain())
        return total + np.log(prior / prior.sum())[:, None]

    def _log_orthant(self, scales):
        """Log posterior over prior probability of positive coefficients."""
        value, rest, vectors = self._spectral
        s = scales[:, None, None]
        precision = 1.0 + s**2 * value
        mean = (vectors @ (s * rest / precision)[..., None])[..., 0]
        covariance = (vectors / precision[:, :, None]) @ vectors.transpose(0, 2, 1)
        return log_orthant(mean, covariance) + mean.shape[-1] * np.log(2.0)

    @functools.cached_property
    def _nonnegative(self):
        """Scaled coefficients (c, k) of non-negative least squares."""
        value, rest, vectors = self._spectral
        root = np.sqrt(value)
        rows = root[:, :, None] * vectors.transpose(0, 2, 1)
        right = rest / or_one(root)
        return np.array([nnls(A, b)[0] for A, b in zip(rows, right)])

    @functools.cached_property
    def _spectral(self):
        """Eigenvalues (c, k) and vectors of the scaled blocks, q along the vectors."""
        # Zero along directions that the model explains almost completely.
        H = self.H * self.unit[:, :, None] * self.unit[:, None]
        value, vectors = np.linalg.eigh(0.5 * (H + H.transpose(0, 2, 1)))
        rest = np.einsum("cab,ca->cb", vectors, self.q * self.unit)
        seen = value > _SPAN * (self.norms * self.unit**2).max(axis=1, keepdims=True)
        return np.where(seen, value, 0.0), np.where(seen, rest, 0.0), vectors

    def shown(self):
        """Whether each group (c,) has a direction that the model does not explain."""
        return self._spectral[0].any(axis=1)

    def coefficients(self):
        """Least-squares coefficients (c, k) along the identifiable directions."""
        value, rest, vectors = self._spectral
        if self.positive:
            return self._nonnegative * self.unit
        inside = rest / or_one(value)
        return np.einsum("cab,cb->ca", vectors, inside) * self.unit

    def gain(self):
        """Decrease (c,) of the weighted squared error by least squares."""
        value, rest, vectors = self._spectral
        if self.positive:
            along = np.einsum("cab,ca->cb", vectors, self._nonnegative)
            return (2 * rest * along - value * along**2).sum(axis=1)
        return (rest**2 / or_one(value)).sum(axis=1)
