"""Noise of torque channels inside the band of the fit."""

# Noise and what a model lacks are told apart by their spectra. Above the band no motion
# is: there that of the residual is measured by differences of high order, without
# reversals, where dry friction jumps. Noise continues it smoothly into the band: known
# from above where it bends towards a flat one; where it still rises, the residual
# between the band of the motion and the cut-off says how far; else it is unknown.

import itertools
from dataclasses import dataclass
from math import comb

import numpy as np
import scipy

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.effects import elements
from sklearn_vbjfa.equations._plan import in_parallel

_ORDER = 5
# The median of abs(x) is 0.6745 standard deviations of a normal variable, and the
# logarithm of a variance from n independent ones has this deviation times n^-1/2.
_MEDIAN, _MEDIAN_SPREAD = 0.6745, 2.33
# Samples of such differences of white noise that count for one.
_DEPENDENCE = 2.9
# Strides of the differences, and their lowest frequency relative to the cut-off:
# at lower ones too many differences would hold a reversal.
_STRIDES = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)
_LOWEST = 2.0
# Bands between those of the motion (a fifth of the cut-off) and of the differences,
# over the cut-off, seen through windows of this many periods of it.
_GAP = np.array([0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.5, 4.0])
_WINDOW = 12.0
# Model error of the family of spectra, in log power.
_UNLIKE = 0.05
# Time after a reversal in which friction turns round, times the cut-off; displacements
# in which it may, as shares of the joint's range.
_TURNING = 0.1
_DISPLACEMENTS = (0.003, 0.03)
# A deviation is reported if its logarithm is known this well; from above alone, where
# white noise is as likely as any but for this cost, the second will do.
_KNOWN, _KNOWN_ABOVE, _WHITE = 0.15, 0.25, 4.0
# The residual in the gap is on the curve of the noise above if the mean squared
# deviation from it is at most the first, and a spectrum above the band like one of the
# family if at most the second.
_CONSISTENT, _ALIKE = 3.0, 30.0
# Waves of a position [1/rad or 1/m] are looked for up to a quarter of so many within
# its range, this many of them, which make up this share of the power above the band and
# so many times what the largest of them would by chance. To this relative difference
# they are the same in two recordings.
_PLACES, _WAVES, _OF_POWER, _BY_CHANCE, _SAME = 16384, 3, 0.1, 5.0, 0.03
# Share of the times between changes of a torque that are alike if it is held.
_HELD = 0.8
# Rows of a recording that are looked at.
ROWS = 100_000
_SHORTEST = 64


def filtered_white_noise(deviation, nv, dt, cutoff):
    """Return the white torque noise (nv,) that passes the low-pass."""
    # deviation: of a sample [N m or N]; None gives nan.
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


@dataclass(frozen=True, kw_only=True)
class NoiseFacts:
    """Noise measurements from the torques of one recording."""

    n: int
    hold: np.ndarray  # (nv,): rows for which a torque is held
    # (nv, n_strides): variances of differences at the strides, per sample of what is
    # held; nan where the recording is too short
    scales: np.ndarray
    gap: np.ndarray  # (nv, n_bands): power per row in the bands of the gap
    # (nv, n_waves): waves of the position that noise is not [1/rad or 1/m], or zero
    waves: np.ndarray


def stopband_exists(dt, cutoff):
    """Whether anything lies between the low-pass and the Nyquist frequency."""
    return dt is not None and np.isfinite(cutoff) and _LOWEST * cutoff <= 0.5 / dt


def noise_facts(residual, torque, states, dt, cutoff, n_jobs=None):
    """Measure the spectrum of the residual (n, nv) of one recording."""
    # states (n, 3 nv); dt [s]; cutoff: of the fit [Hz].
    n, nv = residual.shape
    columns = zip(residual.T, torque.T, states[:, :nv].T, states[:, nv : 2 * nv].T)
    found = in_parallel(_of_joint, ((*own, dt, cutoff) for own in columns), n_jobs)
    hold, scales, gap, waves = map(np.array, zip(*found))
    return NoiseFacts(n=n, hold=hold, scales=scales, gap=gap, waves=waves)


