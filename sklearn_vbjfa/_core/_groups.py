"""Evidence for a group of columns: its scale is integrated, its shapes are averaged."""

import functools
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls
from scipy.special import log_ndtr, softmax

from sklearn_vbjfa._core._linear_systems import or_one

# Scales of a group's torque, over that of the joint, at which its evidence is summed.
_SCALES = np.geomspace(1e-4, 1e2, 25)
# Share of its power that a direction of a group must keep beside everything else.
_SPAN = 1e-5


@dataclass(frozen=True, kw_only=True)
class Overdispersion:
    """Overdispersion of the score between time blocks."""

    # variance of the score over that which they promise, at least one
    ratio: float = 1.0
    # degrees of freedom of that variance; infinite where they are many
    freedom: float = np.inf
    # ratio of effects that are not functions of time, beside which those that are stand
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
    """Log likelihood ratio of Student's t where the normal one has a gain."""
    # Of coefficients of `width` columns.
    return 0.5 * (freedom + width) * np.log1p(2 * gain / freedom)


def log_orthant(mean, covariance):
    """Log probabilities (...) that normal vectors (..., k) have no negative element."""
    # The elements are truncated one by one, the most negative first, and what is left
    # is taken for normal with the moments of the truncated distribution (Mendell and
    # Elston, Biometrics 30, 1974, doi 10.2307/2529616). It is good to half a nat while
    # the probability is not below e^-10 or so, and too high beyond.
    # Of the covariance only the diagonal and one column a step are made.
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

    # (c, k, k): what the model leaves of their Gram matrices, in units of the noise
    H: np.ndarray
    q: np.ndarray  # (c, k): products of their columns with the residual
    own: np.ndarray  # (c, k): square sums of the columns themselves
    # (c, k): coefficients with which each column alone has the torque of its joint
    unit: np.ndarray
    # degrees of freedom of the noise: Student's t in place of the normal
    freedom: float = np.inf
    positive: bool = False  # whether no coefficient may be negative

    def evidence(self, scale):
        """Logarithms of Bayes factors (c,) against the model without the group."""
        # The coefficients are normal, with `unit` times a scale as their deviation, and
        # the scale is half-Cauchy around `scale` (Polson and Scott, doi
        # 10.1214/12-BA730). For one scale s the factor is prod_k (1 + s^2
        # lambda_k)^(-1/2) exp(q_k^2 s^2 / (2 (1 + s^2 lambda_k))) over the eigenvalues
        # of the group's block (Tipping and Faul, AISTATS 2003).
        return np.logaddexp.reduce(self._along(scale), axis=0)

    def most_evidence(self, scale):
        """Upper bounds (c,) of the evidence that take less time for positive groups."""
        # No scale has more than the best coefficients.
        return 0.5 * self.gain() if self.positive else self.evidence(scale)

    def discounted(self, excess):
        """Return the moments of a likelihood discounted for overdispersion."""
        value, rest, vectors = self._spectral
        known = value / excess.ratio, rest / excess.ratio, vectors
        moments = {x: getattr(self, x) / excess.ratio for x in ("H", "q", "own")}
        return self._with(known, **moments, freedom=excess.freedom)

    def part(self, at):
        arrays = {name: getattr(self, name)[at] for name in ("H", "q", "own", "unit")}
        return self._with(tuple(x[at] for x in self._spectral), **arrays)

    def _with(self, spectral, **changes):
        """Return the groups with other moments, whose spectrum is known."""
        found = replace(self, **changes)
        found.__dict__["_spectral"] = spectral
        return found

    def integrated(self, scale, own):
        """Log evidence (c,) over that with the prior deviation `own` alone."""
        value, rest, _ = self._spectral
        s2 = own**2
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
        found = gain - 0.5 * np.log1p(power).sum(axis=2)
        if self.positive:
            # The prior is that of positive coefficients, 2^k times as dense. No factor
            # is above that of the best coefficients, where the approximation fails.
            found = np.minimum(found + self._log_orthant(scales), 0.5 * self.gain())
        return found + np.log(prior / prior.sum())[:, None]

    def _log_orthant(self, scales):
        """Log of the share (n_scales, c) of positive coefficients, over the prior's."""
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
        """Eigenvalues (c, k) of the scaled blocks, products along them, directions."""
        # Zero along directions of which too little is left.
        H = self.H * self.unit[:, :, None] * self.unit[:, None]
        value, vectors = np.linalg.eigh(0.5 * (H + H.transpose(0, 2, 1)))
        rest = np.einsum("cab,ca->cb", vectors, self.q * self.unit)
        seen = value > _SPAN * (self.own * self.unit**2).max(axis=1, keepdims=True)
        return np.where(seen, value, 0.0), np.where(seen, rest, 0.0), vectors

    def shown(self):
        """Whether a group (c,) has a part that the model cannot absorb."""
        return self._spectral[0].any(axis=1)

    def coefficients(self):
        """Coefficients (c, k) of least squares, of what is seen of each group."""
        value, rest, vectors = self._spectral
        if self.positive:
            return self._nonnegative * self.unit
        inside = rest / or_one(value)
        return np.einsum("cab,cb->ca", vectors, inside) * self.unit

    def gain(self):
        """Fall (c,) of the weighted squared error by least squares."""
        value, rest, vectors = self._spectral
        if self.positive:
            along = np.einsum("cab,ca->cb", vectors, self._nonnegative)
            return (2 * rest * along - value * along**2).sum(axis=1)
        return (rest**2 / or_one(value)).sum(axis=1)
