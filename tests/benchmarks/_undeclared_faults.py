"""Faults of the geometry and of the channels, put into a robot and its recording.

Conventions, those of the library's documentation, written out here once more:

- ``base_tilt``: gravity in the base's frame is R g, R = Ry(pitch) Rx(roll).
- ``joint_zero``: the encoder reads the true position plus ``zero``.
- ``joint_axis``: the placement M of a joint is M exp(w), w = about_x e1 + about_y e2
  in the joint's frame; e1 and e2 are the axes about which it does not turn.
- ``torque_gain``: the channel reads ``gain`` times the torque, friction included.

Nothing here uses the code of the package.
"""

from dataclasses import dataclass

import numpy as np
from _undeclared_arms import axes_across
from _undeclared_robots import inverse_dynamics
from scipy.spatial.transform import Rotation

NAMES = {
    "tilt": "base_tilt",
    "zero": "joint_zero",
    "axis": "joint_axis",
    "gain": "torque_gain",
}
PARAMETERS = {
    "base_tilt": ("roll", "pitch"),
    "joint_zero": ("zero",),
    "joint_axis": ("about_x", "about_y"),
    "torque_gain": ("gain",),
}
NEUTRAL = {"base_tilt": 0.0, "joint_zero": 0.0, "joint_axis": 0.0, "torque_gain": 1.0}


@dataclass(frozen=True)
class Fault:
    """One fault of the geometry or of a channel."""

    name: str
    joint: int
    values: tuple

    @property
    def key(self):
        """Name and joint."""
        return self.name, self.joint

    @property
    def parameters(self):
        """Parameters by name."""
        return dict(zip(PARAMETERS[self.name], self.values))


def with_faults(nominal, faults):
    """Return the robot as it is built: gravity and placements with their faults."""
    import pinocchio as pin

    model = nominal.copy()
    for fault in faults:
        if fault.name == "base_tilt":
            roll, pitch = fault.values
            turn = Rotation.from_euler("y", pitch) * Rotation.from_euler("x", roll)
            g = np.asarray(nominal.gravity.linear)
            model.gravity.linear = turn.as_matrix() @ g
        elif fault.name == "joint_axis":
            w = np.asarray(fault.values) @ axes_across(nominal, fault.joint)
            wrong = pin.SE3(Rotation.from_rotvec(w).as_matrix(), np.zeros(3))
            i = fault.joint + 1
            model.jointPlacements[i] = model.jointPlacements[i] * wrong
    return model


def zeros_of(faults, nv):
    """Return what the encoders read too much, (nv,) [rad]."""
    zeros = np.zeros(nv)
    for fault in faults:
        if fault.name == "joint_zero":
            zeros[fault.joint] += fault.values[0]
    return zeros


def gains_of(faults, nv):
    """Return the factors of the torque channels, (nv,)."""
    gains = np.ones(nv)
    for fault in faults:
        if fault.name == "torque_gain":
            gains[fault.joint] *= fault.values[0]
    return gains


def rigid_torque(model, q, v, a, faults):
    """Torques of the bodies (n, nv) where the encoders read q, before any gain."""
    built = with_faults(model, faults)
    return inverse_dynamics(built, q - zeros_of(faults, built.nv), v, a)
