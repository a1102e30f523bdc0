"""Penalised splines: smoothed positions and derivatives with zero phase lag.

A quintic spline with uniform knots is fitted to uniformly spaced samples under a
penalty on its fifth derivative (the difference form of Eilers and Marx, 1996). Inside
the recording the fit acts as a symmetric filter with the gain

    G(f) = 1 / (1 + lambda (2 sin(pi f h))^10 / B(f)^2),

about 1 / (1 + (f / cutoff)^10), h being the knot distance; at the ends it
extrapolates the motion by its own polynomial: nothing is padded and nothing cut.
"""

import itertools
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy import linalg
from scipy.interpolate import BSpline, PPoly, make_interp_spline

_DEGREE = 5
# Of the penalised derivative. The steeper the gain, the less the motion is attenuated
# for the same noise: accelerations of a 4 Hz motion are two to three times better than
# with the customary third derivative.
_ORDER = 5
# Knots per period of the cut-off: with ten, the knots themselves attenuate a sine at
# the cut-off by less than 1e-4, and the banded system stays well conditioned at any
# sampling rate.
_KNOTS_PER_PERIOD = 10
# Coloured noise beyond the motion: frequency ratio of the gap between them, share of
# the velocity power below and largest share within it, and least flatness of the noise
# (geometric over arithmetic mean; 0.56 for the periodogram of white noise).
_GAP, _BELOW, _IN_GAP, _FLAT = 10.0, 0.8, 0.005, 0.05
_WIDTH = _DEGREE + 1
# Steps of iterative refinement; each reduces the error by eps times the condition
# number, 1e-4 at worst.
_CORRECTIONS = 2
# Velocities below this share of the largest are set to zero: the spline's memory of an
# earlier motion decays through all sizes down to rounding, whose sign is arbitrary.
_STANDS_STILL = 2.0**-30


def knot_step(dt, cutoff):
    """Return the samples per knot for a cut-off frequency [Hz]."""
    return max(1, int(1.0 / (dt * cutoff * _KNOTS_PER_PERIOD)))


def gain(frequency, dt, cutoff):
    """Gain of the smoother in mid-recording, one half at `cutoff` [Hz]."""
    h = knot_step(dt, cutoff) * dt
    below = frequency < 0.5 / h
    loss = np.empty(np.shape(frequency))
    loss[below] = _penalty(dt, cutoff) * _difference_gain(frequency[below], h)
    # Above the knots' own Nyquist frequency the least-squares fit averages the samples
    # between knots; the continuous form bounds the remainder.
    loss[~below] = ((frequency[~below] / cutoff) ** 2) ** _ORDER
    return 1.0 / (1.0 + loss)


def rounding(cutoff):
    """Mean of abs(t) under the impulse response of the smoother [s]."""
    # (2 / pi) times the integral of (1 - G) / omega^2 over all positive omega
    share = np.pi / (2 * _ORDER)
    return share / np.sin(share) / (np.pi**2 * cutoff)


def _difference_gain(frequency, h):
    # differences of spline coefficients relative to the amplitude of the spline
    square = np.sin(np.pi * frequency * h) ** 2
    cosine = 1 - 2 * square  # of the whole angle
    b_spline = (16 + 13 * cosine + cosine**2) / 30.0
    return (4 * square) ** _ORDER / b_spline**2


def _penalty(dt, cutoff):
    h = knot_step(dt, cutoff) * dt
    return 1.0 / _difference_gain(cutoff, h)


def knots_and_penalty(dt, cutoff):
    """Return the samples per knot and the factor of the penalty."""
    if not np.isfinite(cutoff):
        # Interpolation does not determine the coefficients beyond the ends. The penalty
        # that determines them must exceed rounding (with 1e-13 a straight line gets
        # accelerations at its ends); it changes white noise by about 1e-6.
        return 1, 1e-9
    step = knot_step(dt, cutoff)
    return step, step * _penalty(dt, cutoff)


# Shortest recording that has a spectrum.
MIN_SPECTRUM = 16


# Length of the spectral windows, at least, in samples and seconds, and their largest
# number, evenly spread: a few minutes of motion suffice for its spectrum.
_WINDOW_SAMPLES, _WINDOW_SECONDS, _MOST_WINDOWS = 1 << 16, 60.0, 4


def _window(dt):
    """Return the largest number of samples in one spectral window."""
    return max(_WINDOW_SAMPLES, round(_WINDOW_SECONDS / dt)) + 2


