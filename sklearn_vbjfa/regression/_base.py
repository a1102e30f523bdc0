"""Validation of data and input noise for all regressors, and linear prediction."""

import warnings
from dataclasses import replace

import numpy as np
from scipy import linalg
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils import check_array
from sklearn.utils._param_validation import Interval, StrOptions
from sklearn.utils.validation import (
    _check_sample_weight,
    check_is_fitted,
    validate_data,
)

from sklearn_vbjfa._core._correlated import direct_share
from sklearn_vbjfa._core._linear_systems import or_one, scaled_eigen, unit_columns
from sklearn_vbjfa._core._runtime import one_blas_thread

# Largest magnitude of a column, and inverse of the smallest, with a finite square sum.
LARGEST = 1e100
# Share of a covariance outside of the span of the noise that counts as rounding.
_OF_RANGE = 1e-6
# The only import of private parts of scikit-learn.
__all__ = ["Interval", "StrOptions", "check_sample_weight"]


class BaseRegressor(RegressorMixin, BaseEstimator):
    """Validation of parameters, rows and queries; subclasses fit in `_fit_rows`."""

    # Fewest rows of a fit.
    _min_samples = 2

    @one_blas_thread()
    def fit(self, X, y, sample_weight=None):
        """Fit the model.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Inputs.
        y : array-like of shape (n_samples,)
            Output.
        sample_weight : array-like of shape (n_samples,), default=None
            Numbers of repetitions, not normalised: a weight of 2 is the row twice.

        Returns
        -------
        self : object
            Fitted estimator.
        """
        self._fit_rows(*self._check_rows(X, y, sample_weight))
        return self

    def _check_rows(self, X, y, sample_weight, *, min_samples=None, reset=True):
        """Validate parameters and rows; return X, y, and weights or None."""
        self._validate_params()
        X, y = validate_data(
            self,
            X,
            y,
            dtype=np.float64,
            y_numeric=True,
            ensure_min_samples=min_samples or self._min_samples,
            reset=reset,
        )
        # Outputs keep their precision above, inputs do not.
        y = y.astype(np.float64, copy=False)
        names = getattr(self, "feature_names_in_", range(X.shape[1]))
        check_sizes(X, [f"column {name} of X" for name in names])
        check_sizes(y[:, None], ["y"])
        if sample_weight is None:
            return X, y, None
        weight = check_sample_weight(sample_weight, X)
        few = min(np.count_nonzero(weight), weight.sum()) < 1 + 1e-9
        if few and min_samples is None and self._min_samples > 1:
            raise ValueError(
                "sample_weight must be positive for 2 samples and sum up to more than "
                f"1, got {np.count_nonzero(weight)} and {weight.sum():.3g}. It counts "
                "repetitions: scale it to sum up to the number of samples."
            )
        return X, y, weight

    def _check_queries(self, X):
        """Validate the inputs (n_samples, n_features) of a prediction."""
        check_is_fitted(self)
        return validate_data(self, X, dtype=np.float64, reset=False)


class LinearRegressor(BaseRegressor):
    """Coefficients and intercept on columns of unit length."""

    def predict(self, X):
        """Predict the output for inputs as they are.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Inputs.

        Returns
        -------
        ndarray of shape (n_samples,)
            Predicted output [unit of y].
        """
        return self._check_queries(X) @ self.coef_ + self.intercept_

    def _unit_columns(self, blocks, weight):
        """Columns of the blocks, side by side, of unit length; (columns, sum of w)."""
        rows = np.column_stack(blocks)
        if weight is None:
            weight = np.ones(rows.shape[0])
        used = weight > 0
        columns = unit_columns(rows[used], weight[used], center=self.fit_intercept)
        return columns, weight.sum()

    def _set_coefficients(self, coef, mean):
        """Set coefficients (d,) and the intercept, given the means of [X y ...]."""
        self.coef_, d = coef, coef.size
        self.intercept_ = float(mean[d] - mean[:d] @ coef)


def check_sizes(columns, names):
    """Refuse columns (n, d) in units in which their squares overflow."""
    size = np.abs(columns).max(axis=0)
    wrong = (size > LARGEST) | ((size > 0) & (size < 1 / LARGEST))
    if wrong.any():
        k = int(np.argmax(wrong))
        raise ValueError(
            f"The largest value of {names[k]} is {size[k]:.3g}, expected "
            f"between {1 / LARGEST:g} and {LARGEST:g}. Choose another unit."
        )


def check_sample_weight(sample_weight, X):
    """Return float64 weights (n,) of the rows of X (n, d), none negative, not all 0."""
    weight = _check_sample_weight(sample_weight, X, dtype=np.float64)
    if weight.min() < 0:
        raise ValueError(
            "sample_weight must not be negative, got a smallest weight of "
            f"{weight.min():.6g}; give 0 to leave a sample out."
        )
    # Recent versions of scikit-learn raise this themselves, in these words.
    if not weight.any():
        raise ValueError("Sample weights must contain at least one non-zero number.")
    return weight


