"""Simulations of machines identified from exact torques, against closed forms."""

import numpy as np
import pytest
from scipy.special import ellipj, ellipk
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import RobotIdentifier, load_identified
from sklearn_vbjfa.effects import Backlash, Delay, LoadFriction, Payload, TorqueGain
from tests.effects._arms import play_sample_by_sample
from tests.simulation._machines import GRAVITY, Arm, pendulum, wheel

DT, INERTIA, MASS, LENGTH, ROTATIONAL = 0.01, 0.5, 1.5, 0.4, 0.02
# Moment of inertia of the pendulum about its axis, and its gravity torque.
MOMENT, WEIGHT = ROTATIONAL + MASS * LENGTH**2, MASS * LENGTH * GRAVITY


def identified(model, states, tau, friction=(), effects=(), **settings):
    """Identify a robot by least squares; masses are completed by the projection."""
    settings = {"regressor": LinearRegression(), "dt": DT} | settings
    robot = RobotIdentifier(model, friction=friction, effects=effects, **settings)
    return robot.fit(states, tau)


def swing(n=600, nv=1):
    """Return states (n, 3 nv) of an exciting motion, and their times."""
    t, w = DT * np.arange(n), 2 * np.pi * np.linspace(0.4, 0.7, nv)
    q = np.sin(np.outer(t, w)) + 0.5 * np.sin(np.outer(t, 2.7 * w))
    v = w * (np.cos(np.outer(t, w)) + 1.35 * np.cos(np.outer(t, 2.7 * w)))
    a = -(w**2) * (np.sin(np.outer(t, w)) + 3.645 * np.sin(np.outer(t, 2.7 * w)))
    return np.hstack([q, v, a]), t


def a_wheel(torque=lambda q, v, a: 0.0 * v, **given):
    """Identify a wheel of known inertia with an additional torque."""
    states, _ = swing()
    q, v, a = states.T[:, :, None]
    return identified(wheel().model, states, INERTIA * a + torque(q, v, a), **given)


def a_pendulum(torque=lambda load, q, v, a: 0.0 * v, **given):
    """Identify a pendulum that hangs down at q = 0, with an additional torque."""
    states, _ = swing()
    q, v, a = states.T[:, :, None]
    load = MOMENT * a + WEIGHT * np.sin(q)
    model = pendulum(MASS, LENGTH, ROTATIONAL).model
    return identified(model, states, load + torque(load, q, v, a), **given)


@pytest.mark.parametrize("way", [-1, 1])
def test_dry_friction_holds_up_to_its_level(way):
    Fc = 2.0
    robot = a_wheel(lambda q, v, a: Fc * np.sign(v), friction=("coulomb",))
    t = DT * np.arange(10)
    for share in (0.99, 1.01, 3.0):
        push = np.full((10, 1), way * share * Fc)
        a = way * max(share - 1.0, 0.0) * Fc / INERTIA
        (first,) = robot.simulate(push[:1], [0.3])
        assert first[2] == pytest.approx(a, rel=1e-5)
        states = robot.simulate(push, [0.3])
        expected = np.column_stack([0.3 + 0.5 * a * t**2, a * t, np.full(10, a)])
        np.testing.assert_allclose(states, expected, atol=1e-6 * max(share, 1.0))


def test_load_friction_holds_a_load():
    # With mu = 1/3, four fifths of the gravity torque hold the pendulum.
    robot = a_pendulum(
        lambda load, q, v, a: np.abs(load) / 3 * np.sign(v), effects=[LoadFriction()]
    )
    q0 = 0.5 * np.pi
    held = robot.simulate(np.full((40, 1), 0.8 * WEIGHT), [q0])
    np.testing.assert_allclose(held, [[q0, 0.0, 0.0]] * 40, atol=1e-9)
    # Half of it does not: the pendulum falls against load-dependent friction.
    falls = robot.simulate(np.full((2, 1), 0.5 * WEIGHT), [q0])
    # M a + W - tau = mu (M a + W), with the load M a + W > 0.
    a = (0.5 / (1 - 1 / 3) - 1) * WEIGHT / MOMENT
    assert falls[0, 2] == pytest.approx(a, rel=2e-3)


