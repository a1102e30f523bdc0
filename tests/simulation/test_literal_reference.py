"""Every effect on an arm with two links, against laws written out and SciPy."""

import numpy as np
import pytest

from sklearn_vbjfa.effects import (
    AsymmetricFriction,
    Backlash,
    Counterbalance,
    Coupling,
    Drift,
    LoadFriction,
    MaxwellSlip,
    Offset,
    Payload,
    Ripple,
    RotorInertia,
    Signal,
    Spring,
    Stribeck,
    ViscousQuadratic,
)
from sklearn_vbjfa.simulation import simulate
from tests.simulation._literal import Law, follow
from tests.simulation._machines import Arm

DT = 0.01
T = DT * np.arange(101)
Q0, V0 = np.array([0.4, -0.6]), np.array([1.0, -2.0])
VISCOUS = np.array([0.3, 0.1])


def torque(t):
    """Straight between samples, whatever their period."""
    return np.array([2.0 - 6.0 * t, 1.0 + 2.0 * t])


def compare(effects, law, friction=None, exact=5e-6, method="DOP853", **keywords):
    """Compare the simulated arm with the literal one."""
    settings = {
        name: keywords.pop(name) for name in ("gains", "since") if name in keywords
    }
    breaks = keywords.pop("breaks", ())
    friction = {"viscous": VISCOUS} if friction is None else friction
    robot = Arm().robot(friction, effects, dt=DT, **settings)
    tau = np.array([torque(t) for t in T]) * robot.gains
    found = simulate(robot, tau, Q0, V0, T, **keywords)
    expected = follow(law, torque, Q0, V0, T, method, breaks)
    np.testing.assert_allclose(found[:, :4], expected[:, :4], rtol=0, atol=exact)
    size = np.abs(expected[:, 4:]).max()
    wrong = np.abs(found[:, 4:] - expected[:, 4:]).max(axis=1) > 100 * exact * size
    # In a row at which a joint stops or breaks loose acceleration has two values.
    assert wrong.sum() <= 2
    return found


def viscous(q, v, t, way, z):
    return VISCOUS * v


def beside(torque):
    """Torque of a law, (q, v, t) -> (2,), beside viscous friction."""
    return lambda q, v, t, way, z: VISCOUS * v + np.array(torque(q, v, t))


def turns(states):
    """Count how often each joint changes its way."""
    v = states[:, 2:4]
    return [(np.diff(np.sign(own[own != 0])) != 0).sum() for own in v.T]


def test_coulomb_friction_through_reversals_and_rest():
    dry = np.array([4.0, 1.5])
    law = Law(smooth=viscous, dry=lambda v, t: dry, sticks=(True, True))
    found = compare([], law, {"viscous": VISCOUS, "coulomb": dry})
    assert sum(turns(found)) >= 2
    assert (found[:, 2:4] == 0).sum() > 5


@pytest.mark.parametrize("k", [1, 2])
def test_stribeck(k):
    Fc, Fs, vs = np.array([2.0, 0.5]), np.array([1.5, 0.8]), 0.2
    law = Law(
        smooth=viscous,
        dry=lambda v, t: Fc + Fs * np.exp(-(np.abs(v / vs) ** k)),
        sticks=(True, True),
    )
    effects = [(Stribeck(j, vs, k), [Fs[j]]) for j in range(2)]
    compare(effects, law, {"viscous": VISCOUS, "coulomb": Fc})


def test_load_friction():
    mu = np.array([0.25, 0.3])
    law = Law(smooth=viscous, mu=mu, sticks=(True, True))
    effects = [(LoadFriction(j), [mu[j]]) for j in range(2)]
    found = compare(effects, law)
    assert sum(turns(found)) >= 1


def test_asymmetric_friction():
    law = Law(
        smooth=beside(lambda q, v, t: (0.6 + 0.2 * abs(v[0]), -0.1 + 0.05 * abs(v[1]))),
        watched=(True, True),
        dry=lambda v, t: np.array([2.0, 0.5]),
        sticks=(True, True),
    )
    effects = [
        (AsymmetricFriction(0), [0.6, 0.2]),
        (AsymmetricFriction(1), [-0.1, 0.05]),
    ]
    compare(effects, law, {"viscous": VISCOUS, "coulomb": [2.0, 0.5]})


def test_quadratic_friction():
    F2 = np.array([0.2, 0.05])
    law = Law(smooth=beside(lambda q, v, t: F2 * v * np.abs(v)), watched=(True, True))
    compare([(ViscousQuadratic(j), [F2[j]]) for j in range(2)], law)


def test_maxwell_slip():
    F, d = np.array([2.0, 1.0]), np.array([0.02, 0.3])
    last, z = [Q0[0]], [np.zeros(2)]

    def moved(q):
        return np.clip(z[0] + (q - last[0]) / d, -1.0, 1.0)

    def turned(joint, q):
        if joint == 0:
            last[0], z[0] = q[0], moved(q[0])

    law = Law(
        smooth=beside(lambda q, v, t: (F @ moved(q[0]), 0.0)),
        watched=(True, False),
        turned=turned,
    )
    found = compare([(MaxwellSlip(0, tuple(d)), F)], law, exact=5e-4)
    assert turns(found)[0] >= 1


def test_backlash():
    k, c, half = 20.0, 0.4, 0.05
    last = [Q0[1]]

    def follows(q):
        return min(max(last[0], q - half), q + half)

    def turned(joint, q):
        if joint == 1:
            last[0] = follows(q[1])

    law = Law(
        smooth=beside(lambda q, v, t: (0.0, k * follows(q[1]) + c)),
        watched=(False, True),
        turned=turned,
    )
    found = compare([(Backlash(1, 2 * half), [k, c])], law, exact=5e-4)
    assert turns(found)[1] >= 2


