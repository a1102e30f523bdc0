"""Identification of a physically consistent rigid-body model of a robot."""

import copy
import warnings
from dataclasses import replace
from functools import wraps

import numpy as np
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin, clone
from sklearn.utils.validation import check_is_fitted, check_scalar

from sklearn_vbjfa._core._runtime import one_blas_thread
from sklearn_vbjfa.effects import CommandDelay, TorqueLag
from sklearn_vbjfa.equations._checks import (
    check_channels,
    check_drive,
    check_input_noise,
    check_length,
    check_speed,
)
from sklearn_vbjfa.equations._equations import assign_blocks
from sklearn_vbjfa.equations._features import RigidBodyFeatures, with_followers
from sklearn_vbjfa.equations._motion_facts import estimate_states
from sklearn_vbjfa.equations._plan import check_effects, make_plan
from sklearn_vbjfa.equations._states import fit_states
from sklearn_vbjfa.equations._torque_noise import filtered_white_noise
from sklearn_vbjfa.fit._arguments import (
    FitOptions,
    check_criterion,
    checked_recording,
    recording_of_arguments,
)
from sklearn_vbjfa.fit._between_recordings import between_recordings
from sklearn_vbjfa.fit._bodies import body_prior_of
from sklearn_vbjfa.fit._estimate import size_of_bodies
from sklearn_vbjfa.fit._fit import FitData, Recipe, fit_robot, refine_fit, suggests_lag
from sklearn_vbjfa.fit._gains import check_gains, check_masses, declared_gains
from sklearn_vbjfa.fit._shared_drives import shared_drives
from sklearn_vbjfa.fit._signs import with_signs
from sklearn_vbjfa.inspection import common_lag, contradicted, inspect_as
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.model._loading import joint_names
from sklearn_vbjfa.recording import PDDrive, check_dt, torques_in_order
from sklearn_vbjfa.robot._robot import IdentifiedRobot


class RecordingRegressorMixin(MultiOutputMixin, RegressorMixin):
    """A multi-output regressor whose rows are recordings in time order."""

    # `groups` is requested by default in metadata routing, as by `StateEstimator`.
    __metadata_request__fit = {"groups": True}  # noqa: RUF012
    __metadata_request__predict = {"groups": True}  # noqa: RUF012
    __metadata_request__score = {"groups": True}  # noqa: RUF012

    def score(self, X, y, sample_weight=None, groups=None, t=None, signals=None):
        """Return the coefficient of determination R^2 of the predicted torques.

        Parameters
        ----------
        X, y, groups, t, signals : array-like
            As for `fit`.
        sample_weight : array-like of shape (n_samples,), default=None
            Weights.

        Returns
        -------
        float
            R^2, the mean over the joints.
        """
        from sklearn.metrics import r2_score

        if getattr(self, "drive", None) is not None:
            recording = recording_of_arguments(self, X, y, groups, None, t, signals)
            _, signals = self.drive.split_signals(y, signals)
            y = recording.torques(self.robot_.plan.delay)
        predicted = self.predict(X, groups=groups, t=t, signals=signals)
        if hasattr(self, "joint_names_"):
            y = torques_in_order(y, self.joint_names_)
        return r2_score(y, predicted, sample_weight=sample_weight)


