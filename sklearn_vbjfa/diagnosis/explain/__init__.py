"""Results of a finished search, each a function and a finding."""

from sklearn_vbjfa import _lazily

# Nothing of it is for users but what `EffectDiscovery` hands on.
_MODULES = {
    "_contradictions": """
        Contradiction Contradictions Deviation Parts contradictions
    """,
    "_curves": """
        FrictionCurves ResidualCurves TimeLine TorqueCurves cloud_size
        curve_size curves_over effect_curves extremes time_line
    """,
    "_gaps": """
        ABOVE_FLOOR Dependence Hidden Unexplained dependences
        inseparable motion_signals p_value
    """,
    "_identified": """
        ParameterValue RecordedMotion parameter_values
    """,
    "_intervals": """
        EffectEstimate FinalFit NEXT_SECONDS added_effects error_intervals
    """,
    "_judgement": """
        CommandsAlone ConsistencyCost Models commands_alone judge
    """,
    "_next": """
        Expectation Motions NextRecording given_motion
    """,
    "_outcome": """
        DiscoveredEffect Outcome Provenance make_outcome named_values
    """,
    "_split": """
        split_in_time
    """,
    "_unnamed": """
        unnamed_torques
    """,
}
__all__ = []
__getattr__, __dir__ = _lazily(
    __name__, {name: tuple(names.split()) for name, names in _MODULES.items()}
)
