"""Robots: from recordings to states, equations, and an identified model."""

from sklearn_vbjfa import _lazily

__all__ = [
    "CurrentDrive",
    "EffectOfTime",
    "JointTorqueRegressor",
    "LeftOut",
    "PDDrive",
    "RigidBodyFeatures",
    "RobotIdentifier",
    "SimulationCriteria",
    "StateEstimator",
    "TorqueResiduals",
    "VoltageDrive",
]

# Values and findings that are not in __all__ are for other rooms and for tests.
_MODULES = {
    "_alike": ("AlikeValue",),
    "_bodies": ("Departure",),
    "_comparison": ("OURS", "compare_methods", "methods"),
    "_corrections": (
        "AxisCorrection",
        "Corrections",
        "GainCorrection",
        "TiltCorrection",
        "ZeroCorrection",
        "corrections_of",
        "note_of_corrections",
    ),
    "_equations": ("Equations", "is_plain"),
    "_estimate": ("estimate", "project"),
    "_exports": ("LeftOut",),
    "_features": ("RigidBodyFeatures",),
    "_fit": ("ModelValues",),
    "_gains": ("ChannelGains", "CommonGain", "KnownMass"),
    "_identifier": ("RobotIdentifier",),
    ".recording._drives": ("CurrentDrive", "PDDrive", "VoltageDrive"),
    "_joint_moments": (
        "JointMoments",
        "Numbering",
        "joint_moments",
        "piece_moments",
        "sum_moments",
    ),
    "_joint_torque": ("JointTorqueRegressor",),
    "_output_error": ("SimulationCriteria",),
    "_plan": ("MotionFacts", "Plan"),
    "_posterior": ("BetweenRecordings", "Marginal", "Posterior"),
    "_ranges": ("SignalRanges",),
    "_residuals": ("TorqueResiduals", "collect_residuals"),
    "_sensitivities": ("slopes",),
    "_signs": ("signed",),
    "_simulator_ranges": ("ParameterRange", "Ranges"),
    "_spreads": (
        "BodyMass",
        "ColumnPowers",
        "EffectOfTime",
        "Spread",
        "body_masses",
        "note_of_masses",
    ),
    "_states": ("RecordingStates", "StateEstimator"),
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
