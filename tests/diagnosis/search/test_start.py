"""The same effects from every start: plain friction, order, sample period."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.diagnosis._recordings import DT, named, record
from tests.diagnosis.report._pages import text_of
from tests.diagnosis.search._searches import stribeck

ARM = record("ZY", seed=4, duration=30.0)
PLAIN = ("viscous", "coulomb", "offset", "rotor_inertia")
STARTS = ((), PLAIN)


def lacking():
    """Friction on both joints, a hump on the second, a spring on the first."""
    return ARM.torque(
        joint_1=lambda r: 0.8 * np.sign(r.v[:, 0]) + 3.0 * r.q[:, 0],
        joint_2=stribeck(1.5),
    )


@pytest.fixture(scope="module")
def loops():
    torque = lacking()
    return {
        friction: ARM.discover(torque, robot=ARM.robot(friction=friction))
        for friction in STARTS
    }


# -- starts


def test_every_start_finds_the_same(loops):
    first, *others = loops.values()
    assert named(first) == [("spring", 0), ("stribeck", 1)]
    for other in others:
        assert named(other) == named(first)
        for name in ("error_plain_", "error_after_", "torque_std_"):
            assert_allclose(getattr(other, name), getattr(first, name), rtol=1e-6)
        for one, same in zip(first.effects_, other.effects_, strict=True):
            assert one.parameters == pytest.approx(same.parameters, rel=1e-4)
            assert one.rivals == same.rivals


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


def test_the_three_errors_are_those_of_the_three_models(loops):
    """Errors of the models on the held-out rows, taken again through `residuals`."""
    loop = loops[()]
    judged = loop.report_.outcome
    # every row that was not searched, without what is next to the search
    index = judged.curves["index"]
    assert index.size > 100
    torque = lacking()
    for robot, error in (
        (loop.declared_, loop.error_before_),
        (loop.baseline_, loop.error_plain_),
        (loop.validation_model_, loop.error_after_),
    ):
        rest = robot.residuals(ARM.position, torque)
        own = np.isin(rest.index, index)
        rms = np.sqrt((rest.residual[own] ** 2).mean(axis=0)) / loop.torque_std_
        # behind another edge of the filter, and standstill counts here
        assert_allclose(rms, error, rtol=0.2)


# -- what is not the robot's


@pytest.mark.slow
def test_a_sample_period_that_is_off_by_two_per_cent_does_not_matter():
    """Speeds, forces of inertia and the band are off; what the robot has is not."""
    torque = lacking()
    for factor in (0.98, 1.02):
        loop = ARM.discover(torque, robot=ARM.robot(dt=factor * DT))
        assert named(loop) == [("spring", 0), ("stribeck", 1)]
