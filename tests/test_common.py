"""scikit-learn's own checks, with no expected failure."""

import pytest
from sklearn.utils.estimator_checks import parametrize_with_checks

from sklearn_vbjfa import JFARegressor, VBJFARegressor

ESTIMATORS = [
    JFARegressor(),
    JFARegressor(query="noisy"),
    VBJFARegressor(),
    VBJFARegressor(prior="paper"),
    VBJFARegressor(latent="correlated"),
]


@parametrize_with_checks(ESTIMATORS)
def test_estimator(estimator, check):
    check(estimator)
