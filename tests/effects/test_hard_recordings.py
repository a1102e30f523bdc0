"""Hysteretic friction in recordings with poor excitation."""

import numpy as np
import pytest

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from tests.effects._arms import arm, inverse_dynamics, motion, stops_sample_by_sample

T, X = motion(1, duration=40.0, dt=0.02, seed=5)
Q, V, _ = np.split(X, 3, axis=1)
MODEL = arm("Y")
NOISE = 0.02 * np.random.default_rng(3).normal(size=Q.shape)
LOAD = inverse_dynamics(MODEL, X)
SLIPS = sum(
    size * stops_sample_by_sample(Q[:, 0], d)[:, None]
    for size, d in ((2.0, 0.05), (1.0, 0.01))
)
TORQUE = LOAD + 0.5 * V + SLIPS + NOISE


def search(q, tau, *names, cutoff="auto"):
    robot = RobotIdentifier(MODEL, dt=0.02, cutoff=cutoff)
    return EffectDiscovery(robot, effects=names, random_state=0).fit(q, tau)


@pytest.mark.parametrize(
    ("q", "tau", "tolerance"),
    [
        (Q[:100], TORQUE[:100], 0.05),  # two seconds
        (Q[500:], TORQUE[500:], 0.01),  # from the middle of a motion
        (np.round(Q / 0.08) * 0.08, TORQUE, 0.05),  # coarser than every threshold
    ],
)
def test_friction_level_is_estimated(q, tau, tolerance):
    (effect,) = search(q, tau, "maxwell_slip", "coulomb").effects_
    assert effect.name == "maxwell_slip"
    assert effect.parameters["Fc"] == pytest.approx(3.0, rel=tolerance)


def test_friction_is_found_with_coarse_encoders():
    coarse = np.round(Q / 0.08) * 0.08
    discovery = search(coarse, TORQUE, "maxwell_slip", "coulomb", cutoff=5.0)
    (effect,) = discovery.effects_
    low, high = effect.intervals["Fc"]
    assert 2.5 < low < 3.04 < high < 3.5


def test_a_displacement_between_two_elements_is_in_its_interval():
    slips = 2.0 * stops_sample_by_sample(Q[:, 0], 0.02)[:, None]
    (effect,) = search(Q, LOAD + 0.5 * V + slips + NOISE, "maxwell_slip").effects_
    low, high = effect.intervals["half"]
    assert low < 0.01 < high < 1.1 * low


def test_a_joint_that_never_reverses_shows_no_memory():
    q = 0.3 * T[:, None] - 0.1 * np.cos(T)[:, None]
    v = np.gradient(q, 0.02, axis=0)
    states = np.hstack([q, v, np.gradient(v, 0.02, axis=0)])
    tau = inverse_dynamics(MODEL, states) + 0.5 * v + 1.0 + NOISE
    assert search(q, tau, "maxwell_slip", "coulomb").effects_ == ()
