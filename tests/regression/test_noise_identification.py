"""The default of VB-JFA: identified input noise and relevant inputs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.linear_model import ARDRegression, LassoCV, LinearRegression

from sklearn_vbjfa import VBJFARegressor
from sklearn_vbjfa.datasets import make_noisy_regression
from sklearn_vbjfa.regression import LARGEST_FRACTION, largest_noise_fraction


def nmse(model, data):
    error = model.predict(data.X_test) - data.y_test
    return np.mean(error**2) / data.y_test.var()


def test_error_is_below_that_of_other_estimators():
    # A small version of the benchmark (all cells, 10 trials): three trials, with the
    # same target, 0.6 times the mean error of the best other estimator.
    errors, rivals = [], []
    for seed in range(3):
        data = make_noisy_regression(
            n_redundant=90, n_irrelevant=0, input_snr=2.0, random_state=seed
        )
        errors.append(nmse(VBJFARegressor(query="noiseless").fit(data.X, data.y), data))
        rivals.append(
            [
                nmse(model.fit(data.X, data.y), data)
                for model in (LinearRegression(), LassoCV(), ARDRegression())
            ]
        )
    assert np.mean(errors) < 0.6 * np.mean(rivals, axis=0).min()


@pytest.mark.parametrize("snr", [2.0, 5.0])
def test_largest_fraction_is_accurate_for_correlated_inputs(snr):
    fractions = []
    for seed in range(5):
        data = make_noisy_regression(
            20_000, n_irrelevant=0, input_snr=snr, random_state=seed
        )
        X, y = data.X - data.X.mean(axis=0), data.y - data.y.mean()
        R = np.corrcoef(X, rowvar=False)
        r = X.T @ y / np.sqrt((X**2).sum(axis=0) * (y @ y))
        fractions.append(largest_noise_fraction(R, r))
    truth = 1 / (1 + snr)
    # Fractions below the truth are not excluded (to the error of 20,000 rows). With
    # strongly correlated inputs nearly all above it are excluded; none exceeds the cap.
    assert max(fractions) <= LARGEST_FRACTION
    assert 0.98 * truth < np.mean(fractions) < 1.2 * truth


def test_only_generators_of_redundant_inputs_are_relevant():
    data = make_noisy_regression(
        n_redundant=30, n_irrelevant=60, input_snr=5.0, random_state=2
    )
    model = VBJFARegressor(query="noiseless").fit(data.X, data.y)
    redundant = slice(10, 40)
    assert not model.relevant_[redundant].any()


def test_exact_copies_share_their_coefficient():
    rng = np.random.default_rng(3)
    t = rng.normal(size=(800, 2))
    y = t @ [2.0, -1.0] + 0.1 * rng.normal(size=800)
    x = t + 0.3 * rng.normal(size=t.shape)
    single = VBJFARegressor(query="noiseless").fit(x, y)
    copied = VBJFARegressor(query="noiseless").fit(
        np.column_stack([x, x[:, 0], -3 * x[:, 0]]), y
    )
    assert_array_equal(copied.relevant_, [True, True, True, True])
    # A third for each standardised column, with the sign of the copy.
    expected = single.coef_[0] / 3 * np.array([1.0, 1.0, -1 / 3])
    assert_allclose(copied.coef_[[0, 2, 3]], expected, rtol=1e-6)
    assert_allclose(copied.coef_[1], single.coef_[1], rtol=1e-6)
    # The variance of the sum is unchanged; that of each coefficient is larger.
    total, cov = np.array([1.0, 0.0, 1.0, -3.0]), copied.coef_cov_
    assert_allclose(total @ cov @ total, single.coef_cov_[0, 0], rtol=1e-6)
    assert copied.coef_std_[0] > 3 * single.coef_std_[0]
