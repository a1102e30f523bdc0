"""Common noise of inputs and output, against a transcription row by row."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import linalg

from sklearn_vbjfa import VBJFARegressor

SHAPE = RATE = 1e-6


def problem(n=60, seed=0, size=0.6):
    """Rows with noise of inputs and output from one joint covariance."""
    rng = np.random.default_rng(seed)
    d = 3
    root = rng.normal(size=(d + 1, d + 1))
    noise = size**2 * root @ root.T / (d + 1)
    t = rng.normal(size=(n, d)) @ np.array([[2, 0.5, 0], [0, 1.5, 0.3], [0, 0, 1.0]])
    e = rng.multivariate_normal(np.zeros(d + 1), noise, size=n)
    X, y = t + e[:, :d], t @ [1.0, -2.0, 0.5] + e[:, d]
    return X, y, noise[:d, :d], noise[:d, d]


def latents(X, y, psi, cross, beta, C, noise):
    """Moments of the latent of each row, from the joint noise of inputs and output."""
    n, d = X.shape
    values, vectors = linalg.eigh(X.T @ X / n - psi)
    sigma = (vectors * np.maximum(values, 0)) @ vectors.T
    share = linalg.solve(psi, cross)
    joint = np.zeros((d + 1, d + 1))
    joint[:d, :d], joint[:d, d], joint[d, :d] = psi, cross, cross
    joint[d, d] = noise + cross @ share
    W, M = linalg.inv(joint), np.vstack([np.eye(d), beta])
    # The covariance of beta is weighted by the precision of the output given the noise
    # of the inputs.
    P = linalg.inv(linalg.inv(sigma) + M.T @ W @ M + C / noise)
    # y minus its share of the noise of the inputs, x - t, and t.
    mu = [P @ M.T @ W @ np.append(*row) for row in zip(X, y)]
    return P, [(out - share @ (x - m), m) for x, out, m in zip(X, y, mu)], share


def literal(X, y, psi, cross, n_iter):
    """Mean of beta and the output noise by plain updates, row by row."""
    n, d = X.shape
    noise, shape = float(y @ y) / n, SHAPE + 0.5
    alpha = np.ones(d)
    # The first step takes the inputs for the latents, as the package does.
    C = linalg.inv(X.T @ X / noise + np.diag(alpha))
    beta = C @ X.T @ y / noise
    for _ in range(n_iter - 1):
        P, rows, share = latents(X, y, psi, cross, beta, C, noise)
        S = sum(np.outer(m, m) + P for _, m in rows)
        right = sum(m * out + P @ share for out, m in rows)
        C = linalg.inv(S / noise + np.diag(alpha))
        beta = C @ right / noise
        gap = share - beta
        squares = sum((out - beta @ m) ** 2 + gap @ P @ gap for out, m in rows)
        noise = (squares + np.trace(C @ S)) / n
        alpha = shape / (RATE + 0.5 * (beta**2 + np.diagonal(C)))
    return beta, noise + cross @ linalg.solve(psi, cross)


def model(**settings):
    """Return a regressor for data in any units."""
    defaults = {"latent": "correlated", "query": "noiseless", "fit_intercept": False}
    return VBJFARegressor(**defaults | settings)


def standard(X, y, psi, cross):
    """Return the same problem with unit mean squares of all columns."""
    x, s = np.sqrt((X**2).mean(axis=0)), np.sqrt((y**2).mean())
    return X / x, y / s, psi / np.outer(x, x), cross / (x * s)


def test_fit_is_the_fixed_point_of_literal_updates():
    X, y, psi, cross = standard(*problem())
    noise = {"input_noise": psi, "input_output_noise": cross}
    found = model(**noise).fit(X, y)
    beta, output = literal(X, y, psi, cross, 1000)
    assert_allclose(found.coef_noiseless_, beta, rtol=1e-6)
    assert_allclose(found.output_noise_, output, rtol=1e-6)
    assert np.diff(found.elbo_history_).min() >= -1e-9


def test_many_rows_give_the_corrected_moments():
    """With a weak prior, beta solves (S - n Psi) beta = s - n cross."""
    X, y, psi, cross = problem(n=20000, size=0.4)
    found = model(input_noise=psi, input_output_noise=cross).fit(X, y)
    n = len(y)
    corrected = linalg.solve(X.T @ X - n * psi, X.T @ y - n * cross)
    assert_allclose(found.coef_noiseless_, corrected, rtol=1e-3)
    assert_allclose(found.coef_noiseless_, [1.0, -2.0, 0.5], atol=0.05)
    noisy = linalg.solve(X.T @ X, X.T @ y)
    assert_allclose(found.coef_noisy_, noisy, rtol=1e-3)
    plain = model(input_noise=psi).fit(X, y)
    assert np.abs(plain.coef_noiseless_ - [1.0, -2.0, 0.5]).max() > 0.1


def test_excessive_noise_is_named():
    """Common noise must not exceed the variance of y."""
    X, y, psi, cross = problem()
    with pytest.warns(UserWarning, match=r"of y: at most 0\.\d+ of it is possible"):
        model(input_noise=psi, input_output_noise=20 * cross).fit(X, y)


def test_units_and_the_order_of_columns_do_not_matter():
    X, y, psi, cross = problem(n=200)
    found = model(input_noise=psi, input_output_noise=cross).fit(X, y)
    unit, order = np.array([1e3, 1e-2, 5.0]), [2, 0, 1]
    other = model(
        input_noise=(psi * np.outer(unit, unit))[np.ix_(order, order)],
        input_output_noise=(7.0 * cross * unit)[order],
    ).fit((X * unit)[:, order], 7.0 * y)
    assert_allclose(other.coef_, (7.0 * found.coef_ / unit)[order], rtol=1e-7)
    assert_allclose(other.output_noise_, 49.0 * found.output_noise_, rtol=1e-7)


def test_relevant_inputs_are_found_with_common_noise():
    """An input that only shares noise with the output is excluded."""
    rng = np.random.default_rng(3)
    t = rng.normal(size=(4000, 2))
    e = 0.5 * rng.normal(size=4000)
    X = t.copy()
    X[:, 1] += e
    y = 2.0 * t[:, 0] + 0.8 * e + 0.1 * rng.normal(size=4000)
    noise = {"input_noise": [0.0, 0.25], "input_output_noise": [0.0, 0.8 * 0.25]}
    found = model(**noise).fit(X, y)
    assert_allclose(found.coef_, [2.0, 0.0], atol=0.02)
    without = model(input_noise=[0.0, 0.25]).fit(X, y)
    assert abs(without.coef_[1]) > 0.1


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"input_output_noise": [0.1, 0.1]}, "must hold 3 covariances"),
        ({"input_output_noise": [0.1, np.nan, 0.1]}, "contains NaN"),
        ({"input_noise": None}, "needs the noise of the inputs as well"),
        ({"input_noise": [0.1, 0.0, 0.1]}, "for input 1 input_noise says that there"),
        ({"latent": "independent"}, 'set latent="correlated"'),
    ],
)
def test_invalid_covariances_are_refused(settings, text):
    X, y, psi, cross = problem()
    noise = {"input_noise": psi, "input_output_noise": cross} | settings
    if noise.get("latent") == "independent":
        noise["input_noise"] = np.diagonal(psi)
    with pytest.raises(ValueError, match=text):
        model(**noise).fit(X, y)
