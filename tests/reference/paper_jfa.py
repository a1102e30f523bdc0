"""Slow, literal transcription of Ting, D'Souza & Schaal (2011).

J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification with input
and output noise", Neural Networks (2011). Sections 3 and 4, equation by equation,
with loops over samples and dense matrices, so that each line can be compared with the
paper. It is the reference for tests of the package and imports nothing from it.

The data are centred, there is no intercept:

    y = sum_m z_m + eps_y,  z_m = w_zm t_m + eps_zm,  x_m = w_xm t_m + eps_xm,
    t_m ~ Normal(0, 1)

Functions whose names end in ``_printed`` are misprinted formulas of the paper, which
tests show to be false.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import digamma, gammaln
from scipy.stats import multivariate_normal

LOG_2PI = np.log(2.0 * np.pi)


@dataclass(frozen=True, kw_only=True)
class JFAParams:
    """Point estimates of Fig. 1b; arrays have shape (n_features,)."""

    w_z: np.ndarray
    w_x: np.ndarray
    psi_y: float
    psi_z: np.ndarray
    psi_x: np.ndarray

    def moments(self):
        """Arguments of the E-step: loadings without posterior variance."""
        return {
            "w_z_mean": self.w_z,
            "w_z_var": np.zeros_like(self.w_z),
            "w_x_mean": self.w_x,
            "w_x_var": np.zeros_like(self.w_x),
            "psi_y": self.psi_y,
            "psi_z": self.psi_z,
            "psi_x": self.psi_x,
        }


@dataclass(frozen=True, kw_only=True)
class VBParams:
    """q(w_z), q(w_x), q(alpha) and the noise variances of Fig. 1c.

    Arrays have shape (n_features,); q(alpha_m) is Gamma with shape and rate.
    """

    w_z_mean: np.ndarray
    w_z_var: np.ndarray
    w_x_mean: np.ndarray
    w_x_var: np.ndarray
    alpha_shape: np.ndarray
    alpha_rate: np.ndarray
    psi_y: float
    psi_z: np.ndarray
    psi_x: np.ndarray

    def moments(self):
        """Arguments of the E-step over Z and T, which does not depend on alpha."""
        return {k: v for k, v in vars(self).items() if not k.startswith("alpha")}


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Gaussian q(z_i, t_i): means (n_samples, n_features), covariances shared by all i.

    ``Sigma_zt[m, k]`` is the covariance of z_m and t_k.
    """

    E_z: np.ndarray
    E_t: np.ndarray
    Sigma_zz: np.ndarray
    Sigma_zt: np.ndarray
    Sigma_tt: np.ndarray

    def covariance(self):
        """Dense (2 n_features, 2 n_features) covariance of (z_i, t_i)."""
        return np.block(
            [[self.Sigma_zz, self.Sigma_zt], [self.Sigma_zt.T, self.Sigma_tt]]
        )


# -- E-step over Z and T ---------------------------------------------------------------


def sigma_zt(Sigma_zz, W_z, Psi_z, K):
    """Cross covariance of z and t, eq. 19 with the sign corrected."""
    return Sigma_zz @ W_z @ np.linalg.inv(Psi_z) @ np.linalg.inv(K)  # [eq. 19]


def sigma_zt_printed(Sigma_zz, W_z, Psi_z, K):
    """Eq. 19 as printed: the sign is wrong."""
    return -Sigma_zz @ W_z @ np.linalg.inv(Psi_z) @ np.linalg.inv(K)  # [eq. 19]


def matrix_k(*, w_z_mean, w_z_var, w_x_mean, w_x_var, psi_z, psi_x):
    """Precision block of t."""
    W_zz = np.diag(w_z_mean**2 + w_z_var)
    W_xx = np.diag(w_x_mean**2 + w_x_var)
    Psi_z_inv = np.linalg.inv(np.diag(psi_z))
    Psi_x_inv = np.linalg.inv(np.diag(psi_x))
    return np.eye(len(w_z_mean)) + W_xx @ Psi_x_inv + W_zz @ Psi_z_inv  # [eq. 21]


