"""Blocks of time."""

import functools
from dataclasses import dataclass

import numpy as np

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


def make_blocks(time, starts, correlation, filter_length, order):
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
        sequence=np.concatenate([blocks[k] for k in order]),
    )
