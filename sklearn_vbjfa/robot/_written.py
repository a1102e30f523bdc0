"""An identified robot as a file for other programs, with notes on what is not in it."""

import numpy as np

from sklearn_vbjfa.model import urdf_to_fill
from sklearn_vbjfa.robot._corrections import note_of_corrections, turned_joints
from sklearn_vbjfa.robot._exports import to_mjcf, to_urdf
from sklearn_vbjfa.robot._gains import note_of_gains, note_of_units
from sklearn_vbjfa.robot._known import note_of_masses
from sklearn_vbjfa.robot._prediction import predictor_of


def urdf_of(robot, source, path):
    """Write the description of an identified robot; see `RobotIdentifier.to_urdf`."""
    # robot: RobotIdentifier or IdentifiedRobot; source: description that it came from,
    # path or text; path: file to write. Returns a tuple of `LeftOut`.
    predictor = predictor_of(robot)
    nominal = predictor.features.nominal_
    return to_urdf(
        path,
        urdf_to_fill(source),
        predictor.torque_model(),
        robot.min_eigenvalues_,
        predictor.powers,
        [
            _note_of_gravity(nominal.gravity.linear),
            note_of_gains(robot.gains_),
            *note_of_corrections(robot),
            note_of_masses(robot),
        ],
        turned_joints(robot),
    )


def _note_of_gravity(gravity):
    """Say that a file has no gravity, where it is not what programs take for it."""
    if np.array_equal(gravity, [0.0, 0.0, -9.81]):
        return ""
    x, y, z = gravity
    return f"Gravity, which URDF has no place for, was {x:g} {y:g} {z:g} m/s^2."


def mjcf_of(robot, path):
    """Write an identified robot as MJCF; see `RobotIdentifier.to_mjcf`."""
    # robot: RobotIdentifier or IdentifiedRobot; path: file to write. Returns a tuple of
    # `LeftOut`.
    predictor = predictor_of(robot)
    return to_mjcf(
        path,
        predictor.torque_model(),
        robot.min_eigenvalues_,
        predictor.powers,
        [note_of_units(robot.gains_), note_of_masses(robot)],
    )
