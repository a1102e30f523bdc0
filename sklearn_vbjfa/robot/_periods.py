"""Periodic motions: noise of any colour, measured between periods.

Even and odd samples of one recording differ by white noise only; slowly varying noise
is common to both. Even and odd *periods* of a repeated motion have nothing but the
motion in common, as long as the noise decorrelates within a period.
"""

import warnings
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa._core import _smoothing
from sklearn_vbjfa.recording import check_dt, contiguous_groups, take_arrays
from sklearn_vbjfa.robot._states import RecordingStates

# Shortest period, in samples, from which states can be estimated.
_MIN_PERIOD = 16
# Largest slip of the last period against the first, in samples: noise of a twentieth of
# the motion within one sample.
_LARGEST_SLIP = 0.05
# Noise between periods may be coloured, and so exceed its white level in the upper half
# of the spectrum; encoder noise never exceeds it by this factor and is at the same time
# this fraction of the motion.
_NOISE_RATIO, _NOISE_SHARE = 10.0, 0.01
# Reach of the smoother: its slowest mode decays by exp(-1.94) per period of the
# cut-off, to 2e-7 over these; without smoothing the spline's decays by 0.43 per sample.
_PERIODS_SEEN, _SAMPLES_SEEN = 8.0, 60


@dataclass(frozen=True, kw_only=True)
class PeriodAverages:
    """One period of each recording, measured twice."""

    # Rows, m = n_recordings * n_period, are those of the first recording's period, then
    # of the second's, and so on.

    n_period: int  # samples
    counts: np.ndarray  # (n_recordings,): whole periods of each recording
    # (m, n_columns): means over the even and the odd periods of positions, or states
    even: np.ndarray
    odd: np.ndarray
    torque: np.ndarray  # (m, nv): weighted means over all periods [N m or N]
    # (m, nv): realisation of noise with the size and colour of that of `torque`: the
    # scaled difference of even and odd periods; nan where only one of them has weight
    torque_noise: np.ndarray
    # (m, nv): mean over the periods, in proportion to their number in the recording
    weight: np.ndarray
    groups: np.ndarray  # (m,): number of the recording

    @property
    def mean(self):
        """Mean of `even` and `odd`."""
        # With an odd number of periods this is not the mean of all, so that a quarter
        # of the squared difference is exactly the covariance of its noise.
        return 0.5 * (self.even + self.odd)

    def repeated(self, margin):
        """Return rows, and slices of recordings, of periods continued at both ends."""
        # Each period is extended by `margin` samples on either side. rows (n_recordings
        # * (n_period + 2 margin),): the period's row at each extended one; parts:
        # slices of the recordings among them.
        one = np.arange(-margin, self.n_period + margin) % self.n_period
        first = self.n_period * np.arange(self.counts.size)
        rows = (first[:, None] + one).ravel()
        starts = one.size * np.arange(self.counts.size)
        return rows, [slice(int(a), int(a) + one.size) for a in starts]

    def both_starts(self):
        """Return each recording's period and the same started half a period later."""
        # For spectral estimates: the taper fades out the ends of each, and together the
        # two weight all samples alike. X (2 n_recordings * n_period, n_columns), and
        # group labels.
        n, p = self.counts.size, self.n_period
        later = np.roll(self.mean.reshape(n, p, -1), p // 2, axis=1)
        X = np.concatenate([self.mean, later.reshape(n * p, -1)])
        return X, np.concatenate([self.groups, n + self.groups])

    def states(self, estimator):
        """Estimate the states (m, 3 nv) of even and odd periods."""
        # The smoother is one-sided at the ends of a recording. A periodic motion has
        # none: each period is extended by itself as far as the smoother reaches, and
        # the extension is discarded. Without an estimator the columns are states
        # already.
        if estimator is None:
            return self.even, self.odd
        slowest = estimator.cutoff_.min()
        margin = _SAMPLES_SEEN
        if np.isfinite(slowest):
            margin += int(np.ceil(_PERIODS_SEEN / (slowest * estimator.dt)))
        rows, parts = self.repeated(margin)
        groups = np.repeat(np.arange(len(parts)), parts[0].stop)
        inner = np.concatenate(
            [np.arange(p.start + margin, p.stop - margin) for p in parts]
        )
        return tuple(
            estimator.transform(positions[rows], groups=groups)[inner]
            for positions in (self.even, self.odd)
        )

    def mean_states(self, estimator, halves):
        """Estimate the `RecordingStates` of the mean periods."""
        # With `halves`, those of `even` and `odd` as well.
        both = self.states(estimator)
        _, parts = self.repeated(0)
        # smoothing is linear: these are the states of the mean
        mean = 0.5 * (both[0] + both[1])
        return RecordingStates.of_rows(parts, mean, both if halves else None)

    def extended(self, recording, states, margin):
        """Extend the mean period by `margin` samples on either side, for filtering."""
        # With half the filter as margin, the filter is centred on each sample of the
        # period once. Returns a `Recording` of one extended period per recording, and
        # its states.
        rows, parts = self.repeated(margin)
        one = rows[parts[0]]

        def extend(segments):
            return [segment[one] for segment in segments]

        states = RecordingStates(
            own=extend(states.own),
            halves=states.halves and tuple(map(extend, states.halves)),
        )
        groups = np.repeat(np.arange(len(parts)), parts[0].stop)
        mean = take_arrays(
            np.concatenate(states.own),
            self.torque[rows],
            groups,
            self.weight[rows],
            dt=recording.dt,
            joint_names=recording.joint_names,
        )
        return mean, states

    def filtered_torque_noise(self, lowpass):
        """Measure the noise of filtered torques, deviations (nv,) [N m or N]."""
        # nan for a joint whose even and odd periods never both have weight.
        known = np.isfinite(self.torque_noise)
        noise = np.where(known, self.torque_noise, 0.0)
        rows, parts = self.repeated(lowpass.half)
        squares = np.zeros(noise.shape[1])
        for part in parts:
            squares += (_every_sample(lowpass)(noise[rows[part]]) ** 2).sum(axis=0)
        share = known.mean(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(share > 0, np.sqrt(squares / share / len(noise)), np.nan)


def _every_sample(lowpass):
    return type(lowpass)(taps=lowpass.taps, step=1)


def period_samples(period, dt):
    """Return the length of a period [s] in samples of dt [s], validating it."""
    dt = check_dt(dt)
    try:
        value = float(period)
    except (TypeError, ValueError):
        value = np.nan
    if not np.isfinite(value) or value <= 0:
        raise ValueError(
            "period must be the time in seconds after which the motion repeats, "
            f"positive and finite, or None; got {period!r}."
        )
    count = value / dt
    if round(count) < _MIN_PERIOD:
        raise ValueError(
            f"period={value:.6g} s are {count:.6g} samples of dt={dt:.6g} s; expected "
            f"at least {_MIN_PERIOD}."
        )
    return count


def _whole_samples(count, n_periods):
    """Return a period as an int; reject one that slips against the samples."""
    n_period = round(count)
    slip = abs(count - n_period) * (n_periods - 1)
    if slip > _LARGEST_SLIP:
        raise ValueError(
            f"The period must be a whole number of samples; got {count:.6g}, which "
            f"comes to a slip of {slip:.3g} samples over {n_periods} periods. "
            "Interpolate the recording onto a sample period that divides the period."
        )
    return n_period


def average_periods(X, y, n_period, groups=None, sample_weight=None):
    """Average the even and the odd periods of a periodic motion, `PeriodAverages`."""
    # Every recording starts a new period; rows after its last whole period are not
    # used. X (n_samples, n_columns): positions or states; y, sample_weight (n_samples,
    # nv); n_period: whole, up to a slip far below one sample. Less than two periods are
    # refused.
    weight = np.ones(y.shape) if sample_weight is None else np.asarray(sample_weight)
    weight = np.broadcast_to(weight.reshape(len(y), -1), y.shape)
    parts = contiguous_groups(groups, X.shape[0])
    lengths = np.array([part.stop - part.start for part in parts])
    # with a tolerance for a last period that is short by less than the slip
    counts = np.floor(lengths / n_period + _LARGEST_SLIP / n_period).astype(int)
    if counts.min() < 2:
        i = int(np.argmin(counts))
        raise ValueError(
            "At least 2 whole periods are needed to tell the motion from the noise; "
            f"the recording from row {parts[i].start} has {lengths[i]} samples, "
            f"{lengths[i] / n_period:.3g} periods of {n_period:.6g}. Give a longer "
            "recording, or period=None."
        )
    n_period = _whole_samples(n_period, int(counts.max()))
    even, odd, torque, noise, average = [], [], [], [], []
    for part, count in zip(parts, counts):
        x, tau, w = (
            z[part][: count * n_period].reshape(count, n_period, -1)
            for z in (X, y, weight)
        )
        even.append(x[::2].mean(axis=0))
        odd.append(x[1::2].mean(axis=0))
        total = w[::2].sum(axis=0), w[1::2].sum(axis=0)
        means = (
            _weighted(tau[::2], w[::2], total[0]),
            _weighted(tau[1::2], w[1::2], total[1]),
        )
        both = np.where(total[0] + total[1] > 0, total[0] + total[1], 1.0)
        torque.append((total[0] * means[0] + total[1] * means[1]) / both)
        # var(mean of all) / var(difference), for variances that go as 1 / total
        size = np.sqrt(total[0] * total[1]) / both
        noise.append(np.where(size > 0, size * (means[0] - means[1]), np.nan))
        average.append(w.mean(axis=0) * count / counts.mean())
    return PeriodAverages(
        n_period=n_period,
        counts=counts,
        even=np.concatenate(even),
        odd=np.concatenate(odd),
        torque=np.concatenate(torque),
        torque_noise=np.concatenate(noise),
        weight=np.concatenate(average),
        groups=np.repeat(np.arange(counts.size), n_period),
    )


def _weighted(values, weight, total):
    return (weight * values).sum(axis=0) / np.where(total > 0, total, 1.0)


def check_periodic(recording, n_period, counts):
    """Warn of joints whose periods differ by far more than noise can explain."""
    # counts (n_recordings,): whole periods of each recording.
    positions, parts = recording.q, recording.segments
    names, dt = recording.joint_names, recording.dt
    between, within = np.zeros((2, positions.shape[1]))
    for part, count in zip(parts, counts):
        x = positions[part][: count * n_period].reshape(count, n_period, -1)
        mean = x.mean(axis=0)
        between += ((x - mean) ** 2).mean(axis=(0, 1)) * count / (count - 1)
        within += mean.var(axis=0)
    between, within = np.sqrt([between / len(parts), within / len(parts)])
    found = []
    for j in np.flatnonzero(between > _NOISE_SHARE * within):
        segments = [positions[part, j] for part in parts]
        spectrum = _smoothing.acceleration_spectra(segments, dt)
        white = np.sqrt(_smoothing.white_noise_variance(*spectrum))
        if between[j] > _NOISE_RATIO * white:
            found.append(
                f"{names[j]} ({between[j]:.3g} between periods, {within[j]:.3g} "
                f"within, white noise {white:.2g})"
            )
    if found:
        warnings.warn(
            f"The motion of {', '.join(found)} [rad or m, root mean square] does not "
            "repeat to within its noise: what differs between periods would be taken "
            "for noise. Check period, and leave out what precedes the repeated motion.",
            UserWarning,
            stacklevel=5,
        )


def measure_periods(settings, recording, effects):
    """Average the periods of a recording, if the settings declare a period."""
    # Returns `PeriodAverages`, or None without a period.
    if settings.period is None:
        return None
    varying = {"time", "signals"}
    timed = [effect.name for effect in effects if varying & set(effect.needs)]
    if timed:
        raise ValueError(
            f"{', '.join(timed)} change(s) with time, which a mean over periods does "
            "not know; identify with period=None."
        )
    n_period = period_samples(settings.period, recording.dt)
    X = recording.inputs
    periods = average_periods(
        X, recording.tau, n_period, recording.groups, recording.weight
    )
    check_periodic(recording, periods.n_period, periods.counts)
    return periods
