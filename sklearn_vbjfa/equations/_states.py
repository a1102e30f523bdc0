"""From joint positions to states: smoothed positions, velocities, accelerations."""

from dataclasses import dataclass

import numpy as np
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_vbjfa._core import _smoothing
from sklearn_vbjfa.recording import check_cutoff, check_dt, contiguous_groups

# Shortest recording that the spline can be fitted to.
_MIN_SAMPLES = 8
# Fewest samples for estimates of noise and bandwidth from spectra.
SAMPLES_FOR_NOISE = 2 * _MIN_SAMPLES
# Factor on the cut-off of least acceleration error: the bias from smoothing the motion
# does not decrease with the length of the recording, whereas noise is corrected for.
_LIGHTER_SMOOTHING = 1.25
# Number of frequencies in sums of the smoother's noise gain.
_NOISE_GRID = 2048


class StateEstimator(TransformerMixin, BaseEstimator):
    """Velocities and accelerations from joint positions, with zero phase lag.

    Each joint's positions are smoothed by a quintic spline with a penalty on the fifth
    derivative and differentiated analytically. Inside the recording this is a symmetric
    low-pass, 1 / (1 + (f / cutoff)^10); at the ends the motion is extrapolated by its
    own polynomial.

    Parameters
    ----------
    dt : float
        Sample period [s].
    cutoff : "auto", float, array-like of shape (nv,) or None, default="auto"
        Cut-off frequency [Hz], half amplitude, for all joints or each. ``"auto"``
        minimises, for each joint, the estimated squared error of the
        acceleration: the noise is measured in the upper half of the spectrum and
        the risk is Mallows' C_p. ``None`` interpolates without smoothing.

    Attributes
    ----------
    cutoff_ : ndarray of shape (nv,)
        Cut-off frequencies [Hz]; infinity where nothing is smoothed.
    noise_variance_ : ndarray of shape (nv,)
        Variance of the white noise in the positions [rad^2 or m^2], measured from the
        upper half of the spectrum of the second differences; nan if the recording is
        too short.
    rest_variance_ : ndarray of shape (nv,)
        The same in the quietest tenth of the recording, where vibration of a moving
        joint is not counted as noise.
    bandwidth_ : ndarray of shape (nv,)
        Frequency [Hz] below which 99 % of the power of the velocity lies; 0 for a
        joint that does not move.
    n_features_in_ : int
        Number of joints nv.

    See Also
    --------
    RigidBodyFeatures : Regressor matrices from states.

    Notes
    -----
    The accelerations of the outermost samples (about half a period of the cut-off)
    rely on one side only and are much less accurate. `RobotIdentifier` does not use
    them.

    References
    ----------
    .. [1] P. H. C. Eilers, B. D. Marx, "Flexible smoothing with B-splines and
       penalties", Statistical Science 11(2), 1996. :doi:`10.1214/ss/1038425655`

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa import StateEstimator
    >>> t = np.arange(0, 10, 0.01)
    >>> q = np.sin(t)[:, None]
    >>> states = StateEstimator(dt=0.01).fit_transform(q)
    >>> bool(np.allclose(states[100:-100, 1], np.cos(t[100:-100]), atol=1e-6))
    True
    """

    # Never differentiate across the border of two recordings, in any fold: metadata
    # routing passes the labels on request.
    __metadata_request__fit = {"groups": True}  # noqa: RUF012
    __metadata_request__transform = {"groups": True}  # noqa: RUF012

    def __init__(self, dt, cutoff="auto"):
        self.dt = dt
        self.cutoff = cutoff

    def fit(self, X, y=None, groups=None):
        """Choose the cut-offs.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv)
            Joint positions [rad or m], equidistant in time.
        y : None
            Ignored.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.

        Returns
        -------
        self : object
            Fitted transformer.
        """
        X = validate_data(self, X, dtype=np.float64)
        dt, self.n_features_in_ = check_dt(self.dt), X.shape[1]
        parts = contiguous_groups(groups, X.shape[0])
        longest = max(part.stop - part.start for part in parts)
        moving, spectra = None, None
        if longest >= SAMPLES_FOR_NOISE:
            segments = [X[part] for part in parts]
            moving = np.any([np.ptp(x, axis=0) > 0 for x in segments], axis=0)
            spectra = _smoothing.acceleration_spectra(segments, dt)
        return self._choose(longest, moving, spectra)

    def _choose(self, longest, moving, spectra):
        # moving (nv,): joints that move; spectra: `acceleration_spectra` of all joints,
        # None if all recordings are too short.
        dt, nv = check_dt(self.dt), self.n_features_in_
        self.noise_variance_ = self.rest_variance_ = np.full(nv, np.nan)
        self.bandwidth_ = np.zeros(nv)
        auto = isinstance(self.cutoff, str)
        if auto and self.cutoff != "auto":
            raise ValueError(
                f"cutoff must be 'auto', a frequency in Hz, or None; got "
                f"{self.cutoff!r}."
            )
        cutoffs = np.full(nv, np.inf)
        if spectra is not None:
            cutoffs = self._analyse(moving, spectra, dt)
        elif auto:
            raise ValueError(
                f"cutoff='auto' needs a recording of at least {SAMPLES_FOR_NOISE} "
                f"samples; the longest has {longest} (1 sample or a few are not "
                "enough). Give cutoff in Hz."
            )
        if not auto:
            requested = np.asarray(self.cutoff, dtype=object)
            if requested.shape not in {(), (nv,)}:
                raise ValueError(
                    f"cutoff must be one frequency or one for each of the {nv} joints; "
                    f"got an array of shape {requested.shape}."
                )
            requested = np.broadcast_to(requested, (nv,))
            cutoffs = np.array([check_cutoff(c, dt) for c in requested])
        self.cutoff_ = cutoffs
        return self

    def _analyse(self, moving, spectra, dt):
        frequency, power, noise_gain, errors = spectra
        nv = moving.size
        self.noise_variance_, self.rest_variance_, self.bandwidth_ = np.zeros((3, nv))
        cutoff = np.full(nv, np.inf)
        if not moving.any():
            return cutoff
        cutoff[moving], self.noise_variance_[moving] = _smoothing.choose_cutoff(
            frequency, power[:, moving], noise_gain, errors[:, moving], dt
        )
        self.rest_variance_ = np.minimum(self.noise_variance_, errors[1])
        for j in np.flatnonzero(moving):
            self.bandwidth_[j] = _smoothing.velocity_bandwidth(
                frequency, power[:, j], noise_gain, self.noise_variance_[j], cutoff[j]
            )
        return cutoff

    def transform(self, X, groups=None):
        """Estimate the states.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv)
            Joint positions [rad or m], equidistant in time.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings; nothing is smoothed across boundaries.

        Returns
        -------
        ndarray of shape (n_samples, 3 * nv)
            States [q | v | a].
        """
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        states = np.empty((len(X), 3 * X.shape[1]))
        for part in contiguous_groups(groups, len(X)):
            states[part] = self.smooth(X[part], part.start)[:]
        return states

    def noise(self, order, at_rest=False):
        """Estimate the std (nv,) of the noise of a derivative; zero if unknown."""
        # White encoder noise through the smoother.
        frequency = np.linspace(0.0, 0.5 / self.dt, _NOISE_GRID)
        noise = np.zeros(self.n_features_in_)
        variances = self.rest_variance_ if at_rest else self.noise_variance_
        for j, (cutoff, variance) in enumerate(zip(self.cutoff_, variances)):
            if variance > 0:
                gain = 1.0
                if np.isfinite(cutoff):
                    gain = _smoothing.gain(frequency, self.dt, cutoff)
                power = np.mean(((2 * np.pi * frequency) ** order * gain) ** 2)
                noise[j] = np.sqrt(variance * power)
        return noise

    def rounding(self):
        """Compute the mean absolute time (nv,) over which the smoother averages [s]."""
        # Times half an acceleration jump, it is the velocity error at the jump.
        return np.array([_smoothing.rounding(cutoff) for cutoff in self.cutoff_])

    def smooth(self, x, start):
        """Return `SplineStates` of the positions (n, nv) of a segment."""
        if x.shape[0] < _MIN_SAMPLES:
            raise ValueError(
                f"A recording must have at least {_MIN_SAMPLES} samples to be "
                f"differentiated; the one at row {start} has {x.shape[0]}. "
                "Leave it out, or check groups."
            )
        columns = zip(np.ascontiguousarray(x.T), self.cutoff_)
        return SplineStates([_smoothing.fit(q, self.dt, c) for q, c in columns], len(x))

    def smooth_halves(self, x, start):
        """Return `SplineStates` of the even and of the odd samples, a pair."""
        # Their encoder noise is independent (white noise assumed), and their motion the
        # same: their regressors differ by noise alone.
        if x.shape[0] < 2 * _MIN_SAMPLES:
            raise ValueError(
                f"A recording must have at least {2 * _MIN_SAMPLES} samples to be "
                f"split; the one at row {start} has {x.shape[0]}."
            )
        highest = 1.0 / (6 * self.dt)
        lower = np.where(
            np.isfinite(self.cutoff_), np.minimum(self.cutoff_, highest), np.inf
        )
        columns = (zip(np.ascontiguousarray(x[k::2].T), lower) for k in range(2))
        dt = 2 * self.dt
        halves = [
            [_smoothing.fit(q, dt, c, every=2, shift=k) for q, c in half]
            for k, half in enumerate(columns)
        ]
        return tuple(SplineStates(half, len(x)) for half in halves)

    def fit_transform(self, X, y=None, groups=None):
        """Choose the cut-offs and estimate the states.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv)
            Joint positions [rad or m], equidistant in time.
        y : None
            Ignored.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.

        Returns
        -------
        ndarray of shape (n_samples, 3 * nv)
            States [q | v | a].
        """
        return self.fit(X, y, groups=groups).transform(X, groups=groups)

    def get_feature_names_out(self, input_features=None):
        """Names q_1 ... v_1 ... a_1 ..., or q_NAME ... of the inputs' names.

        Parameters
        ----------
        input_features : array-like of str, default=None
            Names of the joints.

        Returns
        -------
        ndarray of shape (3 * nv,) of object
            Names.
        """
        check_is_fitted(self)
        fitted = getattr(self, "feature_names_in_", None)
        names = fitted if input_features is None else input_features
        names = range(self.n_features_in_) if names is None else names
        if len(names) != self.n_features_in_:
            raise ValueError(
                "input_features should have length equal to number of features "
                f"({self.n_features_in_}), got {len(names)}."
            )
        if fitted is not None and list(names) != list(fitted):
            raise ValueError(
                f"input_features is not equal to feature_names_in_, {list(fitted)}."
            )
        return np.array(
            [f"{kind}_{name}" for kind in "qva" for name in names], dtype=object
        )


