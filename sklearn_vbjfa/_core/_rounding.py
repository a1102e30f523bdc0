"""When the scatter matrix is not precise enough, and what replaces it.

A scatter matrix holds half the digits of the rows: a direction of the standardised
inputs with the share lambda of the variance is known to rounding / lambda there, and
to the root of that in a QR decomposition of the rows. The scatter is accumulated
first, since it is fast and nearly always enough; its rounding is then compared with
what chance does to the same estimates, and where it is larger a second pass
decomposes the rows.
"""

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core import _stats

_EPS = float(np.finfo(float).eps)


def scatter_rounding(stats):
    """Size of the rounding errors of a correlation matrix, as a spectral norm.

    Each entry is a sum over the rows of a block, with an error of the root of their
    number times eps; a symmetric matrix of d x d such errors has the norm 2 sqrt(d).
    """
    d = stats.n_features
    block = min(stats.n_rows, _stats.rows_per_block(d))
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
    for rows in _stats.centred_blocks(stats, X, y, weight):
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
    data = _stats.standardise(stats, centred=centred)
    if data.x_scale.size == 0 or data.y_scale == 0.0:
        return False
    shows, lost = _judge(data, scatter_rounding(stats))
    if shows or lost.shape[1] == 0:
        return shows
    return not _is_exact(stats, data, lost, X, y, weight)


def accumulate(X, y, weight, *, centred):
    """Statistics of the rows, with their triangular factor where it is needed."""
    stats = _stats.from_data(X, y, weight)
    if stats is not None and loses_digits(stats, X, y, weight, centred=centred):
        stats = _stats.with_factor(stats, X, y, weight)
    return stats


def add(before, X, y, weight, *, centred):
    """Statistics of further rows, with a factor if those before have one.

    The first rows decide: later ones come when the factor of the earlier is lost.
    """
    if before is None:
        return accumulate(X, y, weight, centred=centred)
    stats = _stats.from_data(X, y, weight)
    if stats is None or before.factor is None:
        return stats
    return _stats.with_factor(stats, X, y, weight)
