"""Blocks of time, and what a residual remembers from one to the next."""

import itertools
from dataclasses import dataclass, field

import numpy as np
from scipy import linalg

# Most lags; about as many as Schwert's rule gives, which grows with n^(1/4).
_LAGS = 10.0
# Rows that a coefficient is to be estimated from, at the least.
_ROWS_PER_LAG = 10


def memory_time(residual, used, starts, step, stride=1):
    """Integrated correlation time [s] of residuals (m,) in rows that count."""
    # That of an autoregression; infinite for a random walk. Rows in between are alike
    # because of the low-pass. The order is Akaike's. Least squares in the form r_t =
    # rho r_(t-1) + sum psi_k (r_(t-k) - r_(t-k-1)) + e, where rho says how slowly the
    # residual forgets; in short recordings it is too small by (1 + 3 rho) / n (Kendall,
    # Biometrika 41, 1954; for several lags Andrews and Chen, J. Bus. Econ. Stat. 12(2),
    # 1994), times what the psi leave of a slow change; that much is added.
    n = used.sum() / stride
    most = int(min(_LAGS * (n / 100.0) ** 0.25, n / _ROWS_PER_LAG))
    place = np.arange(residual.size)
    first = np.zeros(residual.size, int)
    first[starts] = starts
    first = np.maximum.accumulate(first)
    missing = np.maximum.accumulate(np.where(used, -1, place))
    since = np.minimum(place - first, place - missing - 1)
    while most >= 1:
        rows = np.flatnonzero(used & (since >= most * stride))
        n = rows.size / stride
        if n >= _ROWS_PER_LAG * most:
            break
        # Short recordings, or many gaps.
        most //= 2
    else:
        return stride * step
    y = residual[rows]
    lags = np.column_stack([residual[rows - k * stride] for k in range(1, most + 1)])
    # rho first, then one psi after the other: nested models, one QR for all.
    A = np.column_stack([lags[:, 0], lags[:, :-1] - lags[:, 1:]])
    Q, R = np.linalg.qr(A)
    explained = np.r_[0.0, np.cumsum((Q.T @ y) ** 2)]
    left = np.maximum(y @ y - explained, np.finfo(float).tiny)
    order = int(np.argmin(n * np.log(left) + 2.0 * np.arange(most + 1)))
    if order == 0:
        return stride * step
    beta = np.linalg.solve(R[:order, :order], (Q.T @ y)[:order])
    rho, psi = beta[0], beta[1:]
    rest = 1.0 - psi.sum()
    if rho > 0 and rest > 0:
        rho = min(rho + rest * (1.0 + 3.0 * min(rho, 1.0)) / n, 1.0)
    phi = np.r_[psi, 0.0] - np.r_[0.0, psi]
    phi[0] += rho
    return stride * step * _integrated(phi)


def _integrated(phi):
    """Sum of the autocorrelations over all lags, of an autoregression."""
    rest = 1.0 - phi.sum()
    if rest <= 0:
        return np.inf
    # Spectral density at zero over the variance, from the impulse response.
    p, companion = phi.size, linalg.companion(np.r_[1.0, -phi])
    if np.abs(np.linalg.eigvals(companion)).max() >= 1.0 - _ROUNDING:
        return np.inf
    noise = np.zeros((p, p))
    noise[0, 0] = 1.0
    flat = np.linalg.solve(np.eye(p * p) - np.kron(companion, companion), noise.ravel())
    # On the edge to a random walk the solution is rounding, of either sign.
    return float(1.0 / (rest**2 * flat[0])) if flat[0] > 0 else np.inf


@dataclass(frozen=True, kw_only=True, eq=False)
class Bridge:
    """Straight lines over rows that are missing."""

    # (m,): rows before and after each
    low: np.ndarray
    high: np.ndarray
    share: np.ndarray  # (m,): its place between them

    @classmethod
    def of(cls, used, starts):
        """Bridge rows (m,) that are not used, in each part; None if none is missing."""
        if used.all() or not used.any():
            return None
        m = used.size
        low, high, share = np.empty(m, int), np.empty(m, int), np.empty(m)
        for a, b in itertools.pairwise([*starts, m]):
            # A part without any stays as it is at its first row.
            there = a + np.flatnonzero(used[a:b]) if used[a:b].any() else np.array([a])
            at = np.interp(np.arange(a, b), there, np.arange(there.size))
            low[a:b] = there[np.floor(at).astype(int)]
            high[a:b] = there[np.ceil(at).astype(int)]
            share[a:b] = at % 1.0
        return cls(low=low, high=high, share=share)

    def __call__(self, x):
        """Bridge rows (m, ...)."""
        share = self.share.reshape((-1,) + (1,) * (x.ndim - 1))
        return (1.0 - share) * x[self.low] + share * x[self.high]


