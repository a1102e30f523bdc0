"""Robots: from recordings to states, equations, and an identified model."""

from sklearn_vbjfa.robot._exports import LeftOut
from sklearn_vbjfa.robot._features import RigidBodyFeatures
from sklearn_vbjfa.robot._identifier import RobotIdentifier
from sklearn_vbjfa.robot._joint_torque import JointTorqueRegressor
from sklearn_vbjfa.robot._output_error import SimulationCriteria
from sklearn_vbjfa.robot._residuals import TorqueResiduals
from sklearn_vbjfa.robot._spreads import EffectOfTime
from sklearn_vbjfa.robot._states import StateEstimator

__all__ = [
    "EffectOfTime",
    "JointTorqueRegressor",
    "LeftOut",
    "RigidBodyFeatures",
    "RobotIdentifier",
    "SimulationCriteria",
    "StateEstimator",
    "TorqueResiduals",
]
