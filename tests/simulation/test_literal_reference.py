"""Effects on a two-link arm, against literal friction laws and SciPy's solver."""

import numpy as np

from sklearn_vbjfa.effects import (
    AsymmetricFriction,
    Coupling,
    Drift,
    LoadFriction,
    MaxwellSlip,
    Ripple,
    RotorInertia,
    Spring,
    Stribeck,
)
from sklearn_vbjfa.simulation import simulate
from tests.simulation._literal import Law, follow
from tests.simulation._machines import Arm

DT = 0.01
T = DT * np.arange(101)
Q0, V0 = np.array([0.4, -0.6]), np.array([1.0, -2.0])
VISCOUS = np.array([0.3, 0.1])


def torque(t):
    """Return torques that are linear in time."""
    return np.array([2.0 - 6.0 * t, 1.0 + 2.0 * t])


def compare(effects, law, friction=None, exact=5e-6):
    """Compare the simulated arm with the literal one."""
    friction = {"viscous": VISCOUS} if friction is None else friction
    robot = Arm().robot(friction, effects, dt=DT)
    tau = np.array([torque(t) for t in T]) * robot.gains
    states = simulate(robot, tau, Q0, V0, T)
    expected = follow(law, torque, Q0, V0, T)
    np.testing.assert_allclose(states[:, :4], expected[:, :4], rtol=0, atol=exact)
    size = np.abs(expected[:, 4:]).max()
    mismatch = np.abs(states[:, 4:] - expected[:, 4:]).max(axis=1) > 100 * exact * size
    # The acceleration is discontinuous where a joint stops or breaks loose.
    assert mismatch.sum() <= 2
    return states


def with_viscous(torque):
    """Return a torque law (q, v, t) -> (2,) with viscous friction added."""
    return lambda q, v, t: VISCOUS * v + np.array(torque(q, v, t))


def turns(states):
    """Count the reversals of each joint."""
    v = states[:, 2:4]
    return [(np.diff(np.sign(x[x != 0])) != 0).sum() for x in v.T]


def test_maxwell_slip():
    F, d = np.array([2.0, 1.0]), np.array([0.02, 0.3])
    last, z = [Q0[0]], [np.zeros(2)]

    def moved(q):
        return np.clip(z[0] + (q - last[0]) / d, -1.0, 1.0)

    def turned(joint, q):
        if joint == 0:
            last[0], z[0] = q[0], moved(q[0])

    law = Law(
        smooth=with_viscous(lambda q, v, t: (F @ moved(q[0]), 0.0)),
        watched=(True, False),
        turned=turned,
    )
    found = compare([(MaxwellSlip(0, tuple(d)), F)], law, exact=5e-4)
    assert turns(found)[0] >= 1


def test_all_effects_together():
    Fc, Fs, vs, mu = np.array([1.0, 0.4]), 0.8, 0.3, 0.1
    law = Law(
        smooth=with_viscous(
            lambda q, v, t: (
                5.0 * q[0] - 1.0 + 0.2 * abs(v[0]),
                0.3 * np.cos(20.0 * q[1]) + 0.1 * v[0] + 0.5 * np.exp(-t / 0.5),
            )
        ),
        dry=lambda v, t: Fc + np.array([Fs * np.exp(-abs(v[0]) / vs), 0.0]),
        mu=np.array([0.0, mu]),
        inertia=np.array([[0.2, 0.0], [0.02, 0.0]]),
        sticks=(True, True),
    )
    effects = [
        (Spring(0), [5.0, -1.0]),
        (AsymmetricFriction(0), [0.0, 0.2]),
        (Ripple(1, 2 * np.pi / 20.0), [0.3, 0.0]),
        (Coupling(1, 0), [0.1, 0.0, 0.02]),
        (Drift(1, "offset", 0.5), [0.5]),
        (Stribeck(0, vs), [Fs]),
        (LoadFriction(1), [mu]),
        (RotorInertia(0), [0.2]),
    ]
    compare(effects, law, {"viscous": VISCOUS, "coulomb": Fc})
