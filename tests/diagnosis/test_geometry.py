"""EffectDiscovery with tilted bases and wrong encoder zeros, axes or gains."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier, load_model
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.effects import BaseTilt, JointAxis, JointZero, OfRobot, TorqueGain
from tests.diagnosis._faulty import with_faults
from tests.diagnosis._recordings import named, record
from tests.diagnosis.report._pages import text_of
from tests.effects._arms import inverse_dynamics
from tests.model._legs import legs_mjcf
from tests.model._robots import arms

LIBRARY = ("base_tilt", "joint_zero", "joint_axis", "torque_gain")
LIBRARY += ("spring", "viscous_quadratic")
ARM = record("ZYX", seed=2, duration=30.0)


def discover(faults, declared=(), **torque):
    faulty, robot = with_faults(faults, ARM), ARM.robot(effects=declared)
    return faulty.discover(faulty.torque(**torque), effects=list(LIBRARY), robot=robot)


TRUTHS = {
    "tilt": BaseTilt(0, 0.07, -0.04),
    "zero": JointZero(1, 0.07),
    "axis": JointAxis(2, 0.05, 0.06),
    "gain": TorqueGain(1, 1.15),
}


# Tilts and zeros are tested below, with other effects.
@pytest.fixture(
    scope="module", params=["axis", pytest.param("gain", marks=pytest.mark.slow)]
)
def one_fault(request):
    truth = TRUTHS[request.param]
    return truth, discover([truth])


def test_the_fault_is_found_with_its_value(one_fault):
    truth, loop = one_fault
    assert named(loop) == [(truth.name, truth.joint)]
    (effect,) = loop.effects_
    for name, value in zip(truth.coefficients, truth.values):
        low, high = effect.intervals[name]
        # A 90 % interval may miss the truth in one recording.
        slack = 0.75 * (high - low)
        assert low - slack < value < high + slack
        assert high - low < 0.02
        assert low < effect.parameters[name] < high
    assert set(effect.parameters) == set(truth.coefficients)
    assert set(effect.units.values()) <= {"rad", "1"}
    assert (effect.scope == "robot") == isinstance(truth, OfRobot)
    assert_allclose(effect.effect.values, list(effect.parameters.values()))


def test_the_correction_reduces_the_error(one_fault):
    truth, loop = one_fault
    torque = with_faults([truth]).torque()
    spread = torque.std(axis=0)
    assert np.all(loop.error_after_ < np.maximum(1.2 * loop.error_before_, 0.02))
    worst = np.argmax(loop.error_before_ - loop.error_after_)
    assert loop.error_after_[worst] < 0.5 * loop.error_before_[worst]
    # The error also falls on another motion.
    other = record("ZYX", seed=7, duration=10.0, noise=0.0)
    other_torque = with_faults([truth], other).torque()
    error = loop.identifier_.predict(other.position) - other_torque
    declared = loop.declared_.predict(other.position) - other_torque
    size = np.sqrt(np.mean(error**2, axis=0)) / spread
    assert np.all(size < 0.05)
    assert np.sum((error / spread) ** 2) < 0.3 * np.sum((declared / spread) ** 2)


def test_the_completed_model_contains_the_correction(one_fault):
    truth, loop = one_fault
    (effect,) = loop.identifier_.effects_
    assert effect.key() == truth.key()
    assert_allclose(effect.values, truth.values, atol=0.01)
    assert_allclose(loop.identifier_.theta_[-effect.values.size :], effect.values)
    assert loop.declared_.effects_ == ()
    text = text_of(loop.report_).lower()
    assert f"{truth.label} " in text
    assert "was missing" in text


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*the base, which root")
def test_tilt_of_a_fixed_floating_base(tmp_path):
    path = tmp_path / "legs.xml"
    path.write_text(legs_mjcf())
    lean = np.deg2rad(3.0)
    askew = load_model(path, [np.cos(lean / 2), np.sin(lean / 2), 0.0, 0.0])
    recording = make_robot_recording(
        askew, duration=20.0, dt=0.01, frequency=1.0, torque_noise=0.02, random_state=0
    )
    data = recording.q, recording.tau
    robot = RobotIdentifier(path, dt=recording.dt, effects=[BaseTilt()]).fit(*data)
    # The tilt turns gravity, opposite to the base.
    assert_allclose(robot.effects_[0].values, [-lean, 0.0], atol=np.deg2rad(0.2))


@pytest.mark.parametrize(
    "truth", [(JointZero(2, 0.12),), (BaseTilt(0, 0.01, 0.06), TorqueGain(3, 0.6))]
)
def test_terms_of_second_order_of_large_faults_are_no_effects(truth):
    """Neither a turned axis of the next joint nor other gains."""
    arm = record("ZYZY", seed=2, duration=20.0, noise=0.005)
    faulty = with_faults(truth, arm)
    loop = faulty.discover(faulty.torque(), list(LIBRARY), robot=arm.robot())
    found = {(x.name, x.joint): x.effect.values for x in loop.effects_}
    assert sorted(found) == sorted((fault.name, fault.joint) for fault in truth)
    for fault in truth:
        assert_allclose(found[fault.name, fault.joint], fault.values, atol=2e-3)


def test_no_corrections_without_faults():
    loop = discover([])
    assert named(loop) == []
    assert_allclose(loop.error_after_, loop.error_plain_)
    # The zeros of the vertical first joint and of the last are not identifiable.
    hidden = {(h.name, h.joint) for h in loop.not_identifiable_}
    assert {("joint_zero", 0), ("joint_zero", 2)} <= hidden
    assert ("base_tilt", 0) not in hidden
    assert ("joint_zero", 1) not in hidden


@pytest.mark.slow
def test_a_declared_tilt_is_estimated_by_the_identifier():
    truth = [BaseTilt(0, 0.07, -0.04), JointZero(1, 0.06)]
    loop = discover(truth, declared=[BaseTilt()])
    assert named(loop) == [("joint_zero", 1)]
    tilt, zero = loop.identifier_.effects_
    assert_allclose(tilt.values, truth[0].values, atol=0.01)
    assert_allclose(zero.values, truth[1].values, atol=0.01)
    # The declared model estimates the tilt without the zero.
    (first,) = loop.declared_.effects_
    assert first.corrects
    assert loop.not_identifiable_ is not None
    assert "base_tilt" not in {e.name for e in loop.effects_}


def test_tilt_requires_gravity():
    model = ARM.model.copy()
    model.gravity.linear = np.zeros(3)
    states = np.hstack([ARM.q, ARM.v, ARM.a])
    weightless = replace(ARM, load=inverse_dynamics(model, states))
    declared = ARM.robot(effects=[BaseTilt()]).set_params(model=model)
    with pytest.raises(ValueError, match="the robot description has no gravity"):
        weightless.discover(weightless.torque(), effects=["offset"], robot=declared)


@pytest.mark.slow
def test_tilt_of_two_branches_is_reported_once():
    model = arms(2)
    roll, pitch = 0.06, -0.03
    leaning = model.copy()
    leaning.gravity.linear = pin.rpy.rpyToMatrix(roll, pitch, 0.0) @ [0, 0, -9.81]
    recording = make_robot_recording(
        leaning,
        duration=12.0,
        dt=0.01,
        frequency=1.0,
        friction=("viscous",),
        torque_noise=0.02,
        random_state=1,
    )
    robot = RobotIdentifier(model, dt=recording.dt, friction=("viscous",))
    loop = EffectDiscovery(robot, effects=["base_tilt", "offset"], random_state=0).fit(
        recording.q, recording.tau
    )
    assert [e.name for e in loop.effects_] == ["base_tilt"]
    (tilt,) = loop.effects_
    assert (tilt.joint, tilt.scope) == (0, "robot")
    assert_allclose(list(tilt.parameters.values()), [roll, pitch], atol=5e-3)
    assert np.all(loop.error_after_ <= loop.error_before_ * 1.1)
    assert loop.error_after_.max() < 0.5 * loop.error_before_.max()
