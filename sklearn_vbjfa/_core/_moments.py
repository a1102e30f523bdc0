"""Second moments of inputs X and an output y: accumulated, merged, standardised.

Rows are reduced block by block to a triangular factor, by QR decompositions: those of
disjoint rows merge in any order, and a direction of the standardised inputs with share
lambda of the variance is known to rounding / sqrt(lambda), with twice the digits of a
scatter matrix.
"""

import functools
from collections import namedtuple
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from sklearn_vbjfa._core._linear_systems import ROUNDING, is_constant, or_one

# Memory of the rows that are factored at a time, to stay in the processor's cache.
_BLOCK_BYTES = 1 << 18
# Share of the square of y that a scatter matrix resolves above rounding: the residual
# is a difference of sums of products.
OUTPUT_FLOOR = 1e-12
# Binary digits of moments, in units of the number of samples, that are kept by
# `without_last_digits`: far more than the samples resolve.
_DIGITS = 36


# ------------------------------------------------------------------ rows to moments


@dataclass(frozen=True, kw_only=True)
class Moments:
    """Weighted count, means and scatter of the columns of [X y]; adds up by ``+``."""

    # A row of weight 2 equals two rows. y is the last column throughout.

    n_samples: float  # sum of the weights
    # (n_features + 1,): one of the rows, subtracted from all
    origin: np.ndarray
    # (rows, n_features + 2): triangular factor of sqrt(w) [1, row - origin]
    factor: np.ndarray

    @property
    def mean(self):
        """Weighted means, ndarray of shape (n_features + 1,)."""
        return self.origin + self.factor[0, 1:] / self.factor[0, 0]

    def __add__(self, other):
        """Merge with the moments of other rows, exactly for any split."""
        moved = _counted_from(other, self.origin)
        return Moments(
            n_samples=self.n_samples + other.n_samples,
            origin=self.origin,
            factor=triangular(np.concatenate([self.factor, moved])),
        )

    def factor_about(self, *, centred):
        """Factor of [X y] about the means, or about zero, (rows, n_features + 1)."""
        if centred:
            return self.factor[1:, 1:]
        return triangular(_counted_from(self, 0.0)[:, 1:])


def _counted_from(moments, origin):
    """Rows of a factor relative to another origin."""
    rows = moments.factor.copy()
    rows[:, 1:] += rows[:, :1] * (moments.origin - origin)
    return rows


def triangular(rows):
    """Triangular factor (min(n, k), k) of rows (n, k), which are overwritten."""
    k = rows.shape[1]
    if not rows.size:
        return rows
    # With space for blocks of columns, many columns take half the time.
    return np.triu(lapack.dgeqrf(rows, lwork=64 * k, overwrite_a=True)[0][:k])


