"""Figures of fitted models, drawn by matplotlib."""

from sklearn_vbjfa import _lazily

# For the command line and the tests; users get `sklearn_vbjfa.diagnosis`.
_MODULES = {"_recordings": ("running_median",)}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
