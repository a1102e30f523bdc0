"""Motions to record next: they determine the model and part what may be missing."""

from typing import TYPE_CHECKING

from sklearn_vbjfa import _lazily

# What type checkers see of names that are imported when they are asked for.
if TYPE_CHECKING:
    from sklearn_vbjfa.design._design import design_motion
    from sklearn_vbjfa.design._limits import MotionLimits
    from sklearn_vbjfa.design._motion import DesignedMotion

__all__ = ["DesignedMotion", "MotionLimits", "design_motion"]
# The others are what tests hold against mathematics.
_MODULES = {
    "_design": ("best_drawn", "design_motion", "pose"),
    "_limits": ("MotionLimits",),
    "_motion": ("DesignedMotion", "FourierCurve"),
    "_collisions": ("Clearance",),
    "_criterion": ("Questions", "worth"),
    "_known_robot": ("KnownRobot",),
    "_optimise": ("Lagrangian",),
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
