"""Penalised splines: smoothed positions and derivatives with zero phase lag.

A quintic spline with uniform knots is fitted to uniformly spaced samples under a
penalty on its fifth derivative (the difference form of Eilers and Marx, 1996). Inside
the recording the fit acts as a symmetric filter with the gain

    G(f) = 1 / (1 + lambda (2 sin(pi f h))^10 / B(f)^2),

about 1 / (1 + (f / cutoff)^10), h being the knot distance; at the ends it
extrapolates the motion by its own polynomial: nothing is padded and nothing cut.
"""

import numpy as np
from scipy import linalg, sparse
from scipy.interpolate import BSpline

DEGREE = _DEGREE = 5
# Of the penalised derivative. The steeper the gain, the less the motion is attenuated
# for the same noise: accelerations of a 4 Hz motion are two to three times better than
# with the customary third derivative.
ORDER = _ORDER = 5

# Knots per period of the cut-off: with ten, the knots themselves attenuate a sine at
# the cut-off by less than 1e-4, and the banded system stays well conditioned at any
# sampling rate.
_KNOTS_PER_PERIOD = 10


# Coloured noise beyond the motion: frequency ratio of the gap between them, share of
# the velocity power below and largest share within it, and least flatness of the noise
# (geometric over arithmetic mean; 0.56 for the periodogram of white noise).
_GAP, _BELOW, _IN_GAP, _FLAT = 10.0, 0.8, 0.005, 0.05


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


def _difference_gain(frequency, h):
    # third differences of spline coefficients against the spline's own amplitude
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
        # Interpolation leaves the coefficients beyond the ends free. The penalty that
        # fixes them must be resolved by the arithmetic (with 1e-13 a straight line gets
        # accelerations at its ends) and changes white noise by only some 1e-6.
        return 1, 1e-9
    step = knot_step(dt, cutoff)
    return step, step * _penalty(dt, cutoff)


def smooth(x, dt, cutoff, at=None):
    """Smooth samples (n,), differentiate them twice, (3, m), `at` times (m,) [s]."""
    # cutoff [Hz]: where the gain is one half; infinity interpolates. Times count from
    # the first sample, up to one period outside the recording, and are by default those
    # of the samples.
    n = x.shape[0]
    step, lam = knots_and_penalty(dt, cutoff)
    # In units of the knot distance, with knots beyond both ends.
    u = np.arange(n) / step
    n_intervals = max(1, int(np.ceil(u[-1] - 1e-9)))
    times = u if at is None else np.asarray(at) / (dt * step)
    knots = np.arange(-_DEGREE, n_intervals + _DEGREE + 1, dtype=float)
    design = BSpline.design_matrix(np.minimum(u, n_intervals), knots, _DEGREE).tocsr()
    n_coef = n_intervals + _DEGREE
    gram = (design.T @ design).todia()
    offset = x.mean()
    bands = _upper_bands(gram, n_coef) + lam * penalty_bands(n_coef)
    coef = np.zeros(n_coef)
    differences = _differences(n_coef)
    # Iterative refinement, with residuals of fit and penalty computed separately.
    for _ in range(3):
        left = design.T @ (x - offset - design @ coef)
        left -= lam * (differences.T @ np.diff(coef, _ORDER))
        coef += linalg.solveh_banded(bands, left)
    spline = BSpline(knots, coef, _DEGREE)
    h = step * dt
    return np.stack(
        [
            spline(times) + offset,
            spline.derivative(1)(times) / h,
            spline.derivative(2)(times) / h**2,
        ]
    )


def _differences(n_coef):
    """Matrix of the differences of n_coef coefficients."""
    stencil = np.poly(np.ones(_ORDER))[::-1]
    return sparse.diags_array(
        [np.full(n_coef - _ORDER, c) for c in stencil],
        offsets=range(_ORDER + 1),
        shape=(n_coef - _ORDER, n_coef),
    ).tocsr()


def penalty_bands(n_coef):
    """Upper bands of the penalty on the differences of n_coef coefficients."""
    differences = _differences(n_coef)
    return _upper_bands((differences.T @ differences).todia(), n_coef)


