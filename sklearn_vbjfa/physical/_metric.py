"""Metric of the projection: validation, square root, and what it cannot see."""

import warnings
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.physical._threads import one_blas_thread

# How many times longer than the visible part of a vector its hidden part may be before
# it is taken for rounding; a plausible robot's are of one order.
_HIDDEN_LIMIT = 100.0


@dataclass(frozen=True, kw_only=True)
class Metric:
    """Validated metric with its square root.

    Attributes
    ----------
    matrix : ndarray of shape (n_features, n_features)
        Symmetric positive semidefinite `A`.
    root : ndarray of shape (n_features, n_features)
        `R` with ``R' R = A``.
    size : ndarray of shape (n_features,)
        Square root of the diagonal.
    basis : ndarray of shape (n_features, n_visible)
        Orthonormal basis of what `A` sees, in units of `size`.
    """

    matrix: np.ndarray
    root: np.ndarray
    size: np.ndarray
    basis: np.ndarray

    def without_rounding(self, theta):
        """Drop what the metric does not see where it dwarfs what it sees.

        A least-squares solve that does not cut its singular values returns 1e10 and
        more along the directions without information.  Such numbers say nothing, and
        neither scales nor anchors may come from them.

        Parameters
        ----------
        theta : ndarray of shape (n_features,)
            Parameter vector.

        Returns
        -------
        theta : ndarray of shape (n_features,)
            The vector, or its visible part.
        """
        standardised = theta * self.size
        visible = self.basis @ (self.basis.T @ standardised)
        hidden = np.linalg.norm(standardised - visible)
        if hidden <= _HIDDEN_LIMIT * np.linalg.norm(visible):
            return theta
        warnings.warn(
            f"The part of theta that the metric does not see is {hidden:.1e} long in "
            f"units of the metric, the part it sees {np.linalg.norm(visible):.1e}: "
            "taken for the rounding of a singular regression and replaced by the "
            "shortest vector that predicts the same. Fit with a regressor that cuts "
            "small singular values.",
            UserWarning,
            stacklevel=4,
        )
        return np.divide(
            visible, self.size, out=np.zeros_like(theta), where=self.size > 0
        )


@one_blas_thread()
def check_metric(metric, n_features):
    """Validate a metric and take its square root.

    Parameters
    ----------
    metric : array-like of shape (n_features, n_features)
        Symmetric positive semidefinite matrix.
    n_features : int
        Length of the parameter vectors.

    Returns
    -------
    metric : Metric
        The symmetric part and its square root.

    Raises
    ------
    ValueError
        If the shape is wrong, a value is not finite, or the matrix is not symmetric
        or not positive semidefinite beyond rounding.
    """
    metric = np.asarray(metric, dtype=float)
    if metric.shape != (n_features, n_features):
        raise ValueError(
            f"metric must have shape ({n_features}, {n_features}), one row and column "
            f"per parameter, got {metric.shape}."
        )
    if not np.all(np.isfinite(metric)):
        raise ValueError("metric must be finite; it contains NaN or infinity.")
    diagonal = np.diag(metric)
    if np.any(diagonal < 0):
        raise ValueError(
            "metric must be positive semidefinite; its diagonal has a negative entry "
            f"({diagonal.min():.3g} at {int(diagonal.argmin())})."
        )
    # Compared in units of the diagonal: the entries of a Gram matrix carry the units
    # of two parameters and may be many orders of magnitude apart.
    size = np.sqrt(diagonal)
    inverse = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    unit_free = metric * inverse * inverse[:, None]
    rounding = n_features * np.finfo(float).eps * np.abs(metric).max(initial=0.0)
    asymmetry = np.abs(metric - metric.T)
    if np.any((asymmetry > rounding) & (np.abs(unit_free - unit_free.T) > 1e-8)):
        raise ValueError(
            "metric must be symmetric; the largest difference between an entry and its "
            f"mirror image is {asymmetry.max():.3g}. Pass (A + A.T) / 2 if rounding "
            "made it so."
        )
    metric = 0.5 * (metric + metric.T)
    correlation = 0.5 * (unit_free + unit_free.T)
    eigenvalue, basis = np.linalg.eigh(correlation)
    # A matrix computed in its own units (a clipped eigendecomposition) is semidefinite
    # to rounding in those, though perhaps not in units of a tiny diagonal.
    if eigenvalue[0] < -1e-10 * max(eigenvalue[-1], 1.0) or np.any(
        np.abs(metric[size == 0]) > 0
    ):
        raw = np.linalg.eigvalsh(metric)[0]
        if raw < -10 * rounding:
            raise ValueError(
                "metric must be positive semidefinite; its smallest eigenvalue is "
                f"{raw:.3g}. A Gram matrix from which a noise covariance was "
                "subtracted has to be clipped first."
            )
    visible = eigenvalue > n_features * np.finfo(float).eps * max(eigenvalue[-1], 0.0)
    eigenvalue[~visible] = 0.0
    return Metric(
        matrix=metric,
        root=np.sqrt(eigenvalue)[:, None] * basis.T * size,
        size=size,
        basis=basis[:, visible],
    )
