"""Identified robots in motion: forward dynamics, and torques one state at a time.

Everything here takes a `TorqueModel`, the result of an identification without data and
estimator. Names that are not in ``__all__`` are for other subpackages and for tests.
"""

from sklearn_vbjfa.simulation._dynamics import ForwardDynamics
from sklearn_vbjfa.simulation._integrate import Integrator
from sklearn_vbjfa.simulation._simulate import (
    SimulationError,
    recorded,
    simulate,
    simulate_controlled,
)
from sklearn_vbjfa.simulation._stepper import (
    LeftOut,
    Load,
    Stepper,
    TorqueModel,
    causal,
    why_left_out,
)

__all__ = ["SimulationError"]
