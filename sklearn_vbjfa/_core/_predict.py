"""Regression coefficients for noisy and for noiseless queries."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class LinearModel:
    """Answer to one kind of query, in standardised units.

    Coefficients (d,), their covariance (d, d), and the variance of y given the query.
    """

    coef: np.ndarray
    cov: np.ndarray
    noise: float


def coefficients_noisy(state):
    """Coefficient of E[y | x] for noisy x.

    Eq. 27 with point estimates reduces, input by input, to
    w_z w_x / (w_x^2 + psi_x).
    """
    w_x = state.w_x_mean
    return state.w_z_mean * w_x / (w_x**2 + state.psi_x)  # [eq. 27]


def coefficients_noiseless(state, retained):
    """Coefficient of E[y | t] for noiseless inputs, zero where not retained.

    The prefactor of eq. 29 cancels: beta = w_z / w_x. For an input that the ARD
    prior has switched off both loadings vanish and their ratio means nothing.
    """
    beta = np.zeros_like(state.w_z_mean)
    beta[retained] = state.w_z_mean[retained] / state.w_x_mean[retained]  # [eq. 29]
    return beta
