"""Diagnosis: what a robot model lacks."""

from sklearn_vbjfa.diagnosis._discovery import EffectDiscovery
from sklearn_vbjfa.diagnosis.displays._convergence import ConvergenceDisplay
from sklearn_vbjfa.diagnosis.displays._recordings import (
    ResidualDisplay,
    SimulationDisplay,
)
from sklearn_vbjfa.diagnosis.displays._rows import NoiseDisplay, ParameterDisplay
from sklearn_vbjfa.diagnosis.report._report import Report
from sklearn_vbjfa.diagnosis.search._settings import SearchSettings
from sklearn_vbjfa.robot._windows import (
    FailedWindow,
    SimulatedWindows,
    simulate_windows,
)

__all__ = [
    "ConvergenceDisplay",
    "EffectDiscovery",
    "FailedWindow",
    "NoiseDisplay",
    "ParameterDisplay",
    "Report",
    "ResidualDisplay",
    "SearchSettings",
    "SimulatedWindows",
    "SimulationDisplay",
    "simulate_windows",
]