def resolve_input_noise(input_noise, n_features):
    """Validate the user's input noise; return None, a fraction, (d,) or (d, d)."""
    if input_noise is None:
        return None
    value = np.asarray(input_noise, dtype=float)
    if not np.isfinite(value).all():
        raise ValueError("input_noise must be finite, got NaN or infinity.")
    if value.ndim == 0:
        if not 0 <= value < 1:
            raise ValueError(
                f"input_noise as a number is a fraction of each input's variance in "
                f"[0, 1), got {float(value):.6g}; give variances as an array."
            )
        return float(value)
    if value.shape == (n_features,):
        if value.min() < 0:
            raise ValueError(
                f"input_noise variances must not be negative, got {value.min():.6g} "
                f"for feature {int(value.argmin())}; give 0 for an exact input."
            )
        return value
    if value.shape == (n_features, n_features):
        scale = np.sqrt(np.abs(np.diagonal(value)))
        unit = np.outer(scale, scale)
        if (np.abs(value - value.T) > 1e-8 * unit).any():
            raise ValueError("input_noise as a covariance must be symmetric.")
        scale = or_one(scale)
        smallest = scaled_eigen(0.5 * (value + value.T), scale=scale).values[0]
        if smallest < -1e-8 or (np.diagonal(value) < 0).any():
            raise ValueError(
                "input_noise as a covariance must be positive semidefinite, got a "
                f"smallest eigenvalue of {smallest:.3g} in units of its diagonal."
            )
        return 0.5 * (value + value.T)
    raise ValueError(
        f"input_noise must be a fraction, variances of shape ({n_features},) or a "
        f"covariance of shape ({n_features}, {n_features}) for {n_features} features, "
        f"got an array of shape {value.shape}."
    )


def standard_noise(noise, data):
    """Noise covariance (d, d) of the standardised active columns; None is unknown."""
    if noise is None:
        return None
    if np.ndim(noise) == 0:
        return noise * np.eye(data.x_scale.size)
    full = np.diag(noise) if np.ndim(noise) == 1 else noise
    unit = np.outer(data.x_scale, data.x_scale)
    return full[np.ix_(data.active, data.active)] / unit


def resolve_cross_noise(cross, noise, data):
    """Validate a covariance of the noise of inputs and output; standardised (d,)."""
    if cross is None:
        return None
    value = check_array(cross, ensure_2d=False, input_name="input_output_noise")
    if value.shape != data.active.shape:
        raise ValueError(
            f"input_output_noise must hold {data.active.size} covariances, one for "
            f"each input; got an array of shape {value.shape}."
        )
    if noise is None:
        raise ValueError(
            "input_output_noise needs the noise of the inputs as well: give "
            "input_noise as variances or a covariance."
        )
    psi = standard_noise(noise, data)
    cross = value[data.active] / (data.x_scale * (data.y_scale or 1.0))
    direct = direct_share(psi, cross)
    off = np.abs(psi @ direct - cross)
    bad = np.flatnonzero(off > _OF_RANGE * np.abs(cross).max(initial=0.0))
    if bad.size:
        raise ValueError(
            "input_output_noise must be a covariance with noise that the inputs have; "
            f"for input {np.flatnonzero(data.active)[bad[0]]} input_noise says that "
            "there is none. Give its variance in input_noise, or zero here."
        )
    if (times := cross @ direct) > 1.0:
        warnings.warn(
            f"input_output_noise makes noise of {times:.3g} times the variance of y: "
            f"at most {times**-0.5:.3g} of it is possible. Check the units of "
            "input_noise and input_output_noise.",
            UserWarning,
            stacklevel=8,
        )
    return cross


def noise_shares(noise, data, names):
    """Shares (n_active,) of the inputs' variances that are noise, None if unknown."""
    if noise is None:
        return None
    if np.ndim(noise) == 2 and np.any(noise - np.diag(np.diagonal(noise))):
        raise ValueError(
            "input_noise with covariances between inputs needs "
            'VBJFARegressor(latent="correlated"); independent latents take the '
            "variances alone: np.diagonal of it, shape (n_features,)."
        )
    psi = standard_noise(noise, data)
    warn_of_excess(data, psi, names)
    return np.minimum(np.diagonal(psi), 1.0)


def warn_of_excess(data, psi, names, *, cross=None, dof=np.inf):
    """Warn of a noise covariance (d, d) that exceeds the covariance of the data."""
    m, labels = data.moments, np.flatnonzero(data.active)
    if data.is_degenerate:
        return
    if (full := np.diagonal(psi) / (m.xx / m.n) > 1 - 1e-9).any():
        shown = ", ".join(str(names[i]) for i in labels[full][:10])
        text = (
            f"at least the whole variance of {full.sum()} input(s) ({shown}): no signal"
        )
    else:
        # The covariance of the inputs given y, without the noise that it shares with
        # them, contains their noise, to three deviations of sampled eigenvalues.
        extra, given = np.sqrt(m.xx.size) + 3.0, m
        if cross is not None:
            given = replace(m, z=m.z - m.R @ direct_share(psi, cross))
        inside = (m.S - np.outer(given.xy, given.xy) / (given.yy or 1.0)) / m.n
        least = max(1.0 - extra / np.sqrt(m.n), 0.0) / (1.0 + extra / np.sqrt(dof))
        values, vectors = linalg.eigh(inside - least**2 * psi)
        if values[0] >= -1e-12:
            return
        v = vectors[:, 0]
        times = v @ psi @ v / max(v @ inside @ v, 1e-12)
        most = ", ".join(str(names[i]) for i in labels[np.argsort(-np.abs(v))[:2]])
        text = f"{times:.2g} times the variance, given y, along inputs {most}"
    warnings.warn(
        f"input_noise is {text}. Check its units (variances, not standard deviations) "
        "and whether y shares noise with the inputs (input_output_noise).",
        UserWarning,
        stacklevel=9,
    )
