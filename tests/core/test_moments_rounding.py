"""When the scatter is not enough: the decision, the factor, and the digits it keeps."""

import warnings
from fractions import Fraction

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import linalg

from sklearn_vbjfa import VBJFARegressor
from sklearn_vbjfa._core import _moments
from sklearn_vbjfa.regression import fit_moments


def make_problem(n, condition, noise, seed=0, *, n_features=6):
    """X = U diag(s) V', y = U c + noise, and the projection of y."""
    rng = np.random.default_rng(seed)
    U = rng.normal(size=(n, n_features))
    U = linalg.qr(U - U.mean(axis=0), mode="economic")[0]
    V = linalg.qr(rng.normal(size=(n_features, n_features)))[0]
    X = (U * np.logspace(0, -np.log10(condition), n_features)) @ V.T * np.sqrt(n)
    y = U @ rng.choice([-1.0, 1.0], n_features) * np.sqrt(n / n_features)
    y += noise * rng.normal(size=n)
    return X, y, U @ (U.T @ y) + y.mean()


def make_model():
    """Bayesian regression with exact inputs."""
    return VBJFARegressor(latent="correlated", input_noise=0.0)


def relative(found, reference):
    return np.linalg.norm(found - reference) / np.linalg.norm(reference)


def joint_rows(X, y, weight, centre):
    rows = np.column_stack([X, y])
    if centre:
        rows = rows - np.average(rows, axis=0, weights=weight)
    return rows * np.sqrt(weight)[:, None]


@pytest.mark.parametrize("n", [30, 3000])
@pytest.mark.parametrize("noise", [1e-2, 1e-10])
@pytest.mark.parametrize("condition", [1e2, 1e6, 1e12])
def test_predictions_are_those_of_the_rows(condition, noise, n):
    X, y, reference = make_problem(n, condition, noise)
    model = make_model().fit(X, y)
    # What the prior does to the estimate, far below its standard error, and what any
    # solver leaves of the digits of X @ coef: eps times the condition number.
    error = relative(model.predict(X), reference)
    standard_error = noise * np.sqrt(6 / n)
    assert error < 0.1 * standard_error + 64 * np.finfo(float).eps * condition
    assert model.converged_
    scatter_alone = fit_moments(make_model(), _moments.from_data(X, y))
    if condition * noise >= 1e8:
        assert model.statistics_.factor is not None
        assert relative(scatter_alone.predict(X), reference) > 100 * error


def test_integers_against_exact_fractions():
    # Two columns that differ by a few units in 1e9; all sums are exact integers.
    rng = np.random.default_rng(1)
    x = rng.integers(-(10**9), 10**9, 40)
    d = rng.integers(-3, 4, 40)
    X = np.column_stack([x, x + d]).astype(float)
    y = (3 * x - 5 * d).astype(float) + rng.integers(-1, 2, 40)
    rows = [[Fraction(int(v)) for v in (1, *row)] for row in X]
    target = [Fraction(int(v)) for v in y]
    table = [
        [sum(r[i] * r[j] for r in rows) for j in range(3)]
        + [sum(r[i] * t for r, t in zip(rows, target))]
        for i in range(3)
    ]
    for k in range(3):
        table[k] = [value / table[k][k] for value in table[k]]
        for i in set(range(3)) - {k}:
            table[i] = [a - table[i][k] * b for a, b in zip(table[i], table[k])]
    exact = np.array([float(row[3]) for row in table])
    model = make_model().fit(X, y)
    assert model.statistics_.factor is not None
    # The prior takes a share of (standard error / coefficient)^2.
    assert_allclose(model.coef_, exact[1:], rtol=1e-2)
    fitted = exact[0] + X @ exact[1:]
    assert relative(model.predict(X), fitted) < 1e-9


@pytest.mark.parametrize(
    ("condition", "noise", "needed"),
    [(1e2, 1e-1, False), (1e4, 1e-1, False), (1e2, 1e-9, True), (1e10, 1e-3, True)],
)
def test_the_choice(condition, noise, needed):
    X, y, _ = make_problem(500, condition, noise)
    stats = _moments.accumulate(X, y, None, centred=True)
    assert (stats.factor is not None) == needed


@pytest.mark.parametrize("offset", [0.0, 1e3])
def test_exact_dependencies_need_no_factor(offset):
    rng = np.random.default_rng(2)
    X = rng.normal(size=(500, 3)) + offset
    X = np.column_stack([X, X[:, 0], X @ [1.0, 2.0, -1.0], 0.5 * X[:, 1]])
    y = X[:, 0] + 0.1 * rng.normal(size=500)
    assert _moments.accumulate(X, y, None, centred=True).factor is None
    # A dependency that the scatter takes for exact and the rows do not.
    X[:, 3] += 1e-9 * rng.normal(size=500)
    assert _moments.accumulate(X, y, None, centred=True).factor is not None


@pytest.mark.parametrize("centred", [True, False])
@pytest.mark.parametrize("splits", [1, 3])
def test_factor_of_any_chunks(monkeypatch, splits, centred):
    monkeypatch.setattr(_moments, "_BLOCK_BYTES", 1)
    rng = np.random.default_rng(3)
    X = rng.normal(size=(900, 3)) + [5.0, -2.0, 0.0]
    y, weight = X @ [1.0, 2.0, 3.0] + rng.normal(size=900), rng.uniform(0.5, 2, 900)
    total = None
    for rows in np.array_split(np.arange(900), splits):
        part = _moments.from_data(X[rows], y[rows], weight[rows])
        part = _moments.with_factor(part, X[rows], y[rows], weight[rows])
        total = part if total is None else total + part
    R = total.factor_about(centred=centred)
    assert_array_equal(R, np.triu(R))
    rows = joint_rows(X, y, weight, centred)
    assert_allclose(R.T @ R, rows.T @ rows, rtol=1e-11, atol=1e-9)
    # Standardised, the moments are those of the factor.
    data = _moments.standardise(total, centred=centred).moments
    c = np.array([0.3, -1.0, 2.0])
    plain = _moments.standardise(
        _moments.from_data(X, y, weight), centred=centred
    ).moments
    assert_allclose(data.dot(c), plain.dot(c), rtol=1e-10)
    for ours, theirs in zip(data.residual(c), plain.residual(c)):
        assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * plain.n)


def test_partial_fit_carries_the_factor():
    X, y, reference = make_problem(600, 1e9, 1e-5)
    model = make_model()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for rows in np.array_split(np.arange(600), 3):
            model.partial_fit(X[rows], y[rows])
    assert model.statistics_.factor is not None
    assert relative(model.predict(X), reference) < 1e-6


def test_partial_fit_says_when_digits_are_lost():
    rng = np.random.default_rng(5)
    X = rng.normal(size=(400, 4))
    X[:, 3] = X[:, 0]
    X[200:, 3] += 1e-8 * X[200:, 1]
    y = X[:, 0] + rng.normal(size=400)
    model = make_model().partial_fit(X[:200], y[:200])
    assert model.statistics_.factor is None
    with pytest.warns(UserWarning, match=r"partial_fit loses digits: .* fit all rows"):
        model.partial_fit(X[200:], y[200:])
