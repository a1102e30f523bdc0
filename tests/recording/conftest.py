"""Simulated recording that tests write to files of many formats."""

import pytest

from sklearn_vbjfa.datasets import make_robot_recording


@pytest.fixture(scope="session")
def arm():
    """Simulate 1000 samples of an arm with six joints."""
    return make_robot_recording(duration=4, dt=0.004, random_state=3)
