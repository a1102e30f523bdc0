"""Zero-phase low-pass with decimation, without transients.

A symmetric windowed-sinc filter of finite length (Kaiser window, 60 dB): the output
is defined where the whole filter lies inside the recording, so that edges are cut and
never made up; and since it looks at a bounded neighbourhood only, a long recording can
be filtered in overlapping chunks with exactly the same result.
"""

from dataclasses import dataclass

import numpy as np
from scipy import signal

_ATTENUATION = 60.0  # dB


@dataclass(frozen=True, kw_only=True)
class Lowpass:
    """A symmetric low-pass followed by decimation.

    Attributes
    ----------
    taps : ndarray of shape (2 * half + 1,)
        Impulse response, of sum 1.
    step : int
        Every `step`-th sample is kept.
    """

    taps: np.ndarray
    step: int

    @property
    def half(self):
        """Samples that are lost at each end."""
        return self.taps.size // 2

    @property
    def efficiency(self):
        """Independent samples per output, for white noise at the input.

        Outputs closer than the filter is long share noise; for the sum of many of
        them, times a slow signal, they count for this share of their number.
        """
        return float(self.step * (self.taps @ self.taps)) if self.half else 1.0

    def centres(self, n):
        """Return the samples at which outputs stand, for a recording of n."""
        return np.arange(self.half, n - self.half, self.step)

    def __call__(self, x):
        """Filter the rows of x (n, ...) and keep every `step`-th."""
        n = x.shape[0]
        count = self.centres(n).size
        if count == 0:
            return np.zeros((0, *x.shape[1:]))
        flat = x.reshape(n, -1)
        if self.half == 0:
            return flat[:: self.step].reshape(count, *x.shape[1:])
        filtered = signal.upfirdn(self.taps, flat, up=1, down=self.step, axis=0)
        # upfirdn starts at the first sample; the first full overlap is 2 * half later
        first = -(-2 * self.half // self.step)
        if 2 * self.half % self.step:
            lead = first * self.step - 2 * self.half
            filtered = signal.upfirdn(
                np.r_[np.zeros(lead), self.taps], flat, up=1, down=self.step, axis=0
            )
        return filtered[first : first + count].reshape(count, *x.shape[1:])

    def average(self, weight):
        """Average weights (n, ...) over the filter's neighbourhood."""
        taps = np.abs(self.taps)
        smoother = Lowpass(taps=taps / taps.sum(), step=self.step)
        return smoother(weight)


def design(dt, cutoff, step=None):
    """Design the filter.

    Parameters
    ----------
    dt : float
        Sample period [s].
    cutoff : float
        Frequency [Hz] of half amplitude; the stop band begins at 1.5 times it.
        Infinity filters nothing.
    step : int or None
        Decimation; None keeps four samples per period of the cut-off.
    """
    if not np.isfinite(cutoff) or cutoff >= 0.5 / dt:
        return Lowpass(taps=np.ones(1), step=step or 1)
    relative = cutoff * dt  # cycles per sample
    length, beta = signal.kaiserord(_ATTENUATION, 2 * relative)
    half = int(np.ceil(length / 2))
    k = np.arange(-half, half + 1)
    taps = 2 * relative * np.sinc(2 * relative * k) * np.kaiser(k.size, beta)
    if step is None:
        step = max(1, int(0.25 / relative))
    return Lowpass(taps=taps / taps.sum(), step=step)
