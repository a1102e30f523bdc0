"""Recording that tests write in many ways."""

import pytest

from sklearn_vbjfa.datasets import make_robot_recording


@pytest.fixture(scope="session")
def made():
    """Simulate the arm of six joints for 1000 samples."""
    return make_robot_recording(duration=4, dt=0.004, random_state=3)
