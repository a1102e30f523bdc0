"""What has to be known of all recordings before any of their equations counts.

Each recording tells its part alone and the parts merge, so that recordings can be
looked at one after the other, at the same time, or on several machines.
"""

from dataclasses import dataclass

import numpy as np

# The speed of a joint is this quantile of its speeds: its fastest, without outliers.
_FAST = 0.995


def n_fastest(n):
    """Return how many of n speeds lie at or above the quantile that counts."""
    return n - int(np.floor(_FAST * (n - 1)))


@dataclass(frozen=True, kw_only=True)
class MotionFacts:
    """Range of positions and fastest speeds.

    Attributes
    ----------
    n : int
        Number of samples.
    lowest, highest : ndarray of shape (nv,)
        Range of the positions [rad or m].
    fastest : ndarray of shape (k, nv)
        The largest speeds of each joint [rad/s or m/s], in any order.
    """

    n: int
    lowest: np.ndarray
    highest: np.ndarray
    fastest: np.ndarray

    @classmethod
    def of(cls, positions, velocities, keep):
        """Take in the positions and velocities (n, nv) of one recording.

        `keep` is `n_fastest` of all recordings together.
        """
        return cls(
            n=positions.shape[0],
            lowest=positions.min(axis=0),
            highest=positions.max(axis=0),
            fastest=_largest(np.abs(velocities), keep),
        )

    def merge(self, other, keep):
        """Merge with those of other recordings."""
        return MotionFacts(
            n=self.n + other.n,
            lowest=np.minimum(self.lowest, other.lowest),
            highest=np.maximum(self.highest, other.highest),
            fastest=_largest(np.concatenate([self.fastest, other.fastest]), keep),
        )

    def fast(self):
        """Return the 99.5th percentiles of the speeds (nv,), of all samples."""
        position = _FAST * (self.n - 1)
        below = int(np.floor(position))
        # ascending; the first of them has the rank `below` among all n
        top = np.sort(self.fastest, axis=0)[-(self.n - below) :]
        return np.quantile(top[:2], position - below, axis=0)


def merge_all(facts, keep):
    """Merge the facts of several recordings."""
    first, *others = facts
    for other in others:
        first = first.merge(other, keep)
    return first


def fastest_period(states):
    """Return the period (nv,) [s] of a sine as fast and as strongly accelerated.

    Parameters
    ----------
    states : ndarray of shape (n, 3 * nv)
        States of all recordings.

    Returns
    -------
    ndarray of shape (nv,)
        2 pi times the fastest speed over the strongest acceleration; zero without.
    """
    _, v, a = np.split(np.abs(states), 3, axis=1)
    fast, strong = (np.quantile(x, _FAST, axis=0) for x in (v, a))
    out = np.zeros_like(fast)
    return np.divide(2 * np.pi * fast, strong, out=out, where=strong > 0)


def _largest(values, keep):
    n = values.shape[0]
    if n <= keep:
        return values
    return np.partition(values, n - keep, axis=0)[n - keep :]
