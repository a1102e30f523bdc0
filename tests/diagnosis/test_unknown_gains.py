"""The loop with torque channels of unknown gains."""

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
    """Currents of an arm that picks up a ball, with a spring that is not declared."""
    model = arm("ZYX")
    t, states = motion(NV, duration=40.0, dt=DT, seed=4)
    both = (inverse_dynamics(one, states) for one in (with_ball(model), model))
    tau = np.where((t >= PICKED)[:, None], *both)
    tau += VISCOUS * states[:, NV : 2 * NV]
    tau[:, 1] += STIFFNESS * states[:, 1]
    white = np.random.default_rng(0).normal(size=tau.shape)
    return model, states, GAINS * (tau + 0.01 * tau.std(axis=0) * white)


PAYLOAD = Payload(joint=NV - 1, instant=PICKED, centre=tuple(CENTRE))


def close(recording, masses, effects, declared=(PAYLOAD,)):
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
    return loop.fit(X, y)


def test_effects_are_found_beside_unknown_gains(recording):
    loop = close(recording, {"payload": MASS}, ["spring", "torque_gain", "offset"])
    (found,) = loop.effects_
    assert (found.name, found.joint) == ("spring", 1)
    # In N m/rad: what is reported is of the model that is handed over.
    low, high = found.intervals["k"]
    assert low - (high - low) < STIFFNESS < high + (high - low)
    assert_allclose(found.parameters["k"], STIFFNESS, rtol=0.05)
    assert_allclose(loop.identifier_.gains_.gain, GAINS, rtol=0.03)
    assert np.all(loop.error_after_ < 0.02)
    assert loop.report_.outcome.robot["gains"] is loop.identifier_.gains_


@pytest.mark.slow
def test_a_payload_that_is_found_fixes_the_common_gain(recording):
    loop = close(recording, {"payload": MASS}, ["payload", "spring"], ())
    # The spring saves too little of the error to be named.
    probable = (*loop.effects_, *loop.possible_)
    assert {(e.name, e.joint) for e in probable} == {("spring", 1), ("payload", 2)}
    assert [e.name for e in loop.effects_] == ["payload"]
    assert not loop.declared_.gains_.absolute
    assert loop.identifier_.gains_.absolute
    assert_allclose(loop.identifier_.gains_.gain, GAINS, rtol=0.03)
    found = {e.name: e for e in probable}
    assert_allclose(found["payload"].parameters["dm"], MASS, rtol=1e-6)
    assert_allclose(found["spring"].parameters["k"], STIFFNESS, rtol=0.05)
    low, high = found["spring"].intervals["k"]
    assert low - (high - low) < STIFFNESS < high + (high - low)
    assert "follows from the payload of 1.5 kg" in text_of(loop.report_)


def test_the_reference_stays_and_gains_are_not_searched(recording):
    loop = close(recording, None, ["spring", "torque_gain"])
    references = {
        robot.gains_.references
        for robot in (loop.declared_, loop.validation_model_, loop.identifier_)
    }
    assert len(references) == 1
    searched = loop.report_.outcome.provenance["settings"]["effects"]
    assert "torque_gain" not in searched
    (first,) = references.pop()
    assert_allclose(loop.identifier_.gains_.gain, GAINS / GAINS[first], rtol=0.03)
    (found,) = loop.effects_
    assert_allclose(found.parameters["k"], STIFFNESS * GAINS[first], rtol=0.05)
    low, high = found.intervals["k"]
    assert high - low < 0.1 * found.parameters["k"]


@pytest.mark.parametrize(
    ("unit", "gains", "options"),
    [("N m", None, {"gains": (-1, 1, 1, 1, 1, 1)}), ("A", "unknown", {})],
)
def test_signs_are_offered_as_gains_of_torques_alone(unit, gains, options):
    made = make_robot_recording(random_state=3, duration=16.0)
    tau = made.tau * [-1, 1, 1, 1, 1, 1]
    wrong = replace(made, tau=tau, torque_units=6 * (unit,), states=None)
    loop = EffectDiscovery(RobotIdentifier(made.urdf, dt=made.dt, gains=gains))
    with pytest.raises(RecordingRefused, match="has the wrong sign") as caught:
        loop.fit_recording(wrong)
    assert caught.value.options == options
