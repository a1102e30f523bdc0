"""Robots with faults, independent of the package's code, and a custom effect."""

import numpy as np

from sklearn_vbjfa.effects import BaseTilt, Effect, JointAxis, JointZero
from tests.effects._arms import inverse_dynamics


class Cubic(Effect):
    """Stiffening spring that is not in the library."""

    name = "cubic"
    label = "stiffening cable"
    coefficients = ("k3",)
    units = (("N m/rad^3", "N/m^3"),)
    contains = ("spring",)

    def columns(self, motion):
        return motion.q[:, [self.joint]] ** 3


def across(model, joint):
    """Return the two axes about which the axis of a joint of `arm` is corrected."""
    letter = model.joints[joint + 1].shortname()[-1]
    return {"Z": np.eye(3)[:2], "X": np.eye(3)[1:], "Y": np.eye(3)[[0, 2]]}[letter]


def faulty(model, effects):
    """Return the robot, encoder shifts and channel gains as defined in the guide.

    There is at most one effect of each kind per joint.
    """
    import pinocchio as pin

    other = model.copy()
    shifts, gains = np.zeros(model.nv), np.ones(model.nv)
    for effect in effects:
        j = effect.joint
        if isinstance(effect, BaseTilt):
            g = model.gravity.linear
            first, second = np.delete(np.eye(3), np.argmax(np.abs(g)), axis=0)
            roll, pitch = pin.exp3(effect.roll * first), pin.exp3(effect.pitch * second)
            other.gravity.linear = pitch @ roll @ g
        elif isinstance(effect, JointZero):
            shifts[j] = effect.zero
        elif isinstance(effect, JointAxis):
            w = np.array([effect.about_x, effect.about_y]) @ across(model, j)
            placement = other.jointPlacements[j + 1]
            placement.rotation = placement.rotation @ pin.exp3(w)
        else:
            gains[j] = effect.gain
    return other, shifts, gains


def measured(model, states, effects, viscous=0.0):
    """Return the measured torques (n, nv) where the encoders read the given states."""
    other, shifts, gains = faulty(model, effects)
    nv = model.nv
    true = states - np.r_[shifts, np.zeros(2 * nv)]
    return gains * (inverse_dynamics(other, true) + viscous * states[:, nv : 2 * nv])
