"""Noise of torque channels inside the band of the fit."""

# Spectra distinguish noise from model error. There is no motion above the band of the
# fit: differences of high order, without reversals, where dry friction jumps, measure
# the noise there. Its spectrum continues smoothly into the band. If it flattens towards
# the band, that suffices; if it still rises, the residual between the motion's band and
# the cut-off limits the level; otherwise it is unknown.

import itertools
from dataclasses import dataclass
from math import comb

import numpy as np
import scipy

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.effects import elements
from sklearn_vbjfa.equations._motion_facts import in_parallel

_ORDER = 5
# The median of abs(x) of a normal variable in standard deviations; the log variance
# estimated from n independent samples has this standard deviation times n^-1/2.
_MEDIAN, _MEDIAN_SPREAD = 0.6745, 2.33
# Dependent differences of white noise that are worth one independent sample.
_DEPENDENCE = 2.9
# Variance of the differences of white noise of variance one; share of the residual from
# which on the rounding of the torques explains it.
_WHITE_SCALE, _ROUNDED = comb(2 * _ORDER, _ORDER), 0.5
# Strides of the differences, and their lowest frequency relative to the cut-off: at
# lower ones too many differences would contain a reversal.
_STRIDES = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)
_LOWEST = 2.0
# Gap: borders of the bands between motion (a fifth of the cut-off) and differences,
# relative to the cut-off; length of the spectral windows in periods of the cut-off.
_GAP = np.array([0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.5, 4.0])
_WINDOW = 12.0
# Model error of the family of spectra, in log power.
_MODEL_ERROR = 0.05
# Time after a reversal in which friction changes, times the cut-off; presliding
# displacements, as shares of the joint's range.
_REVERSAL_TIME = 0.1
_DISPLACEMENTS = (0.003, 0.03)
# Largest reported standard deviation of the log level; the same from the spectrum above
# the band alone, if the cost of white noise exceeds the least by at most the third.
_MAX_STD, _MAX_STD_WHITE, _WHITE_COST = 0.15, 0.25, 4.0
# Largest mean squared misfit of the residual in the gap to the noise spectrum, and of
# the spectrum above the band to the closest one of the family.
_MAX_GAP_MISFIT, _MAX_MISFIT = 3.0, 30.0
# Ripples periodic in position [1/rad or 1/m]: bins of the position (four per shortest
# period), largest number, smallest share of the power above the band, smallest ratio to
# the largest share by chance, relative difference of equal ones in two recordings.
_BINS, _N_WAVES, _MIN_POWER, _MIN_RATIO, _TOLERANCE = 16384, 3, 0.1, 5.0, 0.03
# Share of equal times between changes of a torque that identifies a held signal.
_HELD_SHARE = 0.8
# Largest number of rows of a recording that are analysed.
ROWS = 100_000
_SHORTEST = 64


def filtered_white_noise(deviation, nv, dt, cutoff):
    """Return the white torque noise (nv,) that passes the low-pass."""
    # deviation: standard deviation of a sample [N m or N]; None gives nan.
    if deviation is None:
        return np.full(nv, np.nan)
    noise = np.asarray(deviation, dtype=float)
    if noise.shape not in {(), (nv,)} or not ((noise >= 0) & np.isfinite(noise)).all():
        raise ValueError(
            "torque_noise must be a non-negative standard deviation of one torque "
            f"sample [N m or N], or {nv} of them, or None; got {deviation!r}."
        )
    noise = np.broadcast_to(noise, (nv,))
    if not np.isfinite(cutoff):
        return noise.copy()
    taps = _lowpass.design(dt, cutoff).taps
    return noise * np.sqrt(taps @ taps)


@dataclass(frozen=True)
class NoiseFacts:
    """Noise measurements from the torques of one recording."""

    n: int
    hold: np.ndarray  # (nv,): number of rows for which a torque is held
    # (nv, n_strides): variances of differences at the strides, in samples of the held
    # signal; nan if the recording is too short
    scales: np.ndarray
    gap: np.ndarray  # (nv, n_bands): power per row in the bands of the gap
    # (nv, n_waves): frequencies of position ripples [1/rad or 1/m], or zero
    waves: np.ndarray
    rounding: np.ndarray  # (nv,): mean square of the filtered rounding errors