def posterior_zt(
    X,
    y,
    *,
    w_z_mean,
    w_z_var,
    w_x_mean,
    w_x_var,
    psi_y,
    psi_z,
    psi_x,
    cross_covariance=sigma_zt,
):
    """q(Z, T) by eqs. 17-25, one sample at a time."""
    n_samples, n_features = X.shape
    one = np.ones(n_features)
    W_z, W_x = np.diag(w_z_mean), np.diag(w_x_mean)
    W_xx = np.diag(w_x_mean**2 + w_x_var)
    Psi_z, Psi_x = np.diag(psi_z), np.diag(psi_x)
    Psi_z_inv, Psi_x_inv = np.linalg.inv(Psi_z), np.linalg.inv(Psi_x)
    K = matrix_k(
        w_z_mean=w_z_mean,
        w_z_var=w_z_var,
        w_x_mean=w_x_mean,
        w_x_var=w_x_var,
        psi_z=psi_z,
        psi_x=psi_x,
    )
    K_inv = np.linalg.inv(K)
    inner = np.eye(n_features) + W_xx @ Psi_x_inv + np.diag(w_z_var) @ Psi_z_inv
    M = Psi_z + W_z @ np.linalg.inv(inner) @ W_z.T  # [eq. 22]
    Sigma_zz = M - M @ np.outer(one, one) @ M / (psi_y + one @ M @ one)  # [eq. 17]
    Sigma_tt = (
        K_inv + K_inv @ W_z.T @ Psi_z_inv @ Sigma_zz @ Psi_z_inv @ W_z @ K_inv
    )  # [eq. 18]
    Sigma_zt = cross_covariance(Sigma_zz, W_z, Psi_z, K)
    Sigma_tz = Sigma_zt.T  # [eq. 20]
    E_z, E_t = np.empty_like(X), np.empty_like(X)
    for i in range(n_samples):
        from_x = X[i] @ W_x.T @ Psi_x_inv
        E_z[i] = y[i] / psi_y * one @ Sigma_zz + from_x @ Sigma_tz  # [eq. 23]
        E_t[i] = (
            y[i] / psi_y * one @ Sigma_zz @ W_z @ Psi_z_inv @ K_inv + from_x @ Sigma_tt
        )  # [eq. 24]
    return Posterior(
        E_z=E_z, E_t=E_t, Sigma_zz=Sigma_zz, Sigma_zt=Sigma_zt, Sigma_tt=Sigma_tt
    )


def joint_covariance(params):
    """Dense covariance of (t, z, x, y) for point estimates, from eqs. 3-4.

    Each variable is a linear map of the independent (t, eps_z, eps_x, eps_y).
    """
    n_features = len(params.w_z)
    I_d, O_d = np.eye(n_features), np.zeros((n_features, n_features))
    W_z, W_x = np.diag(params.w_z), np.diag(params.w_x)
    one, zero = np.ones((1, n_features)), np.zeros((1, n_features))
    nil = np.zeros((n_features, 1))
    mixing = np.block(
        [
            [I_d, O_d, O_d, nil],
            [W_z, I_d, O_d, nil],
            [W_x, O_d, I_d, nil],
            [one @ W_z, one, zero, np.ones((1, 1))],
        ]
    )  # [eq. 3]
    source_var = np.concatenate(
        [np.ones(n_features), params.psi_z, params.psi_x, [params.psi_y]]
    )  # [eq. 4]
    return mixing @ np.diag(source_var) @ mixing.T


def condition_gaussian(Sigma, hidden, observed):
    """Gain and covariance of a zero-mean Gaussian, hidden given observed."""
    Sigma_ho = Sigma[np.ix_(hidden, observed)]
    Sigma_oo = Sigma[np.ix_(observed, observed)]
    gain = Sigma_ho @ np.linalg.inv(Sigma_oo)
    return gain, Sigma[np.ix_(hidden, hidden)] - gain @ Sigma_ho.T


