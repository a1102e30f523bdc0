"""Linear models with noisy inputs and outputs, made for robot identification."""

import importlib
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sklearn_vbjfa.diagnosis._discovery import EffectDiscovery
    from sklearn_vbjfa.model._loading import load_model
    from sklearn_vbjfa.physical import PhysicalProjector
    from sklearn_vbjfa.regression._instrumental_variables import InstrumentalVariables
    from sklearn_vbjfa.regression._jfa import JFARegressor
    from sklearn_vbjfa.regression._locally_weighted import LocallyWeightedRegressor
    from sklearn_vbjfa.regression._replicates import NoiseCovariance, replicate_noise
    from sklearn_vbjfa.regression._stepwise import StepwiseRegressor
    from sklearn_vbjfa.regression._total_least_squares import TotalLeastSquares
    from sklearn_vbjfa.regression._vbjfa import VBJFARegressor
    from sklearn_vbjfa.robot._features import RigidBodyFeatures
    from sklearn_vbjfa.robot._identified import IdentifiedRobot, load_identified
    from sklearn_vbjfa.robot._identifier import RobotIdentifier
    from sklearn_vbjfa.robot._joint_torque import JointTorqueRegressor
    from sklearn_vbjfa.robot._states import StateEstimator

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
    "EffectDiscovery": "diagnosis._discovery",
    "IdentifiedRobot": "robot._identified",
    "InstrumentalVariables": "regression._instrumental_variables",
    "JFARegressor": "regression._jfa",
    "JointTorqueRegressor": "robot._joint_torque",
    "LocallyWeightedRegressor": "regression._locally_weighted",
    "NoiseCovariance": "regression._replicates",
    "PhysicalProjector": "physical",
    "RigidBodyFeatures": "robot._features",
    "RobotIdentifier": "robot._identifier",
    "StateEstimator": "robot._states",
    "StepwiseRegressor": "regression._stepwise",
    "TotalLeastSquares": "regression._total_least_squares",
    "VBJFARegressor": "regression._vbjfa",
    "load_identified": "robot._identified",
    "load_model": "model._loading",
    "replicate_noise": "regression._replicates",
}
_ROOMS = (
    "datasets",
    "diagnosis",
    "distributed",
    "effects",
    "inspection",
    "model",
    "physical",
    "recording",
    "regression",
    "robot",
    "simulation",
)


def lazy_names(package, modules, whole=None):
    """Return `__getattr__` and `__dir__` of a package that imports names when asked."""
    # modules: of each name the module below the package that has it; whole: of names of
    # modules themselves.
    whole = whole or {}

    def __getattr__(name):
        own = whole.get(name) or modules.get(name)
        if own is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = importlib.import_module(f"{package}.{own}")
        found = module if name in whole else getattr(module, name)
        vars(sys.modules[package])[name] = found
        return found

    def __dir__():
        return sorted({*vars(sys.modules[package]), *modules, *whole})

    return __getattr__, __dir__


__getattr__, __dir__ = lazy_names(__name__, _MODULES, {room: room for room in _ROOMS})
