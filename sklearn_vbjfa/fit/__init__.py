"""Estimation of the parameters of a robot."""

from sklearn_vbjfa import _lazily

# Names for other subpackages and tests.
_MODULES = {
    "_arguments": "FitOptions",
    "_bodies": "BodyPrior DESCRIBED Departure SCALES around little_learned",
    "_fit": "ModelValues equivalent_corner",
    "_identifier": "RobotIdentifier",
    "_joint_torque": "JointTorqueRegressor",
    "_output_error": "Normal Windows deviations propagate run_windows slopes",
    "_rotor_prior": "rotor_posterior",
    "_shared_drives": "AlikeValue",
    "_signs": "expected signed",
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
