"""Results of a finished search, as plain data."""

from sklearn_vbjfa import _lazily

# For the report, the command line and tests; users get them from `EffectDiscovery`.
_MODULES = {
    "_curves": "torque_curves",
    "_effects": "DiscoveredEffect discovered_effects named_values",
    "_errors": "NEXT_SECONDS error_intervals held_out_errors",
    "_final": "EffectEstimate FinalFit",
    "_gaps": """
        ABOVE_FLOOR Dependence NO_INFORMATION NotIdentifiable Unexplained WELL WORSE
        dependences is_refuted motion_signals rises
    """,
    "_next": "ExpectedError MotionStatistics motion_statistics",
    "_outcome": "Fact JointErrors Outcome make_outcome parameter_values",
    "_recordings": "Contradiction RecordingMoments contradictions",
    "_split": "split_in_time",
    "_unnamed": "supported_terms unnamed_torques",
}
__all__ = []
__getattr__, __dir__ = _lazily(__name__, _MODULES)