class RobotIdentifier(RecordingRegressorMixin, BaseEstimator):
    """Identify the rigid-body model of a robot from joint positions and torques.

    The estimator smooths the positions, computes the regressor matrix, filters
    regressor and torques, excludes standstill, estimates one parameter vector by
    weighted regression, and projects it onto the physically consistent set.

    Parameters
    ----------
    model : str, os.PathLike or pinocchio.Model
        Path of a URDF or MJCF file, or a model: a tree of joints with one degree of
        freedom. A free base is held, see `load_model`. The inertias of the model
        complete what the data do not determine.
    dt : float, default=None
        Sample period [s]. Required unless states are given and nothing is filtered.
    friction : tuple of {"viscous", "coulomb", "offset", "rotor_inertia"}, \
            default=("viscous", "coulomb", "offset", "rotor_inertia")
        Friction terms of each joint. The paper has ``("viscous",)``.
    effects : tuple of Effect, default=()
        Effects beyond rigid bodies and `friction`, such as ``Spring(joint=1)``, each
        on its joint; see `sklearn_vbjfa.effects`.
        `EffectDiscovery` finds the required ones.
    regressor : estimator, default=None
        Linear regressor, see `JointTorqueRegressor`. None is weighted least squares
        with the description as prior or, without one (see `bodies`),
        ``VBJFARegressor(latent="correlated", input_noise=0.0)``. If its `fit` takes
        `instruments` (`InstrumentalVariables`), these are the commanded motion of the
        `drive`, or the odd samples without a drive.
    projector : "default", PhysicalProjector or None, default="default"
        Projection of the parameters. None leaves them as estimated.
    cutoff : "auto", float or None, default="auto"
        Cut-off frequency [Hz] of the low-pass filter of regressor and torques.
        ``"auto"`` is five times the bandwidth of the motion (the frequency below which
        99 % of the velocity power of the fastest joint lies), and at least 5 Hz or
        25 % of the sampling rate; states are not filtered. None filters nothing.
    input_noise : "auto" or None, default="auto"
        With ``"auto"`` the noise of the regressor matrix is estimated from even and odd
        samples, and corrected by regressors that accept a noise covariance. None treats
        the regressor matrix as exact.
    n_jobs : int, default=None
        Number of recordings, or pieces of them, that are processed in parallel. None is
        1, -1 all processors. The result does not depend on it.
    gains : None, "unknown" or sequence of str, default=None
        None: y holds torques. ``"unknown"``: y is proportional to the torques (motor
        currents); the factors of the channels are identified relative to a reference
        channel, see `gains_`, and torques, masses and friction are in its unit unless
        `FitOptions.known_masses` determines it. A sequence names the reference joints,
        one for each group of joints that share bodies.
    criterion : {"torque", "simulation"}, default="torque"
        ``"torque"`` minimises the torque error. ``"simulation"`` refines bodies,
        friction and coefficients by output error, until simulated positions are closest
        to the measured ones.
    bodies : {"prior", "free", "fixed"}, default="prior"
        ``"prior"``: bodies are near those of the description unless the torques
        contradict it (affine-invariant distance with a half-Cauchy scale around 0.2).
        ``"free"``: the torques decide, and the description completes what they do not
        determine. ``"fixed"``: bodies are as described. Masses without extension
        are free, and so are all bodies with `gains` or a custom `regressor`.
    drive : PDDrive, CurrentDrive, VoltageDrive or None, default=None
        Control law of the motors for logs without torques; y then holds positions,
        currents or voltages (``docs/drives.rst``). The delay of commands is estimated.
    options : FitOptions, default=None
        Further settings; None is ``FitOptions()``.

    Attributes
    ----------
    robot_ : IdentifiedRobot
        The identified robot without data, as `load_identified` returns it. Its
        attributes and methods are also those of the fitted estimator: `theta_`,
        `theta_std_`, `parameter_names_`, `identifiable_`, `gains_`, `noise_floor_`,
        `simulate`, `sample`, `to_urdf`, `save`, ...
    from_description_ : ndarray of shape (p,), bool
        Parameters whose variance the data reduce by less than half.
    common_size_ : float
        Common factor of all masses relative to the description.
    mass_deviations_ : tuple of Departure
        Bodies that differ from the description, the most certain first: `bodies`
        (indistinguishable candidates), `factors` (mass over described mass), `stds` and
        `log_odds`.
    alike_ : tuple of AlikeValue
        Parameters that joints share: `group`, `parameter`, `joints`, the mean `value`,
        its `std` and `unit`, and the relative `scatter`.
    torque_lag_ : float
        Lag [s] of all torques relative to the positions: a parameter
        ``torques:lag`` if `inspect_recording` finds a lag, otherwise zero.
    estimate_ : Estimate
        Result of the regression: fitted `regressor` and `projector`, `metric` (p, p) of
        the projection (the weighted Gram matrix, input noise subtracted), `moments` of
        the equations, `joint_weights`, and `prior_std` (p,) of the bodies.
    criteria_ : SimulationCriteria
        Errors of positions (nv,) before and after the refinement, number and length of
        the windows, convergence. Only with ``criterion="simulation"``.
    n_features_in_ : int
        nv or 3 nv.

    Notes
    -----
    Joints that follow others in the description, q_f = m q + o, have no columns. Their
    bodies act on the joints that move them, tau = A' Phi(A q + b) pi; see `effects_`.

    `theta_std_` compares the observed scatter between forty blocks of time (phases, if
    a motion repeats) with that expected for white residuals: a block sandwich estimate
    with Student's t; windows are the blocks of ``criterion="simulation"``. It is too
    small if residuals are correlated over a tenth of the recordings or longer.

    Examples
    --------
    >>> from sklearn_vbjfa import RobotIdentifier
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> recording = load_demo_recording()
    >>> robot = RobotIdentifier(recording.urdf, dt=recording.dt)
    >>> robot = robot.fit(recording.q, recording.tau, groups=recording.groups)
    >>> bool((robot.min_eigenvalues_ > 0).all())
    True
    """

    def __init__(
        self,
        model,
        *,
        dt=None,
        friction=("viscous", "coulomb", "offset", "rotor_inertia"),
        effects=(),
        regressor=None,
        projector="default",
        cutoff="auto",
        input_noise="auto",
        n_jobs=None,
        gains=None,
        criterion="torque",
        bodies="prior",
        drive=None,
        options=None,
    ):
        self.model = model
        self.dt = dt
        self.friction = friction
        self.effects = effects
        self.regressor = regressor
        self.projector = projector
        self.cutoff = cutoff
        self.input_noise = input_noise
        self.n_jobs = n_jobs
        self.gains = gains
        self.criterion = criterion
        self.bodies = bodies
        self.drive = drive
        self.options = options

    # (2, nv): mean position and velocity gains of the fitted recording, or None.
    _feedback = None

    @property
    def fit_options(self):
        """`options`, or the default ones."""
        check_scalar(self.options, "options", (FitOptions, type(None)))
        return FitOptions() if self.options is None else self.options

    @property
    def used_gains(self):
        """`gains`, or those of the drive if `gains` is None."""
        if self.gains is None and self.drive is not None:
            return self.drive.gains
        return self.gains

    def fit(self, X, y, groups=None, sample_weight=None, t=None, signals=None):
        """Identify the robot.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions [rad or m], uniformly sampled; or states [q | v | a]. The
            columns of a data frame are matched by name: ``q_<joint>``, ``<joint>`` or
            ``q1, q2, ...`` (``v``, ``a`` for states).
        y : array-like of shape (n_samples, nv)
            Joint torques [N m] or forces [N]; columns of a data frame are matched by
            name: ``tau_<joint>``, ``<joint>`` or ``tau1, tau2, ...``. With a `drive`
            its input: commanded positions, currents, or voltages.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings; nothing is differentiated or filtered
            across their boundaries.
        sample_weight : array-like of shape (n_samples,) or (n_samples, nv), \
                default=None
            Weights; zero leaves a torque (of one joint) out, not its position.
        t : array-like of shape (n_samples,), default=None
            Time stamps [s], consistent with `dt` within each recording. They may
            restart with each recording, unless effects vary with time. None counts
            `dt` from the first row.
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Recorded signals by name, such as a temperature, or a data frame, for
            effects that vary with them (`effects.Signal`). Other columns of a data
            frame X are used as well. Further channels of a `drive`, of shape
            (n_samples, nv): ``v_desired``, ``tau_ff``, ``kp``, ``kd``, ``supply``.

        Returns
        -------
        self : object
            Fitted estimator.

        Raises
        ------
        ValueError
            If an argument does not match the robot, or a signal is missing, constant,
            not finite, or equal to a position, velocity, torque or time.
        SimulationError
            A ValueError; with ``criterion="simulation"``, if the simulation with the
            parameters of the torque fit diverges.

        Warns
        -----
        DoubtWarning
            If the fit contradicts the description and `inspect_channels` finds a
            reason, such as a wrong unit or sign of the torques.
        """
        self._declare()
        arguments = X, y, groups, sample_weight, t, signals
        return self._fit_and_inspect(recording_of_arguments(self, *arguments))

    def fit_recording(self, recording):
        """Identify the robot from a `Recording`.

        Parameters
        ----------
        recording : Recording
            Positions or states, torques [N m or N], labels, weights and signals, with
            columns in the order of `joint_names_`.

        Returns
        -------
        self : object
            Fitted estimator.
        """
        self._declare()
        return self._fit_and_inspect(checked_recording(self, recording))

    def _fit_and_inspect(self, recording):
        """Fit; warn about the channels if the fit contradicts the description."""
        self._fit(recording, inspect=True)
        lag = self.warned_lag(recording) if self._suspect else 0.0
        if lag and (self.drive, self.used_gains) == (None, None):
            self.fit_without_inspection(recording, lag)
        return self

    def warned_lag(self, recording):
        """Warn about the channels; return the lag of all torques that they show [s]."""
        findings = self.findings(recording)
        for finding in findings:
            if finding.severity != "note":
                warnings.warn(finding.message, DoubtWarning, stacklevel=4)
        return common_lag(findings)

    def lag_from(self, recording, lag):
        """Estimate the lag of all torques from an initial value, with its deviation."""
        # Returns () instead of the effect if the initial value is zero.
        if not lag:
            return (), np.nan
        refit = clone(self).fit_without_inspection(recording, lag, compare=False)
        return refit.effects_[-1:], refit.theta_std_[-1:]

    def findings(self, recording):
        """Return what `inspect_channels` finds in a recording under these settings."""
        settings = {"drive": self.drive, "gains": self.used_gains}
        return inspect_as(recording, self.model, bodies=self.bodies, **settings)

    @one_blas_thread()
    def _fit(self, recording, inspect=False, compare=True, previous=None):
        self._feedback = recording.feedback
        plan, recording, states = self._prepare(recording)
        robot = self._declared_robot(plan)
        data = FitData(
            recording=recording,
            states=states,
            blocks=assign_blocks(recording, plan),
            n_jobs=self.n_jobs,
        )
        recipe = self._recipe()
        if self.drive is not None and self.drive.unsigned and recording.command is None:
            data = with_signs(recipe, robot, data, previous)
            recording = data.recording
        fit = fit_robot(recipe, robot, data, previous)
        inspect = inspect and self.dt is not None and plan.lag is None
        self._suspect = inspect and (
            contradicted(recording, fit.errors(), fit.torque_size)
            or suggests_lag(recipe, fit, data)
        )
        if self.fit_options.torque_noise is None:
            fit = fit.with_noise_facts(fit.robot.noise_facts(recording, self.n_jobs))
        if self.criterion == "simulation":
            fit = refine_fit(recipe, fit, data, self.fit_options.window)
            self.criteria_ = fit.criteria
        return self._set_attributes(fit, compare)

    def _recipe(self):
        """Return the settings of the estimation, including the described bodies."""
        return Recipe(
            regressor=self.regressor,
            joint_weights=self.fit_options.joint_weights,
            projector=self.projector,
            bodies=self.bodies,
            body_prior=self._body_prior if self.used_gains is None else None,
            gains=self._channel_gains,
            masses=self._masses,
            shared_drives=self._shared_drives,
        )

    def _declared_robot(self, plan):
        noise, nv = self.fit_options.torque_noise, self.features_.n_joints_
        return IdentifiedRobot(
            features_=self.features_,
            plan=plan,
            torque_noise_=filtered_white_noise(noise, nv, plan.dt, plan.cutoff),
            source=self.model,
        )

    # -- for other subpackages ---------------------------------------------------------

    def fit_without_inspection(self, recording, lag=0.0, compare=True, previous=None):
        """Identify the robot from a recording whose channels were inspected."""
        # lag: initial value [s] of the lag of all torques, estimated as `torque_lag_`
        # unless zero; compare: whether to estimate the variance between recordings;
        # previous: an `IdentifiedRobot` whose load initialises the fit.
        self._declare(*([TorqueLag(lag=lag)] if lag else []))
        recording = checked_recording(self, recording, recording.states is None)
        return self._fit(recording, compare=compare, previous=previous)

    def build_model(self):
        """Load the model without data: names, `effects_` and `features_`."""
        if self.criterion != "torque":
            raise ValueError(
                "Second moments alone cannot be refined by simulation, which needs the "
                "recordings themselves: set criterion='torque', or use fit."
            )
        self._declare()
        return self

    def fit_moments(self, plan, moments, facts=lambda robot: ()):
        """Identify the robot from second moments that were computed elsewhere."""
        # plan: of states and equations; moments: `JointMoments` of all equations;
        # facts: function from the fitted `robot_` to `NoiseFacts` of all recordings.
        self.n_features_in_ = plan.standstill.size
        robot = self._declared_robot(plan)
        fit = self._recipe().fit_moments(robot, moments).with_ranges()
        if self.fit_options.torque_noise is None:
            fit = fit.with_noise_facts(facts(fit.robot))
        return self._set_attributes(fit)

    def extended_by(self, effects, std=np.nan):
        """Return a copy whose robot has further effects, see `IdentifiedRobot`."""
        if not effects:
            return self
        out = copy.copy(self)
        out._robot = self.robot_.extended_by(effects, std)
        out.effects_ = out._robot.effects_
        return out

    def set_parameters(self, theta, status):
        """Replace the parameters of the fitted robot and their status (`known_`)."""
        self._robot = replace(self.robot_, theta_=theta, known_=status)

    # -- settings and plan -------------------------------------------------------------

    def _declare(self, *extra):
        # extra: effects that a first fit requires
        check_criterion(self)
        check_input_noise(self.input_noise)
        check_drive(self)
        self.features_ = RigidBodyFeatures(self.model, friction=self.friction).load()
        model = self.features_.model_
        self.joint_names_ = joint_names(model)
        declared = check_effects(self.effects, model.nv, self.features_.friction_)
        # The gain of a single channel is not identifiable: it is the unit.
        single = self.gains is None and model.nv == 1
        gains = self._channel_gains = None if single else self.used_gains
        masses = self.fit_options.known_masses
        self._masses = check_masses(masses, gains, model) if masses else {}
        if gains is not None:
            check_gains(gains, self.joint_names_)
            declared = declared_gains(declared, model.nv)
        delay_known = self.drive is None or self.drive.known_delay is not None
        if not (delay_known or any(isinstance(x, CommandDelay) for x in declared)):
            declared += (CommandDelay(),)
        declared += extra
        self.effects_ = with_followers(declared, self.features_)
        self.features_ = self.features_.corrected(self.effects_)
        self._body_prior = body_prior_of(self)
        self._shared_drives = shared_drives(self)

    def _prepare(self, recording):
        estimator, parts = None, recording.segments
        if recording.states is None:
            settings = check_dt(self.dt), self.fit_options.state_cutoff
            estimator = fit_states(*settings, recording.q, recording.groups)
        halves = self.input_noise is not None
        states, facts = estimate_states(recording, estimator, halves, self.n_jobs)
        if estimator is not None:
            check_speed(self.dt, facts.fast(), self.features_.model_)
        ranges = np.stack([facts.lowest, facts.highest])
        check_channels(self.joint_names_, ranges, recording.tau)
        lengths = [rows.stop - rows.start for rows in parts]
        plan = make_plan(self, self.effects_, lengths, estimator, facts)
        # Rejects time stamps that the effects cannot use.
        clock = plan.clock(recording)
        if plan.timed and clock is not None:
            plan = replace(plan, time=(float(clock[0]), float(clock[-1])))
        names = () if recording.before else recording.group_names
        check_length(parts, plan.lowpass, plan.cutoff, names)
        return plan, recording, states

    # -- fitted attributes -------------------------------------------------------------

    def _set_attributes(self, fit, compare=True):
        result, self._robot = fit.estimate, fit.robot
        if compare:
            variance = between_recordings(fit.full_estimate or result, fit.robot)
            self._robot = replace(fit.robot, recording_variance=variance)
        self.effects_, self.features_ = fit.robot.effects_, fit.robot.features_
        moments = replace(result.moments, blocks=None, recordings=None)
        self.estimate_ = replace(result, moments=moments)
        self.from_description_ = result.from_description
        bodies = result.bodies
        self.mass_deviations_ = () if bodies is None else bodies.departures
        if bodies is None:
            gains = fit.robot.gains_
            self.common_size_ = size_of_bodies(result, self._body_prior, gains)
        else:
            self.common_size_ = bodies.common_size
        self.alike_ = tuple(x.at(self.theta_) for x in result.alike)
        return self

    @property
    def robot_(self):
        """The identified robot without data, an `IdentifiedRobot`."""
        check_is_fitted(self, "_robot")
        return self._robot

    def __getattr__(self, name):
        """Return an attribute or a method of `robot_`."""
        if name.startswith("_") or not hasattr(IdentifiedRobot, name):
            raise AttributeError(
                f"{type(self).__name__!r} object has no attribute {name!r}"
            )
        check_is_fitted(self, "_robot")
        return getattr(self._robot, name)

    @property
    def torque_lag_(self):
        """Lag [s] of all torques relative to the positions, or zero."""
        return self.robot_.plan.lag or 0.0

    # -- methods of the identified robot -----------------------------------------------

    predict = IdentifiedRobot.predict

    @wraps(IdentifiedRobot.residuals)
    def residuals(self, X, y, groups=None, sample_weight=None, t=None, signals=None):
        robot, arguments = self.robot_, (X, y, groups, sample_weight, t, signals)
        if self.drive is None:
            return robot.residuals(*arguments)
        return robot.residuals_of(recording_of_arguments(self, *arguments))

    @wraps(IdentifiedRobot.follow)
    def follow(self, recording, drive=None, *, window=None):
        drive = self.drive if drive is None else drive
        return self.robot_.follow(recording, drive, window=window)

    @wraps(IdentifiedRobot.to_mjcf)
    def to_mjcf(self, path, sample=None, random_state=0, *, drive=None):
        drive = self.drive if drive is None else drive
        drive = drive if isinstance(drive, PDDrive) else None
        if drive is not None and self._feedback is not None:
            if drive.kp is None or drive.kd is None:
                kp, kd = self._feedback
                drive = clone(drive).set_params(kp=kp, kd=kd)
        return self.robot_.to_mjcf(path, sample, random_state, drive=drive)
