"""Values of effects that are part of the robot model, by Gauss and Newton.

The torque is linear in the parameters of the bodies and not in a tilt of the base or
the gain of a channel. With the derivatives by these values as columns, all are fitted
by least squares and the regressor is made anew of the corrected robot, until no value
moves by more than a tenth of its standard error. A prior on the corrections would hold
each value where it began; bodies are estimated afterwards, with the values as found.
"""

import warnings
from dataclasses import dataclass

import numpy as np
from sklearn.exceptions import ConvergenceWarning

from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.robot._estimate import PlainEstimate, plain_estimate

# A value stays where a correction is smaller than this share of its standard error.
STAYS = 0.1
# ... or than this share of the range of plausible values, which is rounding.
_ROUNDING = 1e-10
# Corrections of one fit.
MOST_CORRECTIONS = 12
# Of a correction that would lead out of the plausible values, this share of the way.
_SHORT = 0.9
# A value is at the end of its range where it is within this share of it.
_END = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelValues:
    """What a fit says of the values of effects that are in the model."""

    effects: tuple  # all effects of the fit
    places: np.ndarray  # where those values are among the parameters
    # corrections of the values; zero where the recording does not show them
    step: np.ndarray
    std: np.ndarray  # of the values; nan where the recording does not show them
    # estimate of everything, with corrections in the places of the values
    estimate: PlainEstimate | None = None

    @classmethod
    def of(cls, moments, effects, n_rigid, joint_weights):
        """Fit the values beside everything else to the moments of equations."""
        # Columns of the moments are those of the features, `n_rigid` of them, and then
        # those of the effects, with derivatives by the values.
        places, at = [], n_rigid
        for effect in effects:
            stop = at + len(effect.coefficients)
            if effect.in_model:
                places += range(at, stop)
            at = stop
        found = plain_estimate(moments, joint_weights)
        shown = found.known[places]
        return cls(
            effects=tuple(effects),
            places=np.array(places),
            step=np.where(shown, found.theta[places], 0.0),
            std=np.where(shown, found.std[places], np.nan),
            estimate=found,
        )

    def stay(self):
        """Whether no value moves by more than a tenth of its standard error."""
        # One at the end of what is plausible stays where it would go on outwards.
        own = [effect for effect in self.effects if effect.in_model]
        low, high = (np.concatenate(x) for x in zip(*[e.bounds() for e in own]))
        with np.errstate(invalid="ignore"):
            least = np.maximum(STAYS * self.std, _ROUNDING * (high - low))
            moves = np.abs(self.step) > least
        below, above = (np.concatenate(x) for x in zip(*map(_at_bounds, own)))
        out = (below & (self.step < 0)) | (above & (self.step > 0))
        return not (moves & ~out).any()

    @staticmethod
    def values_of(effects):
        """Present values of effects, ndarray, in the order of `places`."""
        return np.concatenate([one.values for one in effects if one.in_model])

    def corrected(self):
        """Return the effects with corrected values, within those that are plausible."""
        found, at = [], 0
        for effect in self.effects:
            if effect.in_model:
                step = self.step[at : at + len(effect.coefficients)]
                at += len(effect.coefficients)
                effect = effect.at(_within(effect, step))
            found.append(effect)
        return tuple(found)

    def tell_bounds(self, names):
        """Warn of values at the bounds of the plausible: they fit something else."""
        # names: of the joints.
        told = []
        for effect in self.effects:
            if not effect.in_model:
                continue
            below, above = _at_bounds(effect)
            told += [
                f"{name} of {effect.name} on {names[effect.joint]} ({value:.3g})"
                for name, value, ends in zip(
                    effect.tangent, effect.values, below | above
                )
                if ends
            ]
        if told:
            warnings.warn(
                f"{', '.join(told)} went to the end of what is plausible: the "
                "recording shows something else, or does not show it. Leave the effect "
                "out, or look for a larger fault.",
                DoubtWarning,
                stacklevel=6,
            )


def _at_bounds(effect):
    """Which values are at their lower and at their upper bounds, two arrays (k,)."""
    low, high = effect.bounds()
    # A gain has more room above 1 than below.
    below, above = effect.idle - low, high - effect.idle
    near = 2 * _END
    return effect.values < low + near * below, effect.values > high - near * above


def _within(effect, step):
    """Shorten a correction that leads out of the plausible values."""
    low, high = effect.bounds()
    room = np.where(step > 0, high, low) - effect.values
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(step == 0, np.inf, room / np.where(step == 0, 1.0, step))
    return step if share.min() >= 1 else _SHORT * max(share.min(), 0.0) * step


def tell_unsettled(values):
    """Warn that values still move after all corrections."""
    names = [effect.name for effect in values.effects if effect.in_model]
    warnings.warn(
        f"The values of {', '.join(dict.fromkeys(names))} still moved by more than a "
        f"tenth of their standard errors after {MOST_CORRECTIONS} corrections: the "
        "recording hardly tells them apart. Declare fewer of them.",
        ConvergenceWarning,
        stacklevel=7,
    )
