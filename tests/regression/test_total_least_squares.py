"""Total least squares against closed forms and its objective."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import TotalLeastSquares


def make_noisy(seed, n_samples=80, n_features=3, input_std=0.3, output_std=0.3):
    """Return inputs and output with noise and offsets, and the coefficients."""
    rng = np.random.default_rng(seed)
    xi = rng.normal(size=(n_samples, n_features)) @ (
        np.eye(n_features) + 0.3 * rng.normal(size=(n_features, n_features))
    )
    coef = rng.normal(size=n_features)
    y = xi @ coef + 4.0 + output_std * rng.normal(size=n_samples)
    X = xi + input_std * rng.normal(size=xi.shape) + 2.0
    return X, y, coef


def objective(coef, intercept, X, y, weight, input_noise, output_noise):
    """Weighted sum of squared distances to the hyperplane, in the noise metric."""
    variance = output_noise + coef @ input_noise @ coef
    return np.sum(weight * (y - X @ coef - intercept) ** 2) / variance


def test_one_feature_formula():
    # Closed form of Deming for one feature and a known ratio of variances.
    X, y, _ = make_noisy(1, n_features=1)
    ratio = 2.5
    C = np.cov(X[:, 0], y)
    gap = C[1, 1] - ratio * C[0, 0]
    slope = (gap + np.sqrt(gap**2 + 4 * ratio * C[0, 1] ** 2)) / (2 * C[0, 1])
    model = TotalLeastSquares(input_noise=[0.2], output_noise=0.2 * ratio).fit(X, y)
    assert_allclose(model.coef_, [slope], rtol=1e-10)


@pytest.mark.parametrize("kind", ["classical", "variances", "exact", "singular"])
@pytest.mark.parametrize("seed", range(3))
def test_minimises_its_objective(kind, seed):
    X, y, _ = make_noisy(seed)
    weight = np.random.default_rng(seed).uniform(0.5, 2.0, size=len(y))
    direction = np.array([1.0, 2.0, -1.0])
    noise, parameter, output_noise = {
        "classical": (np.eye(3), None, None),
        "variances": (np.diag([0.5, 2.0, 0.1]), [0.5, 2.0, 0.1], 0.3),
        "exact": (np.diag([0.5, 0.0, 0.1]), [0.5, 0.0, 0.1], 0.3),
        "singular": (np.outer(direction, direction),) * 2 + (0.3,),
    }[kind]
    model = TotalLeastSquares(input_noise=parameter, output_noise=output_noise)
    model.fit(X, y, sample_weight=weight)
    arguments = (X, y, weight, noise, output_noise or 1.0)

    def value(parameters):
        return objective(parameters[:3], parameters[3], *arguments)

    best = np.append(model.coef_, model.intercept_)
    for step in np.eye(4) * 1e-5:
        slope = (value(best + step) - value(best - step)) / 2e-5
        assert abs(slope) < 1e-6 * value(best)
    rng = np.random.default_rng(seed)
    for size in [1e-2, 1e-1, 1.0, 10.0]:
        for _ in range(100):
            assert value(best) < value(best + size * rng.normal(size=4))


def test_exact_inputs_are_least_squares():
    X, y, _ = make_noisy(6)
    model = TotalLeastSquares(input_noise=np.zeros(3), output_noise=1.0).fit(X, y)
    expected = LinearRegression().fit(X, y)
    assert_allclose(model.coef_, expected.coef_, rtol=1e-10)
    assert_allclose(model.intercept_, expected.intercept_, rtol=1e-10)
    model.set_params(input_noise=np.full(3, 1e-12)).fit(X, y)
    assert_allclose(model.coef_, expected.coef_, rtol=1e-8)


def test_nongeneric_problem():
    # y is orthogonal to the second feature, and its distance to the first exceeds the
    # norm of the second: no finite solution uses the second.
    X = np.array([[1.0, 0.0], [0.0, 0.1], [0.0, 0.0]])
    y = np.array([1.0, 0.0, 1.0])
    model = TotalLeastSquares(fit_intercept=False).fit(X, y)
    alone = TotalLeastSquares(fit_intercept=False).fit(X[:, :1], y)
    assert_allclose(model.coef_, [alone.coef_[0], 0.0], atol=1e-12)

    near = X + [[0, 0], [0, 0], [0, 1e-3]]
    model.fit(near, y)
    assert abs(model.coef_[1]) > 1


@pytest.mark.parametrize("noise", [np.eye(3), np.zeros((3, 3)), np.diag([1, 0, 1])])
def test_constant_column(noise):
    X, y, _ = make_noisy(9)
    X[:, 1] = 0.1
    model = TotalLeastSquares(input_noise=noise, output_noise=1.0).fit(X, y)
    reduced = TotalLeastSquares(
        input_noise=np.delete(np.diag(noise), 1), output_noise=1.0
    ).fit(X[:, [0, 2]], y)
    assert_allclose(model.coef_[[0, 2]], reduced.coef_, rtol=1e-9)
    assert model.coef_[1] == 0


def test_bad_input():
    X, y, _ = make_noisy(13)
    with pytest.raises(ValueError, match="got input_noise without output_noise"):
        TotalLeastSquares(input_noise=np.ones(3)).fit(X, y)
    with pytest.raises(ValueError, match="got output_noise without input_noise"):
        TotalLeastSquares(output_noise=1.0).fit(X, y)
    with pytest.raises(ValueError, match=r"shape \(2,\)"):
        TotalLeastSquares(input_noise=np.ones(2), output_noise=1.0).fit(X, y)
    with pytest.raises(ValueError, match="must not be negative, got -1 for"):
        TotalLeastSquares(input_noise=[1, -1, 1], output_noise=1.0).fit(X, y)
    for noise in [np.ones((3, 3)) + np.eye(3)[[1, 2, 0]], 2 * np.ones((3, 3))]:
        noise[np.diag_indices(3)] = 1.0
        with pytest.raises(ValueError, match=r"symmetric|positive semidefinite"):
            TotalLeastSquares(input_noise=noise, output_noise=1.0).fit(X, y)
    with pytest.raises(ValueError, match="'output_noise' parameter"):
        TotalLeastSquares(input_noise=np.ones(3), output_noise=0.0).fit(X, y)