def _of_joint(residual, torque, q, v, dt, cutoff):
    residual, torque, q, v = map(np.ascontiguousarray, (residual, torque, q, v))
    n, count = residual.size, held_rows(torque)
    scales = np.full(len(_STRIDES), np.nan)
    turning = int(_TURNING / (cutoff * dt))
    turned = np.cumsum(np.r_[0, np.diff(np.sign(v)) != 0, 0])
    first = np.arange(count // 2, n, count)
    turned_after = turned[np.minimum(first + turning, n - 1)]
    turned_before = turned[np.maximum(first - turning, 0)]
    x = residual[count // 2 :: count]
    for k, stride in enumerate(_strides(dt * count, cutoff)):
        if x.size >= max(_SHORTEST, 16 * _ORDER * stride):
            d = x
            for _ in range(_ORDER):
                d = d[stride:] - d[:-stride]
            d = d[turned_after[-d.size :] == turned_before[: d.size]]
            if d.size >= _SHORTEST:
                scales[k] = (np.median(np.abs(d)) / _MEDIAN) ** 2
    left = _without_own_friction(q, v, residual)
    waves = _waves(q, residual, count, _lowpass.design(dt, cutoff).taps)
    return count, scales, _gap_power(left, dt, cutoff), waves


def _waves(q, x, hold, taps):
    """Waves (n_waves,) of a position that stand out in x (n,) above the band."""
    found, reach, half = np.zeros(_WAVES), np.ptp(q), taps.size // 2
    if not reach > 0 or x.size < 2 * taps.size:
        return found
    x = (x - scipy.signal.oaconvolve(x, taps, mode="same"))[half:-half]
    place = ((q[half:-half] - q.min()) * (_PLACES / reach)).astype(int)
    sums = np.fft.rfft(np.bincount(place, x), 4 * _PLACES)[: _PLACES + 1]
    unit = 2 / max(x.size * (x @ x), np.finfo(float).tiny)
    share = unit * np.abs(sums) ** 2
    # Where a joint moves evenly, a tone looks the same.
    tone = unit * (np.abs(np.fft.rfft(x, 4 * x.size)) ** 2).max()
    least = max(_OF_POWER, tone, 2 * _BY_CHANCE * np.log(_PLACES) * hold / x.size)
    peaks = scipy.signal.find_peaks(share, least, distance=8)[0]
    best = peaks[np.argsort(-share[peaks])][:_WAVES]
    found[: best.size] = best / (4 * reach)
    return found


def _without_own_friction(q, v, residual):
    """Remove from a residual (n,) what friction of the joint itself can explain."""
    reach = np.ptp(q)
    if not reach > 0:
        return residual
    friction = [np.sign(v), v, np.abs(v), v * np.abs(v)]
    friction += list(elements(q, reach * np.array(_DISPLACEMENTS)).T)
    columns = np.stack([*friction, np.ones_like(q)])
    sizes = np.abs(columns).max(axis=1, keepdims=True)
    columns /= np.maximum(sizes, np.finfo(float).tiny)
    # Products suffice: what they cannot tell apart takes away the same.
    products = columns @ columns.T, columns @ residual
    return residual - np.linalg.lstsq(*products, rcond=None)[0] @ columns


def held_rows(torque):
    """Return for how many rows a torque (n,) keeps its value, 1 if it does not."""
    changes = np.flatnonzero(np.diff(torque))
    if changes.size < 2:
        return 1
    lengths = np.diff(changes)
    usual = round(np.median(lengths))
    # Rounded torques repeat values as well, but for irregular times.
    alike = np.abs(lengths - usual) <= max(1, usual // 4)
    return usual if usual > 1 and alike.mean() > _HELD else 1


def _strides(dt, cutoff):
    return [s for s in _STRIDES if 2 * s * dt * cutoff * _LOWEST <= 1.0]


def _gap_power(x, dt, cutoff):
    """Power per row of x (n,) in bands of the gap (n_bands,), median of windows."""
    length = round(_WINDOW / (cutoff * dt))
    power = np.full(_GAP.size - 1, np.nan)
    if x.size < 3 * length:
        return power
    taper = np.hanning(length + 2)[1:-1]
    frequency = np.fft.rfftfreq(length, dt) / cutoff
    borders = np.searchsorted(frequency, _GAP)
    windows = np.lib.stride_tricks.sliding_window_view(x, length)[:: length // 2]
    windows = (windows - windows.mean(axis=1, keepdims=True)) * taper
    spectra = np.abs(np.fft.rfft(windows, axis=1)) ** 2 / (taper @ taper)
    for k, (low, high) in enumerate(itertools.pairwise(borders)):
        if low < high:
            power[k] = np.median(spectra[:, low:high].mean(axis=1))
    # the median of a Gamma variable over its mean (Wilson and Hilferty)
    return power / (1 - 1 / (9 * _gap_shape())) ** 3


def common_waves(facts):
    """Waves (nv, n_waves) of the longest recording that most rows have, or zero."""
    best = max(facts, key=lambda own: own.n).waves
    others = np.array([own.waves for own in facts])[:, :, None]
    near = np.abs(others - best[..., None]) < _SAME * best[..., None]
    rows = np.array([own.n for own in facts]) / sum(own.n for own in facts)
    return best * (np.tensordot(rows, near.any(axis=-1), 1) > 0.5)


def _gap_shape():
    return np.maximum(np.diff(_GAP) * _WINDOW / 1.5, 1.0)


def filtered_noise(facts, dt, cutoff, left=np.inf):
    """Deviations (nv,) [N m or N] of the noise that passes the low-pass."""
    # left (nv,): deviations that the fit leaves behind the low-pass. nan where they
    # cannot be found: without a low-pass, with one too close to the Nyquist frequency,
    # where the spectrum rises towards the band and is not continued, or where it has
    # waves of the position.
    nv = facts[0].hold.size
    found, left = np.full(nv, np.nan), np.where(left > 0, left, np.inf) * np.ones(nv)
    if not stopband_exists(dt, cutoff):
        return found
    families, waves = {}, common_waves(facts)
    for j in range(nv):
        # recordings of one robot are held alike
        hold = int(np.median([f.hold[j] for f in facts]))
        used = [f for f in facts if f.hold[j] == hold]
        strides = _strides(dt * hold, cutoff)
        if not strides or not used or waves[j].any():
            continue
        rows = np.array([f.n for f in used], dtype=float)
        scales, scale_rows = _mean([f.scales[j, : len(strides)] for f in used], rows)
        gap, gap_rows = _mean([f.gap[j] for f in used], rows)
        seen_scales = scales > 0
        if not seen_scales.any():
            continue
        if hold not in families:
            families[hold] = _NoiseFamily.of(dt, hold, cutoff)
        independent = scale_rows / (hold * _DEPENDENCE * np.array(strides))
        scale_spread = np.hypot(
            _UNLIKE, _MEDIAN_SPREAD / np.sqrt(np.maximum(independent, 1.0))
        )
        # they overlap by half
        windows = 1.8 * gap_rows * dt * cutoff / _WINDOW
        gap_spread = np.hypot(
            _UNLIKE, 1.25 / np.sqrt(np.maximum(windows, 1.0) * _gap_shape())
        )
        scales = np.where(seen_scales, scales, np.nan)
        left_spread = np.hypot(_UNLIKE, 1.0 / np.sqrt(rows.sum() * dt * cutoff))
        found[j] = families[hold].deviation(
            scales, scale_spread, gap, gap_spread, 2 * np.log(left[j]), left_spread
        )
    return np.minimum(found, left)


def _mean(values, rows):
    values = np.array(values)
    weight = rows[:, None] * np.isfinite(values)
    total = weight.sum(axis=0)
    summed = (np.where(np.isfinite(values), values, 0.0) * weight).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(total > 0, summed / total, np.nan), total


@dataclass(frozen=True, kw_only=True)
class _NoiseFamily:
    """Spectra that noise may have, each of one amplitude."""

    # White noise; noise of one pole, and of two (a sensor's low-pass), with their
    # corner anywhere, and with white noise on top.

    prior: np.ndarray  # (m,): how likely they are: white noise as likely as all others
    scales: np.ndarray  # (m, n_strides): logarithms of the variances of differences
    gap: np.ndarray  # (m, n_bands): logarithms of the power per row in the gap
    band: np.ndarray  # (m,): logarithms of the variance behind the low-pass

    @classmethod
    def of(cls, dt, hold, cutoff):
        step = dt * hold
        # cycles per held sample
        nu = np.unique(
            np.r_[
                np.geomspace(1e-3 * cutoff * step, 0.5, 4000),
                np.linspace(1e-4, 0.5, 6000),
            ]
        )
        corners = np.geomspace(0.05 * cutoff, 0.45 / step, 48)
        rho = np.exp(-2 * np.pi * corners * step)[:, None]
        one = 1 / (1 + 4 * rho / (1 - rho) ** 2 * np.sin(np.pi * nu) ** 2)
        tangent = np.tan(np.pi * np.minimum(nu, 0.4999))
        two = 1 / (1 + (tangent / np.tan(np.pi * corners * step)[:, None]) ** 4)
        S = np.vstack([np.ones(nu.size), one, two])
        weight = np.gradient(nu)
        strides = np.array(_strides(step, cutoff))
        gains = (2 * np.sin(np.pi * nu * strides[:, None])) ** (2 * _ORDER)
        # The gain for white noise is known exactly, whatever the grid.
        exact = comb(2 * _ORDER, _ORDER)
        gains *= exact / (gains @ weight)[:, None]
        # power per row: what is held is that many times as large at low frequencies
        frequency = nu / step
        per_row = hold * np.sinc(nu) ** 2
        bands = [
            (frequency >= low * cutoff) & (frequency < high * cutoff)
            for low, high in itertools.pairwise(_GAP)
        ]
        passed = _gain(dt, cutoff, frequency) ** 2 * np.sinc(nu) ** 2
        views = [*(gains * weight)]
        # A band beyond the Nyquist frequency is empty, and not measured either.
        views += [b * per_row * weight / max(b @ weight, nu[0]) for b in bands]
        views.append(2 * passed * weight)
        seen_as = S @ np.array(views).T
        # White noise on top of each adds what is seen of it.
        white, shapes = seen_as[:1], seen_as[1:]
        floors = np.r_[0.0, np.geomspace(1e-4, 1.0, 13)][:, None]
        mixed = (shapes[:, None] + floors * white).reshape(-1, white.shape[1])
        with np.errstate(divide="ignore"):
            seen_as = np.log(np.vstack([white, mixed]))
        return cls(
            prior=np.r_[0.5, np.full(len(mixed), 0.5 / len(mixed))],
            scales=seen_as[:, : strides.size],
            gap=seen_as[:, strides.size : -1],
            band=seen_as[:, -1],
        )

    def deviation(self, scales, scale_spread, gap, gap_spread, left, left_spread):
        """Return the low-pass filtered deviation of the measured torque, or nan."""
        # scales (n_strides,): variances of differences, nan where not seen; gap
        # (n_bands,): power per row in the gap; left: logarithm of the largest variance
        # that it may have; the spreads are deviations of their logarithms.
        with np.errstate(invalid="ignore", divide="ignore"):
            above = (np.log(scales) - self.scales) / scale_spread
            between = (np.log(gap) - self.gap) / gap_spread
        seen_above, seen_between = np.isfinite(scales), gap > 0
        w_above = np.where(seen_above, scale_spread**-2.0, 0.0)
        w_between = np.where(seen_between, gap_spread**-2.0, 0.0)
        above, between = (
            np.where(seen, x, 0.0)
            for seen, x in ((seen_above, above), (seen_between, between))
        )

        def cost_of(amplitude, most):
            """Sum the squared deviations, those in the gap as far as at most `most`."""
            own = above - amplitude[:, None] / scale_spread * seen_above
            more = between - amplitude[:, None] / gap_spread * seen_between
            over = np.maximum((self.band + amplitude - left) / left_spread, 0.0)
            squares = (own**2).sum(axis=1) + (np.minimum(more, most) ** 2).sum(axis=1)
            return squares + over**2

        # From above alone: noise is no more than all that is left in the gap.
        amplitude = (above * scale_spread) @ w_above / w_above.sum()
        cost = cost_of(amplitude, 0.0)
        (low, level, high), unlike = self._level(cost, amplitude, seen_above.sum())
        # One stride shows no colour. What is white there needs no continuation, only
        # that nothing else is likely.
        white = cost[0] <= cost.min() + _WHITE
        enough = _KNOWN_ABOVE if white else _KNOWN
        settled = high - low <= 2 * enough and unlike <= _ALIKE and seen_above.sum() > 1
        margin = _KNOWN if settled else 2 * _KNOWN
        reach = low - margin, high + margin
        if seen_between.any():
            # With the gap as its continuation.
            total = w_above.sum() + w_between.sum()
            amplitude = (
                (above * scale_spread) @ w_above + (between * gap_spread) @ w_between
            ) / total
            count = seen_above.sum() + seen_between.sum()
            cost = cost_of(amplitude, np.inf)
            (low, both, high), unlike = self._level(cost, amplitude, count)
            agree = reach[0] <= both <= reach[1]
            if agree and unlike <= _CONSISTENT and high - low <= 2 * _KNOWN:
                return np.exp(both)
        return np.exp(level) if settled else np.nan

    def _level(self, cost, amplitude, count):
        """Quantiles of the logarithm of the level (16, 50, 84 %), least mean cost."""
        unlike = cost.min() / max(count - 2, 1)
        weight = self.prior * np.exp(-0.5 * (cost - cost.min()) / max(unlike, 1.0))
        weight /= weight.sum()
        values = 0.5 * (self.band + amplitude)
        order = np.argsort(values)
        share = np.cumsum(weight[order]) / weight.sum()
        at = np.searchsorted(share, [0.16, 0.5, 0.84])
        return values[order][np.minimum(at, order.size - 1)], unlike


def _gain(dt, cutoff, frequency):
    taps = _lowpass.design(dt, cutoff).taps
    n = 1 << int(np.ceil(np.log2(16 * taps.size)))
    gain = np.abs(np.fft.rfft(taps, n))
    return np.interp(frequency, np.fft.rfftfreq(n, dt), gain)
