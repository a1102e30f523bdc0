"""EffectDiscovery with torque channels of unknown gain."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.effects import Payload
from sklearn_vbjfa.recording import RecordingRefused
from sklearn_vbjfa.robot import FitOptions
from tests.diagnosis.report._pages import text_of
from tests.effects._arms import arm, inverse_dynamics, motion
from tests.robot.test_known_masses import CENTRE, GAINS, MASS, with_ball

DT, NV = 0.02, 3
STIFFNESS, PICKED = 6.0, 20.0
VISCOUS = np.array([0.5, 0.4, 0.3])


@pytest.fixture(scope="module")
def recording():
    """Simulate currents of an arm that picks up a ball; a spring is not declared."""
    model = arm("ZYX")
    t, states = motion(NV, duration=40.0, dt=DT, seed=4)
    torques = (inverse_dynamics(x, states) for x in (with_ball(model), model))
    tau = np.where((t >= PICKED)[:, None], *torques)
    tau += VISCOUS * states[:, NV : 2 * NV]
    tau[:, 1] += STIFFNESS * states[:, 1]
    white = np.random.default_rng(0).normal(size=tau.shape)
    return model, states, GAINS * (tau + 0.01 * tau.std(axis=0) * white)


PAYLOAD = Payload(joint=NV - 1, instant=PICKED, centre=tuple(CENTRE))


def discover(recording, masses, effects, declared=(PAYLOAD,), groups=None):
    model, X, y = recording
    robot = RobotIdentifier(
        model,
        dt=DT,
        effects=declared,
        gains="unknown",
        options=FitOptions(known_masses=masses),
        cutoff=None,
        friction=("viscous",),
    )
    loop = EffectDiscovery(robot, effects=effects, random_state=0)
    return loop.fit(X, y, groups)


@pytest.fixture(scope="module")
def absolute(recording):
    effects = ["spring", "torque_gain", "offset"]
    return discover(recording, {"payload": MASS}, effects)


def column(loop, name):
    return [row[name] for row in loop.report_.to_dict()["errors"]]


def expected_errors(loop):
    return [x.value for x in loop.report_.outcome.facts_of("next recording")]


def test_effects_are_found_with_unknown_gains(absolute):
    loop = absolute
    (effect,) = loop.effects_
    assert (effect.name, effect.joint) == ("spring", 1)
    # In N m/rad: parameters of the completed model.
    low, high = effect.intervals["k"]
    assert low - (high - low) < STIFFNESS < high + (high - low)
    assert_allclose(effect.parameters["k"], STIFFNESS, rtol=0.05)
    assert_allclose(loop.identifier_.gains_.gain, GAINS, rtol=0.03)
    assert np.all(loop.error_after_ < 0.02)
    assert loop.report_.outcome.robot["gains"] is loop.identifier_.gains_
    # The report is in N m, attributes are in the units of the channels.
    assert column(loop, "unit") == NV * ["N m"]
    assert_allclose(column(loop, "spread"), loop.torque_std_ / GAINS, rtol=0.03)
    joints = [curve.joint for curve in loop.report_.outcome.curves["torques"]]
    drawn = [np.nanstd(x.measured) for x in loop.report_.outcome.curves["torques"]]
    assert_allclose(drawn, np.take(column(loop, "spread"), joints), rtol=0.5)


@pytest.mark.slow
def test_a_discovered_payload_fixes_the_common_gain(recording):
    loop = discover(recording, {"payload": MASS}, ["payload", "spring"], ())
    # The spring reduces the error too little to be named.
    probable = (*loop.effects_, *loop.possible_)
    assert {(e.name, e.joint) for e in probable} == {("spring", 1), ("payload", 2)}
    assert [e.name for e in loop.effects_] == ["payload"]
    assert not loop.declared_.gains_.absolute
    assert loop.identifier_.gains_.absolute
    assert_allclose(loop.identifier_.gains_.gain, GAINS, rtol=0.03)
    by_name = {e.name: e for e in probable}
    assert_allclose(by_name["payload"].parameters["dm"], MASS, rtol=1e-6)
    assert_allclose(by_name["spring"].parameters["k"], STIFFNESS, rtol=0.05)
    low, high = by_name["spring"].intervals["k"]
    assert low - (high - low) < STIFFNESS < high + (high - low)
    assert "follows from the payload of 1.5 kg" in text_of(loop.report_)


def test_a_known_payload_may_change_between_recordings(recording):
    groups = np.arange(len(recording[2])) * DT >= PICKED
    effects = ["payload", "spring"]
    loop = discover(recording, {"payload": MASS}, effects, (), groups)
    assert_allclose(loop.identifier_.gains_.gain, GAINS, rtol=0.03)
    assert loop.report_.outcome.findings["contradictions"] == ()
    # Without the mass, the change is a difference between recordings.
    assert discover(recording, None, effects, (), groups).effects_ == ()


def test_reference_channel_is_kept_and_gains_are_not_searched(recording, absolute):
    loop = discover(recording, None, ["spring", "torque_gain"])
    references = {
        robot.gains_.references
        for robot in (loop.declared_, loop.validation_model_, loop.identifier_)
    }
    assert len(references) == 1
    searched = loop.report_.outcome.provenance["settings"]["effects"]
    assert "torque_gain" not in searched
    (first,) = references.pop()
    assert_allclose(loop.identifier_.gains_.gain, GAINS / GAINS[first], rtol=0.03)
    (effect,) = loop.effects_
    assert_allclose(effect.parameters["k"], STIFFNESS * GAINS[first], rtol=0.05)
    low, high = effect.intervals["k"]
    assert high - low < 0.1 * effect.parameters["k"]
    assert column(loop, "unit") == NV * ["channel units"]
    assert_allclose(column(loop, "spread"), loop.torque_std_, rtol=1e-12)
    assert_allclose(expected_errors(loop), expected_errors(absolute), rtol=0.2)
    X, motion = recording[1], loop.expected_error(recording[1])[0]
    assert_allclose(motion, absolute.expected_error(X)[0], rtol=0.2)


@pytest.mark.parametrize(
    ("unit", "gains", "options"),
    [("N m", None, {"gains": (-1, 1, 1, 1, 1, 1)}), ("A", "unknown", {})],
)
def test_sign_corrections_are_suggested_for_torques_only(unit, gains, options):
    arm = make_robot_recording(random_state=3, duration=16.0)
    tau = arm.tau * [-1, 1, 1, 1, 1, 1]
    wrong = replace(arm, tau=tau, torque_units=6 * (unit,), states=None)
    loop = EffectDiscovery(RobotIdentifier(arm.urdf, dt=arm.dt, gains=gains))
    with pytest.raises(RecordingRefused, match="has the wrong sign") as error_info:
        loop.fit_recording(wrong)
    assert error_info.value.options == options
