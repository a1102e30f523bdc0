"""Motions that repeat: noise of any colour, measured between periods.

What the even and the odd samples of one recording do not share is white noise only:
noise that changes slowly is the same in both. The even and the odd *periods* of a
repeated motion share the motion and nothing else, as long as the noise forgets itself
within a period.
"""

import warnings
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa._core import _smoothing
from sklearn_vbjfa.recording._recording import check_dt, contiguous_groups, take_arrays
from sklearn_vbjfa.robot._states import RecordingStates

# Shortest period that states can be estimated from.
_MIN_PERIOD = 16
# By how many samples the last period may have slipped against the first: noise of the
# size of a twentieth of the motion within one sample.
_LARGEST_SLIP = 0.05
# Noise between periods may be coloured, that is larger than its white part in the upper
# half of the spectrum; an encoder's is never this many times larger and at the same
# time this share of the motion.
_NOISE_RATIO, _NOISE_SHARE = 10.0, 0.01
# How far the smoother sees: its slowest mode falls by exp(-1.94) in a period of the
# cut-off, which is 2e-7 over these; without smoothing the spline's falls to 0.43 in a
# sample.
_PERIODS_SEEN, _SAMPLES_SEEN = 8.0, 60


@dataclass(frozen=True, kw_only=True)
class PeriodAverages:
    """One period of each recording, measured twice.

    Rows are those of the first recording's period, then of the second's, and so on.

    Attributes
    ----------
    n_period : int
        Samples of a period.
    counts : ndarray of shape (n_recordings,)
        Whole periods of each recording.
    even, odd : ndarray of shape (n_recordings * n_period, n_columns)
        Means over the even and over the odd periods of the positions [rad or m], or
        of states.
    torque : ndarray of shape (n_recordings * n_period, nv)
        Weighted means over all periods [N m or N].
    torque_noise : ndarray of shape (n_recordings * n_period, nv)
        Noise of the size and colour of that of `torque` [N m or N]: the difference of
        even and odd periods, scaled; nan where only one of the two has weight.
    weight : ndarray of shape (n_recordings * n_period, nv)
        Mean weights over the periods; recordings with more periods than others have
        more.
    groups : ndarray of shape (n_recordings * n_period,)
        Number of the recording.
    """

    n_period: int
    counts: np.ndarray
    even: np.ndarray
    odd: np.ndarray
    torque: np.ndarray
    torque_noise: np.ndarray
    weight: np.ndarray
    groups: np.ndarray

    @property
    def mean(self):
        """Mean of `even` and `odd`.

        With an odd number of periods it is not that of all: a quarter of the squared
        difference is then exactly the covariance of its noise.
        """
        return 0.5 * (self.even + self.odd)

    def repeated(self, margin):
        """Return rows, and slices of recordings, of periods that go on at both ends.

        Parameters
        ----------
        margin : int
            Samples by which each period is extended on either side, by itself.

        Returns
        -------
        rows : ndarray of shape (n_recordings * (n_period + 2 * margin),)
            Row numbers of the period's sample at each of the extended ones.
        parts : list of slice
            Recordings among them.
        """
        one = np.arange(-margin, self.n_period + margin) % self.n_period
        first = self.n_period * np.arange(self.counts.size)
        rows = (first[:, None] + one).ravel()
        starts = one.size * np.arange(self.counts.size)
        return rows, [slice(int(a), int(a) + one.size) for a in starts]

    def both_starts(self):
        """Return each recording's period and the same begun half a period later.

        For what is read off a spectrum: its taper fades out the ends of each, and
        the two together weigh all samples alike.

        Returns
        -------
        X : ndarray of shape (2 * n_recordings * n_period, n_columns)
            Rows of `mean`.
        groups : ndarray of shape (2 * n_recordings * n_period,)
            Labels.
        """
        n, p = self.counts.size, self.n_period
        later = np.roll(self.mean.reshape(n, p, -1), p // 2, axis=1)
        X = np.concatenate([self.mean, later.reshape(n * p, -1)])
        return X, np.concatenate([self.groups, n + self.groups])

    def states(self, estimator):
        """Estimate the states of a motion that goes on periodically, twice.

        The smoother of an end sees one side only. Here there is none: each period is
        extended by itself as far as the smoother sees, and the extension is thrown
        away again.

        Parameters
        ----------
        estimator : StateEstimator or None
            Fitted estimator; None if the columns are states.

        Returns
        -------
        even, odd : ndarray of shape (n_recordings * n_period, 3 * nv)
            States [q | v | a].
        """
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
        """Estimate the `RecordingStates` of the mean periods.

        Parameters
        ----------
        estimator : StateEstimator or None
            Fitted estimator; None if the columns are states.
        halves : bool
            Whether those of `even` and `odd` are asked for.
        """
        both = self.states(estimator)
        _, parts = self.repeated(0)
        # smoothing is linear: these are the states of the mean
        mean = 0.5 * (both[0] + both[1])
        return RecordingStates.of_rows(parts, mean, both if halves else None)

    def extended(self, recording, states, margin):
        """Extend the mean period by itself on either side, for what is filtered.

        The filter's outputs then stand on each sample of the period once.

        Parameters
        ----------
        recording : Recording
            What the periods are of.
        states : RecordingStates
            `mean_states`.
        margin : int
            Samples on either side: half the filter.

        Returns
        -------
        recording : Recording
            One extended period of each recording, by its states.
        states : RecordingStates
            The same states, and those of the halves.
        """
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
        """Measure the noise of the filtered torques: standard deviations [N m or N].

        Parameters
        ----------
        lowpass : Lowpass
            Filter of torques and regressors.

        Returns
        -------
        ndarray of shape (nv,)
            nan for a joint whose even and odd periods never both have weight.
        """
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
    """Return the number of samples of a period [s], refusing what is no number.

    Parameters
    ----------
    period : float
        Period of the motion [s].
    dt : float
        Sample period [s].
    """
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
    """Return a period as an int; refuse one that slips against the samples."""
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
    """Average the even and the odd periods of a motion that repeats.

    Every recording begins a period of its own; rows after its last whole period are
    not used.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_columns)
        Positions [rad or m], or states.
    y : ndarray of shape (n_samples, nv)
        Torques [N m or N].
    n_period : float
        Samples of a period; whole, but for a slip that stays far below one sample.
    groups : array-like of shape (n_samples,), default=None
        Labels of separate recordings.
    sample_weight : ndarray of shape (n_samples,) or (n_samples, nv), default=None
        Weights of the torques.

    Returns
    -------
    PeriodAverages
        Two independent measurements of one period of each recording.

    Raises
    ------
    ValueError
        If a recording holds less than two whole periods, or the period is not a whole
        number of samples.
    """
    weight = np.ones(y.shape) if sample_weight is None else np.asarray(sample_weight)
    weight = np.broadcast_to(weight.reshape(len(y), -1), y.shape)
    parts = contiguous_groups(groups, X.shape[0])
    lengths = np.array([part.stop - part.start for part in parts])
    # rounded up by what the last sample lacks of a period that is not quite whole
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
    """Warn of joints whose periods differ by far more than noise can explain.

    Parameters
    ----------
    recording : Recording
        Positions.
    n_period : int
        Samples of a period.
    counts : ndarray of shape (n_recordings,)
        Whole periods of each recording.
    """
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
            stacklevel=3,
        )


def measure_periods(settings, recording, effects):
    """Average the periods of a recording as an identifier asks for it.

    Parameters
    ----------
    settings : RobotIdentifier
        Its `period`.
    recording : Recording
        What is fitted.
    effects : tuple of Effect
        Effects beside the bodies.

    Returns
    -------
    PeriodAverages or None
        None without a period.
    """
    if settings.period is None:
        return None
    timed = [effect.name for effect in effects if "time" in effect.needs]
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
