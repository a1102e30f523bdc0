"""Rounding with nearly dependent inputs and nearly noise-free outputs."""

import numpy as np
import pytest
from scipy import linalg

from sklearn_vbjfa import VBJFARegressor


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


@pytest.mark.parametrize("n", [30, 3000])
@pytest.mark.parametrize("noise", [1e-2, 1e-10])
@pytest.mark.parametrize("condition", [1e2, 1e6, 1e12])
def test_predictions_equal_those_from_the_rows(condition, noise, n):
    X, y, reference = make_problem(n, condition, noise)
    model = make_model().fit(X, y)
    # The bias by the prior is far below the standard error; the rounding of X @ coef
    # is eps times the condition number for any solver.
    error = relative(model.predict(X), reference)
    standard_error = noise * np.sqrt(6 / n)
    assert error < 0.1 * standard_error + 64 * np.finfo(float).eps * condition
    assert model.converged_
