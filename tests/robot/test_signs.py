"""Drives with measured currents and voltages, and signs of unsigned currents."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.fit import expected
from sklearn_vbjfa.inspection import most_explaining
from sklearn_vbjfa.recording import take_arrays
from sklearn_vbjfa.robot import CurrentDrive, VoltageDrive

ARM = make_robot_recording(duration=20.0, dt=0.01, random_state=3)


def identify(y, drive=None, **settings):
    """Fit the arm to its drive channels."""
    robot = RobotIdentifier(ARM.urdf, dt=ARM.dt, drive=drive, **settings)
    return robot.fit(ARM.q, y)


def test_expected_sign_of_unsigned_torques():
    rng = np.random.default_rng(0)
    truth = 3.0 * rng.normal(size=(400, 2))
    size = np.abs(truth + 0.5 * rng.normal(size=truth.shape))
    signed = expected(size, truth)
    variance = ((size - np.abs(truth)) ** 2).mean(axis=0)
    # Mean over both signs under a normal distribution.
    up, down = (np.exp(-0.5 * (s * size - truth) ** 2 / variance) for s in (1, -1))
    assert_allclose(signed, size * (up - down) / (up + down), rtol=1e-9)
    assert_array_equal(expected(size, -truth), -signed)
    # Exact magnitudes get the sign of the prediction.
    assert_array_equal(expected(np.abs(truth), truth), truth)


def test_signs_are_recovered_for_gravity_and_friction():
    """The sign of the torque is neither that of gravity nor that of the velocity."""
    t = np.arange(0.0, 20.0, 0.01)
    q, v = 1.2 * np.sin(t), 1.2 * np.cos(t)
    ones = np.ones_like(t)
    columns = np.column_stack([np.sin(q), np.sign(v), v, -q, ones])
    for friction in (0.05, 0.5, 1.0, 5.0):
        torque = columns @ [1.0, friction, 0.1, 0.2, 0.1]
        coef = most_explaining(columns, np.abs(torque))
        signs = np.sign(columns @ coef)
        assert abs((signs * np.sign(torque)).mean()) == 1.0


@pytest.mark.parametrize(
    "constant", [0.5, pytest.param("unknown", marks=pytest.mark.slow)]
)
def test_unsigned_current_gives_the_fit_of_a_signed_one(constant):
    signed = identify(ARM.tau, CurrentDrive(constant))
    unsigned = identify(np.abs(ARM.tau), CurrentDrive(constant, signed=False))
    exact, estimate = signed.predict(ARM.q), unsigned.predict(ARM.q)
    error = (estimate - exact).std(axis=0) / exact.std(axis=0)
    assert error.max() < 0.03
    if constant != "unknown":
        assert_allclose(exact, 0.5 * identify(ARM.tau).predict(ARM.q), rtol=1e-6)
    else:
        assert unsigned.gains_ is not None


def test_duty_cycle_is_multiplied_by_the_supply():
    duty = ARM.tau / 24.0
    recording = take_arrays(ARM.q, duty, dt=ARM.dt, joint_names=ARM.joint_names)
    measured = replace(recording, signals={"supply": np.full(len(duty), 24.0)})
    constant = VoltageDrive(supply=24.0).driven(recording)
    for driven in (VoltageDrive().driven(measured), constant):
        assert_allclose(driven.tau, ARM.tau, rtol=1e-9)


BAD = {
    "negative": (CurrentDrive(signed=False), ARM.tau, "has negative currents"),
    "word": (CurrentDrive("known"), ARM.tau, "must be one number, or"),
    "several": (
        CurrentDrive([0.1, 0.2]),
        ARM.tau,
        "CurrentDrive: torque_constant must",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_invalid_current_drives_are_refused(case):
    drive, y, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        identify(y, drive)
