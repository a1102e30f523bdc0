"""Simulated recordings: the torques are those of the robot that comes with them."""

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa.datasets import Recording, load_demo_recording, make_robot_recording
from sklearn_vbjfa.model import position_range

ALL = ("viscous", "coulomb", "offset", "rotor_inertia")


def test_torques_are_inverse_dynamics_plus_friction():
    recording = make_robot_recording(
        duration=2.0, dt=0.01, friction=ALL, n_recordings=2, random_state=0
    )
    model = pin.buildModelFromUrdf(recording.urdf)
    for j, body in enumerate(recording.inertial):
        model.inertias[j + 1] = pin.Inertia.FromDynamicParameters(body)
    data = model.createData()
    for row, torque in zip(recording.states, recording.tau_clean):
        q, v, a = row.reshape(3, 6)
        expected = pin.rnea(model, data, q, v, a)
        for name, signal in zip(ALL, (v, np.sign(v), np.ones(6), a)):
            expected = expected + recording.friction[name] * signal
        np.testing.assert_allclose(torque, expected, rtol=1e-10, atol=1e-10)


def test_limits_of_zero_are_no_limits():
    model = pin.buildModelFromUrdf(make_robot_recording(duration=1.0).urdf)
    for name in ("lowerPositionLimit", "upperPositionLimit", "velocityLimit"):
        setattr(model, name, np.zeros(model.nv))
    recording = make_robot_recording(model, duration=1.0, random_state=0)
    assert (np.ptp(recording.q, axis=0) > 0.5).all()
    low, high = position_range(model)
    np.testing.assert_allclose([low, high], [[-np.pi] * 6, [np.pi] * 6])


def test_seed_and_recordings():
    first, again, other = (
        make_robot_recording(duration=1.0, n_recordings=3, random_state=seed)
        for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(first.q, again.q)
    np.testing.assert_array_equal(first.tau, again.tau)
    assert np.abs(first.q - other.q).max() > 0.1
    assert first.group_names == ("motion_1", "motion_2", "motion_3")
    np.testing.assert_array_equal(first.groups, np.repeat([0, 1, 2], 200))
    starts = first.t.reshape(3, 200)[:, 0]
    np.testing.assert_array_equal(starts, 0.0)
    motions = first.q.reshape(3, 200, 6)
    assert np.abs(motions[0] - motions[1]).max() > 0.1
    assert isinstance(first, Recording)


def test_the_demo_is_always_the_same():
    first, again = load_demo_recording(), load_demo_recording()
    for name in ("q", "tau", "states", "inertial"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert repr(first) == (
        "Recording 'demo': 8000 samples, 6 joints, dt = 0.005 s, 2 recordings"
    )
    assert first.robot_model().nv == 6
    assert first.select("motion_1").n_samples == 4000
    nominal = [b.toDynamicParameters()[0] for b in first.robot_model().inertias[1:]]
    assert np.abs(first.inertial[:, 0] / nominal - 1).max() > 0.05


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"duration": 0.05}, "are 10 samples; expected at least 16"),
        ({"friction": ("sticky",)}, r"Unknown friction \['sticky'\]; expected some"),
        ({"friction": {"sticky": 1.0}}, r"Unknown friction \['sticky'\]"),
    ],
)
def test_wrong_options(options, message):
    with pytest.raises(ValueError, match=message):
        make_robot_recording(**{"duration": 1.0, **options})
