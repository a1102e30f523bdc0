"""Identify robots from logs and find effects missing from their dynamics models."""

import importlib
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sklearn_vbjfa.diagnosis._discovery import EffectDiscovery
    from sklearn_vbjfa.equations._features import RigidBodyFeatures
    from sklearn_vbjfa.equations._states import StateEstimator
    from sklearn_vbjfa.fit._identifier import RobotIdentifier
    from sklearn_vbjfa.fit._joint_torque import JointTorqueRegressor
    from sklearn_vbjfa.model._loading import load_model
    from sklearn_vbjfa.physical import PhysicalProjector
    from sklearn_vbjfa.regression._instrumental_variables import InstrumentalVariables
    from sklearn_vbjfa.regression._joint_factor import JFARegressor
    from sklearn_vbjfa.regression._locally_weighted import LocallyWeightedRegressor
    from sklearn_vbjfa.regression._stepwise import StepwiseRegressor
    from sklearn_vbjfa.regression._total_least_squares import (
        NoiseCovariance,
        TotalLeastSquares,
        replicate_noise,
    )
    from sklearn_vbjfa.regression._vbjfa import VBJFARegressor
    from sklearn_vbjfa.robot._robot import IdentifiedRobot, load_identified
    from sklearn_vbjfa.robot._simulator_ranges import Ranges

__version__ = "0.2.0.dev0"
__all__ = [
    "EffectDiscovery",
    "IdentifiedRobot",
    "InstrumentalVariables",
    "JFARegressor",
    "JointTorqueRegressor",
    "LocallyWeightedRegressor",
    "NoiseCovariance",
    "PhysicalProjector",
    "Ranges",
    "RigidBodyFeatures",
    "RobotIdentifier",
    "StateEstimator",
    "StepwiseRegressor",
    "TotalLeastSquares",
    "VBJFARegressor",
    "load_identified",
    "load_model",
    "replicate_noise",
]

# Modules of the public names, which are imported at their first use: importing all of
# them takes seconds.
_MODULES = {
    "diagnosis._discovery": "EffectDiscovery",
    "model._loading": "load_model",
    "physical": "PhysicalProjector",
    "regression._instrumental_variables": "InstrumentalVariables",
    "regression._joint_factor": "JFARegressor",
    "regression._locally_weighted": "LocallyWeightedRegressor",
    "regression._stepwise": "StepwiseRegressor",
    "regression": "NoiseCovariance TotalLeastSquares replicate_noise",
    "regression._vbjfa": "VBJFARegressor",
    "equations._features": "RigidBodyFeatures",
    "robot._robot": "IdentifiedRobot load_identified",
    "fit._identifier": "RobotIdentifier",
    "fit._joint_torque": "JointTorqueRegressor",
    "robot._simulator_ranges": "Ranges",
    "equations._states": "StateEstimator",
}
_SUBPACKAGES = """
    datasets design diagnosis distributed effects gravity inspection model physical
    recording regression robot simulation
"""


def _lazily(package, modules, subpackages=""):
    """Return `__getattr__` and `__dir__` that import names at their first use."""
    # modules: the names that each module of the package defines; its path is relative
    # to the package, with a dot to its parent.
    where = {
        name: module
        for module, names in modules.items()
        for name in (names.split() if isinstance(names, str) else names)
    }
    known, subpackages = vars(sys.modules[package]), subpackages.split()

    def get(name):
        if name in where:
            module = importlib.import_module(f".{where[name]}", package)
            found = known[name] = getattr(module, name)
            return found
        if name in subpackages:
            return importlib.import_module(f".{name}", package)
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return get, lambda: sorted({*known, *where, *subpackages})


__getattr__, __dir__ = _lazily(__name__, _MODULES, _SUBPACKAGES)
