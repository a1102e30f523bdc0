"""From positions and torques to a physically consistent rigid-body model."""

from dataclasses import replace

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_vbjfa._core._progress import show_progress
from sklearn_vbjfa.model._loading import joint_names
from sklearn_vbjfa.recording import (
    OfferedSignals,
    PDDrive,
    check_dt,
    check_time_stamps,
    check_useful,
    columns_beside,
    contiguous_groups,
    levels,
    positions_in_order,
    signals_for,
    torques_in_order,
)
from sklearn_vbjfa.robot._alike import alike_joints
from sklearn_vbjfa.robot._bodies import described_bodies, warn_of_unit
from sklearn_vbjfa.robot._equations import numbered, with_delayed_commands
from sklearn_vbjfa.robot._features import (
    RigidBodyFeatures,
    refuse_followers,
    with_followers,
)
from sklearn_vbjfa.robot._fit import Recipe, Source, fit_robot, refine_fit
from sklearn_vbjfa.robot._gains import check_gains, check_masses, declared_gains
from sklearn_vbjfa.robot._joint_torque import JointTorqueRegressor
from sklearn_vbjfa.robot._output_error import check_criterion
from sklearn_vbjfa.robot._plan import (
    check_effects,
    delay_of,
    effect_names,
    make_plan,
    observe,
)
from sklearn_vbjfa.robot._recording_checks import (
    check_channels,
    check_drive,
    check_input_noise,
    check_length,
    check_motion,
    check_speed,
    check_weight,
    check_widths,
    warn_of_disorder,
)
from sklearn_vbjfa.robot._robot import (
    IdentifiedRobot,
    SimulatesTorques,
    recording_of,
)
from sklearn_vbjfa.robot._signs import signed, with_signs
from sklearn_vbjfa.robot._spreads import Spread, ends
from sklearn_vbjfa.robot._states import fit_states
from sklearn_vbjfa.robot._torque_noise import (
    filtered_noise,
    given_noise,
)

# Attributes that are those of the identified robot.
_OF_ROBOT = (
    "theta_",
    "theta_unconstrained_",
    "theta_std_",
    "identifiable_",
    "effect_ranges_",
    "gains_",
    "min_eigenvalues_",
    "noise_floor_",
    "torque_noise_",
    "output_noise_",
    "state_estimator_",
    "cutoff_",
    "standstill_",
)


