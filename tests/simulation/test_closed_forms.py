"""Motions with analytic solutions."""

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa.effects import Spring
from sklearn_vbjfa.model import with_bodies
from sklearn_vbjfa.simulation import simulate
from tests.model._robots import random_body
from tests.model._trees import random_placement
from tests.simulation._machines import machine, slider, wheel


def zeros(n, nv=1):
    return np.zeros((n, nv))


@pytest.mark.parametrize("dt", [0.001, 0.07])
@pytest.mark.parametrize("way", [-1, 1])
def test_mass_with_coulomb_friction_stops(dt, way):
    mass, Fc, v0 = 2.0, 3.0, 1.5 * way
    states = simulate(slider(mass, {"coulomb": Fc}, dt=dt), zeros(40), [0.2], [v0])
    t = np.minimum(dt * np.arange(40), mass * abs(v0) / Fc)
    q = 0.2 + v0 * t - way * 0.5 * Fc / mass * t**2
    np.testing.assert_allclose(states[:, 0], q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(states[:, 1], v0 - way * Fc / mass * t, atol=1e-12)
    rests = dt * np.arange(40) > mass * abs(v0) / Fc
    assert (states[rests, 1:] == 0).all()


def test_spring_with_coulomb_friction_loses_amplitude_linearly():
    mass, Fc, k, q0, dt = 2.0, 3.0, 200.0, 0.5, 0.001
    robot = slider(mass, {"coulomb": Fc}, [(Spring(), [k, 0.0])], dt=dt)
    half = np.pi * np.sqrt(mass / k)
    band = Fc / k
    turns = int(np.ceil((q0 / band - 1) / 2))
    t = dt * np.arange(int((turns + 0.5) * half / dt))
    states = simulate(robot, zeros(t.size), [q0])
    number = np.minimum((t / half).astype(int), turns)
    way = (-1.0) ** number
    size = np.where(number < turns, q0 - band - 2 * band * number, 0.0)
    rests = way * (q0 - 2 * band * number)
    q = np.where(number < turns, size * np.cos(np.pi * t / half) + way * band, rests)
    np.testing.assert_allclose(states[:, 0], q, rtol=0, atol=1e-7)
    assert (states[number == turns, 1] == 0).sum() > 50


@pytest.mark.parametrize("dt", [0.001, 0.01])
@pytest.mark.parametrize("way", [-1, 1])
def test_breaks_loose_under_a_ramp(dt, way):
    inertia, Fc, slope = 0.5, 3.1, 4.0 * way
    t = dt * np.arange(int(2 / dt) + 1)
    robot = wheel(inertia, {"coulomb": Fc}, dt=dt)
    states = simulate(robot, slope * t[:, None], [0.3])
    past = np.maximum(t - Fc / abs(slope), 0)
    expected = [slope * past**3 / 6 / inertia + 0.3, slope * past**2 / 2 / inertia]
    np.testing.assert_allclose(states[:, :2].T, expected, rtol=0, atol=1e-10)
    assert (states[past == 0, 1:] == 0).all()
    assert (states[past == 0, 0] == 0.3).all()


@pytest.mark.parametrize("rate", [1.0, 1e3, 1e6])
def test_viscous_decay(rate):
    t = 0.01 * np.arange(101)
    robot = wheel(0.5, {"viscous": 0.5 * rate})
    states = simulate(robot, zeros(t.size), [0.0], [1.0])
    np.testing.assert_allclose(states[:, 1], np.exp(-rate * t), atol=1e-7)
    gone = -np.expm1(-rate * t) / rate
    np.testing.assert_allclose(states[:, 0], gone, atol=1e-7 / rate)


def chain(rng, n_joints, kinds=("RX", "RY", "RZ")):
    """Return a serial chain of moderate size."""
    model, bodies = pin.Model(), []
    for j in range(n_joints):
        joint = getattr(pin, f"JointModel{rng.choice(kinds)}")()
        placement = random_placement(rng)
        placement.translation *= 0.3
        model.addJoint(j, joint, placement, f"joint_{j}")
        bodies.append(random_body(rng))
    return model, bodies


def energies(robot, states):
    """Return kinetic and potential energy (n,) by Pinocchio."""
    model = with_bodies(robot.model, robot.bodies)
    data, nv = model.createData(), robot.n_joints
    kinetic = [
        pin.computeKineticEnergy(model, data, x[:nv], x[nv : 2 * nv]) for x in states
    ]
    potential = [pin.computePotentialEnergy(model, data, x[:nv]) for x in states]
    return np.array(kinetic), np.array(potential)


@pytest.mark.parametrize(
    ("n_joints", "dt"), [*[(n, 0.01) for n in range(1, 8)], (2, 0.001), (6, 0.001)]
)
def test_energy_is_conserved_without_friction(n_joints, dt):
    rng = np.random.default_rng(n_joints)
    model, bodies = chain(rng, n_joints)
    robot = machine(model, bodies, dt=dt)
    start = rng.normal(size=(2, n_joints))
    states = simulate(robot, zeros(int(10 / dt) + 1, n_joints), *start)
    kinetic, potential = energies(robot, states)
    total = kinetic + potential
    assert np.abs(total - total[0]).max() < 1e-6 * kinetic.max()