def _upper_bands(matrix, size):
    bands = np.zeros((_DEGREE + 1, size))
    for k in range(_DEGREE + 1):
        bands[_DEGREE - k, k:] = matrix.diagonal(k)
    return bands


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
    # x (n,) or (n, k). Returns squared amplitudes (n_fft // 2 + 1[, k]), zero for a
    # recording that is too short, and the energy of the taper, by which to divide them.
    columns = x.reshape(x.shape[0], -1)
    n, window = x.shape[0], _window(dt)
    if n < MIN_SPECTRUM:
        return np.zeros((n_fft // 2 + 1, *x.shape[1:])), 0.0
    if n > window:
        count = min(-(-n // window), _MOST_WINDOWS)
        starts = np.linspace(0, n - window, count).astype(int)
        parts = [acceleration_power(x[i : i + window], dt, n_fft) for i in starts]
        return sum(power for power, _ in parts), sum(energy for _, energy in parts)
    # Second differences reduce the enormous dynamic range between slow motion and
    # noise, which would leak through any taper.
    d = np.ascontiguousarray(np.diff(columns, 2, axis=0).T) / dt**2
    d -= d.mean(axis=1, keepdims=True)
    taper = np.hanning(d.shape[1] + 2)[1:-1]
    power = np.abs(np.fft.rfft(d * taper, n_fft)) ** 2
    return power.T.reshape(-1, *x.shape[1:]), float(taper @ taper)


def acceleration_spectra(segments, dt):
    """Frequencies (m,) [Hz] and power (m[, k]) of all segments' second differences."""
    # The third result (m,) is the power that white noise of variance 1 would have
    # there.
    longest = max((x.shape[0] for x in segments), default=0)
    if longest < MIN_SPECTRUM:
        raise ValueError(
            "Choosing the cut-off from the data needs a recording of at least "
            f"{MIN_SPECTRUM} samples, got {longest}; give cutoff in Hz."
        )
    n_fft = fft_length(longest, dt)
    power, energy = 0.0, 0.0
    for x in segments:
        more = acceleration_power(x, dt, n_fft)
        power, energy = power + more[0], energy + more[1]
    return spectrum(power, energy, n_fft, dt)


def spectrum(power, energy, n_fft, dt):
    """Frequencies, power and noise gain from sums of `acceleration_power`."""
    frequency = np.fft.rfftfreq(n_fft, dt)
    noise_gain = (2 * np.sin(np.pi * frequency * dt)) ** 4 / dt**4
    return frequency[1:], power[1:] / energy, noise_gain[1:]


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
    size, larger = divmod(ratio.size, n_blocks)  # as np.array_split divides
    sizes = np.r_[np.full(larger, size + 1), np.full(n_blocks - larger, size)]
    means = np.add.reduceat(ratio, np.cumsum(sizes) - sizes) / sizes
    if n_blocks < 3:  # a mean, or as good as one
        return float(np.mean(means))
    return float(np.median(means) / (1 - 1 / (9 * _INDEPENDENT)) ** 3)


# A periodogram ordinate counts as signal above this multiple of the noise. Ordinates of
# noise are exponential: of all its power 0.3 % lies beyond, and 1 % where the level of
# the noise is estimated a fifth too low, as it is in recordings of some seconds.
_STANDS_OUT = 8.0


def choose_cutoff(frequency, power, noise_gain, dt):
    """Cut-off [Hz] that minimises the estimated error of the second derivative."""
    # With gain G the expected squared error at a frequency is (1 - G)^2 times the
    # signal power plus G^2 times the noise power; the signal power is the measured one
    # minus the noise (Mallows' C_p) where it stands out. Also returns the noise
    # variance; both are arrays if `power` has one spectrum per column.
    columns = power.reshape(power.shape[0], -1)
    variance = np.array(
        [white_noise_variance(frequency, column, noise_gain) for column in columns.T]
    )
    noise = variance * noise_gain[:, None]
    # Acceleration noise grows as the fourth power of frequency: a tenth of it taken for
    # signal would outweigh the motion.
    signal = np.where(columns > _STANDS_OUT * noise, columns - noise, 0.0)
    candidates = np.geomspace(max(frequency[0], 1e-3 / dt), 1.0 / (3 * dt), 120)
    risks = np.empty((candidates.size, columns.shape[1]))
    for i, cutoff in enumerate(candidates):
        # The gains are the same for all spectra.
        G = gain(frequency, dt, cutoff)
        risks[i] = (1 - G) ** 2 @ signal + (G**2 @ noise_gain) * variance
    cutoffs = candidates[np.argmin(risks, axis=0)]
    if power.ndim == 1:
        return float(cutoffs[0]), float(variance[0])
    return cutoffs, variance


def _noise_beyond(frequency, excess, power):
    """Index above which the excess power is coloured noise, beyond a wide gap."""
    # Interpolation and sampling jitter produce coloured noise that exceeds the white
    # level a decade above all motion. Lines there (vibration) are not noise: their
    # spectrum is not flat.
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
    # twice the `cutoff` of least error: far above it, some of the many noise ordinates
    # would exceed that level too.
    noise = variance * noise_gain
    signal = (power > 5 * noise) & (frequency <= 2 * cutoff)
    excess = np.where(signal, power - noise, 0.0) / frequency**2
    excess[_noise_beyond(frequency, excess, power) :] = 0.0
    cumulative = np.cumsum(excess)
    if not cumulative[-1] > 0:
        return float(min(cutoff, frequency[-1]))
    return float(frequency[np.argmax(cumulative >= share * cumulative[-1])])
