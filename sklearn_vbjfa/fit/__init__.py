"""From equations to the parameters of a robot, and the estimator that users fit."""

from sklearn_vbjfa import _lazily

# What is not in __all__ is for other rooms and for tests.
_MODULES = {
    "_arguments": ("FitOptions",),
    "_bodies": ("BodyPrior", "DESCRIBED", "Departure", "SCALES", "around")
    + ("little_learned",),
    "_fit": ("ModelValues", "jump"),
    "_identifier": ("RobotIdentifier",),
    "_joint_torque": ("JointTorqueRegressor",),
    "_output_error": (
        "Normal",
        "Windows",
        "deviations",
        "propagate",
        "run_windows",
        "slopes",
    ),
    "_pooling": ("AlikeValue", "WIDTH", "most_probable"),
    "_signs": ("expected", "signed"),
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
