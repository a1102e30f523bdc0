"""Exponential forgetting of the errors-in-variables regressors."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from sklearn.utils._param_validation import InvalidParameterError

from sklearn_vbjfa import JFARegressor, VBJFARegressor

MODELS = [
    JFARegressor(input_noise=0.1),
    JFARegressor(input_noise=0.1, fit_intercept=False),
    VBJFARegressor(latent="independent", input_noise=0.1),
    VBJFARegressor(latent="correlated", input_noise=0.0),
]


def rows(seed=0, n=400):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, 3)) + [0.0, 5.0, -2.0]
    return X, X @ [1.0, -2.0, 0.5] + 0.1 * rng.normal(size=n)


@settings(max_examples=12, derandomize=True, deadline=None)
@given(
    model=st.sampled_from(MODELS),
    cuts=st.lists(st.integers(1, 399), min_size=1, max_size=5, unique=True),
    forgetting=st.sampled_from([0.9, 0.99, 0.9999]),
    weighted=st.booleans(),
)
def test_equals_a_fit_that_weighs_by_age(model, cuts, forgetting, weighted):
    X, y = rows()
    own = np.random.default_rng(1).uniform(0.5, 2.0, 400) if weighted else np.ones(400)
    fading = model.__class__(**{**model.get_params(), "forgetting": forgetting})
    for a, b in itertools.pairwise([0, *sorted(cuts), 400]):
        fading.partial_fit(X[a:b], y[a:b], sample_weight=own[a:b])
    age = np.arange(399.0, -1.0, -1.0)
    whole = model.__class__(**model.get_params())
    whole.fit(X, y, sample_weight=own * forgetting**age)
    stats, expected = fading.statistics_, whole.statistics_
    for name in ("n_samples", "x_mean", "y_mean", "S_xx", "S_xy", "S_yy"):
        reference = getattr(expected, name)
        size = np.abs(reference).max()
        assert_allclose(getattr(stats, name), reference, rtol=0, atol=1e-10 * size)
    if not model.fit_intercept:
        # About a mean that is not taken off the likelihood is flat: rounding of the
        # moments decides where on it the iterations end, by more than `tol` says.
        return
    # rounding, after as many iterations as it takes
    assert_allclose(fading.coef_, whole.coef_, rtol=0, atol=1e-8)
    assert_allclose(fading.intercept_, whole.intercept_, rtol=0, atol=1e-7)


def test_without_forgetting_nothing_changes():
    X, y = rows()
    whole = JFARegressor(input_noise=0.1).fit(X, y)
    chunks = JFARegressor(input_noise=0.1, forgetting=1.0)
    for part in np.array_split(np.arange(400), 7):
        chunks.partial_fit(X[part], y[part])
    assert chunks.statistics_.n_samples == 400
    assert_allclose(chunks.coef_, whole.coef_, rtol=1e-8)


def test_fit_does_not_forget():
    X, y = rows()
    fading = JFARegressor(input_noise=0.1, forgetting=0.5).fit(X, y)
    assert_allclose(fading.coef_, JFARegressor(input_noise=0.1).fit(X, y).coef_)


def test_memory_is_as_long_as_said():
    X, y = rows(n=2000)
    fading = JFARegressor(input_noise=0.1, forgetting=0.99).partial_fit(X, y)
    # the sum of a geometric series
    expected = (1 - 0.99**2000) / (1 - 0.99)
    assert fading.statistics_.n_samples == pytest.approx(expected, rel=1e-12)
    halves = JFARegressor(input_noise=0.1, forgetting=0.999)
    halves.partial_fit(X[:1000], y[:1000]).partial_fit(X[1000:], y[1000:])
    age = 0.999 ** np.arange(1999.0, -1.0, -1.0)
    scatter = age.sum() * np.cov(X, rowvar=False, aweights=age, ddof=0)
    assert_allclose(halves.statistics_.S_xx, scatter, rtol=1e-9)


@pytest.mark.parametrize("model", [JFARegressor, VBJFARegressor])
@pytest.mark.parametrize("forgetting", [0.0, -0.1, 1.01, "slow", None])
def test_what_is_no_weight_is_refused(model, forgetting):
    X, y = rows()
    with pytest.raises(InvalidParameterError, match="'forgetting' parameter"):
        model(forgetting=forgetting).partial_fit(X, y)
