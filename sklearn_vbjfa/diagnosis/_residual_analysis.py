"""Out-of-sample residuals of a declared model: size, noise floor, what they follow."""

from dataclasses import dataclass

import numpy as np
from sklearn.base import clone
from sklearn.utils.validation import check_array

from sklearn_vbjfa.diagnosis.explain import dependences, motion_signals
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.report import text_table
from sklearn_vbjfa.diagnosis.search._blocks import correlation_time
from sklearn_vbjfa.diagnosis.search._held_out import HeldOut
from sklearn_vbjfa.diagnosis.search._problem import declared_alone
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.recording import check_clock, check_given, check_useful, take_arrays
from sklearn_vbjfa.robot._identifier import RobotIdentifier
from sklearn_vbjfa.robot._recording_checks import check_weight

# Signals that are named in the printed table.
_SHOWN = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualAnalysis:
    """What a model leaves of the torques, on blocks of time that it was not fitted to.

    Attributes
    ----------
    joint_names, torque_units : tuple of str
        Joints, and the units of their torques.
    index : ndarray of shape (m,)
        Row of the recording at the middle of each filtered sample.
    residual, weight, torque : ndarray of shape (m, nv)
        Out-of-sample residuals, what they count, measured torques behind the same
        low-pass [N m or N].
    rms : ndarray of shape (nv,)
        Root mean square of the residual [N m or N].
    floor : ndarray of shape (nv,)
        The same from noise alone; nan if unknown.
    error : ndarray of shape (nv,)
        `rms` over the standard deviation of the torque.
    correlation_time : ndarray of shape (nv,)
        Integrated autocorrelation time of the residual [s].
    dependences : tuple of tuple of Dependence
        For each joint the signals that the residual varies with, the strongest first.
    n_blocks, n_folds : int
        Blocks of time, and groups of blocks that were left out together.
    """

    joint_names: tuple
    torque_units: tuple
    index: np.ndarray
    residual: np.ndarray
    weight: np.ndarray
    torque: np.ndarray
    rms: np.ndarray
    floor: np.ndarray
    error: np.ndarray
    correlation_time: np.ndarray
    dependences: tuple
    n_blocks: int
    n_folds: int

    def __str__(self):
        rows = []
        for j in range(len(self.joint_names)):
            signals = [
                f"{words.signal_label(d.signal, self.joint_names, j)} "
                f"({words.whole_percent(d.share)})"
                for d in self.dependences[j]
            ]
            rows.append(
                [
                    words.joint_label(self.joint_names, j),
                    f"{words.number(self.rms[j])} {self.torque_units[j]}",
                    words.number(self.floor[j]),
                    words.bare_percent(self.error[j]),
                    words.number(1e3 * self.correlation_time[j], 2),
                    words.join(signals, _SHOWN) or "-",
                ]
            )
        heads = ["", "residual", "floor", "error %", "memory ms", "varies with"]
        return (
            f"{text_table(heads, rows, numbers=True)}\n"
            f"Out of sample: {self.n_blocks} blocks of time in {self.n_folds} folds."
        )


def analyse_residuals(
    identifier, X, y, groups=None, t=None, *, sample_weight=None, signals=None
):
    """Look at what a declared model leaves of the torques.

    Each eighth block of time is predicted by the others: the residual of a fit to the
    same data would hide in the parameters what the model lacks.

    Parameters
    ----------
    identifier : RobotIdentifier
        The declared model. It is used as it is if it has been fitted (to this
        recording, as a rule), else a clone of it is fitted.
    X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
        Joint positions [rad or m], or states [q | v | a].
    y : array-like of shape (n_samples, nv)
        Joint torques [N m] or forces [N].
    groups : array-like of shape (n_samples,), default=None
        Labels of separate recordings.
    t : array-like of shape (n_samples,), default=None
        Time [s], rising over all recordings; None counts the identifier's `dt`.
    sample_weight : array-like of shape (n_samples,) or (n_samples, nv), default=None
        Weights; zero leaves a sample out.
    signals : mapping of str to array-like of shape (n_samples,), default=None
        Columns recorded beside the motion, such as a temperature, by name: what the
        residual may vary with, and what effects of the model may need.

    Returns
    -------
    ResidualAnalysis
        Residuals, noise floor, correlation, and the signals that they vary with.

    Raises
    ------
    ValueError
        If the recording is too short for blocks of time, or one of `signals` is no
        condition of the robot.

    See Also
    --------
    sklearn_vbjfa.EffectDiscovery : Names what is missing and adds it.

    Examples
    --------
    >>> from sklearn_vbjfa import RobotIdentifier
    >>> from sklearn_vbjfa.datasets import make_robot_recording
    >>> from sklearn_vbjfa.diagnosis import analyse_residuals
    >>> recording = make_robot_recording(duration=20.0, dt=0.01, random_state=0)
    >>> robot = RobotIdentifier(
    ...     recording.robot_model(), dt=recording.dt, friction=("viscous",)
    ... )
    >>> found = analyse_residuals(robot, recording.q, recording.tau)
    >>> [signals[0].signal for signals in found.dependences[:2]]
    ['speed of joint_1', 'speed of joint_2']
    """
    if not isinstance(identifier, RobotIdentifier):
        raise ValueError(
            "identifier must be a RobotIdentifier, the declared model; got "
            f"{type(identifier).__name__}."
        )
    X = check_array(X, dtype=np.float64)
    y = check_array(y, dtype=np.float64, ensure_2d=False).reshape(X.shape[0], -1)
    weight = check_weight(sample_weight, y.shape)
    if not hasattr(identifier, "theta_"):
        identifier = clone(identifier).fit(X, y, groups, weight, t, signals)
    recording = take_arrays(
        X,
        y,
        groups,
        weight,
        check_clock(t, X.shape[0], identifier.dt),
        dt=identifier.dt,
        joint_names=identifier.joint_names_,
        signals=check_given(signals, X.shape[0]),
    )
    check_useful(recording.signals, recording)
    view = RecordingView(identifier, recording)
    fit = declared_alone(view)
    left_out = HeldOut(view, view.blocks.fold).fitted(fit, None)
    return _collect(identifier, view, left_out.residual, fit.theta)


def _collect(identifier, view, residual, theta):
    root, weight = view.root, view.equations.weight
    residual = (residual / np.where(root.T > 0, root.T, np.inf)).T
    names = identifier.joint_names_
    motion = view.motion(theta)
    signals = motion_signals(motion, names)
    seen = {key: view.filtered(value[:, None])[:, 0] for key, value in signals.items()}
    torque = view.equations.tau
    with np.errstate(divide="ignore", invalid="ignore"):
        rms = np.sqrt((weight * residual**2).sum(axis=0) / weight.sum(axis=0))
        spread = view.spread()
        error = np.where(spread > 0, rms / spread, np.nan)
    one = [slice(j, j + 1) for j in range(view.nv)]
    return ResidualAnalysis(
        joint_names=names,
        torque_units=tuple("N" if p else "N m" for p in motion.prismatic),
        index=view.index,
        residual=residual,
        weight=weight,
        torque=torque,
        rms=rms,
        floor=np.array(identifier.noise_floor_, dtype=float),
        error=error,
        correlation_time=np.array(
            [
                correlation_time(residual[:, j], weight[:, j], view.step, view.starts)
                for j in one
            ]
        ),
        dependences=tuple(
            dependences(residual[:, j], weight[:, j], seen, view)
            for j in range(view.nv)
        ),
        n_blocks=view.blocks.n_blocks,
        n_folds=view.blocks.n_folds,
    )