# -- Sums over samples and the blocks of the iteration ---------------------------------


def sample_sums(posterior, X, y):
    """Sum over samples for eqs. 8-16; each is (n_features,) or scalar."""
    n_samples, n_features = X.shape
    one = np.ones(n_features)
    S_zz, S_zt, S_tt, S_xt, S_xx = (np.zeros(n_features) for _ in range(5))
    S_yy, S_yz, S_1zz1 = 0.0, 0.0, 0.0
    for i in range(n_samples):
        E_z, E_t = posterior.E_z[i], posterior.E_t[i]
        E_zz = posterior.Sigma_zz + np.outer(E_z, E_z)
        E_zt = posterior.Sigma_zt + np.outer(E_z, E_t)
        E_tt = posterior.Sigma_tt + np.outer(E_t, E_t)
        S_zz += np.diag(E_zz)  # [eq. 25]
        S_zt += np.diag(E_zt)  # [eq. 25]
        S_tt += np.diag(E_tt)  # [eq. 25]
        S_xt += X[i] * E_t
        S_xx += X[i] ** 2
        S_yy += y[i] ** 2
        S_yz += y[i] * (one @ E_z)
        S_1zz1 += one @ E_zz @ one
    return {
        "zz": S_zz,
        "zt": S_zt,
        "tt": S_tt,
        "xt": S_xt,
        "xx": S_xx,
        "yy": S_yy,
        "yz": S_yz,
        "1zz1": S_1zz1,
    }


def update_psi_y(posterior, X, y):
    """Output-noise variance."""
    S = sample_sums(posterior, X, y)
    return (S["yy"] - 2.0 * S["yz"] + S["1zz1"]) / len(y)  # [eq. 14]


def update_psi_z(posterior, X, y, *, w_z_mean, w_z_var):
    """Variances of the hidden z, shape (n_features,)."""
    S = sample_sums(posterior, X, y)
    E_wzz = w_z_mean**2 + w_z_var
    return (S["zz"] - 2.0 * w_z_mean * S["zt"] + E_wzz * S["tt"]) / len(y)  # [eq. 15]


def update_psi_x(posterior, X, y, *, w_x_mean, w_x_var):
    """Input-noise variances, shape (n_features,)."""
    S = sample_sums(posterior, X, y)
    E_wxx = w_x_mean**2 + w_x_var
    return (S["xx"] - 2.0 * w_x_mean * S["xt"] + E_wxx * S["tt"]) / len(y)  # [eq. 16]


def update_w_z(posterior, X, y, *, psi_z, E_alpha):
    """q(w_z): mean and variance, each (n_features,)."""
    S = sample_sums(posterior, X, y)
    w_z_var = 1.0 / (S["tt"] / psi_z + E_alpha)  # [eq. 8]
    return w_z_var / psi_z * S["zt"], w_z_var  # [eq. 9]


def update_w_x(posterior, X, y, *, psi_x, E_alpha):
    """q(w_x): mean and variance, each (n_features,)."""
    S = sample_sums(posterior, X, y)
    w_x_var = 1.0 / (S["tt"] / psi_x + E_alpha)  # [eq. 10]
    return w_x_var / psi_x * S["xt"], w_x_var  # [eq. 11]


def update_alpha(*, w_z_mean, w_z_var, w_x_mean, w_x_var, ard_shape, ard_rate):
    """q(alpha): shape and rate, each (n_features,)."""
    alpha_shape = np.full_like(w_z_mean, ard_shape) + 1.0  # [eq. 12]
    E_wzz, E_wxx = w_z_mean**2 + w_z_var, w_x_mean**2 + w_x_var
    return alpha_shape, ard_rate + (E_wzz + E_wxx) / 2.0  # [eq. 13]