class SplineStates:
    """States of one recording, evaluated on demand from one spline per joint."""

    # Indexed by a slice of rows like an array of states, but stores coefficients only.

    def __init__(self, splines, n):
        self._splines = splines
        self.shape = n, 3 * len(splines)

    def __getitem__(self, rows):
        """States [q | v | a] of a slice of rows, (n, 3 * nv)."""
        start, stop, step = rows.indices(self.shape[0])
        # The samples of a signal are contiguous, as they are evaluated and read.
        columns = np.empty((3, len(self._splines), stop - start))
        for order, signals in enumerate(columns):
            self._evaluate(start, stop, order, signals)
        return columns.reshape(self.shape[1], -1).T[::step]

    def derivative(self, rows, order):
        """Positions, velocities or accelerations of a slice of rows, (n, nv)."""
        start, stop, _ = rows.indices(self.shape[0])
        signals = np.empty((len(self._splines), stop - start))
        self._evaluate(start, stop, order, signals)
        return signals.T

    def _evaluate(self, start, stop, order, out):
        """Write the derivatives of one order for a range of rows to `out`, (nv, n)."""
        for signal, spline in zip(out, self._splines):
            spline(start, stop, order, out=signal)


@dataclass(frozen=True, kw_only=True)
class RecordingStates:
    """States of a recording's segments, from all samples and from half of them."""

    full: list  # (n, 3 * nv) for each segment
    # states from the even and from the odd samples, whose noise is independent
    halves: tuple | None = None

    @classmethod
    def of_rows(cls, segments, states):
        """Divide states (n, 3 * nv) of all rows among the segments."""
        return cls(full=[states[part] for part in segments])

    @classmethod
    def of(cls, recording, estimator):
        """Smooth the positions of a recording, or use its states without estimator."""
        if estimator is None:
            return cls.of_rows(recording.segments, recording.inputs)
        parts = recording.segments
        return cls(full=[estimator.smooth(recording.q[x], x.start) for x in parts])


