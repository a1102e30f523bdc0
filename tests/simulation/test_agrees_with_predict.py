"""Predicted torques of simulated states equal the driving torques."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sklearn_vbjfa import effects
from sklearn_vbjfa.simulation import simulate
from tests.model.test_mjcf import rigid
from tests.simulation._machines import random_machine, wheel


def some_effects(rng, nv):
    """Return random effects on random joints."""
    j = int(rng.integers(nv))
    drawn = [
        (effects.Stribeck(j, 0.2, int(rng.integers(1, 3))), [0.5]),
        (effects.LoadFriction(j), [0.1]),
        (effects.AsymmetricFriction(j), [0.2, 0.05]),
        (effects.ViscousQuadratic(j), [0.02]),
        (
            effects.MaxwellSlip(j, (0.0, 0.05, 0.2), (), (0.1, 0.0)),
            [0.4, 0.5, 0.2, 0.3, 0.2],
        ),
        (effects.Backlash(j, 0.02), [2.0, 0.1]),
        (effects.Spring(j), [3.0, 0.2]),
        (effects.Counterbalance(j), [0.5, -0.3, 0.2, 0.1, 0.3]),
        (effects.Ripple(j, 0.5), [0.1, 0.2]),
        (effects.RotorInertia(j), [0.2]),
        (effects.Drift(j, "viscous", 2.0), [0.2]),
    ]
    if nv > 1:
        drawn.append((effects.Coupling(j, (j + 1) % nv), [0.05, 0.1, 0.01]))
    return [drawn[i] for i in np.flatnonzero(rng.random(len(drawn)) < 0.5)]


def inverse(robot, states, t):
    """Return torques of states from bodies, declared friction and effect columns."""
    q, v, a = np.split(states, 3, axis=1)
    load = rigid(robot.model, robot.bodies, states)
    declared = dict(zip(robot.friction_names, robot.friction.T))
    tau = load + declared["viscous"] * v + declared["coulomb"] * np.sign(v)
    motion = effects.Motion(q=q, v=v, a=a, t=t, load=load, torque=load)
    for effect, coef in zip(robot.effects, robot.coefficients):
        tau[:, effect.joint] += effect.columns(motion) @ coef
    return tau


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 99), nv=st.integers(1, 7))
def test_inverse_dynamics_of_simulated_states(seed, nv):
    rng = np.random.default_rng([seed, nv])
    friction = {"viscous": rng.uniform(0.2, 1, nv), "coulomb": rng.uniform(0.2, 2, nv)}
    robot = random_machine(rng, nv, friction, some_effects(rng, nv), dt=0.002)
    t = 0.002 * np.arange(60)
    tau = 5 * np.sin(np.outer(t, rng.uniform(5, 20, nv)) + rng.uniform(0, 6, nv))
    states = simulate(robot, tau, rng.normal(size=nv), rng.normal(size=nv))
    v = states[:, nv : 2 * nv]
    # The first row shows no direction. After a reversal between two rows, the memory
    # reversed there and not in a row.
    moves = (np.abs(v) > 1e-2).all(axis=1) & (np.arange(len(t)) > 0)
    turned = np.abs(np.diff(np.sign(v), axis=0)).sum(axis=1) > 0
    moves[np.argmax(turned) + 1 if turned.any() else len(t) :] = False
    expected = inverse(robot, states, t)[moves]
    size = np.abs(expected).max(initial=1.0)
    np.testing.assert_allclose(tau[moves], expected, rtol=0, atol=1e-9 * size)


def filtered(effect, coef, x, t):
    """Return torques x (n,) as measured by a channel."""
    rest = np.zeros((x.size, 1))
    motion = effects.Motion(
        q=rest, v=rest, a=rest, t=t, load=x[:, None], torque=x[:, None]
    )
    return x + effect.columns(motion) @ coef


@pytest.mark.parametrize(
    "effect",
    [
        effects.Delay(0, 0.004),
        effects.Delay(0, -0.004),
        effects.TorqueFilter(0, "lag", "torque", 0.004),
        effects.TorqueFilter(0, "smooth", "torque", 0.004),
        effects.TorqueFilter(0, "lag", "position", 0.004),
    ],
)
def test_channel_filters_are_inverted(effect):
    """Errors are of third order in the filter, (2 pi f T)^3, or due to sampling."""
    t, gain = 0.001 * np.arange(2000), 1.3
    x = 2.0 * np.sin(2 * np.pi * 2.0 * t) + 1.0
    size = effect.delay if isinstance(effect, effects.Delay) else effect.time_constant
    measured = gain * filtered(effect, np.array([size]), x, t)
    robot = wheel(effects=[(effect, [size])], gains=np.array([gain]), dt=0.001)
    restored = robot.true_torques(measured[:, None], t)[:, 0]
    inner = slice(100, -100)
    order = 2 * (2 * np.pi * 2.0 * 0.004) ** 3
    assert np.abs(restored - x)[inner].max() < 2 * order
    assert np.abs(measured / gain - x)[inner].max() > 2 * order
