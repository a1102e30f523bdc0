"""What effects of time add to a prediction, and how well that is known."""

from dataclasses import dataclass

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.effects import TORQUE

# Relative step of the derivative by a shape parameter.
_STEP = 1e-3
# Time outside the fit, as a share of its duration, from which a prediction says so.
_MARGIN = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class Spread:
    """How well an effect's coefficients and shape are known.

    Attributes
    ----------
    shape : tuple of str
        Shape parameters that were tuned with the coefficients.
    covariance : ndarray of shape (k + n_shape, k + n_shape)
        Joint covariance of coefficients and shape.
    """

    shape: tuple
    covariance: np.ndarray

    @classmethod
    def of_deviations(cls, deviations):
        """Independent coefficients with given deviations (k,), the shape as given."""
        return cls(shape=(), covariance=np.diag(np.square(deviations)))


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectOfTime:
    """The share of an effect of time in predicted torques.

    Attributes
    ----------
    name : str
        Effect.
    label : str
        What an engineer calls it.
    joint : int
        Joint, from zero.
    torque : ndarray of shape (n, nv)
        What it adds [N m or N].
    std : ndarray of shape (n, nv)
        Standard deviation of that [N m or N], from the covariance of its coefficients
        and of the shape parameters that were tuned with them; nan where the regressor
        tells none.
    beyond : ndarray of shape (n,)
        Time of each row after the last one of the fit [s]; negative before the first
        one, zero in between.
    """

    name: str
    label: str
    joint: int
    torque: np.ndarray
    std: np.ndarray
    beyond: np.ndarray


def effect_of_time(effect, coef, spread, motion, time):
    """Compute the share of an effect with coefficients (k,) in a motion.

    spread : `Spread`; time : first and last time of the fit [s].
    """

    def columns(one):
        made = one.columns(motion)
        if one.whole_robot:
            return made
        own = np.zeros((made.shape[0], motion.n_joints, made.shape[1]))
        own[:, one.joint] = made
        return own

    own = columns(effect)
    slopes = []
    for name in spread.shape:
        value = getattr(effect, name)
        step = _STEP * abs(value)
        above, below = (
            columns(clone(effect).set_params(**{name: value + way * step})) @ coef
            for way in (0.5, -0.5)
        )
        slopes.append(((above - below) / step)[:, :, None])
    slopes = np.concatenate([own, *slopes], axis=2)
    variance = np.einsum("njk,kl,njl->nj", slopes, spread.covariance, slopes)
    first, last = time
    return EffectOfTime(
        name=effect.name,
        label=type(effect).describe(effect.shape(), lambda joint: f"joint {joint + 1}"),
        joint=effect.joint,
        torque=own @ coef,
        std=np.sqrt(np.maximum(variance, 0.0)),
        beyond=np.maximum(motion.t - last, 0.0) + np.minimum(motion.t - first, 0.0),
    )


def beyond_text(found, time, names, prismatic):
    """Say which effects of time are predicted outside the time of the fit.

    found : `EffectOfTime` of each; time : first and last time of the fit [s]. Returns a
    list of str, empty if there is nothing to say.
    """
    said = []
    margin = _MARGIN * (time[1] - time[0])
    for one in found:
        for rows, where in (
            (one.beyond > margin, "beyond"),
            (one.beyond < -margin, "before"),
        ):
            if not rows.any():
                continue
            power, variance = (
                (x[rows] ** 2).mean(axis=0) for x in (one.torque, one.std)
            )
            # Of a payload, the joint that feels it most.
            joint = int(np.argmax(power))
            size, deviation = np.sqrt(power[joint]), np.sqrt(variance[joint])
            if not (size > 0 or deviation > 0):
                continue
            unit = TORQUE[int(prismatic[joint])]
            known = f" +- {deviation:.2g}" if np.isfinite(deviation) else ""
            said.append(
                f"{names[joint]}: {one.label} predicted up to "
                f"{np.abs(one.beyond[rows]).max():.3g} s {where} the time of the fit, "
                f"{size:.2g}{known} {unit} (root mean square, one standard deviation)"
            )
    return said
