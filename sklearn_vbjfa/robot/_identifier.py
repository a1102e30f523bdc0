"""From positions and torques to a physically consistent rigid-body model.

Tags and score of the estimators that take whole recordings.

The steps of an identification, without the public estimator around them.

`RobotIdentifier` checks its arguments and runs these steps on recordings in memory; on
a running robot (`partial_fit`) and on recordings on several machines other parts bring
the statistics, and the steps from there on are the same. They are a class since all of
them read the estimator's parameters and set its attributes.
"""

import itertools

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.metrics import r2_score
from sklearn.utils.validation import check_array, check_is_fitted, validate_data

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.effects._rest import Rest
from sklearn_vbjfa.model._loading import joint_names
from sklearn_vbjfa.model._urdf import write_identified
from sklearn_vbjfa.recording._columns import positions_in_order, torques_in_order
from sklearn_vbjfa.recording._recording import check_cutoff, check_dt, contiguous_groups
from sklearn_vbjfa.regression._joint_factor import BaseJointFactorRegressor
from sklearn_vbjfa.robot import _friction, _online, _torque_noise
from sklearn_vbjfa.robot._equations import (
    RegressorRows,
    Stretch,
    accumulate,
    check_effects,
    edge_rows,
    effect_names,
    filtered_equations,
    fit_passes,
    make_motion,
    needs_load,
    numbered_parts,
    run,
    unexcited_entries,
)
from sklearn_vbjfa.robot._estimate import identifiable, min_eigenvalues, project_beside
from sklearn_vbjfa.robot._features import RigidBodyFeatures
from sklearn_vbjfa.robot._joint_moments import split_residual
from sklearn_vbjfa.robot._joint_torque import JointTorqueRegressor
from sklearn_vbjfa.robot._periods import measure_periods
from sklearn_vbjfa.robot._plan import (
    CUTOFF_PER_BANDWIDTH,
    MotionFacts,
    check_channels,
    check_count,
    check_input_noise,
    check_length,
    check_speed,
    check_time_stamps,
    check_widths,
    fastest_period,
    merge_all,
    n_fastest,
    resolve_clock,
    resolve_cutoff,
    resolve_standstill,
    warn_of_disorder,
)
from sklearn_vbjfa.robot._residuals import collect_residuals
from sklearn_vbjfa.robot._states import SplineStates, fit_states, smooth_to
from sklearn_vbjfa.robot._torque_noise import given_noise, rows_looked_at


class RecordingRegressorMixin(RegressorMixin):
    """A regressor of several outputs whose rows are recordings in the order of time."""

    def __sklearn_tags__(self):
        """Tags of a regressor with several outputs."""
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        tags.target_tags.single_output = True
        return tags

    def score(self, X, y, sample_weight=None, groups=None, t=None):
        """Coefficient of determination R^2 of the predicted torques.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions or states.
        y : array-like of shape (n_samples, nv)
            Measured torques [N m or N].
        sample_weight : array-like of shape (n_samples,), default=None
            Weights.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings, as for `predict`.
        t : array-like of shape (n_samples,), default=None
            Time [s], as for `predict`.

        Returns
        -------
        float
            R^2, the mean over the joints.
        """
        predicted = self.predict(X, groups=groups, t=t)
        if hasattr(self, "joint_names_"):
            y = torques_in_order(y, self.joint_names_)
        return r2_score(y, predicted, sample_weight=sample_weight)


# Filtered rows of the feature matrix that are in memory at once.
_CHUNK_BYTES = 32 << 20


def smooth_recording(x, start, estimator, keep, *, halves):
    """States of one recording by splines, and what all have to know of it.

    Parameters
    ----------
    x : ndarray of shape (n, nv)
        Positions.
    start : int
        Number of its first row, for messages.
    estimator : StateEstimator
        Fitted estimator.
    keep : int
        `n_fastest` of all recordings.
    halves : bool
        Whether to make states from the even and from the odd samples as well.

    Returns
    -------
    states : SplineStates
        States.
    halves : tuple of SplineStates or None
        States from the even and from the odd samples.
    facts : MotionFacts
        Range and speeds.
    """
    n = x.shape[0]
    states = SplineStates(estimator._splines(x, start), n)
    both = None
    if halves:
        both = tuple(SplineStates(s, n) for s in estimator._half_splines(x, start))
    rows = slice(None)
    positions, speeds = states.derivative(rows, 0), states.derivative(rows, 1)
    return states, both, MotionFacts.of(positions, speeds, keep)


