"""Blocks of time: what counts as one independent piece of evidence."""

import itertools
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis._whitening import fit_memory

# A block is this many times longer than the residual stays correlated.
_CORRELATION_TIMES = 10.0
# Blocks wanted. What a poor first model lacks is correlated for as long as the motion
# is; it is not noise, and must not make the blocks so long that fewer are left than
# the signed-rank test needs among a hundred candidates. Noise that stays correlated for
# longer than a block is taken out before blocks are compared, see `Judge`.
_WANTED = (40, 60)
# The fewest with which anything can be said: the smallest p-value is 2^-12.
FEWEST = 12
# Folds take every eighth block, so that each leaves out a little of all motions: a
# fold of neighbours would have to be extrapolated to, which says more of the short
# recording than of the effect.
_FOLDS = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class Blocks:
    """Blocks and folds of rows.

    Attributes
    ----------
    label : ndarray of shape (m,)
        Block of each row, rising.
    fold : ndarray of shape (m,)
        Fold of each row: blocks that are left out together.
    length : float
        Typical length of a block [s].
    """

    label: np.ndarray
    fold: np.ndarray
    length: float

    @property
    def n_blocks(self):
        """Number of blocks."""
        return int(self.label[-1]) + 1

    @property
    def n_folds(self):
        """Number of folds."""
        return int(self.fold.max()) + 1

    def folds(self):
        """Rows of each fold, list of ndarray."""
        return [np.flatnonzero(self.fold == k) for k in range(self.n_folds)]

    def divided(self, least):
        """Return blocks cut into pieces that are not shorter than a time [s]."""
        pieces = max(1, int(self.length / least))
        count = np.bincount(self.label)
        first = np.r_[0, np.cumsum(count)[:-1]]
        place = np.arange(self.label.size) - first[self.label]
        piece = place * pieces // count[self.label]
        _, label = np.unique(self.label * pieces + piece, return_inverse=True)
        return Blocks(label=label, fold=self.fold, length=self.length / pieces)

    def sums(self, values):
        """Sum rows (m, ...) over each block."""
        starts = np.r_[0, np.flatnonzero(np.diff(self.label)) + 1]
        return np.add.reduceat(values, starts, axis=0)


def correlation_time(residual, weight, step, starts):
    """Longest integrated autocorrelation time of the joints' residuals [s].

    That of an autoregression, see `fit_memory`: sums of sample autocorrelations read
    slow residuals too short, as their own mean is taken out of them; infinite for a
    random walk.

    Parameters
    ----------
    residual, weight : ndarray of shape (m, nv)
        Residuals and what they count.
    step : float
        Time between rows [s].
    starts : ndarray of int
        First rows of the recordings.
    """
    times = []
    for r, used in zip(residual.T, weight.T > 0):
        r = np.where(used, r, 0.0)
        if r.any():
            times.append(fit_memory(r, used, np.asarray(starts), step).time)
    return float(max(times, default=0.0))


def make_blocks(time, starts, correlation, filter_length):
    """Divide rows into blocks of time.

    Parameters
    ----------
    time : ndarray of shape (m,)
        Time of the rows within their recording [s].
    starts : ndarray of int
        First rows of the recordings.
    correlation : float
        Correlation time of the residual [s].
    filter_length : float
        Length of the low-pass [s].

    Raises
    ------
    ValueError
        If the recordings are too short for blocks.
    """
    edges = np.r_[starts, time.size]
    lengths = [float(np.ptp(time[a:b])) for a, b in itertools.pairwise(edges)]
    total = sum(lengths)
    least = max(_CORRELATION_TIMES * correlation, filter_length)
    if total / FEWEST < filter_length:
        raise ValueError(
            f"The recordings hold {total:.3g} s behind the low-pass, too little for "
            f"{FEWEST} blocks of time that are longer than the filter "
            f"({filter_length:.3g} s each); record at least "
            f"{FEWEST * filter_length:.3g} s more than is kept for the test, or raise "
            "the identifier's cutoff."
        )
    wanted = int(np.clip(total / least, *_WANTED))
    wanted = min(wanted, int(total / filter_length))
    label = np.empty(time.size, dtype=int)
    first = 0
    for a, b, length in zip(edges[:-1], edges[1:], lengths):
        count = max(1, round(wanted * length / total)) if total else 1
        count = min(count, b - a)
        label[a:b] = first + (np.arange(b - a) * count) // (b - a)
        first += count
    folds = min(_FOLDS, first)
    return Blocks(label=label, fold=label % folds, length=total / max(first, 1))
