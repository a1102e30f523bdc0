"""What examples in docstrings have in common."""

import pytest


@pytest.fixture(scope="session")
def demo_robot():
    """Return the demonstration's recording, and the robot identified from it."""
    pytest.importorskip("pinocchio")
    from sklearn_vbjfa import RobotIdentifier
    from sklearn_vbjfa.datasets import load_demo_recording

    recording = load_demo_recording()
    robot = RobotIdentifier(recording.urdf, dt=recording.dt)
    return recording, robot.fit(recording.q, recording.tau, groups=recording.groups)


@pytest.fixture(autouse=True)
def names_of_examples(request, doctest_namespace):
    """Give the examples that say so `recording` and `robot`."""
    item = request.node
    if isinstance(item, pytest.DoctestItem) and "robot of the example" in (
        item.dtest.docstring or ""
    ):
        recording, robot = request.getfixturevalue("demo_robot")
        doctest_namespace.update(recording=recording, robot=robot)
