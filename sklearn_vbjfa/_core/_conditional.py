"""Exact conditional maximisers of the correlated-latent model's bound.

The plain iteration updates coefficients, precisions and output noise one after the
other, each given the others' last values, and creeps where two of them move together.
Here pairs are maximised jointly; every result is a higher bound at the price of the
same O(d^3), and the fixed points are those of the plain iteration.
"""

import numpy as np
from scipy import linalg

# Newton steps of the joint maximum of mean and noise; it is close from the second
# iteration on, and the outer loop goes on where this one stops.
_NEWTON_STEPS = 20
_ENOUGH = 1e-4  # share of the promised gain that a step must bring
_LARGEST_LOG = 300.0


def precisions_given_others(mean, variance, alpha, shape0, rate0):
    """Best E[alpha_m] of each coefficient, the posterior of the others held.

    mean, variance : posterior of beta under the precisions `alpha`, each (d,). Without
    its own prior, beta_m has the precision s_m = 1/variance - alpha and the score
    q_m = mean / variance (Tipping and Faul, 2003). The plain update is then

        alpha <- (2 a0 + 1) / (2 b0 + q^2 / (alpha + s)^2 + 1 / (alpha + s)),

    whose fixed points are the roots of a cubic. It rises with alpha, so that it would
    end at the next root on the side to which it moves: that one is returned.
    """
    total = 2 * shape0 + 1.0
    # An input that says nothing has s = 0, to rounding.
    s = np.maximum(1.0 / variance - alpha, np.finfo(float).eps / variance)
    strength = (mean / variance) ** 2 / s
    rate = 2 * rate0 * s
    # In v = s / alpha: total v^3 = (rate + strength + 1 - 2 total) v^2
    #                              + (2 rate - 2 a0) v + rate
    companion = np.zeros((s.size, 3, 3))
    companion[:, 0, 0] = (rate + strength + 1.0 - 2 * total) / total
    companion[:, 0, 1] = (2 * rate - 2 * shape0) / total
    companion[:, 0, 2] = rate / total
    companion[:, 1, 0] = companion[:, 2, 1] = 1.0
    roots = np.linalg.eigvals(companion)
    now = s / alpha
    v_next = now[:, None] / (1.0 + now[:, None])  # s / (alpha + s)
    plain = total / (rate + v_next[:, 0] * (strength * v_next[:, 0] + 1.0))  # alpha/s
    falls = (1.0 / plain < now)[:, None]  # v falls when alpha rises
    real = np.abs(roots.imag) <= np.sqrt(np.finfo(float).eps) * np.abs(roots)
    v = np.where(real & (roots.real > 0), roots.real, np.nan)
    below = np.where(v <= now[:, None], v, -np.inf).max(axis=1)
    above = np.where(v >= now[:, None], v, np.inf).min(axis=1)
    found = np.where(falls[:, 0], below, above)
    found = np.where(np.isfinite(found), found, 1.0 / plain)  # a root lost to rounding
    return s / found


def noise_given_shape(squares, n, d, penalty):
    """Best output noise s2 when the posterior covariance of beta scales with it.

    Maximises -(n log s2 + squares / s2) / 2 + (d log s2 - penalty s2) / 2, `penalty`
    being sum(alpha_m cov_mm) / s2.
    """
    half = 0.5 * (n - d)
    root = np.sqrt(half * half + penalty * squares)
    if half > 0:
        return squares / (half + root)
    return (root - half) / penalty


def mean_and_noise(moments, latent_gain, latent_cov, shape, start, alpha):
    """Best mean of beta and output noise together, q(T) at its optimum throughout.

    Given shape = cov / s2 (d, d), the noise enters the bound through
    y | x ~ N(c'x, s2 + beta'P beta), c = H'beta, with H and P the latent gain and
    covariance raised by `shape`; the prior and the entropy add
    -(beta' A beta + penalty s2 - d log s2) / 2. Newton's method in (beta, log s2) with
    the magnitudes of the eigenvalues, which makes each step an ascent.

    Parameters
    ----------
    moments : tuple
        S (d, d), S_xy (d,), S_yy and n.
    latent_gain, latent_cov : ndarray of shape (d, d)
        E[t | x] = H x and Cov[t | x].
    shape : ndarray of shape (d, d)
        Posterior covariance of beta over s2.
    start : tuple
        Mean (d,) and noise to start from.
    alpha : ndarray of shape (d,)
        Precisions of the prior.
    """
    S, xy, yy, n = moments
    mean, noise = start
    d = mean.size
    lu = linalg.lu_factor(np.eye(d) + latent_cov @ shape)
    H, P = linalg.lu_solve(lu, latent_gain), linalg.lu_solve(lu, latent_cov)
    P = 0.5 * (P + P.T)
    K, k = H @ S @ H.T, H @ xy
    penalty = alpha @ np.diagonal(shape)

    def value(mean, log_noise):
        s2 = np.exp(log_noise)
        q = s2 + mean @ P @ mean
        squares = yy - 2 * mean @ k + mean @ K @ mean
        data = n * np.log(q) + squares / q
        return -0.5 * (data + alpha @ mean**2 - d * log_noise + penalty * s2)

    log_noise = np.log(noise)
    best = value(mean, log_noise)
    curvature = np.empty((d + 1, d + 1))
    for _ in range(_NEWTON_STEPS):
        s2, w = np.exp(log_noise), 2 * P @ mean
        q = s2 + 0.5 * mean @ w
        r = k - K @ mean
        squares = yy - mean @ (k + r)
        on_q, on_qq = 0.5 * (squares / q - n) / q, (0.5 * n - squares / q) / q**2
        gradient = np.append(
            on_q * w + r / q - alpha * mean, on_q * s2 + 0.5 * (d - penalty * s2)
        )
        cross = np.outer(w, r) / q**2
        curvature[:d, :d] = K / q - 2 * on_q * P - on_qq * np.outer(w, w)
        curvature[:d, :d] += cross + cross.T + np.diag(alpha)
        curvature[:d, d] = curvature[d, :d] = s2 * (r / q**2 - on_qq * w)
        curvature[d, d] = 0.5 * penalty * s2 - on_q * s2 - on_qq * s2**2
        unit = 1.0 / np.sqrt(np.append(np.diagonal(K) / q + alpha, 0.5 * n))
        values, vectors = linalg.eigh(curvature * np.outer(unit, unit))
        values = np.maximum(np.abs(values), d * np.finfo(float).eps * abs(values[-1]))
        step = unit * (vectors @ ((vectors.T @ (unit * gradient)) / values))
        promised = gradient @ step
        # The exponential of the noise's logarithm must stay a number.
        length = min(1.0, _LARGEST_LOG / max(abs(step[d]), 1.0))
        while True:
            trial = mean + length * step[:d], log_noise + length * step[d]
            new = value(*trial)
            if new >= best + _ENOUGH * length * promised:
                break
            length *= 0.5
            if length * promised <= np.finfo(float).eps * n:
                return mean, float(np.exp(log_noise))
        (mean, log_noise), best = trial, new
    return mean, float(np.exp(log_noise))
