"""Exact quantiles of numbers that are never in one place.

The bit patterns of numbers that are not negative are in the order of the numbers. A
first pass counts their upper 16 bits (sign, exponent and four bits of the mantissa),
which tells within 6 % where a quantile lies; a second one fetches the few numbers that
begin with the same bits, among which it is.
"""

from dataclasses import dataclass

import numpy as np

_SHIFT = 48
_BINS = 1 << 15


def _leading(values):
    """Upper 16 bits of numbers that are not negative; -0.0 counts as 0.0."""
    return (np.ascontiguousarray(values) + 0.0).view(np.int64) >> _SHIFT


@dataclass(frozen=True)
class BitCounts:
    """How many numbers of each column begin with which bits.

    Attributes
    ----------
    counts : ndarray of shape (k, 2 ** 15)
        Counts.
    """

    counts: np.ndarray

    @classmethod
    def empty(cls, k):
        """Count nothing, for k columns."""
        return cls(np.zeros((k, _BINS), dtype=np.int64))

    def __add__(self, other):
        """Merge the counts of disjoint rows."""
        return BitCounts(self.counts + other.counts)

    @property
    def n(self):
        """Number of rows."""
        return int(self.counts[0].sum())

    def bins(self, q):
        """Bins of the two numbers that a quantile lies between, (k, 2).

        With fewer than one row there are none, and the bins are empty.
        """
        if self.n == 0:
            return np.full((self.counts.shape[0], 2), -1)
        low = int(np.floor(q * (self.n - 1)))
        ranks = [low, min(low + 1, self.n - 1)]
        cumulative = np.cumsum(self.counts, axis=1)
        return np.array([np.searchsorted(c, ranks, side="right") for c in cumulative])


def bit_counts(values):
    """Count the leading bits of values (n, k), which are not negative."""
    columns = _leading(values).T
    return BitCounts(np.array([np.bincount(c, minlength=_BINS) for c in columns]))


def candidates(values, bins):
    """Numbers of each column in its two bins, a list of arrays."""
    columns = _leading(values).T
    return [
        column[(bits == low) | (bits == high)]
        for column, bits, (low, high) in zip(values.T, columns, bins)
    ]


def merge_candidates(first, *others):
    """Merge the candidates of disjoint rows."""
    return [np.concatenate(columns) for columns in zip(first, *others)]


def quantile(counts, found, q):
    """Quantile of each column, interpolated as `numpy.quantile` does.

    Parameters
    ----------
    counts : BitCounts
        Counts of all rows.
    found : list of ndarray
        Their merged candidates.
    q : float
        Which quantile.

    Returns
    -------
    ndarray of shape (k,)
        Quantiles; nan without rows.
    """
    if counts.n == 0:
        return np.full(len(found), np.nan)
    position = q * (counts.n - 1)
    rank = int(np.floor(position))
    result = np.empty(len(found))
    for j, ((low, _), values) in enumerate(zip(counts.bins(q), found)):
        first = rank - int(counts.counts[j, :low].sum())
        pair = np.sort(values)[first : first + 2]
        result[j] = np.quantile(pair, position - rank)
    return result
