"""Tests of the robot chain."""

from sklearn_vbjfa.robot import FitOptions

# States as they are, all rows, no filter and no projection.
EXACT = {
    "friction": ("viscous",),
    "projector": None,
    "cutoff": None,
    "options": FitOptions(standstill=None),
}
