"""From positions and torques to a physically consistent rigid-body model."""

from dataclasses import replace

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.metrics import r2_score
from sklearn.utils.validation import check_array, check_is_fitted, validate_data

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.model._loading import joint_names
from sklearn_vbjfa.model._urdf import write_identified
from sklearn_vbjfa.recording._columns import positions_in_order, torques_in_order
from sklearn_vbjfa.recording._recording import (
    check_clock,
    check_cutoff,
    check_dt,
    contiguous_groups,
    take_arrays,
)
from sklearn_vbjfa.recording._stamps import check_time_stamps
from sklearn_vbjfa.robot._equations import (
    accumulate,
    equations,
    joined,
    regressor_rows,
    segments,
    unexcited_entries,
)
from sklearn_vbjfa.robot._estimate import estimate, min_eigenvalues, project
from sklearn_vbjfa.robot._features import RigidBodyFeatures
from sklearn_vbjfa.robot._joint_torque import JointTorqueRegressor
from sklearn_vbjfa.robot._online import OnlineMoments, check_online, check_rows
from sklearn_vbjfa.robot._periods import measure_periods
from sklearn_vbjfa.robot._plan import (
    Plan,
    check_effects,
    effect_names,
    make_plan,
    needs_load,
    observe,
    resolve_standstill,
    takes_moments,
)
from sklearn_vbjfa.robot._recording_checks import (
    check_channels,
    check_count,
    check_input_noise,
    check_length,
    check_speed,
    check_weight,
    check_widths,
    warn_of_disorder,
)
from sklearn_vbjfa.robot._residuals import collect_residuals
from sklearn_vbjfa.robot._states import RecordingStates, fit_states, smooth_to
from sklearn_vbjfa.robot._torque_noise import (
    filtered_noise,
    given_noise,
    noise_facts,
    rows_looked_at,
    seen,
)


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


