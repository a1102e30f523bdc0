"""Machines identified from torques that are exact, and simulated: motions by hand."""

import numpy as np
import pytest
from scipy.special import ellipj, ellipk
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import RobotIdentifier, load_identified
from sklearn_vbjfa.effects import Backlash, Delay, LoadFriction, Payload, TorqueGain
from tests.effects._arms import play_sample_by_sample
from tests.simulation._machines import GRAVITY, Arm, pendulum, wheel

DT, INERTIA, MASS, LENGTH, OWN = 0.01, 0.5, 1.5, 0.4, 0.02
# Of the pendulum, about its axis, and its weight.
MOMENT, WEIGHT = OWN + MASS * LENGTH**2, MASS * LENGTH * GRAVITY


def identified(model, states, tau, friction=(), effects=(), **given):
    """Identify a robot by least squares; masses are completed by the projection."""
    given = {"regressor": LinearRegression(), "dt": DT} | given
    robot = RobotIdentifier(model, friction=friction, effects=effects, **given)
    return robot.fit(states, tau)


def swing(n=600, nv=1):
    """States (n, 3 nv) of a motion that shows everything, and their times."""
    t, w = DT * np.arange(n), 2 * np.pi * np.linspace(0.4, 0.7, nv)
    q = np.sin(np.outer(t, w)) + 0.5 * np.sin(np.outer(t, 2.7 * w))
    v = w * (np.cos(np.outer(t, w)) + 1.35 * np.cos(np.outer(t, 2.7 * w)))
    a = -(w**2) * (np.sin(np.outer(t, w)) + 3.645 * np.sin(np.outer(t, 2.7 * w)))
    return np.hstack([q, v, a]), t


def a_wheel(torque=lambda q, v, a: 0.0 * v, **given):
    """Wheel of a known inertia, with a torque beside it."""
    states, _ = swing()
    q, v, a = states.T[:, :, None]
    return identified(wheel().model, states, INERTIA * a + torque(q, v, a), **given)


def a_pendulum(torque=lambda load, q, v, a: 0.0 * v, **given):
    """Pendulum that hangs down at q = 0, with a torque beside it."""
    states, _ = swing()
    q, v, a = states.T[:, :, None]
    load = MOMENT * a + WEIGHT * np.sin(q)
    model = pendulum(MASS, LENGTH, OWN).model
    return identified(model, states, load + torque(load, q, v, a), **given)


@pytest.mark.parametrize("way", [-1, 1])
def test_dry_friction_holds_what_it_can_and_no_more(way):
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


def test_friction_of_the_load_holds_a_load():
    # mu is a third: a torque that carries four fifths of the weight is enough.
    robot = a_pendulum(
        lambda load, q, v, a: np.abs(load) / 3 * np.sign(v), effects=[LoadFriction()]
    )
    q0 = 0.5 * np.pi
    held = robot.simulate(np.full((40, 1), 0.8 * WEIGHT), [q0])
    np.testing.assert_allclose(held, [[q0, 0.0, 0.0]] * 40, atol=1e-9)
    # Half of it is not: the arm falls against friction in proportion to the rest.
    falls = robot.simulate(np.full((2, 1), 0.5 * WEIGHT), [q0])
    # M a + W - tau = mu (M a + W), with the load M a + W > 0.
    a = (0.5 / (1 - 1 / 3) - 1) * WEIGHT / MOMENT
    assert falls[0, 2] == pytest.approx(a, rel=2e-3)


def test_a_pendulum_swings_as_elliptic_functions_say():
    # Rows are so far apart that the steps between them have to be chosen.
    dt, q0 = 0.05, 2.5
    robot, t = a_pendulum(dt=dt), dt * np.arange(80)
    states = robot.simulate(np.zeros((80, 1)), [q0])
    k, w = np.sin(0.5 * q0) ** 2, np.sqrt(WEIGHT / MOMENT)
    sn, cn, *_ = ellipj(w * t + ellipk(k), k)
    q, v = 2 * np.arcsin(np.sqrt(k) * sn), 2 * np.sqrt(k) * w * cn
    np.testing.assert_allclose(states[:, 0], q, rtol=0, atol=1e-5)
    np.testing.assert_allclose(states[:, 1], v, rtol=0, atol=3e-5)


@pytest.mark.parametrize("delay", [0.03, -0.03])
def test_late_torques_drive_as_they_were_and_stay_as_they_are(delay):
    # tau = I a of a late channel; by its own clock the wheel swings as it did.
    states, t = swing()
    w = 2 * np.pi * 0.4

    def torque(t):
        return -INERTIA * w**2 * (np.sin(w * t) + 3.645 * np.sin(2.7 * w * t))

    read = torque(t - delay)[:, None]
    robot = identified(wheel().model, states, read, effects=[Delay(0, delay)])
    kept = read.copy()
    found = robot.simulate(read, states[0, :1], states[0, 1:2])
    np.testing.assert_array_equal(read, kept)
    inner = slice(10, -10)
    wrong = np.abs(found[inner, 2] - states[inner, 2]).max()
    assert wrong < 0.03 * np.abs(states[:, 2]).max()


def test_a_channel_that_reads_too_much_drives_as_it_should():
    arm, gain = Arm(), np.array([1.0, 1.25])
    states, _ = swing(nv=2)
    q, v, a = np.split(states, 3, axis=1)
    tau = np.array([arm.mass(x) @ z + arm.bias(x, y) for x, y, z in zip(q, v, a)])
    robot = identified(arm.model(), states, gain * tau, effects=[TorqueGain(joint=1)])
    found = robot.simulate(gain * tau, q[0], v[0])
    # Torques are straight between the rows.
    assert np.abs(found[:100, :2] - q[:100]).max() < 2e-2


def test_play_has_its_width_once():
    width, k = 0.3, 4.0
    states, _ = swing()
    tau = INERTIA * states[:, 2] + k * play_sample_by_sample(states[:, 0], width)
    robot = identified(
        wheel().model, states, tau[:, None], effects=[Backlash(0, width)]
    )
    # From rest at 1 the pull does not change until the wheel has gone half the width.
    found = robot.simulate(np.zeros((60, 1)), [1.0])
    crossed = np.sqrt(width * INERTIA / k)
    first = DT * np.arange(60) < crossed
    np.testing.assert_allclose(found[first, 2], -k / INERTIA, rtol=1e-6)
    # After that it follows at that distance.
    after = np.argmin(first) + 2
    p = found[after, 0] + width / 2
    assert found[after, 2] == pytest.approx(-k * p / INERTIA, rel=1e-5)
    assert 1.0 - p > 1e-3


def test_a_payload_is_there_from_its_instant_on(tmp_path):
    arm, instant, mass = Arm(), 3.0, 0.5
    states, t = swing(nv=2)
    q, v, a = np.split(states, 3, axis=1)
    carried = np.where(t >= instant, mass, 0.0)
    tau = np.array(
        [arm.mass(x, m) @ z + arm.bias(x, y, m) for x, y, z, m in zip(q, v, a, carried)]
    )
    robot = identified(arm.model(), states, tau, effects=[Payload(1, instant)])
    for since in (instant - DT, instant):
        at = round(since / DT)
        row = slice(at, at + 1)
        found = robot.simulate(tau[row], q[at], v[at], t[row])
        np.testing.assert_allclose(found[0, 4:], a[at], rtol=1e-6)
    robot.save(tmp_path / "arm.json")
    stepper = load_identified(tmp_path / "arm.json")
    for at in range(298, 303):
        found = stepper.step(q[at], v[at], a[at], t[at])
        np.testing.assert_allclose(found, tau[at], atol=1e-5)
