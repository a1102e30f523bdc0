"""Rows of a recording in frequency: discrete cosines, and the residual's spectrum."""

import itertools
from dataclasses import dataclass

import numpy as np
from scipy import fft, special

from sklearn_vbjfa.diagnosis.search._blocks import Bridge

# Bands of frequency in an octave, and the fewest cosines in one.
_PER_OCTAVE, _FEWEST = 2, 2
# Spectral density below this share of the largest is rounding.
_ROUNDING = 1e-12


class Cosines:
    """Discrete cosines of a recording's rows, each part (a recording) for itself."""

    # Stationary residuals are nearly independent there, with the spectrum as their
    # variance (P. Whittle, Arkiv for Matematik 2, 1953, doi 10.1007/BF02590998). Rows
    # that do not count are bridged by straight lines. band (n,): that of each cosine;
    # edges (n_bands + 1,): where bands begin and the last one ends; octave (n_bands,):
    # log2 of their frequencies; fill (nv,): share of the rows that count.

    def __init__(self, view):
        m = view.index.size
        self._parts = list(itertools.pairwise([*view.starts, m]))
        used = view.root > 0
        self.fill = used.mean(axis=0)
        self._bridges = [Bridge.of(own, view.starts) for own in used.T]
        frequency = np.empty(m)
        for a, b in self._parts:
            frequency[a:b] = np.arange(b - a) / (2.0 * (b - a) * view.step)
        cutoff = view.robot.cutoff_
        kept = np.flatnonzero(frequency <= (cutoff if np.isfinite(cutoff) else np.inf))
        longest = max(b - a for a, b in self._parts) * view.step
        band, self.octave = _bands(frequency[kept], 0.5 / longest)
        order = np.argsort(band, kind="stable")
        self.band, self._kept, self._n_rows = band[order], kept[order], m
        self.edges = np.searchsorted(self.band, np.arange(self.octave.size + 1))

    def __call__(self, rows, joints):
        """Cosines (nj, n, ...) of rows (nj, m, ...) of some joints."""
        whole = rows.copy()
        for i, j in enumerate(joints):
            if self._bridges[j] is not None:
                whole[i] = self._bridges[j](rows[i])
        for a, b in self._parts:
            whole[:, a:b] = fft.dct(whole[:, a:b], axis=1, norm="ortho")
        return whole[:, self._kept]

    def rows(self, cosines):
        """Rows (nj, m, ...) of cosines (nj, n, ...)."""
        whole = np.zeros((cosines.shape[0], self._n_rows, *cosines.shape[2:]))
        whole[:, self._kept] = cosines
        for a, b in self._parts:
            whole[:, a:b] = fft.idct(whole[:, a:b], axis=1, norm="ortho")
        return whole


def _bands(frequency, lowest):
    """Band of each cosine, and the middle of each band in octaves."""
    octave = np.log2(np.maximum(frequency, lowest) / lowest)
    label = np.floor(_PER_OCTAVE * octave + 1e-9).astype(int)
    count = np.bincount(label)
    # Bands with too few cosines go with the next one above.
    merged, total, at = np.empty(count.size, int), 0, 0
    for k, n in enumerate(count):
        merged[k], total = at, total + n
        if total >= _FEWEST:
            at, total = at + 1, 0
    if total and at:
        merged[merged == at] = at - 1
    band = merged[label]
    size = np.bincount(band)
    return band, np.bincount(band, octave) / size


@dataclass(frozen=True, kw_only=True, eq=False)
class Spectrum:
    """Variance of a residual's cosines by joint and band."""

    variance: np.ndarray  # (nv, n_bands): infinite for a joint that does not count
    log_prior: float  # logarithm of its prior density, but for a constant

    @classmethod
    def of(cls, power, freedom, octave, smoothness):
        """Estimate it from sums of squares of a residual by bands, (nv, n_bands)."""
        # The logarithm of each band's mean square, unbiased, with the variance of that
        # of a chi-squared variable of `freedom` (cosines that count, less what the fit
        # took of them), under a prior for its second differences, with the deviation
        # `smoothness`: a band of few cosines is what its neighbours make of it.
        variance, log_prior = np.full(power.shape, np.inf), 0.0
        bend = _second_differences(octave) / smoothness
        for j in np.flatnonzero(power.any(axis=1)):
            own = np.maximum(power[j], _ROUNDING * power[j].max())
            known = freedom[j] > 0.5
            half = 0.5 * np.where(known, freedom[j], 1.0)
            # Mean and variance of the logarithm of chi^2 / freedom.
            value = np.log(own / (2 * half)) - special.digamma(half) + np.log(half)
            weight = np.where(known, 1.0 / special.polygamma(1, half), 0.0)
            normal = np.diag(weight) + bend.T @ bend
            normal += 1e-9 * np.trace(normal) * np.eye(own.size)
            smooth = np.linalg.solve(normal, weight * value)
            variance[j] = np.exp(smooth)
            log_prior -= 0.5 * float(((bend @ smooth) ** 2).sum())
        return cls(variance=variance, log_prior=log_prior)

    def weights(self, cosines, share=1.0):
        """Weights by band (nv, n_bands), by a power of it; see `spectrum_of`."""
        # Those of a bridged recording count less. Their mean, weighted by the spectrum,
        # is that of all of it.
        heard = np.isfinite(self.variance)
        whole = np.where(heard, self.variance, 1.0)
        inverse = whole**-share
        count = np.diff(cosines.edges)
        mean = (inverse * whole) @ count / count.sum()
        own = cosines.fill[:, None] * inverse / mean[:, None]
        return np.where(heard, own, 0.0)

    def noise(self, cosines):
        """Variance by band (nv, n_bands) of weighted cosines; zero where none count."""
        weights = self.weights(cosines)
        return np.divide(1.0, weights, out=np.zeros(weights.shape), where=weights > 0)


def _second_differences(octave):
    """Second differences of values at unequal places, (n - 2, n)."""
    n = octave.size
    out = np.zeros((max(n - 2, 0), n))
    for i in range(n - 2):
        left, right = np.diff(octave[i : i + 3])
        out[i, i : i + 3] = 1 / left, -1 / left - 1 / right, 1 / right
    return out / _PER_OCTAVE
