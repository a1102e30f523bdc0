"""Identified robots without data and estimator: from a fit to a file, and back."""

from sklearn_vbjfa.robot import _model_file
from sklearn_vbjfa.robot._estimate import min_eigenvalues
from sklearn_vbjfa.robot._prediction import PredictsTorques, predictor_of
from sklearn_vbjfa.robot._written import mjcf_of, urdf_of
from sklearn_vbjfa.simulation import Stepper, causal


def torque_model(robot):
    """Return the `TorqueModel` of an identified robot, for simulation and control.

    Parameters
    ----------
    robot : RobotIdentifier or IdentifiedRobot
        Fitted.

    Returns
    -------
    TorqueModel
        The robot as `predict` knows it for states: the model that the effects
        correct, and velocity signs as without noise.
    """
    return predictor_of(robot).torque_model()


class IdentifiedRobot(PredictsTorques):
    """An identified robot without its data, for prediction, simulation and control.

    `load_identified` reads it from the file that `RobotIdentifier.save` wrote.

    Parameters
    ----------
    saved : SavedRobot
        What a file holds.

    Attributes
    ----------
    joint_names_ : tuple of str
        Joints, in the order of all columns.
    theta_, theta_std_ : ndarray of shape (p,)
        Parameters and their standard deviations, as in `RobotIdentifier`.
    parameter_names_, parameter_units_ : tuple of str
        Names ("joint_1:m") and units of the parameters.
    identifiable_ : ndarray of shape (p,), bool
        Parameters that the data determined individually.
    known_ : tuple of str
        "yes", "in combination" or "no": whether the recording tells a parameter by
        itself, together with others, or not at all.
    effects_ : tuple of Effect
        Effects in use.
    effect_ranges_ : tuple of EffectRange
        What each effect was fitted on.
    gains_ : ChannelGains or None
        Gains of the torque channels, if they were unknown.
    features_ : RigidBodyFeatures
        The robot, corrected by its effects in ``model_``, and as described in
        ``nominal_``.
    min_eigenvalues_ : ndarray of shape (nv,)
        Smallest pseudo-inertia eigenvalue of each body, positive if it is physically
        consistent.
    noise_floor_ : ndarray of shape (nv,)
        Torque residuals expected from noise alone [N m or N].
    standstill_ : ndarray of shape (nv,)
        Speeds at or below which a joint may be standing [rad/s or m/s].
    cutoff_ : float
        Highest frequency that was identified [Hz].
    dt : float or None
        Sample period of the fit [s].
    description_ : str
        Robot description (URDF), not corrected.
    left_out_ : tuple of LeftOutEffect
        Effects that `step` does without, as they need what comes after a state, each
        with `name`, `joint` (from zero) and `reason`.

    See Also
    --------
    load_identified : Reads it from a file.
    RobotIdentifier : Identifies robots.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from sklearn_vbjfa import RobotIdentifier, load_identified
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> recording = load_demo_recording().select(0)
    >>> fitted = RobotIdentifier(recording.urdf, dt=recording.dt)
    >>> fitted = fitted.fit(recording.q, recording.tau)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fitted.save(f"{folder}/arm.json")
    ...     robot = load_identified(f"{folder}/arm.json")
    >>> torque = robot.predict(recording.q)
    >>> bool(np.array_equal(torque, fitted.predict(recording.q)))
    True

    State by state, as in a control loop:

    >>> q, v, a = np.zeros((3, 6))
    >>> first = robot.step(q, v, a)
    >>> second = robot.step(q + 1e-5, v + 0.01, a)
    >>> robot.reset()
    """

    def __init__(self, saved):
        self._saved = saved
        predictor = saved.predictor
        plan = predictor.plan
        self.joint_names_ = predictor.joint_names
        self.theta_, self.theta_std_ = predictor.theta, saved.theta_std
        self.parameter_names_, self.parameter_units_ = saved.names, saved.units
        self.identifiable_, self.known_ = saved.identifiable, saved.known
        self.effects_, self.effect_ranges_ = predictor.effects, predictor.ranges
        self.gains_, self.features_ = saved.gains, predictor.features
        self.min_eigenvalues_ = min_eigenvalues(predictor.bodies(predictor.theta))
        self.noise_floor_ = saved.noise_floor
        self.standstill_, self.cutoff_, self.dt = plan.standstill, plan.cutoff, plan.dt
        self.description_ = saved.urdf
        _, self.left_out_ = causal(torque_model(self))
        self._stepper = None

    def __getstate__(self):
        """Return what is copied: all but the motion that `step` remembers."""
        return vars(self) | {"_stepper": None}

    def __repr__(self):
        """Tell the size of the robot and its effects."""
        effects = ", ".join(effect.name for effect in self.effects_)
        return (
            f"<IdentifiedRobot: {len(self.joint_names_)} joints, effects: "
            f"{effects or 'none'}>"
        )

    def _predictor(self):
        """Return the `TorquePredictor` of the file."""
        return self._saved.predictor

    def predict(self, X, groups=None, t=None, signals=None, *, return_std=False):
        """Predict the joint torques, as `RobotIdentifier.predict` does.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions [rad or m], sampled with `dt` and smoothed as in the fit;
            or states [q | v | a], taken as noiseless.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.
        t : array-like of shape (n_samples,), default=None
            Time [s] on the clock of the fit, for effects that vary with time. None: the
            motion begins when the first recording of the fit began.
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Columns recorded beside the motion, for effects that vary with them.
        return_std : bool, default=False
            Whether to return the standard deviation of measured torques about the
            predicted ones as well; see `RobotIdentifier.predict`.

        Returns
        -------
        torque : ndarray of shape (n_samples, nv)
            Joint torques [N m] or forces [N], friction included; those of the
            `RobotIdentifier` that was saved.
        std : ndarray of shape (n_samples, nv)
            Their standard deviations [N m or N], only with `return_std`.

        Raises
        ------
        ValueError
            If X does not suit the robot, a signal is missing, or `return_std` is asked
            of a robot whose fit had no covariance.

        Warns
        -----
        UserWarning
            If the motion leaves what effects were fitted on; see
            `RobotIdentifier.predict`.
        """
        return self._predictor().predict(X, groups, t, signals, return_std=return_std)

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
            What is recorded beside the motion, for effects that vary with it.

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
        A state takes some 10 microseconds for seven joints with friction, and as long
        after an hour as at first. One robot object is for one loop; copy it
        (`copy.deepcopy`) for another. Nothing is said of motion outside what was
        fitted: ask `predict` for that before.
        """
        if self._stepper is None:
            self._stepper = Stepper(torque_model(self))
        return self._stepper.step(q, v, a, t, signals)

    def reset(self):
        """Forget the motion: the next state is the first one of a recording."""
        if self._stepper is not None:
            self._stepper.reset()

    def save(self, path):
        """Write the robot to a file again, the same one that it was read from.

        Parameters
        ----------
        path : str or os.PathLike
            File to write.

        Raises
        ------
        FileNotFoundError
            If its folder does not exist.
        """
        _model_file.write(path, self._saved)

    def to_urdf(self, path):
        """Write the robot description with the identified inertias and friction.

        The file is that of `RobotIdentifier.to_urdf`. For a robot that was identified
        from a `pinocchio.Model`, it has one link a joint, without shapes.

        Parameters
        ----------
        path : str or os.PathLike
            File to write.

        Returns
        -------
        tuple of LeftOut
            What the file does not have; see `RobotIdentifier.to_urdf`.

        Raises
        ------
        ValueError
            If the parameters are not physically consistent.
        """
        return urdf_of(self, self._saved.urdf, path)

    def to_mjcf(self, path):
        """Write the identified robot as MJCF, the description of MuJoCo.

        The file is that of `RobotIdentifier.to_mjcf`.

        Parameters
        ----------
        path : str or os.PathLike
            File to write.

        Returns
        -------
        tuple of LeftOut
            What the file does not have; see `RobotIdentifier.to_mjcf`.

        Raises
        ------
        ValueError
            If the parameters are not physically consistent.
        """
        return mjcf_of(self, path)


def load_identified(path, effects=()):
    """Read an identified robot from a file that `RobotIdentifier.save` wrote.

    Nothing in the file is executed: it is JSON, and effects are taken from the library
    by name.

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
        If it is not JSON, holds no identified robot or one of a newer version, or
        something in it is missing or wrong; the message names the key.
    ImportError
        If Pinocchio is not installed.

    See Also
    --------
    RobotIdentifier.save : Writes the file.

    Examples
    --------
    >>> import tempfile
    >>> from sklearn_vbjfa import RobotIdentifier, load_identified
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> recording = load_demo_recording().select(0)
    >>> fitted = RobotIdentifier(recording.urdf, dt=recording.dt)
    >>> fitted = fitted.fit(recording.q, recording.tau)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fitted.save(f"{folder}/arm.json")
    ...     robot = load_identified(f"{folder}/arm.json")
    >>> robot.joint_names_[:2]
    ('joint_1', 'joint_2')
    """
    return IdentifiedRobot(_model_file.read(path, effects))
