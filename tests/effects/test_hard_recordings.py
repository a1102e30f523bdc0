"""Friction with memory in recordings that hardly show it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("pinocchio")

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.effects import Effect, LoadFriction, MaxwellSlip
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


class Many(Effect):
    """An effect with thirty columns, most of which are nearly the same."""

    name = "many"
    coefficients = tuple(f"c{i}" for i in range(30))
    units = (("N m", "N"),) * 30

    def columns(self, motion):
        return np.cos(np.outer(motion.q[:, self.joint], np.arange(1, 31)))


def searched(q, tau, *names):
    robot = RobotIdentifier(MODEL, dt=0.02)
    return EffectDiscovery(robot, effects=names, random_state=0).fit(q, tau)


@pytest.mark.parametrize(
    ("q", "tau", "tolerance"),
    [
        (Q[:100], TORQUE[:100], 0.05),  # two seconds
        (Q[500:], TORQUE[500:], 0.01),  # from the middle of a motion
        (np.round(Q / 0.08) * 0.08, TORQUE, 0.05),  # coarser than every threshold
    ],
)
def test_the_size_of_the_friction_is_found(q, tau, tolerance):
    (effect,) = searched(q, tau, "maxwell_slip", "coulomb").effects_
    assert effect.name == "maxwell_slip"
    assert effect.parameters["Fc"] == pytest.approx(3.0, rel=tolerance)


def test_a_joint_that_never_reverses_shows_no_memory():
    q = 0.3 * T[:, None] - 0.1 * np.cos(T)[:, None]
    v = np.gradient(q, 0.02, axis=0)
    states = np.hstack([q, v, np.gradient(v, 0.02, axis=0)])
    tau = inverse_dynamics(MODEL, states) + 0.5 * v + 1.0 + NOISE
    assert searched(q, tau, "maxwell_slip", "coulomb").effects_ == ()


def test_thirty_columns_do_not_hide_what_is_there():
    loop = searched(Q, TORQUE, Many, "maxwell_slip")
    assert loop.effects_[0].name == "maxwell_slip"
    assert loop.error_after_[0] < 0.02


def test_sizes_are_not_negative():
    """Nor beside a load that changes its sign; one element is a bank, too."""
    effects = [LoadFriction(), MaxwellSlip(displacements=(0.05,))]
    robot = RobotIdentifier(MODEL, dt=0.02, effects=effects)
    robot.fit(Q, TORQUE - 0.3 * np.abs(LOAD) * np.sign(V))
    found = dict(zip(robot.parameter_names_, robot.theta_))
    assert_allclose(found["joint_1:load_friction:mu"], 0.0, atol=1e-9)
    assert found["joint_1:maxwell_slip:F1"] > 0
