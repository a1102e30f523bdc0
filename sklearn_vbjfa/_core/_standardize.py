"""Weighted centring and scaling of columns, free of any absolute tolerance."""

from dataclasses import dataclass

import numpy as np

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
