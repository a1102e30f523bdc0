"""Physical consistency of rigid-body parameters: what it is and how to restore it."""

from sklearn_vbjfa.physical._layout import ParameterLayout, resolve_layout
from sklearn_vbjfa.physical._projection import ProjectionResult, project
from sklearn_vbjfa.physical._projector import PhysicalProjector
from sklearn_vbjfa.physical._pseudo_inertia import (
    INERTIAL_NAMES as INERTIAL_NAMES,
)
from sklearn_vbjfa.physical._pseudo_inertia import (
    body_scales,
    constraint_matrix,
    inertia_matrix,
    inertial_parameters,
    is_consistent,
    min_eigenvalue,
    parameter_units,
    pseudo_inertia,
    spatial_inertia,
)
from sklearn_vbjfa.physical._solver import ProjectionError
from sklearn_vbjfa.physical._solver import one_blas_thread as one_blas_thread

# What is imported under its own name is for other rooms and tests, not for users.
__all__ = [
    "ParameterLayout",
    "PhysicalProjector",
    "ProjectionError",
    "ProjectionResult",
    "body_scales",
    "constraint_matrix",
    "inertia_matrix",
    "inertial_parameters",
    "is_consistent",
    "min_eigenvalue",
    "parameter_units",
    "project",
    "pseudo_inertia",
    "resolve_layout",
    "spatial_inertia",
]
