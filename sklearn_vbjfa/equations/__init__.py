"""From recordings to states, regressor matrices, filtered equations and moments."""

from sklearn_vbjfa import _lazily

# Names that are not in __all__ are for other subpackages and tests.
_MODULES = {
    "_equations": "Equations TorqueResiduals is_load_free",
    "_features": "RigidBodyFeatures with_followers",
    "_joint_moments": "BlockAssignment piece_moments sum_moments",
    "_plan": "Plan",
    "_ranges": "EffectRange OutsideRange outside clipped_motions",
    "_repetition": "find_repetition",
    "_states": "RecordingStates",
    "_torque_noise": "filtered_noise held_rows noise_facts",
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
