"""Zero-phase low-pass with decimation, without transients.

A symmetric windowed-sinc filter of finite length (Kaiser window, 60 dB). Its output is
defined where the whole filter lies inside the recording: edges are cut, and chunks that
overlap give the same result. Rows may come in blocks, each of which adds to the outputs
whose window it lies in: regressors a thousand columns wide are never held as a whole.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy

_ATTENUATION = 60.0  # dB
# A filtered row counts when at least this share of the filter's neighbourhood counts.
_MASK_SHARE = 0.5
# Standard deviation of the unknown torque at rest over that of the noise.
_UNKNOWN = 200.0
# Memory of a block's rows, and fewest rows for which a call is worth its overhead.
_BLOCK_BYTES = 4 << 20
_MIN_ROWS = 512
# Fewest rows that are multiplied with taps together, and the products that take as long
# as a call.
_FEWEST, _CALL = 32, 20_000


@dataclass(frozen=True, kw_only=True)
class Lowpass:
    """A symmetric low-pass followed by decimation."""

    taps: np.ndarray  # (2 * half + 1,): impulse response, of sum 1
    step: int  # every `step`-th sample is kept

    @property
    def half(self):
        """Samples that are lost at each end."""
        return self.taps.size // 2

    def centres(self, n, outputs=slice(None)):
        """Return the samples at the centres of (some) outputs, for n samples."""
        chosen = range(self.half, n - self.half, self.step)[outputs]
        return np.arange(chosen.start, chosen.stop, chosen.step)

    def __call__(self, x):
        """Filter the rows of x (n, ...) and keep every `step`-th."""
        if self.half == 0:
            return x[:: self.step]
        n = x.shape[0]
        flat = x.reshape(n, -1)
        result = BlockFilter(self, self.centres(n).size, flat.shape[1])
        if result.outputs.size:
            length = block_length(self, 8 * flat.shape[1])
            for first in range(0, n, length):
                result.add(first, flat[first : first + length])
        return result.outputs.reshape(-1, *x.shape[1:])

    def average(self, weight):
        """Average weights (n, ...) over the filter's neighbourhood."""
        taps = np.abs(self.taps)
        return replace(self, taps=taps / taps.sum())(weight)

    def certainty(self, known):
        """Return weights of filtered rows, of which some torques are unknown."""
        unknown = 1.0 - self.average(known.astype(float))
        return 1.0 / (1.0 + (_UNKNOWN * unknown) ** 2)

    def samples(self, weight):
        """Return the number of independent samples of each row, zero if masked."""
        # Outputs within a filter length of each other share noise.
        each = float(self.step * (self.taps @ self.taps)) if self.half else 1.0
        # The margin keeps a tie from depending on the order of summation.
        counts = self.average((weight > 0).astype(float)) > _MASK_SHARE - 1e-9
        return np.where(counts, each * self.average(weight), 0.0)


def design(dt, cutoff, step=None):
    """Design a filter of half amplitude at `cutoff` [Hz]."""
    # The stop band begins at 1.5 times it. An infinite cutoff filters nothing; step
    # None keeps four samples per period of it.
    if not np.isfinite(cutoff) or cutoff >= 0.5 / dt:
        return Lowpass(taps=np.ones(1), step=step or 1)
    relative = cutoff * dt  # cycles per sample
    length, beta = scipy.signal.kaiserord(_ATTENUATION, 2 * relative)
    half = int(np.ceil(length / 2))
    k = np.arange(-half, half + 1)
    taps = 2 * relative * np.sinc(2 * relative * k) * np.kaiser(k.size, beta)
    step = step or max(1, int(0.25 / relative))
    return Lowpass(taps=taps / taps.sum(), step=step)


# Fewest samples per filtered row for smooth signals; with four rows in a period of the
# cut-off, more samples do not change the band below it.
_PER_ROW = 5


def stride(lowpass):
    """Return the largest decimation of the samples of smooth signals."""
    most = lowpass.step // _PER_ROW
    return max((k for k in range(1, most + 1) if lowpass.step % k == 0), default=1)


def coarser(lowpass, every):
    """Return the same low-pass for every `every`-th sample."""
    if every == 1:
        return lowpass
    taps = lowpass.taps[lowpass.half % every :: every]
    return replace(lowpass, taps=taps / taps.sum(), step=lowpass.step // every)


def coarser_rows(parts, lowpass, every):
    """Thin the rows of parts by an integer factor; return rows and thinned parts."""
    # The outputs of the coarser low-pass lie on the samples of those of the original.
    if every == 1:
        return slice(None), tuple(parts)
    half = lowpass.half // every
    rows, slices, first = [], [], 0
    for part in parts:
        count = lowpass.centres(part.stop - part.start).size
        length = (
            2 * half + (count - 1) * (lowpass.step // every) + 1 if count else 2 * half
        )
        index = np.arange(part.start + lowpass.half % every, part.stop, every)[:length]
        rows.append(index)
        slices.append(slice(first, first + index.size))
        first += index.size
    return np.concatenate(rows), tuple(slices)


@lru_cache(maxsize=64)
def _tap_matrix(taps, step, n_rows):
    """Taps (n_outputs, n_rows) of a block that begins at a multiple of `step`."""
    # Also returns the number of outputs before the block that it adds to. taps: as
    # bytes, which are hashable.
    taps = np.frombuffer(taps)
    length = taps.size
    before = (length - 1) // step
    outputs = np.arange(-before, (n_rows - 1) // step + 1)
    k = np.arange(n_rows) - step * outputs[:, None]
    inside = (k >= 0) & (k < length)
    matrix = np.where(inside, taps[np.where(inside, k, 0)], 0.0)
    matrix.setflags(write=False)
    return before, matrix


def block_length(lowpass, row_bytes):
    """Return the number of rows of a block: a multiple of the decimation."""
    # With a filter, half of its length: few zeros in the matrix of taps, and rows still
    # in the cache when they are filtered; without one, what fits into the cache.
    half = lowpass.half
    rows = max(_MIN_ROWS, half) if half else _BLOCK_BYTES // row_bytes
    return lowpass.step * max(1, -(-rows // lowpass.step))


class BlockFilter:
    """Filter rows of `width` numbers to `count` outputs, the first from row 0 on."""

    def __init__(self, lowpass, count, width):
        self._lowpass = lowpass
        self._taps = np.asarray(lowpass.taps, dtype=float).tobytes()
        self.outputs = np.zeros((count, width))

    def add(self, first, rows):
        """Add a block of rows that begins at row `first`, a multiple of the step."""
        if self._lowpass.half == 0:
            kept = rows[:: self._lowpass.step]
            at = first // self._lowpass.step
            self.outputs[at : at + kept.shape[0]] = kept
            return
        # Short parts have few zeros in the matrix of taps, but narrow rows need longer
        # parts to be worth a call.
        step, some = self._lowpass.step, max(_FEWEST, self._lowpass.half // 4)
        some = step * -(-some // step)
        while some < rows.shape[0] and some**2 * rows.shape[1] < _CALL * step:
            some *= 2
        for at in range(0, rows.shape[0], some):
            part = rows[at : at + some]
            before, matrix = _tap_matrix(self._taps, step, part.shape[0])
            low = (first + at) // step - before
            high = min(low + matrix.shape[0], self.outputs.shape[0])
            if high <= max(low, 0):
                # Rows after the window of the last output.
                return
            matrix = matrix[max(-low, 0) : high - low]
            self.outputs[max(low, 0) : high] += matrix @ part