class RecordingRegressorMixin(RegressorMixin):
    """A multi-output regressor whose rows are recordings in time order."""

    # Labels of recordings that are passed are taken, as by `StateEstimator`.
    __metadata_request__fit = {"groups": True}  # noqa: RUF012
    __metadata_request__predict = {"groups": True}  # noqa: RUF012
    __metadata_request__score = {"groups": True}  # noqa: RUF012

    def __sklearn_tags__(self):
        """Tags of a regressor with several outputs."""
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        tags.target_tags.single_output = True
        return tags

    def score(self, X, y, sample_weight=None, groups=None, t=None, signals=None):
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
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Columns recorded beside the motion, as for `predict`.

        Returns
        -------
        float
            R^2, the mean over the joints.
        """
        from sklearn.metrics import r2_score

        if getattr(self, "drive", None) is not None:
            told = self._take(X, y, groups, None, t, signals)
            _, signals = self.drive.taken(y, signals)
            y = with_delayed_commands(told, self.robot_.plan).tau
        predicted = self.predict(X, groups=groups, t=t, signals=signals)
        if hasattr(self, "joint_names_"):
            y = torques_in_order(y, self.joint_names_)
        return r2_score(y, predicted, sample_weight=sample_weight)


class RobotIdentifier(RecordingRegressorMixin, SimulatesTorques, BaseEstimator):
    """Identify a robot: joint positions and torques in, rigid-body model out.

    The whole chain: state estimation, regressor matrices, parallel low-pass filtering
    of regressor and torques, standstill mask, weighted estimation of one parameter
    vector, and projection onto the physically consistent set.

    Parameters
    ----------
    model : str, os.PathLike or pinocchio.Model
        Path of a URDF or MJCF file, or a model; a tree of one-degree-of-freedom
        joints; a free base is held, see `load_model`. Its inertias complete what
        the data do not determine, see `theta_`.
    dt : float, default=None
        Sample period [s]; needed unless states are given and nothing is filtered.
    friction : tuple of {"viscous", "coulomb", "offset", "rotor_inertia"}, \
            default=("viscous", "coulomb", "offset", "rotor_inertia")
        Additional columns of each joint: by default the four that hardly any drive is
        without. The paper has ``("viscous",)``.
    effects : tuple of Effect, default=()
        Effects beyond rigid bodies and friction, each on one joint; see
        `sklearn_vbjfa.effects`. `EffectDiscovery` finds out which are needed.
    regressor : estimator, default=None
        Linear regressor, see `JointTorqueRegressor`; None is
        ``VBJFARegressor(latent="correlated", input_noise=0.0)``. One whose `fit` takes
        `instruments`, as `InstrumentalVariables`, has the commanded motion of the
        `drive` for them, and without one the odd samples beside the even ones.
    projector : "default", PhysicalProjector or None, default="default"
        Projection of the parameters; None leaves them as estimated.
    cutoff : "auto", float or None, default="auto"
        Cut-off [Hz] of the low-pass applied to regressor and torques. ``"auto"``:
        five times the bandwidth of the motion (the frequency below which 99 % of the
        velocity power of the fastest joint lies), as in Gautier's practice; if states
        are given, nothing is filtered. None filters nothing.
    state_cutoff : "auto", float, array-like of shape (nv,) or None, default="auto"
        Cut-off [Hz] of `StateEstimator`. ``"auto"``: 1.25 times the one of least
        acceleration error, since noise averages out and smoothing bias does not.
    standstill : "auto", float, array-like of shape (nv,) or None, default="auto"
        Speed [rad/s or m/s] at or below which a joint's equations are left out.
        ``"auto"``: 2 % of the 99.5th percentile of its speed in the fitted
        recordings. None masks nothing.
    joint_weights : "auto", None or array-like of shape (nv,), default="auto"
        Weights of the joints' equations, see `JointTorqueRegressor`.
    input_noise : "auto" or None, default="auto"
        ``"auto"``: given positions, the noise of the regressor is measured by
        computing it from the even and the odd samples separately, whose white encoder
        noise is independent; a regressor that accepts a noise covariance (the default
        one) corrects for it. None treats the regressor as exact.
    torque_noise : float or array-like of shape (nv,), default=None
        Standard deviation of the white noise of one torque sample [N m or N], for
        `noise_floor_`. None measures it in the fitted torques, above the band of the
        low-pass. Interpolation attenuates noise: for interpolated rows, give the
        `torque_noise` of the recording.
    n_jobs : int, default=None
        Number of recordings, or pieces of them, processed in parallel, in threads
        unless a `joblib.parallel_config` says otherwise; None is one, -1 all
        processors. The result does not depend on it.
    gains : None, "unknown" or sequence of str, default=None
        None: y holds torques. ``"unknown"``: it holds what is proportional to them,
        such as motor currents, with an unknown factor for each channel. The factors are
        identified relative to one channel, from what joints have in common, see
        `gains_`; torques, masses and friction are then in units of that channel, unless
        `known_masses` fixes its gain. Names of joints: channels that are to be the
        units, one for each group of joints that share bodies.
    known_masses : dict of str to float, default=None
        Masses [kg] of bodies by their names, or of a ``"payload"``, which an effect
        `Payload` has; for unknown gains. A mass that the recording determines fixes the
        gain that all channels have in common.
    criterion : {"torque", "simulation"}, default="torque"
        ``"torque"``: least squares of the torques. ``"simulation"``: their result is
        refined by output error, until simulated positions are closest to the measured
        ones; see Notes and ``docs/simulation.rst``.
    window : "auto" or float, default="auto"
        Length [s] of the windows that are simulated, each from its measured state.
        ``"auto"``: five times as long as friction takes to slow the slowest joint to
        1 / e, but at least five periods of the fastest motion, and so that there are at
        least eight windows.
    bodies : {"prior", "free", "fixed"}, default="prior"
        What the description's masses and inertias are worth. ``"prior"``: bodies are
        near those of the description, each at a distance tr((P0^-1 dP)^2) of its
        pseudo-inertia (no frame matters) whose scale is integrated over, a half-Cauchy
        distribution around 0.2: torques that tell a body otherwise are believed.
        ``"free"``: the torques alone decide, and the description completes what they
        say nothing of. ``"fixed"``: the bodies are those of the description. Bodies
        without mass or extension are free, and so are all with `gains` or a
        `regressor` of one's own.
    drive : PDDrive, CurrentDrive, VoltageDrive or None, default=None
        What the robot was told in place of torques, where no torque was measured: y is
        then that, and torques are what the drive makes of it (``docs/drives.rst``). A
        delay of the commands is found with the other parameters.
    alike : "auto", None, str or sequence, default="auto"
        Joints that have the same drive, such as those of the legs of a quadruped: their
        rotor inertia, viscous and Coulomb friction, and coefficients of effects that
        have no sign (`Stribeck`, `LoadFriction`, ...), are near each other. The mean of
        a group is free; the scatter between its joints, as a share of that mean, is
        integrated over, a half-Cauchy distribution around 0.2, so that torques that
        tell a value otherwise are believed; offsets are not shared. A sequence of
        groups: each the names of its joints, or a pattern that is a part of them, with
        wildcards; or all patterns in one text, ``"hip thigh calf"``. ``"auto"``: joints
        of which none carries another, whose names differ in a leg, a side or a number
        alone, and whose bodies in the description have the same mass and principal
        inertias; none with `gains` or a `regressor` of one's own. None: no joints.
    verbose : int, default=0
        If not 0, show :ref:`progress bars <progress>` on terminals.

    Attributes
    ----------
    theta_ : ndarray of shape (p,)
        Parameters, physically consistent if projected; effects' coefficients come
        last. Directions that the data do not determine are those of the prior; with
        free bodies they are completed from the model's inertias, scaled to the data.
    theta_unconstrained_ : ndarray of shape (p,)
        Parameters before the projection.
    theta_std_ : ndarray of shape (p,)
        Posterior standard deviations of `theta_unconstrained_`; 90 % intervals are
        plus or minus 1.645 of them. They allow for residuals correlated in time, as
        unmodelled effects are: the deviations for independent residuals are scaled by
        the ratio of observed to expected scatter between forty blocks of time (see
        Notes), or of phases where a motion repeats. nan if the regressor
        provides none. The projection moves `theta_`
        into the physically consistent set, and undetermined directions to the model's
        values; no deviation is given for that.
    theta_prior_std_ : ndarray of shape (p,)
        Standard deviations of the bodies' parameters by the description alone, at the
        scale that each body turned out to have; nan for what it does not say, and
        without a prior.
    from_description_ : ndarray of shape (p,), bool
        Parameters of which the data take away less than half of that variance: their
        values are those of the description more than measured ones.
    common_size_ : float
        How many times as heavy all bodies together are as in the description: a
        description in grams has 0.001, a torque channel may have another unit.
    mass_deviations_ : tuple of Departure
        Bodies that are not as described, the surest first, each with `bodies` (joints
        whose bodies explain the torques about as well, within three nats), `factors`
        (how many times as heavy each would be), `stds` and `log_odds`.
    alike_ : tuple of AlikeValue
        Values that joints share: `group`, `parameter`, the `joints`, their mean `value`
        with its deviation `std` and its `unit`, the `scatter` between them as a share
        of the mean, and `apart`, joints whose value is another one: each a `Departure`
        with `factors` over the mean of the other joints. They are not shared.
    effects_ : tuple of Effect
        Effects in use: first the bodies of joints that follow others (``mimic`` of a
        URDF), each with its ten inertial parameters.
    effect_ranges_ : tuple of EffectRange
        What each effect was fitted on, the declared friction joint by joint and then
        `effects_`: positions, speeds and loads of its joint behind the low-pass, in
        rows with weight in which it moves. `predict` warns outside. Loads are nan
        without `effects`.
    gains_ : ChannelGains or None
        Gains of the torque channels: ``gain`` and ``std`` (nv,), ``intervals()`` of
        90 %, the joint whose channel each is relative to, ``reference`` (nv,), and
        ``common``, what their common factor rests on. None unless they are unknown.
    parameter_names_, parameter_units_ : tuple of str
        Names ("joint_1:m") and units of the parameters.
    identifiable_ : ndarray of shape (p,), bool
        Parameters that the data determine individually, not only in combination.
    joint_names_ : tuple of str
        Joints in Pinocchio's order, which is the column order of X and y.
    min_eigenvalues_ : ndarray of shape (nv,)
        Smallest eigenvalue of each body's pseudo-inertia matrix in units of the
        body's mass and length scale; positive for a physically consistent body.
    noise_floor_ : ndarray of shape (nv,)
        Standard deviation of `residuals` expected from noise alone, with a complete
        model [N m or N]: input noise through the parameters, and torque sensor noise
        in the band of the fit. With `period` it refers to the mean period and is
        smaller than for a single recording. nan where the sensor noise is not known.
    torque_noise_ : ndarray of shape (nv,)
        Sensor noise component of the floor [N m or N], white or coloured: the residual
        spectrum above the band of the fit, extrapolated into it. nan where it cannot
        be determined: nothing lies above the band, the spectrum there resembles no
        smooth noise spectrum, or it still rises towards the band and the residual
        between the motion's band and the cut-off is not its continuation.
    input_noise_torque_ : ndarray of shape (nv,)
        Input noise component of the floor [N m or N].
    output_noise_ : ndarray of shape (nv,)
        Standard deviation of the fit residual not explained by input noise [N m or N];
        it exceeds `torque_noise_` by the model error.
    cutoff_ : float
        Cut-off of the low-pass in use [Hz]; infinity without.
    standstill_ : ndarray of shape (nv,)
        Speeds at or below which samples are left out.
    state_estimator_ : StateEstimator or None
        None if states were given.
    robot_ : IdentifiedRobot
        The identified robot without data and estimator, as `load_identified` reads it:
        what `predict`, `residuals`, `simulate`, `save` and the exports ask.
    features_ : RigidBodyFeatures
        Fitted transformer from states to the regressor.
    estimator_ : JointTorqueRegressor
        Fitted regressor of the parameters.
    criteria_ : SimulationCriteria
        Errors of positions and torques before and after the refinement, ``(nv,)`` each,
        number and length of the windows, number of steps and whether they converged.
        Only with ``criterion="simulation"``.
    n_features_in_ : int
        nv or 3 nv.

    Notes
    -----
    Joints that follow others by the description, q_f = m q + o, have no columns. Their
    bodies are felt by the joints that move them, tau = A' Phi(A q + b) pi: see
    `effects_`. Effects that correct the robot's geometry leave those bodies where the
    description has them.

    The regressor is computed and reduced to second moments piece by piece, and never
    held as a whole (unless `regressor` needs the equations themselves).

    `theta_std_` compares the scatter between forty blocks of time, over all recordings,
    with that expected of white residuals after the fit (a block sandwich estimate,
    unbiased for white residuals, with Student's t for the number of blocks). Blocks
    are merged until neighbours are nearly uncorrelated or sixteen remain. Where a
    motion repeats, within a recording or between recordings, blocks are its phases:
    what is not modelled comes again with it and does not average out. Residuals that
    stay correlated over a tenth of the recordings or longer still make it too small.

    With ``criterion="simulation"`` bodies, friction and coefficients of effects are
    refined by steps of Gauss and Newton on the sensitivities of simulated positions,
    damped in the metric of the torque fit, so that what the simulation does not
    determine stays as it was, and projected onto the consistent parameters; the
    criterion never rises. Start states of the windows are estimated as well, with their
    measurement noise as prior. `theta_std_` is then a sandwich estimate with windows as
    blocks. Shapes of effects and the values of those in the model stay.

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
        state_cutoff="auto",
        standstill="auto",
        joint_weights="auto",
        input_noise="auto",
        torque_noise=None,
        n_jobs=None,
        gains=None,
        known_masses=None,
        criterion="torque",
        window="auto",
        bodies="prior",
        drive=None,
        alike="auto",
        verbose=0,
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
        self.input_noise = input_noise
        self.torque_noise = torque_noise
        self.n_jobs = n_jobs
        self.gains = gains
        self.known_masses = known_masses
        self.criterion = criterion
        self.window = window
        self.bodies = bodies
        self.drive = drive
        self.alike = alike
        self.verbose = verbose

    def fit(
        self,
        X,
        y,
        groups=None,
        sample_weight=None,
        t=None,
        signals=None,
    ):
        """Identify the robot.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions [rad or m], uniformly sampled; or states [q | v | a]. The
            columns of a data frame may be in any order: they are matched by name,
            ``q_<joint>``, ``<joint>`` or ``q1, q2, ...`` (``v``, ``a`` for states),
            here and in `predict`.
        y : array-like of shape (n_samples, nv)
            Joint torques [N m] or forces [N]; columns of a data frame are matched by
            name: ``tau_<joint>``, ``<joint>`` or ``tau1, tau2, ...``. With a `drive`
            what that was told: positions of a `PDDrive`, currents, or
            voltages.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings; nothing is differentiated or filtered
            across their boundaries.
        sample_weight : array-like of shape (n_samples,) or (n_samples, nv), \
                default=None
            Weights; zero leaves a sample (of one joint) out.
        t : array-like of shape (n_samples,), default=None
            Time stamps [s], consistent with `dt` within each recording. They may
            restart with each recording, unless effects vary with time. None counts
            `dt` from the first row.
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Columns recorded beside the motion, such as a temperature, by name (or a
            data frame), for effects that vary with them (`effects.Signal`). Columns of
            a data frame X that are not a channel of a joint are taken as well. A
            `drive` takes its further channels from here, (n_samples, nv) each:
            ``v_desired``, ``tau_ff``, ``kp``, ``kd``, ``supply``.

        Returns
        -------
        self : object
            Fitted estimator.

        Raises
        ------
        ValueError
            If an argument does not suit the robot, or a signal is missing, constant,
            no finite numbers, or a position, velocity, torque or time by another name.
        SimulationError
            A ValueError; with ``criterion="simulation"``, if the motion that is
            simulated with the parameters of the torque fit diverges.

        Warns
        -----
        UserWarning
            With ``criterion="simulation"``, if there are fewer than two windows of
            joints for each direction of the parameters that they determine. With
            ``bodies="prior"`` or ``"fixed"``, if the torques are so small for the
            described bodies that they are motor currents, or in another unit.
        """
        check_criterion(self)
        self._declare()
        recording = self._take(X, y, groups, sample_weight, t, signals)
        with show_progress(self.verbose):
            return self._fit(recording)._of_a_size()

    def fit_recording(self, recording):
        """Identify the robot from a recording as it is.

        Parameters
        ----------
        recording : Recording
            Positions or states, torques [N m or N], labels, weights and signals, its
            columns in the order of `joint_names_`.

        Returns
        -------
        self : object
            Fitted estimator.

        Warns
        -----
        UserWarning
            As of `fit`.
        """
        return self.fit_inspected(recording)._of_a_size()

    def _fit(self, recording):
        """Fit to a checked recording."""
        self._feedback = recording.feedback
        plan, recording, states = self._prepare(recording)
        noise = given_noise(
            self.torque_noise, self.features_.n_joints_, self.dt, plan.cutoff
        )
        robot = self._robot_of(plan, noise, recording.signals)
        source = Source(
            recording=recording,
            states=states,
            numbering=numbered(recording, plan),
            n_jobs=self.n_jobs,
        )
        recipe, before, self._before = self._recipe(), self._before, None
        if self.drive is not None and self.drive.unsigned and recording.command is None:
            source = with_signs(recipe, robot, source, before)
            recording = source.recording
        fit = fit_robot(recipe, robot, source, before)
        if self.torque_noise is None:
            clock = plan.clock(recording)
            facts = fit.robot.noise_facts(recording, clock, self.n_jobs)
            fit = self._with_noise(fit, facts)
        if self.criterion == "simulation":
            fit = refine_fit(recipe, fit, source, self)
            self.criteria_ = fit.criteria
        return self._set(fit)

    def _of_a_size(self):
        """Return the fitted estimator, with a warning if its torques are too small."""
        if self._description is not None and self.drive is None:
            warn_of_unit(self._description, self.estimator_.statistics_)
        return self

    # Robot whose load the next fit begins with, in place of a first pass.
    _before = None
    # Mean gains of position and velocity of the fitted recording, (2, nv), if any.
    _feedback = None

    def _recipe(self):
        """Return the settings of the estimation, with the bodies that are described."""
        names = "regressor", "joint_weights", "projector", "bodies"
        return Recipe(
            gains=self._found_gains,
            masses=self._masses,
            description=self._description,
            alike=self._shared_drives,
            **{name: getattr(self, name) for name in names},
        )

    def _robot_of(self, plan, torque_noise, signals=None):
        """Return the declared robot, whose parameters are not known."""
        return IdentifiedRobot(
            features_=self.features_,
            plan=plan,
            signal_ends=ends({} if signals is None else signals),
            state_cutoff=self.state_cutoff,
            torque_noise_=torque_noise,
            source=self.model,
        )

    def _with_noise(self, fit, facts):
        """Return a fit with the torque noise that facts of all recordings tell."""
        if not facts:
            return fit
        plan = fit.robot.plan
        return fit.with_torque_noise(filtered_noise(facts, plan.dt, plan.cutoff))

    # -- for other rooms -------------------------------------------------------------

    def fit_inspected(self, recording):
        """Identify the robot from a recording whose channels were looked at.

        Parameters
        ----------
        recording : Recording
            As of `fit_recording`.

        Returns
        -------
        self : object
            Fitted estimator.
        """
        check_criterion(self)
        self._declare()
        return self._fit(self._checked(recording))

    def build_model(self):
        """Load the model without data.

        Returns
        -------
        self : object
            With the names of joints and parameters, `effects_` and `features_`.
        """
        if self.criterion != "torque":
            raise ValueError(
                "Second moments alone cannot be refined by simulation, which needs the "
                "recordings themselves: set criterion='torque', or use fit."
            )
        self._declare()
        return self

    def fit_moments(self, plan, moments, facts=lambda robot: ()):
        """Identify the robot from second moments that were computed elsewhere.

        Parameters
        ----------
        plan : Plan
            How states and equations were made.
        moments : JointMoments
            Of all equations.
        facts : callable
            Called with the fitted `robot_` where the torque noise is to be measured;
            returns `NoiseFacts` of all recordings.

        Returns
        -------
        self : object
            Fitted estimator.
        """
        nv = self.n_features_in_ = plan.standstill.size
        noise = given_noise(self.torque_noise, nv, plan.dt, plan.cutoff)
        robot = self._robot_of(plan, noise)
        fit = self._recipe().of_moments(robot, moments)
        if self.torque_noise is None:
            fit = self._with_noise(fit, facts(fit.robot))
        return self._set(fit)

    def signed(self, recording):
        """Give sizes of torques the signs that the fitted robot predicts.

        Parameters
        ----------
        recording : Recording
            Torques of a drive that is ``unsigned``.

        Returns
        -------
        Recording
            With `tau` and `command` of both signs.
        """
        return signed(self.robot_, self.drive.driven(recording))

    def begin_with(self, fitted):
        """Begin the next fit with the load of a fitted identifier, where it has one.

        Parameters
        ----------
        fitted : RobotIdentifier
            Of the same robot.

        Returns
        -------
        self : object
            Not fitted.
        """
        self._before = fitted.robot_
        return self

    def described(self):
        """Return what the description says of the parameters, as a prior.

        Returns
        -------
        tuple of ndarray or None
            Precision (p, p) in the units of the weighted equations, and mean (p,);
            None without a prior.
        """
        bodies = self._bodies
        return None if bodies is None else (bodies.noise * bodies.prior, bodies.centre)

    def tell_spreads(self, estimates):
        """Take how well the last effects are known, for predictions.

        Parameters
        ----------
        estimates : sequence
            For each of them, with the tuned parameters `shape` and the joint
            `covariance` of coefficients and shape.
        """
        if estimates:
            own = [Spread(shape=e.shape, covariance=e.covariance) for e in estimates]
            spreads = (*self._robot.coefficient_covariances[: -len(own)], *own)
            self._robot = replace(self._robot, coefficient_covariances=spreads)

    @property
    def asked_gains(self):
        """`gains`, or unknown ones where the drive's are."""
        if self.gains is None and self.drive is not None:
            return self.drive.gains
        return self.gains

    # -- from the arguments to a plan --------------------------------------------------

    def _declare(self):
        """Load the model; set the names and units of the parameters."""
        self.features_ = RigidBodyFeatures(self.model, friction=self.friction).load()
        self.joint_names_ = joint_names(self.features_.model_)
        declared = check_effects(self.effects, self.features_.n_joints_)
        self.gains_ = None
        model = self.features_.model_
        check_drive(self)
        gains = self._found_gains = self.asked_gains
        if self.gains is None and len(self.joint_names_) == 1:
            # In the unit of the only channel.
            gains = self._found_gains = None
        check_gains(gains, self.joint_names_)
        self._masses = check_masses(self.known_masses, gains, model)
        if gains is not None:
            declared = declared_gains(declared, model.nv)
        declared += delay_of(self.drive, declared)
        self.effects_ = with_followers(declared, self.features_)
        self.features_ = self.features_.corrected(self.effects_)
        if self.criterion == "simulation":
            refuse_followers(
                self.effects_, "criterion='simulation'", "use criterion='torque'"
            )
        names, units = effect_names(self.effects_, self.features_.model_)
        self.parameter_names_ = self.features_.parameter_names_ + names
        self.parameter_units_ = self.features_.parameter_units_ + units
        self._description = described_bodies(self)
        self._shared_drives = alike_joints(self)

    def _take(self, X, y, groups, sample_weight, t, signals):
        """Make a `Recording` of the arguments of a fit, rejecting invalid ones."""
        beside = columns_beside(X, self.joint_names_)
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
        self._check_rows(X, groups, t, contiguous_groups(groups, X.shape[0]))
        told = {}
        if self.drive is not None:
            told, signals = self.drive.taken(y, signals)
        used = signals_for(self.effects_, signals, beside, X.shape[0])
        weight = check_weight(sample_weight, y.shape)
        recording = recording_of(
            self.joint_names_,
            self.dt,
            X,
            y,
            groups=groups,
            weight=weight,
            t=t,
            signals=used,
        )
        check_useful(signals, recording)
        if self.drive is None:
            return recording
        recording = self.drive.driven(replace(recording, signals=told))
        return replace(recording, signals=used)

    def _checked(self, recording):
        """Return a recording with the signals that are needed, rejecting others."""
        names, X = self.joint_names_, recording.inputs
        if recording.joint_names != names or recording.dt != self.dt:
            raise ValueError(
                f"recording must have the joints of the robot ({', '.join(names)}) in "
                f"their order and its sample period dt={self.dt} s; got "
                f"{', '.join(recording.joint_names)} and {recording.dt} s."
            )
        validate_data(self, X, skip_check_array=True)
        self._check_rows(X, recording.groups, recording.t, recording.segments)
        if self.drive is not None:
            recording = self.drive.driven(recording)
        offered = OfferedSignals(columns=recording.signals)
        used = signals_for(self.effects_, None, offered, recording.n_samples)
        weight = recording.weight
        if weight is not None and used.keys() == recording.signals.keys():
            return recording
        weight = check_weight(weight, recording.tau.shape)
        return replace(recording, signals=used, weight=weight)

    def _check_rows(self, X, groups, t, parts):
        """Reject rows that are no recording of this robot, piece by piece."""
        check_input_noise(self.input_noise)
        nv = self.features_.n_joints_
        if X.shape[1] == nv:
            check_motion(self.joint_names_, X, parts)
        warn_of_disorder(self.joint_names_, X[:, :nv], parts, groups)
        check_time_stamps(t, self.dt, parts)

    def _prepare(self, recording):
        """Return the plan of the fit, the recording to fit, and its states."""
        estimator = None
        if recording.states is None:
            source = recording.q, recording.groups
            estimator = fit_states(check_dt(self.dt), self.state_cutoff, *source)
        halves = self.input_noise is not None
        states, facts = observe(recording, estimator, halves, self.n_jobs)
        if estimator is not None:
            travel = facts.highest - facts.lowest
            check_speed(self.dt, facts.fast(), travel, self.features_.model_)
        ranges = np.stack([facts.lowest, facts.highest])
        torques = [levels(np.asarray(recording.tau[p])) for p in recording.segments]
        torques = np.concatenate(torques)
        check_channels(self.joint_names_, ranges, torques, recording.n_samples)
        plan = make_plan(
            self,
            self.effects_,
            [rows.stop - rows.start for rows in recording.segments],
            estimator,
            facts,
        )
        plan = plan.set_to(recording)
        check_length(recording.segments, plan.lowpass, plan.cutoff)
        return plan, recording, states

    # -- from a fit to attributes ----------------------------------------------------

    def _set(self, fit):
        """Set the attributes to what a fit found."""
        found = fit.found
        self._robot = replace(fit.robot, recording_variance=fit.between())
        self.effects_, self.features_ = fit.robot.effects_, fit.robot.features_
        for name in _OF_ROBOT:
            setattr(self, name, getattr(fit.robot, name))
        self.estimator_ = JointTorqueRegressor.of_estimate(
            found,
            fit.robot.plan.lowpass,
            regressor=None if self.regressor is None else clone(self.regressor),
            joint_weights=self.joint_weights,
            dt=self.dt,
            cutoff=self.cutoff_ if np.isfinite(self.cutoff_) else None,
        )
        self.projector_ = found.projector
        self.theta_prior_std_ = found.prior_std
        self.from_description_ = found.from_description
        self._bodies = bodies = found.bodies
        self.mass_deviations_ = () if bodies is None else bodies.departures
        self.common_size_ = 1.0 if bodies is None else bodies.common
        self.alike_ = tuple(one.at(self.theta_) for one in found.alike)
        self.input_noise_torque_ = found.noise()[0]
        return self

    def predict(self, X, groups=None, t=None, signals=None, *, return_std=False):
        r"""Predict the joint torques.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions, which are smoothed to the cut-off of the fit (nothing was
            identified above it); or states [q | v | a], taken as noiseless.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.
        t : array-like of shape (n_samples,), default=None
            Time [s] on the clock of the fit, for effects that vary with time. None: the
            motion begins when the first recording of the fit began, with the robot as
            cold and as loaded as it was then.
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Columns recorded beside the motion, as for `fit`; needed by effects that
            vary with them.
        return_std : bool, default=False
            Whether to return the standard deviation of measured torques about the
            predicted ones as well; see Notes.

        Returns
        -------
        torque : ndarray of shape (n_samples, nv)
            Joint torques [N m] or forces [N], friction included.
        std : ndarray of shape (n_samples, nv)
            Standard deviation [N m or N] of what the torque channel will read behind
            the low-pass of the fit; only with `return_std`. Infinite where a row asks
            for a parameter of which the fit saw nothing, as of a joint that stood.

        Raises
        ------
        ValueError
            If X does not suit the robot, a signal is missing, or `return_std` is asked
            of a regressor without ``coef_cov_``.

        Warns
        -----
        UserWarning
            If the motion leaves what effects were fitted on (`effect_ranges_`), once
            for all of them: a joint's position, speed or load that one of its effects
            `depends` on lies outside by more than a fifth of the range's width (a tenth
            where the effect is curved) in more than 0.5 % of the rows. It says which
            torques are held beyond that margin, see Notes. The same warning
            tells of effects of time outside the time of the fit, by more than a tenth
            of its duration, what they add there and its standard deviation
            (`IdentifiedRobot.effects_of_time`), and of recorded signals that leave
            their range in the fit by more than a fifth of its width.

        Notes
        -----
        A joint at rest may have any dry friction within its band, and the sign of its
        estimated velocity is noise. Every effect of a velocity's sign is therefore
        predicted with the expected sign, over what the true velocity may be,

        .. math::

            s(v, a) = E[\mathrm{sign}(v + u + e)], \quad
            u \sim U(-w, w), \quad e \sim N(0, \sigma^2), \quad
            w = \frac{v_s}{1 + |a| T / v_s}.

        sigma is the velocity noise, propagated from the encoders through the smoother
        (`StateEstimator`); zero for states. v_s is `standstill_`, at or below which
        the fit has no equations, and T the period of the fastest motion: 5 / `cutoff_`,
        or that of the fitted states if nothing is filtered. Without v_s
        (`standstill=None`) s is erf(v / (sqrt(2) sigma)); for noiseless states it is
        v / w up to w and the sign itself beyond. At rest s = 0; at a reversal the
        acceleration is large, w therefore small, and the sign is kept. The rule uses
        one row at a time: states may come one by one.

        Beyond the margin from which on the motion counts as outside, the torque of an
        effect of `effects_` stays as it is there: its columns are made from its joint's
        position, speed or load (those that it `depends` on) at the nearest of
        `EffectRange.ends`. Rigid bodies, declared friction and effects whose law is
        `bounded` (ripple, counterbalance) go on with the motion. The equations of a fit
        hold nothing.

        Effects of time use what is known: after the last time of the fit a drift fades
        on, towards what remains when warm, and a payload stays; before the first time
        both are as they were then.

        The standard deviation is that of measured minus predicted torque, both behind
        the low-pass of the fit as in `residuals`, at a new state of the same robot
        while the joint moves,

        .. math::

            \mathrm{std}_j^2 = \phi_j^T C \phi_j + s_j^2.

        phi is the row of the regressor, C the covariance of the parameters before the
        projection, with one factor for the scatter between blocks of time as in
        `theta_std_`, and s the residual of the joint in the fit: noise of the torque,
        what the model lacks and, unless states are asked for, noise of the positions;
        what the fit took of them for its own is added. 90 % of the torques are within
        1.645 of it if the other motion finds the model as wrong as that of the fit did:
        88 to 91 % on simulated arms with white and coloured noise of the torques.
        Where the model lacks something it is not so: on another motion of measured
        robots 80 to 97 %, and 41 % for joint 5 of a TX40 (``docs/evidence.md``).
        Values of effects that correct the robot (a tilt, a gain), tuned shapes, dry
        friction at rest, and noise above the low-pass are not in it.
        """
        return self.robot_.predicted(X, groups, t, signals, return_std)

    @property
    def robot_(self):
        """The identified robot without data and estimator, an `IdentifiedRobot`."""
        check_is_fitted(self)
        if self.theta_ is not self._robot.theta_:
            return replace(self._robot, theta_=self.theta_)
        return self._robot

    def residuals(
        self,
        X,
        y,
        groups=None,
        sample_weight=None,
        t=None,
        signals=None,
        *,
        cutoff="fit",
    ):
        """Torque residuals on a recording, with the low-pass and mask of the fit.

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
            Time [s] on the clock of the fit, for effects that vary with time; None as
            for `predict`.
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Columns recorded beside the motion, for effects that vary with them, as for
            `fit`.
        cutoff : "fit", float or None, default="fit"
            Cut-off of the low-pass [Hz]; ``"fit"`` uses `cutoff_`, None filters
            nothing. Nothing was identified above the band of the fit.

        Returns
        -------
        TorqueResiduals
            Filtered torques, predictions and weights.

        Notes
        -----
        Rows with weight are predicted with the columns of the fit, effects held within
        their ranges as in `predict`. Where a joint is at rest (zero weight), dry
        friction has its mean, as there.
        """
        if self.drive is not None:
            check_is_fitted(self)
            recording = self._take(X, y, groups, sample_weight, t, signals)
            return self.robot_.residuals_of(recording, cutoff=cutoff)
        return self.robot_.residuals(
            X, y, groups, sample_weight, t, signals, cutoff=cutoff
        )

    def sample(self, n, random_state=None):
        r"""Draw robots that this one may be, as its next recording may show it.

        Parameters
        ----------
        n : int
            How many.
        random_state : int, RandomState or None, default=None
            Seed. Row k of a seed is the same one for every n, and the sample k of
            `to_mjcf` and `to_urdf`.

        Returns
        -------
        ndarray of shape (n, p)
            Parameters in the order of `parameter_names_` and the units of
            `parameter_units_`; bodies are physically consistent, and friction and
            armature are not negative. What no torque tells stays as it is. Values of
            the geometry (a tilt, a gain) are drawn by themselves, and the files of
            `to_mjcf` and `to_urdf` have them as identified; a delay of commands is
            drawn with the damping that it may be mistaken for.

        Raises
        ------
        ValueError
            If n is less than one, or `regressor` gives no ``coef_cov_``.

        See Also
        --------
        ranges : Intervals of the parameters, and ``ranges.json`` for simulators.

        Notes
        -----
        A row is

        .. math::

            \theta = \hat\theta + \delta + e, \quad \delta \sim N(0, C), \quad
            e_k \sim N(0, s_k^2 (1 + h_k)), \quad \theta_k \ge 0.

        theta-hat is `theta_unconstrained_`, and C the covariance of the parameters
        before the projection, with one factor for the scatter between blocks of time,
        as in `predict` (`theta_std_` has a factor for each, which would lose what the
        torques tell of sums of them). e is there if several recordings were fitted, for
        all that is not a body: a random effect by recording,
        :math:`y_r = \Phi_r (\theta + u_r) + \epsilon` with :math:`u_{rk} \sim N(0,
        s_k^2)`, independent. h is the sum of the squared shares that recordings have
        in the value that was fitted, 1/R for R recordings alike. The scale s is
        half-Cauchy around a fifth of the value, at most twice the value, and each row
        has one of its own, by its posterior from the second moments of the recordings
        (with the others' scales at their geometric means): for few recordings the tails
        are as wide as those of Student's t. Of more than 40 recordings, neighbours are
        taken together.

        Armature and friction of drives are cut off at zero as the joint distribution
        is: rows in which one of them is negative are drawn anew by Gibbs's sampler, 200
        sweeps one parameter at a time given all others. Bodies of a row that none can
        have are projected in the metric of their posterior, and the rest of the row is
        drawn given them.

        Examples
        --------
        With the robot of the example of `RobotIdentifier`:

        >>> robot.sample(5, random_state=0).shape
        (5, 84)
        """
        return self.robot_.sample(n, random_state)

    def ranges(self, level=0.9):
        """Return how far each parameter may be off in the robot's next recording.

        Parameters
        ----------
        level : float, default=0.9
            Probability that it is within its range, half of the rest on each side.

        Returns
        -------
        Ranges
            One `ParameterRange` for each parameter; ``save`` writes ``ranges.json``,
            in which simulators find their own words.

        Raises
        ------
        ValueError
            If the level is not between 0 and 1, or `regressor` gives no ``coef_cov_``.

        See Also
        --------
        sample : Draws of all parameters together.

        Notes
        -----
        Each range is of the parameter by itself: of the distribution of `sample` with
        `theta_std_` for C, but for what other parameters cut off and the consistency of
        bodies. What is known
        in combination only (``known``) is better drawn with `sample`.

        Examples
        --------
        With the robot of the example of `RobotIdentifier`:

        >>> one = robot.ranges(level=0.9)["joint_2:coulomb"]
        >>> one.unit, one.known
        ('N m', 'yes')
        >>> bool(one.lower < one.value < one.upper)
        True
        """
        return self.robot_.ranges(level, drive=self._drive_of_files(None))

    def to_urdf(self, path, sample=None, random_state=0):
        """Write the robot description with the identified inertias and friction.

        Damping and friction of a joint are the sums of what was declared and found.
        Axes of joints that a `JointAxis` has turned are corrected, too. A tilt of the
        base, zeros of encoders and gains of torque channels are not a property of the
        robot that a description could hold: a comment at the top says what is to be
        changed, as plainly as that four degrees are to be subtracted. It also names
        bodies whose masses the recording does not determine, and lists what the file
        does not have. Torques of the written robot are the true ones, at true
        positions; damping that an effect found has no end, though `predict` holds it
        outside the speeds of the fit. Of an MJCF file the joints and bodies are written
        as a URDF.

        Parameters
        ----------
        path : str or os.PathLike
            File to write.
        sample : int, default=None
            Row of `sample` to write in place of `theta_`; the file says which.
        random_state : int, RandomState or None, default=0
            Seed of the sample, as for `sample`.

        Returns
        -------
        tuple of LeftOut
            What the file does not have: springs, armature, offsets, effects of the
            load, of time, of the channels, and coefficients that are negative. Each has
            `name`, `joint`, `joint_name`, `size` (root mean square of its torque over
            the fitted recording [N m or N]; nan if unknown), `unit` and `reason`.

        Raises
        ------
        ValueError
            If `model` is a `pinocchio.Model`, which keeps no URDF, or the parameters
            are not physically consistent.

        See Also
        --------
        to_mjcf : The same for MuJoCo, with armature, springs and couplings.

        Examples
        --------
        With the robot of the example of `RobotIdentifier`:

        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     left_out = robot.to_urdf(f"{folder}/identified.urdf")
        >>> sorted({one.name for one in left_out})
        ['offset', 'rotor_inertia']
        """
        return self.robot_.to_urdf(path, sample, random_state)

    def save(self, path):
        """Write the identified robot to a file that predicts without the data.

        Parameters
        ----------
        path : str or os.PathLike
            File to write, JSON with the robot description inside; see
            ``docs/simulation.rst``. References to meshes are kept as they are, the
            meshes are not in it.

        Raises
        ------
        FileNotFoundError
            If its folder does not exist, or the URDF of `model` no longer does.
        ValueError
            If that URDF describes another robot by now, `model` is a
            `pinocchio.Model` with a joint that URDF has no name for, or an effect of
            one's own has a parameter that JSON cannot hold.

        See Also
        --------
        load_identified : Reads it, to predict and for control loops.

        Examples
        --------
        With the robot of the example of `RobotIdentifier`:

        >>> import tempfile
        >>> from sklearn_vbjfa import load_identified
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     robot.save(f"{folder}/arm.json")
        ...     load_identified(f"{folder}/arm.json")
        <IdentifiedRobot: 6 joints, effects: none>
        """
        self.robot_.save(path)

    def to_mjcf(self, path, sample=None, random_state=0, *, drive=None):
        """Write the identified robot as MJCF, the description of MuJoCo.

        Bodies and joints come from the robot model, as its effects correct it: a
        `pinocchio.Model` will do, and no meshes are written. Viscous friction is
        ``damping``, Coulomb friction ``frictionloss``, rotor inertia ``armature``, a
        spring ``stiffness`` and ``springref``; a tilted base is in the direction of
        gravity, an encoder's zero in ``ref``. Couplings that two joints have of each
        other are fixed tendons with the same attributes. Each joint has a motor of its
        name, whose control is what the torque channel reads, or, with a `PDDrive`, the
        commanded position, at the gains, the limit and the delay of the drive; constant
        torques are its bias. Torques of springs and dampers have no end, though
        `predict` holds those of `effects_` outside the range of the fit.

        Parameters
        ----------
        path : str or os.PathLike
            File to write. MuJoCo 3.2 and newer read it; 3.3.1 and newer if couplings
            have inertia, which inverse dynamics know of in 3.6.
        sample : int, default=None
            Row of `sample` to write in place of `theta_`; the file says which.
        random_state : int, RandomState or None, default=0
            Seed of the sample, as for `sample`.
        drive : PDDrive, default=None
            Drive of the motors, whose controls are then positions; by default the
            identifier's, with the mean of gains that were recorded. Its delay is the
            one that was found, or sampled, and needs MuJoCo 3.5. Motors of a robot with
            another drive, or none, are told torques, as are those of
            ``robot_.to_mjcf(path)``.

        Returns
        -------
        tuple of LeftOut
            What the file does not have, in its comment as well: effects of the load, of
            time, of the channels, what is not a linear function of position or speed,
            and coefficients that are negative; see `to_urdf`.

        Raises
        ------
        ValueError
            If the parameters are not physically consistent, or a joint is helical.

        See Also
        --------
        to_urdf : The same as URDF.

        Notes
        -----
        Dry friction of MuJoCo is a soft constraint: with the time step h of the file it
        is full where abs(v) > h (abs(a) + 1e-4 Fc / M), for a joint of inertia M, and
        grows in proportion to the speed below. Joint limits are those of the
        description, shifted by an encoder's zero; limits of speed are not written, and
        of torque only the ``saturation`` of the drive.

        Examples
        --------
        With the robot of the example of `RobotIdentifier`:

        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     robot.to_mjcf(f"{folder}/identified.xml")
        ()
        """
        drive = self._drive_of_files(drive)
        return self.robot_.to_mjcf(path, sample, random_state, drive=drive)

    def _drive_of_files(self, drive):
        """Return the `PDDrive` with gains that is written into files, or None."""
        drive = self.drive if drive is None else drive
        if not isinstance(drive, PDDrive):
            return None
        if self._feedback is not None and (drive.kp is None or drive.kd is None):
            kp, kd = self._feedback
            drive = clone(drive).set_params(kp=kp, kd=kd, gear=1.0)
        return drive
