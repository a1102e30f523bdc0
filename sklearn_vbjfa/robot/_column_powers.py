"""How large the torques of friction and effects were in a fitted recording."""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.effects import TorqueGain


@dataclass(frozen=True, kw_only=True, eq=False)
class ColumnPowers:
    """Mean products of the columns of friction and effects in a fitted recording."""

    # The square of the root mean square of an effect's torque is coef' (products) coef.

    friction: np.ndarray  # (nv, n_friction): mean squares of the declared columns
    # (nv, k, k): products of each effect's columns in the equations of every joint; nan
    # where they are not known
    effects: tuple = ()

    @classmethod
    def of_moments(cls, moments, n_rigid, n_friction, effects, gains):
        """Take them from a fit's `JointMoments`, whose columns are the parameters."""
        # The effects come last, in the first of several passes fewer; gains (nv,): what
        # the rows of each joint are multiplied by.
        nv = moments.n.size
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = moments.G / (np.asarray(gains) ** 2 * moments.n)[:, None, None]
        own = mean[:, :n_rigid, :n_rigid].diagonal(axis1=1, axis2=2)
        width = n_rigid // nv
        own = own.reshape(nv, nv, width)[np.arange(nv), np.arange(nv)]
        found, at = [], n_rigid
        for effect in effects:
            stop = at + len(effect.coefficients)
            block = mean[:, at:stop, at:stop].copy()
            if isinstance(effect, TorqueGain):
                # Its column is the true torque already.
                block *= (np.asarray(gains) ** 2)[:, None, None]
            # Values in the model have columns only where they are corrected.
            if effect.in_model and not block.any():
                block[:] = np.nan
            found.append(block)
            at = stop
        return cls(friction=own[:, width - n_friction :].copy(), effects=tuple(found))

    def with_tangents(self, other, effects):
        """Return them with the products of effects in the model from others."""
        taken = [
            theirs if effect.in_model else ours
            for effect, ours, theirs in zip(effects, self.effects, other.effects)
        ]
        return replace(self, effects=tuple(taken))

    def in_units(self, unit):
        """Return them with torques in another unit, of this size in the present one."""
        scale = 1.0 / unit**2
        return ColumnPowers(
            friction=scale * self.friction,
            effects=tuple(scale * block for block in self.effects),
        )
