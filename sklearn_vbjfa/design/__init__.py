"""Motions to record next: they determine the model and part what may be missing."""

from sklearn_vbjfa.design._design import design_motion
from sklearn_vbjfa.design._limits import MotionLimits
from sklearn_vbjfa.design._motion import DesignedMotion

__all__ = ["DesignedMotion", "MotionLimits", "design_motion"]