class RobotIdentifier(RecordingRegressorMixin, BaseEstimator):
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
    n_jobs : int, default=None
        Recordings, and pieces of them, that are worked on at the same time, in threads
        unless a `joblib.parallel_config` says otherwise; None is one, -1 all
        processors. The result does not depend on it.
    forgetting : float, default=1.0
        For `partial_fit`: weight in (0, 1] that a row keeps with each further one.

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
        self._declare()
        recording = self._take(X, y, groups, sample_weight, t)
        periods = measure_periods(self, recording, self.effects_)
        plan, recording, states = self._prepare(recording, periods)
        self._adopt(plan)
        if periods is None:
            self.torque_noise_ = given_noise(
                self.torque_noise, self.features_.n_joints_, self.dt, plan.cutoff
            )
        else:
            self.torque_noise_ = periods.filtered_torque_noise(plan.lowpass)
        for one in plan.passes():
            if needs_load(one.effects):
                self._load = self.theta_[: self.features_.n_parameters_]
            made = segments(recording, states, one, self.features_, theta=self._load)
            self._set(self._estimate(made))
        if periods is None and self.torque_noise is None:
            X = recording.inputs
            clock = plan.clock(recording)
            facts = noise_of(self, X, recording.tau, recording.segments, clock)
            tell_noise(self, facts)
        return self

    # -- from the arguments to a plan --------------------------------------------------

    def _declare(self):
        """Load the model and name what will be identified."""
        self.features_ = RigidBodyFeatures(self.model, friction=self.friction).load()
        self.joint_names_ = joint_names(self.features_.model_)
        self.effects_ = check_effects(self.effects, self.features_.n_joints_)
        names, units = effect_names(self.effects_, self.features_.model_)
        self.parameter_names_ = self.features_.parameter_names_ + names
        self.parameter_units_ = self.features_.parameter_units_ + units
        self._load = None

    def _take(self, X, y, groups, sample_weight, t):
        """Make a `Recording` of the arguments of a fit, refusing what cannot be."""
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
        check_input_noise(self.input_noise)
        nv = self.features_.n_joints_
        parts = contiguous_groups(groups, X.shape[0])
        warn_of_disorder(self.joint_names_, X[:, :nv], parts, groups)
        check_time_stamps(t, self.dt, parts)
        return self._recording(X, y, groups, check_weight(sample_weight, y.shape), t)

    def _recording(self, X, y=None, groups=None, weight=None, t=None):
        """Make a `Recording` of checked arrays; zero torques where none are given."""
        nv = self.features_.n_joints_
        positions = X.shape[1] == nv
        dt = check_dt(self.dt) if positions or self.dt is not None else None
        return take_arrays(
            X,
            np.zeros((X.shape[0], nv)) if y is None else y,
            groups,
            weight,
            t,
            dt=dt,
            joint_names=self.joint_names_,
        )

    def _prepare(self, recording, periods):
        """Plan the fit; return the plan, what it is of, and the states of that."""
        estimator = None
        if recording.states is None:
            source = recording.q, recording.groups
            if periods is not None:
                source = periods.both_starts()
            estimator = fit_states(check_dt(self.dt), self.state_cutoff, *source)
        halves = self.input_noise is not None
        states, facts = observe(recording, estimator, periods, halves, self.n_jobs)
        if estimator is not None:
            travel = facts.highest - facts.lowest
            check_speed(self.dt, facts.fast(), travel, self.features_.model_)
        ranges = np.stack([facts.lowest, facts.highest])
        check_channels(self.joint_names_, ranges, recording.tau)
        plan = make_plan(
            self,
            self.effects_,
            [rows.stop - rows.start for rows in recording.segments],
            estimator,
            facts,
        )
        plan.clock(recording)  # refuses stamps that effects cannot do with
        if periods is None:
            check_length(recording.segments, plan.lowpass, plan.cutoff)
            return plan, recording, states
        return (
            replace(plan, repeats=True),
            *periods.extended(recording, states, plan.lowpass.half),
        )

    def _adopt(self, plan):
        self._plan = plan
        self.state_estimator_ = plan.state_estimator
        self.cutoff_, self.standstill_ = plan.cutoff, plan.standstill

    # -- from equations to attributes --------------------------------------------------

    def _estimate(self, made):
        """Estimate from segments, in parallel where second moments are all it takes."""
        lowpass = self._plan.lowpass
        if takes_moments(self.regressor, self.block_noise):
            return self._estimate_moments(accumulate(made, lowpass, n_jobs=self.n_jobs))
        return self._estimate_rows(equations(made, lowpass))

    def _estimate_rows(self, pieces):
        """Estimate from equations, which may be a stream."""
        rows, total = [], None
        keep = not takes_moments(self.regressor, self.block_noise)
        for one in pieces:
            moments = one.moments()
            total = moments if total is None else total + moments
            if keep:
                rows.append(one)
        return self._estimate_moments(total, rows)

    def _estimate_moments(self, moments, rows=()):
        """Estimate from the second moments of all equations."""
        check_count(moments, self.standstill_, len(self.parameter_names_))
        zeros = unexcited_entries(moments, self.features_.n_parameters_)
        found = estimate(
            moments.zeroed(zeros),
            self.regressor,
            joint_weights=self.joint_weights,
            rows=[one.zeroed(zeros) for one in rows],
            block_noise=self.block_noise,
        )
        return project(found, self.projector, self.features_)

    def _set(self, found):
        """Set what an estimate determines."""
        self.estimator_ = JointTorqueRegressor.of_estimate(
            found,
            self._plan.lowpass,
            regressor=None if self.regressor is None else clone(self.regressor),
            joint_weights=self.joint_weights,
            block_noise=self.block_noise,
            dt=self.dt,
            cutoff=self.cutoff_ if np.isfinite(self.cutoff_) else None,
        )
        self.theta_, self.theta_unconstrained_ = found.theta, found.theta_unconstrained
        self.theta_std_, self.projector_ = found.std, found.projector
        self.identifiable_ = found.identifiable
        self.min_eigenvalues_ = min_eigenvalues(self._bodies())
        self.input_noise_torque_, self.output_noise_ = found.noise()
        self.noise_floor_ = np.hypot(self.torque_noise_, self.input_noise_torque_)

    def _bodies(self):
        """Parameters of the features, (nv, 10 + number of friction columns)."""
        rigid = self.theta_[: self.features_.n_parameters_]
        return rigid.reshape(self.features_.n_joints_, -1)

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
            self._begin_online()
        self._online.forgetting = float(self.forgetting)
        X = positions_in_order(X, self.joint_names_)
        y = torques_in_order(y, self.joint_names_)
        rows = check_rows(self.joint_names_, X, y, sample_weight)
        self._online.add(*rows, self.standstill_)
        if refit:
            self._set(self._estimate_moments(self._online.moments()))
        return self

    def _begin_online(self):
        """Prepare for rows of a running robot."""
        known = getattr(self, "standstill_", None)
        fastest = getattr(getattr(self, "_plan", None), "fastest_period", None)
        self._declare()
        check_online(self, self.effects_)
        nv = self.features_.n_joints_
        automatic = isinstance(self.standstill, str)
        if not automatic or known is None:
            if automatic and self.standstill == "auto":
                raise ValueError(
                    "standstill='auto' needs the speeds of a whole recording, which "
                    "partial_fit does not have: fit a recording first, or give "
                    "standstill as speeds [rad/s or m/s], or as None."
                )
            known = resolve_standstill(self.standstill, np.zeros(nv))
        self._adopt(
            Plan(
                dt=self.dt,
                state_estimator=None,
                cutoff=np.inf,
                lowpass=_lowpass.design(1.0, np.inf),
                standstill=known,
                fastest_period=fastest,
            )
        )
        self.torque_noise_ = np.full(nv, np.nan)
        self._online = OnlineMoments(self.features_, float(self.forgetting))
        self.n_features_in_ = 3 * nv

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
        recording = self._recording(X, groups=groups, t=self._clock(t, X.shape[0]))
        states, rest = self._query(X, groups, in_band=True)
        own = [states[rows] for rows in recording.segments]
        rows = regressor_rows(
            recording, own, self._plan, self.features_, theta=self._load, rest=rest
        )
        return np.concatenate([one.predict(self.theta_) for one in rows])

    def _clock(self, t, n_samples):
        """Return the time of each row of a query [s], of stamps where effects ask."""
        timed = any("time" in effect.needs for effect in self.effects_)
        return check_clock(t if timed else None, n_samples, self.dt)

    def _query(self, X, groups, *, in_band=False):
        """States (n, 3 nv) of a query, and the `Rest` that tells their signs of speed.

        With `in_band` they are smoothed to the band that was identified.
        """
        nv = self.features_.n_joints_
        if X.shape[1] == 3 * nv:
            return X, self._plan.rest(np.zeros(nv))
        estimator = self._plan.state_estimator
        if estimator is None:
            estimator = fit_states(check_dt(self.dt), self.state_cutoff, X, groups)
        if in_band:
            estimator = smooth_to(estimator, self.cutoff_)
        states = estimator.transform(X, groups=groups)
        return states, self._plan.rest(estimator.velocity_noise())

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
        weight = check_weight(sample_weight, y.shape)
        if isinstance(cutoff, str) and cutoff == "fit":
            cutoff = self.cutoff_
        elif cutoff is None:
            cutoff = np.inf
        else:
            cutoff = check_cutoff(cutoff, check_dt(self.dt), "cutoff")
        lowpass = _lowpass.design(self.dt or 1.0, cutoff)
        check_length(contiguous_groups(groups, X.shape[0]), lowpass, cutoff)
        clock = self._clock(t, X.shape[0])
        recording = self._recording(X, y, groups, weight, clock)
        states, rest = self._query(X, groups)
        states = RecordingStates.of_rows(recording.segments, states)

        def compared(rest):
            made = segments(
                recording,
                states,
                replace(self._plan, repeats=False),
                self.features_,
                theta=self._load,
                rest=rest,
            )
            return collect_residuals(equations(made, lowpass), self.theta_)

        found = compared(None)
        if not (found.weight > 0).all():
            # What counts has the columns of the fit; what stands is predicted.
            found = found.filled(compared(rest))
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
            self.features_.model_,
            self._bodies(),
            self.features_.friction_,
            self.min_eigenvalues_,
        )


