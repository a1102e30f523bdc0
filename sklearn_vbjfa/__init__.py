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

# Where each name is. It is imported when it is first asked for: a program is at work at
# once, and can be stopped while the rest is loaded.
_MODULES = {
    "diagnosis._discovery": ("EffectDiscovery",),
    "model._loading": ("load_model",),
    "physical": ("PhysicalProjector",),
    "regression._instrumental_variables": ("InstrumentalVariables",),
    "regression._joint_factor": ("JFARegressor",),
    "regression._locally_weighted": ("LocallyWeightedRegressor",),
    "regression._stepwise": ("StepwiseRegressor",),
    "regression": ("NoiseCovariance", "TotalLeastSquares", "replicate_noise"),
    "regression._vbjfa": ("VBJFARegressor",),
    "equations._features": ("RigidBodyFeatures",),
    "robot._robot": ("IdentifiedRobot", "load_identified"),
    "fit._identifier": ("RobotIdentifier",),
    "fit._joint_torque": ("JointTorqueRegressor",),
    "robot._simulator_ranges": ("Ranges",),
    "equations._states": ("StateEstimator",),
}
_ROOMS = (
    "datasets",
    "design",
    "diagnosis",
    "distributed",
    "effects",
    "gravity",
    "inspection",
    "model",
    "physical",
    "recording",
    "regression",
    "robot",
    "simulation",
)


def _lazily(package, modules, rooms=()):
    """Return `__getattr__` and `__dir__` that import names when they are asked for."""
    # modules: names that a module below the package has, by the module, beside the
    # package if it begins with a dot; rooms: modules that are names themselves. The
    # faces of rooms are made of it as well.
    where = {name: module for module, names in modules.items() for name in names}
    known = vars(sys.modules[package])

    def get(name):
        if name in where:
            module = importlib.import_module(f".{where[name]}", package)
            found = known[name] = getattr(module, name)
            return found
        if name in rooms:
            return importlib.import_module(f".{name}", package)
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return get, lambda: sorted({*known, *where, *rooms})


__getattr__, __dir__ = _lazily(__name__, _MODULES, _ROOMS)
