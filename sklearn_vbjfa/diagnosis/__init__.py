"""Diagnosis: what a robot model lacks."""

from typing import TYPE_CHECKING

from sklearn_vbjfa import _lazily

if TYPE_CHECKING:
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

_MODULES = {
    ".robot._windows": ("FailedWindow", "SimulatedWindows", "simulate_windows"),
    "_discovery": ("EffectDiscovery",),
    "displays._convergence": ("ConvergenceDisplay",),
    "displays._recordings": ("ResidualDisplay", "SimulationDisplay"),
    "displays._rows": ("NoiseDisplay", "ParameterDisplay"),
    "report._report": ("Report",),
    "search._settings": ("SearchSettings",),
}
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
__getattr__, __dir__ = _lazily(__name__, _MODULES)
