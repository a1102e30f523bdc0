"""Identified robots: parameters and predictions without data."""

import warnings
from dataclasses import dataclass, replace
from numbers import Integral
from pathlib import Path

import numpy as np
from sklearn.utils.validation import check_array, check_scalar

from sklearn_vbjfa.effects import CommandDelay, Rest
from sklearn_vbjfa.equations._checks import check_length, check_weight, check_widths
from sklearn_vbjfa.equations._equations import (
    build_segments,
    compare,
    edge_rows,
    equations,
    is_load_free,
    pick_load_free,
    regressor_rows,
)
from sklearn_vbjfa.equations._features import RigidBodyFeatures, body_torques
from sklearn_vbjfa.equations._plan import Plan, needs_load, parameter_names
from sklearn_vbjfa.equations._ranges import EffectRange, outside
from sklearn_vbjfa.equations._states import RecordingStates, fit_states, limit_cutoffs
from sklearn_vbjfa.equations._torque_noise import ROWS, noise_facts, stopband_exists
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.model._loading import joint_names
from sklearn_vbjfa.model._mjcf import Servo
from sklearn_vbjfa.model._trees import is_prismatic
from sklearn_vbjfa.recording import positions_and_signals, signals_for, torques_in_order
from sklearn_vbjfa.recording._drives import PDDrive
from sklearn_vbjfa.recording._recording import (
    Recording,
    check_clock,
    check_dt,
    take_arrays,
    with_torques_shifted,
)
from sklearn_vbjfa.robot import _model_file
from sklearn_vbjfa.robot._channels import ChannelGains, note_of_gains, note_of_units
from sklearn_vbjfa.robot._corrections import note_of_corrections, turned_joints
from sklearn_vbjfa.robot._exports import (
    as_pinocchio,
    plain_totals,
    refitted,
    to_mjcf,
    to_urdf,
    warn_of_motion,
)
from sklearn_vbjfa.robot._posterior import (
    BetweenRecordings,
    Posterior,
    body_indices,
    min_eigenvalues,
    model_parameter_mask,
    note_of_masses,
    outside_text,
    seed_of,
)
from sklearn_vbjfa.robot._simulator_ranges import ranges_of
from sklearn_vbjfa.robot._windows import follow
from sklearn_vbjfa.simulation._simulate import simulate
from sklearn_vbjfa.simulation._stepper import Load, Stepper, TorqueModel, causal

# Largest share of a recording at each end in which the smoother is one-sided.
_EDGE_SHARE = 0.25


