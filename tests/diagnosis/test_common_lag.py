"""Correction of a common lag of all torque channels."""

from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa.datasets import load_demo_recording
from sklearn_vbjfa.recording import with_torques_shifted


@pytest.mark.parametrize("lag", [0.05, -0.0125])
def test_shifted_torques_match_the_motion(lag):
    recording = load_demo_recording().select(0)
    t = np.arange(recording.n_samples) * recording.dt
    tau = np.column_stack([np.sin((1 + j) * t) for j in range(recording.nv)])
    late = np.column_stack([np.sin((1 + j) * (t - lag)) for j in range(recording.nv)])
    weight = np.ones(late.shape)
    # A sample of zero weight must not affect its neighbours.
    weight[200, 0], late[200, 0] = 0.0, 1e6
    shifted = with_torques_shifted(replace(recording, tau=late, weight=weight), lag)
    used = shifted.weight[:, 0] > 0
    lost = np.ceil(abs(lag) / recording.dt) + 1 + (lag % recording.dt > 1e-9)
    assert used.sum() == recording.n_samples - lost
    np.testing.assert_allclose(shifted.tau[used], tau[used], atol=1e-5)
