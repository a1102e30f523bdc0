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
    """Parameters that the load and the torque in effects' columns are made with.

    They are those of the fit before the last one, and differ a little from the final
    ones; see `sklearn_vbjfa.robot._equations.make_motion`.

    Attributes
    ----------
    bodies : ndarray of shape (nv, 10)
        Inertial parameters.
    friction : ndarray of shape (nv, n_friction)
        Coefficients of the declared friction.
    coefficients : tuple of ndarray
        Those of each effect; empty arrays for effects that need a load themselves.
    """

    bodies: np.ndarray
    friction: np.ndarray
    coefficients: tuple


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueModel:
    """An identified robot: bodies, friction, effects, and what its channels read.

    Attributes
    ----------
    model : pinocchio.Model
        Geometry and gravity, as the effects in the model correct them. Its inertias
        are not used.
    bodies : ndarray of shape (nv, 10)
        Identified inertial parameters, Pinocchio's order.
    friction_names : tuple of str
        Declared friction columns, such as ("viscous", "coulomb").
    friction : ndarray of shape (nv, n_friction)
        Their coefficients.
    effects : tuple of Effect
        Effects in use, those in the model (`in_model`) among them.
    coefficients : tuple of ndarray
        Linear coefficients of each effect; of one in the model its values, which act
        through `model` and `gains` alone.
    ranges : tuple of EffectRange or None
        What each effect is held within, None where nothing is held; empty holds none.
    gains : ndarray of shape (nv,)
        What each torque channel reads over the true torque.
    load : Load or None
        None if no effect needs a load.
    rest : Rest or None
        Speeds at or below which joints may be standing; see `Rest`.
    since : float or None
        First time of the fit [s], where effects of time begin; None without such.
    dt : float or None
        Sample period of the fit [s].
    """

    model: "pin.Model"
    bodies: np.ndarray
    friction_names: tuple
    friction: np.ndarray
    effects: tuple = ()
    coefficients: tuple = ()
    ranges: tuple = ()
    gains: np.ndarray
    load: Load | None = None
    rest: Rest | None = None
    since: float | None = None
    dt: float | None = None

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
