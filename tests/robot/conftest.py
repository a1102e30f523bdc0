"""Recording of a faulty arm that several tests fit."""

import numpy as np
import pytest

from sklearn_vbjfa.datasets import make_robot_recording


@pytest.fixture(scope="session")
def moved():
    """Simulate an arm with errors in tilt, zero, axis and gain."""
    return make_robot_recording(
        duration=16.0,
        dt=0.01,
        frequency=1.0,
        torque_noise=0.01,
        friction=("viscous", "coulomb"),
        base_tilt=np.deg2rad([4.0, 2.0]),
        joint_zero={2: np.deg2rad(3.0)},
        joint_axis={3: np.deg2rad([2.0, 0.0, 0.0])},
        torque_gain={1: 1.15},
        random_state=3,
    )