def jfa_em_step(params, X, y, *, cross_covariance=sigma_zt):
    """One EM iteration of section 3.1 (Fig. 1b), noise variances with the new w."""
    posterior = posterior_zt(
        X, y, cross_covariance=cross_covariance, **params.moments()
    )
    S = sample_sums(posterior, X, y)
    # Maximum likelihood: eqs. 9 and 11 in the limit of a flat prior, alpha -> 0.
    w_z = S["zt"] / S["tt"]  # [eq. 9]
    w_x = S["xt"] / S["tt"]  # [eq. 11]
    zero = np.zeros_like(w_z)
    return JFAParams(
        w_z=w_z,
        w_x=w_x,
        psi_y=update_psi_y(posterior, X, y),
        psi_z=update_psi_z(posterior, X, y, w_z_mean=w_z, w_z_var=zero),
        psi_x=update_psi_x(posterior, X, y, w_x_mean=w_x, w_x_var=zero),
    )


def vb_step(params, X, y, ard_shape, ard_rate):
    """One iteration of section 3.2: q(Z, T), q(w_z), q(w_x), q(alpha), then the psi."""
    posterior = posterior_zt(X, y, **params.moments())
    E_alpha = params.alpha_shape / params.alpha_rate
    w_z_mean, w_z_var = update_w_z(posterior, X, y, psi_z=params.psi_z, E_alpha=E_alpha)
    w_x_mean, w_x_var = update_w_x(posterior, X, y, psi_x=params.psi_x, E_alpha=E_alpha)
    alpha_shape, alpha_rate = update_alpha(
        w_z_mean=w_z_mean,
        w_z_var=w_z_var,
        w_x_mean=w_x_mean,
        w_x_var=w_x_var,
        ard_shape=ard_shape,
        ard_rate=ard_rate,
    )
    return replace(
        params,
        w_z_mean=w_z_mean,
        w_z_var=w_z_var,
        w_x_mean=w_x_mean,
        w_x_var=w_x_var,
        alpha_shape=alpha_shape,
        alpha_rate=alpha_rate,
        psi_y=update_psi_y(posterior, X, y),
        psi_z=update_psi_z(posterior, X, y, w_z_mean=w_z_mean, w_z_var=w_z_var),
        psi_x=update_psi_x(posterior, X, y, w_x_mean=w_x_mean, w_x_var=w_x_var),
    )


# -- The bound and the likelihood ------------------------------------------------------


def data_terms(
    X, y, posterior, *, w_z_mean, w_z_var, w_x_mean, w_x_var, psi_y, psi_z, psi_x
):
    """Terms of the bound that depend on the samples, with the entropy of q(Z, T)."""
    n_samples, n_features = X.shape
    one = np.ones(n_features)
    log_p_y, log_p_z, log_p_x, log_p_t, entropy_zt = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n_samples):
        E_z, E_t = posterior.E_z[i], posterior.E_t[i]
        E_zz = posterior.Sigma_zz + np.outer(E_z, E_z)
        E_zt = posterior.Sigma_zt + np.outer(E_z, E_t)
        E_tt = posterior.Sigma_tt + np.outer(E_t, E_t)
        E_square = y[i] ** 2 - 2.0 * y[i] * (one @ E_z) + one @ E_zz @ one
        log_p_y += -0.5 * (LOG_2PI + np.log(psi_y) + E_square / psi_y)  # [eq. 6]
        for m in range(n_features):
            E_square = (
                E_zz[m, m]
                - 2.0 * w_z_mean[m] * E_zt[m, m]
                + (w_z_mean[m] ** 2 + w_z_var[m]) * E_tt[m, m]
            )
            log_p_z += -0.5 * (
                LOG_2PI + np.log(psi_z[m]) + E_square / psi_z[m]
            )  # [eq. 6]
            E_square = (
                X[i, m] ** 2
                - 2.0 * w_x_mean[m] * X[i, m] * E_t[m]
                + (w_x_mean[m] ** 2 + w_x_var[m]) * E_tt[m, m]
            )
            log_p_x += -0.5 * (
                LOG_2PI + np.log(psi_x[m]) + E_square / psi_x[m]
            )  # [eq. 6]
            log_p_t += -0.5 * (LOG_2PI + E_tt[m, m])  # [eq. 6]
        logdet = np.linalg.slogdet(posterior.covariance())[1]
        entropy_zt += 0.5 * (2 * n_features * (1.0 + LOG_2PI) + logdet)
    return {
        "log_p_y": log_p_y,
        "log_p_z": log_p_z,
        "log_p_x": log_p_x,
        "log_p_t": log_p_t,
        "entropy_zt": entropy_zt,
    }


