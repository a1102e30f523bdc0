"""The data at the door of all regressors, and the prediction of the linear ones."""

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils._param_validation import Interval, StrOptions
from sklearn.utils.validation import (
    _check_sample_weight,
    check_is_fitted,
    validate_data,
)

from sklearn_vbjfa._core._linear_systems import unit_columns

# Columns that are larger, or smaller than its inverse, have no squares to sum.
LARGEST = 1e100
# Private parts of scikit-learn come from here alone.
__all__ = ["Interval", "StrOptions", "check_sample_weight"]


class BaseRegressor(RegressorMixin, BaseEstimator):
    """Validation of parameters, rows and queries."""

    def _check_rows(self, X, y, sample_weight, *, min_samples=1, reset=True):
        """Validate parameters and rows; return X, y, and weights or None."""
        self._validate_params()
        X, y = validate_data(
            self,
            X,
            y,
            dtype=np.float64,
            y_numeric=True,
            ensure_min_samples=min_samples,
            reset=reset,
        )
        names = getattr(self, "feature_names_in_", range(X.shape[1]))
        names = [f"column {name} of X" for name in names]
        check_sizes(np.column_stack([X, y]), names)
        if sample_weight is None:
            return X, y, None
        return X, y, check_sample_weight(sample_weight, X)

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
        d = coef.size
        self.coef_ = coef
        self.intercept_ = float(mean[d] - mean[:d] @ coef)


def check_sizes(columns, names):
    """Refuse columns (n, d + 1) of [X y] in units in which their squares overflow."""
    size = np.abs(columns).max(axis=0)
    wrong = (size > LARGEST) | ((size > 0) & (size < 1 / LARGEST))
    if wrong.any():
        k = int(np.argmax(wrong))
        raise ValueError(
            f"The largest value of {[*names, 'y'][k]} is {size[k]:.3g}, expected "
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