class IdentificationSteps:
    """What `RobotIdentifier` does between its arguments and its attributes."""

    def _load_robot(self):
        """Load the model and name what will be identified."""
        self.features_ = RigidBodyFeatures(self.model, friction=self.friction)._load()
        self._nv = self.features_.n_joints_
        self.joint_names_ = joint_names(self.features_._model)
        self.effects_ = check_effects(self.effects, self._nv)
        names, units = effect_names(self.effects_, self.features_._model)
        self.parameter_names_ = self.features_.parameter_names_ + names
        self.parameter_units_ = self.features_.parameter_units_ + units
        self._load_theta = None
        self._active_effects = ()

    # -- states ----------------------------------------------------------------

    def _fit_states(self, X, groups, parts, periods):
        """States and halves of all recordings, and what is known of the motion.

        Where positions are given both are lists of `SplineStates`, one a recording;
        where states are given, or a mean period is, arrays of all rows. The halves are
        None where the noise is not asked for.
        """
        self.state_estimator_ = None
        if X.shape[1] == self._nv:
            source = (X, groups) if periods is None else periods.both_starts()
            self.state_estimator_ = self._new_state_estimator(*source)
        if periods is not None:
            even, odd = periods.states(self.state_estimator_)
            # smoothing is linear: these are the states of the mean
            halves = None if self.input_noise is None else (even, odd)
            states = 0.5 * (even + odd)
        elif self.state_estimator_ is None:
            states, halves = X, None
        else:
            return self._smooth(X, parts)
        v = states[:, self._nv : 2 * self._nv]
        keep = n_fastest(states.shape[0])
        return states, halves, MotionFacts.of(states[:, : self._nv], v, keep)

    def _smooth(self, X, parts):
        keep, halves = n_fastest(X.shape[0]), self.input_noise is not None
        tasks = [
            (X[part], part.start, self.state_estimator_, keep, halves) for part in parts
        ]
        made = list(run(_smooth_task, tasks, self.n_jobs))
        states, halves, facts = zip(*made)
        halves = None if halves[0] is None else tuple(map(list, zip(*halves)))
        return list(states), halves, merge_all(facts, keep)

    def _halves(self, X, groups):
        """States from the even and from the odd samples, where the noise is asked."""
        if self.input_noise is None or self.state_estimator_ is None:
            return None
        return self.state_estimator_.split_transform(X, groups=groups)

    def _new_state_estimator(self, X, groups):
        return fit_states(check_dt(self.dt), self.state_cutoff, X, groups)

    def _states(self, X, groups, *, in_band=False):
        """States of a query; `in_band` smooths to the band that was identified."""
        return self._states_and_rest(X, groups, in_band=in_band)[0]

    def _states_and_rest(self, X, groups, *, in_band=False):
        """States of a query, and the `Rest` that tells the signs of their speeds."""
        if X.shape[1] == 3 * self._nv:
            return X, self._rest(np.zeros(self._nv))
        estimator = self.state_estimator_
        if estimator is None:
            estimator = self._new_state_estimator(X, groups)
        if in_band:
            estimator = smooth_to(estimator, self.cutoff_)
        states = estimator.transform(X, groups=groups)
        return states, self._rest(estimator._velocity_noise())

    def _rest(self, noise):
        """Return what tells the signs of velocities with this noise (nv,)."""
        time = np.full(self._nv, CUTOFF_PER_BANDWIDTH / self.cutoff_)
        if not np.isfinite(self.cutoff_):
            # rows of a running robot do not tell it either
            time = getattr(self, "_fastest_period", time)
        # What masks nothing is negative.
        return Rest(speed=np.maximum(self.standstill_, 0.0), time=time, noise=noise)

    # -- equations -------------------------------------------------------------

    def _corrects_noise(self):
        """Whether the regressor takes a measured covariance of the input noise."""
        return self.regressor is None or (
            getattr(self.regressor, "latent", None) == "correlated"
            and self.regressor.input_noise is None
        )

    def _filtered(self, states, y, weight, parts, lowpass, halves=None, t=None, **kw):
        """Yield the equations of what moves, see `filtered_equations`."""
        stretches = self._stretches(states, y, weight, parts, halves, t, **kw)
        return filtered_equations(stretches, lowpass, chunk_bytes=_CHUNK_BYTES)

    def _stretches(
        self, states, y, weight, parts, halves=None, t=None, *, ends=True, rest=None
    ):
        """Join recordings and their regressor matrices, ready for the low-pass.

        States are arrays of all rows, or lists of one entry a recording. A `Rest` is
        for comparing; what is fitted is masked at rest.
        """
        average = halves is not None and self._corrects_noise()
        rows = [None] * len(parts)
        if not average:
            rows = self._rows_by_part(states, parts, t, rest)
        both = [None] * len(parts)
        if halves is not None:
            both = list(zip(*[self._rows_by_part(half, parts, t) for half in halves]))
        smoother = self.state_estimator_ if ends else None
        return [
            Stretch(
                first=part.start,
                states=own,
                rows=row,
                halves=pair,
                torque=y[part],
                weight=weight[part],
                standstill=self.standstill_,
                edge=edge_rows(part.stop - part.start, smoother),
                number=number,
            )
            for number, (part, own, row, pair) in enumerate(
                zip(parts, _each(states, parts), rows, both)
            )
        ]

    def _rows_by_part(self, states, parts, t, rest=None):
        if self._active_effects:
            # Effects look at all recordings together (time, largest speeds).
            whole = states
            if isinstance(states, list):
                whole = np.concatenate([own[:] for own in states])
            rows = self._rows(whole, parts, t, rest)
            return [rows.part(part) for part in parts]
        return [
            RegressorRows(self.features_, own, rest=rest)
            for own in _each(states, parts)
        ]

    def _rows(self, states, parts, t, rest=None):
        """Regressor matrices of states, with the effects' columns."""
        motion, effects = None, self._active_effects
        if effects:
            signals = states, t, parts, self._load_theta, self.cutoff_
            motion = make_motion(self.features_, *signals, rest)
        return RegressorRows(self.features_, states, effects, motion, rest)

    # -- estimation ------------------------------------------------------------

    def _takes_statistics(self):
        """Whether second moments are all that the regressor needs."""
        known = self.regressor is None or isinstance(
            self.regressor, BaseJointFactorRegressor
        )
        return known and not self.block_noise

    def _new_estimator(self):
        self.estimator_ = JointTorqueRegressor(
            None if self.regressor is None else clone(self.regressor),
            joint_weights=self.joint_weights,
            block_noise=self.block_noise,
            dt=self.dt,
            cutoff=self.cutoff_ if np.isfinite(self.cutoff_) else None,
        )
        self.estimator_._begin()

    def _fit_stretches(self, stretches, lowpass):
        """Estimate from recordings, in parallel where statistics are all it takes."""
        if not self._takes_statistics():
            return self._fit_equations(
                filtered_equations(stretches, lowpass, chunk_bytes=_CHUNK_BYTES),
                numbered_parts(stretches, lowpass, chunk_bytes=_CHUNK_BYTES),
            )
        stats = accumulate(
            stretches, lowpass, chunk_bytes=_CHUNK_BYTES, n_jobs=self.n_jobs
        )
        return self._fit_statistics(stats)

    def _fit_equations(self, pieces, parts=None):
        """Estimate from filtered (index, Phi, tau, weight), which may be a stream.

        Without `numbered_parts` the equations count as independent.
        """
        self._new_estimator()
        for (_, *equations), own in zip(pieces, parts or itertools.repeat(None)):
            self.estimator_._accumulate(*equations, parts=own)
        return self._estimate()

    def _fit_statistics(self, stats):
        """Estimate from the second moments of all equations."""
        self._new_estimator()
        self.estimator_._stats = stats
        return self._estimate()

    def _estimate(self):
        stats = self.estimator_._stats
        check_count(stats, self.standstill_, len(self.parameter_names_))
        self.estimator_._forget(unexcited_entries(stats, self.features_.n_parameters_))
        self.estimator_._finish()
        self._constrain()
        return self

    def _constrain(self):
        """Project, and derive what the data determine."""
        self.theta_unconstrained_ = self.estimator_.theta_unconstrained_
        self.theta_std_ = self.estimator_.theta_std_
        metric = self.estimator_.metric_
        self.identifiable_ = identifiable(metric)
        self.theta_ = self.theta_unconstrained_
        self.projector_ = None
        if self.projector is not None:
            self.projector_, self.theta_ = project_beside(
                self.projector,
                self.features_._model,
                self.theta_unconstrained_,
                metric,
                _friction.check_names(self.friction),
            )
        self.min_eigenvalues_ = min_eigenvalues(self._bodies())
        noise = split_residual(self.estimator_.statistics_, self.theta_)
        self.input_noise_torque_, self.output_noise_ = noise
        self.noise_floor_ = np.hypot(self.torque_noise_, self.input_noise_torque_)

    # -- noise of the torques --------------------------------------------------

    def _noise_facts(self, X, y, t=None):
        """Return what one recording says of the noise of its torques, or None."""
        if not _torque_noise.seen(self.dt, self.cutoff_):
            return None
        states = self._states(X, None, in_band=True)
        residual = y - self.predict(states, t=t)
        return _torque_noise.noise_facts(residual, y, states, self.dt, self.cutoff_)

    def _tell_noise(self, facts):
        """Set the floor from the `_noise_facts` of all recordings."""
        facts = [found for found in facts if found is not None]
        if facts:
            self.torque_noise_ = _torque_noise.filtered_noise(
                facts, self.dt, self.cutoff_
            )
        self.noise_floor_ = np.hypot(self.torque_noise_, self.input_noise_torque_)

    def _bodies(self):
        """Parameters of the features, (nv, 10 + number of friction columns)."""
        return self.theta_[: self.features_.n_parameters_].reshape(self._nv, -1)

    def _residuals_of(self, pieces):
        return collect_residuals(pieces, self.theta_)


def _smooth_task(x, start, estimator, keep, halves):
    return smooth_recording(x, start, estimator, keep, halves=halves)


def _each(states, parts):
    """States of each recording, out of an array of all rows unless they are that."""
    return states if isinstance(states, list) else [states[part] for part in parts]


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
        count = max(1, _CHUNK_BYTES // (8 * self._nv * self.theta_.size))
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
