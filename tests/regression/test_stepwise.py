"""Stepwise regression against refits and a textbook example."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

from sklearn_vbjfa import StepwiseRegressor


def residual_sum(X, y, weight, chosen, fit_intercept):
    """Residual sum of squares of a refit on the chosen columns."""
    columns = [X[:, j] for j in chosen]
    if fit_intercept:
        columns.append(np.ones(len(y)))
    root = np.sqrt(weight)
    if not columns:
        return np.sum(weight * y**2)
    design = np.column_stack(columns) * root[:, None]
    solution = np.linalg.lstsq(design, root * y, rcond=None)[0]
    return np.sum((root * y - design @ solution) ** 2)


def literal_stepwise(X, y, *, p_enter, p_remove, weight=None, fit_intercept=True):
    """Stepwise regression of Draper & Smith, refitting each candidate model."""
    weight = np.ones(len(y)) if weight is None else weight
    chosen, path = [], []

    def test(larger, feature):
        smaller = [j for j in larger if j != feature]
        rss = residual_sum(X, y, weight, larger, fit_intercept)
        increase = residual_sum(X, y, weight, smaller, fit_intercept) - rss
        nu = weight.sum() - len(larger) - fit_intercept
        F = increase / (rss / nu)
        return F, stats.f.sf(F, 1, nu)

    while True:
        tests = [(*test(chosen, j), j) for j in chosen]
        if tests and min(tests)[1] > p_remove:
            F, p_value, j = min(tests)
            chosen.remove(j)
            path.append((j, "remove", F, p_value))
            continue
        tests = [
            (*test([*chosen, j], j), j) for j in range(X.shape[1]) if j not in chosen
        ]
        if tests and max(tests)[1] < p_enter:
            F, p_value, j = max(tests)
            chosen.append(j)
            path.append((j, "enter", F, p_value))
            continue
        return sorted(chosen), path


def make_collinear(seed, n_samples=60, n_features=8):
    """Return noisy mixtures of four signals with offsets, output, and the truth."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n_samples, 4)) @ rng.normal(size=(4, n_features))
    X += 0.3 * rng.normal(size=X.shape)
    coef = np.where(rng.random(n_features) < 0.5, rng.normal(size=n_features), 0.0)
    y = X @ coef + 5.0 + rng.normal(size=n_samples)
    return X + 10 * rng.normal(size=n_features), y, coef


@pytest.fixture
def hald():
    """Heat evolved by 13 cements, with the contents of four compounds [%]."""
    X = np.array(
        [
            [7, 1, 11, 11, 7, 11, 3, 1, 2, 21, 1, 11, 10],
            [26, 29, 56, 31, 52, 55, 71, 31, 54, 47, 40, 66, 68],
            [6, 15, 8, 8, 6, 9, 17, 22, 18, 4, 23, 9, 8],
            [60, 52, 20, 47, 33, 22, 6, 44, 22, 26, 34, 12, 12],
        ],
        dtype=float,
    ).T
    y = [
        *[78.5, 74.3, 104.3, 87.6, 95.9, 109.2, 102.7],
        *[72.5, 93.1, 115.9, 83.8, 113.3, 109.4],
    ]
    return X, np.array(y)


def test_textbook_trace(hald):
    # The worked example of Draper & Smith: x4, x1 and x2 enter, x4 leaves.
    model = StepwiseRegressor(p_enter=0.10, p_remove=0.10).fit(*hald)
    assert [(step.feature, step.action) for step in model.path_] == [
        (3, "enter"),
        (0, "enter"),
        (1, "enter"),
        (3, "remove"),
    ]
    F = [step.F for step in model.path_]
    assert_allclose(F, [22.80, 108.22, 5.03, 1.86], atol=0.005)
    assert_allclose(model.coef_, [1.47, 0.66, 0, 0], atol=0.005)
    assert_allclose(model.intercept_, 52.58, atol=0.005)
    assert model.converged_
    assert model.n_iter_ == 4


@pytest.mark.parametrize("fit_intercept", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_path_equals_refits(seed, fit_intercept):
    X, y, _ = make_collinear(seed)
    weight = np.random.default_rng(seed).integers(1, 4, size=len(y)).astype(float)
    model = StepwiseRegressor(p_enter=0.2, p_remove=0.2, fit_intercept=fit_intercept)
    model.fit(X, y, sample_weight=weight)
    chosen, path = literal_stepwise(
        X, y, p_enter=0.2, p_remove=0.2, weight=weight, fit_intercept=fit_intercept
    )
    assert [(step.feature, step.action) for step in model.path_] == [
        step[:2] for step in path
    ]
    assert_allclose([s.F for s in model.path_], [s[2] for s in path], rtol=1e-8)
    assert_allclose([s.p_value for s in model.path_], [s[3] for s in path], rtol=1e-7)
    assert_array_equal(np.flatnonzero(model.selected_), chosen)

    design = np.column_stack([X[:, chosen], np.full(len(y), float(fit_intercept))])
    root = np.sqrt(weight)[:, None]
    solution = np.linalg.lstsq(design * root, y * root[:, 0], rcond=None)[0]
    assert_allclose(model.coef_[chosen], solution[:-1], rtol=1e-9)
    assert_allclose(model.intercept_, solution[-1], rtol=1e-9)
    assert np.all(model.coef_[~model.selected_] == 0)


def test_nothing_enters_after_an_exact_fit():
    X = np.random.default_rng(0).normal(size=(50, 6))
    model = StepwiseRegressor(p_enter=1.0, p_remove=1.0).fit(X, 0.3 * X[:, 2] + 1)
    assert_array_equal(np.flatnonzero(model.selected_), [2])


def test_bad_input(hald):
    X, y = hald
    with pytest.raises(ValueError, match=r"got p_enter=0.2 and p_remove=0.1\. Lower"):
        StepwiseRegressor(p_enter=0.2).fit(X, y)
    with pytest.raises(ValueError, match="sum up to more than 2, got 2"):
        StepwiseRegressor().fit(X, y, sample_weight=np.full(13, 2 / 13))
    with pytest.raises(ValueError, match="must not be negative, got a smallest"):
        StepwiseRegressor().fit(X, y, sample_weight=np.linspace(-1, 1, 13))
    with pytest.raises(ValueError, match="at least one non-zero"):
        StepwiseRegressor().fit(X, y, sample_weight=np.zeros(13))
    with pytest.raises(ValueError, match="'p_enter' parameter of StepwiseRegressor"):
        StepwiseRegressor(p_enter=0.0).fit(X, y)
