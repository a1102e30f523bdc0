"""Second moments of inputs X and an output y: accumulated, merged, standardised.

Rows are reduced to `Moments` block by block, never to raw moments, whose differences
cancel; those of disjoint rows add up in any order. A direction of the standardised
inputs with share lambda of the variance is known to rounding / lambda from the scatter,
and to the root of that from a QR decomposition of the rows: a second pass, where the
rounding exceeds the estimates' sampling error.
"""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._core._linear_systems import is_constant, scaled_eigen

_EPS = float(np.finfo(float).eps)

# Rows per block of the one pass over the data: small enough that the centred copy
# of a block stays in the processor's cache, large enough for the matrix product.
_BLOCK_BYTES = 4 << 20


# ------------------------------------------------------------------ rows to moments


@dataclass(frozen=True, kw_only=True)
class Moments:
    """Weighted count, means and scatter of the columns of [X y]; adds up by ``+``."""

    # A row of weight 2 is the row twice. y is the last column throughout.

    n_rows: int
    n_samples: float  # sum of the weights
    mean: np.ndarray  # (n_features + 1,): weighted means
    # (n_features + 1, n_features + 1): sum of w (row - mean)(row - mean)'
    scatter: np.ndarray
    # (n_features + 1,): rounding errors of the means
    mean_low: np.ndarray | float = 0.0
    # (n_features + 1, n_features + 1) or None: R with R'R the scatter, from the rows
    # themselves, with twice its digits
    factor: np.ndarray | None = None

    @property
    def n_features(self):
        """Number of inputs."""
        return self.mean.shape[0] - 1

    @property
    def x_mean(self):
        """Means of the inputs, ndarray of shape (n_features,)."""
        return self.mean[:-1]

    @property
    def y_mean(self):
        """Mean of the output, float."""
        return float(self.mean[-1])

    @property
    def S_xx(self):
        """Scatter of the inputs, ndarray of shape (n_features, n_features)."""
        return self.scatter[:-1, :-1]

    @property
    def S_xy(self):
        """Scatter of the inputs with the output, ndarray of shape (n_features,)."""
        return self.scatter[:-1, -1]

    @property
    def S_yy(self):
        """Scatter of the output, float."""
        return float(self.scatter[-1, -1])

    def __add__(self, other):
        """Merge with the moments of other rows, exactly for any split."""
        # The pairwise update of Chan, Golub and LeVeque (1983); the sum has a
        # triangular factor if both have one.
        n = self.n_samples + other.n_samples
        step = other.mean - self.mean + (other.mean_low - self.mean_low)
        share = other.n_samples / n
        cross = self.n_samples * share
        mean, low = _two_sum(self.mean, self.mean_low + share * step)
        factor = None
        if self.factor is not None and other.factor is not None:
            between = np.sqrt(cross) * step[None]
            factor = triangular(self.factor, other.factor, between)
        return Moments(
            n_rows=self.n_rows + other.n_rows,
            n_samples=n,
            mean=mean,
            scatter=self.scatter + other.scatter + cross * np.outer(step, step),
            mean_low=low,
            factor=factor,
        )

    def scatter_about(self, *, centred):
        """Scatter of [X y] about the means, or about zero."""
        if centred:
            return self.scatter
        return self.scatter + self.n_samples * np.outer(self.mean, self.mean)

    def factor_about(self, *, centred):
        """Triangular factor about the means, or about zero; None if there is none."""
        if centred or self.factor is None:
            return self.factor
        return triangular(self.factor, np.sqrt(self.n_samples) * self.mean[None])


def _two_sum(a, b):
    """Return the rounded sum and its rounding error, exactly (Knuth)."""
    total = a + b
    shifted = total - a
    return total, (a - (total - shifted)) + (b - shifted)


