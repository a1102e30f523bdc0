"""Discrete cosine transform of a recording's rows, and the residual's spectrum."""

import itertools
from dataclasses import dataclass

import numpy as np
from scipy import fft, special

# Frequency bands per octave, and the minimum number of cosines in a band.
_PER_OCTAVE, _FEWEST = 2, 2
# Spectral density below this share of the largest is rounding.
_ROUNDING = 1e-12


class Cosines:
    """Discrete cosine transform of rows, separately for each part (a recording)."""

    # The cosines of stationary residuals are nearly independent, with the spectrum as
    # variance (P. Whittle, Arkiv for Matematik 2, 1953, doi 10.1007/BF02590998). Rows
    # without weight are interpolated linearly; such rows are also appended to parts
    # whose length has large prime factors. band (n,): band of each cosine; edges
    # (n_bands + 1,): bounds of the bands; octave (n_bands,): log2 of their frequencies;
    # fill (nv,): share of the rows with weight.

    def __init__(self, view):
        parts = list(itertools.pairwise([*view.starts, view.index.size]))
        lengths = [fft.next_fast_len(int(b - a)) for a, b in parts]
        starts = np.cumsum([0, *lengths])
        self._parts = list(itertools.pairwise(starts))
        pairs = zip(parts, lengths)
        row = [a + np.minimum(np.arange(n), b - a - 1) for (a, b), n in pairs]
        row = np.concatenate(row)
        appended = np.diff(row, prepend=-1) == 0
        used = (view.root[row] > 0) & ~appended[:, None]
        self.fill, self._rows = used.mean(axis=0), np.flatnonzero(~appended)
        between = [_interpolation(x, starts[:-1]) for x in used.T]
        self._interpolations = [(row[a], row[b], share) for a, b, share in between]
        frequency = [np.arange(n) / (2.0 * n * view.step) for n in lengths]
        frequency = np.concatenate(frequency)
        kept = np.flatnonzero(frequency <= view.robot.cutoff_)
        band, self.octave = _bands(frequency[kept], 0.5 / (max(lengths) * view.step))
        order = np.argsort(band, kind="stable")
        self.band, self._kept = band[order], kept[order]
        self.edges = np.searchsorted(self.band, np.arange(self.octave.size + 1))

    def __call__(self, rows, joints):
        """Transform rows (nj, m, ...) of some joints to cosines (nj, n, ...)."""
        whole = np.empty((len(rows), self._parts[-1][1], *rows.shape[2:]))
        for x, out, j in zip(rows, whole, joints):
            low, high, share = self._interpolations[j]
            np.take(x, low, axis=0, out=out)
            at = np.flatnonzero(share)
            share = share[at].reshape(-1, *(1,) * (x.ndim - 1))
            out[at] += share * (x[high[at]] - x[low[at]])
        for a, b in self._parts:
            whole[:, a:b] = fft.dct(whole[:, a:b], axis=1, norm="ortho")
        return whole[:, self._kept]

    def rows(self, cosines):
        """Transform cosines (nj, n, ...) back to rows (nj, m, ...)."""
        whole = np.zeros((cosines.shape[0], self._parts[-1][1], *cosines.shape[2:]))
        whole[:, self._kept] = cosines
        for a, b in self._parts:
            whole[:, a:b] = fft.idct(whole[:, a:b], axis=1, norm="ortho")
        return whole[:, self._rows]


def _interpolation(used, starts):
    """Return the used rows (m,) around each row, and its position between them."""
    low, high, share = np.arange(used.size), np.arange(used.size), np.zeros(used.size)
    for a, b in itertools.pairwise([*starts, used.size]):
        rows = a + np.flatnonzero(used[a:b])
        # Without used rows a part remains as it is.
        if 0 < rows.size < b - a:
            position = np.interp(np.arange(a, b), rows, np.arange(rows.size))
            low[a:b] = rows[np.floor(position).astype(int)]
            high[a:b] = rows[np.ceil(position).astype(int)]
            share[a:b] = position % 1.0
    return low, high, share


def _bands(frequency, lowest):
    """Return the band of each cosine, and the centre of each band in octaves."""
    octave = np.log2(np.maximum(frequency, lowest) / lowest)
    label = np.floor(_PER_OCTAVE * octave + 1e-9).astype(int)
    count = np.bincount(label)
    # Merge bands with too few cosines with the next higher one.
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

    variance: np.ndarray  # (nv, n_bands): infinite for an unused joint
    log_prior: float  # log prior density, up to a constant

    @classmethod
    def of(cls, power, freedom, octave, smoothness):
        """Estimate it from sums of squared residuals by band, (nv, n_bands)."""
        # Smooth the unbiased log mean square of each band, with the variance of the log
        # of a chi-squared variable of `freedom` (cosines with weight less parameters of
        # the fit), under a Gaussian prior on second differences with standard deviation
        # `smoothness`. Bands with few cosines follow their neighbours.
        variance, log_prior = np.full(power.shape, np.inf), 0.0
        slopes = np.diff(np.eye(octave.size), axis=0) / np.diff(octave)[:, None]
        D = np.diff(slopes, axis=0) / (_PER_OCTAVE * smoothness)
        for j in np.flatnonzero(power.any(axis=1)):
            y = np.maximum(power[j], _ROUNDING * power[j].max())
            valid = freedom[j] > 0.5
            half = 0.5 * np.where(valid, freedom[j], 1.0)
            # Mean and variance of the logarithm of chi^2 / freedom.
            value = np.log(y / (2 * half)) - special.digamma(half) + np.log(half)
            weight = np.where(valid, 1.0 / special.polygamma(1, half), 0.0)
            normal = np.diag(weight) + D.T @ D
            normal += 1e-9 * np.trace(normal) * np.eye(y.size)
            smooth = np.linalg.solve(normal, weight * value)
            variance[j] = np.exp(smooth)
            log_prior -= 0.5 * float(((D @ smooth) ** 2).sum())
        return cls(variance=variance, log_prior=log_prior)

    def weights(self, cosines, share=1.0):
        """Return weights (nv, n_bands) by a power of the spectrum (`spectrum_of`)."""
        # Interpolated rows reduce the weights. Normalise them so that their mean, times
        # the spectrum, is that of full spectral weighting.
        used = np.isfinite(self.variance)
        variance = np.where(used, self.variance, 1.0)
        inverse = variance**-share
        count = np.diff(cosines.edges)
        mean = (inverse * variance) @ count / count.sum()
        weights = cosines.fill[:, None] * inverse / mean[:, None]
        return np.where(used, weights, 0.0)

    def noise(self, cosines):
        """Return the noise variance (nv, n_bands), 1 over the weights, or zero."""
        weights = self.weights(cosines)
        return np.divide(1.0, weights, out=np.zeros(weights.shape), where=weights > 0)
