"""When the scatter matrix is not precise enough, and what replaces it.

A scatter matrix holds half the digits of the rows: a direction of the standardised
inputs with the share lambda of the variance is known to rounding / lambda there, and
to the root of that in a QR decomposition of the rows. The scatter is accumulated
first, since it is fast and nearly always enough; its rounding is then compared with
what chance does to the same estimates, and where it is larger a second pass
decomposes the rows.

Weighted centring and scaling of columns, free of any absolute tolerance.

Sufficient statistics of a linear-Gaussian model: count, means and scatter.

Everything the EM and variational updates need of the data is n, the means and the
second moments. They are accumulated about the mean (never as raw moments, whose
differences cancel), they merge exactly, and a row with weight 2 is the row twice.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy import linalg

# Rounding of a column that ought to be constant is a few units in the last place
# of its values; a spread below this fraction of its mean carries no data.
CONSTANT_COLUMN = 32 * np.finfo(np.float64).eps


def is_constant(spread, mean):
    """Whether columns are constant up to rounding, whatever their unit.

    spread, mean : root mean square deviation from the mean, and the mean; about zero,
    the root mean square and zero: then a column is constant only if it is zero.
    """
    noise = CONSTANT_COLUMN * np.abs(mean)
    return spread <= np.maximum(noise, np.finfo(np.float64).tiny)


@dataclass(frozen=True, kw_only=True)
class Standardized:
    """Columns of unit length, weighted by the square root of the row weights.

    Attributes
    ----------
    values : ndarray of shape (n_samples, n_features)
        ``sqrt(weight) * (X - mean) / scale``; zero for a constant column.

    mean : ndarray of shape (n_features,)
        Weighted means, in the unit of each column; zero without centring.

    scale : ndarray of shape (n_features,)
        Lengths of the centred, weighted columns, in the unit of each column; one
        for a constant column.
    """

    values: np.ndarray
    mean: np.ndarray
    scale: np.ndarray


def standardize(X, weight, *, center):
    """Centre the columns at their weighted means and scale them to unit length.

    Dividing by the largest magnitude first keeps squares from overflowing, and the
    second pass of the mean takes away the rounding of the first, so that columns in
    any unit and with any offset are treated alike.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        Columns to standardise; not modified.

    weight : ndarray of shape (n_samples,)
        Strictly positive weights of the rows.

    center : bool
        Whether to subtract the weighted mean. Without it a column is constant only
        if it is zero.

    Returns
    -------
    Standardized
        Standardised columns, means and scales.
    """
    total = weight.sum()
    magnitude = np.maximum(X.max(axis=0), -X.min(axis=0))
    magnitude = np.where(magnitude > 0, magnitude, 1.0)
    values = X / magnitude
    mean = np.zeros(X.shape[1])
    if center:
        for _ in range(2):
            shift = weight @ values / total
            values -= shift
            mean += shift
    values *= np.sqrt(weight)[:, np.newaxis]
    length = np.sqrt(np.einsum("ij,ij->j", values, values))
    constant = is_constant(length / np.sqrt(total), mean)
    values[:, constant] = 0.0
    length[constant] = 1.0
    values /= length
    scale = np.where(constant, 1.0, magnitude * length)
    return Standardized(values=values, mean=mean * magnitude, scale=scale)


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


_EPS = float(np.finfo(float).eps)


def scatter_rounding(stats):
    """Size of the rounding errors of a correlation matrix, as a spectral norm.

    Each entry is a sum over the rows of a block, with an error of the root of their
    number times eps; a symmetric matrix of d x d such errors has the norm 2 sqrt(d).
    """
    d = stats.n_features
    block = min(stats.n_rows, rows_per_block(d))
    return 2 * _EPS * np.sqrt(d * max(block, 1))


def _judge(data, rounding):
    """Say whether rounding shows, and return the directions lost in it.

    Rounding shows in the predictions where it moves them by more than their standard
    errors, sqrt(s2 / n) a direction; and in the output noise s2 where it is more than
    the standard error of s2 itself, s2 sqrt(2 / n).
    """
    m = data.moments
    values, vectors = linalg.eigh(m.S / m.n)
    known = values > rounding
    projection = vectors[:, known].T @ (m.xy / m.n)
    coefficients = projection / values[known]
    s2 = max(m.yy / m.n - projection @ coefficients, 0.0)
    size = 1.0 + coefficients @ coefficients
    moved = rounding**2 * size * np.sum(1.0 / values[known])
    shows = moved > known.sum() * s2 / m.n
    shows |= rounding * size > s2 * np.sqrt(2.0 / m.n)
    return bool(shows), vectors[:, ~known]


def _is_exact(stats, data, directions, X, y, weight):
    """Whether the rows have nothing along the directions but their own rounding.

    The rows' numbers are rounded by eps of their values, offset included; so many of
    them add up in each product.
    """
    scaled = directions / data.x_scale[:, None]
    left = 0.0
    for rows in centred_blocks(stats, X, y, weight):
        along = rows[:, :-1][:, data.active] @ scaled
        left = left + np.einsum("ij,ij->j", along, along)
    offset = stats.x_mean[data.active] / data.x_scale
    unit = _EPS * np.sqrt(data.x_scale.size * (1.0 + np.max(offset**2, initial=0.0)))
    total = X.shape[0] if weight is None else weight.sum()
    return bool(np.all(left <= (4 * unit) ** 2 * total))


def loses_digits(stats, X, y, weight, *, centred):
    """Whether the scatter is too coarse for the data, of which X, y are rows.

    Directions that are lost in the rounding of the scatter do not matter if they are
    exact dependencies, which the rows tell.
    """
    if stats.factor is not None:
        return False
    data = standardise(stats, centred=centred)
    if data.x_scale.size == 0 or data.y_scale == 0.0:
        return False
    shows, lost = _judge(data, scatter_rounding(stats))
    if shows or lost.shape[1] == 0:
        return shows
    return not _is_exact(stats, data, lost, X, y, weight)


def accumulate(X, y, weight, *, centred):
    """Statistics of the rows, with their triangular factor where it is needed."""
    stats = from_data(X, y, weight)
    if stats is not None and loses_digits(stats, X, y, weight, centred=centred):
        stats = with_factor(stats, X, y, weight)
    return stats


def add(before, X, y, weight, *, centred):
    """Statistics of further rows, with a factor if those before have one.

    The first rows decide: later ones come when the factor of the earlier is lost.
    """
    if before is None:
        return accumulate(X, y, weight, centred=centred)
    stats = from_data(X, y, weight)
    if stats is None or before.factor is None:
        return stats
    return with_factor(stats, X, y, weight)
