"""Blocks of time, and the correlation time of a residual."""

import functools
import itertools
from dataclasses import dataclass

import numpy as np

# Maximum lag for 100 rows, about Schwert's rule, which grows with n^(1/4).
_LAGS = 10.0
# Minimum number of rows per coefficient.
_ROWS_PER_LAG = 10


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
    first = np.zeros(residual.size, int)
    first[starts] = starts
    first = np.maximum.accumulate(first)
    last_gap = np.maximum.accumulate(np.where(used, -1, index))
    n_before = np.minimum(index - first, index - last_gap - 1)
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


def interpolation(used, starts):
    """Return the used rows (m,) around each row, and its position between them."""
    low, high, share = np.arange(used.size), np.arange(used.size), np.zeros(used.size)
    for a, b in itertools.pairwise([*starts, used.size]):
        rows = a + np.flatnonzero(used[a:b])
        # Without used rows a part remains as it is.
        if 0 < rows.size < b - a:
            position = np.interp(np.arange(a, b), rows, np.arange(rows.size))
            low[a:b] = rows[np.floor(position).astype(int)]
            high[a:b] = rows[np.ceil(position).astype(int)]
            share[a:b] = position % 1.0
    return low, high, share


# A partial autocorrelation this close to one is that of a random walk.
_ROUNDING = 1e-9
# Length of a block over the correlation time of the residual.
_CORRELATION_TIMES = 10.0
# Range of the number of blocks. Unmodelled torque is correlated for as long as the
# motion; it is not noise, and must not leave only few long blocks. Noise that stays
# correlated for longer than a block is removed before blocks are compared.
_BLOCK_RANGE = (40, 60)
# Minimum number of blocks.
FEWEST = 12
# Folds take every eighth block: folds of adjacent blocks would require extrapolation,
# which depends more on the short recording than on the effect.
_FOLDS = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class Blocks:
    """Blocks of rows, and folds of blocks."""

    label: np.ndarray  # (m,): block of each row
    length: float  # typical length of a block [s]
    sequence: np.ndarray  # (n_blocks,): blocks in an order independent of the parts

    @property
    def n_blocks(self):
        """Number of blocks."""
        return self.sequence.size

    @property
    def n_folds(self):
        """Number of folds."""
        return min(_FOLDS, self.n_blocks)

    @property
    def fold(self):
        """Fold of each row: blocks that are left out together, (m,)."""
        return np.argsort(self.sequence)[self.label] % self.n_folds

    @functools.cached_property
    def order(self):
        """Rows sorted by block, (m,)."""
        return np.argsort(self.label, kind="stable")

    @property
    def starts(self):
        """First row of each block, among the rows sorted by `order`."""
        return np.searchsorted(self.label[self.order], np.arange(self.n_blocks))

    def sums(self, values):
        """Sum rows (m, ...) over each block."""
        return np.add.reduceat(values[self.order], self.starts, axis=0)


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


def phase_blocks(motion, phase, correlation, filter_length):
    """Divide rows into blocks by the phase (m,) [s] of repeated motions (m,)."""
    # Unmodelled torque repeats with the motion: all rows of a phase are in one block.
    names, motion = np.unique(motion, return_inverse=True)
    phases = [phase[motion == k] for k in range(names.size)]
    low, length = np.array([(x.min(), np.ptp(x)) for x in phases]).T
    total = float(length.sum())
    least = max(_CORRELATION_TIMES * correlation, filter_length)
    wanted = min(np.clip(total / least, *_BLOCK_RANGE), total / filter_length)
    count = np.maximum(1, np.round(wanted * length / max(total, filter_length)))
    share = (phase - low[motion]) / np.maximum(length, filter_length)[motion]
    place = np.minimum(np.floor(share * count[motion]), count[motion] - 1)
    label = (np.cumsum(count) - count)[motion] + place
    names, label = np.unique(label, return_inverse=True)
    return Blocks(
        label=label, length=total / names.size, sequence=np.arange(names.size)
    )


def make_blocks(time, starts, correlation, filter_length, order=None):
    """Divide rows at times (m,) [s] into blocks that are nearly independent."""
    # correlation: correlation time of the residual [s]; filter_length in [s]. Blocks
    # are assigned to folds cyclically, by recording in the given `order`.
    edges = np.r_[starts, time.size]
    sizes, lengths = np.diff(edges), time[edges[1:] - 1] - time[edges[:-1]]
    total = float(lengths.sum())
    least = max(_CORRELATION_TIMES * correlation, filter_length)
    if total / FEWEST < filter_length:
        raise ValueError(
            f"Recording too short: {total:.3g} s are left after filtering, and "
            f"{FEWEST} blocks of {filter_length:.3g} s are needed. Record at least "
            f"{FEWEST * filter_length:.3g} s besides the held-out data, or raise the "
            "identifier's cutoff."
        )
    wanted = int(np.clip(total / least, *_BLOCK_RANGE))
    wanted = min(wanted, int(total / filter_length))
    counts = np.clip(np.round(wanted * lengths / total), 1, sizes).astype(int)
    first, part = np.cumsum(counts) - counts, np.repeat(np.arange(sizes.size), sizes)
    row = np.arange(time.size) - edges[part]
    blocks = np.split(np.arange(counts.sum()), first[1:])
    return Blocks(
        label=first[part] + row * counts[part] // sizes[part],
        length=total / counts.sum(),
        sequence=np.concatenate(
            blocks if order is None else [blocks[k] for k in order]
        ),
    )
