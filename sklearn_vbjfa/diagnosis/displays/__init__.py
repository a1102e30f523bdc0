"""Figures of fitted models, drawn by matplotlib."""

from sklearn_vbjfa import lazy_names

# For the command line and the tests; users get `sklearn_vbjfa.diagnosis`.
__getattr__, __dir__ = lazy_names(
    __name__, {"running_median": "_recordings", "windows_of": "_recordings"}
)
