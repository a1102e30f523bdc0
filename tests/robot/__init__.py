"""Tests of robot identification."""

from sklearn_vbjfa.robot import FitOptions

# Unfiltered states, all rows, no projection.
EXACT = {
    "friction": ("viscous",),
    "projector": None,
    "cutoff": None,
    "options": FitOptions(standstill=None),
}
