"""Estimated velocities whose corners are rounded, and when their joints turn round."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa import RobotIdentifier, StateEstimator, load_identified
from sklearn_vbjfa.effects import Rest
from sklearn_vbjfa.fit import equivalent_corner
from sklearn_vbjfa.recording import take_arrays
from sklearn_vbjfa.robot import FitOptions, PDDrive
from tests.robot.test_drives import one_joint

DT = 0.005
KP, KD = 20.0, 1.0
MOMENT, VISCOUS, COULOMB = 0.03, 0.2, 0.3


@pytest.mark.parametrize("cutoff", [4.0, 9.0])
def test_a_corner_is_rounded_by_half_the_mean_time_of_the_smoother(cutoff):
    t = DT * np.arange(-800, 801)
    estimator = StateEstimator(DT, cutoff=cutoff)
    # of slope -1 before and 1 behind: a jump of 2
    speed = estimator.fit_transform((0.5 * t * np.abs(t))[:, None])[800, 1]
    assert_allclose(speed, estimator.rounding()[0], rtol=2e-3)


def test_the_jump_is_what_a_simulated_drive_answers():
    """A step of friction, integrated, smoothed by the gain of the smoother."""
    dry, inertia, damping, stiffness, cutoff = 0.3, 0.03, 1.2, 20.0, 7.0
    t = 1e-4 * np.arange(-60_000, 60_001)
    roots = np.roots([inertia, damping, stiffness]).astype(complex)
    after = np.where(t > 0, t, 0.0)
    speed = np.exp(np.multiply.outer(roots, after)) / (
        inertia * (roots - roots[::-1])[:, None]
    )
    speed = -2 * dry * np.where(t > 0, speed.sum(axis=0).real, 0.0)
    frequency = np.fft.rfftfreq(t.size, 1e-4)
    gain = 1 / (1 + (frequency / cutoff) ** 10)
    smoothed = np.fft.irfft(gain * np.fft.rfft(speed), t.size)[60_000]
    rounding = StateEstimator(DT, cutoff=cutoff).fit(np.zeros((99, 1))).rounding()
    # where it is not smoothed it is zero there
    assert_allclose(
        equivalent_corner(dry, inertia, damping, stiffness, cutoff),
        -smoothed / rounding,
        rtol=0.01,
    )


@pytest.mark.parametrize("turns", [1, -1])
@pytest.mark.parametrize("before", [8.0, 3.0])
def test_the_sign_turns_when_the_true_velocity_does(turns, before):
    """Slopes of -+ before and after; with the smaller one the joint stays."""
    corner, t = 3.0, DT * np.arange(-800, 801)
    after = max(before - 2 * corner, 0.0)
    v = turns * np.where(t < 0, before * t, after * t)
    q = DT * np.cumsum(v) - 0.5 * DT * v
    estimator = StateEstimator(DT, cutoff=6.0).fit(q[:, None])
    _, v, a = estimator.transform(q[:, None]).T[:, :, None]
    nothing = np.zeros(1)
    rest = Rest(
        speed=nothing,
        time=nothing,
        noise=nothing,
        corner=np.array([corner]),
        rounding=estimator.rounding(),
    )

    def turned(sign):
        near = np.abs(t) < 0.05
        return t[near][np.argmax(turns * sign[near, 0] > 0)]

    at = turned(rest.sign(v, a))
    assert abs(at) < 1.5 * DT
    assert turned(np.sign(v)) != pytest.approx(at, abs=0.4 * DT)


def driven(seconds=20.0, seed=0):
    """Simulate a joint under its drive at 20 kHz, commanded and logged at 200 Hz."""
    rng = np.random.default_rng(seed)
    dt, sub = 1e-3, 20
    t = dt * np.arange(round(seconds / dt))
    f, phase = rng.uniform(1.0, 3.0, 3), rng.uniform(0, 2 * np.pi, 3)
    aim = (0.6 / (1 + f) * np.sin(2 * np.pi * f * t[:, None] + phase)).sum(axis=1)
    aim = np.repeat(aim[::5], 5)
    rows, q, v = np.empty(t.size), 0.0, 0.0
    for i in range(t.size):
        rows[i] = q
        for _ in range(sub):
            tau = KP * (aim[i] - q) - KD * v - VISCOUS * v
            new = v + tau / MOMENT * dt / sub
            # friction brings it to a stand at most
            most = COULOMB / MOMENT * dt / sub
            v = new - np.clip(new, -most, most)
            q += v * dt / sub
    q, aim = rows[::5, None], aim[::5, None]
    whole = take_arrays(q, 0.0 * q, dt=DT, joint_names=("j",))
    drive = PDDrive(KP, KD, delay=0.0)
    return drive, replace(whole, signals={"q_desired": aim})


def fitted(drive, recording, **settings):
    given = {
        "dt": DT,
        "cutoff": 3.0,
        "options": FitOptions(state_cutoff=6.0),
        "bodies": "fixed",
    }
    wheel = one_joint(pin.JointModelRZ(), moment=0.01)
    robot = RobotIdentifier(wheel, drive=drive, **{**given, **settings})
    if drive is not None:
        recording = drive.driven(recording)
    return robot.fit_recording(recording)


@pytest.mark.slow
def test_what_was_smoothed_is_not_taken_for_inertia(tmp_path):
    drive, recording = driven()

    def rotor(robot):
        return robot.theta_[robot.parameter_names_.index("j:rotor_inertia")] / 0.02 - 1

    robot = fitted(drive, recording)
    assert abs(rotor(robot)) < 0.006
    # torques whose law is not known
    measured = replace(drive.driven(recording), feedback=None)
    assert rotor(fitted(None, measured)) > 0.011
    # predictions of positions know of it, from a file as well
    robot.save(tmp_path / "robot.json")
    known = load_identified(tmp_path / "robot.json")
    asked = recording.q[:500]
    assert_allclose(known.predict(asked), robot.predict(asked), rtol=1e-9)
    plan = replace(robot.robot_.plan, corners=None)
    without = replace(robot.robot_, plan=plan)
    assert np.abs(without.predict(asked) - known.predict(asked)).max() > 0.1
