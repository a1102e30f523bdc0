"""Physical consistency of rigid-body parameters: what it is and how to restore it."""

from sklearn_vbjfa.physical._layout import ParameterLayout, resolve_layout
from sklearn_vbjfa.physical._programme import ProjectionError
from sklearn_vbjfa.physical._projection import ProjectionResult, project
from sklearn_vbjfa.physical._projector import PhysicalProjector
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
from sklearn_vbjfa.physical._virtual import (
    inertial_from_virtual,
    virtual_curvature,
    virtual_from_inertial,
    virtual_jacobian,
)

__all__ = [
    "ParameterLayout",
    "PhysicalProjector",
    "ProjectionError",
    "ProjectionResult",
    "body_scales",
    "constraint_matrix",
    "inertia_matrix",
    "inertial_from_virtual",
    "inertial_parameters",
    "is_consistent",
    "min_eigenvalue",
    "parameter_units",
    "project",
    "pseudo_inertia",
    "resolve_layout",
    "spatial_inertia",
    "virtual_curvature",
    "virtual_from_inertial",
    "virtual_jacobian",
]
