"""Where the joints of a robot are, in all rows of a motion at once."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.model._regressor import describe


@dataclass(frozen=True)
class Poses:
    """Frames of the bodies in the world, for each row of positions."""

    # (n, nv + 1, 3, 3): directions by columns; the first body is the base
    axes: np.ndarray
    origins: np.ndarray  # (n, nv + 1, 3) [m]
    # (n, nv, 3): motion of each joint at unit speed, as a screw about the origin of the
    # world: a point p that it carries moves with linear + angular x p
    linear: np.ndarray
    angular: np.ndarray


class JointPoses:
    """Forward kinematics of a model whose joints have one degree of freedom each."""

    # carries (nv + 1, nv): which joints move a body; the first body is the base.

    def __init__(self, model):
        self._parents = np.array(list(model.parents)[1:]) - 1
        self._tree = describe(model, self._parents)
        self._offsets = np.array([x.translation for x in model.jointPlacements[1:]])
        self.carries = np.zeros((model.nv + 1, model.nv), dtype=bool)
        for j, parent in enumerate(self._parents):
            self.carries[j + 1] = self.carries[parent + 1]
            self.carries[j + 1, j] = True

    def __call__(self, q):
        """Return the `Poses` of positions (n, nv) [rad, m]."""
        tree, (n, nv) = self._tree, q.shape
        axes = np.empty((n, nv + 1, 3, 3))
        origins = np.empty((n, nv + 1, 3))
        linear, angular = np.empty((2, n, nv, 3))
        axes[:, 0], origins[:, 0] = np.eye(3), 0.0
        for j, parent in enumerate(self._parents):
            carrier = axes[:, parent + 1]
            at_zero = carrier @ tree.frames[j].T
            direction = at_zero @ tree.axes[j]
            origins[:, j + 1] = origins[:, parent + 1] + carrier @ self._offsets[j]
            origins[:, j + 1] += tree.slides[j] * q[:, j, None] * direction
            axes[:, j + 1] = at_zero @ _turned(tree.axes[j], tree.turns[j] * q[:, j])
            angular[:, j] = tree.turns[j] * direction
            linear[:, j] = np.cross(origins[:, j + 1], angular[:, j])
            linear[:, j] += tree.slides[j] * direction
        return Poses(axes, origins, linear, angular)


def _turned(axis, angles):
    """Rotations (n, 3, 3) by angles (n,) [rad] about a unit vector (Rodrigues)."""
    x, y, z = axis
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angles = angles[:, None, None]
    return np.eye(3) + np.sin(angles) * across + (1 - np.cos(angles)) * across @ across
