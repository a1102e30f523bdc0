"""Inspection of robots with many joints: swapped channels."""

import numpy as np
import pytest

from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.inspection import inspect_channels
from tests._quick import checkered
from tests.model._robots import arms


def record_motion(model, seed=0):
    return make_robot_recording(
        model, duration=12.0, dt=0.01, torque_noise=0.02, random_state=seed
    )


@pytest.fixture(scope="module")
def two_arms():
    model = arms(2)
    return model, record_motion(model)


@pytest.mark.parametrize(
    ("pair", "kind"), checkered([(1, 6), (4, 6)], ["torques", "positions", "joints"])
)
def test_swapped_channels_of_twelve_joints(two_arms, pair, kind):
    model, recording = two_arms
    order = np.arange(model.nv)
    order[list(pair)] = order[list(pair[::-1])]
    q, tau = recording.q, recording.tau
    q = q[:, order] if kind != "torques" else q
    tau = tau[:, order] if kind != "positions" else tau
    findings = inspect_channels(model, q, tau, recording.dt)
    errors = [(f.kind, f.joints) for f in findings if f.severity == "error"]
    assert errors == [(f"swapped_{kind}", pair)]


def test_two_arms_without_fault_have_no_findings(two_arms):
    model, recording = two_arms
    assert inspect_channels(model, recording.q, recording.tau, recording.dt) == ()