def from_data(X, y, weight=None):
    """Moments of X (n, d), y (n,) in one pass, block by block."""
    # The first row is subtracted from all: a large offset does not round the others,
    # and a constant column is exactly zero.
    y = np.asarray(y, dtype=float)
    if weight is not None and not (keep := weight > 0).all():
        X, y, weight = X[keep], y[keep], weight[keep]
    n, d = X.shape
    origin = np.append(X[0], y[0]).astype(float)
    factor, step = np.zeros((0, d + 2)), max(2 * d, _BLOCK_BYTES // (8 * (d + 2)))
    for start in range(0, n, step):
        at = slice(start, start + step)
        rows = np.empty((factor.shape[0] + y[at].size, d + 2), order="F")
        new = rows[factor.shape[0] :]
        rows[: factor.shape[0]], new[:, 0] = factor, 1.0
        np.subtract(X[at], origin[:-1], out=new[:, 1:-1])
        np.subtract(y[at], origin[-1], out=new[:, -1])
        if weight is not None:
            new *= np.sqrt(weight[at])[:, None]
        factor = triangular(rows)
    n_samples = float(n if weight is None else weight.sum())
    return Moments(n_samples=n_samples, origin=origin, factor=factor)


# Sum of the weights, and sums of products (d, d), (d,) and a float of the columns of
# [X y], without the rows.
Scatter = namedtuple("Scatter", "n_samples S_xx S_xy S_yy")


def from_scatter(sums):
    """Moments about zero from a `Scatter`, whose resolution of y counts as noise."""
    p = sums.S_xy.size + 1
    scatter = np.empty((p, p))
    scatter[:-1, :-1], scatter[-1, -1] = sums.S_xx, sums.S_yy
    scatter[-1, :-1] = scatter[:-1, -1] = sums.S_xy
    unit = or_one(np.sqrt(np.diagonal(scatter)))
    scaled = scatter / np.outer(unit, unit)
    root = square_root(1.0, scaled[:-1, :-1], scaled[:-1, -1], scaled[-1, -1])
    factor = np.zeros((p + 1, p + 1))
    factor[0, 0] = np.sqrt(sums.n_samples)
    inside = slice(1, 1 + root.z.size)
    factor[inside, 1:-1], factor[inside, -1] = root.R, root.z
    factor[-1, -1] = np.sqrt(root.rest + OUTPUT_FLOOR * scaled[-1, -1])
    factor[1:, 1:] *= unit
    return Moments(n_samples=sums.n_samples, origin=np.zeros(p), factor=factor)


# -------------------------------------------------------- moments in standard units


@dataclass(frozen=True, kw_only=True)
class SecondMoments:
    """Standardised moments, as used by the iterations."""

    # Rows R (r, d), z (r,) and a rest: S_xx = R'R, S_xy = R'z, S_yy = z'z + rest.

    n: float
    R: np.ndarray
    z: np.ndarray
    rest: float

    @functools.cached_property
    def S(self):
        return self.R.T @ self.R

    @functools.cached_property
    def xx(self):
        return np.diagonal(self.S).copy()

    @functools.cached_property
    def xy(self):
        return self.R.T @ self.z

    @functools.cached_property
    def yy(self):
        return float(self.z @ self.z) + self.rest

    def residual(self, c):
        """Return S_xe and S_ee for e = y - c'x."""
        left = self.z - self.R @ c
        return self.R.T @ left, float(left @ left) + self.rest

    def columns(self, chosen):
        """Moments of some inputs, and of y."""
        return replace(self, R=self.R[:, chosen])

    def without_last_digits(self):
        """Return the moments rounded to a grid."""
        # Moments of the same rows in another order differ by rounding, about 1e-15; on
        # the grid they are nearly always equal bit for bit.
        width = 2.0 ** (np.floor(np.log2(self.n)) - _DIGITS)
        S, xy, yy = (np.round(x / width) * width for x in (self.S, self.xy, self.yy))
        return Products(n=self.n, S=S, xy=xy, yy=float(yy), xx=np.diagonal(S).copy())


@dataclass(frozen=True, kw_only=True)
class Products:
    """Sums of products on a grid, equal bit for bit for any order of the rows."""

    n: float
    S: np.ndarray
    xx: np.ndarray
    xy: np.ndarray
    yy: float

    def residual(self, c):
        S_xe = self.xy - self.S @ c
        return S_xe, max(self.yy - c @ (self.xy + S_xe), 0.0)


def square_root(n, S, xy, yy):
    """`SecondMoments` of sums of products, without the rounding of their null space."""
    # Pivots at rounding level are set to zero: otherwise they would act as information
    # once the noise is small enough.
    d = xy.size
    largest = np.abs(np.diagonal(S)).max(initial=0.0)
    # With pivoting, rounding errors come last.
    factor, pivots, rank, _ = lapack.dpstrf(S, tol=d * ROUNDING * largest)
    order = pivots - 1
    R = np.empty((rank, d))
    R[:, order] = np.triu(factor[:rank])
    z = linalg.solve_triangular(factor[:rank, :rank], xy[order[:rank]], trans="T")
    return SecondMoments(n=n, R=R, z=z, rest=max(float(yy - z @ z), 0.0))


@dataclass(frozen=True, kw_only=True)
class Standardised:
    """Moments in units of each column's standard deviation, with their scales."""

    # The moments contain only ``active`` columns, which are not constant. ``x_scale``
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
    factor, mean = moments.factor_about(centred=centred), moments.mean * centred
    n = moments.n_samples
    spread = np.sqrt((factor**2).sum(axis=0) / n)
    varies = ~is_constant(spread, mean)
    # y is used in any case, in a unit that is not zero.
    used = np.append(varies[:-1], True)
    units = np.where(varies, spread, 1.0)[used]
    R, d = triangular(factor[:, used] / units), units.size - 1
    rest = float((R[d:, -1] ** 2).sum())
    return Standardised(
        moments=SecondMoments(n=n, R=R[:d, :-1], z=R[:d, -1], rest=rest),
        active=varies[:-1],
        x_scale=units[:-1],
        y_scale=float(spread[-1]) if varies[-1] else 0.0,
        x_offset=mean[:-1],
        y_offset=float(mean[-1]),
    )
