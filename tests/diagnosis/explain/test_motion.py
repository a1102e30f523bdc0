import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.diagnosis.explain import motion_limits
from sklearn_vbjfa.diagnosis.search import RecordingView
from sklearn_vbjfa.recording import take_arrays
from tests.effects._arms import arm, inverse_dynamics

DT = 0.02
T = np.arange(0.0, 40.0, DT)
GOOD = np.stack([0.8 * np.sin(0.9 * T) + 0.4 * np.sin(2.3 * T), 0.7 * np.sin(T)], 1)


def limits(q, axes="ZY", groups=None):
    """Motion limits of positions (n, nv) of an arm."""
    model = arm(axes)
    v = np.gradient(q, DT, axis=0)
    a = np.gradient(v, DT, axis=0)
    torque = inverse_dynamics(model, np.hstack([q, v, a]))
    torque += 0.5 * v + 0.3 * np.sign(v)
    rng = np.random.default_rng(0)
    torque += 0.02 * rng.normal(size=q.shape)
    position = q + 1e-5 * rng.normal(size=q.shape)
    groups = np.zeros(len(q), dtype=int) if groups is None else groups
    robot = RobotIdentifier(model, dt=DT, friction=("viscous", "coulomb"))
    robot.fit(position, torque, groups=groups)
    measured = take_arrays(
        position,
        torque,
        groups,
        np.ones_like(q),
        dt=DT,
        joint_names=robot.joint_names_,
    )
    return motion_limits(RecordingView(robot, measured))


def second(q):
    """Positions whose second joint moves like that."""
    return np.stack([GOOD[:, 0], q], axis=1)


def rounded_triangles(speed, corner):
    """Back and forth at a speed [rad/s], with rounded corners [s]."""
    v = speed * np.sign(np.sin(2 * np.pi * T / 10.0 + 1e-9))
    width = round(corner / DT)
    v = np.convolve(v, np.ones(width) / width, "same")
    return np.cumsum(v) * DT


def test_a_motion_that_excites_everything_has_no_limits():
    assert limits(GOOD) == ()


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_joint_that_never_reverses(way):
    (found,) = limits(second(way * (0.4 * T + 0.2 * np.sin(T))))
    assert (found.kind, found.joint, found.recordings) == ("one way", 1, (0,))
    # 0.4 + 0.2 cos(t) rad/s
    slow, fast = sorted((abs(found.low), abs(found.high)))
    assert slow == pytest.approx(0.2, abs=0.01)
    assert fast == pytest.approx(0.6, abs=0.01)
    assert np.sign([found.low, found.high]).tolist() == [way, way]


def test_a_recording_that_goes_the_other_way_mends_it():
    there = 0.4 * T + 0.2 * np.sin(T)
    groups = np.arange(T.size) // (T.size // 2)
    both = np.where(groups == 0, there, there[T.size // 2] * 2 - there)
    assert limits(second(both), groups=groups) == ()
    same = limits(second(there), groups=groups)
    assert [(x.kind, x.recordings) for x in same] == [("one way", (0, 1))]


def test_a_joint_of_one_speed():
    found = limits(second(rounded_triangles(0.3, 0.4)))
    assert [(x.kind, x.joint) for x in found] == [("one speed", 1)]
    assert found[0].low == pytest.approx(0.3, rel=0.05)
    assert found[0].high == pytest.approx(0.3, rel=0.05)
    # Half of the time in the corners: all speeds.
    assert limits(second(rounded_triangles(0.3, 2.5))) == ()


def test_a_joint_of_one_pose():
    near = 0.5 + 0.02 * np.sin(1.3 * T) + 0.01 * np.sin(3.1 * T)
    (found,) = limits(second(near))
    assert (found.kind, found.joint) == ("one pose", 1)
    assert found.low == pytest.approx(0.47, abs=0.01)
    assert found.high == pytest.approx(0.53, abs=0.01)
    assert limits(second(0.5 + 10 * (near - 0.5))) == ()


def test_weight_does_not_act_about_a_vertical_axis():
    near = 0.5 + 0.02 * np.sin(1.3 * T) + 0.01 * np.sin(3.1 * T)
    assert limits(np.stack([near, GOOD[:, 1]], axis=1)) == ()


def test_a_link_that_others_turn_hangs_in_many_poses():
    near = 0.5 + 0.02 * np.sin(1.3 * T) + 0.01 * np.sin(3.1 * T)
    q = np.stack([GOOD[:, 0], near], axis=1)
    # About two horizontal axes, of which the first moves.
    assert limits(q, axes="YY") == ()
