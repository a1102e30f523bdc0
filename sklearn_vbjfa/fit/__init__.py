"""From equations to the parameters of a robot, and the estimator that users fit."""

from typing import TYPE_CHECKING

from sklearn_vbjfa import _lazily

# What type checkers see of names that are imported when they are asked for.
if TYPE_CHECKING:
    from sklearn_vbjfa.fit._arguments import FitOptions
    from sklearn_vbjfa.fit._identifier import RobotIdentifier
    from sklearn_vbjfa.fit._joint_torque import JointTorqueRegressor

__all__: list[str] = []

# What is not in __all__ is for other rooms and for tests.
_MODULES = {
    "_alike": ("AlikeValue", "WIDTH", "most_probable"),
    "_arguments": ("FitOptions",),
    "_bodies": ("BodyPrior", "DESCRIBED", "Departure", "SCALES", "Site", "around")
    + ("little_learned",),
    "_fit": ("ModelValues", "jump"),
    "_gains": ("relative_gains",),
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
    "_signs": ("expected", "signed"),
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
