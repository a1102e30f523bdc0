"""Locally weighted regression."""

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import LocallyWeightedRegressor, VBJFARegressor


def make_curve(seed, n=3000, noise=0.15):
    """Smooth function of two inputs with noise in inputs and output."""
    rng = np.random.default_rng(seed)

    def function(t):
        return np.sin(1.5 * t[:, 0]) + 0.5 * t[:, 1] ** 2

    t = rng.uniform(-2, 2, size=(n, 2))
    X = t + noise * rng.normal(size=t.shape)
    y = function(t) + 0.1 * rng.normal(size=n)
    t_test = rng.uniform(-1.8, 1.8, size=(1000, 2))
    return X, y, t_test, function(t_test)


def test_a_weight_is_a_repeated_row():
    X, y, X_test, _ = make_curve(2, n=60)
    count = np.ones(60, dtype=int)
    count[0] = 50
    weighted = LocallyWeightedRegressor(n_models=5).fit(X, y, sample_weight=count)
    repeated = LocallyWeightedRegressor(n_models=5)
    repeated.fit(np.repeat(X, count, axis=0), np.repeat(y, count))
    expected = repeated.predict(X_test)
    np.testing.assert_allclose(weighted.predict(X_test), expected, atol=1e-6)


def test_error_is_below_that_of_a_global_fit():
    X, y, X_test, y_test = make_curve(0)
    local = LocallyWeightedRegressor(n_models=25).fit(X, y)
    single = VBJFARegressor().fit(X, y)

    def error(model):
        return np.mean((model.predict(X_test) - y_test) ** 2) / y_test.var()

    # The curve is nonlinear: the global fit explains less than 60 % of it.
    assert error(single) > 0.4
    assert error(local) < 0.25 * error(single)


def test_one_model_is_the_global_regressor():
    X, y, X_test, _ = make_curve(1, n=300)
    local = LocallyWeightedRegressor(LinearRegression(), n_models=1)
    single = LinearRegression().fit(X, y)
    # Weights are at least 1 - 1e-12: the width is a million standard deviations.
    np.testing.assert_allclose(
        local.fit(X, y).predict(X_test), single.predict(X_test), rtol=1e-6
    )


def make_clusters(seed):
    """Return inputs in four separate clusters, for which k-means has one solution."""
    rng = np.random.default_rng(seed)
    centre = np.array([[0, 0], [10, 0], [0, 10], [10, 10]])[rng.integers(4, size=400)]
    X = centre + rng.normal(size=(400, 2))
    return X, np.sin(X[:, 0]) + 0.3 * X[:, 1]


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_units_do_not_matter(scale):
    X, y = make_clusters(3)
    unit = np.array([scale, 1.0])
    # Least squares of scikit-learn would drop a column that is a million times smaller.
    model = LocallyWeightedRegressor(VBJFARegressor(input_noise=0.0), n_models=4)
    plain = model.fit(X, y).predict(X)
    scaled = model.fit(X * unit, y).predict(X * unit)
    np.testing.assert_allclose(scaled, plain, rtol=1e-6)
