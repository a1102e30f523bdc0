"""Physical consistency of rigid-body parameters, and projection onto it."""

from sklearn_vbjfa.physical._projection import Options, PhysicalProjector
from sklearn_vbjfa.physical._pseudo_inertia import (
    INERTIAL_NAMES,
    body_scales,
    inertia_matrix,
    inertial_parameters,
    is_consistent,
    min_eigenvalue,
    pseudo_inertia,
)
from sklearn_vbjfa.physical._solver import ProjectionError

# Public in `sklearn_vbjfa`: `PhysicalProjector`; others are for subpackages and tests.
__all__ = ["Options", "ProjectionError", "is_consistent"]
