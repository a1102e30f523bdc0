"""What a residual varies with, when no effect of the library explains it."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.explain._evidence import compare
from sklearn_vbjfa.diagnosis.explain._whitening import Whitening

# Bins of a signal, and those of time: coarse enough to be filled, fine enough to bend.
_BINS = 12


@dataclass(frozen=True, kw_only=True)
class Dependence:
    """How much of a joint's residual a signal explains out of sample."""

    signal: str  # such as "v of joint 2" or "time"
    # share of the mean square that a step function of it explains in other blocks
    share: float
    # p-value from the blocks of time, in rows without what the residual remembers of
    # its past once the step function is taken off, see `Whitening`
    p_value: float


def dependences(residual, weight, signals, view, level=0.01):
    """Signals (m,) by name that a residual (m,) depends on, the strongest first."""
    # They are filtered as the residual is; the level is shared out among them
    # (Bonferroni).
    used = weight > 0
    if not used.any():
        return ()
    found = []
    for name, signal in signals.items():
        inner = np.quantile(signal[used], np.linspace(0, 1, _BINS + 1)[1:-1])
        bins = np.searchsorted(inner, signal)
        gain, p_value = _step_function(residual, weight, bins, view)
        if gain > 0 and p_value < level / len(signals):
            found.append(Dependence(signal=name, share=gain, p_value=p_value))
    return tuple(sorted(found, key=lambda d: -d.share))


def _step_function(residual, weight, bins, view):
    """Out-of-sample gain of a step function, and its p-value over blocks."""
    blocks = view.blocks
    total = np.bincount(bins, weight * residual, _BINS)
    count = np.bincount(bins, weight, _BINS)
    fit = np.zeros_like(residual)
    for k in range(blocks.n_folds):
        rows = blocks.fold == k
        part = np.bincount(bins[rows], (weight * residual)[rows], _BINS)
        n = np.bincount(bins[rows], weight[rows], _BINS)
        rest = count - n
        mean = np.where(rest > 0, (total - part) / np.where(rest > 0, rest, 1.0), 0.0)
        fit[rows] = mean[bins[rows]]
    before = blocks.sums(weight * residual**2)
    after = blocks.sums(weight * (residual - fit) ** 2)
    if before.sum() == 0 or after.sum() >= before.sum():
        return 0.0, 1.0
    root = np.sqrt(weight)[:, None]
    whiten = Whitening.of(view, (residual - fit)[None] * root.T, root)
    y = whiten(residual[None] * root.T, [0])[0]
    columns = (bins[:, None] == np.arange(_BINS)) * root
    A = whiten(columns[None], [0])[0]
    left = y.copy()
    for k in range(blocks.n_folds):
        rows = blocks.fold == k
        coef = np.linalg.lstsq(A[~rows], y[~rows], rcond=1e-10)[0]
        left[rows] -= A[rows] @ coef
    white = blocks.sums(y**2), blocks.sums(left**2)
    return (
        float((before - after).sum() / before.sum()),
        compare(before, after, white).p_value,
    )


def motion_signals(motion, names):
    """Signals of all joints by the name under which they are reported."""
    signals = {}
    for j, name in enumerate(names):
        signals[f"position of {name}"] = motion.q[:, j]
        signals[f"speed of {name}"] = motion.v[:, j]
        signals[f"acceleration of {name}"] = motion.a[:, j]
        if motion.load is not None:
            signals[f"load of {name}"] = motion.load[:, j]
    if motion.t is not None:
        signals["time"] = motion.t
    # What does not vary has no bins.
    return signals | {k: x for k, x in motion.signals.items() if np.ptp(x) > 0}
