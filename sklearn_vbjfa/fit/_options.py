"""Settings of an identification for experts."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, eq=False)
class FitOptions:
    """Settings of `RobotIdentifier` for experts.

    Parameters
    ----------
    state_cutoff : "auto", float, array-like of shape (nv,) or None, default="auto"
        Cut-off frequency [Hz] of `StateEstimator`; ``"auto"`` is 1.25 times that of
        least acceleration error.
    standstill : "auto", float, array-like of shape (nv,) or None, default="auto"
        Speed [rad/s or m/s] at or below which the equations of a joint are excluded.
        ``"auto"`` is 2 % of the 99.5th percentile of its speed. None excludes nothing.
    joint_weights : "auto", None or array-like of shape (nv,), default="auto"
        Weights of the joints' equations, see `JointTorqueRegressor`.
    torque_noise : float or array-like of shape (nv,), default=None
        Standard deviation of the white noise of one torque sample [N m or N], for
        ``noise_floor_``. None estimates it above the band of the low-pass filter.
    known_masses : dict of str to float, default=None
        Known masses [kg] of bodies, or of a ``"payload"`` (effect `Payload`), which
        determine the common factor of unknown gains.
    window : "auto" or float, default="auto"
        Length [s] of the windows of ``criterion="simulation"``. ``"auto"`` is five
        times the longest time constant of friction, at least five periods of the
        fastest motion, and at most an eighth of the recordings.
    alike : "auto", None, str or sequence, default="auto"
        Groups of joints with the same drive, whose rotor inertia, viscous and Coulomb
        friction, and coefficients of unsigned effects share a mean. A sequence holds
        the groups, each as names or as a pattern; a string holds all patterns,
        ``"hip thigh calf"``. ``"auto"`` groups joints whose names differ in a leg, a
        side or a number only and whose described bodies are equal; it groups none with
        `gains` or a custom `regressor`. None groups none.
    verbose : int, default=0
        If not 0, show :ref:`progress bars <progress>` on terminals.

    Examples
    --------
    >>> from sklearn_vbjfa import RobotIdentifier
    >>> from sklearn_vbjfa.fit import FitOptions
    >>> options = FitOptions(standstill=0.01, alike=None)
    >>> robot = RobotIdentifier("arm.urdf", dt=0.01, options=options)
    """

    state_cutoff: object = "auto"
    standstill: object = "auto"
    joint_weights: object = "auto"
    torque_noise: object = None
    known_masses: Mapping[str, float] | None = None
    window: str | float = "auto"
    alike: object = "auto"
    verbose: int = 0
