"""The search by itself: rounds, refinement, pruning, limits."""

import ast
from dataclasses import FrozenInstanceError
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

pytest.importorskip("pinocchio")

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis.search import _search
from tests.diagnosis.search._searches import (
    CLEAN,
    coulomb,
    found,
    search,
    spring,
    stribeck,
)

# -- candidates


def test_candidates_are_what_can_be_looked_for():
    robot = CLEAN.robot(friction=("viscous", "coulomb"))
    now = search(CLEAN.torque(), "all", robot=robot)
    now.accept(())
    names = {e.name for e in now.candidates_of(0)}
    assert not names & {"viscous", "coulomb", "payload"}
    assert {"stribeck", "coupling", "backlash"} <= names
    assert all(e.joint == 0 for e in now.candidates_of(0))
    assert "payload" in {e.name for e in now.candidates_of(1)}


# -- runs


def test_a_clean_recording_needs_nothing():
    now = search(CLEAN.torque(), ["coulomb", "spring", "offset"])
    nothing = now.run()
    assert nothing.effects == ()
    assert nothing.steps == ()
    assert now.at_floor(nothing.model.squares).all()


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
                np.sum(s * now.model.precision)
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
    now.accept(())
    now.accept([effects.Stribeck(1, vs=0.3), effects.Spring(0)])
    now.prune(now.model.effects[1])
    assert [s.action for s in now.steps] == ["drop"]
    assert now.steps[0].evidence.significant(0.05)
    assert [e.name for e in now.model.effects] == ["spring"]


def test_the_plain_effect_comes_before_what_contains_it():
    torque = CLEAN.torque(joint_2=coulomb(1.0))
    now = search(torque, ["stribeck", "presliding", "asymmetric_friction", "coulomb"])
    assert found(now.run()) == [("coulomb", 1)]


def test_a_constant_is_no_spring():
    now = search(CLEAN.torque(joint_1=spring(0.0, 1.0)), ["spring", "offset"]).run()
    assert found(now) == [("offset", 0)]


@pytest.mark.parametrize("limit", [0, 1])
def test_most_effects(limit):
    torque = CLEAN.torque(joint_2=coulomb(1.0), joint_1=spring(4.0))
    now = search(torque, ["coulomb", "spring"], max_effects=limit).run()
    assert len(now.effects) == limit
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
    assert_array_equal(runs[0].model.theta, runs[1].model.theta)


def test_joints_without_weight_are_left_out():
    torque = CLEAN.torque(joint_2=coulomb(1.0), joint_1=spring(4.0))
    now = search(torque, ["coulomb", "spring"])
    now.view.root[:, 1] = 0.0
    now.view.precision[1] = 0.0
    now.view.Z[1] = 0.0
    now.view.target[1] = 0.0
    assert {joint for _, joint in found(now.run())} <= {0}


# -- what the search leaves alone


def test_the_view_is_as_it_was_after_a_search():
    torque = CLEAN.torque(joint_2=coulomb(1.0), joint_1=spring(4.0, 1.0))
    now = search(torque, ["coulomb", "spring", "load_friction"])
    names = ("precision", "Z", "back", "root", "target", "index", "size", "floor")
    before = {name: np.copy(getattr(now.view, name)) for name in names}
    attributes = set(vars(now.view))
    run = now.run()
    assert len(run.effects) == 2
    for name in names:
        assert_array_equal(getattr(now.view, name), before[name])
    assert set(vars(now.view)) == attributes
    with pytest.raises(FrozenInstanceError):
        run.model = None
    with pytest.raises(FrozenInstanceError):
        run.model.effects = ()


def test_no_effect_is_named_in_the_search():
    """What must be known of an effect is read off its class."""
    # A signal is also what an effect may need, in plain English.
    names = set(effects.available()) - {"signal"}
    for path in Path(_search.__file__).parents[1].rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        texts = {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)}
        assert not texts & names, path.name