def test_pendulum_matches_elliptic_functions():
    # The rows are so far apart that steps between them are needed.
    dt, q0 = 0.05, 2.5
    robot, t = a_pendulum(dt=dt), dt * np.arange(80)
    states = robot.simulate(np.zeros((80, 1)), [q0])
    k, w = np.sin(0.5 * q0) ** 2, np.sqrt(WEIGHT / MOMENT)
    sn, cn, *_ = ellipj(w * t + ellipk(k), k)
    q, v = 2 * np.arcsin(np.sqrt(k) * sn), 2 * np.sqrt(k) * w * cn
    np.testing.assert_allclose(states[:, 0], q, rtol=0, atol=1e-5)
    np.testing.assert_allclose(states[:, 1], v, rtol=0, atol=3e-5)


@pytest.mark.parametrize("delay", [0.03, -0.03])
def test_delayed_torques_are_advanced(delay):
    # tau = I a is read by a delayed channel; the simulation removes the delay.
    states, t = swing()
    w = 2 * np.pi * 0.4

    def torque(t):
        return -INERTIA * w**2 * (np.sin(w * t) + 3.645 * np.sin(2.7 * w * t))

    measured = torque(t - delay)[:, None]
    robot = identified(wheel().model, states, measured, effects=[Delay(0, delay)])
    copy = measured.copy()
    simulated = robot.simulate(measured, states[0, :1], states[0, 1:2])
    np.testing.assert_array_equal(measured, copy)
    inner = slice(10, -10)
    error = np.abs(simulated[inner, 2] - states[inner, 2]).max()
    assert error < 0.03 * np.abs(states[:, 2]).max()


def test_torque_gain_is_removed():
    arm, gain = Arm(), np.array([1.0, 1.25])
    states, _ = swing(nv=2)
    q, v, a = np.split(states, 3, axis=1)
    tau = np.array([arm.mass(x) @ z + arm.bias(x, y) for x, y, z in zip(q, v, a)])
    robot = identified(arm.model(), states, gain * tau, effects=[TorqueGain(joint=1)])
    simulated = robot.simulate(gain * tau, q[0], v[0])
    # Torques are interpolated linearly between the rows.
    assert np.abs(simulated[:100, :2] - q[:100]).max() < 2e-2


def test_backlash_width():
    width, k = 0.3, 4.0
    states, _ = swing()
    tau = INERTIA * states[:, 2] + k * play_sample_by_sample(states[:, 0], width)
    robot = identified(
        wheel().model, states, tau[:, None], effects=[Backlash(0, width)]
    )
    # From rest at 1, the torque is constant until the wheel crosses half the width.
    found = robot.simulate(np.zeros((60, 1)), [1.0])
    crossed = np.sqrt(width * INERTIA / k)
    first = DT * np.arange(60) < crossed
    np.testing.assert_allclose(found[first, 2], -k / INERTIA, rtol=1e-6)
    # Afterwards the play follows at that distance.
    after = np.argmin(first) + 2
    p = found[after, 0] + width / 2
    assert found[after, 2] == pytest.approx(-k * p / INERTIA, rel=1e-5)
    assert 1.0 - p > 1e-3


def test_payload_acts_from_its_instant_on(tmp_path):
    arm, instant, mass = Arm(), 3.0, 0.5
    states, t = swing(nv=2)
    q, v, a = np.split(states, 3, axis=1)
    payload = np.where((t >= instant) & (t < 4.0), mass, 0.0)
    tau = np.array(
        [arm.mass(x, m) @ z + arm.bias(x, y, m) for x, y, z, m in zip(q, v, a, payload)]
    )
    robot = identified(arm.model(), states, tau, effects=[Payload(1, instant, 4.0)])
    for start in (instant - DT, instant, 4.0 - DT, 4.0):
        k = round(start / DT)
        row = slice(k, k + 1)
        actual = robot.simulate(tau[row], q[k], v[k], t[row])
        np.testing.assert_allclose(actual[0, 4:], a[k], rtol=1e-6)
    robot.save(tmp_path / "arm.json")
    stepper = load_identified(tmp_path / "arm.json")
    for k in (*range(298, 303), *range(398, 403)):
        actual = stepper.step(q[k], v[k], a[k], t[k])
        np.testing.assert_allclose(actual, tau[k], atol=1e-5)