# -- what other rooms do with an identifier ------------------------------------------


def declare(identifier):
    """Load an identifier's model; names of joints and parameters are set."""
    identifier._online = None
    identifier._declare()


def conclude(identifier, plan, moments):
    """Fit an identifier to second moments that were made by a plan elsewhere."""
    identifier._adopt(plan)
    identifier.torque_noise_ = given_noise(
        identifier.torque_noise, plan.standstill.size, plan.dt, plan.cutoff
    )
    identifier._set(identifier._estimate_moments(moments))


def noise_of(identifier, X, y, segments, clock=None):
    """Return what recordings say of the noise of their torques, a list of facts.

    Parameters
    ----------
    identifier : RobotIdentifier
        Fitted identifier.
    X, y : ndarray
        Positions or states, torques.
    segments : sequence of slice
        Recordings.
    clock : ndarray or None
        Time of each row [s].
    """
    if not seen(identifier.dt, identifier.cutoff_):
        return []
    found = []
    for rows in map(rows_looked_at, segments):
        states, _ = identifier._query(X[rows], None, in_band=True)
        t = None if clock is None else clock[rows]
        residual = y[rows] - identifier.predict(states, t=t)
        band = identifier.dt, identifier.cutoff_
        found.append(noise_facts(residual, y[rows], states, *band))
    return found