def stopband_exists(dt, cutoff):
    """Return True if a band exists between the low-pass and the Nyquist frequency."""
    return dt is not None and np.isfinite(cutoff) and _LOWEST * cutoff <= 0.5 / dt


def noise_facts(residual, torque, states, dt, cutoff, n_jobs=None):
    """Measure the spectrum of the residual (n, nv) of one recording."""
    # states (n, 3 nv); dt [s]; cutoff: of the fit [Hz].
    n, nv = residual.shape
    columns = zip(residual.T, torque.T, states[:, :nv].T, states[:, nv : 2 * nv].T)
    facts = in_parallel(_joint_facts, ((*x, dt, cutoff) for x in columns), n_jobs)
    return NoiseFacts(n, *map(np.array, zip(*facts)))


def _joint_facts(residual, torque, q, v, dt, cutoff):
    residual, torque, q, v = map(np.ascontiguousarray, (residual, torque, q, v))
    n, count = residual.size, held_rows(torque)
    scales = np.full(len(_STRIDES), np.nan)
    reach = int(_REVERSAL_TIME / (cutoff * dt))
    reversals = np.cumsum(np.r_[0, np.diff(np.sign(v)) != 0, 0])
    first = np.arange(count // 2, n, count)
    after = reversals[np.minimum(first + reach, n - 1)]
    before = reversals[np.maximum(first - reach, 0)]
    x = residual[count // 2 :: count]
    for k, stride in enumerate(_strides(dt * count, cutoff)):
        if x.size >= max(_SHORTEST, 16 * _ORDER * stride):
            d = x
            for _ in range(_ORDER):
                d = d[stride:] - d[:-stride]
            d = d[after[-d.size :] == before[: d.size]]
            if d.size >= _SHORTEST:
                scales[k] = (np.median(np.abs(d)) / _MEDIAN) ** 2
    remainder = _remove_friction(q, v, residual)
    taps = _lowpass.design(dt, cutoff).taps
    rounding = _rounding_power(torque, torque - residual, scales[0], taps)
    waves = _waves(q, residual, count, taps)
    return count, scales, _gap_power(remainder, dt, cutoff), waves, rounding


def _rounding_power(torque, predicted, scale, taps):
    """Mean square of the filtered rounding error, simulated from predicted torques."""
    # It is not white: slow torques cross the levels at times that the motion sets,
    # unless noise blurs the crossings; scale: variance of its differences.
    step = np.median(np.diff(np.unique(torque))) if np.ptp(torque) > 0 else 0.0
    if not step > 0 or torque.size < taps.size:
        return 0.0
    white = np.sqrt(max(np.nan_to_num(scale) / _WHITE_SCALE - step**2 / 12, 0.0))
    noisy = predicted + white * np.random.default_rng(0).normal(size=predicted.size)
    error = torque[0] + step * np.round((noisy - torque[0]) / step) - predicted
    return np.mean(scipy.signal.oaconvolve(error, taps, mode="valid") ** 2)


def _waves(q, x, hold, taps):
    """Find peaks (n_waves,) in the spectrum of x (n,) over position, above the band."""
    waves, travel, half = np.zeros(_N_WAVES), np.ptp(q), taps.size // 2
    if not travel > 0 or x.size < 2 * taps.size:
        return waves
    x = (x - scipy.signal.oaconvolve(x, taps, mode="same"))[half:-half]
    bins = ((q[half:-half] - q.min()) * (_BINS / travel)).astype(int)
    sums = np.fft.rfft(np.bincount(bins, x), 4 * _BINS)[: _BINS + 1]
    unit = 2 / max(x.size * (x @ x), np.finfo(float).tiny)
    share = unit * np.abs(sums) ** 2
    # At constant speed a tone has the same spectrum: peaks must exceed it.
    tone = unit * (np.abs(np.fft.rfft(x, 4 * x.size)) ** 2).max()
    floor = max(_MIN_POWER, tone, 2 * _MIN_RATIO * np.log(_BINS) * hold / x.size)
    peaks = scipy.signal.find_peaks(share, floor, distance=8)[0]
    largest = peaks[np.argsort(-share[peaks])][:_N_WAVES]
    waves[: largest.size] = largest / (4 * travel)
    return waves


def _remove_friction(q, v, residual):
    """Subtract the least-squares fit of the joint's friction from a residual (n,)."""
    travel = np.ptp(q)
    if not travel > 0:
        return residual
    friction = [np.sign(v), v, np.abs(v), v * np.abs(v)]
    friction += list(elements(q, travel * np.array(_DISPLACEMENTS)).T)
    columns = np.stack([*friction, np.ones_like(q)])
    sizes = np.abs(columns).max(axis=1, keepdims=True)
    columns /= np.maximum(sizes, np.finfo(float).tiny)
    # Normal equations suffice: the fit is unique, even if the coefficients are not.
    products = columns @ columns.T, columns @ residual
    return residual - np.linalg.lstsq(*products, rcond=None)[0] @ columns


def held_rows(torque):
    """Return the number of rows for which a torque (n,) is held, 1 if it is not."""
    changes = np.flatnonzero(np.diff(torque))
    if changes.size < 2:
        return 1
    lengths = np.diff(changes)
    usual = round(np.median(lengths))
    # Rounded torques repeat values as well, but at irregular times.
    equal = np.abs(lengths - usual) <= max(1, usual // 4)
    return usual if usual > 1 and equal.mean() > _HELD_SHARE else 1


def _strides(dt, cutoff):
    return [s for s in _STRIDES if 2 * s * dt * cutoff * _LOWEST <= 1.0]


def _gap_power(x, dt, cutoff):
    """Power per row of x (n,) in bands of the gap (n_bands,), median of windows."""
    length = round(_WINDOW / (cutoff * dt))
    power = np.full(_GAP.size - 1, np.nan)
    if x.size < 3 * length:
        return power
    taper = np.hanning(length + 2)[1:-1]
    borders = np.searchsorted(np.fft.rfftfreq(length, dt) / cutoff, _GAP)
    windows = np.lib.stride_tricks.sliding_window_view(x, length)[:: length // 2]
    windows = (windows - windows.mean(axis=1, keepdims=True)) * taper
    spectra = np.abs(np.fft.rfft(windows, axis=1)) ** 2 / (taper @ taper)
    for k, (low, high) in enumerate(itertools.pairwise(borders)):
        if low < high:
            power[k] = np.median(spectra[:, low:high].mean(axis=1))
    # the median of a Gamma variable over its mean (Wilson and Hilferty)
    return power / (1 - 1 / (9 * _gap_shape())) ** 3


def common_waves(facts):
    """Waves (nv, n_waves) of the longest recording shared by most rows, or zero."""
    longest = max(facts, key=lambda x: x.n).waves
    others = np.array([x.waves for x in facts])[:, :, None]
    near = np.abs(others - longest[..., None]) < _TOLERANCE * longest[..., None]
    rows = np.array([x.n for x in facts]) / sum(x.n for x in facts)
    return longest * (np.tensordot(rows, near.any(axis=-1), 1) > 0.5)


def _gap_shape():
    return np.maximum(np.diff(_GAP) * _WINDOW / 1.5, 1.0)


def filtered_noise(facts, dt, cutoff, left=np.inf):
    """Return the std (nv,) [N m or N] of the noise that passes the low-pass."""
    # left (nv,): filtered residual of the fit, standard deviation. nan if unknown:
    # without a low-pass, with one too close to the Nyquist frequency, with a spectrum
    # that rises towards the band without continuation, or with position ripples.
    nv = facts[0].hold.size
    noise, left = np.full(nv, np.nan), np.where(left > 0, left, np.inf) * np.ones(nv)
    if not stopband_exists(dt, cutoff):
        return noise
    families, waves = {}, common_waves(facts)
    for j in range(nv):
        # the hold length is the same in all recordings of a robot
        hold = int(np.median([f.hold[j] for f in facts]))
        used = [f for f in facts if f.hold[j] == hold]
        strides = _strides(dt * hold, cutoff)
        if not strides or not used or waves[j].any():
            continue
        rows = np.array([f.n for f in used])
        scales, scale_rows = _mean([f.scales[j, : len(strides)] for f in used], rows)
        gap, gap_rows = _mean([f.gap[j] for f in used], rows)
        measured = scales > 0
        if not measured.any():
            continue
        if hold not in families:
            families[hold] = _NoiseFamily.of(dt, hold, cutoff)
        count = np.maximum(scale_rows / (hold * _DEPENDENCE * np.array(strides)), 1.0)
        scale_spread = np.hypot(_MODEL_ERROR, _MEDIAN_SPREAD / np.sqrt(count))
        # windows overlap by half
        count = np.maximum(1.8 * gap_rows * dt * cutoff / _WINDOW, 1.0) * _gap_shape()
        gap_spread = np.hypot(_MODEL_ERROR, 1.25 / np.sqrt(count))
        scales = np.where(measured, scales, np.nan)
        left_spread = np.hypot(_MODEL_ERROR, 1.0 / np.sqrt(rows.sum() * dt * cutoff))
        noise[j] = families[hold].deviation(
            scales, scale_spread, gap, gap_spread, 2 * np.log(left[j]), left_spread
        )
    rounding = np.sqrt(_mean([f.rounding for f in facts], [f.n for f in facts])[0])
    explains = rounding > _ROUNDED * left
    return np.minimum(np.fmax(noise, np.where(explains, rounding, np.nan)), left)


def _mean(values, rows):
    values, rows = np.array(values), np.array(rows, dtype=float)
    weight = rows[:, None] * np.isfinite(values)
    total = weight.sum(axis=0)
    summed = (np.where(np.isfinite(values), values, 0.0) * weight).sum(axis=0)
    return summed / np.where(total > 0, total, np.nan), total


@dataclass(frozen=True, kw_only=True)
class _NoiseFamily:
    """Family of noise spectra of unit amplitude."""

    # White noise; noise of one pole, and of two (a sensor's low-pass), with any corner
    # frequency and any level of added white noise.

    prior: np.ndarray  # (m,): probabilities, one half for white noise
    scales: np.ndarray  # (m, n_strides): logarithms of the variances of differences
    gap: np.ndarray  # (m, n_bands): logarithms of the power per row in the gap
    band: np.ndarray  # (m,): logarithms of the variance after the low-pass

    @classmethod
    def of(cls, dt, hold, cutoff):
        step = dt * hold
        # cycles per held sample
        even = np.linspace(1e-4, 0.5, 6000)
        nu = np.unique(np.r_[np.geomspace(1e-3 * cutoff * step, 0.5, 4000), even])
        corners = np.geomspace(0.05 * cutoff, 0.45 / step, 48)
        rho = np.exp(-2 * np.pi * corners * step)[:, None]
        one_pole = 1 / (1 + 4 * rho / (1 - rho) ** 2 * np.sin(np.pi * nu) ** 2)
        tangent = np.tan(np.pi * np.minimum(nu, 0.4999))
        two_pole = 1 / (1 + (tangent / np.tan(np.pi * corners * step)[:, None]) ** 4)
        S = np.vstack([np.ones(nu.size), one_pole, two_pole])
        weight = np.gradient(nu)
        strides = np.array(_strides(step, cutoff))
        gains = (2 * np.sin(np.pi * nu * strides[:, None])) ** (2 * _ORDER)
        # Normalise by the exact gain for white noise, independent of the grid.
        gains *= _WHITE_SCALE / (gains @ weight)[:, None]
        # power per row: a hold multiplies it at low frequencies
        frequency, held = nu / step, (np.sinc(nu) / np.sinc(nu / hold)) ** 2
        per_row = hold * held
        borders = itertools.pairwise(_GAP * cutoff)
        bands = [(frequency >= low) & (frequency < high) for low, high in borders]
        passed = _gain(dt, cutoff, frequency) ** 2 * held
        views = [*(gains * weight)]
        # A band above the Nyquist frequency is empty, and not measured.
        views += [b * per_row * weight / max(b @ weight, nu[0]) for b in bands]
        views.append(2 * passed * weight)
        powers = S @ np.array(views).T
        # Added white noise adds its measured powers.
        white, shapes = powers[:1], powers[1:]
        floors = np.r_[0.0, np.geomspace(1e-4, 1.0, 13)][:, None]
        mixed = (shapes[:, None] + floors * white).reshape(-1, white.shape[1])
        with np.errstate(divide="ignore"):
            powers = np.log(np.vstack([white, mixed]))
        return cls(
            prior=np.r_[0.5, np.full(len(mixed), 0.5 / len(mixed))],
            scales=powers[:, : strides.size],
            gap=powers[:, strides.size : -1],
            band=powers[:, -1],
        )

    def deviation(self, scales, scale_spread, gap, gap_spread, left, left_spread):
        """Return the std of the low-pass filtered noise, or nan."""
        # scales (n_strides,): variances of differences, nan if not measured; gap
        # (n_bands,): power per row in the gap; left: logarithm of the largest variance
        # allowed; spreads: standard deviations of the logarithms.
        with np.errstate(invalid="ignore", divide="ignore"):
            above = (np.log(scales) - self.scales) / scale_spread
            in_gap = (np.log(gap) - self.gap) / gap_spread
        has_above, has_gap = np.isfinite(scales), gap > 0
        w_above = np.where(has_above, scale_spread**-2.0, 0.0)
        w_gap = np.where(has_gap, gap_spread**-2.0, 0.0)
        above, in_gap = np.where(has_above, above, 0.0), np.where(has_gap, in_gap, 0.0)

        def cost_of(amplitude, most):
            """Sum squared deviations, those in the gap clipped from above at `most`."""
            dev = above - amplitude[:, None] / scale_spread * has_above
            more = in_gap - amplitude[:, None] / gap_spread * has_gap
            over = np.maximum((self.band + amplitude - left) / left_spread, 0.0)
            squares = (dev**2).sum(axis=1) + (np.minimum(more, most) ** 2).sum(axis=1)
            return squares + over**2

        # Fit above the band alone: noise cannot exceed the residual in the gap.
        amplitude = (above * scale_spread) @ w_above / w_above.sum()
        cost = cost_of(amplitude, 0.0)
        (low, level, high), misfit = self._level(cost, amplitude, has_above.sum())
        # One stride does not determine the shape of the spectrum. White noise needs no
        # data in the gap, only a lower likelihood of all other shapes.
        white = cost[0] <= cost.min() + _WHITE_COST
        limit = _MAX_STD_WHITE if white else _MAX_STD
        precise = (
            high - low <= 2 * limit and misfit <= _MAX_MISFIT and has_above.sum() > 1
        )
        margin = _MAX_STD if precise else 2 * _MAX_STD
        interval = low - margin, high + margin
        if has_gap.any():
            # Fit the spectrum above the band and in the gap together.
            amplitude = (above * scale_spread) @ w_above + (in_gap * gap_spread) @ w_gap
            amplitude /= w_above.sum() + w_gap.sum()
            count = has_above.sum() + has_gap.sum()
            cost = cost_of(amplitude, np.inf)
            (low, combined, high), misfit = self._level(cost, amplitude, count)
            agree = interval[0] <= combined <= interval[1]
            if agree and misfit <= _MAX_GAP_MISFIT and high - low <= 2 * _MAX_STD:
                return np.exp(combined)
        return np.exp(level) if precise else np.nan

    def _level(self, cost, amplitude, count):
        """Quantiles of the log level (16, 50, 84 %), and the least mean cost."""
        misfit = cost.min() / max(count - 2, 1)
        weight = self.prior * np.exp(-0.5 * (cost - cost.min()) / max(misfit, 1.0))
        weight /= weight.sum()
        values = 0.5 * (self.band + amplitude)
        order = np.argsort(values)
        share = np.cumsum(weight[order]) / weight.sum()
        index = np.searchsorted(share, [0.16, 0.5, 0.84])
        return values[order][np.minimum(index, order.size - 1)], misfit


def _gain(dt, cutoff, frequency):
    taps = _lowpass.design(dt, cutoff).taps
    n = 1 << int(np.ceil(np.log2(16 * taps.size)))
    gain = np.abs(np.fft.rfft(taps, n))
    return np.interp(frequency, np.fft.rfftfreq(n, dt), gain)
