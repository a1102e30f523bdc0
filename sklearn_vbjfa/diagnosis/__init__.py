"""Diagnosis: what a robot model lacks."""

from sklearn_vbjfa.diagnosis._convergence_display import ConvergenceDisplay
from sklearn_vbjfa.diagnosis._discovery import EffectDiscovery
from sklearn_vbjfa.diagnosis._display import ResidualDisplay
from sklearn_vbjfa.diagnosis._noise_display import NoiseDisplay
from sklearn_vbjfa.diagnosis._parameter_display import ParameterDisplay
from sklearn_vbjfa.diagnosis._report import Report
from sklearn_vbjfa.diagnosis._residual_analysis import (
    ResidualAnalysis,
    analyse_residuals,
)

__all__ = [
    "ConvergenceDisplay",
    "EffectDiscovery",
    "NoiseDisplay",
    "ParameterDisplay",
    "Report",
    "ResidualAnalysis",
    "ResidualDisplay",
    "analyse_residuals",
]
