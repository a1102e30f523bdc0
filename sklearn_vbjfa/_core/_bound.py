"""The variational lower bound, with all its constants.

With q(Z, T) at its optimum the terms in Z and T and their entropy add up to the
log-normaliser of one Gaussian: x_m ~ N(0, psi_x + w_x^2 / a_m) and
y | x ~ N(c'x, s), where a_m is the prior precision of t_m raised by the loadings'
uncertainty (each sample then also pays -log(a_m)/2). For JFA, a_m = 1 and the bound
is the log-likelihood itself.
"""

import numpy as np
from scipy.special import digamma, gammaln

_LOG_2PI = float(np.log(2 * np.pi))


def data_bound(moments, hidden):
    """Return the expected log-likelihood plus the entropy of q(Z, T)."""
    n = moments.n
    x_part = n * (_LOG_2PI + np.log(hidden.x_var) + np.log(hidden.t_precision))
    x_part = x_part + moments.xx / hidden.x_var
    y_part = n * (_LOG_2PI + np.log(hidden.y_var)) + hidden.S_ee / hidden.y_var
    return -0.5 * float(x_part.sum() + y_part)


def prior_bound(state, prior):
    """Minus the divergence of q(w_z) q(w_x) q(alpha) from the prior, plus noise prior.

    [eq. 5], whose second line is p(w_x | alpha). The inverse-gamma prior on psi_x
    enters through its density on log(psi_x), without its constant (the weight's
    normaliser), so that its maximum is at the documented mode.
    """
    total = 0.0
    if prior.psi_x_weight and prior.psi_x_fixed is None:
        ratio = prior.psi_x_mode / state.psi_x
        total += 0.5 * prior.psi_x_weight * float((np.log(ratio) - ratio).sum())
    if not prior.ard:
        return total
    shape, rate = state.alpha_shape, state.alpha_rate
    E_alpha = shape / rate
    E_log_alpha = digamma(shape) - np.log(rate)
    E_zz = state.w_z_mean**2 + state.w_z_var
    loadings = 0.5 * (E_log_alpha - E_alpha * E_zz + 1.0 + np.log(state.w_z_var))
    if prior.coupled:
        E_xx = state.w_x_mean**2 + state.w_x_var
        loadings = loadings + 0.5 * (
            E_log_alpha - E_alpha * E_xx + 1.0 + np.log(state.w_x_var)
        )
    a0, b0 = prior.ard_shape, prior.ard_rate
    precisions = a0 * np.log(b0) - gammaln(a0) + (a0 - 1) * E_log_alpha - b0 * E_alpha
    entropy = shape - np.log(rate) + gammaln(shape) + (1 - shape) * digamma(shape)
    return total + float((loadings + precisions + entropy).sum())


def bound(moments, state, hidden, prior):
    """Return the lower bound on the log evidence (JFA: the log-likelihood)."""
    return data_bound(moments, hidden) + prior_bound(state, prior)