def test_spring_and_offset():
    k, c = np.array([30.0, 8.0]), np.array([-2.0, 1.0])
    law = Law(smooth=beside(lambda q, v, t: k * q + c + (0.5, -0.2)))
    effects = [(Spring(j), [k[j], c[j]]) for j in range(2)]
    effects += [(Offset(0), [0.5]), (Offset(1), [-0.2])]
    compare(effects, law)


def test_counterbalance_with_harmonics():
    a, b, c, d, e = -4.0, 3.0, 0.5, -0.7, 1.0
    law = Law(
        smooth=beside(
            lambda q, v, t: (
                a * np.cos(q[0])
                + b * np.sin(q[0])
                + c * np.cos(2 * q[0])
                + d * np.sin(2 * q[0])
                + e,
                0.0,
            )
        )
    )
    compare([(Counterbalance(0), [a, b, c, d, e])], law)


def test_counterbalance_on_a_linkage():
    Fr, krL, ratio, angle = -6.0, 9.0, 0.6, 0.3

    def balance(q, v, t):
        x = q[0] - angle
        length = np.sqrt(1 + ratio**2 - 2 * ratio * np.cos(x))
        return (Fr / length + krL) * np.sin(x), 0.0

    effect = Counterbalance(0, "linkage", ratio, angle)
    compare([(effect, [Fr, krL])], Law(smooth=beside(balance)))


def test_ripple():
    c, s, period = 0.4, -0.3, 0.15
    law = Law(
        smooth=beside(
            lambda q, v, t: (
                0.0,
                c * np.cos(2 * np.pi * q[1] / period)
                + s * np.sin(2 * np.pi * q[1] / period),
            )
        )
    )
    compare([(Ripple(1, period), [c, s])], law)


@pytest.mark.parametrize("own", [0, 1, -1, 0.4])
def test_coupling(own):
    # Friction and inertia of a difference act against it.
    Fv, Ia = (-0.2, -0.03) if own < 0 else (0.2, 0.03)
    law = Law(
        smooth=beside(lambda q, v, t: (0.0, Fv * (v[0] + own * v[1]))),
        inertia=np.array([[0.0, 0.0], [Ia, own * Ia]]),
    )
    compare([(Coupling(1, 0, own), [Fv, 0.0, Ia])], law)


def test_dry_friction_of_a_coupled_speed_turns_over_slow_speeds():
    # The documented law: the sign of w, straight between -1 and 1 mm/s or mrad/s.
    Fc, slow = 0.4, 1e-3
    law = Law(
        smooth=beside(
            lambda q, v, t: (
                0.0,
                Fc * np.clip((v[0] - v[1]) / slow, -1.0, 1.0),
            )
        )
    )
    effect = Coupling(1, 0, -1.0)
    compare([(effect, [0.0, Fc, 0.0])], law, exact=5e-4, method="Radau")


def test_rotor_inertia():
    rotors = np.array([0.4, 0.1])
    law = Law(smooth=viscous, inertia=np.diag(rotors))
    compare([(RotorInertia(j), [rotors[j]]) for j in range(2)], law)
    compare([], law, {"viscous": VISCOUS, "rotor_inertia": rotors})


@pytest.mark.parametrize("of", ["offset", "viscous", "coulomb"])
def test_drift(of):
    D, constant, since = 1.5, 0.3, 0.2
    Fc = np.array([2.0, 1.0])

    def size(t):
        return D * np.exp(-max(t, since) / constant)

    factor = {"offset": 1.0, "coulomb": 0.0}
    law = Law(
        smooth=beside(lambda q, v, t: (size(t) * factor.get(of, v[0]), 0.0)),
        dry=lambda v, t: Fc + np.array([size(t) * (of == "coulomb"), 0.0]),
        sticks=(True, True),
    )
    effect = Drift(0, of, constant)
    friction = {"viscous": VISCOUS, "coulomb": Fc}
    compare([(effect, [D])], law, friction, since=since, breaks=(since,))


@pytest.mark.parametrize("of", ["offset", "viscous", "coulomb"])
def test_signal(of):
    k, reference = 0.8, 20.0
    Fc = np.array([2.0, 1.0])
    factor = {"offset": 1.0, "coulomb": 0.0}

    def size(t):
        return k * (reference + 1.0 + 0.5 * t - reference)

    law = Law(
        smooth=beside(lambda q, v, t: (0.0, size(t) * factor.get(of, v[1]))),
        dry=lambda v, t: Fc + np.array([0.0, size(t) * (of == "coulomb")]),
        sticks=(True, True),
    )
    friction = {"viscous": VISCOUS, "coulomb": Fc}
    effect = Signal(1, "grease", of, reference)
    signals = {"grease": reference + 1.0 + 0.5 * T}
    compare([(effect, [k])], law, friction, signals=signals)


@pytest.mark.parametrize("instant", [0.37, 0.4567])
def test_payload(instant):
    mass, length = 0.7, Arm.lengths[1]
    effect = Payload(1, instant, (0.0, 0.0, -length))
    law = Law(smooth=viscous, payload=lambda t: mass * (t >= instant))
    coefficients = [mass, 0.0, 0.0, -mass * length, 0.0]
    compare([(effect, coefficients)], law, breaks=(instant,))


def test_everything_at_once():
    Fc, Fs, vs, mu = np.array([1.0, 0.4]), 0.8, 0.3, 0.1
    law = Law(
        smooth=beside(
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