def prior_terms(params, ard_shape, ard_rate):
    """Prior terms of the bound for w_z, w_x and alpha, with their entropies."""
    log_p_w_z, log_p_w_x, log_p_alpha = 0.0, 0.0, 0.0
    entropy_w_z, entropy_w_x, entropy_alpha = 0.0, 0.0, 0.0
    for m in range(len(params.w_z_mean)):
        shape, rate = params.alpha_shape[m], params.alpha_rate[m]
        E_alpha, E_log_alpha = shape / rate, digamma(shape) - np.log(rate)
        E_wzz = params.w_z_mean[m] ** 2 + params.w_z_var[m]
        E_wxx = params.w_x_mean[m] ** 2 + params.w_x_var[m]
        log_p_w_z += 0.5 * (E_log_alpha - LOG_2PI - E_alpha * E_wzz)  # [eq. 5]
        log_p_w_x += 0.5 * (E_log_alpha - LOG_2PI - E_alpha * E_wxx)  # [eq. 5]
        log_p_alpha += (
            ard_shape * np.log(ard_rate)
            - gammaln(ard_shape)
            + (ard_shape - 1.0) * E_log_alpha
            - ard_rate * E_alpha
        )  # [eq. 5]
        entropy_w_z += 0.5 * (1.0 + LOG_2PI + np.log(params.w_z_var[m]))
        entropy_w_x += 0.5 * (1.0 + LOG_2PI + np.log(params.w_x_var[m]))
        entropy_alpha += (
            shape - np.log(rate) + gammaln(shape) + (1.0 - shape) * digamma(shape)
        )
    return {
        "log_p_w_z": log_p_w_z,
        "log_p_w_x": log_p_w_x,
        "log_p_alpha": log_p_alpha,
        "entropy_w_z": entropy_w_z,
        "entropy_w_x": entropy_w_x,
        "entropy_alpha": entropy_alpha,
    }


def elbo_terms(params, X, y, ard_shape, ard_rate, posterior=None):
    """All terms of the bound by name; q(Z, T) is the optimal one unless given."""
    if posterior is None:
        posterior = posterior_zt(X, y, **params.moments())
    return {
        **data_terms(X, y, posterior, **params.moments()),
        **prior_terms(params, ard_shape, ard_rate),
    }


def elbo(params, X, y, ard_shape, ard_rate, posterior=None):
    """Variational lower bound on log p(X, y), with all its constants."""
    return sum(elbo_terms(params, X, y, ard_shape, ard_rate, posterior).values())


def elbo_eq5_printed(params, X, y, ard_shape, ard_rate, posterior=None):
    """Bound with eq. 5 as printed: p(w_z | alpha) twice, no prior on w_x."""
    terms = elbo_terms(params, X, y, ard_shape, ard_rate, posterior)
    return sum(terms.values()) + terms["log_p_w_z"] - terms["log_p_w_x"]


def elbo_eq6_printed(params, X, y, ard_shape, ard_rate, posterior=None):
    """Bound with eq. 6 as printed: p(alpha_m) once for each of the two loadings."""
    terms = elbo_terms(params, X, y, ard_shape, ard_rate, posterior)
    return sum(terms.values()) + terms["log_p_alpha"]


