"""What an identified robot is made of, without data and estimator."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sklearn_vbjfa.effects import OfChannel, Rest
from sklearn_vbjfa.model import joint_names

if TYPE_CHECKING:
    import pinocchio as pin


@dataclass(frozen=True, kw_only=True, eq=False)
class Load:
    """Parameters that the load and the torque in effects' columns are made with."""

    # They are those of the fit before the last one, and differ a little from the final
    # ones; see `sklearn_vbjfa.robot._equations.make_motion`.
    bodies: np.ndarray  # (nv, 10)
    friction: np.ndarray  # (nv, n_friction): of the declared friction
    coefficients: tuple  # of each effect; empty for effects that need a load themselves


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueModel:
    """An identified robot: bodies, friction, effects, and what its channels read."""

    # Geometry and gravity, as the effects in the model correct them, without inertias.
    model: "pin.Model"
    bodies: np.ndarray  # (nv, 10): inertial parameters in Pinocchio's order
    friction_names: tuple  # declared columns, such as ("viscous", "coulomb")
    friction: np.ndarray  # (nv, n_friction): their coefficients
    effects: tuple = ()  # those in the model (`in_model`) among them
    # Of each effect; those of one in the model act through `model` and `gains` alone.
    coefficients: tuple = ()
    ranges: tuple = ()  # `EffectRange` of each effect or None; empty holds none
    gains: np.ndarray  # (nv,): what each torque channel reads over the true torque
    load: Load | None = None  # None if no effect needs a load
    rest: Rest | None = None  # speeds at or below which joints may be standing
    since: float | None = None  # first time of the fit [s], where effects of time begin
    dt: float | None = None  # sample period of the fit [s]

    @property
    def held(self):
        """Range of each effect, a tuple of EffectRange or None."""
        return self.ranges or (None,) * len(self.effects)

    @property
    def n_joints(self):
        """Number of joints."""
        return self.model.nv

    @property
    def joint_names(self):
        """Names of the joints, tuple of str."""
        return joint_names(self.model)

    def true_torques(self, tau, t):
        """Turn measured torques (n, nv) at times t (n,) into those at the joints."""
        out = tau / self.gains
        for effect, coef in zip(self.effects, self.coefficients):
            if isinstance(effect, OfChannel) and t.size > 1:
                j = effect.joint
                out[:, j] = effect.taken_back(coef, out[:, j], t)
        return out

    def own_effects(self):
        """Effects that are not in the model, with coefficients and what holds them."""
        every = zip(self.effects, self.coefficients, self.held, strict=True)
        return [one for one in every if not one[0].in_model]
