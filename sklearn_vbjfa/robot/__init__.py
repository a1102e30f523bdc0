"""Identified robots: predictions, simulation, samples and files.

Settings of `RobotIdentifier` and drives are here as well, for users.
"""

from typing import TYPE_CHECKING

from sklearn_vbjfa import _lazily

# What type checkers see of names that are imported when they are asked for.
if TYPE_CHECKING:
    from sklearn_vbjfa.fit._arguments import FitOptions
    from sklearn_vbjfa.recording._drives import CurrentDrive, PDDrive, VoltageDrive

__all__ = ["CurrentDrive", "FitOptions", "PDDrive", "VoltageDrive"]

# Names that are not in __all__ are for other subpackages and tests.
_MODULES = {
    ".fit": "FitOptions",
    ".recording": "CurrentDrive PDDrive VoltageDrive",
    "_channels": "ChannelGains CommonGain",
    "_corrections": "Correction corrections_of",
    "_exports": "TERMS changed_motion to_mjcf typical_motion",
    "_posterior": "BetweenRecordings Marginal Posterior note_of_masses",
    "_simulator_ranges": "ParameterRange Ranges",
    "_windows": "clearly_smaller follow_windows",
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
