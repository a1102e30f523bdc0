"""Effects that a rigid-body model may lack, each a small transformer."""

from sklearn_vbjfa.effects._base import Effect, JointEffect, Motion
from sklearn_vbjfa.effects._channels import Delay, Jerk, TorqueFilter
from sklearn_vbjfa.effects._drive import Coupling, Elastic, RotorInertia
from sklearn_vbjfa.effects._friction import (
    AsymmetricFriction,
    Coulomb,
    LoadFriction,
    Stribeck,
    Viscous,
    ViscousQuadratic,
)
from sklearn_vbjfa.effects._hysteresis import Backlash, Presliding
from sklearn_vbjfa.effects._in_model import (
    BaseTilt,
    JointAxis,
    JointZero,
    ModelEffect,
    TorqueGain,
)
from sklearn_vbjfa.effects._library import available, resolve
from sklearn_vbjfa.effects._position import Counterbalance, Offset, Ripple, Spring
from sklearn_vbjfa.effects._ranges import EffectRange
from sklearn_vbjfa.effects._signals import Signal
from sklearn_vbjfa.effects._time import Drift, Payload

__all__ = [
    "AsymmetricFriction",
    "Backlash",
    "BaseTilt",
    "Coulomb",
    "Counterbalance",
    "Coupling",
    "Delay",
    "Drift",
    "Effect",
    "EffectRange",
    "Elastic",
    "Jerk",
    "JointAxis",
    "JointEffect",
    "JointZero",
    "LoadFriction",
    "ModelEffect",
    "Motion",
    "Offset",
    "Payload",
    "Presliding",
    "Ripple",
    "RotorInertia",
    "Signal",
    "Spring",
    "Stribeck",
    "TorqueFilter",
    "TorqueGain",
    "Viscous",
    "ViscousQuadratic",
    "available",
    "resolve",
]
