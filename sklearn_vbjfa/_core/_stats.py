"""Sufficient statistics of a linear-Gaussian model: count, means and scatter.

Everything the EM and variational updates need of the data is n, the means and the
second moments. They are accumulated about the mean (never as raw moments, whose
differences cancel), they merge exactly, and a row with weight 2 is the row twice.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

# Rows per block of the one pass over the data: small enough that the centred copy
# of a block stays in the processor's cache, large enough for the matrix product.
_BLOCK_BYTES = 4 << 20


@dataclass(frozen=True, kw_only=True)
class SufficientStatistics:
    """Weighted count, means and scatter matrices of inputs X and one output y.

    Attributes
    ----------
    n_rows : int
        Number of rows seen, whatever their weight.
    n_samples : float
        Sum of the weights.
    x_mean, y_mean : ndarray of shape (n_features,), float
        Weighted means.
    S_xx : ndarray of shape (n_features, n_features)
        Scatter about the mean, sum of w (x - x_mean)(x - x_mean)'.
    S_xy : ndarray of shape (n_features,)
        sum of w (x - x_mean)(y - y_mean).
    S_yy : float
        sum of w (y - y_mean)^2.
    """

    n_rows: int
    n_samples: float
    x_mean: np.ndarray
    y_mean: float
    S_xx: np.ndarray
    S_xy: np.ndarray
    S_yy: float

    @property
    def n_features(self):
        """Number of inputs."""
        return self.x_mean.shape[0]

    def about(self, *, centred):
        """Return (S_xx, S_xy, S_yy) about the means, or about zero."""
        if centred:
            return self.S_xx, self.S_xy, self.S_yy
        n, x, y = self.n_samples, self.x_mean, self.y_mean
        return (
            self.S_xx + n * np.outer(x, x),
            self.S_xy + n * x * y,
            self.S_yy + n * y * y,
        )


def _centre(X, y, weight):
    """Return n, the means, and the rows about them times the root of their weights.

    Taking the first row off before the means makes a constant column exactly zero; the
    running sum of a million equal numbers is some 1e6 eps off.
    """
    X_shift, y_shift = X - X[0], (y - y[0]).astype(float, copy=False)
    if weight is None:
        n = float(X.shape[0])
        x_mean, y_mean = X_shift.mean(axis=0), float(y_shift.mean())
    else:
        n = float(weight.sum())
        x_mean, y_mean = weight @ X_shift / n, float(weight @ y_shift / n)
    X_shift -= x_mean
    y_shift -= y_mean
    if weight is not None:
        # The square root on both factors keeps the product symmetric (syrk).
        root = np.sqrt(weight)
        X_shift *= root[:, None]
        y_shift *= root
    return n, X[0] + x_mean, float(y[0] + y_mean), X_shift, y_shift


def _block_statistics(X, y, weight):
    n, x_mean, y_mean, Xc, yc = _centre(X, y, weight)
    return SufficientStatistics(
        n_rows=X.shape[0],
        n_samples=n,
        x_mean=x_mean,
        y_mean=y_mean,
        S_xx=Xc.T @ Xc,
        S_xy=Xc.T @ yc,
        S_yy=float(yc @ yc),
    )


def merge(first, second):
    """Merge the statistics of two disjoint sets of rows.

    The pairwise update of Chan, Golub and LeVeque (1983), exact whatever the split.
    """
    if first is None:
        return second
    n = first.n_samples + second.n_samples
    dx, dy = second.x_mean - first.x_mean, second.y_mean - first.y_mean
    share = second.n_samples / n
    cross = first.n_samples * share
    return SufficientStatistics(
        n_rows=first.n_rows + second.n_rows,
        n_samples=n,
        x_mean=first.x_mean + share * dx,
        y_mean=first.y_mean + share * dy,
        S_xx=first.S_xx + second.S_xx + cross * np.outer(dx, dx),
        S_xy=first.S_xy + second.S_xy + cross * dx * dy,
        S_yy=first.S_yy + second.S_yy + cross * dy * dy,
    )


def _drop_weightless(X, y, weight):
    if weight is None or (keep := weight > 0).all():
        return X, y, weight
    return X[keep], y[keep], weight[keep]


def from_data(X, y, weight=None):
    """Accumulate the statistics of X (n, d), y (n,) in one pass, block by block."""
    y = np.asarray(y, dtype=float)
    X, y, weight = _drop_weightless(X, y, weight)
    step = max(256, _BLOCK_BYTES // (8 * max(1, X.shape[1])))
    total = None
    for start in range(0, X.shape[0], step):
        stop = start + step
        w = None if weight is None else weight[start:stop]
        total = merge(total, _block_statistics(X[start:stop], y[start:stop], w))
    return total


class Moments(Protocol):
    """What one iteration asks of the (standardised) data.

    n : number of samples; xx : diagonal of S_xx; xy, yy : S_xy, S_yy;
    dot(v) : S_xx v.
    """

    n: float
    xx: np.ndarray
    xy: np.ndarray
    yy: float

    def dot(self, v):
        """Return S_xx v."""


@dataclass(frozen=True, kw_only=True)
class GramMoments:
    """Moments held as the scatter matrix: O(d^2) an iteration, whatever n."""

    n: float
    S: np.ndarray
    xy: np.ndarray
    yy: float
    xx: np.ndarray

    def dot(self, v):
        """Return S_xx v."""
        return self.S @ v


@dataclass(frozen=True, kw_only=True)
class DataMoments:
    """Moments held as the data themselves: O(n d) an iteration, for d > n."""

    n: float
    X: np.ndarray
    xy: np.ndarray
    yy: float
    xx: np.ndarray

    def dot(self, v):
        """Return S_xx v."""
        return self.X.T @ (self.X @ v)


@dataclass(frozen=True, kw_only=True)
class Standardised:
    """Moments in units of each column's standard deviation, and the way back.

    ``active`` marks the columns that vary at all; the moments hold only those.
    ``x_scale`` (n_active,) and ``y_scale`` convert: x = x_scale * standardised.
    """

    moments: Moments
    active: np.ndarray
    x_scale: np.ndarray
    y_scale: float
    x_offset: np.ndarray
    y_offset: float

    def expand(self, values, fill=0.0):
        """Spread values of the active columns over all columns."""
        out = np.full(self.active.shape[0], fill, dtype=float)
        out[self.active] = values
        return out


def _scales(xx, x_mean, n):
    # A column is constant when its spread is rounding of its mean: no absolute
    # tolerance, since columns come in any unit.
    spread = np.sqrt(np.maximum(xx, 0.0) / n)
    rounding = 8 * np.finfo(float).eps * np.sqrt(n) * np.abs(x_mean)
    active = (spread > rounding) & (spread > np.finfo(float).tiny)
    return spread, active


def standardise(stats, *, centred):
    """Scale accumulated statistics to unit variance (unit mean square if uncentred)."""
    S, xy, yy = stats.about(centred=centred)
    mean = stats.x_mean if centred else np.zeros_like(stats.x_mean)
    spread, active = _scales(np.diagonal(S), mean, stats.n_samples)
    x_scale = spread[active]
    y_scale = float(np.sqrt(yy / stats.n_samples))
    y_rounding = 8 * np.finfo(float).eps * abs(stats.y_mean) * centred
    if not y_scale > y_rounding:
        y_scale = 0.0
    y_unit = y_scale or 1.0
    S = S[np.ix_(active, active)] / np.outer(x_scale, x_scale)
    moments = GramMoments(
        n=stats.n_samples,
        S=S,
        xy=xy[active] / (x_scale * y_unit),
        yy=yy / y_unit**2,
        xx=np.diagonal(S).copy(),
    )
    return Standardised(
        moments=moments,
        active=active,
        x_scale=x_scale,
        y_scale=y_scale,
        x_offset=stats.x_mean if centred else np.zeros_like(stats.x_mean),
        y_offset=stats.y_mean if centred else 0.0,
    )


def standardise_data(X, y, weight=None, *, centred):
    """Like `standardise`, holding the (weighted, centred, scaled) rows themselves."""
    y = np.asarray(y, dtype=float)
    X, y, weight = _drop_weightless(X, y, weight)
    if centred:
        n, x_mean, y_mean, Xc, yc = _centre(X, y, weight)
    else:
        w = np.ones(X.shape[0]) if weight is None else weight
        n, x_mean, y_mean = float(w.sum()), np.zeros(X.shape[1]), 0.0
        root = np.sqrt(w)
        Xc, yc = X * root[:, None], y * root
    spread, active = _scales(np.einsum("ij,ij->j", Xc, Xc), x_mean, n)
    x_scale = spread[active]
    y_scale = float(np.sqrt(yc @ yc / n))
    if not y_scale > 8 * np.finfo(float).eps * abs(y_mean):
        y_scale = 0.0
    Xc = Xc[:, active] / x_scale
    yc = yc / (y_scale or 1.0)
    moments = DataMoments(
        n=n,
        X=Xc,
        xy=Xc.T @ yc,
        yy=float(yc @ yc),
        xx=np.einsum("ij,ij->j", Xc, Xc),
    )
    return Standardised(
        moments=moments,
        active=active,
        x_scale=x_scale,
        y_scale=y_scale,
        x_offset=x_mean,
        y_offset=y_mean,
    )
