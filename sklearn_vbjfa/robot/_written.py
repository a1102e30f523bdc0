"""An identified robot as a robot description, with notes on what that cannot hold."""

from sklearn_vbjfa.model._urdf import write_identified
from sklearn_vbjfa.robot._corrections import note_of_corrections, turned_joints
from sklearn_vbjfa.robot._gains import note_of_gains
from sklearn_vbjfa.robot._known import note_of_masses
from sklearn_vbjfa.robot._prediction import predictor_of


def write_robot(robot, source, path):
    """Write the description of an identified robot.

    robot : RobotIdentifier or IdentifiedRobot; source : description that it came from;
    path : file to write.
    """
    features, predictor = robot.features_, predictor_of(robot)
    notes = [
        note_of_gains(robot.gains_),
        *note_of_corrections(robot),
        note_of_masses(robot),
    ]
    return write_identified(
        source,
        path,
        features.model_,
        predictor.bodies(predictor.theta),
        features.friction_,
        robot.min_eigenvalues_,
        "\n".join(filter(None, notes)),
        turned_joints(robot),
    )
