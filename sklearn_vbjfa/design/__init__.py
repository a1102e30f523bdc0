"""Design of exciting trajectories."""

from typing import TYPE_CHECKING

from sklearn_vbjfa import _lazily

# What type checkers see of names that are imported when they are asked for.
if TYPE_CHECKING:
    from sklearn_vbjfa.design._design import design_motion
    from sklearn_vbjfa.design._motion import DesignedMotion, MotionLimits

__all__ = ["DesignedMotion", "MotionLimits", "design_motion"]
# The others are what tests hold against mathematics.
_MODULES = {
    "_design": "best_drawn design_motion pose read_report",
    "_motion": "DesignedMotion FourierCurve MotionLimits",
    "_collisions": "Clearance",
    "_optimise": "Lagrangian Questions worth",
    "_robot": "KnownRobot",
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
