"""Whether a prediction is better, block by block, and what a residual varies with."""

import itertools
from dataclasses import dataclass

import numpy as np
from scipy import special, stats

from sklearn_vbjfa.diagnosis.search._blocks import Bridge, fit_memory

# What takes less than this off a joint's squared error is not worth telling.
SMALLEST_GAIN = 0.02


def p_value(before, after):
    """One-sided test over blocks that the second errors are the smaller ones."""
    # Wilcoxon's signed ranks keep a few difficult blocks from deciding, but with a
    # dozen blocks they cannot reach the level that a hundred candidates ask for,
    # however clear the case; Student's t of the log ratios can. The smaller p-value
    # counts, twice, as two tests were made.
    if before.size < 3:
        return 1.0
    ranks = stats.wilcoxon(before - after, alternative="greater").pvalue
    # A block that is fitted exactly would decide alone.
    tiny = 1e-6 * before.mean()
    ratio = np.log((before + tiny) / (after + tiny))
    error = ratio.std(ddof=1) / np.sqrt(ratio.size)
    t = ratio.mean() / error if error > 0 else np.copysign(np.inf, ratio.mean())
    mean = special.stdtr(ratio.size - 1, -t)
    return float(min(1.0, 2 * np.fmin(ranks, mean)))


# -- rows without their memory ---------------------------------------------------------


class Whitening:
    """Rows of all joints without what the residuals' past predicts."""

    # residual (nv, m): scaled by the root (m, nv) of the weights, which is zero for a
    # row that is left out; starts: first rows of the recordings; step [s]; cutoff: of
    # the low-pass that the rows have passed [Hz]; memory: of each joint.

    @classmethod
    def of(cls, view, residual, root=None):
        """Take the memory out of residuals of a view, with its weights unless given."""
        root = view.root if root is None else root
        return cls(residual, root, view.starts, view.step, view.robot.cutoff_)

    def __init__(self, residual, root, starts, step, cutoff=np.inf):
        # Rows further apart than half a period of the cut-off are as good as not
        # correlated by the low-pass.
        self._stride = max(1, int(np.ceil(0.5 / (cutoff * step) - 1e-9)))
        self._root, self._starts = root, np.asarray(starts)
        self._used = root > 0
        self._gaps = [Bridge.of(used, self._starts) for used in self._used.T]
        self.memory = []
        for j, own in enumerate(residual):
            used = self._used[:, j]
            values = np.where(used, own / np.where(used, root[:, j], 1.0), 0.0)
            self.memory.append(
                fit_memory(values, used, self._starts, step, self._stride)
            )

    def __call__(self, rows, joints):
        """Whiten rows (nj, m, ...) of joints, scaled by the root of the weights."""
        # Missing rows are bridged by straight lines, in torques and columns alike, so
        # that what explains the one explains the other; before its first row a
        # recording counts as constant.
        out = np.empty_like(rows)
        for i, j in enumerate(joints):
            shape = (-1,) + (1,) * (rows.ndim - 2)
            phi, root = self.memory[j].phi, self._root[:, j]
            x = rows[i] / np.where(root > 0, root, 1.0).reshape(shape)
            if self._gaps[j] is not None:
                x = self._gaps[j](x)
            out[i] = x
            edges = [*self._starts, x.shape[0]]
            for a, b in itertools.pairwise(edges):
                for k, coefficient in enumerate(phi, start=1):
                    past = min(k * self._stride, b - a)
                    out[i, a + past : b] -= coefficient * x[a : b - past]
                    out[i, a : a + past] -= coefficient * x[a]
            out[i] *= root.reshape(shape)
        return out


def memory_seconds(model):
    """How long the residual of each joint of a model stays correlated, list [s]."""
    return [m.time for m in Whitening.of(model.view, model.residual).memory]


# -- signals that a residual varies with -----------------------------------------------

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
    gain = float((before - after).sum() / before.sum())
    # Blocks without the residual's memory are independent: the p-value is theirs.
    first, second = blocks.sums(y**2), blocks.sums(left**2)
    used = first != second
    if (first - second).sum() <= 0:
        return gain, 1.0
    return gain, p_value(first[used], second[used])


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
