import dataclasses

import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier, VBJFARegressor
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.diagnosis import analyse_residuals


@pytest.fixture(scope="module", name="recording")
def fixture_recording():
    return make_robot_recording(duration=15.0, dt=0.01, random_state=0)


def robot_of(recording, **changes):
    return RobotIdentifier(
        recording.robot_model(),
        dt=recording.dt,
        **{"friction": ("viscous",), **changes},
    )


@pytest.fixture(scope="module", name="found")
def fixture_found(recording):
    return analyse_residuals(robot_of(recording), recording.q, recording.tau)


def test_missing_friction_is_seen_on_every_joint(found):
    names = found.joint_names
    assert (found.rms > 2 * found.floor).all()
    for name, signals in zip(names, found.dependences):
        assert signals[0].signal == f"speed of {name}"
        assert signals[0].share > 0.3
    assert (found.correlation_time > 0.02).all()


def test_a_complete_model_leaves_less(recording, found):
    robot = robot_of(recording, friction=("viscous", "coulomb"))
    complete = analyse_residuals(robot, recording.q, recording.tau)
    assert (complete.rms < 0.5 * found.rms).all()
    assert (complete.correlation_time < found.correlation_time).all()


def test_residuals_are_out_of_sample(recording, found):
    robot = robot_of(recording).fit(recording.q, recording.tau)
    again = analyse_residuals(robot, recording.q, recording.tau)
    np.testing.assert_allclose(again.residual, found.residual)
    own = robot.residuals(recording.q, recording.tau)
    np.testing.assert_array_equal(own.index, found.index)
    assert (found.rms > own.rms()).mean() > 0.5
    assert not np.allclose(own.residual, found.residual)


def test_numbers_agree_with_the_residuals(found):
    used = found.weight > 0
    for j in range(used.shape[1]):
        r = found.residual[used[:, j], j]
        w = found.weight[used[:, j], j]
        assert found.rms[j] == pytest.approx(np.sqrt(np.average(r**2, weights=w)))
        tau = found.torque[used[:, j], j]
        spread = np.sqrt(np.cov(tau, aweights=w, ddof=0))
        assert found.error[j] == pytest.approx(found.rms[j] / spread)


def test_text_is_a_short_table(found):
    lines = str(found).splitlines()
    # one row a joint, of which only the last column may go on below itself
    rows = [line for line in lines[1:-1] if not line.startswith(10 * " ")]
    assert len(rows) == len(found.joint_names)
    assert max(map(len, lines)) <= 80
    assert "its speed" in lines[1]


def test_result_is_frozen(found):
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.rms = None


def test_other_estimators_are_refused(recording):
    with pytest.raises(ValueError, match="must be a RobotIdentifier"):
        analyse_residuals(VBJFARegressor(), recording.q, recording.tau)


def test_recordings_too_short_for_blocks_are_refused(recording):
    robot = robot_of(recording, cutoff=1.0)
    with pytest.raises(ValueError, match="too little for 12 blocks"):
        analyse_residuals(robot, recording.q[:1000], recording.tau[:1000])