def triangular(*rows):
    """Triangular factor of stacked rows (n, k), ndarray of shape (k, k)."""
    R = np.linalg.qr(np.concatenate(rows), mode="r")
    missing = R.shape[1] - R.shape[0]
    return np.pad(R, ((0, missing), (0, 0))) if missing > 0 else R


def rows_per_block(n_features):
    """Rows summed at a time."""
    return max(256, _BLOCK_BYTES // (8 * max(1, n_features)))


def _with_weight(X, y, weight):
    """Rows (n, d), (n,), (n,) of positive weight."""
    y = np.asarray(y, dtype=float)
    if weight is None or (keep := weight > 0).all():
        return X, y, weight
    return X[keep], y[keep], weight[keep]


def _blocks(X, y, weight, origin):
    """Yield rows [X y] less `origin` (d + 1,), and their weights, in one buffer."""
    # The buffer is reused for each block: allocating one costs as much as filling it.
    n, d = X.shape
    step = min(rows_per_block(d), n)
    buffer = np.empty((step, d + 1))
    for start in range(0, n, step):
        at = slice(start, start + step)
        rows = buffer[: min(step, n - start)]
        np.subtract(X[at], origin[:-1], out=rows[:, :-1])
        np.subtract(y[at], origin[-1], out=rows[:, -1])
        yield rows, None if weight is None else weight[at]


def _centre(rows, weight):
    """Centre rows (n, d + 1) in place, scale by root weight; return (sum, mean)."""
    if weight is None:
        n = float(rows.shape[0])
        mean = rows.mean(axis=0)
    else:
        n = float(weight.sum())
        mean = weight @ rows / n
    rows -= mean
    if weight is not None:
        # The square root on both factors keeps the product symmetric (syrk).
        rows *= np.sqrt(weight)[:, None]
    return n, mean


def from_data(X, y, weight=None):
    """Moments of X (n, d), y (n,) in one pass, block by block; None without weight."""
    # The first row is subtracted from all blocks. Their means, whose differences enter
    # the scatter, then carry no rounding of a large offset, and a constant column is
    # exactly zero; a running sum of a million equal numbers is off by some 1e6 eps.
    X, y, weight = _with_weight(X, y, weight)
    if X.shape[0] == 0:
        return None
    origin = np.append(X[0], y[0]).astype(float)
    total = None
    for rows, w in _blocks(X, y, weight, origin):
        n, mean = _centre(rows, w)
        block = Moments(
            n_rows=rows.shape[0], n_samples=n, mean=mean, scatter=rows.T @ rows
        )
        total = block if total is None else total + block
    mean, low = _two_sum(origin, total.mean)
    return replace(total, mean=mean, mean_low=low + total.mean_low)


def _centred_blocks(moments, X, y, weight):
    """Yield blocks of rows [X y] centred by `moments`, scaled by root weight."""
    X, y, weight = _with_weight(X, y, weight)
    for rows, w in _blocks(X, y, weight, moments.mean):
        rows -= moments.mean_low
        if w is not None:
            rows *= np.sqrt(w)[:, None]
        yield rows


def with_factor(moments, X, y, weight=None):
    """Add the triangular factor of the rows of `moments`."""
    # A second pass: QR decomposition of each block stacked below the current factor.
    factor = np.zeros((0, moments.n_features + 1))
    for rows in _centred_blocks(moments, X, y, weight):
        factor = triangular(factor, rows)
    return replace(moments, factor=factor)


def accumulate(X, y, weight, *, centred, before=None):
    """Moments of the rows, with their triangular factor if needed."""
    # With `before`, moments of earlier rows to be merged with, the factor is kept
    # exactly if those have one: it cannot be recovered later.
    moments = from_data(X, y, weight)
    if moments is None:
        return None
    if before is None:
        needed = loses_digits(moments, X, y, weight, centred=centred)
    else:
        needed = before.factor is not None
    return with_factor(moments, X, y, weight) if needed else moments


# -------------------------------------------------------- moments in standard units


@dataclass(frozen=True, kw_only=True)
class SquareRoot:
    """Rows R (r, d), z (r,) and a rest with S = R'R, S_xy = R'z, S_yy = z'z + rest."""

    R: np.ndarray
    z: np.ndarray
    rest: float


@dataclass(frozen=True, kw_only=True)
class SecondMoments:
    """Standardised moments, as used by the iterations."""

    n: float
    # (d,): diagonal of S_xx, and S_xy, S_yy
    xx: np.ndarray
    xy: np.ndarray
    yy: float
    S: np.ndarray  # (d, d): S_xx
    # square root with more digits than S, used for products
    root: SquareRoot | None = None

    def dot(self, v):
        """Return S_xx v."""
        if self.root is None:
            return self.S @ v
        return self.root.R.T @ (self.root.R @ v)

    def residual(self, c):
        """Return S_xe and S_ee for e = y - c'x."""
        if self.root is None:
            S_xe = self.xy - self.dot(c)
            return S_xe, max(self.yy - c @ (self.xy + S_xe), 0.0)
        left = self.root.z - self.root.R @ c
        return self.root.R.T @ left, float(left @ left) + self.root.rest

    def less(self, c):
        """Moments with y - c'x in place of y."""
        xy, yy = self.residual(c)
        root = self.root
        if root is not None:
            root = replace(root, z=root.z - root.R @ c)
        return replace(self, xy=xy, yy=yy, root=root)

    def columns(self, chosen):
        """Moments of some inputs, and of y."""
        root = self.root
        return replace(
            self,
            S=self.S[np.ix_(chosen, chosen)],
            xy=self.xy[chosen],
            xx=self.xx[chosen],
            root=None if root is None else replace(root, R=root.R[:, chosen]),
        )

    def is_exact(self, share):
        """Whether some linear function leaves at most this share of y's variance."""
        # Known with a square root.
        return self.root is not None and self.root.rest <= share * self.yy

    def without_last_digits(self):
        """Return the moments rounded to a grid of 2^-36 of the number of samples."""
        # Moments of the same rows in another order differ by rounding, some 1e-15; on
        # the grid they are nearly always equal bit for bit. The grid is far finer than
        # n samples resolve. With a square root the order is fixed.
        if self.root is not None:
            return self
        width = 2.0 ** (np.floor(np.log2(self.n)) - 36)
        S, xy = (np.round(x / width) * width for x in (self.S, self.xy))
        yy = float(np.round(self.yy / width) * width)
        return replace(self, S=S, xy=xy, yy=yy, xx=np.diagonal(S).copy())


@dataclass(frozen=True, kw_only=True)
class Standardised:
    """Moments in units of each column's standard deviation, with their scales."""

    # The moments hold only ``active`` columns, which are not constant. ``x_scale``
    # (n_active,) and ``y_scale`` convert back: x = x_scale * standardised; the offsets
    # are the means, zero without centring.

    moments: SecondMoments
    active: np.ndarray
    x_scale: np.ndarray
    y_scale: float
    x_offset: np.ndarray
    y_offset: float

    @property
    def is_degenerate(self):
        """Whether y or all inputs are constant."""
        return self.x_scale.size == 0 or self.y_scale == 0.0

    def expand(self, values, fill=0.0):
        """Spread values of the active columns over all columns."""
        out = np.full(self.active.shape[0], fill, dtype=float)
        out[self.active] = values
        return out


def standardise(moments, *, centred):
    """Scale moments to unit variance (unit mean square if uncentred)."""
    scatter = moments.scatter_about(centred=centred)
    n, mean = moments.n_samples, moments.mean * centred
    spread = np.sqrt(np.maximum(np.diagonal(scatter), 0.0) / n)
    varies = ~is_constant(spread, mean)
    # y is used in any case, in a unit that is not zero.
    used = np.append(varies[:-1], True)
    units = np.where(varies, spread, 1.0)[used]
    scatter = scatter[np.ix_(used, used)] / np.outer(units, units)
    root, factor = None, moments.factor_about(centred=centred)
    if factor is not None:
        factor = triangular(factor[:, used] / units)
        root = SquareRoot(
            R=factor[:-1, :-1], z=factor[:-1, -1], rest=float(factor[-1, -1] ** 2)
        )
        scatter = factor.T @ factor
    S = scatter[:-1, :-1]
    second = SecondMoments(
        n=n,
        S=np.ascontiguousarray(S),
        xy=scatter[:-1, -1].copy(),
        yy=float(scatter[-1, -1]),
        xx=np.diagonal(S).copy(),
        root=root,
    )
    return Standardised(
        moments=second,
        active=varies[:-1],
        x_scale=units[:-1],
        y_scale=float(spread[-1]) if varies[-1] else 0.0,
        x_offset=mean[:-1],
        y_offset=float(mean[-1]),
    )


# ------------------------------------------------------- the rounding of the scatter


def scatter_rounding(moments):
    """Size of the rounding errors of a correlation matrix, as a spectral norm."""
    # Each entry is a sum over the rows of a block, with an error of the root of their
    # number times eps; a symmetric matrix of d x d such errors has the norm 2 sqrt(d).
    d = moments.n_features
    block = min(moments.n_rows, rows_per_block(d))
    return 2 * _EPS * np.sqrt(d * max(block, 1))


def _judge(second, rounding):
    """Whether rounding is significant, and the directions (d, k) lost in it."""
    # It is significant if it changes the predictions by more than their standard
    # error, sqrt(s2 / n) per direction, or the output noise s2 by more than its
    # standard error, s2 sqrt(2 / n).
    n, r = second.n, second.xy / second.n
    eigen = scaled_eigen(second.S / n, rounding, scale=1.0, relative=False)
    values, vectors = eigen.known_values, eigen.known_vectors
    projection = vectors.T @ r
    coefficients = projection / values
    s2 = max(second.yy / n - projection @ coefficients, 0.0)
    size = 1.0 + coefficients @ coefficients
    moved = rounding**2 * size * np.sum(1.0 / values)
    shows = moved > eigen.rank * s2 / n
    shows |= rounding * size > s2 * np.sqrt(2.0 / n)
    return bool(shows), eigen.null_space


def _is_exact(moments, data, directions, X, y, weight):
    """Whether the rows vanish along the directions, up to their own rounding."""
    # Each entry is rounded by eps of its value, offset included; the rounding of all
    # columns adds up in each product.
    # Inactive columns and y do not enter.
    scaled = np.zeros((data.active.size + 1, directions.shape[1]))
    scaled[:-1][data.active] = directions / data.x_scale[:, None]
    left, shift = 0.0, (moments.mean_low * np.ones(scaled.shape[0])) @ scaled
    for rows, w in _blocks(*_with_weight(X, y, weight), moments.mean):
        squares = (rows @ scaled - shift) ** 2
        left = left + (squares.sum(axis=0) if w is None else w @ squares)
    offset = moments.x_mean[data.active] / data.x_scale
    unit = _EPS * np.sqrt(data.x_scale.size * (1.0 + np.max(offset**2, initial=0.0)))
    total = X.shape[0] if weight is None else weight.sum()
    return bool(np.all(left <= (4 * unit) ** 2 * total))


def loses_digits(moments, X, y, weight, *, centred):
    """Whether the scatter is too inaccurate for the data, of which X, y are rows."""
    # Directions lost in the rounding of the scatter do not matter if they are exact
    # dependencies, which is checked on the rows.
    if moments.factor is not None:
        return False
    data = standardise(moments, centred=centred)
    if data.is_degenerate:
        return False
    shows, lost = _judge(data.moments, scatter_rounding(moments))
    if shows or lost.shape[1] == 0:
        return shows
    return not _is_exact(moments, data, lost, X, y, weight)
