"""Tests of a log against the robot description, and effects that a motion shows."""

from sklearn_vbjfa import _lazily

# Names that other subpackages and the tests import.
_MODULES = {
    "_inspect": (
        "ChannelFinding",
        "common_lag",
        "inspect_as",
        "inspect_channels",
        "inspect_recording",
        "refusal",
    ),
    "_motion": ("JointMotion", "motion_of", "one_speed"),
    "_rows": ("at_rest", "contradicted", "disorder"),
    "_reading": ("Reading", "Signals"),
    "_sentences": ("finding",),
    "_torques": ("most_explaining", "signed_columns"),
}
__all__: list[str] = []
__getattr__, __dir__ = _lazily(__name__, _MODULES)
