"""Sufficient statistics of a linear-Gaussian model: count, means and scatter.

Everything the EM and variational updates need of the data is n, the means and the
second moments. They are accumulated about the mean (never as raw moments, whose
differences cancel), they merge exactly, and a row with weight 2 is the row twice.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from sklearn_vbjfa._core._standardize import is_constant

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
    x_mean_low, y_mean_low : ndarray of shape (n_features,), float
        What rounding the means to a number left of them.
    factor : ndarray of shape (n_features + 1, n_features + 1) or None
        Triangular factor of the centred, weighted rows of [X y], where it is carried
        along: its product with itself is the scatter, which has only half its digits.
    """

    n_rows: int
    n_samples: float
    x_mean: np.ndarray
    y_mean: float
    S_xx: np.ndarray
    S_xy: np.ndarray
    S_yy: float
    x_mean_low: np.ndarray | float = 0.0
    y_mean_low: float = 0.0
    factor: np.ndarray | None = None

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

    def factor_about(self, *, centred):
        """Return the triangular factor about the means, or about zero."""
        if centred or self.factor is None:
            return self.factor
        mean = np.append(self.x_mean, self.y_mean)
        return triangular(self.factor, np.sqrt(self.n_samples) * mean[None])


def _centre(X, y, weight, x_origin, y_origin):
    """Return n, the means less the origin, and the centred rows times root weight.

    The origin is a row of the data. Taking it off before the means makes a constant
    column exactly zero; the running sum of a million equal numbers is some 1e6 eps off.
    """
    X_shift, y_shift = X - x_origin, (y - y_origin).astype(float, copy=False)
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
    return n, x_mean, y_mean, X_shift, y_shift


def _block_statistics(X, y, weight, x_origin, y_origin):
    n, x_mean, y_mean, Xc, yc = _centre(X, y, weight, x_origin, y_origin)
    return SufficientStatistics(
        n_rows=X.shape[0],
        n_samples=n,
        x_mean=x_mean,
        y_mean=y_mean,
        S_xx=Xc.T @ Xc,
        S_xy=Xc.T @ yc,
        S_yy=float(yc @ yc),
    )


def triangular(*rows):
    """Triangular factor of stacked rows (n, k), ndarray of shape (k, k)."""
    R = np.linalg.qr(np.concatenate(rows), mode="r")
    missing = R.shape[1] - R.shape[0]
    return np.pad(R, ((0, missing), (0, 0))) if missing > 0 else R


def _two_sum(a, b):
    """Return the rounded sum and its rounding error, exactly (Knuth)."""
    total = a + b
    shifted = total - a
    return total, (a - (total - shifted)) + (b - shifted)


def merge(first, second):
    """Merge the statistics of two disjoint sets of rows.

    The pairwise update of Chan, Golub and LeVeque (1983), exact whatever the split.
    The result has a triangular factor if both have one.
    """
    if first is None:
        return second
    n = first.n_samples + second.n_samples
    dx, dy = second.x_mean - first.x_mean, second.y_mean - first.y_mean
    dx = dx + (second.x_mean_low - first.x_mean_low)
    dy = dy + (second.y_mean_low - first.y_mean_low)
    share = second.n_samples / n
    cross = first.n_samples * share
    x_mean, x_low = _two_sum(first.x_mean, first.x_mean_low + share * dx)
    y_mean, y_low = _two_sum(first.y_mean, first.y_mean_low + share * dy)
    factor = None
    if first.factor is not None and second.factor is not None:
        between = np.sqrt(cross) * np.append(dx, dy)[None]
        factor = triangular(first.factor, second.factor, between)
    return SufficientStatistics(
        n_rows=first.n_rows + second.n_rows,
        n_samples=n,
        x_mean=x_mean,
        y_mean=float(y_mean),
        S_xx=first.S_xx + second.S_xx + cross * np.outer(dx, dx),
        S_xy=first.S_xy + second.S_xy + cross * dx * dy,
        S_yy=first.S_yy + second.S_yy + cross * dy * dy,
        x_mean_low=x_low,
        y_mean_low=float(y_low),
        factor=factor,
    )


