"""Private parts of scikit-learn, gathered here so that one file follows its changes."""

import numpy as np
from sklearn.utils._param_validation import Interval, StrOptions
from sklearn.utils.validation import _check_sample_weight

__all__ = ["Interval", "StrOptions", "check_sample_weight"]


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
