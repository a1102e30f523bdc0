"""Linear models with noisy inputs and outputs, made for robot identification."""

from sklearn_vbjfa._jfa import JFARegressor
from sklearn_vbjfa._vbjfa import VBJFARegressor

__version__ = "0.1.0.dev0"
__all__ = ["JFARegressor", "VBJFARegressor"]
