"""A robot model with corrections: its base, zeros, axes, and what its channels read."""

import numpy as np

from sklearn_vbjfa.model._loading import import_pinocchio
from sklearn_vbjfa.model._regressor import describe


class CorrectedModel:
    """A robot model that takes corrections, in any order; `nominal` is left alone."""

    # gains (nv,): what each torque channel reads, over the torque.

    def __init__(self, nominal):
        self._nominal = nominal
        self.model = nominal.copy()
        self.gains = np.ones(nominal.nv)
        parents = np.array([int(k) - 1 for k in nominal.parents][1:])
        self._tree = describe(nominal, parents)

    @property
    def nominal_gravity(self):
        """Gravity of the description, ndarray (3,) [m/s^2]."""
        return self._nominal.gravity.linear.copy()

    def axis(self, joint):
        """Direction of a joint in its own frame, ndarray (3,)."""
        return self._tree.axes[joint]

    def tilt(self, rotation):
        """Turn gravity by a matrix (3, 3)."""
        gravity = self.model.gravity.copy()
        gravity.linear = rotation @ gravity.linear
        self.model.gravity = gravity

    def turn(self, joint, rotation):
        """Turn the placement of a joint, with all it carries, by a matrix (3, 3)."""
        # The matrix counts in the frame of the description: a zero that was moved
        # before is moved along the turned axis.
        placement = self.model.jointPlacements[joint + 1]
        nominal = self._nominal.jointPlacements[joint + 1]
        turned = nominal.rotation @ rotation @ nominal.rotation.T
        arm = turned @ (placement.translation - nominal.translation)
        placement.translation = nominal.translation + arm
        placement.rotation = turned @ placement.rotation

    def move_zero(self, joint, zero):
        """Put a joint's zero where its encoder reads `zero` [rad or m]."""
        pin, tree = import_pinocchio(), self._tree
        placement = self.model.jointPlacements[joint + 1]
        axis = tree.axes[joint]
        shift = -zero * tree.slides[joint] * (placement.rotation @ axis)
        placement.translation = placement.translation + shift
        turn = pin.exp3(-zero * tree.turns[joint] * axis)
        placement.rotation = placement.rotation @ turn

    def read(self, joint, gain):
        """Let the torque channel of a joint read `gain` times what it reads."""
        self.gains[joint] *= gain
