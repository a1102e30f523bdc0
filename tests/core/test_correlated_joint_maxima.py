"""Joint maximisers against brute force."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import optimize

from sklearn_vbjfa._core import _correlated
from sklearn_vbjfa._core._moments import SecondMoments


@pytest.mark.parametrize(("shape0", "rate0"), [(1e-6, 1e-6), (0.3, 0.7)])
def test_precisions_are_fixed_points_of_the_plain_update(shape0, rate0):
    rng = np.random.default_rng(0)
    n = 200
    alpha = 10.0 ** rng.uniform(-3, 5, n)
    s = 10.0 ** rng.uniform(-2, 4, n)
    q = rng.normal(size=n) * np.sqrt(s) * 10.0 ** rng.uniform(-1, 2, n)

    def plain(alpha):
        total = alpha + s
        return (2 * shape0 + 1) / (2 * rate0 + (q / total) ** 2 + 1 / total)

    found = _correlated.precisions_given_others(
        q / (alpha + s), 1 / (alpha + s), alpha, shape0, rate0
    )
    # Slopes of the plain update near one take digits of a root.
    assert_allclose(plain(found), found, rtol=1e-5)
    # On the side to which the plain iteration goes, and the first there: the update
    # keeps its direction all the way.
    assert np.all((found > alpha) == (plain(alpha) > alpha))
    for share in (0.25, 0.5, 0.75):
        between = alpha * (found / alpha) ** share
        rises = (plain(between) - between) * np.sign(found - alpha)
        assert np.all(rises >= -1e-9 * between)


@pytest.mark.parametrize("d", [3, 30])
def test_noise_is_the_maximum(d):
    n, squares, penalty = 20.0, 7.0, 4.0

    def minus(log_s2):
        s2 = np.exp(log_s2)
        return 0.5 * ((n - d) * log_s2 + squares / s2 + penalty * s2)

    best = optimize.minimize_scalar(minus, bounds=(-10, 10), method="bounded")
    found = _correlated.noise_given_shape(squares, n, d, penalty)
    assert_allclose(np.log(found), best.x, atol=1e-4)


def test_mean_and_noise_are_the_maximum():
    rng = np.random.default_rng(1)
    d, n = 3, 40.0
    root = rng.normal(size=(3, d, d))
    S, P = n * (root[0] @ root[0].T + np.eye(d)), 0.1 * root[1] @ root[1].T
    H = np.eye(d) + 0.1 * root[2]
    xy, alpha = S @ np.array([1.0, -0.5, 0.2]), np.array([0.1, 1.0, 3.0])
    yy = float(xy @ np.linalg.solve(S, xy)) + 30.0
    shape = np.linalg.inv(S)
    moments = SecondMoments(n=n, S=S, xx=np.diagonal(S), xy=xy, yy=yy)
    latent = _correlated.Latent(H=H, P=P, Sigma_t=S / n, exact=False, clipped=())
    mean, s2 = _correlated.mean_and_noise(
        moments, latent, shape, (np.zeros(d), 1.0), alpha
    )
    inflate = np.linalg.inv(np.eye(d) + P @ shape)
    gain, spread = inflate @ H, inflate @ P

    def minus(vector):
        beta, noise = vector[:d], np.exp(vector[d])
        c, q = gain.T @ beta, noise + beta @ spread @ beta
        value = n * np.log(q) + (yy - 2 * c @ xy + c @ S @ c) / q
        value += alpha @ beta**2 - d * vector[d] + noise * alpha @ np.diagonal(shape)
        return 0.5 * value

    best = optimize.minimize(minus, np.zeros(d + 1), options={"gtol": 1e-9})
    assert_allclose(mean, best.x[:d], atol=1e-5)
    assert_allclose(np.log(s2), best.x[d], atol=1e-5)