@dataclass(frozen=True, kw_only=True, eq=False)
class Inputs:
    """Rows of a recording without torques."""

    recording: Recording  # the rows, with their clock
    states: np.ndarray  # (n, 3 * nv): in the band of the fit
    rest: Rest  # velocity signs at rest
    estimator: object = None  # state estimator; None for given states

    def valid_rows(self, standstill):
        """Return rows (n, nv), bool, in which each signal is valid, by its name."""
        # Rows where the smoother is one-sided and rows without weight are not; a joint
        # at rest has no speed, as in the fit.
        shape = self.states.shape[0], self.recording.nv
        inner = np.zeros(shape, dtype=bool)
        for part in self.recording.segments:
            edge = edge_rows(part.stop - part.start, self.estimator, _EDGE_SHARE)
            inner[part.start + edge : part.stop - edge] = True
        if self.recording.weight is not None:
            inner &= self.recording.weight > 0
        speeds = np.abs(self.states[:, shape[1] : 2 * shape[1]])
        moves = inner & (speeds > standstill)
        return {"position": inner, "speed": moves, "load": inner, "direction": moves}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class IdentifiedRobot:
    """An identified robot without its data, for prediction, simulation and control.

    `RobotIdentifier.robot_` is one, and `load_identified` reads one from the file that
    `save` wrote. It is immutable; only `step` keeps the state of the motion.

    Attributes
    ----------
    theta_ : ndarray of shape (p,)
        Parameters, physically consistent if projected: for each joint ten inertial
        parameters in Pinocchio's order and friction, then effects.
    theta_unconstrained_ : ndarray of shape (p,)
        Parameters before the projection.
    theta_std_ : ndarray of shape (p,)
        Posterior standard deviations of `theta_unconstrained_`, which allow for
        residuals that are correlated in time (see Notes). Infinite if only sums with
        others are determined, nan if the regressor provides none.
    identifiable_ : ndarray of shape (p,), bool
        Parameters that the data determine individually, not only in combination.
    known_ : tuple of str
        "yes", "in combination", "from the description" or "no": whether the recording
        determines a parameter individually, together with others, less than the
        description, or not at all.
    effect_ranges_ : tuple of EffectRange
        Positions, speeds and loads on which declared friction and `effects_` were
        fitted. `predict` warns outside.
    gains_ : ChannelGains or None
        Gains of the torque channels: ``gain`` and ``std`` (nv,), ``intervals()`` of
        90 %, ``reference`` (nv,), and the ``common`` factor. None unless unknown.
    noise_floor_ : ndarray of shape (nv,)
        Standard deviation of `residuals` [N m or N] that encoder and torque noise leave
        in a complete model. nan if the torque noise is unknown.
    torque_noise_ : ndarray of shape (nv,)
        Torque noise component of the floor [N m or N]: the residual spectrum above the
        band, extrapolated into it. nan if the extrapolation is ambiguous.
    output_noise_ : ndarray of shape (nv,)
        Standard deviation of the residual that input noise does not explain [N m or N];
        its excess over `torque_noise_` is model error.
    features_ : RigidBodyFeatures
        The robot, corrected by effects in ``model_``, as described in ``nominal_``.
    """

    features_: RigidBodyFeatures
    plan: Plan  # how the fit smoothed and filtered, with the values of the effects
    theta_: np.ndarray | None = None  # None before a fit
    # parameters with which the load of the effects is computed; see `make_motion`
    load_parameters: np.ndarray | None = None
    # of friction by joint, then of the effects, which are held constant outside unless
    # they are `bounded`; empty, or for all
    effect_ranges_: tuple[EffectRange, ...] = ()
    # (p, p): of the parameters before the projection, infinite on the diagonal for
    # undetermined ones; None if the regressor has none
    covariance: np.ndarray | None = None
    # scatter from one recording to another, for several recordings
    recording_variance: BetweenRecordings | None = None
    theta_std_: np.ndarray | None = None
    theta_unconstrained_: np.ndarray | None = None
    identifiable_: np.ndarray | None = None
    known_: tuple[str, ...] = ()
    noise_floor_: np.ndarray | None = None
    torque_noise_: np.ndarray | None = None
    output_noise_: np.ndarray | None = None
    joint_weights: np.ndarray | None = None  # (nv,): in the fit
    waves: np.ndarray | None = None  # (nv, n_waves): see `NoiseFacts`
    gains_: ChannelGains | None = None
    source: object = None  # path or model that the robot came from
    # URDF of a robot that was saved
    text: str | None = None
    _stepper: object = None

    def __getstate__(self):
        """Return the state for copies, without the motion that `step` remembers."""
        return vars(self) | {"_stepper": None}

    # -- attributes of a fitted estimator --------------------------------------------

    @property
    def robot_(self):
        """The robot itself."""
        return self

    @property
    def description_(self):
        """Robot description (URDF), not corrected."""
        return self.features_.description if self.text is None else self.text

    @property
    def min_eigenvalues_(self):
        """Smallest eigenvalue of each body's pseudo-inertia matrix, (nv,).

        In units of its mass and length scale; positive for a consistent body.
        """
        return min_eigenvalues(self.bodies(self.theta_))

    @property
    def parameter_names_(self):
        """Names of the parameters ("joint_1:m"), tuple of str."""
        return parameter_names(self.features_, self.effects_)[0]

    @property
    def parameter_units_(self):
        """Units of the parameters, tuple of str."""
        return parameter_names(self.features_, self.effects_)[1]

    @property
    def left_out_(self):
        """Effects that need later samples, left out by `step`; tuple of LeftOut."""
        return causal(self.torque_model())[1]

    @property
    def dt(self):
        """Sample period of the fit [s], or None."""
        return self.plan.dt

    @property
    def state_estimator_(self):
        """Smoother of positions in the fit; None if states were given."""
        return self.plan.state_estimator

    @property
    def standstill_(self):
        """Speeds (nv,) at or below which samples are excluded [rad/s or m/s]."""
        return self.plan.standstill

    @property
    def cutoff_(self):
        """Cut-off frequency of the low-pass filter [Hz]; infinity without."""
        return self.plan.cutoff

    # -- prediction, simulation, export -----------------------------------------------

    def predict(self, X, groups=None, t=None, signals=None):
        """Predict the joint torques.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions, which are smoothed to the cut-off of the fit, or noiseless
            states [q | v | a].
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.
        t : array-like of shape (n_samples,), default=None
            Time [s] on the clock of the fit, for effects that vary with time. None
            starts at the beginning of the first fitted recording.
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Recorded signals, as for `fit`; required by effects that vary with them.

        Returns
        -------
        ndarray of shape (n_samples, nv)
            Joint torques [N m] or forces [N], friction included, as the channels record
            them: with their gains, delays and common lag.

        Raises
        ------
        ValueError
            If X does not match the robot, or a signal is missing.

        Warns
        -----
        UserWarning
            If the motion leaves the range of an effect (`effect_ranges_`) by more than
            a fifth of its width in more than 0.5 % of the rows.

        Notes
        -----
        A joint at rest may have any dry friction within its band: the sign of its
        velocity is replaced by its expected value (``docs/theory.rst``).

        Outside the margin of its range, the torque of an effect is held constant: its
        columns are computed at the nearest of `EffectRange.ends`. Rigid bodies,
        declared friction and `bounded` effects are extrapolated. After the last time of
        the fit a drift continues to decay and a payload remains; before the first time
        both have their initial value.
        """
        robot = self.robot_  # also of a fitted identifier
        X, signals = robot.checked(X, signals)
        inputs = robot.prepare(X, groups, t, signals=signals)
        robot.warn_outside(inputs, stacklevel=3)
        return robot.readings(inputs)

    def residuals(self, X, y, groups=None, sample_weight=None, t=None, signals=None):
        """Return the torque residuals, filtered and masked as in the fit.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions, or states.
        y : array-like of shape (n_samples, nv)
            Measured torques.
        groups, t, signals : default=None
            As for `predict`.
        sample_weight : array-like of shape (n_samples,) or (n_samples, nv), \
                default=None
            Weights; zero leaves a sample out.

        Returns
        -------
        TorqueResiduals
            Filtered torques, predictions (as of `predict`) and weights.
        """
        X, signals = self.checked(X, signals)
        y = torques_in_order(y, self.joint_names_)
        y = check_array(y, dtype=np.float64, ensure_2d=False).reshape(X.shape[0], -1)
        check_widths(self.joint_names_, X, y)
        clock = self.clock(t, X.shape[0])
        weight = check_weight(sample_weight, y.shape)
        return self.residuals_of(self.recording(X, y, groups, weight, clock, signals))

    def residuals_of(self, recording, predicts=True):
        """Torque residuals on a `Recording`; see `residuals`."""
        # predicts: whether predictions are needed in addition to torques and weights
        lowpass = self.plan.lowpass
        names = () if recording.before else recording.group_names
        check_length(recording.segments, lowpass, self.plan.cutoff, names)
        recording = self._on_clock(recording)
        estimator = self.estimator(recording.inputs, recording.groups)
        states, rest = (
            RecordingStates.of(recording, estimator),
            self.plan.prediction_rest(estimator),
        )

        # Weighted rows have the columns of the fit; rows at rest are predicted.
        segments = (
            build_segments(
                recording,
                states,
                self.prediction_plan,
                self.features_,
                theta=self.load_parameters,
                rest=signs,
            )
            for signs in (None, rest)
        )
        return compare(*segments, lowpass, self.theta_ if predicts else None)

    def step(self, q, v, a, t=None, signals=None):
        """Predict the torques of the next state of a running robot.

        Rows of states one after another get the torques that `predict` gives them
        together, without the effects in `left_out_`. Hysteresis, play, delays and lags
        remember the states since `reset`.

        Parameters
        ----------
        q, v, a : array-like of shape (nv,)
            Positions [rad or m], velocities and accelerations, taken as noiseless.
        t : float, default=None
            Time [s] on the clock of the fit, later than that of the state before; used
            where effects vary with time or have a lag. None counts `dt` from the start
            of the fit.
        signals : mapping of str to float, default=None
            Recorded signals, for effects that vary with them.

        Returns
        -------
        ndarray of shape (nv,)
            Joint torques [N m] or forces [N], friction included.

        Raises
        ------
        ValueError
            If a state is not of the robot's size or not finite, a signal or the time
            is missing, or time does not go on; such a state is not remembered.

        Notes
        -----
        One robot object is for one loop; copy it (`copy.deepcopy`) for another.
        """
        if self._stepper is None:
            object.__setattr__(self, "_stepper", Stepper(self.torque_model()))
        return self._stepper.step(q, v, a, t, signals)

    def reset(self):
        """Forget the motion: the next state is the first one of a recording."""
        if self._stepper is not None:
            self._stepper.reset()

    def simulate(self, tau, q0, v0=None, t=None, *, signals=None):
        """Simulate the identified robot, driven by measured torques.

        Parameters
        ----------
        tau : array-like of shape (n_samples, nv)
            Torques that the channels measured [N m or N], one row per sample, or a data
            frame with the joints' names. Between rows they go straight.
        q0 : array-like of shape (nv,)
            Positions in the first row [rad or m].
        v0 : array-like of shape (nv,), default=None
            Velocities in the first row [rad/s or m/s]; None is at rest.
        t : array-like of shape (n_samples,), default=None
            Times of the rows [s], on the clock of the fit. None: from its start.
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Recorded signals, for effects that vary with them.

        Returns
        -------
        ndarray of shape (n_samples, 3 * nv)
            States [q | v | a]; the first row is the start, where friction with memory
            is relaxed.

        Raises
        ------
        ValueError
            If torques, times or the start do not suit the robot (the message says what
            and where), or the robot has no positive inertia.
        SimulationError
            A ValueError; if the motion diverges.

        Warns
        -----
        UserWarning
            Of effects that have no forward dynamics (`effects.Elastic`,
            `effects.Jerk`, custom effects without ``terms``).
        """
        model = self.torque_model()
        tau = torques_in_order(tau, model.joint_names)
        t = None if t is None else check_clock(t, len(tau), self.dt)
        return simulate(model, tau, q0, v0, t, signals=signals)

    def follow(self, recording, drive=None, *, window=None):
        """Simulate the identified robot under its drive, from commands alone.

        Parameters
        ----------
        recording : Recording
            With the commands, channels of the drive in `signals`; its positions are
            only the start.
        drive : PDDrive, default=None
            Its commands and law; None is the `drive` of the identifier, which a saved
            robot does not have. Its delay, if given, replaces that of the fit.
        window : float, default=None
            Length [s] after which the simulation starts from the recorded state again;
            None simulates each recording as a whole.

        Returns
        -------
        ndarray of shape (n_samples, 3 * nv)
            States [q | v | a], row by row as the recording.

        Raises
        ------
        ValueError
            If there is no drive that takes positions, or a channel is missing.
        SimulationError
            A ValueError; if the motion diverges.
        """
        if not isinstance(drive, PDDrive):
            raise ValueError(
                "follow needs a drive that takes positions, drive=PDDrive(...); got "
                f"{drive!r}."
            )
        return follow(self, drive, recording, window)

    def gravity(self, q):
        """Return the torques that hold the robot still.

        Parameters
        ----------
        q : array-like of shape (nv,) or (n_samples, nv)
            Joint positions [rad or m].

        Returns
        -------
        ndarray of the shape of q
            Torques of gravity on the identified bodies, as the torque channels read
            them [N m or N]; no friction, offset or spring.

        Raises
        ------
        ValueError
            If q does not suit the robot.
        """
        q = np.asarray(q, dtype=float)
        nv = self.features_.n_joints_
        if q.shape[-1:] != (nv,) or q.ndim > 2 or not np.isfinite(q).all():
            raise ValueError(
                f"q must hold finite positions of {nv} joints, shape ({nv},) or "
                f"(n_samples, {nv}); got shape {q.shape}."
            )
        rows = np.atleast_2d(q)
        still = np.zeros_like(rows)
        torque = self.rigid(rows, still, still)
        return (torque * self.features_.gains_).reshape(q.shape)

    def to_pinocchio(self):
        """Return a Pinocchio model of the identified robot.

        Returns
        -------
        pinocchio.Model
            Identified bodies in ``inertias``, rotor inertia in ``armature``, viscous
            friction in ``damping`` and Coulomb friction in ``lowerDryFrictionLimit``
            and ``upperDryFrictionLimit``. ``pinocchio.rnea`` and ``aba`` take bodies
            and armature into account, and no friction.

        Raises
        ------
        ValueError
            If a body has no mass.

        Notes
        -----
        Offsets, springs and further effects have no place in the model, nor have bodies
        of joints that follow others (``mimic``), which a `DoubtWarning` names.
        """
        if lost := ", ".join(e.of for e in self.effects_ if e.loads):
            message = f"The Pinocchio model lacks the bodies of {lost}: use to_mjcf."
            warnings.warn(message, DoubtWarning, stacklevel=2)
        return as_pinocchio(self.torque_model())

    def save(self, path):
        """Write the identified robot to a file.

        Parameters
        ----------
        path : str or os.PathLike
            JSON file with the robot description (``docs/simulation.rst``). Meshes are
            referenced, not included.

        Raises
        ------
        FileNotFoundError
            If its folder does not exist.
        ValueError
            If `model` is a `pinocchio.Model` with a joint type that URDF lacks, or a
            custom effect has a parameter that JSON cannot hold.
        """
        _model_file.write(path, self)

    def sample(self, n, random_state=None):
        """Draw parameters of the robot in its next recording from the posterior.

        Parameters
        ----------
        n : int
            Number of draws.
        random_state : int, RandomState or None, default=None
            Seed. Row k does not depend on n, and is the sample k of `to_mjcf`.

        Returns
        -------
        ndarray of shape (n, p)
            Parameters in the order of `parameter_names_` and the units of
            `parameter_units_`. Bodies are physically consistent; friction and armature
            are not negative. Parameters without effect on the torques are constant.
            Corrections of the model are drawn independently; a delay of commands is
            drawn together with the damping.

        Raises
        ------
        ValueError
            If n is less than one, or `regressor` gives no ``coef_cov_``.
        """
        check_scalar(n, "n", Integral, min_val=1)
        return Posterior.of(self).sample(seed_of(random_state), range(n))

    def ranges(self, level=0.9):
        """Return the range of each parameter in the robot's next recording.

        Parameters
        ----------
        level : float, default=0.9
            Probability of the range; the tails are equal.

        Returns
        -------
        Ranges
            One `ParameterRange` for each parameter; ``save`` writes ``ranges.json``.

        Raises
        ------
        ValueError
            If the level is not between 0 and 1, or `regressor` gives no ``coef_cov_``.
        """
        return ranges_of(self, level)

    def _sampled(self, sample, random_state):
        if sample is None:
            return self, ""
        number = check_scalar(sample, "sample", Integral, min_val=0)
        seed = seed_of(random_state)
        (theta,) = Posterior.of(self).sample(seed, [number])
        note = (
            f"Sample {number} of the posterior of the identified robot "
            f"(random_state={seed})."
        )
        return replace(self, theta_=theta), note

    def to_urdf(self, path):
        """Write the robot description with the identified inertias and friction.

        Damping and friction of a joint are the sums of declared and found terms, and
        axes with the effect `JointAxis` are corrected. A comment at the top of the file
        lists the corrections that a URDF cannot hold (tilt of the base, encoder zeros,
        gains of torque channels), bodies whose masses are not identifiable, and effects
        that are left out. The robot has true torques at true positions. MJCF models are
        written as URDF.

        Parameters
        ----------
        path : str or os.PathLike
            File to write.

        Returns
        -------
        tuple of LeftOut
            Effects that the file cannot hold, and negative coefficients, each with
            `name`, `joint`, `joint_name` and `reason`.

        Raises
        ------
        ValueError
            If the parameters are not physically consistent.
        """
        x, y, z = self.features_.nominal_.gravity.linear
        other = f"Gravity, which URDF has no place for, was {x:g} {y:g} {z:g} m/s^2."
        notes = [
            "" if (x, y, z) == (0.0, 0.0, -9.81) else other,
            note_of_gains(self.gains_),
            *note_of_corrections(self),
            note_of_masses(self),
        ]
        return to_urdf(
            path,
            self.description_,
            self.torque_model(),
            self.min_eigenvalues_,
            notes,
            turned_joints(self),
        )

    def to_mjcf(self, path, sample=None, random_state=0, *, drive=None):
        """Write the identified robot as an MJCF file for MuJoCo.

        Bodies and joints are those of the corrected robot model, with viscous friction,
        Coulomb friction, rotor inertia and springs; no meshes are written.
        Each joint has a motor of its name, whose control is the reading of the torque
        channel, or, with a `PDDrive`, the commanded position.

        Parameters
        ----------
        path : str or os.PathLike
            File to write, for MuJoCo 3.2 or newer.
        sample : int, default=None
            Row of `sample` to write instead of `theta_`; None writes `theta_`.
        random_state : int, RandomState or None, default=0
            Seed of the sample, as for `sample`.
        drive : PDDrive, default=None
            Drive of the motors, whose controls are then positions. None is the drive of
            the identifier, with the mean of recorded gains and its delay, or the
            estimated or sampled one if it is "auto" (MuJoCo 3.5). Robots without a
            `PDDrive` have torque motors.

        Returns
        -------
        tuple of LeftOut
            Effects that the file cannot hold, and negative coefficients; see `to_urdf`.
            They are also listed in a comment of the file.

        Raises
        ------
        ValueError
            If the parameters are not physically consistent, or a joint is helical.

        Warns
        -----
        DoubtWarning
            If friction that MuJoCo lacks changes the simulated positions of a joint
            within a second by more than 2 % of their spread, after damping and
            frictionloss were fitted again, each by a factor of at most two; or if the
            robot itself diverges.
        """
        robot, which = self._sampled(sample, random_state)
        model = robot.torque_model()
        added = refitted(robot, plain_totals(model))
        notes = [which, note_of_units(self.gains_), note_of_masses(self)]
        left = to_mjcf(
            path, model, robot.min_eigenvalues_, notes, robot._servo(drive), added
        )
        warn_of_motion(robot, added, Path(path).name)
        return left

    def _servo(self, drive):
        """Return the `Servo` of a drive as identified, None for motors without one."""
        if drive is None:
            return None
        if not isinstance(drive, PDDrive):
            raise ValueError(
                "A file needs a drive that takes positions, PDDrive(...); got "
                f"{drive!r}. Controls of others are torques: leave drive=None."
            )
        if (delay := drive.known_delay) is None:
            pairs = zip(self.effects_, self.split(self.theta_))
            delay = sum(x[0] for effect, x in pairs if isinstance(effect, CommandDelay))
        kp, kd = drive.law(self.joint_names_)
        most = drive.torque_limits(self.joint_names_)
        return Servo(kp=kp, kd=kd, torque_limits=most, delay=delay)

    @property
    def joint_names_(self):
        """Joints in the order of the columns of X and y, tuple of str."""
        return joint_names(self.features_.model_)

    @property
    def effects_(self):
        """Effects in use, first the bodies of follower joints; a tuple."""
        return self.plan.effects

    @property
    def limits(self):
        """Ranges to which motion is clipped, by effect; None for `bounded` ones."""
        ranges = self.effect_ranges_[len(self.effect_ranges_) - len(self.effects_) :]
        return tuple(
            None if effect.bounded else x for effect, x in zip(self.effects_, ranges)
        )

    @property
    def prediction_plan(self):
        """The plan for predictions, with the ranges of the effects."""
        return replace(self.plan, ranges=self.limits)

    # -- groups of parameters --------------------------------------------------------

    def split(self, parameters):
        """Split parameters (p,) into those of each effect, a list."""
        # In the first of several passes, load-dependent effects are missing.
        ends = np.cumsum([len(effect.coefficients) for effect in self.effects_])
        coefficients = parameters[self.features_.n_parameters_ :]
        return np.split(coefficients, ends[:-1]) if self.effects_ else []

    def bodies(self, parameters):
        """Inertial and friction parameters of each joint, (nv, 10 + n_friction)."""
        rigid = parameters[: self.features_.n_parameters_]
        return rigid.reshape(self.features_.n_joints_, -1)

    def rigid(self, q, v, a):
        """Torques (n, nv) of all bodies, without friction and rotors."""
        bodies = self.theta_[body_indices(self)]
        return body_torques(self.features_, self.effects_, bodies, q, v, a)

    # -- inputs ---------------------------------------------------------------------

    def checked(self, X, signals):
        """Return positions or states, and the signals that effects vary with."""
        X, columns = positions_and_signals(X, self.joint_names_)
        # Positions and states are both accepted, whichever were fitted.
        X = check_array(X, dtype=np.float64)
        check_widths(self.joint_names_, X)
        return X, signals_for(self.effects_, signals, columns, X.shape[0])

    def clock(self, t, n_samples):
        """Return the time of each row [s], from time stamps if effects need them."""
        # Without time stamps it starts at the first time of the fit.
        dt, time = self.plan.dt, self.plan.time
        if t is not None and self.plan.timed:
            return check_clock(t, n_samples, dt)
        clock = check_clock(None, n_samples, dt)
        return clock if time is None or clock is None else clock + time[0]

    def estimator(self, X, groups, *, in_band=False):
        """State estimator for X; None if X holds states."""
        # in_band: whether it smooths to the identified band.
        if X.shape[1] == 3 * self.features_.n_joints_:
            return None
        estimator = self.plan.state_estimator
        if estimator is None:
            estimator = fit_states(check_dt(self.plan.dt), "auto", X, groups)
        return limit_cutoffs(estimator, self.plan.cutoff) if in_band else estimator

    def states(self, X, groups):
        """States (n, 3 nv) of positions smoothed as in the fit, or of given states."""
        estimator = self.estimator(X, groups)
        return X if estimator is None else estimator.transform(X, groups=groups)

    def recording(self, X, y=None, groups=None, weight=None, t=None, signals=None):
        """Make a `Recording` of checked arrays, by default with zero torques."""
        keywords = {"dt": self.plan.dt, "joint_names": self.joint_names_}
        return take_arrays(X, y, groups, weight, t, signals=signals, **keywords)

    def prepare(self, X, groups=None, t=None, signals=None):
        """Make the `Inputs` of the rows of a recording."""
        clock = self.clock(t, X.shape[0])
        recording = self.recording(X, None, groups, None, clock, signals)
        return self.prepare_recording(recording)

    def prepare_recording(self, recording):
        inputs, groups = recording.inputs, recording.groups
        estimator = self.estimator(inputs, groups, in_band=True)
        states = inputs if estimator is None else estimator.transform(inputs, groups)
        if estimator is not None:
            # Friction with memory would follow the overshoot of smoother positions.
            nv = inputs.shape[1]
            states[:, :nv] = self.states(inputs, groups)[:, :nv]
        return Inputs(
            recording=self._on_clock(recording),
            states=states,
            rest=self.plan.prediction_rest(estimator),
            estimator=estimator,
        )

    def _on_clock(self, recording):
        if not self.plan.timed:
            return recording
        return replace(recording, t=self.clock(recording.t, recording.n_samples))

    # -- predictions ----------------------------------------------------------------

    def torques(self, inputs):
        """Torques (n, nv) that are predicted for `Inputs`."""
        rows = self.regressors(inputs.recording, inputs.states, inputs.rest)
        return np.concatenate([x.predict(self.theta_)[0] for x in rows])

    def readings(self, inputs):
        """Torques (n, nv) that the channels record for `Inputs`, late by their lag."""
        tau, lag = self.torques(inputs), -(self.plan.lag or 0.0)
        recording = replace(inputs.recording, tau=tau, weight=None)
        return with_torques_shifted(recording, lag).tau

    def regressors(self, recording, states, rest=None):
        """Return the `RegressorRows` of each segment, from states (n, 3 nv)."""
        states = [states[rows] for rows in recording.segments]
        arguments = self.prediction_plan, self.features_, self.load_parameters, rest
        return regressor_rows(recording, states, *arguments)

    def warn_outside(self, inputs, stacklevel):
        joints = self.joint_names_, is_prismatic(self.features_.model_)
        if text := outside_text(self.outside(inputs), *joints):
            message = f"Prediction outside the range of the fit. {text}."
            warnings.warn(message, UserWarning, stacklevel=stacklevel)

    def outside(self, inputs):
        """Find where `Inputs` leaves the ranges of the fit, tuple of `OutsideRange`."""
        wanted = {(name, e.joint) for e in self.effect_ranges_ for name in e.depends}
        q, v, a = np.split(inputs.states, 3, axis=1)
        signals = {"position": q, "speed": np.abs(v), "direction": np.sign(v)}
        if any(name == "load" for name, _ in wanted):
            signals["load"] = self.rigid(q, v, a)
        valid = inputs.valid_rows(self.plan.standstill)
        values = {(k, j): signals[k][valid[k][:, j], j] for k, j in wanted}
        clips = [x is not None for x in self.limits]
        clips = [False] * (len(self.effect_ranges_) - len(clips)) + clips
        return outside(self.effect_ranges_, values, clips)

    # -- for other fits, and for simulation -------------------------------------------

    def torque_model(self):
        """Return the `TorqueModel` of the robot, its states taken as noiseless."""
        bodies = self.bodies(self.theta_)
        return TorqueModel(
            model=self.features_.model_,
            bodies=np.ascontiguousarray(bodies[:, :10]),
            friction_names=self.features_.friction_,
            friction=bodies[:, 10:].copy(),
            effects=self.effects_,
            coefficients=tuple(coef.copy() for coef in self.split(self.theta_)),
            ranges=self.limits,
            gains=self.features_.gains_.copy(),
            load=self._load(),
            rest=self.plan.prediction_rest(),
            since=None if self.plan.time is None else self.plan.time[0],
            dt=self.plan.dt,
        )

    def _load(self):
        if self.load_parameters is None:
            return None
        bodies = self.bodies(self.load_parameters)
        plain = self.load_parameters[self.features_.n_parameters_ :]
        widths = [len(e.coefficients) * is_load_free(e) for e in self.effects_]
        return Load(
            bodies=np.ascontiguousarray(bodies[:, :10]),
            friction=bodies[:, 10:].copy(),
            coefficients=tuple(np.split(plain, np.cumsum(widths))[:-1]),
        )

    def corrected(self, effects):
        """Return the robot corrected by effects, which replace effects of equal key."""
        by_key = {effect.key(): effect for effect in (*self.effects_, *effects)}
        return replace(self, features_=self.features_.corrected(by_key.values()))

    def next_load_parameters(self):
        """Parameters with which the next fit computes the load, see `make_motion`."""
        rigid, coefs = np.split(self.theta_, [self.features_.n_parameters_])
        return np.append(rigid, pick_load_free(self.effects_, coefs))

    def extended_by(self, effects, std=np.nan):
        """Return the robot with further effects whose coefficients are one."""
        # Nothing is fitted: the other parameters and the load do not change. Effects in
        # the model have their values, with deviations std (k,), nan if unknown.
        values = [getattr(e, "values", np.ones(len(e.coefficients))) for e in effects]
        values = np.concatenate(values)
        known = np.broadcast_to(np.isfinite(std), values.shape)
        load = self.load_parameters
        if load is None and needs_load(effects):
            load = self.next_load_parameters()
        plain = sum(len(e.coefficients) for e in effects if is_load_free(e))
        of_joint = {x.joint: x for x in self.effect_ranges_}
        ranges = [
            replace(of_joint[e.joint], name=e.name, depends=e.depends) for e in effects
        ]

        def longer(before, added):
            added = np.broadcast_to(added, values.shape)
            return None if before is None else np.append(before, added)

        C = self.covariance
        return replace(
            self,
            plan=replace(self.plan, effects=(*self.effects_, *effects)),
            theta_=longer(self.theta_, values),
            theta_unconstrained_=longer(self.theta_unconstrained_, values),
            theta_std_=longer(self.theta_std_, std),
            covariance=None if C is None else np.pad(C, (0, values.size)),
            identifiable_=longer(self.identifiable_, known),
            known_=(*self.known_, *np.where(known, "yes", "no").tolist()),
            load_parameters=None if load is None else np.append(load, np.zeros(plain)),
            effect_ranges_=(*self.effect_ranges_, *ranges),
        )

    def linear_part(self, theta):
        """Parameters (p,) with zeros for those in the model."""
        return np.where(model_parameter_mask(self), 0.0, theta)

    def equations(self, recording, states=None):
        """Return the filtered `Equations` of a recording, as in the fit."""
        # Columns of effects in the model are derivatives with respect to their values,
        # with which other fits correct them; predictions do not use them.
        if states is None:
            states = self.states(recording.inputs, recording.groups)
        plan = replace(self.plan, tangents=True)
        segments = RecordingStates.of_rows(recording.segments, states)
        segments = build_segments(
            recording, segments, plan, self.features_, theta=self.load_parameters
        )
        return equations(segments, plan.lowpass)

    def noise_facts(self, recording, n_jobs=None):
        """Estimate the torque noise of a recording; `NoiseFacts` of each segment."""
        band = self.plan.dt, self.plan.cutoff
        if not stopband_exists(*band):
            return []
        facts, torques = [], self.plan.with_delays(recording).tau
        clock = self.plan.clock(recording)
        for part in recording.segments:
            rows = slice(part.start, min(part.stop, part.start + ROWS))
            t = None if clock is None else clock[rows]
            signals = {name: x[rows] for name, x in recording.signals.items()}
            inputs = self.prepare(recording.inputs[rows], t=t, signals=signals)
            rest = self.plan.prediction_rest(self.plan.state_estimator)
            inputs, y = replace(inputs, rest=rest), torques[rows]
            residual = y - self.torques(inputs)
            facts.append(noise_facts(residual, y, inputs.states, *band, n_jobs))
        return facts


def load_identified(path, effects=()):
    """Read an identified robot from a file that `RobotIdentifier.save` wrote.

    The file is JSON, nothing in it is executed; effects are those of the library.

    Parameters
    ----------
    path : str or os.PathLike
        File.
    effects : iterable of type, default=()
        Classes of effects that are not in the library, if the robot has any.

    Returns
    -------
    IdentifiedRobot
        The robot; it predicts what the fitted identifier did.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not JSON, not an identified robot or one of a newer version, or
        something in it is missing or wrong; the message names the key.
    ImportError
        If Pinocchio is not installed.
    """
    return _model_file.read(path, IdentifiedRobot, effects)