def fit_states(dt, cutoff, X, groups):
    """Fit a state estimator for identification, with slightly raised cut-offs."""
    return raise_cutoffs(StateEstimator(dt, cutoff=cutoff).fit(X, groups=groups))


def choose_states(dt, cutoff, longest, moving, spectra):
    """Return the estimator of `fit_states` from `acceleration_spectra`."""
    # longest: rows of the longest recording; moving (nv,): joints that move; spectra:
    # of all recordings, None if all are too short.
    estimator = StateEstimator(dt, cutoff=cutoff)
    estimator.n_features_in_ = moving.size
    return raise_cutoffs(estimator._choose(longest, moving, spectra))


def raise_cutoffs(estimator):
    """Slightly raise automatic cut-offs of a fitted state estimator."""
    if not isinstance(estimator.cutoff, str):
        return estimator
    raised = np.minimum(_LIGHTER_SMOOTHING * estimator.cutoff_, 1 / (3 * estimator.dt))
    finite = np.isfinite(estimator.cutoff_)
    return _with_cutoffs(estimator, np.where(finite, raised, np.inf))


def _with_cutoffs(estimator, cutoffs):
    finite = [c if np.isfinite(c) else None for c in cutoffs]
    changed = StateEstimator(estimator.dt, cutoff=finite)
    fitted = {k: v for k, v in vars(estimator).items() if k.endswith("_")}
    vars(changed).update(fitted, cutoff_=cutoffs)
    return changed


def select_joints(estimator, joints):
    selected = _with_cutoffs(estimator, estimator.cutoff_[joints])
    selected.n_features_in_ = selected.cutoff_.size
    selected.noise_variance_ = estimator.noise_variance_[joints]
    selected.rest_variance_ = estimator.rest_variance_[joints]
    return selected


def limit_cutoffs(estimator, cutoff):
    """Copy a fitted state estimator, with its cut-offs limited to a band [Hz]."""
    return _with_cutoffs(estimator, np.minimum(estimator.cutoff_, cutoff))
