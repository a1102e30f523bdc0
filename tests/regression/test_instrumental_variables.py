"""Two-stage least squares against literal formulas."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_vbjfa import InstrumentalVariables


def make_repeated(seed, n_samples=100, n_features=3, n_instruments=3, noise=0.5):
    """Return noisy inputs, output, instruments and the coefficients."""
    rng = np.random.default_rng(seed)
    xi = rng.normal(size=(n_samples, n_features)) + 2.0
    coef = rng.normal(size=n_features)
    y = xi @ coef - 3.0 + 0.2 * rng.normal(size=n_samples)
    X = xi + noise * rng.normal(size=xi.shape)
    mixing = np.eye(n_features, n_instruments)
    mixing += 0.3 * rng.normal(size=mixing.shape)
    Z = xi @ mixing + noise * rng.normal(size=(n_samples, n_instruments))
    return X, y, Z, coef


def literal_two_stages(X, y, Z):
    """Regress X on Z, then y on the prediction; intercepts are columns of ones."""
    ones = np.ones((len(y), 1))
    X, Z = np.hstack([X, ones]), np.hstack([Z, ones])
    predicted = Z @ np.linalg.lstsq(Z, X, rcond=None)[0]
    solution = np.linalg.lstsq(predicted, y, rcond=None)[0]
    residual = y - X @ solution
    variance = residual @ residual / (len(y) - X.shape[1])
    covariance = variance * np.linalg.inv(predicted.T @ predicted)
    return solution[:-1], solution[-1], np.sqrt(np.diag(covariance))[:-1]


@pytest.mark.parametrize("n_instruments", [3, 7])
@pytest.mark.parametrize("seed", range(2))
def test_equals_two_literal_stages(seed, n_instruments):
    X, y, Z, _ = make_repeated(seed, n_instruments=n_instruments)
    model = InstrumentalVariables().fit(X, y, instruments=Z)
    coef, intercept, std = literal_two_stages(X, y, Z)
    assert_allclose(model.coef_, coef, rtol=1e-9)
    assert_allclose(model.intercept_, intercept, rtol=1e-9)
    assert_allclose(model.coef_std_, std, rtol=1e-9)
    assert model.rank_ == 3


def test_without_instruments_it_is_least_squares():
    X, y, _, _ = make_repeated(0)
    model = InstrumentalVariables().fit(X, y)
    expected = LinearRegression().fit(X, y)
    assert_allclose(model.coef_, expected.coef_, rtol=1e-10)
    assert_allclose(model.intercept_, expected.intercept_, rtol=1e-10)
    assert_allclose(model.coef_std_, literal_two_stages(X, y, X)[2], rtol=1e-10)
    explicit = InstrumentalVariables().fit(X, y, instruments=X)
    assert_allclose(explicit.coef_, model.coef_, rtol=1e-10)


@pytest.mark.parametrize("factor", [1.0, 1e-6, 1e6])
def test_duplicate_and_constant_features(factor):
    X, y, Z, _ = make_repeated(1, n_instruments=6)
    reference = InstrumentalVariables().fit(X, y, instruments=Z)
    wide = np.column_stack([X, factor * X[:, 0], np.full(len(y), 0.1)])
    model = InstrumentalVariables().fit(wide, y, instruments=Z)
    assert model.rank_ == 3
    # Copies contribute equally in any units; a constant does not.
    half = reference.coef_[0] / 2
    expected = [half, *reference.coef_[1:], half / factor, 0.0]
    assert_allclose(model.coef_, expected, rtol=1e-8)
    assert_array_equal(np.isinf(model.coef_std_), [True, False, False, True, True])
    assert_allclose(model.coef_std_[1:3], reference.coef_std_[1:], rtol=1e-8)
    assert_allclose(model.predict(wide), reference.predict(X), rtol=1e-8)


def test_bad_input():
    X, y, Z, _ = make_repeated(5)
    with pytest.raises(ValueError, match=r"at least 3 columns, .* got 2\. Add"):
        InstrumentalVariables().fit(X, y, instruments=Z[:, :2])
    with pytest.raises(ValueError, match="inconsistent numbers of samples"):
        InstrumentalVariables().fit(X, y, instruments=Z[1:])
    with pytest.raises(ValueError, match="instruments contains NaN"):
        InstrumentalVariables().fit(X, y, instruments=np.where(Z == Z[0, 0], np.nan, Z))


def test_instruments_pass_through_a_searched_pipeline():
    X, y, Z, _ = make_repeated(6)
    pipeline = make_pipeline(StandardScaler(), InstrumentalVariables())
    reference = InstrumentalVariables().fit(X, y, instruments=Z)
    fitted = pipeline.fit(X, y, instrumentalvariables__instruments=Z)
    assert_allclose(fitted.predict(X), reference.predict(X), rtol=1e-9)
    search = GridSearchCV(pipeline, {"standardscaler__with_mean": [True, False]})
    search.fit(X, y, instrumentalvariables__instruments=Z)
    assert_allclose(search.predict(X), reference.predict(X), rtol=1e-9)
