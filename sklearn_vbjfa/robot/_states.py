"""From joint positions to states: smoothed positions, velocities, accelerations."""

import numpy as np
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_vbjfa._core import _smoothing
from sklearn_vbjfa.robot._groups import check_cutoff, check_dt, contiguous_groups

# Shortest recording that the spline can be fitted to.
_MIN_SAMPLES = 8
# The state cut-off of least acceleration error, times this: what smoothing takes from
# the motion biases the parameters however long the recording, while noise averages
# out and is corrected for.
_LIGHTER_SMOOTHING = 1.25


class StateEstimator(TransformerMixin, BaseEstimator):
    """Velocities and accelerations from joint positions, without phase.

    Each joint's positions are smoothed by a quintic spline with a penalty on the fifth
    derivative, whose derivatives are exact. Inside the recording this is a symmetric
    low-pass, 1 / (1 + (f / cutoff)^10); at the ends the motion goes on by its own
    polynomial.

    Parameters
    ----------
    dt : float
        Sample period [s].
    cutoff : "auto", float, array-like of shape (nv,) or None, default="auto"
        Cut-off frequency [Hz], half amplitude, for all joints or each. ``"auto"``
        chooses for each joint the one that minimises the estimated squared error of
        the acceleration: the noise is measured in the upper half of the spectrum and
        the risk is Mallows' C_p. ``None`` interpolates without smoothing.

    Attributes
    ----------
    cutoff_ : ndarray of shape (nv,)
        Cut-off frequencies [Hz]; infinity where nothing is smoothed.
    noise_variance_ : ndarray of shape (nv,)
        Variance of the white noise in the positions [rad^2 or m^2], measured from the
        upper half of the spectrum of the second differences; nan for a recording too
        short to tell.
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
    rest on one side only and are much less certain. `RobotIdentifier` does not use
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
        dt = check_dt(self.dt)
        X = validate_data(self, X, dtype=np.float64)
        parts = contiguous_groups(groups, X.shape[0])
        nv = X.shape[1]
        self.noise_variance_ = np.full(nv, np.nan)
        self.bandwidth_ = np.zeros(nv)
        auto = isinstance(self.cutoff, str)
        if auto and self.cutoff != "auto":
            raise ValueError(
                f"cutoff must be 'auto', a frequency in Hz, or None; got "
                f"{self.cutoff!r}."
            )
        chosen = np.full(nv, np.inf)
        if max(part.stop - part.start for part in parts) >= 2 * _MIN_SAMPLES:
            for j in range(nv):
                segments = [X[part, j] for part in parts]
                chosen[j] = self._analyse(j, segments, dt)
        elif auto:
            raise ValueError(
                f"cutoff='auto' needs a recording of at least {2 * _MIN_SAMPLES} "
                "samples; the longest has "
                f"{max(part.stop - part.start for part in parts)} "
                "(1 sample or a few are not enough). Give cutoff in Hz."
            )
        if not auto:
            given = np.asarray(self.cutoff, dtype=object)
            if given.shape not in {(), (nv,)}:
                raise ValueError(
                    f"cutoff must be one frequency or one for each of the {nv} joints; "
                    f"got an array of shape {given.shape}."
                )
            given = np.broadcast_to(given, (nv,))
            chosen = np.array([check_cutoff(c, dt, "cutoff") for c in given])
        self.cutoff_ = chosen
        return self

    def _analyse(self, j, segments, dt):
        """Noise, bandwidth and best cut-off of one joint."""
        spread = max(np.ptp(x) for x in segments)
        if spread == 0:
            self.noise_variance_[j] = 0.0
            return np.inf
        frequency, power, noise_gain = _smoothing.acceleration_spectra(segments, dt)
        cutoff, variance = _smoothing.choose_cutoff(frequency, power, noise_gain, dt)
        self.noise_variance_[j] = variance
        self.bandwidth_[j] = _smoothing.velocity_bandwidth(
            frequency, power, noise_gain, variance, cutoff
        )
        return cutoff

    def transform(self, X, groups=None):
        """Estimate the states.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv)
            Joint positions [rad or m], equidistant in time.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings; nothing is smoothed across their borders.

        Returns
        -------
        ndarray of shape (n_samples, 3 * nv)
            States [q | v | a].
        """
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        n, nv = X.shape
        states = np.empty((n, 3, nv))
        for part in contiguous_groups(groups, n):
            length = part.stop - part.start
            if length < _MIN_SAMPLES:
                raise ValueError(
                    f"A recording must have at least {_MIN_SAMPLES} samples to be "
                    f"differentiated; the one at row {part.start} has {length}. "
                    "Leave it out, or check groups."
                )
            for j in range(nv):
                states[part, :, j] = _smoothing.smooth(
                    X[part, j], self.dt, self.cutoff_[j]
                ).T
        return states.reshape(n, 3 * nv)

    def split_transform(self, X, groups=None):
        """Estimate the states twice, from the even and from the odd samples.

        The encoder noise of the two is independent (white noise assumed) while the
        motion is the same: what their regressors do not share is noise.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv)
            Joint positions [rad or m].
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.

        Returns
        -------
        even, odd : ndarray of shape (n_samples, 3 * nv)
            States at the times of all samples.
        """
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        n, nv = X.shape
        halves = np.empty((2, n, 3, nv))
        highest = 1.0 / (6 * self.dt)
        for part in contiguous_groups(groups, n):
            length = part.stop - part.start
            if length < 2 * _MIN_SAMPLES:
                raise ValueError(
                    f"A recording must have at least {2 * _MIN_SAMPLES} samples to be "
                    f"split; the one at row {part.start} has {length}."
                )
            times = np.arange(length) * self.dt
            for k in range(2):
                samples = X[part][k::2]
                for j in range(nv):
                    cutoff = self.cutoff_[j]
                    halves[k, part, :, j] = _smoothing.smooth(
                        samples[:, j],
                        2 * self.dt,
                        min(cutoff, highest) if np.isfinite(cutoff) else cutoff,
                        at=times - k * self.dt,
                    ).T
        return halves[0].reshape(n, -1), halves[1].reshape(n, -1)

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
        if input_features is None:
            input_features = getattr(
                self, "feature_names_in_", [str(j) for j in range(self.n_features_in_)]
            )
        return np.array(
            [f"{kind}_{name}" for kind in "qva" for name in input_features],
            dtype=object,
        )


def fit_states(dt, cutoff, X, groups):
    """Fit a state estimator for identification; its own choice is raised a little."""
    estimator = StateEstimator(dt, cutoff=cutoff).fit(X, groups=groups)
    if not isinstance(cutoff, str):
        return estimator
    lighter = np.minimum(_LIGHTER_SMOOTHING * estimator.cutoff_, 1 / (3 * dt))
    chosen = [
        lower if np.isfinite(own) else None
        for lower, own in zip(lighter, estimator.cutoff_)
    ]
    return StateEstimator(dt, cutoff=chosen).fit(X, groups=groups)


def smooth_to(estimator, cutoff, X, groups):
    """Fit a copy of a state estimator that passes no more than a band [Hz]."""
    cutoffs = np.minimum(estimator.cutoff_, cutoff)
    chosen = [c if np.isfinite(c) else None for c in cutoffs]
    return StateEstimator(estimator.dt, cutoff=chosen).fit(X, groups=groups)
