"""The regression study of the paper, section 5.1."""

from numbers import Integral, Real

import numpy as np
from sklearn.utils import Bunch, check_random_state, check_scalar

# Signal-to-noise ratio of the output (variances), and number of test samples.
_OUTPUT_SNR, _N_TEST = 5.0, 2000


def make_noisy_regression(
    n_samples=1000,
    *,
    n_relevant=10,
    n_redundant=0,
    n_irrelevant=90,
    input_snr=2.0,
    random_state=None,
) -> Bunch:
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
    input_snr : float, default=2.0
        Signal-to-noise ratio: variance of the signal by that of the noise. That of the
        output is 5.
    random_state : int, RandomState instance or None, default=None
        Seed of everything that is drawn.

    Returns
    -------
    data : Bunch
        Data and truth: noisy training data `X` (n_samples, n_features), its columns
        relevant, redundant and irrelevant, and `y`; noiseless `X_test`, `y_test`; true
        coefficients `coef` (n_relevant,); which inputs are `relevant` (n_features,);
        variances `input_noise` (n_features,), `input_noise_covariance`, in which
        redundant inputs inherit the noise of what they are made of, and `output_noise`.

    Raises
    ------
    ValueError
        If the ratio is not positive, a number of inputs is negative, or there is no
        sample or no relevant input.

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
    ratio = {"min_val": 0, "include_boundaries": "neither"}
    check_scalar(input_snr, "input_snr", Real, **ratio)
    check_scalar(n_samples, "n_samples", Integral, min_val=1)
    check_scalar(n_relevant, "n_relevant", Integral, min_val=1)
    check_scalar(n_redundant, "n_redundant", Integral, min_val=0)
    check_scalar(n_irrelevant, "n_irrelevant", Integral, min_val=0)
    rng = check_random_state(random_state)
    root = rng.normal(size=(n_relevant, n_relevant)) / np.sqrt(n_relevant)
    covariance = root @ root.T
    coef = np.arange(1.0, n_relevant + 1)
    weights = rng.dirichlet(np.ones(n_relevant), size=n_redundant)
    noise = np.diagonal(covariance) / input_snr
    output_noise = float(coef @ covariance @ coef / _OUTPUT_SNR)

    t = rng.normal(size=(n_samples, n_relevant)) @ root.T
    y = t @ coef + np.sqrt(output_noise) * rng.normal(size=n_samples)
    x = t + np.sqrt(noise) * rng.normal(size=t.shape)
    X = np.hstack([x, x @ weights.T, rng.normal(size=(n_samples, n_irrelevant))])
    x_test = rng.normal(size=(_N_TEST, n_relevant)) @ root.T
    irrelevant = rng.normal(size=(_N_TEST, n_irrelevant))
    absent = np.zeros((n_irrelevant, n_relevant))
    mixing = np.vstack([np.eye(n_relevant), weights, absent])
    noise_covariance = mixing @ np.diag(noise) @ mixing.T
    return Bunch(
        X=X,
        y=y,
        X_test=np.hstack([x_test, x_test @ weights.T, irrelevant]),
        y_test=x_test @ coef,
        coef=coef,
        relevant=np.arange(len(noise_covariance)) < n_relevant,
        input_noise=np.diagonal(noise_covariance).copy(),
        input_noise_covariance=noise_covariance,
        output_noise=output_noise,
    )
