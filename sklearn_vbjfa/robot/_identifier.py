"""From positions and torques to a physically consistent rigid-body model."""

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_array, check_is_fitted, validate_data

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.robot import _friction, _identification, _online
from sklearn_vbjfa.robot._effect_columns import fit_passes, needs_load
from sklearn_vbjfa.robot._groups import check_cutoff, check_dt, contiguous_groups
from sklearn_vbjfa.robot._identification import IdentificationSteps
from sklearn_vbjfa.robot._joint_columns import positions_in_order, torques_in_order
from sklearn_vbjfa.robot._joint_torque import JointTorqueRegressor
from sklearn_vbjfa.robot._motion_facts import fastest_period
from sklearn_vbjfa.robot._periods import measure_periods
from sklearn_vbjfa.robot._recording_checks import (
    check_channels,
    check_input_noise,
    check_length,
    check_speed,
    check_time_stamps,
    check_widths,
    resolve_clock,
    resolve_cutoff,
    resolve_standstill,
    warn_of_disorder,
)
from sklearn_vbjfa.robot._recording_score import RecordingRegressorMixin
from sklearn_vbjfa.robot._torque_noise import given_noise, rows_looked_at
from sklearn_vbjfa.robot._urdf import write_identified


class RobotIdentifier(IdentificationSteps, RecordingRegressorMixin, BaseEstimator):
    """Identify a robot: joint positions and torques in, rigid-body model out.

    The whole chain: states from positions, regressor matrices, parallel low-pass of
    regressors and torques, standstill masked, weighted estimation of one parameter
    vector, projection on physically consistent ones.

    Parameters
    ----------
    model : str, os.PathLike or pinocchio.Model
        Path of a URDF file, or a model; a tree of one-degree-of-freedom joints. Its
        inertias serve to complete what the data cannot tell, see `theta_`.
    dt : float, default=None
        Sample period [s]; needed unless states are given and nothing is filtered.
    friction : tuple of {"viscous", "coulomb", "offset", "rotor_inertia"}, \
            default=("viscous",)
        Further columns of each joint.
    effects : tuple of Effect, default=()
        Effects beside the rigid bodies and their friction, each on one joint; see
        `sklearn_vbjfa.effects`. `EffectDiscovery` finds out which.
    regressor : estimator, default=None
        Linear regressor, see `JointTorqueRegressor`; None is
        ``VBJFARegressor(latent="correlated", input_noise=0.0)``.
    projector : "default", PhysicalProjector or None, default="default"
        Projection of the parameters; None leaves them as estimated.
    cutoff : "auto", float or None, default="auto"
        Cut-off [Hz] of the low-pass that regressors and torques pass. ``"auto"``:
        five times the bandwidth of the motion (the frequency below which 99 % of the
        power of the velocity lies, the fastest joint), as in Gautier's practice;
        without positions (states given) nothing is filtered. None filters nothing.
    state_cutoff : "auto", float, array-like of shape (nv,) or None, default="auto"
        Cut-off [Hz] of `StateEstimator`. ``"auto"``: 1.25 times the one of least
        acceleration error; smoothing bias does not average out, noise does.
    standstill : "auto", float, array-like of shape (nv,) or None, default="auto"
        Speed [rad/s or m/s] at or below which a joint's equations are left out.
        ``"auto"``: 2 % of the 99.5th percentile of its speed in the recordings of the
        fit. None masks nothing.
    joint_weights : "auto", None or array-like of shape (nv,), default="auto"
        Weights of the joints' equations, see `JointTorqueRegressor`.
    block_noise : bool, default=False
        Whether stretches of time in which the model fails count less, see
        `JointTorqueRegressor`.
    input_noise : "auto" or None, default="auto"
        ``"auto"``: where positions are given, the noise of the regressors is measured
        by making them from the even and from the odd samples separately, whose white
        encoder noise is independent, and a regressor that takes a noise covariance
        (the default one) corrects for it. None takes the regressors as exact.
    period : float, default=None
        Time [s] after which the motion repeats, from the first row of every recording
        on: a whole number of samples, twice or more. The even and the odd periods are
        then averaged separately. They share no noise of any colour, where even and odd
        samples share all that is not white, and the fit is to the mean period.
    torque_noise : float or array-like of shape (nv,), default=None
        Standard deviation of the white noise of one torque sample [N m or N], for
        `noise_floor_`. None measures it in the torques of the fit, above the band of
        the low-pass; where rows were interpolated, which takes noise away, give the
        `torque_noise` of the recording. With `period` it is always measured.

    Attributes
    ----------
    theta_ : ndarray of shape (p,)
        Parameters, physically consistent if projected, the effects' coefficients
        last. Directions that the data do not determine are completed from the model's
        inertias, scaled to the data.
    theta_unconstrained_ : ndarray of shape (p,)
        Parameters before the projection.
    theta_std_ : ndarray of shape (p,)
        Posterior standard deviations of `theta_unconstrained_`: 1.645 of them to both
        sides are 90 % intervals. Residuals may be correlated in time, as what a model
        lacks is: the deviations for independent ones are multiplied by the scatter
        between forty blocks of time over the one to expect (see Notes). For
        independent rows after `partial_fit`; nan where the regressor does not tell.
        The projection moves `theta_` inside of what is physically possible, and what
        the data leave open to the model's values; this has no deviation of its own.
    effects_ : tuple of Effect
        Effects in use.
    parameter_names_, parameter_units_ : tuple of str
        Names ("joint_1:m") and units of the parameters.
    identifiable_ : ndarray of shape (p,), bool
        Parameters that the data determine on their own, not only in combinations.
    joint_names_ : tuple of str
        Joints in Pinocchio's order, the order of the columns of X and y.
    min_eigenvalues_ : ndarray of shape (nv,)
        Smallest eigenvalue of each body's pseudo-inertia matrix in units of the
        body's mass and length scale; positive for a physically consistent body.
    noise_floor_ : ndarray of shape (nv,)
        Standard deviation of `residuals` to expect from noise alone, if the model
        lacked nothing [N m or N]: input noise through the parameters, and the noise
        of the torque sensors in the band of the fit. With `period` that of the mean
        period, smaller than that of a recording. nan where the latter is not known.
    torque_noise_ : ndarray of shape (nv,)
        The torque sensors' part of it [N m or N], white or coloured: the spectrum of
        the residual above the band of the fit, continued into it. nan where that
        cannot be told: nothing lies above the band, no smooth spectrum of noise is like
        what does, or it goes on rising towards the band and the residual between the
        motion's band and the cut-off is not its continuation. With `period` measured
        between periods, in the band.
    input_noise_torque_ : ndarray of shape (nv,)
        The input noise's part of it [N m or N].
    output_noise_ : ndarray of shape (nv,)
        Standard deviation of what input noise does not explain of the residual of the
        fit [N m or N]; above `torque_noise_` by what the model lacks.
    cutoff_ : float
        Cut-off of the low-pass in use [Hz]; infinity without.
    standstill_ : ndarray of shape (nv,)
        Speeds at or below which samples are left out.
    state_estimator_ : StateEstimator or None
        None if the fit got states.
    features_ : RigidBodyFeatures
        Features.
    estimator_ : JointTorqueRegressor
        Estimation of the parameters.
    n_features_in_ : int
        nv or 3 nv.

    Notes
    -----
    The feature matrix is made and reduced to second moments piece by piece and never
    held as a whole (unless `regressor` needs the equations themselves).

    `theta_std_` compares forty blocks of time, of all recordings together, with what
    white residuals would make of them after the fit (a sandwich estimate by blocks,
    unbiased for white residuals, with Student's t for the number of blocks). Blocks are
    joined until neighbours are hardly correlated, as long as sixteen are left: of
    residuals that stay correlated for a tenth of the recordings or longer it still
    tells too little.

    Examples
    --------
    >>> from sklearn_vbjfa import RobotIdentifier
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> recording = load_demo_recording()
    >>> robot = RobotIdentifier(recording.robot_model(), dt=recording.dt)
    >>> robot = robot.fit(recording.q, recording.tau, groups=recording.groups)
    >>> bool((robot.min_eigenvalues_ > 0).all())
    True
    """

    def __init__(
        self,
        model,
        *,
        dt=None,
        friction=("viscous",),
        effects=(),
        regressor=None,
        projector="default",
        cutoff="auto",
        state_cutoff="auto",
        standstill="auto",
        joint_weights="auto",
        block_noise=False,
        input_noise="auto",
        period=None,
        torque_noise=None,
        n_jobs=None,
        forgetting=1.0,
    ):
        self.model = model
        self.dt = dt
        self.friction = friction
        self.effects = effects
        self.regressor = regressor
        self.projector = projector
        self.cutoff = cutoff
        self.state_cutoff = state_cutoff
        self.standstill = standstill
        self.joint_weights = joint_weights
        self.block_noise = block_noise
        self.input_noise = input_noise
        self.period = period
        self.torque_noise = torque_noise
        self.n_jobs = n_jobs
        self.forgetting = forgetting

    def fit(self, X, y, groups=None, sample_weight=None, t=None):
        """Identify the robot.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions [rad or m], rows equidistant in time; or states
            [q | v | a]. The columns of a data frame may be in any order: they are
            found by name, ``q_<joint>``, ``<joint>`` or ``q1, q2, ...`` (``v``, ``a``
            for states), here and in `predict`.
        y : array-like of shape (n_samples, nv)
            Joint torques [N m] or forces [N]; of a data frame by name, too,
            ``tau_<joint>``, ``<joint>`` or ``tau1, tau2, ...``.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings; nothing is differentiated or filtered
            across their borders.
        sample_weight : array-like of shape (n_samples,) or (n_samples, nv), \
                default=None
            Weights; zero leaves a sample (of one joint) out.
        t : array-like of shape (n_samples,), default=None
            Time stamps [s], which must agree with `dt` within a recording and may
            restart with each; but rise over all for effects that change with time.
            None counts `dt` from the first row.

        Returns
        -------
        self : object
            Fitted estimator.
        """
        self._online = None
        self._load_robot()
        X, y = self._validate(X, y)
        check_input_noise(self.input_noise)
        parts = contiguous_groups(groups, X.shape[0])
        warn_of_disorder(self.joint_names_, X[:, : self._nv], parts, groups)
        check_time_stamps(t, self.dt, parts)
        clock = resolve_clock(t, self.dt, parts, self.effects_)
        weight = JointTorqueRegressor._check_weight(sample_weight, y.shape)
        periods = measure_periods(self, X, y, groups, weight)
        states, halves, facts = self._fit_states(X, groups, parts, periods)
        if self.state_estimator_ is not None:
            travel = facts.highest - facts.lowest
            check_speed(self.dt, facts.fast(), travel, self.features_._model)
        check_channels(self.joint_names_, np.stack([facts.lowest, facts.highest]), y)
        self.cutoff_ = resolve_cutoff(
            self.cutoff, parts, self.dt, self.state_estimator_
        )
        self.standstill_ = resolve_standstill(self.standstill, facts.fast())
        if not isinstance(states, list):
            self._fastest_period = fastest_period(states)
        lowpass = _lowpass.design(self.dt or 1.0, self.cutoff_)
        if periods is None:
            check_length(parts, lowpass, self.cutoff_)
            self.torque_noise_ = given_noise(
                self.torque_noise, self._nv, self.dt, self.cutoff_
            )
            recordings = states, y, weight, parts, halves, clock
        else:
            self.torque_noise_ = periods.filtered_torque_noise(lowpass)
            recordings = periods.equations(states, lowpass, halves)
        for effects in fit_passes(self.effects_):
            if needs_load(effects):
                self._load_theta = self.theta_[: self.features_.n_parameters_]
            self._active_effects = effects
            stretches = self._stretches(*recordings, ends=periods is None)
            self._fit_stretches(stretches, lowpass)
        if periods is None and self.torque_noise is None:
            facts = (
                self._noise_facts(
                    X[rows], y[rows], None if clock is None else clock[rows]
                )
                for rows in map(rows_looked_at, parts)
            )
            self._tell_noise(facts)
        return self

    def partial_fit(self, X, y, sample_weight=None, *, refit=True):
        """Take in rows of a robot that is running, forgetting older ones.

        A row counts ``forgetting ** age``, with the age in rows. Nothing is filtered
        in time: give states that the robot measures or estimates itself, and torques
        of the same delay. The first call after a `fit` begins anew and takes over
        only `standstill_`: unfiltered rows and the filtered ones of a fit do not have
        the same noise.

        Parameters
        ----------
        X : array-like of shape (n_samples, 3 * nv) or (3 * nv,)
            Further rows of states [q | v | a], in the order of time.
        y : array-like of shape (n_samples, nv) or (nv,)
            Their torques [N m] or forces [N].
        sample_weight : array-like of shape (n_samples,) or (n_samples, nv), \
                default=None
            Weights besides those of age; zero leaves a row (of one joint) out.
        refit : bool, default=True
            Whether to estimate the parameters anew. False only accumulates, fast
            enough for every cycle of a control loop; see ``docs/large_data.rst`` for
            what either costs.

        Returns
        -------
        self : object
            The estimator, fitted if `refit`.

        Raises
        ------
        ValueError
            If X holds no states, settings need more than second moments (effects,
            `period`, `block_noise`, other regressors), `standstill` is ``"auto"`` and
            nothing was fitted before, or a refit is asked for with fewer equations
            than parameters.
        """
        if getattr(self, "_online", None) is None:
            self._online = _online.begin(self)
            self.n_features_in_ = 3 * self._nv
        self._online.forgetting = float(self.forgetting)
        X = positions_in_order(X, self.joint_names_)
        y = torques_in_order(y, self.joint_names_)
        self._online.add(*_online.check_rows(self, X, y, sample_weight))
        return self._fit_statistics(self._online.statistics()) if refit else self

    def _validate(self, X, y):
        X, y = validate_data(
            self,
            positions_in_order(X, self.joint_names_),
            torques_in_order(y, self.joint_names_),
            dtype=np.float64,
            multi_output=True,
            y_numeric=True,
        )
        y = np.asarray(y, dtype=float).reshape(X.shape[0], -1)
        check_widths(self.joint_names_, X, y)
        return X, y

    def predict(self, X, groups=None, t=None):
        r"""Predict the joint torques.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions, which are smoothed up to the cut-off of the fit (above
            it nothing was identified); or states [q | v | a], which count as
            noiseless and are taken as they are.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.
        t : array-like of shape (n_samples,), default=None
            Time [s] on the clock of the fit, for effects that change with it.

        Returns
        -------
        ndarray of shape (n_samples, nv)
            Joint torques [N m] or forces [N], friction included.

        Notes
        -----
        A joint that stands may have any dry friction within its band, and the sign of
        its estimated velocity is that of noise. All effects of the sign of a velocity
        are predicted with its mean over what the true one may be,

        .. math::

            s(v, a) = E[\mathrm{sign}(v + u + e)], \quad
            u \sim U(-w, w), \quad e \sim N(0, \sigma^2), \quad
            w = \frac{v_s}{1 + |a| T / v_s}.

        sigma is the noise of the velocities, from that of the encoders through the
        smoothing (`StateEstimator`); zero for states. v_s is `standstill_`, at or below
        which the fit saw no equations, and T the period of the fastest motion:
        5 / `cutoff_`, or that of the fitted states where nothing is filtered. Without
        v_s (`standstill=None`) s is erf(v / (sqrt(2) sigma)); for noiseless states it
        is v / w up to w and the sign itself beyond. A joint that stands has s = 0; one
        that turns round has a large acceleration, so a small w, and keeps its sign.
        The rule looks at one row: states may come one by one.
        """
        check_is_fitted(self)
        X = self._validate_query(X)
        states, rest = self._states_and_rest(X, groups, in_band=True)
        parts = contiguous_groups(groups, X.shape[0])
        clock = resolve_clock(t, self.dt, parts, self.effects_)
        rows = self._rows(states, parts, clock, rest)
        count = max(
            1, _identification._CHUNK_BYTES // (8 * self._nv * self.theta_.size)
        )
        return np.concatenate(
            [
                rows(slice(i, i + count)) @ self.theta_
                for i in range(0, states.shape[0], count)
            ]
        )

    def _validate_query(self, X):
        # Positions and states are both welcome, whichever the fit got.
        X = check_array(positions_in_order(X, self.joint_names_), dtype=np.float64)
        check_widths(self.joint_names_, X)
        return X

    def residuals(self, X, y, groups=None, sample_weight=None, t=None, *, cutoff="fit"):
        """Compare with a recording, behind the low-pass and mask of the fit.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions, or states.
        y : array-like of shape (n_samples, nv)
            Measured torques.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.
        sample_weight : array-like of shape (n_samples,) or (n_samples, nv), \
                default=None
            Weights; zero leaves a sample out.
        t : array-like of shape (n_samples,), default=None
            Time [s] on the clock of the fit, for effects that change with it.
        cutoff : "fit", float or None, default="fit"
            Cut-off of the low-pass [Hz]; ``"fit"`` is that of the fit, None filters
            nothing. Above the band of the fit nothing was identified.

        Returns
        -------
        TorqueResiduals
            Filtered torques, predictions and weights.

        Notes
        -----
        What counts is predicted with the columns of the fit. Where a joint stands, and
        the weight is zero, dry friction has its mean as in `predict`.
        """
        check_is_fitted(self)
        X = self._validate_query(X)
        y = torques_in_order(y, self.joint_names_)
        y = check_array(y, dtype=np.float64, ensure_2d=False).reshape(X.shape[0], -1)
        check_widths(self.joint_names_, X, y)
        parts = contiguous_groups(groups, X.shape[0])
        weight = JointTorqueRegressor._check_weight(sample_weight, y.shape)
        if isinstance(cutoff, str) and cutoff == "fit":
            cutoff = self.cutoff_
        elif cutoff is None:
            cutoff = np.inf
        else:
            cutoff = check_cutoff(cutoff, check_dt(self.dt), "cutoff")
        lowpass = _lowpass.design(self.dt or 1.0, cutoff)
        check_length(parts, lowpass, cutoff)
        clock = resolve_clock(t, self.dt, parts, self.effects_)
        states, rest = self._states_and_rest(X, groups)
        signals = states, y, weight, parts, lowpass
        found = self._residuals_of(self._filtered(*signals, t=clock))
        if not (found.weight > 0).all():
            # What counts has the columns of the fit; what stands is predicted.
            stands = self._residuals_of(self._filtered(*signals, t=clock, rest=rest))
            found = found.filled(stands)
        return found

    def to_urdf(self, path):
        """Write the robot description with the identified inertias and friction.

        Parameters
        ----------
        path : str or os.PathLike
            File to write.

        Raises
        ------
        ValueError
            If the identifier was given a `pinocchio.Model`, which keeps no URDF, or
            the parameters are not physically consistent.
        """
        check_is_fitted(self)
        write_identified(
            self.model,
            path,
            self.features_._model,
            self._bodies(),
            _friction.check_names(self.friction),
            self.min_eigenvalues_,
        )
