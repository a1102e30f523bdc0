"""VB-JFA regression: models, limits, invariances and messages."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.exceptions import ConvergenceWarning

from sklearn_vbjfa import JFARegressor, LocallyWeightedRegressor, VBJFARegressor
from tests.regression._problems import (
    assert_same_fit,
    bayesian_ridge,
    least_squares,
    make_regression,
)


def make_model(kind, **params):
    """Return the estimator of a model by name."""
    if kind == "correlated":
        options = {"latent": "correlated", "input_noise": 0.1}
    elif kind == "auto":
        options = {}
    elif kind == "jfa":
        return JFARegressor(query="noiseless", tol=1e-10, **params)
    elif kind == "default":
        options = {"query": "noisy"}
    else:
        options = {"latent": "independent", "prior": kind}
    return VBJFARegressor(**{"query": "noiseless", "tol": 1e-8, **options, **params})


# With a fixed number of iterations, equivalent fits differ only by rounding, not by the
# point at which they stop in a flat direction.
FIXED = {"max_iter": 25, "tol": 0.0}
unconverged = pytest.mark.filterwarnings(
    "ignore::sklearn.exceptions.ConvergenceWarning"
)

MODELS = ["paper", "noise", "correlated", "auto", "default"]


@pytest.mark.parametrize(("kind", "rtol"), [("paper", 1e-3), ("noise", 0.03)])
def test_noisy_coefficients_tend_to_least_squares(kind, rtol):
    X, y, _ = make_regression(1, 20_000)
    model = make_model(kind, tol=1e-7).fit(X, y)
    # ARD shrinks each coefficient by 1 / n, and stopping leaves an error of 1e-4. The
    # prior on the noise always has the weight of a tenth of the samples.
    assert_allclose(model.coef_noisy_, least_squares(X, y), rtol=rtol)


@pytest.mark.parametrize("kind", ["jfa", "paper", "noise", "correlated"])
def test_known_noise_recovers_the_coefficients(kind):
    X, y, coef = make_regression(2, 20_000, noise=0.5)
    model = make_model(kind, input_noise=np.full(4, 0.25)).fit(X, y)
    # Noise of y given x has a variance of 0.2 |coef|^2 + 0.09, less than 1.5: four
    # standard deviations of sqrt(1.5 / 20000) * 1.25 = 0.011.
    assert_allclose(model.coef_, coef, atol=0.045)
    assert_allclose(model.coef_noisy_, coef / 1.25, atol=0.04)
    assert_allclose(np.diagonal(np.atleast_2d(model.input_noise_)).max(), 0.25)
    assert kind == "jfa" or model.relevant_.all()


def test_known_noise_covariance_of_correlated_inputs():
    rng = np.random.default_rng(3)
    mix, root = rng.normal(size=(2, 3, 3))
    n, coef = 20_000, np.array([1.0, -2.0, 0.5])
    t = rng.normal(size=(n, 3)) @ (mix + 2 * np.eye(3))
    X = t + 0.4 * rng.normal(size=t.shape) @ root
    y = t @ coef + 0.3 * rng.normal(size=n)
    psi, unit = 0.16 * root.T @ root, np.array([1, 100, 1])
    model = make_model("correlated", input_noise=psi * np.outer(unit, unit))
    model.fit(X * unit + 5, y)
    corrected = np.linalg.solve(np.cov(X.T, ddof=0) - psi, np.cov(X.T, y)[:3, 3])
    # The error due to the stopping rule is small.
    assert_allclose(model.coef_ * unit, corrected, rtol=0.01)
    # Within four standard deviations of the truth; least squares is not.
    relative = np.abs(model.coef_ * unit - coef) / (model.coef_std_ * unit)
    assert relative.max() < 4
    error = np.abs(least_squares(X, y) - coef) / (model.coef_std_ * unit)
    assert error.max() > 10


def test_zero_noise_is_ard_regression():
    X, y, _ = make_regression(4, 100, 5)
    y = y - X[:, 0] * least_squares(X, y)[0]
    model = VBJFARegressor(
        query="noiseless", latent="correlated", input_noise=0, tol=1e-14
    )
    model.fit(X, y)
    # A literal variational ARD regression on standardised data.
    A, b = X - X.mean(axis=0), y - y.mean()
    x_unit, y_unit = A.std(axis=0), b.std()
    A, b, s2, alpha = A / x_unit, b / y_unit, 1.0, np.ones(5)
    for _ in range(3000):
        cov = np.linalg.inv(A.T @ A / s2 + np.diag(alpha))
        mean = cov @ A.T @ b / s2
        square = mean**2 + np.diagonal(cov)
        alpha = (1e-6 + 0.5) / (1e-6 + 0.5 * square)
        s2 = (np.sum((b - A @ mean) ** 2) + np.trace(A.T @ A @ cov)) / 100
    # Relative to the largest: coefficients pruned by ARD converge slowly to zero.
    scale = np.abs(mean).max()
    assert_allclose(model.coef_ * x_unit / y_unit, mean, atol=1e-6 * scale)
    kept = np.arange(5) > 0
    assert_allclose(model.output_noise_ / y_unit**2, s2, rtol=1e-6)
    assert_allclose((model.alpha_ * y_unit**2)[kept], alpha[kept], rtol=1e-6)
    assert_array_equal(model.relevant_, kept)
    assert_array_equal(model.input_noise_, np.zeros((5, 5)))
    # Standard deviations: literal Bayesian ridge regression, second moment about mean.
    ridge, cov, _ = bayesian_ridge(A, b)
    std = np.sqrt(np.diagonal(cov) + (ridge - mean) ** 2)
    assert_allclose(model.coef_std_ * x_unit / y_unit, std, rtol=1e-5)


@unconverged
@settings(max_examples=6, derandomize=True, deadline=None)
@given(
    seed=st.integers(0, 2**20),
    x_power=st.integers(-6, 6),
    y_power=st.integers(-6, 6),
    order=st.permutations(range(4)),
    flips=st.lists(st.sampled_from([-1.0, 1.0]), min_size=4, max_size=4),
)
@pytest.mark.parametrize("kind", MODELS)
def test_units_signs_and_order(kind, seed, x_power, y_power, order, flips):
    X, y, _ = make_regression(seed, 80)
    order, x_unit = np.array(order), np.array(flips)
    x_unit[seed % 4] *= 10.0**x_power
    y_unit = -(10.0**y_power)
    plain = make_model(kind, **FIXED).fit(X, y)
    rows = np.random.default_rng(seed).permutation(80)
    model = make_model(kind, **FIXED).fit(
        (X * x_unit)[rows][:, order], y[rows] * y_unit
    )
    for name in ("coef_", "coef_noisy_", "coef_std_", "relevant_"):
        value = getattr(model, name)
        setattr(model, name, value[np.argsort(order)])
    noise, back = model.input_noise_, np.argsort(order)
    model.input_noise_ = noise[back] if noise.ndim == 1 else noise[np.ix_(back, back)]
    assert_same_fit(model, plain, x_unit=x_unit, y_unit=y_unit, rtol=1e-5)


@unconverged
@pytest.mark.parametrize("kind", MODELS)
def test_chunks_and_weights_are_repeated_rows(kind):
    X, y, _ = make_regression(9, 90)
    count = np.random.default_rng(9).integers(0, 3, 90)
    rows = np.repeat(np.arange(90), count)
    repeated = make_model(kind, **FIXED).fit(X[rows], y[rows])
    weight = count.astype(float)
    weighted = make_model(kind, **FIXED).fit(X, y, sample_weight=weight)
    assert_same_fit(weighted, repeated, rtol=1e-5)
    chunked = make_model(kind, **FIXED)
    for part in reversed(np.array_split(np.arange(90), 4)):
        chunked.partial_fit(X[part], y[part], sample_weight=weight[part])
    assert_same_fit(chunked, repeated, rtol=1e-5)


@unconverged
@pytest.mark.parametrize("kind", MODELS)
def test_constant_column(kind):
    X, y, _ = make_regression(11)
    without = make_model(kind, **FIXED).fit(X, y)
    model = make_model(kind, **FIXED).fit(np.insert(X, 1, 0.1, axis=1), y)
    kept = [0, 2, 3, 4]
    assert model.coef_[1] == model.coef_noisy_[1] == 0.0
    assert np.isinf(model.coef_std_[1])
    assert np.isinf(model.alpha_[1])
    assert not model.relevant_[1]
    assert_allclose(model.coef_[kept], without.coef_, rtol=1e-6)
    assert np.isfinite(model.coef_std_[kept]).all()
    assert np.isfinite(model.input_noise_).all()
    _, std = model.predict(np.insert(X, 1, 0.1, axis=1), return_std=True)
    assert np.isfinite(std).all()


def test_noise_of_the_whole_variance_is_named():
    X, y, _ = make_regression(15)
    noise = np.array([0.1, 5.0, 0.1, 0.1])
    for kind in ("noise", "correlated"):
        with pytest.warns(UserWarning, match=r"whole variance of 1 input\(s\) \(1\)"):
            model = make_model(kind, input_noise=noise).fit(X, y)
        # That column contains no signal.
        assert abs(model.coef_[1]) < 0.05 * np.abs(model.coef_).max()
        assert model.coef_[1] == 0.0 or kind == "correlated"
        assert np.isfinite(model.coef_).all()


@pytest.mark.parametrize("kind", ["paper", "correlated"])
def test_too_few_iterations_are_reported(kind):
    X, y, _ = make_regression(17)
    with pytest.warns(ConvergenceWarning, match=r"after max_iter=2 iterations"):
        model = make_model(kind, max_iter=2, tol=0).fit(X, y)
    assert model.n_iter_ == 2
    assert not model.converged_


# -- invalid or implausible noise ------------------------------------------------------

OFF_DIAGONAL = np.eye(4, k=1) + np.eye(4, k=-1)


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        (np.nan, r"must be finite, got NaN"),
        (1.5, r"in \[0, 1\), got 1\.5; give variances as an array"),
        (-0.1, r"in \[0, 1\), got -0\.1"),
        ([0.1, 0.1, -0.5, 0.1], r"must not be negative, got -0\.5 for feature 2"),
        ([0.1, 0.1], r"shape \(4,\) or a covariance of shape \(4, 4\).*shape \(2,\)"),
        (np.ones((1, 4, 4)), r"for 4 features, got an array of shape \(1, 4, 4\)"),
        (np.eye(4) + np.eye(4, k=1), r"must be symmetric"),
        (np.eye(4) - 2 * OFF_DIAGONAL, r"positive semidefinite, got a smallest eigen"),
        # An exact input cannot share noise with another.
        (np.diag([1.0, 0.0, 1.0, 1.0]) + OFF_DIAGONAL, r"must be positive semidef"),
    ],
)
def test_invalid_noise_is_refused(noise, message):
    X, y, _ = make_regression(30)
    with pytest.raises(ValueError, match=message):
        VBJFARegressor(query="noiseless", input_noise=noise).fit(X, y)


@pytest.mark.parametrize("latent", ["correlated", "independent"])
@pytest.mark.parametrize(("times", "named"), [(1.0, False), (4.0, True)])
def test_noise_beyond_the_inputs_given_y_is_named(times, named, latent):
    X, y, _ = make_regression(35, 2000, 3, noise=0.2, output_noise=0.1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        VBJFARegressor(latent=latent, input_noise=np.full(3, 0.04 * times)).fit(X, y)
    assert any("given y" in str(w.message) for w in caught) == named


@pytest.mark.parametrize("n_used", [1, 60])
def test_weights_of_one_sample_are_refused(n_used):
    X, y, _ = make_regression(36, 60)
    weight = np.where(np.arange(60) < n_used, 1 / n_used, 0.0)
    for regressor in (VBJFARegressor(), LocallyWeightedRegressor()):
        with pytest.raises(ValueError, match=r"more than 1, got .* number of"):
            regressor.fit(X, y, sample_weight=weight)


@pytest.mark.filterwarnings("error")
def test_semidefinite_covariance_is_allowed():
    # A single source of noise in all inputs: rank one, three eigenvalues are zero.
    X, y, _ = make_regression(33)
    direction = np.array([0.1, -0.2, 0.3, 0.05])
    psi = np.outer(direction, direction)
    model = make_model("correlated", input_noise=psi).fit(X, y)
    assert_allclose(model.input_noise_, psi, rtol=0, atol=1e-12)
    assert np.isfinite(model.coef_).all()


def test_covariance_beyond_the_data_names_the_columns():
    X, y, _ = make_regression(34)
    factor = np.array([0.5, 1.5, 0.5, 2.0])
    psi = np.cov(X, rowvar=False) * np.outer(factor, factor)
    with pytest.warns(UserWarning, match=r"of 2 input\(s\) \(1, 3\): no signal.*units"):
        model = make_model("correlated", input_noise=psi).fit(X, y)
    assert np.isfinite(model.coef_).all()
    assert np.isfinite(model.output_noise_)
