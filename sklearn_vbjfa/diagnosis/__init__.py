"""Diagnosis: what a robot model lacks."""

from typing import TYPE_CHECKING

from sklearn_vbjfa import _lazily

if TYPE_CHECKING:
    from sklearn_vbjfa.diagnosis._discovery import EffectDiscovery
    from sklearn_vbjfa.diagnosis._displays import ResidualDisplay, TorqueDisplay
    from sklearn_vbjfa.diagnosis.report._report import Report
    from sklearn_vbjfa.diagnosis.search._posterior import SearchSettings
    from sklearn_vbjfa.robot._windows import simulate_windows

_MODULES = {
    ".robot._windows": ("simulate_windows",),
    "_discovery": ("EffectDiscovery",),
    "_displays": ("ResidualDisplay", "TorqueDisplay"),
    "report._report": ("Report",),
    "search._posterior": ("SearchSettings",),
}
__all__ = [
    "Report",
    "ResidualDisplay",
    "SearchSettings",
    "TorqueDisplay",
    "simulate_windows",
]
__getattr__, __dir__ = _lazily(__name__, _MODULES)
