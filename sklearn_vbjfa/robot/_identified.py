"""Identified robots without data and estimator."""

from sklearn_vbjfa.robot._prediction import predictor_of


def torque_model(robot):
    """Return the `TorqueModel` of an identified robot, for simulation and control.

    Parameters
    ----------
    robot : RobotIdentifier or IdentifiedRobot
        Fitted.

    Returns
    -------
    TorqueModel
        The robot as `predict` knows it for states: the model that the effects
        correct, and velocity signs as without noise.
    """
    return predictor_of(robot).torque_model()
