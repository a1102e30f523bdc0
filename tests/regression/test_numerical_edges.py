"""Units out of range, and at its limits."""

import numpy as np
import pytest

from sklearn_vbjfa import (
    InstrumentalVariables,
    JFARegressor,
    LocallyWeightedRegressor,
    StepwiseRegressor,
    TotalLeastSquares,
    VBJFARegressor,
)

ESTIMATORS = [
    InstrumentalVariables(),
    JFARegressor(),
    LocallyWeightedRegressor(),
    StepwiseRegressor(),
    TotalLeastSquares(),
    VBJFARegressor(),
    VBJFARegressor(latent="independent"),
]


def make_data(n=60):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(n, 3))
    return X, X @ [1.0, -2.0, 0.0] + 0.1 * rng.normal(size=n)


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)
@pytest.mark.parametrize("scale", [1e-200, 1e200])
def test_units_out_of_range_are_refused_by_name(estimator, scale):
    X, y = make_data()
    with pytest.raises(ValueError, match=r"column 1 of X is .* another unit"):
        estimator.fit(X * [1.0, scale, 1.0], y)
    with pytest.raises(ValueError, match=r"of y is .* another unit"):
        estimator.fit(X, y * scale)


@pytest.mark.parametrize("estimator", [JFARegressor(), VBJFARegressor()])
def test_coefficients_out_of_range_are_refused(estimator):
    X, y = make_data()
    with pytest.raises(ValueError, match="Choose other units"):
        estimator.fit(X * 1e-90, y * 1e90)


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)
def test_units_at_the_limits_of_the_range(estimator):
    X, y = make_data()
    expected = estimator.fit(X, y).predict(X)
    # One unit for inputs and output: TotalLeastSquares compares them.
    for scale in (2.0**-220, 2.0**220):
        found = estimator.fit(X * scale, y * scale).predict(X * scale)
        np.testing.assert_allclose(found / scale, expected, rtol=1e-8, atol=1e-8)
        if hasattr(estimator, "coef_std_"):
            assert np.isfinite(estimator.coef_std_).all()
    # Single precision gives no warning.
    X, y = X.astype(np.float32), y.astype(np.float32)
    np.testing.assert_allclose(estimator.fit(X, y).predict(X), expected, atol=1e-3)
