"""Private parts of scikit-learn, gathered here so that one file follows its changes."""

import numpy as np
from sklearn.utils._param_validation import Interval, StrOptions
from sklearn.utils.validation import _check_sample_weight

__all__ = ["Interval", "StrOptions", "check_sample_weight"]


def check_sample_weight(sample_weight, X):
    """Return float64 weights of the rows of X, none negative and not all zero.

    Parameters
    ----------
    sample_weight : array-like of shape (n_samples,), float or None
        Weights; ``None`` means ones.

    X : ndarray of shape (n_samples, n_features)
        Validated data.

    Returns
    -------
    ndarray of shape (n_samples,)
        Validated weights.
    """
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
