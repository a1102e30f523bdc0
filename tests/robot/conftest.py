"""A simulated recording that several tests fit."""

import pytest


@pytest.fixture(scope="session")
def simulated():
    """Two motions of the made-up arm, and its truth."""
    from sklearn_vbjfa.datasets import make_robot_recording

    return make_robot_recording(
        duration=16.0, dt=0.01, frequency=1.0, n_recordings=2, random_state=1
    )


@pytest.fixture(scope="session")
def new_motion(simulated):
    """Make another motion of the same arm."""
    from sklearn_vbjfa.datasets import make_robot_recording

    return make_robot_recording(
        duration=8.0,
        dt=0.01,
        frequency=0.9,
        inertial=simulated.inertial,
        friction=simulated.friction,
        random_state=7,
    )


@pytest.fixture(scope="session")
def identified(simulated):
    """Identify the made-up arm by default settings; tests must not change it."""
    from sklearn_vbjfa import RobotIdentifier

    robot = RobotIdentifier(
        simulated.urdf, dt=simulated.dt, friction=("viscous", "coulomb")
    )
    return robot.fit(simulated.q, simulated.tau, groups=simulated.groups)