# An autoregression as near as this to one that forgets nothing is one.
_ROUNDING = 1e-9
# A block is this many times longer than the residual stays correlated.
_CORRELATION_TIMES = 10.0
# Blocks wanted. What a poor first model lacks is correlated for as long as the motion
# is; it is not noise, and must not make the blocks so long that few are left. Noise
# that stays correlated for longer than a block is taken out before blocks are compared.
_BLOCK_RANGE = (40, 60)
# The fewest with which anything can be said: the smallest p-value is 2^-12.
FEWEST = 12
# Folds take every eighth block: to a fold of neighbours one would have to extrapolate,
# which says more of the short recording than of the effect.
_FOLDS = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class Blocks:
    """Blocks and folds of rows."""

    label: np.ndarray  # (m,): block of each row
    fold: np.ndarray  # (m,): fold of each row: blocks that are left out together
    length: float  # typical one of a block [s]
    # (m,): rows block by block
    order: slice | np.ndarray = field(default_factory=lambda: slice(None))

    @property
    def n_blocks(self):
        """Number of blocks."""
        return int(self.label.max()) + 1

    @property
    def n_folds(self):
        """Number of folds."""
        return int(self.fold.max()) + 1

    @property
    def starts(self):
        """First row of each block, of rows in their `order`."""
        return np.r_[0, np.flatnonzero(np.diff(self.label[self.order])) + 1]

    def sums(self, values):
        """Sum rows (m, ...) over each block."""
        return np.add.reduceat(values[self.order], self.starts, axis=0)


def correlation_time(residual, weight, step, starts):
    """Longest integrated autocorrelation time of residuals (m, nv) [s]."""
    # See `memory_time`: sums of sample autocorrelations read slow residuals too short,
    # as their own mean is taken out of them.
    times = []
    for r, used in zip(residual.T, weight.T > 0):
        r = np.where(used, r, 0.0)
        if r.any():
            times.append(memory_time(r, used, np.asarray(starts), step))
    return float(max(times, default=0.0))


def phase_blocks(motion, phase, correlation, filter_length):
    """Divide rows into blocks of the phase (m,) [s] of the motion (m,) that repeats."""
    # What is not modelled repeats with the motion: rows of one phase are in one block,
    # whenever they come.
    names, motion = np.unique(motion, return_inverse=True)
    low = np.array([phase[motion == k].min() for k in range(names.size)])
    length = np.array([np.ptp(phase[motion == k]) for k in range(names.size)])
    total = float(length.sum())
    least = max(_CORRELATION_TIMES * correlation, filter_length)
    wanted = min(np.clip(total / least, *_BLOCK_RANGE), total / filter_length)
    count = np.maximum(1, np.round(wanted * length / max(total, filter_length)))
    share = (phase - low[motion]) / np.maximum(length, filter_length)[motion]
    place = np.minimum(np.floor(share * count[motion]), count[motion] - 1)
    label = (np.cumsum(count) - count)[motion] + place
    label = np.unique(label, return_inverse=True)[1]
    n_blocks = int(label.max()) + 1
    return Blocks(
        label=label,
        fold=label % min(_FOLDS, n_blocks),
        length=total / n_blocks,
        order=np.argsort(label, kind="stable"),
    )


def make_blocks(time, starts, correlation, filter_length, order=None):
    """Divide rows at times (m,) [s] into blocks as long as independence asks for."""
    # The residual's correlation time and the filter's length are in seconds. Blocks go
    # to the folds in turns, recording after recording in the given order of these.
    edges = np.r_[starts, time.size]
    lengths = [float(np.ptp(time[a:b])) for a, b in itertools.pairwise(edges)]
    total = sum(lengths)
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
    label = np.empty(time.size, dtype=int)
    counts = []
    for a, b, length in zip(edges[:-1], edges[1:], lengths):
        count = max(1, round(wanted * length / total)) if total else 1
        count = min(count, b - a)
        label[a:b] = sum(counts) + (np.arange(b - a) * count) // (b - a)
        counts.append(count)
    counts = np.array(counts)
    order = np.arange(counts.size) if order is None else np.asarray(order)
    before = np.empty_like(counts)
    before[order] = np.r_[0, np.cumsum(counts[order])[:-1]]
    # Place of each block in its recording, and of that among the others.
    place = np.concatenate([np.arange(n) + b for n, b in zip(counts, before)])
    n_blocks = int(counts.sum())
    return Blocks(
        label=label,
        fold=place[label] % min(_FOLDS, n_blocks),
        length=total / max(n_blocks, 1),
    )
