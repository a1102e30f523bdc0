"""Robots: from recordings to states, equations, and an identified model."""

from typing import TYPE_CHECKING

from sklearn_vbjfa import _lazily

# What type checkers see of names that are imported when they are asked for.
if TYPE_CHECKING:
    from sklearn_vbjfa.recording import CurrentDrive, PDDrive, VoltageDrive
    from sklearn_vbjfa.robot._equations import TorqueResiduals
    from sklearn_vbjfa.robot._features import RigidBodyFeatures
    from sklearn_vbjfa.robot._identifier import FitOptions, RobotIdentifier
    from sklearn_vbjfa.robot._joint_torque import JointTorqueRegressor
    from sklearn_vbjfa.robot._states import StateEstimator

__all__ = [
    "CurrentDrive",
    "FitOptions",
    "JointTorqueRegressor",
    "PDDrive",
    "RigidBodyFeatures",
    "RobotIdentifier",
    "StateEstimator",
    "TorqueResiduals",
    "VoltageDrive",
]

# Values and findings that are not in __all__ are for other rooms and for tests.
_MODULES = {
    "_alike": ("AlikeValue",),
    "_bodies": ("Departure",),
    "_corrections": (
        "AxisCorrection",
        "Corrections",
        "GainCorrection",
        "TiltCorrection",
        "ZeroCorrection",
        "corrections_of",
        "note_of_corrections",
    ),
    "_equations": ("Equations", "TorqueResiduals", "is_plain"),
    "_estimate": ("estimate", "project"),
    "_features": ("RigidBodyFeatures",),
    "_fit": ("ModelValues",),
    "_gains": ("ChannelGains", "CommonGain", "KnownMass"),
    "_identifier": ("FitOptions", "RobotIdentifier"),
    ".recording._drives": ("CurrentDrive", "PDDrive", "VoltageDrive"),
    "_joint_moments": (
        "JointMoments",
        "BlockAssignment",
        "piece_moments",
        "sum_moments",
    ),
    "_joint_torque": ("JointTorqueRegressor",),
    "_output_error": ("slopes",),
    "_plan": ("MotionFacts", "Plan"),
    "_posterior": ("BetweenRecordings", "Marginal", "Posterior"),
    "_signs": ("signed",),
    "_simulator_ranges": ("ParameterRange", "Ranges"),
    "_spreads": (
        "BodyMass",
        "SignalRanges",
        "body_masses",
        "note_of_masses",
    ),
    "_states": ("RecordingStates", "StateEstimator"),
    "_windows": ("follow_windows",),
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
