"""Correlation times of residuals."""

import numpy as np

# Maximum lag for 100 rows, about Schwert's rule, which grows with n^(1/4).
_LAGS = 10.0
# Minimum number of rows per coefficient.
_ROWS_PER_LAG = 10
# A partial autocorrelation this close to one is that of a random walk.
_ROUNDING = 1e-9


def memory_time(residual, used, starts, step, stride=1):
    """Estimate the integrated correlation time [s] of residuals (m,) in used rows."""
    # By an autoregression of every `stride`-th row, as the low-pass correlates rows in
    # between; infinite for a random walk. AIC selects the order. Least squares in the
    # form r_t = rho r_(t-1) + sum psi_k (r_(t-k) - r_(t-k-1)) + e, where rho is the
    # persistence; its bias in short recordings, -(1 + 3 rho) / n (Kendall, Biometrika
    # 41, 1954; for several lags Andrews and Chen, J. Bus. Econ. Stat. 12(2), 1994)
    # times 1 - sum psi_k, is corrected.
    n = used.sum() / stride
    n_lags = int(min(_LAGS * (n / 100.0) ** 0.25, n / _ROWS_PER_LAG))
    index = np.arange(residual.size)
    first = np.where(used, 0, index + 1)
    first[starts] = np.maximum(first[starts], starts)
    n_before = index - np.maximum.accumulate(first)
    while n_lags >= 1:
        rows = np.flatnonzero(used & (n_before >= n_lags * stride))
        n = rows.size / stride
        if n >= _ROWS_PER_LAG * n_lags:
            break
        # Use fewer lags for short recordings or many gaps.
        n_lags //= 2
    else:
        return stride * step
    y = residual[rows]
    lags = np.column_stack([residual[rows - k * stride] for k in range(1, n_lags + 1)])
    # One QR for all orders: the models with rho and psi_1, psi_2, ... are nested.
    A = np.column_stack([lags[:, 0], lags[:, :-1] - lags[:, 1:]])
    Q, R = np.linalg.qr(A)
    explained = np.r_[0.0, np.cumsum((Q.T @ y) ** 2)]
    rss = np.maximum(y @ y - explained, np.finfo(float).tiny)
    order = int(np.argmin(n * np.log(rss) + 2.0 * np.arange(n_lags + 1)))
    if order == 0:
        return stride * step
    beta = np.linalg.solve(R[:order, :order], (Q.T @ y)[:order])
    rho, psi = beta[0], beta[1:]
    factor = 1.0 - psi.sum()
    if rho > 0 and factor > 0:
        rho = min(rho + factor * (1.0 + 3.0 * min(rho, 1.0)) / n, 1.0)
    phi = np.r_[psi, 0.0] - np.r_[0.0, psi]
    phi[0] += rho
    return stride * step * _integrated(phi)


def _integrated(phi):
    """Sum the autocorrelations of an autoregression over all lags."""
    gain, variance = 1.0 - phi.sum(), 1.0
    if gain <= 0:
        return np.inf
    # The Durbin-Levinson recursion backwards: the process is stationary if all partial
    # autocorrelations are below one.
    while phi.size:
        partial = phi[-1]
        if abs(partial) >= 1.0 - _ROUNDING:
            return np.inf
        phi = (phi[:-1] + partial * phi[-2::-1]) / (1.0 - partial**2)
        variance /= 1.0 - partial**2
    # Spectral density at zero frequency over the variance.
    return float(1.0 / (gain**2 * variance))


def correlation_time(residual, weight, step, starts, stride=1):
    """Compute the longest integrated correlation time of residuals (m, nv) [s]."""
    # See `memory_time`: sums of sample autocorrelations are biased low for slow
    # residuals, as the sample mean is subtracted.
    times = []
    for r, used in zip(residual.T, weight.T > 0):
        r = np.where(used, r, 0.0)
        if r.any():
            times.append(memory_time(r, used, np.asarray(starts), step, stride))
    return float(max(times, default=0.0))
