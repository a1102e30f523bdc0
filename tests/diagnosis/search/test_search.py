"""The search by itself: rounds, refinement, pruning, limits."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

pytest.importorskip("pinocchio")

from sklearn_vbjfa import effects
from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.diagnosis.search._search import EffectSearch
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from tests.diagnosis._recordings import DT, record

CLEAN = record("ZY", seed=2)


def coulomb(size):
    return lambda r: size * np.sign(r.v[:, 1])


def spring(k, c=0.0):
    return lambda r: k * r.q[:, 0] + c


def stribeck(size):
    def torque(r):
        v = r.v[:, 1]
        return (1.0 + size * np.exp(-np.abs(v / 0.3))) * np.sign(v)

    return torque


def search(torque, library, recording=CLEAN, robot=None, groups=None, **given):
    robot = recording.robot() if robot is None else robot
    groups = np.zeros(torque.shape[0], int) if groups is None else groups
    robot.fit(recording.position, torque, groups=groups)
    weight = np.ones_like(torque)
    view = RecordingView(robot, recording.position, torque, groups, weight, recording.t)
    return EffectSearch(
        view=view,
        library=effects.resolve(library),
        declared=tuple(robot.features_.friction_),
        floor=robot.noise_floor_**2,
        **{"alpha": 0.05, **given},
    )


def found(run):
    return [(e.name, e.joint) for e in run.accepted]


# -- the recording as the search sees it


def test_columns_pass_the_filter_of_the_torques():
    torque = CLEAN.torque()
    now = search(torque, ["coulomb"])
    view, robot = now.view, now.view.robot
    lowpass = _lowpass.design(DT, robot.cutoff_)
    motion = view.motion(None)
    for effect in (effects.Coulomb(1), effects.Counterbalance(0)):
        columns = view.columns([effect], motion)
        assert columns.shape == (1, view.index.size, 1, len(effect.coefficients))
        expected = lowpass(effect.columns(motion)) * view.root[:, [effect.joint]]
        assert_allclose(columns[0, :, 0], expected, atol=1e-12)
    residuals = robot.residuals(CLEAN.position, torque)
    assert_array_equal(view.index, residuals.index)
    assert_allclose(view.target.T, residuals.torque * view.root, atol=1e-12)
    assert_allclose(view.equations.weight, residuals.weight, atol=1e-12)


def test_whole_robot_effects_have_columns_on_every_joint():
    now = search(CLEAN.torque(), ["payload"])
    payload = effects.Payload(joint=1, instant=10.0)
    columns = now.view.columns([payload], now.view.motion(None))
    assert columns.shape == (2, now.view.index.size, 1, 5)
    before = CLEAN.t[now.view.index] < 9.0
    assert_array_equal(columns[:, before], 0.0)
    assert np.abs(columns[:, ~before]).max() > 0


def test_filter_and_blocks_respect_recordings():
    groups = np.repeat([0, 1], [500, CLEAN.t.size - 500])
    view = search(CLEAN.torque(), ["coulomb"], groups=groups).view
    half = _lowpass.design(DT, view.robot.cutoff_).half
    assert np.all((view.index < 500 - half) | (view.index >= 500 + half))
    first = np.flatnonzero(view.index >= 500)[0]
    assert_array_equal(view.starts, [0, first])
    assert view.blocks.label[first] == view.blocks.label[first - 1] + 1


def test_load_is_that_of_the_bodies():
    now = search(CLEAN.torque(), ["load_friction"])
    now.run()
    inside = slice(50, -50)
    error = (now.motion.load - CLEAN.load)[inside]
    assert np.all(error.std(axis=0) < 0.03 * CLEAN.load.std(axis=0))


# -- candidates


def test_candidates_are_what_can_be_looked_for():
    robot = CLEAN.robot(friction=("viscous", "coulomb"))
    now = search(CLEAN.torque(), "all", robot=robot)
    now.motion = now.view.motion(None)
    names = {e.name for e in now.candidates_of(0)}
    assert not names & {"viscous", "coulomb", "payload"}
    assert {"stribeck", "coupling", "backlash"} <= names
    assert all(e.joint == 0 for e in now.candidates_of(0))
    assert "payload" in {e.name for e in now.candidates_of(1)}


# -- runs


def test_a_clean_recording_needs_nothing():
    now = search(CLEAN.torque(), ["coulomb", "spring", "offset"]).run()
    assert now.accepted == []
    assert now.steps == []
    assert now.at_floor(now.before).all()


def test_steps_tell_the_story():
    torque = CLEAN.torque(joint_2=coulomb(1.0), joint_1=spring(4.0, 1.0))
    now = search(torque, ["coulomb", "spring", "offset"]).run()
    assert sorted(found(now)) == [("coulomb", 1), ("spring", 0)]
    added = {(s.effect.name, s.effect.joint) for s in now.steps if s.action == "add"}
    assert set(found(now)) <= added
    for step in now.steps:
        assert step.action in {"add", "replace", "drop", "refuse", "withdraw"}
        assert (step.replaced is not None) == (step.action == "replace")
        if step.action == "add":
            assert step.evidence.significant(step.rule.level)
            assert 0.05 / step.rule.n_tests <= step.rule.level <= 0.05
            before, after = (
                np.sum(s * now.view.precision)
                for s in (step.squares_before, step.squares_after)
            )
            assert after < before
        assert step.effect not in [rival.effect for rival in step.rivals]


def test_what_has_the_wrong_sign_is_something_else():
    """Friction that falls towards standstill is no Stribeck friction."""
    rising = CLEAN.torque(joint_2=stribeck(0.6))
    falling = CLEAN.torque(joint_2=stribeck(-0.6))
    friction = ("viscous", "coulomb")
    for torque, expected in ((rising, [("stribeck", 1)]), (falling, [])):
        robot = CLEAN.robot(friction=friction)
        assert found(search(torque, ["stribeck"], robot=robot).run()) == expected


def test_what_took_the_wrong_sign_beside_others_is_dropped():
    robot = CLEAN.robot(friction=("viscous", "coulomb"))
    now = search(CLEAN.torque(joint_2=stribeck(-0.6)), ["stribeck"], robot=robot)
    now._refresh()
    now.accepted = [effects.Stribeck(1, vs=0.3), effects.Spring(0)]
    now._refresh()
    now._prune(now.accepted[1])
    assert [s.action for s in now.steps] == ["drop"]
    assert now.steps[0].evidence.significant(0.05)
    assert [e.name for e in now.accepted] == ["spring"]


def test_coefficients_are_in_the_effects_own_units():
    torque = CLEAN.torque(joint_2=coulomb(1.5), joint_1=spring(4.0, 1.0))
    now = search(torque, ["coulomb", "spring"]).run()
    by_name = {e.name: now.coefficients(e) for e in now.accepted}
    assert_allclose(by_name["coulomb"], [1.5], rtol=0.02)
    assert_allclose(by_name["spring"], [4.0, 1.0], rtol=0.05)
    with pytest.raises(ValueError, match="not among the accepted"):
        now.coefficients(effects.Offset(0))


def test_the_plain_effect_comes_before_what_contains_it():
    torque = CLEAN.torque(joint_2=coulomb(1.0))
    now = search(torque, ["stribeck", "presliding", "asymmetric_friction", "coulomb"])
    assert found(now.run()) == [("coulomb", 1)]


def test_a_constant_is_no_spring():
    now = search(CLEAN.torque(joint_1=spring(0.0, 1.0)), ["spring", "offset"]).run()
    assert found(now) == [("offset", 0)]


@pytest.mark.parametrize("period", [0.23, 0.41])
def test_shapes_are_refined_between_the_points_of_the_grid(period):
    torque = CLEAN.torque(
        joint_2=lambda r: 0.8 * np.cos(2 * np.pi * r.q[:, 1] / period)
    )
    now = search(torque, ["ripple"]).run()
    assert found(now) == [("ripple", 1)]
    assert now.accepted[0].period == pytest.approx(period, rel=0.01)
    grid = [s["period"] for s in now.accepted[0].shapes(now.motion)]
    assert now.accepted[0].period not in grid


@pytest.mark.parametrize("limit", [0, 1])
def test_most_effects(limit):
    torque = CLEAN.torque(joint_2=coulomb(1.0), joint_1=spring(4.0))
    now = search(torque, ["coulomb", "spring"], max_effects=limit).run()
    assert len(now.accepted) == limit
    assert len([s for s in now.steps if s.action == "add"]) == limit


def test_progress_is_told():
    said = []
    torque = CLEAN.torque(joint_2=coulomb(1.0))
    search(torque, ["coulomb"], on_progress=lambda *x: said.append(x)).run()
    assert said[0] == (0, "joint 1 of 2")
    assert said[-1][0] >= 1


def test_the_search_draws_nothing():
    torque = CLEAN.torque(joint_2=coulomb(0.3))
    runs = [search(torque, ["coulomb", "stribeck"]).run() for _ in range(2)]
    assert found(runs[0]) == found(runs[1])
    assert_array_equal(runs[0].base.theta, runs[1].base.theta)


def test_joints_without_weight_are_left_out():
    torque = CLEAN.torque(joint_2=coulomb(1.0), joint_1=spring(4.0))
    now = search(torque, ["coulomb", "spring"])
    now.view.root[:, 1] = 0.0
    now.view.precision[1] = 0.0
    now.view.Z[1] = 0.0
    now.view.target[1] = 0.0
    now.run()
    assert {joint for _, joint in found(now)} <= {0}
