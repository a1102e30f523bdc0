"""Smoothing splines that are kept by their coefficients and evaluated where asked.

The spline of `_smoothing.smooth`, for equidistant samples: its knots are equidistant
too, a whole number of samples apart, so that the same six values of the basis return in
every interval. The normal equations and any stretch of rows are then products with one
small matrix, and a long recording needs memory for its coefficients only.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy import linalg
from scipy.interpolate import BSpline, PPoly

from sklearn_vbjfa._core import _smoothing

_DEGREE = _smoothing.DEGREE
_WIDTH = _DEGREE + 1
# Corrections of the solution; the first leaves eps times the condition number of what
# was wrong, 1e-4 at worst.
_CORRECTIONS = 2
# A velocity below this share of the fastest is none: what is left of a motion long past
# falls through all sizes, down to rounding, whose sign means nothing.
_STANDS_STILL = 2.0**-30


def _pieces():
    """Polynomials of the basis in an interval, highest power first, (6, 6)."""
    basis = PPoly.from_spline(BSpline.basis_element(np.arange(_WIDTH + 1.0)))
    # without the pieces outside the support
    first = np.searchsorted(basis.x, 0.0, side="right") - 1
    c = basis.c[:, first : first + _WIDTH]
    # The j-th function over an interval is in the piece 5 - j of its own support.
    return np.ascontiguousarray(c[:, ::-1])


_POLYNOMIALS = _pieces()


@lru_cache(maxsize=256)
def _basis(step, first, last, order):
    """Values (order 0) or derivatives of the six functions at x = k / step."""
    # For k from `first` to `last`; outside [0, 1] the polynomials continue.
    x = np.arange(first, last + 1) / step
    columns = []
    for c in _POLYNOMIALS.T:
        columns.append(np.polyval(np.polyder(c, order), x))
    table = np.column_stack(columns)
    table.setflags(write=False)
    return table


@dataclass(frozen=True, kw_only=True)
class Spline:
    """Smoothed samples of one signal, as spline coefficients."""

    coef: np.ndarray  # (n_intervals + 5,): coefficients, about `offset`
    offset: float
    per_knot: int  # rows of the recording between knots
    shift: int  # row at which the first knot stands
    h: float  # distance of the knots [s]

    def __call__(self, start, stop, order=0):
        """Evaluate rows start ... stop - 1 of the recording, or a derivative there."""
        # Velocities below a billionth of the fastest are exactly zero.
        per = self.per_knot
        n_intervals = self.coef.size - _DEGREE
        low, high = start - self.shift, stop - 1 - self.shift
        first = min(max(low // per, 0), n_intervals - 1)
        last = min(max(high // per, 0), n_intervals - 1)
        coef = self.coef
        windows = np.empty((last - first + 1, _WIDTH))
        for j in range(_WIDTH):
            windows[:, j] = coef[first + j : last + 1 + j]
        values = (windows @ _basis(per, 0, per - 1, order).T).ravel()
        begin, end = first * per, (last + 1) * per
        values = values[max(low - begin, 0) : max(high + 1 - begin, 0)]
        if low < begin:
            # Rows outside the knots: the polynomials at the ends continue.
            before = _basis(per, low - begin, min(high - begin, -1), order)
            values = np.r_[before @ windows[0], values]
        if high >= end:
            after = _basis(per, per + max(low - end, 0), per + high - end, order)
            values = np.r_[values, after @ windows[-1]]
        if order == 0:
            values += self.offset
            return values
        if order == 1:
            values[np.abs(values) <= self._stands_still] = 0.0
        values /= self.h**order
        return values

    @cached_property
    def _stands_still(self):
        """Largest velocity that is none, times the distance of the knots."""
        # A velocity is a mean of neighbouring differences of the coefficients.
        return _STANDS_STILL * np.abs(np.diff(self.coef)).max()


def fit(x, dt, cutoff, *, every=1, shift=0):
    """Smooth samples (n,) as `_smoothing.smooth`, rows shift, shift + every, ..."""
    # dt [s] is the period of the samples; cutoff [Hz] has a gain of one half, infinity
    # interpolates.
    step, lam = _smoothing.knots_and_penalty(dt, cutoff)
    n = x.shape[0]
    n_intervals = max(1, -(-(n - 1) // step))
    n_coef = n_intervals + _DEGREE
    offset = x.mean()
    # The sums of small numbers first: the penalty is many times larger.
    bands = _gram_bands(n, step, n_coef)
    bands += lam * _penalty_bands(n_coef)
    factor = linalg.cholesky_banded(bands, overwrite_ab=True, check_finite=False)
    coef = np.zeros(n_coef)
    for _ in range(1 + _CORRECTIONS):
        left = _slope(x - offset, coef, step, lam)
        coef += linalg.cho_solve_banded((factor, False), left, check_finite=False)
    return Spline(
        coef=coef, offset=offset, per_knot=every * step, shift=shift, h=step * dt
    )


def _slope(x, coef, step, lam):
    """Minus half the gradient of |x - B c|^2 + lam |D c|^2 at c, shape of c."""
    # The penalty is up to 1e12 times the rest, and the sum of both matrices has lost
    # the digits of what it does to slow motions. Each part by itself has them:
    # differences of neighbours are exact where a motion is slow.
    n, n_intervals = x.size, coef.size - _DEGREE
    basis = _basis(step, 0, step - 1, 0)
    # One interval more, of which the first sample may be on the last knot: the last of
    # its functions is zero there.
    windows = np.zeros((n_intervals + 1, _WIDTH))
    for j in range(_WIDTH):
        part = coef[j : j + n_intervals + 1]
        windows[: part.size, j] = part
    left = -(windows @ basis.T).ravel()
    left[:n] += x
    left[n:] = 0.0
    products = left.reshape(-1, step) @ basis
    slope = np.zeros(coef.size + 1)
    for j in range(_WIDTH):
        slope[j : j + n_intervals + 1] += products[:, j]
    rough = np.diff(coef, _smoothing.ORDER)
    # The transpose of differences is differences of what is padded by zeros.
    pull = np.diff(np.pad(rough, _smoothing.ORDER), _smoothing.ORDER)
    sign = (-1) ** _smoothing.ORDER
    return slope[:-1] - lam * sign * pull


def _gram_bands(n, step, n_coef):
    """Upper bands of the Gram matrix of the basis at n samples."""
    bands = np.zeros((_WIDTH, n_coef))
    basis = _basis(step, 0, step - 1, 0)
    whole, rest = divmod(n, step)
    full, partial = basis.T @ basis, basis[:rest].T @ basis[:rest]
    for i in range(_WIDTH):
        for j in range(i, _WIDTH):
            # band j - i, at column: interval + j
            row = bands[_DEGREE - (j - i)]
            row[j : j + whole] += full[i, j]
            # A last interval that only begins has functions beyond the last knot,
            # which are zero there.
            if rest and j + whole < row.size:
                row[j + whole] += partial[i, j]
    return bands


@lru_cache(maxsize=1)
def _short_penalty_bands():
    return _smoothing.penalty_bands(4 * _WIDTH)


def _penalty_bands(n_coef):
    """Upper bands of the penalty; all columns but those at the ends are the same."""
    short = _short_penalty_bands()
    if n_coef <= short.shape[1]:
        return _smoothing.penalty_bands(n_coef)
    bands = np.empty((_WIDTH, n_coef))
    ends = 2 * _WIDTH
    bands[:, :ends], bands[:, -ends:] = short[:, :ends], short[:, ends:]
    bands[:, ends:-ends] = short[:, ends : ends + 1]
    return bands
