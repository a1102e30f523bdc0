"""What a report leaves open becomes what the motion decides."""

import json
from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.design import design_motion
from sklearn_vbjfa.effects import Spring
from sklearn_vbjfa.robot import FitOptions
from tests.design._chains import chain, posed, swung

DT, STIFFNESS = 0.01, 12.0


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return chain(tmp_path_factory.mktemp("open"), ("revolute",) * 2, effort=60.0)


@pytest.fixture(scope="module")
def loop(path):
    """Search in a recording of a robot with a spring on its second joint."""
    q, tau = swung(path, [0.31, 0.43], 1500, third=0.4)
    tau[:, 1] += STIFFNESS * (q[:, 1] - 0.2)
    rng = np.random.default_rng(0)
    tau += 0.05 * rng.normal(size=tau.shape)
    robot = RobotIdentifier(path, dt=DT, friction=("viscous",))
    found = EffectDiscovery(
        robot, effects=("spring", "coulomb", "offset"), random_state=0
    )
    return found.fit(q + 1e-5 * rng.normal(size=q.shape), tau)


def moving_states():
    """States (50, 6) with velocities whose sign the encoder's noise cannot change."""
    rng = np.random.default_rng(0)
    states = rng.uniform(-1, 1, size=(50, 6))
    states[:, 2:4] += 0.3 * np.sign(states[:, 2:4])
    return states


def asked_of(problem):
    effects = problem.model.effects[problem.model.n_members :]
    return {
        (one.effect.name, one.effect.joint): weight
        for one, weight in zip(effects, problem.questions.alone)
    }


def test_all_kinds_of_reports_ask_the_same(loop, tmp_path):
    assert [(e.name, e.joint) for e in loop.effects_] == [("spring", 1)]
    data = loop.report_.to_dict()
    (tmp_path / "report.json").write_text(json.dumps(data), encoding="utf-8")
    kinds = (loop, loop.report_, data, tmp_path, str(tmp_path / "report.json"))
    asked = [asked_of(posed(loop.identifier_, report=kind)) for kind in kinds]
    assert all(one == asked[0] for one in asked)
    # What was found is to be confirmed, and counts more than what nobody named.
    weights = [weight for weight in asked[0].values() if weight > 0]
    assert asked[0]["spring", 1] == max(weights) > min(weights)


def test_an_identified_robot_brings_its_torques_and_its_noise(loop, path):
    problem = posed(loop.identifier_)
    states = moving_states()
    expected = loop.identifier_.predict(states)
    found = problem.torques(problem.model(states))
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    # Louder joints count less, as their variance.
    loud = RobotIdentifier(
        path,
        dt=DT,
        options=FitOptions(torque_noise=np.array([0.1, 0.4])),
        friction=("viscous",),
    )
    loud.fit(*swung(path, [0.5, 0.8], 800))
    noise = posed(loud).noise
    assert (noise[1] / noise[0]) ** 2 == pytest.approx(16.0, rel=0.2)
    # The noise of a reading, which is a gain times the torque.
    readings, features = posed(loud).robot.torque_noise, copy(loud.features_)
    features.gains_ = np.array([2.0, 0.5])
    channels = replace(loud.robot_, features_=features)
    np.testing.assert_allclose(
        posed(channels).robot.torque_noise, readings / features.gains_
    )


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        (("nothing",), "Unknown effect 'nothing'"),
        ((Spring(joint=2),), "on joint 2, counted from zero; the robot has 2 joints"),
        (("base_tilt",), "No motion is designed for 'base_tilt'"),
    ],
)
def test_effects_that_cannot_be_asked_for(path, effects, message):
    with pytest.raises(ValueError, match=message):
        posed(path, effects=effects)


def test_reports_that_are_none(path, tmp_path, loop):
    with pytest.raises(TypeError, match="got int"):
        posed(path, report=5)
    with pytest.raises(FileNotFoundError, match="No report at"):
        posed(path, report=tmp_path / "nowhere")
    (tmp_path / "report.json").write_text("{", encoding="utf-8")
    with pytest.raises(ValueError, match="not readable as JSON"):
        posed(path, report=tmp_path)
    (tmp_path / "report.json").write_text("{}", encoding="utf-8")
    with pytest.raises(ValueError, match="not a report of identify"):
        posed(path, report=tmp_path)
    other = chain(tmp_path, ("revolute",) * 2, name="other")
    with pytest.raises(ValueError, match="report is of joints chain_1, chain_2"):
        posed(other, report=loop)


@pytest.mark.slow
def test_a_report_bends_the_motion_and_tells_what_it_shows(loop):
    motion = design_motion(
        loop.identifier_, report=loop, duration=3.0, dt=0.02, random_state=0
    )
    assert motion.within_limits
    told = {(one.name, one.joint): one for one in motion.shows}
    assert told["spring", 1].joint_name == "chain_2"
    # Twelve newton metres per radian are plain to see.
    assert 0 < told["spring", 1].least < 0.2 * STIFFNESS
