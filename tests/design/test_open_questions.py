"""Motions designed from reports."""

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
    """Search effects of a robot with a spring on its second joint."""
    q, tau = swung(path, [0.31, 0.43], 1500, third=0.4)
    tau[:, 1] += STIFFNESS * (q[:, 1] - 0.2)
    rng = np.random.default_rng(0)
    tau += 0.05 * rng.normal(size=tau.shape)
    robot = RobotIdentifier(path, dt=DT, friction=("viscous",))
    discovery = EffectDiscovery(
        robot, effects=("spring", "coulomb", "offset"), random_state=0
    )
    return discovery.fit(q + 1e-5 * rng.normal(size=q.shape), tau)


def moving_states():
    """Draw states (50, 6) with velocities well above the encoder noise."""
    rng = np.random.default_rng(0)
    states = rng.uniform(-1, 1, size=(50, 6))
    states[:, 2:4] += 0.3 * np.sign(states[:, 2:4])
    return states


def test_all_forms_of_a_report_give_the_same_questions(loop, tmp_path):
    assert [(e.name, e.joint) for e in loop.effects_] == [("spring", 1)]
    data = loop.report_.to_dict()
    (tmp_path / "report.json").write_text(json.dumps(data), encoding="utf-8")
    kinds = (loop, loop.report_, data, tmp_path, str(tmp_path / "report.json"))
    asked = []
    for kind in kinds:
        problem = posed(loop.identifier_, report=kind)
        effects = problem.model.effects[problem.model.n_members :]
        names = [(one.effect.name, one.effect.joint) for one in effects]
        asked.append(dict(zip(names, problem.questions.alone)))
    assert all(one == asked[0] for one in asked)
    # The discovered effect has the largest weight.
    weights = [weight for weight in asked[0].values() if weight > 0]
    assert asked[0]["spring", 1] == max(weights) > min(weights)


def test_design_uses_torques_and_noise_of_the_identified_robot(loop, path):
    problem = posed(loop.identifier_)
    states = moving_states()
    expected = loop.identifier_.predict(states)
    torques = problem.torques(problem.model(states))
    np.testing.assert_allclose(torques, expected, atol=1e-6 * np.abs(expected).max())
    # Noise of the design follows the torque noise of each joint.
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
def test_invalid_effects_of_a_design_are_refused(path, effects, message):
    with pytest.raises(ValueError, match=message):
        posed(path, effects=effects)


def test_invalid_reports_are_refused(path, tmp_path, loop):
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
def test_motion_for_a_report_shows_its_effect(loop):
    motion = design_motion(
        loop.identifier_, report=loop, duration=3.0, dt=0.02, random_state=0
    )
    assert motion.within_limits
    shown = {(one.name, one.joint): one for one in motion.shows}
    assert shown["spring", 1].joint_name == "chain_2"
    # The stiffness is clearly detectable.
    assert 0 < shown["spring", 1].least < 0.2 * STIFFNESS
