"""Diagnosis of effects that are missing from a robot model."""

from sklearn_vbjfa.diagnosis._displays import ResidualDisplay, TorqueDisplay
from sklearn_vbjfa.diagnosis.report._report import Report
from sklearn_vbjfa.diagnosis.search._posterior import SearchSettings
from sklearn_vbjfa.robot._windows import simulate_windows

__all__ = [
    "Report",
    "ResidualDisplay",
    "SearchSettings",
    "TorqueDisplay",
    "simulate_windows",
]
