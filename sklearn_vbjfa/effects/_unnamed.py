"""Joint torques beyond the named effects, as weighted sums of terms."""

import itertools

import numpy as np

from sklearn_vbjfa.effects._base import RATIO, Shaped, Stateful
from sklearn_vbjfa.effects._friction import Stribeck, ViscousQuadratic
from sklearn_vbjfa.effects._memory import MaxwellSlip
from sklearn_vbjfa.effects._position import Ripple, Spring

# Stribeck speeds over the largest speed; displacements and periods over the range.
_SPEEDS = (0.05, 0.15, 0.4)
_LOADED, _SLIPS = (1e-4, 0.01, 0.1), (0.001, 0.006, 0.035, 0.2)
_PERIODS = (2.0, 1.0, 0.5)


class UnnamedTorque(Shaped, Stateful):
    """A joint torque without a named cause, share * sum_k w_k c_k.

    The terms c_k are those of library effects on one quantity. `EffectDiscovery` finds
    the weights and adds the torque to the fitted model with a share of one, without
    changing other parameters. Beyond the range of the fit it is held constant.

    Parameters
    ----------
    of : {"speed", "load", "memory", "position"}, default="speed"
        Terms: quadratic and Stribeck friction; stop operators proportional to the load;
        stop operators; a spring and three ripples.
    weights : tuple of float, default=()
        Weights w_k of the terms, in the order of `parts`.
    reach, fast : float, default=1.0
        Range [rad or m] and largest speed [rad/s or m/s] of the joint.
    """

    name = "unnamed_torque"
    label = "unnamed joint torque"
    formula = r"\mathrm{share} \sum_k w_k\,c_k"
    coefficients = nonnegative = ("share",)
    units = (RATIO,)
    kinds = ("speed", "load", "memory", "position")
    choices = (("of", kinds),)

    def __init__(self, joint=0, of="speed", weights=(), reach=1.0, fast=1.0):
        super().__init__(joint)
        self.of = of
        self.weights = weights
        self.reach = reach
        self.fast = fast

    needs = property(lambda self: self.parts[0].needs)
    depends = property(lambda self: self.parts[0].depends)

    @property
    def parts(self):
        """Library effects whose columns are the terms."""
        j = self.joint
        if self.of == "speed":
            stribeck = (Stribeck(j, share * self.fast) for share in _SPEEDS)
            return (ViscousQuadratic(j), *stribeck)
        if self.of == "load":
            return (MaxwellSlip(j, (), loaded=tuple(self.reach * d for d in _LOADED)),)
        if self.of == "memory":
            return (MaxwellSlip(j, tuple(self.reach * d for d in _SLIPS)),)
        return (Spring(j), *(Ripple(j, share * self.reach) for share in _PERIODS))

    def prefix(self, joint_name):
        return f"{joint_name}:unnamed_{self.of}"

    def key(self):
        return (self.name, self.joint, self.of)

    def terms_of(self, motion):
        """Columns of the terms (n, k)."""
        return np.hstack([part.columns(motion) for part in self.parts])

    def columns(self, motion):
        return self.terms_of(motion) @ np.reshape(self.weights, (-1, 1))

    def law(self, maths):
        laws = [part.law(maths) for part in self.parts]

        def torque(state):
            terms = itertools.chain.from_iterable(law(state) for law in laws)
            return (sum(w * x for w, x in zip(self.weights, terms, strict=True)),)

        return torque

    def simulated(self, table, share):
        """Add its terms to a `TermTable`; False if one is not possible."""
        weights = iter(self.weights)
        return all(
            part.simulated(table, *(share * next(weights) for _ in part.coefficients))
            for part in self.parts
        )
