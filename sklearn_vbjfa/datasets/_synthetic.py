"""The synthetic regression study of the paper, section 5.1."""

from dataclasses import dataclass

import numpy as np
from sklearn.utils import check_random_state


@dataclass(frozen=True, kw_only=True)
class NoisyRegression:
    """A regression with noisy inputs and output, noiseless test data, and the truth.

    Attributes
    ----------
    X, y : ndarray of shape (n_samples, n_features), (n_samples,)
        Noisy training data. Columns: relevant inputs, redundant, irrelevant.
    X_test, y_test : ndarray of shape (n_test, n_features), (n_test,)
        Noiseless test data.
    coef : ndarray of shape (n_relevant,)
        True coefficients of the relevant inputs.
    relevant : ndarray of shape (n_features,), bool
        The relevant inputs.
    irrelevant : ndarray of shape (n_features,), bool
        The inputs that have nothing to do with the output.
    input_noise : ndarray of shape (n_features,)
        Variances of the inputs' noise.
    input_noise_covariance : ndarray of shape (n_features, n_features)
        Its covariance: redundant inputs inherit the noise of what they are made of.
    output_noise : float
        Variance of the output's noise.
    """

    X: np.ndarray
    y: np.ndarray
    X_test: np.ndarray
    y_test: np.ndarray
    coef: np.ndarray
    relevant: np.ndarray
    irrelevant: np.ndarray
    input_noise: np.ndarray
    input_noise_covariance: np.ndarray
    output_noise: float


def make_noisy_regression(
    n_samples=1000,
    *,
    n_relevant=10,
    n_redundant=0,
    n_irrelevant=90,
    input_snr=2.0,
    output_snr=5.0,
    n_test=2000,
    random_state=None,
) -> NoisyRegression:
    """Generate the data of section 5.1 of the paper.

    The relevant inputs are Gaussian with a random covariance, the output has the
    coefficients 1, 2, ..., noise is added to both, redundant inputs are random convex
    combinations of the noisy relevant ones, irrelevant ones are standard normal. Test
    data are made likewise without any noise.

    Parameters
    ----------
    n_samples : int, default=1000
        Number of training samples (the paper does not say).
    n_relevant, n_redundant, n_irrelevant : int, default=10, 0, 90
        Numbers of inputs of each kind.
    input_snr, output_snr : float, default=2.0, 5.0
        Signal-to-noise ratios: variance of the signal by that of the noise.
    n_test : int, default=2000
        Number of test samples.
    random_state : int, RandomState instance or None, default=None
        Seed of everything that is drawn.

    Returns
    -------
    NoisyRegression
        Data and truth.

    Raises
    ------
    ValueError
        If a ratio is not positive, a number of inputs is negative, or none is relevant.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import make_noisy_regression
    >>> data = make_noisy_regression(n_redundant=30, n_irrelevant=60, random_state=0)
    >>> data.X.shape, int(data.relevant.sum())
    ((1000, 100), 10)
    """
    if input_snr <= 0 or output_snr <= 0:
        raise ValueError(
            "Signal-to-noise ratios must be positive, got input_snr="
            f"{input_snr} and output_snr={output_snr}; infinity means no noise."
        )
    if n_relevant < 1 or n_redundant < 0 or n_irrelevant < 0:
        raise ValueError(
            "At least one relevant input and no negative numbers are needed, got "
            f"n_relevant={n_relevant}, n_redundant={n_redundant}, "
            f"n_irrelevant={n_irrelevant}."
        )
    rng = check_random_state(random_state)
    root = rng.normal(size=(n_relevant, n_relevant)) / np.sqrt(n_relevant)
    covariance = root @ root.T
    coef = np.arange(1.0, n_relevant + 1)
    weights = rng.dirichlet(np.ones(n_relevant), size=n_redundant)
    noise = np.diagonal(covariance) / input_snr
    output_noise = float(coef @ covariance @ coef / output_snr)

    t = rng.normal(size=(n_samples, n_relevant)) @ root.T
    y = t @ coef + np.sqrt(output_noise) * rng.normal(size=n_samples)
    x = t + np.sqrt(noise) * rng.normal(size=t.shape)
    X = np.hstack([x, x @ weights.T, rng.normal(size=(n_samples, n_irrelevant))])
    t_test = rng.normal(size=(n_test, n_relevant)) @ root.T
    X_test = np.hstack(
        [t_test, t_test @ weights.T, rng.normal(size=(n_test, n_irrelevant))]
    )
    made = np.vstack(
        [np.eye(n_relevant), weights, np.zeros((n_irrelevant, n_relevant))]
    )
    full = made @ np.diag(noise) @ made.T
    kind = np.repeat([0, 1, 2], [n_relevant, n_redundant, n_irrelevant])
    return NoisyRegression(
        X=X,
        y=y,
        X_test=X_test,
        y_test=t_test @ coef,
        coef=coef,
        relevant=kind == 0,
        irrelevant=kind == 2,
        input_noise=np.diagonal(full).copy(),
        input_noise_covariance=full,
        output_noise=output_noise,
    )