def tell_noise(identifier, facts):
    """Set the floor from what all recordings say of the noise of their torques."""
    if facts:
        identifier.torque_noise_ = filtered_noise(
            facts, identifier.dt, identifier.cutoff_
        )
    identifier.noise_floor_ = np.hypot(
        identifier.torque_noise_, identifier.input_noise_torque_
    )


def states_of(identifier, X, groups=None):
    """States (n, 3 nv) of a recording, smoothed as a fitted identifier does."""
    return identifier._query(X, groups)[0]


def equations_of(identifier, X, y, groups, weight, t=None):
    """Make the filtered equations of a recording as a fitted identifier does.

    Returns
    -------
    Equations
        With `index`, the rows that they stand at.
    """
    recording = identifier._recording(X, y, groups, weight, t)
    states = states_of(identifier, X, groups)
    plan = replace(identifier._plan, repeats=False)
    made = segments(
        recording,
        RecordingStates.of_rows(recording.segments, states),
        plan,
        identifier.features_,
        theta=identifier._load,
    )
    return joined(equations(made, plan.lowpass))


def pieces_of(identifier, X, y, groups, *, halves=None):
    """Make the equations of a recording for other estimators than the identifier's.

    Parameters
    ----------
    identifier : RobotIdentifier
        Fitted identifier.
    X, y, groups : array-like
        Recording.
    halves : {"noise", "instruments"}, default=None
        What the states of the even and of the odd samples are for: the difference of
        their regressor matrices, or the odd ones as instruments of the even ones.

    Returns
    -------
    list of Equations
    """
    weight = np.ones(y.shape)
    recording = identifier._recording(X, y, groups, weight)
    plan, features = identifier._plan, identifier.features_

    def pieces(states):
        made = segments(recording, states, plan, features, theta=identifier._load)
        return list(equations(made, plan.lowpass))

    def of_rows(states, both=None):
        return RecordingStates.of_rows(recording.segments, states, both)

    known = plan.state_estimator is not None and identifier.input_noise is not None
    if halves == "instruments":
        even, odd = plan.state_estimator.split_transform(X, groups)
        # An equation counts only where both halves say that the joint moves.
        return [
            replace(
                one,
                weight=np.minimum(one.weight, other.weight),
                instruments=other.Phi,
            )
            for one, other in zip(pieces(of_rows(even)), pieces(of_rows(odd)))
        ]
    both = None
    if halves == "noise" and known:
        both = plan.state_estimator.split_transform(X, groups=groups)
    return pieces(of_rows(states_of(identifier, X, groups), both))


def estimate_of(identifier, pieces, settings):
    """Estimate from a fitted identifier's equations with another one's settings."""
    other = clone(settings)
    other._declare()
    other._adopt(identifier._plan)
    return other._estimate_rows(pieces)


def load_parameters(identifier):
    """Parameters of the bodies that a fit made the effects' load of; None without."""
    return identifier._load
