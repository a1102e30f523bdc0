"""Torques of currents and voltages, and signs of currents logged as sizes."""

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
    """Fit the arm to what its drives were told."""
    robot = RobotIdentifier(ARM.urdf, dt=ARM.dt, drive=drive, **settings)
    return robot.fit(ARM.q, y)


def test_sizes_count_with_their_mean_sign():
    rng = np.random.default_rng(0)
    truth = 3.0 * rng.normal(size=(400, 2))
    sizes = np.abs(truth + 0.5 * rng.normal(size=truth.shape))
    found = expected(sizes, truth)
    variance = ((sizes - np.abs(truth)) ** 2).mean(axis=0)
    # The mean over both signs of a normal distribution, written out.
    up, down = (np.exp(-0.5 * (s * sizes - truth) ** 2 / variance) for s in (1, -1))
    assert_allclose(found, sizes * (up - down) / (up + down), rtol=1e-9)
    assert_array_equal(expected(sizes, -truth), -found)
    # What is exact has its sign.
    assert_array_equal(expected(np.abs(truth), truth), truth)


def test_signs_explain_a_torque_of_gravity_and_friction():
    """Where neither gravity nor the motion has the sign of the torque."""
    t = np.arange(0.0, 20.0, 0.01)
    q, v = 1.2 * np.sin(t), 1.2 * np.cos(t)
    one = np.ones_like(t)
    columns = np.column_stack([np.sin(q), np.sign(v), v, -q, one])
    for friction in (0.05, 0.5, 1.0, 5.0):
        torque = columns @ [1.0, friction, 0.1, 0.2, 0.1]
        coef = most_explaining(columns, np.abs(torque))
        found = np.sign(columns @ coef)
        assert abs((found * np.sign(torque)).mean()) == 1.0


@pytest.mark.parametrize(
    "constant", [0.5, pytest.param("unknown", marks=pytest.mark.slow)]
)
def test_an_unsigned_current_is_identified_as_one_with_its_sign(constant):
    one = identify(ARM.tau, CurrentDrive(constant))
    other = identify(np.abs(ARM.tau), CurrentDrive(constant, signed=False))
    exact, found = one.predict(ARM.q), other.predict(ARM.q)
    left = (found - exact).std(axis=0) / exact.std(axis=0)
    assert left.max() < 0.03
    if constant != "unknown":
        assert_allclose(exact, 0.5 * identify(ARM.tau).predict(ARM.q), rtol=1e-6)
    else:
        assert other.gains_ is not None


def test_a_duty_cycle_is_multiplied_by_the_supply():
    duty = ARM.tau / 24.0
    recording = take_arrays(ARM.q, duty, dt=ARM.dt, joint_names=ARM.joint_names)
    measured = replace(recording, signals={"supply": np.full(len(duty), 24.0)})
    given = VoltageDrive(supply=24.0).driven(recording)
    for one in (VoltageDrive().driven(measured), given):
        assert_allclose(one.tau, ARM.tau, rtol=1e-9)


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
def test_bad_input_is_named(case):
    drive, y, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        identify(y, drive)
