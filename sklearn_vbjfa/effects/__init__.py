"""Effects that a rigid-body model may lack, each a small transformer.

Names that are not in ``__all__`` are for other subpackages and for tests.
"""

from typing import TYPE_CHECKING

from sklearn_vbjfa import _lazily

if TYPE_CHECKING:
    from sklearn_vbjfa.effects._base import Effect, Shaped, Stateful
    from sklearn_vbjfa.effects._friction import Coulomb, LoadFriction, Stribeck, Viscous
    from sklearn_vbjfa.effects._in_model import BaseTilt, TorqueGain
    from sklearn_vbjfa.effects._library import available
    from sklearn_vbjfa.effects._memory import MaxwellSlip
    from sklearn_vbjfa.effects._position import Spring

_MODULES = {
    "_base": """
        INERTIA POSITION SPEED TORQUE Bank Converted Effect InFiles OfRobot OfSignals
        OfTime OnAllJoints Shaped Stateful Sudden
    """,
    "_channels": "Delay Jerk OfChannel TorqueFilter low_pass smooth",
    "_drive": "Coupling CouplingSpring Elastic ToAnother",
    "_friction": """
        AsymmetricFriction Coulomb GearLoss LoadFriction Offset RotorInertia Stribeck
        Viscous ViscousQuadratic
    """,
    "_in_model": """
        BaseTilt CommandDelay InModel JointAxis JointZero TorqueGain TorqueLag
        cross_axes rotation
    """,
    "_library": """
        available check_declared closure declarable declared declared_columns resolve
    """,
    "_memory": "Backlash MaxwellSlip earlier_reversals elements play",
    "_motion": "HELD Floats Motion Rest State",
    "_position": "Counterbalance FrictionByPosition Ripple Spring",
    "_unnamed": "UnnamedTorque",
    "_varying": "Drift Payload Signal Varied",
}
__all__ = [
    "BaseTilt",
    "Coulomb",
    "Effect",
    "LoadFriction",
    "MaxwellSlip",
    "Shaped",
    "Spring",
    "Stateful",
    "Stribeck",
    "TorqueGain",
    "Viscous",
    "available",
]
__getattr__, __dir__ = _lazily(__name__, _MODULES)
