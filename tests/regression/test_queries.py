"""What is answered by default, and what an unknown input noise leaves open."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import linalg

from sklearn_vbjfa import JFARegressor, VBJFARegressor
from sklearn_vbjfa.regression import NoiseCovariance, _correlated
from tests.regression._problems import bayesian_ridge


def make_inputs(seed, n=400, d=4, rho=0.5, fraction=0.2, noise=0.5):
    """Latent inputs, noisy inputs, outputs, coefficients."""
    rng = np.random.default_rng(seed)
    t = np.sqrt(rho) * rng.normal(size=(n, 1))
    t = t + np.sqrt(1 - rho) * rng.normal(size=(n, d))
    coef = np.random.default_rng([seed, 1]).choice([-2.0, -1.0, 1.0, 2.0], size=d)
    X = t + np.sqrt(fraction / (1 - fraction)) * rng.normal(size=t.shape)
    return t, X, t @ coef + noise * rng.normal(size=n), coef


@pytest.mark.parametrize("model", [VBJFARegressor(), JFARegressor()])
def test_noisy_queries_are_the_default(model):
    _, X, y, _ = make_inputs(0)
    model.fit(X, y)
    assert_array_equal(model.coef_, model.coef_noisy_)
    assert_allclose(model.predict(X), X @ model.coef_noisy_ + model.intercept_)
    assert not np.allclose(model.coef_noisy_, model.coef_noiseless_, rtol=0.01)


def test_unknown_noise_is_the_mean_of_the_admissible_fractions():
    _, X, y, _ = make_inputs(2, 20_000, noise=0.2)
    model = VBJFARegressor(query="noiseless", tol=1e-12).fit(X, y)
    assert model.relevant_.all()
    # Literally: (R - f I) b = R b_0 = r at fractions from zero to the largest.
    R = np.corrcoef(X, rowvar=False)
    r = np.array([np.corrcoef(x, y)[0, 1] for x in X.T])
    largest = min(1 / 3, linalg.eigvalsh(R - np.outer(r, r))[0])

    def answer(f):
        return linalg.solve(R - f * np.eye(4), r) * y.std() / X.std(axis=0)

    # 20,000 rows: the prior moves a coefficient by less than a thousandth.
    assert_allclose(model.coef_, answer(0.5 * largest), rtol=2e-3)
    # The mean square over both ends. At the upper one the noise of y is all but gone,
    # which the fit does not quite reach.
    ends = [answer(0.0), answer(largest * 20_000 / (20_000 - 4))]
    square = np.mean([(end - model.coef_) ** 2 for end in ends], axis=0)
    assert np.all(model.coef_std_**2 > 0.95 * square)
    assert np.all(model.coef_std_**2 < 1.1 * square)
    share = model.input_noise_.diagonal() / X.var(axis=0)
    assert_allclose(share, 0.5 * largest, rtol=1e-6)


def test_noisy_queries_are_the_mean_of_two_regressions():
    _, X, y, _ = make_inputs(5, 60, 8, noise=3.0)
    model = VBJFARegressor(tol=1e-12).fit(X, y)
    ard = VBJFARegressor(input_noise=0.0, tol=1e-12).fit(X, y)
    # Literal Bayesian ridge regression on standardised data.
    A, b = X - X.mean(axis=0), y - y.mean()
    unit = b.std() / A.std(axis=0)
    ridge, cov, noise = bayesian_ridge(A / A.std(axis=0), b / b.std())
    assert_allclose(model.coef_, 0.5 * (ard.coef_ + ridge * unit), rtol=1e-5, atol=1e-8)
    square = np.diagonal(cov) * unit**2 + (model.coef_ - ridge * unit) ** 2
    assert_allclose(model.coef_std_, np.sqrt(square), rtol=1e-5)
    # At the mean of the inputs what is left is the mean noise of both, and what 60 rows
    # leave of the mean of y.
    at = X.mean(axis=0)[None]
    expected = 0.5 * (ard.output_noise_ + noise * y.var()) * (1 + 1 / 60)
    _, deviation = model.predict(at, return_std=True)
    assert_allclose(deviation**2, expected, rtol=1e-5)


def test_known_noise_helps_with_few_rows():
    coef, errors = np.r_[2, -1, 1, np.zeros(57)], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        t = rng.normal(size=(45, 60))
        y = t @ coef + 0.3 * rng.normal(size=45)
        X = t + rng.normal(size=t.shape) / 3
        known = VBJFARegressor(query="noiseless", input_noise=0.1).fit(X, y)
        unknown = VBJFARegressor().fit(X, y)
        assert_array_equal(known.coef_noisy_, unknown.coef_)
        assert known.coef_std_.min() > 0.05
        assert np.mean(np.abs(unknown.coef_ - coef) < 2 * unknown.coef_std_) > 0.8
        errors.append([np.sum((m.coef_ - coef) ** 2) for m in (known, unknown)])
    assert np.mean(errors, axis=0)[0] < min(0.6, np.mean(errors, axis=0)[1])


@pytest.mark.parametrize("n_samples", [40, 50])
@pytest.mark.parametrize("n_relevant", [0, 3, 50])
def test_few_rows_do_not_interpolate(n_relevant, n_samples):
    errors, wrong = [], []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        coef = np.where(np.arange(50) < n_relevant, rng.choice([-1, 1], 50), 0.0)
        X = rng.normal(size=(n_samples, 50))
        y = X @ coef + rng.normal(size=n_samples)
        model = VBJFARegressor().fit(X, y)
        errors.append(np.sum((model.coef_ - coef) ** 2) / (coef @ coef or 1.0))
        wrong.extend(model.relevant_[n_relevant:])
    assert np.mean(errors) < {0: 0.4, 3: 0.2, 50: 0.4}[n_relevant]
    assert not wrong or np.mean(wrong) < 0.06


@pytest.mark.parametrize("fraction", [0.0, 0.2])
def test_intervals_cover_as_they_say(fraction):
    # 60 data sets of four coefficients: a binomial deviation of 2 %.
    z = []
    for seed in range(60):
        _, X, y, coef = make_inputs(seed, 300, fraction=fraction)
        # Coefficients of E[y | x] for these latents.
        latent = 0.5 * np.eye(4) + 0.5
        total = latent + fraction / (1 - fraction) * np.eye(4)
        model = VBJFARegressor().fit(X, y)
        away = model.coef_ - linalg.solve(total, latent @ coef)
        z.append(np.abs(away) / model.coef_std_)
    z = np.array(z)
    assert 0.84 < np.mean(z < 1.645) < 0.96
    # The bounds tell other levels from this one: 73 and 98.4 %.
    assert np.mean(z < 1.1) < 0.84
    assert np.mean(z < 2.4) > 0.96


@pytest.mark.parametrize("dof", [np.inf, 50.0])
@pytest.mark.parametrize("few", [2, 20_000])
def test_deviations_with_known_noise_are_those_of_fuller(dof, few, monkeypatch):
    monkeypatch.setattr(_correlated, "SAMPLES_PER_INPUT", few)
    # Hardly any output noise, so that the noise of the inputs makes most of it.
    rng = np.random.default_rng(6)
    n, coef, psi = 20_000, np.array([2.0, -1.0]), np.array([[0.5, 0.2], [0.2, 0.3]])
    t = rng.normal(size=(n, 2)) @ [[1.0, 0.4], [0.0, 1.0]]
    X = t + rng.normal(size=t.shape) @ linalg.cholesky(psi)
    y = t @ coef + 0.1 * rng.normal(size=n)
    known = NoiseCovariance(covariance=psi, dof=dof)
    model = VBJFARegressor(input_noise=known, query="noiseless").fit(X, y)
    # Fuller (1987), theorem 2.2.1, term by term.
    latent = np.linalg.inv(np.cov(X, rowvar=False, ddof=0) - psi)
    v = 0.01 + coef @ psi @ coef
    expected = v * latent + latent @ (v * psi) @ latent
    expected += latent @ np.outer(psi @ coef, psi @ coef) @ latent
    expected /= n
    moved = (coef @ psi @ coef) * psi + np.outer(psi @ coef, psi @ coef)
    expected += latent @ moved @ latent / dof
    assert_allclose(model.coef_cov_, expected, rtol=0.04)
    assert np.all(np.abs(model.coef_ - coef) < 4 * model.coef_std_)