def fft_length(longest, dt):
    """Length of the transforms of second differences, for the longest recording."""
    return 1 << int(np.ceil(np.log2(min(longest, _window(dt)) - 2)))


def acceleration_power(x, dt, n_fft):
    """Power of the second differences of one recording, to be summed over several."""
    # x (n, k). Returns squared amplitudes (n_fft // 2 + 1, k), zero for a recording
    # that is too short, `_staircase` and `_quiet_noise` (2, k), and the energy of the
    # taper, by which to divide both.
    n, window = x.shape[0], _window(dt)
    if n < MIN_SPECTRUM:
        return np.zeros((n_fft // 2 + 1, x.shape[1])), 0.0, 0.0
    if n > window:
        count = min(-(-n // window), _MOST_WINDOWS)
        starts = np.linspace(0, n - window, count).astype(int)
        parts = (acceleration_power(x[i : i + window], dt, n_fft) for i in starts)
        return tuple(map(sum, zip(*parts)))
    # Second differences reduce the enormous dynamic range between slow motion and
    # noise, which would leak through any taper.
    d = np.ascontiguousarray(np.diff(x, 2, axis=0).T) / dt**2
    d -= d.mean(axis=1, keepdims=True)
    taper = np.hanning(d.shape[1] + 2)[1:-1]
    power = np.abs(np.fft.rfft(d * taper, n_fft)) ** 2
    weight = np.pad(taper**2, 1)
    staircases = [_staircase(column, weight) for column in x.T]
    energy = float(weight.sum())
    return power.T, np.array([staircases, energy * _quiet_noise(x)]), energy


def _staircase(x, weight):
    """Weighted square error of samples (n,) that hold a value and then jump."""
    # Coarse encoders and held samples: about a straight line, the error of each run of
    # equal samples is uniformly distributed. A standstill ends in a small jump.
    change = np.flatnonzero(np.diff(x))
    run, inverse = np.diff(change), 1 / np.abs(x[change + 1] - x[change])
    square = (2 / (inverse[1:] + inverse[:-1])) ** 2 / 12
    return square * (1 - 1 / run**2) @ np.diff(np.cumsum(weight)[change])


# Rows of a block, the share of the blocks that are quiet, and that quantile of the
# blocks' variances for white noise of variance 1.
_QUIET_ROWS, _QUIET_SHARE, _QUIET_OF_WHITE = 32, 0.1, 0.567


def _quiet_noise(x):
    """Variance (k,) of the noise of samples (n, k) in the quietest blocks that vary."""
    # By third differences. The vibration of a moving joint is not its noise at rest.
    d = np.diff(x, 3, axis=0) ** 2 / 20
    rows = min(_QUIET_ROWS, len(d))
    blocks = d[: len(d) // rows * rows].reshape(-1, rows, x.shape[1]).mean(axis=1)
    still = np.sum(blocks == 0, axis=0)
    pick = still + (_QUIET_SHARE * (len(blocks) - still)).astype(int)
    quiet = np.sort(blocks, axis=0)[
        np.minimum(pick, len(blocks) - 1), np.arange(len(pick))
    ]
    return quiet / _QUIET_OF_WHITE


def acceleration_spectra(segments, dt):
    """Frequencies (m,) [Hz] and power (m, k) of all segments' second differences."""
    # The third result (m,) is the power that white noise of variance 1 would have
    # there, the fourth (2, k) the errors of staircases and of quiet blocks.
    longest = max((x.shape[0] for x in segments), default=0)
    if longest < MIN_SPECTRUM:
        raise ValueError(
            "Choosing the cut-off from the data needs a recording of at least "
            f"{MIN_SPECTRUM} samples, got {longest}: check groups, or give a cutoff."
        )
    n_fft = fft_length(longest, dt)
    parts = [acceleration_power(np.asarray(x), dt, n_fft) for x in segments]
    return spectrum(*map(sum, zip(*parts)), n_fft, dt)


def spectrum(power, errors, energy, n_fft, dt):
    """Results of `acceleration_spectra` from sums of `acceleration_power`."""
    frequency = np.fft.rfftfreq(n_fft, dt)
    noise_gain = (2 * np.sin(np.pi * frequency * dt)) ** 4 / dt**4
    return frequency[1:], power[1:] / energy, noise_gain[1:], errors / energy


# Neighbouring ordinates averaged before the median, and the equivalent number of
# independent ones under the taper.
_BLOCK, _INDEPENDENT = 16, 8


def white_noise_variance(frequency, power, noise_gain):
    """Variance of white noise in the samples, from the upper half of the spectrum."""
    # The median over blocks of ordinates resists lines (vibrations) there. A block's
    # mean has a Gamma distribution, whose median is (1 - 1 / (9 shape))^3 of its mean
    # (Wilson and Hilferty). Unlike for single ordinates, it then matters little over
    # how many segments they were averaged.
    ratio = (power / noise_gain)[frequency >= 0.5 * frequency[-1]]
    n_blocks = max(1, ratio.size // _BLOCK)
    means = [part.mean() for part in np.array_split(ratio, n_blocks)]
    if n_blocks < 3:  # the median is close to the mean
        return float(np.mean(means))
    return float(np.median(means) / (1 - 1 / (9 * _INDEPENDENT)) ** 3)


# A periodogram ordinate counts as signal above this multiple of the noise. Ordinates of
# noise are exponential: 0.3 % of its power lies above, and 1 % if the noise level is
# underestimated by a fifth, as in recordings of a few seconds.
_STANDS_OUT = 8.0


def choose_cutoff(frequency, power, noise_gain, errors, dt):
    """Cut-off [Hz] that minimises the estimated error of the second derivative."""
    # With gain G the expected squared error at a frequency is (1 - G)^2 times the
    # signal power plus G^2 times the noise power; the signal power is the measured one
    # minus the noise (Mallows' C_p). errors: those of `acceleration_spectra`. Also
    # returns the noise variance.
    levels = [white_noise_variance(frequency, x, noise_gain) for x in power.T]
    variance = np.array(levels)
    noise = variance * noise_gain[:, None]
    # Acceleration noise grows with the fourth power of frequency: a tenth of it counted
    # as signal would exceed the motion.
    signal = np.where(power > _STANDS_OUT * noise, power - noise, 0.0)
    # The error of a staircase has lines, which are no motion: those of the highest
    # frequencies, up to its variance (accurate to 0.1 %) less the white part.
    share = signal / noise_gain[:, None]
    share[-1] /= 2  # of the Nyquist frequency, the only one without a negative one
    beyond = np.cumsum(share[::-1], axis=0)[::-1]
    signal[beyond < (1.01 * errors[0] - variance) * frequency.size] = 0.0
    candidates = np.geomspace(max(frequency[0], 1e-3 / dt), 1.0 / (3 * dt), 120)
    risks = np.empty((candidates.size, power.shape[1]))
    for i, cutoff in enumerate(candidates):
        G = gain(frequency, dt, cutoff)
        risks[i] = (1 - G) ** 2 @ signal + (G**2 @ noise_gain) * variance
    return candidates[np.argmin(risks, axis=0)], variance


def _noise_beyond(frequency, excess, power):
    """Index above which the excess power is coloured noise, beyond a wide gap."""
    # Interpolation and sampling jitter cause coloured noise above the white level, a
    # decade above all motion. Lines (vibration) are not flat and do not count as noise.
    total = np.cumsum(excess)
    n = frequency.size
    end = np.searchsorted(frequency, _GAP * frequency)
    end = np.minimum(end, n - 1)
    below, through = total, total[end] - total
    gap = (below > _BELOW * total[-1]) & (through < _IN_GAP * total[-1]) & (end < n - 1)
    if not gap.any():
        return n
    first = end[np.argmax(gap)]
    beyond = power[first:] / frequency[first:] ** 2
    beyond = beyond[beyond > 0]
    if beyond.size == 0:
        return n
    flatness = np.exp(np.log(beyond).mean()) / beyond.mean()
    return first if flatness > _FLAT else n


def velocity_bandwidth(frequency, power, noise_gain, variance, cutoff, share=0.99):
    """Frequency [Hz] below which `share` of the velocity power lies."""
    # Only ordinates above five times the expected noise power count, and only up to
    # twice the `cutoff` of least error: above it, some of the many noise ordinates
    # exceed that level too.
    noise = variance * noise_gain
    signal = (power > 5 * noise) & (frequency <= 2 * cutoff)
    excess = np.where(signal, power - noise, 0.0) / frequency**2
    excess[_noise_beyond(frequency, excess, power) :] = 0.0
    cumulative = np.cumsum(excess)
    if not cumulative[-1] > 0:
        return float(min(cutoff, frequency[-1]))
    return float(frequency[np.argmax(cumulative >= share * cumulative[-1])])


def _pieces():
    """Polynomials of the basis in an interval, highest power first, (6, 6)."""
    basis = PPoly.from_spline(BSpline.basis_element(np.arange(_WIDTH + 1.0)))
    # without the pieces outside the support
    first = np.searchsorted(basis.x, 0.0, side="right") - 1
    c = basis.c[:, first : first + _WIDTH]
    # The j-th function over an interval is in the piece 5 - j of its own support.
    return np.ascontiguousarray(c[:, ::-1])


_POLYNOMIALS = _pieces()


@lru_cache(maxsize=256)
def _basis(step, first, last, order):
    """Values (order 0) or derivatives of the six functions at x = k / step."""
    # For k from `first` to `last`; outside [0, 1] the polynomials continue.
    x = np.arange(first, last + 1) / step
    derivatives = [np.polyder(c, order) for c in _POLYNOMIALS.T]
    table = np.column_stack([np.polyval(c, x) for c in derivatives])
    table.setflags(write=False)
    return table


def _windows(coef):
    """Coefficients of the functions of each interval, (n, 6)."""
    # NumPy's own function checks for longer than a short piece takes.
    shape, strides = (coef.size - _DEGREE, _WIDTH), 2 * coef.strides
    return np.ndarray(shape, coef.dtype, coef, strides=strides).copy()


@dataclass(frozen=True, kw_only=True)
class Spline:
    """Smoothed samples of one signal, as spline coefficients."""

    # (n_intervals + 5,): coefficients, about `offset`
    coef: np.ndarray
    offset: float
    per_knot: int  # rows of the recording between knots
    shift: int  # row of the first knot
    h: float  # distance of the knots [s]

    def __call__(self, start, stop, order=0, out=None):
        """Evaluate rows start ... stop - 1 of the recording, or a derivative there."""
        # Velocities below a billionth of the fastest are exactly zero.
        out = np.empty(stop - start) if out is None else out
        per = self.per_knot
        n_intervals = self.coef.size - _DEGREE
        low, high = start - self.shift, stop - 1 - self.shift
        first = min(max(low // per, 0), n_intervals - 1)
        last = min(max(high // per, 0), n_intervals - 1)
        windows = _windows(self.coef[first : last + _WIDTH])
        values = (windows @ self._table(0, per - 1, order).T).ravel()
        begin, end = first * per, (last + 1) * per
        inside = slice(max(begin - low, 0), max(min(end, high + 1) - low, 0))
        out[inside] = values[max(low - begin, 0) : max(high + 1 - begin, 0)]
        if low < begin:
            # Rows outside the knots: the polynomials at the ends continue.
            before = self._table(low - begin, min(high - begin, -1), order)
            out[: len(before)] = before @ windows[0]
        if high >= end:
            after = self._table(per + max(low - end, 0), per + high - end, order)
            out[out.size - len(after) :] = after @ windows[-1]
        if order == 0:
            out += self.offset
        if order == 1:
            out[np.abs(out) <= self._stands_still] = 0.0
        return out

    def _table(self, first, last, order):
        """Values or derivatives of the six functions, in units of the samples."""
        return _basis(self.per_knot, first, last, order) / self.h**order

    @cached_property
    def _stands_still(self):
        """Largest velocity that counts as zero."""
        # A velocity is a mean of neighbouring differences of the coefficients.
        return _STANDS_STILL * np.abs(np.diff(self.coef)).max() / self.h


def fit(x, dt, cutoff, *, every=1, shift=0):
    """Smooth samples (n,) as a penalised spline, rows shift, shift + every, ..."""
    # dt [s] is the period of the samples; cutoff [Hz] has a gain of one half, infinity
    # interpolates.
    step, lam = knots_and_penalty(dt, cutoff)
    n = x.shape[0]
    n_intervals = max(1, -(-(n - 1) // step))
    n_coef = n_intervals + _DEGREE
    offset = x.mean()
    whole, rest = divmod(n, step)
    basis, stencil = _basis(step, 0, step - 1, 0), np.poly(np.ones(_ORDER))
    bands, penalty = np.zeros((2, _WIDTH, n_coef))
    # Sum the small terms first: the penalty is many times larger.
    _overlay(bands, basis.T @ basis, 0, whole)
    _overlay(bands, basis[:rest].T @ basis[:rest], whole, 1)
    _overlay(penalty, np.outer(stencil, stencil), 0, n_coef - _ORDER)
    bands += lam * penalty
    factor = linalg.cholesky_banded(bands, overwrite_ab=True, check_finite=False)
    coef = np.zeros(n_coef)
    for _ in range(1 + _CORRECTIONS):
        left = _slope(x - offset, coef, step, lam)
        coef += linalg.cho_solve_banded((factor, False), left, check_finite=False)
    return Spline(
        coef=coef, offset=offset, per_knot=every * step, shift=shift, h=step * dt
    )


def _slope(x, coef, step, lam):
    """Minus half the gradient of |x - B c|^2 + lam |D c|^2 at c, shape of c."""
    # The penalty is up to 1e12 times the other term, so that the sum of both matrices
    # has lost the digits that matter for slow motions. Evaluated separately both are
    # accurate: differences of neighbours are exact for a slow motion.
    n, n_intervals = x.size, coef.size - _DEGREE
    basis = _basis(step, 0, step - 1, 0)
    # One more interval, since the first sample of it may be on the last knot, where the
    # last of its functions is zero.
    left = -(_windows(np.append(coef, 0.0)) @ basis.T).ravel()
    left[:n] += x
    left[n:] = 0.0
    products = left.reshape(-1, step) @ basis
    slope = np.zeros(coef.size + 1)
    for j in range(_WIDTH):
        slope[j : j + n_intervals + 1] += products[:, j]
    rough = np.diff(coef, _ORDER)
    # The transpose of differences are differences of the zero-padded values.
    pull = np.diff(np.pad(rough, _ORDER), _ORDER)
    sign = (-1) ** _ORDER
    return slope[:-1] - lam * sign * pull


def _overlay(bands, block, first, count):
    """Add a block (6, 6) at each of some intervals to the upper bands of a matrix."""
    # The functions of an incomplete last interval are zero beyond the last knot.
    for i, j in itertools.combinations_with_replacement(range(_WIDTH), 2):
        bands[_DEGREE - (j - i), first + j : first + j + count] += block[i, j]


def contiguous_groups(groups, n_samples):
    """Return slices of the recordings, one per run of equal labels (n_samples,)."""
    # None as labels is one recording.
    if groups is None:
        return [slice(0, n_samples)]
    labels = np.asarray(groups)
    if labels.shape != (n_samples,):
        raise ValueError(
            f"groups must hold one label per row, shape ({n_samples},); got shape "
            f"{labels.shape}."
        )
    if labels.dtype.kind == "f" and np.isnan(labels).any():
        raise ValueError("groups must label every row; got nan.")
    borders = np.flatnonzero(labels[1:] != labels[:-1]) + 1
    ends = [0, *map(int, borders), n_samples]
    return [slice(a, b) for a, b in itertools.pairwise(ends)]


def interpolate(values, parts, t, delay=0.0, order=0):
    """Channels (n, ...) a delay [s] earlier, or their derivative by time there."""
    # parts: recordings, across whose borders nothing is interpolated; t (n,) [s].
    # Splines: straight lines would take 1 % of what moves at a twentieth of the
    # sampling frequency. Before a recording its first value is held.
    out = np.empty(values.shape)
    for part in parts:
        rows, clock = values[part], t[part]
        if clock.size == 1:
            out[part] = rows if order == 0 else 0.0
            continue
        # Relative to the start of the recording, large time stamps lose no digits.
        clock = clock - clock[0]
        spline = make_interp_spline(clock, rows, k=min(3, clock.size - 1))
        delayed = clock - delay
        out[part] = spline(np.clip(delayed, 0.0, clock[-1]), nu=order)
        if order:
            out[part][(delayed < 0.0) | (delayed > clock[-1])] = 0.0
    return out


def zero_order_hold(values, parts, t, delay):
    """Channels (n, ...) with zero-order hold that act with a delay [s]."""
    # Sampled steps would alias frequencies above the band of the rows into it. Within
    # the band, a hold is the average of a spline over the last period.
    out = np.empty(values.shape)
    for part in parts:
        rows, clock = values[part], t[part] - t[part][0]
        if clock.size == 1:
            out[part] = rows
            continue
        period = clock[-1] / (clock.size - 1)
        spline = make_interp_spline(clock, rows, k=min(3, clock.size - 1))
        until = clock - delay
        ends = [_integral(spline, rows, x) for x in (until, until - period)]
        out[part] = (ends[0] - ends[1]) / period
    return out


def _integral(spline, rows, t):
    """Integral of a spline from its first time, constant beyond both ends."""
    inside = np.clip(t, *spline.t[[0, -1]])
    outside = (t - inside).reshape(-1, *(rows.ndim - 1) * (1,))
    ends = np.minimum(outside, 0.0) * rows[0] + np.maximum(outside, 0.0) * rows[-1]
    return spline.antiderivative()(inside) + ends
