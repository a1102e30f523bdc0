"""Linear models with noisy inputs and outputs, made for robot identification."""

from sklearn_vbjfa.diagnosis._discovery import EffectDiscovery
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
    "replicate_noise",
]