def jfa_loglik(params, X, y):
    """Gaussian log-likelihood of (x, y) from the dense joint covariance."""
    n_features = X.shape[1]
    observed = np.arange(2 * n_features, 3 * n_features + 1)
    Sigma = joint_covariance(params)[np.ix_(observed, observed)]
    mean = np.zeros(n_features + 1)
    return float(
        sum(
            multivariate_normal.logpdf(np.append(X[i], y[i]), mean, Sigma)
            for i in range(len(y))
        )
    )


# -- Regression vectors of section 3.3 -------------------------------------------------


def beta_noise_eq27(w_z, w_x, psi_y, psi_z, psi_x, *, w_z_var=None, w_x_var=None):
    """Coefficients for noisy queries; the paper uses point estimates for <W'W>.

    With ``w_z_var`` and ``w_x_var`` the angle brackets are second moments.
    """
    n_features = len(w_z)
    one = np.ones(n_features)
    W_z, W_x = np.diag(w_z), np.diag(w_x)
    W_zz = W_z.T @ W_z + (0.0 if w_z_var is None else np.diag(w_z_var))
    W_xx = W_x.T @ W_x + (0.0 if w_x_var is None else np.diag(w_x_var))
    Psi_z_inv, Psi_x_inv = np.linalg.inv(np.diag(psi_z)), np.linalg.inv(np.diag(psi_x))
    A_noise = np.eye(n_features) + W_xx @ Psi_x_inv + W_zz @ Psi_z_inv  # [eq. 27]
    A_inv = np.linalg.inv(A_noise)
    B = (
        np.outer(one, one) / psi_y
        + Psi_z_inv
        - Psi_z_inv @ W_z.T @ A_inv @ W_z @ Psi_z_inv
    )  # [eq. 27]
    B_inv = np.linalg.inv(B)
    scale = psi_y * one @ B_inv / (psi_y - one @ B_inv @ one)  # [eq. 27]
    return scale @ Psi_z_inv @ W_z @ A_inv @ W_x.T @ Psi_x_inv  # [eq. 27]


def beta_jfa_eq28(w_z, w_x, psi_x):
    """Coefficients of joint factor analysis, with the corrected A_JFA.

    The paper's expression is a diagonal matrix; the regression vector is its diagonal.
    """
    W_z, W_x = np.diag(w_z), np.diag(w_x)
    Psi_x_inv = np.linalg.inv(np.diag(psi_x))
    A_jfa = np.eye(len(w_z)) + W_x.T @ Psi_x_inv @ W_x  # [eq. 28]
    return np.diag(W_z @ np.linalg.inv(A_jfa) @ W_x.T @ Psi_x_inv)  # [eq. 28]


def beta_jfa_eq28_printed(w_z, w_x, psi_x):
    """Eq. 28 as printed: A_JFA has an additional W_x."""
    W_z, W_x = np.diag(w_z), np.diag(w_x)
    Psi_x_inv = np.linalg.inv(np.diag(psi_x))
    A_jfa = np.eye(len(w_z)) + W_x.T @ W_x @ Psi_x_inv @ W_x  # [eq. 28]
    return np.diag(W_z @ np.linalg.inv(A_jfa) @ W_x.T @ Psi_x_inv)  # [eq. 28]


def beta_true_eq29(w_z, w_x, psi_y, psi_z):
    """Coefficients for noiseless queries."""
    one = np.ones(len(w_z))
    W_z, W_x = np.diag(w_z), np.diag(w_x)
    Psi_z_inv = np.linalg.inv(np.diag(psi_z))
    C_inv = np.linalg.inv(np.outer(one, one) / psi_y + Psi_z_inv)  # [eq. 29]
    scale = psi_y * one @ C_inv / (psi_y - one @ C_inv @ one)  # [eq. 29]
    return scale @ Psi_z_inv @ W_z.T @ np.linalg.inv(W_x)  # [eq. 29]
