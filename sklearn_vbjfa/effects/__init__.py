"""Effects that a rigid-body model may lack, each a small transformer.

Names that are not in ``__all__`` are for other rooms of the package and for tests.
"""

from sklearn_vbjfa.effects._base import (
    POSITION,
    SPEED,
    TORQUE,
    Effect,
    InFiles,
    OfTime,
    Shaped,
    Stateful,
)
from sklearn_vbjfa.effects._channels import (
    Delay,
    Jerk,
    OfChannel,
    TorqueFilter,
    low_pass,
    smooth,
)
from sklearn_vbjfa.effects._drive import (
    Coupling,
    CouplingSpring,
    Elastic,
    RotorInertia,
)
from sklearn_vbjfa.effects._friction import (
    AsymmetricFriction,
    Coulomb,
    GearLoss,
    LoadFriction,
    Stribeck,
    Viscous,
    ViscousQuadratic,
)
from sklearn_vbjfa.effects._in_model import (
    BaseTilt,
    CommandDelay,
    InModel,
    JointAxis,
    JointZero,
    TorqueGain,
    TorqueLag,
    cross_axes,
    rotation,
    turned_by,
    without_rounding,
)
from sklearn_vbjfa.effects._library import (
    available,
    check_declared,
    closure,
    declarable,
    declared,
    declared_columns,
    resolve,
)
from sklearn_vbjfa.effects._memory import Backlash, MaxwellSlip, elements, play
from sklearn_vbjfa.effects._motion import (
    FAST,
    HELD,
    MARGIN,
    OUTLIERS,
    ROUNDING,
    EffectRange,
    Floats,
    Motion,
    OutsideRange,
    Rest,
    State,
    mean_sign,
    outside,
    own_motions,
)
from sklearn_vbjfa.effects._position import (
    Counterbalance,
    FrictionByPosition,
    Offset,
    Ripple,
    Spring,
)
from sklearn_vbjfa.effects._unnamed import UnnamedTorque
from sklearn_vbjfa.effects._varying import Drift, Payload, Signal

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
