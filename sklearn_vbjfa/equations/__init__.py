"""From recordings to states, regressor matrices, filtered equations and moments."""

from sklearn_vbjfa import _lazily

# What is not in __all__ is for other rooms and for tests.
_MODULES = {
    "_equations": ("Equations", "TorqueResiduals", "build_segments", "is_plain"),
    "_features": ("RigidBodyFeatures", "with_followers"),
    "_joint_moments": (
        "BlockAssignment",
        "JointMoments",
        "piece_moments",
        "sum_moments",
    ),
    "_plan": ("MotionFacts", "Plan"),
    "_ranges": ("SignalRanges",),
    "_states": ("RecordingStates", "StateEstimator"),
    "_torque_noise": ("filtered_noise", "held_rows", "noise_facts"),
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
