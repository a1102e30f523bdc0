"""Results must not depend on the declared friction or the sample period."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.diagnosis._recordings import DT, named, record
from tests.diagnosis.report._pages import text_of
from tests.diagnosis.search._searches import stribeck

ARM = record("ZY", seed=4, duration=30.0)
PLAIN = ("viscous", "coulomb", "offset", "rotor_inertia")
STARTS = ((), PLAIN)


def simulated_torque():
    """Friction on both joints, Stribeck on the second, a spring on the first."""
    return ARM.torque(
        joint_1=lambda r: 0.8 * np.sign(r.v[:, 0]) + 3.0 * r.q[:, 0],
        joint_2=stribeck(1.5),
    )


@pytest.fixture(scope="module")
def loops():
    torque = simulated_torque()
    return {
        friction: ARM.discover(torque, robot=ARM.robot(friction=friction))
        for friction in STARTS
    }


def test_result_is_independent_of_declared_friction(loops):
    first, *others = loops.values()
    assert named(first) == [("spring", 0), ("stribeck", 1)]
    for other in others:
        assert named(other) == named(first)
        for name in ("error_plain_", "error_after_", "torque_std_"):
            assert_allclose(getattr(other, name), getattr(first, name), rtol=1e-6)
        for effect, match in zip(first.effects_, other.effects_, strict=True):
            assert effect.parameters == pytest.approx(match.parameters, rel=1e-4)
            assert effect.rivals == match.rivals


def test_plain_terms_are_added_and_not_discovered(loops):
    for friction, loop in loops.items():
        added = loop.report_.outcome.robot["added"]
        assert added == tuple(name for name in PLAIN if name not in friction)
        assert loop.declared_.features_.friction_ == friction
        for robot in (loop.baseline_, loop.validation_model_, loop.identifier_):
            assert set(robot.features_.friction_) == set(PLAIN)
        assert not {e.name for e in loop.effects_} & set(PLAIN)
        assert ("Added to every joint" in text_of(loop.report_)) == bool(added)
    assert loops[PLAIN].declared_ is loops[PLAIN].baseline_
    assert (loops[PLAIN].error_before_ == loops[PLAIN].error_plain_).all()
    assert (loops[()].error_before_ > 1.5 * loops[()].error_plain_).all()


def test_errors_match_the_residuals_of_the_models(loops):
    loop = loops[()]
    outcome = loop.report_.outcome
    # Held-out rows without the guard.
    index = outcome.curves["index"]
    assert index.size > 100
    torque = simulated_torque()
    for robot, error in (
        (loop.declared_, loop.error_before_),
        (loop.baseline_, loop.error_plain_),
        (loop.validation_model_, loop.error_after_),
    ):
        residuals = robot.residuals(ARM.position, torque)
        rows = np.isin(residuals.index, index)
        rms = np.sqrt((residuals.residual[rows] ** 2).mean(axis=0)) / loop.torque_std_
        # Other filter edges, and standstill is included here.
        assert_allclose(rms, error, rtol=0.2)


@pytest.mark.slow
def test_result_is_robust_to_sample_period_errors():
    """A wrong sample period scales velocities and accelerations only."""
    torque = simulated_torque()
    for factor in (0.98, 1.02):
        loop = ARM.discover(torque, robot=ARM.robot(dt=factor * DT))
        assert named(loop) == [("spring", 0), ("stribeck", 1)]
