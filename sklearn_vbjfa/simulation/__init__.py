"""Identified robots in motion: forward dynamics, and torques one state at a time.

Everything here takes a `TorqueModel`, which is what an identification leaves when data
and estimator are put away.
"""

from sklearn_vbjfa.simulation._controller import PositionController
from sklearn_vbjfa.simulation._simulate import SimulationError
from sklearn_vbjfa.simulation._torque_model import Load, TorqueModel

__all__ = ["Load", "PositionController", "SimulationError", "TorqueModel"]
