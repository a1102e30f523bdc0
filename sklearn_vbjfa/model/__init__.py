"""Robot descriptions and regressor matrices: the interface to Pinocchio."""

from sklearn_vbjfa import _lazily

# Public as `sklearn_vbjfa.load_model`; the rest is for other subpackages.
_MODULES = {
    "_dynamics": "CorrectedModel TorqueDerivatives TreeRegressor rounding_entries",
    "_loading": """
        build_model description_text load_folded load_model load_reduced load_text
        movable_joints write_reduced
    """,
    "_mjcf": "JointDynamics write_mjcf",
    "_shapes": "NoShapes import_coal load_shapes",
    "_trees": """
        body_names describe end_joints import_pinocchio in_order is_prismatic
        joint_names joint_origin nominal_parameters position_range solid_bodies
        with_bodies with_joints
    """,
    "_urdf": "write_urdf",
}
__all__: list[str] = []
__getattr__, __dir__ = _lazily(__name__, _MODULES)


class DoubtWarning(UserWarning):
    """Part of the input is not used in a result, or the result may be wrong."""
