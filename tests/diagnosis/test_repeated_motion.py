"""Repeated motions: torques that depend on the phase must not be named."""

import numpy as np
import pytest

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from tests._quick import one_in
from tests.diagnosis.report._pages import text_of
from tests.effects._arms import arm, inverse_dynamics

PERIOD, DT, TIMES = 10.0, 0.01, 6
PLAIN = ("viscous", "coulomb", "offset", "rotor_inertia")


MODEL = arm("Y")


def simulate(seed, undeclared=None, disturbance=0.05):
    """Simulate six repetitions of 10 s with a torque that depends on the phase."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(TIMES * PERIOD / DT)) * DT
    q, v, a = np.zeros((3, t.size))
    for k in rng.choice(np.arange(1, 10), size=6, replace=False):
        w, phase = 2 * np.pi * k / PERIOD, rng.uniform(0, 2 * np.pi)
        wave = 0.25 / np.sqrt(k / PERIOD) * np.exp(1j * (w * t + phase))
        q, v, a = (x + ((1j * w) ** n * wave).imag for n, x in enumerate((q, v, a)))
    tau = inverse_dynamics(MODEL, np.column_stack([q, v, a]))[:, 0]
    tau = tau + 0.4 * v + 0.6 * np.sign(v) + 0.1 + 0.02 * a
    if undeclared is not None:
        tau += undeclared(q, v)
    orders = np.arange(1, 31)
    amplitude = rng.normal(size=30) + 1j * rng.normal(size=30)
    curve = (amplitude @ np.exp(2j * np.pi * orders[:, None] * t / PERIOD)).real
    residual = np.sqrt(0.9) * curve / curve.std() + np.sqrt(0.1) * rng.normal(
        size=t.size
    )
    tau += disturbance * tau.std() * residual
    return (q + 2e-5 * rng.normal(size=t.size))[:, None], tau[:, None]


def discover(q, tau, groups=None):
    robot = RobotIdentifier(MODEL, dt=DT, friction=PLAIN)
    return EffectDiscovery(robot).fit(q, tau, groups=groups)


# Cross-validation over time blocks instead of phases would name effects here.
@pytest.mark.parametrize("case", one_in(2, [(9, 1), (12, 1), (12, TIMES), (0, TIMES)]))
def test_phase_dependent_torques_are_not_named(case):
    seed, recordings = case
    q, tau = simulate(seed)
    groups = np.arange(len(q)) * recordings // len(q)
    loop = discover(q, tau, groups)
    assert loop.effects_ == ()
    (repetition,) = loop.report_.outcome.findings["repeated"]
    assert repetition["seconds"] == pytest.approx(PERIOD, abs=0.05)
    assert repetition["count"] == pytest.approx(TIMES, rel=0.01)
    assert "Repeated motion: " in text_of(loop.report_)
    assert loop.report_.has_open_questions
    assert "a longer motion that does not repeat" in text_of(loop.report_)


def test_effects_are_found_in_repeated_motions():
    q, tau = simulate(
        1, lambda q, v: 1.5 * np.exp(-((v / 0.2) ** 2)) * np.sign(v), 0.02
    )
    assert [e.name for e in discover(q, tau).effects_] == ["stribeck"]
