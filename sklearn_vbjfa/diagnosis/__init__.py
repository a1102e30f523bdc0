"""Diagnosis: what a robot model lacks."""

from sklearn_vbjfa.diagnosis._discovery import EffectDiscovery
from sklearn_vbjfa.diagnosis._display import ResidualDisplay
from sklearn_vbjfa.diagnosis._report import Report
from sklearn_vbjfa.diagnosis._residual_analysis import (
    ResidualAnalysis,
    analyse_residuals,
)

__all__ = [
    "EffectDiscovery",
    "Report",
    "ResidualAnalysis",
    "ResidualDisplay",
    "analyse_residuals",
]