def fade(stats, factor):
    """Multiply the weight of every row so far by a factor."""
    if factor == 1.0:
        return stats
    return replace(
        stats,
        n_samples=factor * stats.n_samples,
        S_xx=factor * stats.S_xx,
        S_xy=factor * stats.S_xy,
        S_yy=factor * stats.S_yy,
        factor=None if stats.factor is None else np.sqrt(factor) * stats.factor,
    )


def _drop_weightless(X, y, weight):
    if weight is None or (keep := weight > 0).all():
        return X, y, weight
    return X[keep], y[keep], weight[keep]


def rows_per_block(n_features):
    """Rows that are summed at once."""
    return max(256, _BLOCK_BYTES // (8 * max(1, n_features)))


def _blocks(X, y, weight):
    step = rows_per_block(X.shape[1])
    for start in range(0, X.shape[0], step):
        rows = slice(start, start + step)
        yield X[rows], y[rows], None if weight is None else weight[rows]


def from_data(X, y, weight=None):
    """Accumulate the statistics of X (n, d), y (n,) in one pass, block by block.

    All blocks are taken about the first row, so that their means, whose differences
    enter the scatter, are not rounded in units of a large offset.
    """
    y = np.asarray(y, dtype=float)
    X, y, weight = _drop_weightless(X, y, weight)
    if X.shape[0] == 0:
        return None
    x_origin, y_origin = X[0].astype(float), float(y[0])
    total = None
    for X_block, y_block, w in _blocks(X, y, weight):
        block = _block_statistics(X_block, y_block, w, x_origin, y_origin)
        total = merge(total, block)
    x_mean, x_low = _two_sum(x_origin, total.x_mean)
    y_mean, y_low = _two_sum(y_origin, total.y_mean)
    return replace(
        total,
        x_mean=x_mean,
        y_mean=y_mean,
        x_mean_low=x_low + total.x_mean_low,
        y_mean_low=y_low + total.y_mean_low,
    )


def centred_blocks(stats, X, y, weight=None):
    """Yield blocks of rows [X y] about the means of `stats` times root weight."""
    X, y, weight = _drop_weightless(X, np.asarray(y, dtype=float), weight)
    for X_block, y_block, w in _blocks(X, y, weight):
        rows = np.empty((X_block.shape[0], X_block.shape[1] + 1))
        rows[:, :-1] = (X_block - stats.x_mean) - stats.x_mean_low
        rows[:, -1] = (y_block - stats.y_mean) - stats.y_mean_low
        if w is not None:
            rows *= np.sqrt(w)[:, None]
        yield rows


def with_factor(stats, X, y, weight=None):
    """Add the triangular factor of the rows that `stats` were made of.

    One more pass: a QR decomposition of each block below the factor so far.
    """
    factor = np.zeros((0, stats.n_features + 1))
    for rows in centred_blocks(stats, X, y, weight):
        factor = triangular(factor, rows)
    return replace(stats, factor=factor)


class Moments(Protocol):
    """What one iteration asks of the (standardised) data.

    n : number of samples; xx : diagonal of S_xx; xy, yy : S_xy, S_yy;
    dot(v) : S_xx v; residual(c) : sums of x e and of e^2, e = y - c'x.
    """

    n: float
    xx: np.ndarray
    xy: np.ndarray
    yy: float

    def dot(self, v):
        """Return S_xx v."""

    def residual(self, c):
        """Return S_xe and S_ee."""

    def without_last_digits(self):
        """Return moments that do not depend on the order of summation."""


@dataclass(frozen=True, kw_only=True)
class SquareRoot:
    """Rows R (r, d), z (r,) and a rest with S = R'R, S_xy = R'z, S_yy = z'z + rest."""

    R: np.ndarray
    z: np.ndarray
    rest: float

    def columns(self, chosen):
        """Square root of the moments of some inputs, and of y."""
        return SquareRoot(R=self.R[:, chosen], z=self.z, rest=self.rest)


def _residual_of_moments(moments, c):
    S_xe = moments.xy - moments.dot(c)
    return S_xe, max(moments.yy - c @ (moments.xy + S_xe), 0.0)


@dataclass(frozen=True, kw_only=True)
class GramMoments:
    """Moments held as the scatter matrix: O(d^2) an iteration, whatever n.

    With `root`, a square root with more digits than the scatter, products go there.
    """

    n: float
    S: np.ndarray
    xy: np.ndarray
    yy: float
    xx: np.ndarray
    root: SquareRoot | None = None

    def dot(self, v):
        """Return S_xx v."""
        if self.root is None:
            return self.S @ v
        return self.root.R.T @ (self.root.R @ v)

    def columns(self, chosen):
        """Moments of some inputs, and of y."""
        return replace(
            self,
            S=self.S[np.ix_(chosen, chosen)],
            xy=self.xy[chosen],
            xx=self.xx[chosen],
            root=None if self.root is None else self.root.columns(chosen),
        )

    def without_last_digits(self):
        """Return the moments on a grid of 2^-36 of the samples' number.

        Summed in another order the same rows give moments that differ by rounding,
        some 1e-15; on the grid they are nearly always the same to the bit. The grid
        itself is far below what n samples determine.
        """
        if self.root is not None:
            return self
        width = 2.0 ** (np.floor(np.log2(self.n)) - 36)
        S, xy = (np.round(x / width) * width for x in (self.S, self.xy))
        yy = float(np.round(self.yy / width) * width)
        return replace(self, S=S, xy=xy, yy=yy, xx=np.diagonal(S).copy())

    def residual(self, c):
        """Return S_xe and S_ee for e = y - c'x."""
        if self.root is None:
            return _residual_of_moments(self, c)
        left = self.root.z - self.root.R @ c
        return self.root.R.T @ left, float(left @ left) + self.root.rest


@dataclass(frozen=True, kw_only=True)
class DataMoments:
    """Moments held as the data themselves: O(n d) an iteration, for d > n."""

    n: float
    X: np.ndarray
    xy: np.ndarray
    yy: float
    xx: np.ndarray

    def without_last_digits(self):
        """Return the moments as they are: rows come in one order only."""
        return self

    def dot(self, v):
        """Return S_xx v."""
        return self.X.T @ (self.X @ v)

    def residual(self, c):
        """Return S_xe and S_ee for e = y - c'x."""
        return _residual_of_moments(self, c)


def exact_fit(moments, share):
    """Whether some linear function leaves at most this share of y's variance.

    Known of rows that are fewer than the inputs, and where there is a square root.
    """
    if isinstance(moments, DataMoments):
        return moments.X.shape[0] <= moments.X.shape[1]
    root = getattr(moments, "root", None)
    return root is not None and root.rest <= share * moments.yy


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
    spread = np.sqrt(np.maximum(xx, 0.0) / n)
    return spread, ~is_constant(spread, x_mean)


def standardise(stats, *, centred):
    """Scale accumulated statistics to unit variance (unit mean square if uncentred)."""
    S, xy, yy = stats.about(centred=centred)
    n = stats.n_samples
    spread, active = _scales(np.diagonal(S), stats.x_mean * centred, n)
    x_scale = spread[active]
    y_scale = float(np.sqrt(yy / n))
    if is_constant(y_scale, stats.y_mean * centred):
        y_scale = 0.0
    y_unit = y_scale or 1.0
    S = S[np.ix_(active, active)] / np.outer(x_scale, x_scale)
    xy, yy = xy[active] / (x_scale * y_unit), yy / y_unit**2
    root = None
    factor = stats.factor_about(centred=centred)
    if factor is not None:
        factor = factor[:, np.append(active, True)] / np.append(x_scale, y_unit)
        factor = triangular(factor)
        R, z = factor[:-1, :-1], factor[:-1, -1]
        root = SquareRoot(R=R, z=z, rest=float(factor[-1, -1] ** 2))
        S, xy, yy = R.T @ R, R.T @ z, float(z @ z) + root.rest
    moments = GramMoments(n=n, S=S, xy=xy, yy=yy, xx=np.diagonal(S).copy(), root=root)
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
        n, x_mean, y_mean, Xc, yc = _centre(X, y, weight, X[0], y[0])
        x_mean, y_mean = X[0] + x_mean, float(y[0] + y_mean)
    else:
        w = np.ones(X.shape[0]) if weight is None else weight
        n, x_mean, y_mean = float(w.sum()), np.zeros(X.shape[1]), 0.0
        root = np.sqrt(w)
        Xc, yc = X * root[:, None], y * root
    spread, active = _scales(np.einsum("ij,ij->j", Xc, Xc), x_mean, n)
    x_scale = spread[active]
    y_scale = float(np.sqrt(yc @ yc / n))
    if is_constant(y_scale, y_mean):
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
