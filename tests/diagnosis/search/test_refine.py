"""Shape parameters are searched between the points of the grid."""

from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis.search._refine import ShapePoint, refine_instant
from tests.diagnosis.search._searches import CLEAN, search, stribeck

MOTION = search(CLEAN.torque(), ["stribeck"]).view.motion(None)
GRID = sorted({s["vs"] for s in effects.Stribeck(1).shapes(MOTION)})


def test_bounds_are_the_next_points_of_the_grid():
    inner = ShapePoint.of(effects.Stribeck(1, vs=GRID[2]), MOTION)
    assert inner.at(inner.low).vs == pytest.approx(GRID[1])
    assert inner.at(inner.high).vs == pytest.approx(GRID[3])
    last = ShapePoint.of(effects.Stribeck(1, vs=GRID[-1]), MOTION)
    assert last.at(last.high).vs == pytest.approx(GRID[-1])


def best(start, evidence, motion):
    """Search an instant with a known evidence (of one effect) beside a fit."""
    return refine_instant(
        [start], lambda some: np.array([*map(evidence, some)]), motion
    )


@pytest.mark.parametrize("name", ["stribeck", "ripple"])
def test_the_best_place_between_two_points_is_found(name):
    """One parameter, and two of which one is an angle's period, beside a fit."""
    kind = {"stribeck": effects.Stribeck, "ripple": effects.Ripple}[name]
    (shape, value) = {"stribeck": ("vs", 0.31), "ripple": ("period", 0.23)}[name]
    truth = kind(1, **{shape: value})
    added = truth.columns(MOTION) @ np.full(len(truth.coefficients), 3.0)
    torque = CLEAN.torque()
    torque[:, 1] += added
    path = search(torque, [name]).path()
    found = path.run().members[0].effect
    assert getattr(found, shape) == pytest.approx(value, rel=0.01)
    assert getattr(found, shape) not in [one[shape] for one in found.shapes(MOTION)]


def two_recordings():
    half = MOTION.t.size // 2
    parts = (slice(0, half), slice(half, MOTION.t.size))
    t = MOTION.t + np.where(np.arange(MOTION.t.size) < half, 0.0, 20.0)
    return replace(MOTION, t=t, parts=parts, begins=(t[0], t[half] - 0.5))


def test_an_instant_is_found_among_several_peaks():
    motion = replace(MOTION, begins=(MOTION.t[0],))
    grid = [s["instant"] for s in effects.Payload(1).shapes(motion)]
    truth = grid[3] + 0.4 * (grid[4] - grid[3])

    def evidence(effect):
        away = abs(effect.instant - truth)
        return 1e3 * np.exp(-away) + 50 * np.cos(60 * away)

    start = effects.Payload(1, instant=truth + 0.08)
    found = best(start, evidence, motion)
    assert found.instant == pytest.approx(truth, abs=0.05)
    assert found.instant in motion.t


def test_an_instant_between_two_recordings_is_the_start_of_the_second():
    motion = two_recordings()
    begin = motion.begins[1]
    start = effects.Payload(1, instant=begin + 2.0)

    def shared(effect):
        return 100.0 * (begin - 5.0 < effect.instant <= begin)

    assert best(start, shared, motion).instant == begin


def test_no_instant_is_in_a_recording_of_which_all_rows_are_left_out():
    motion = two_recordings()
    last = motion.t[-1]
    motion = replace(motion, begins=(*motion.begins, last + 1.0))
    start = effects.Payload(1, instant=last - 0.5)
    assert best(start, lambda effect: effect.instant, motion).instant <= last


@pytest.mark.parametrize(("worth", "left"), [(4.0, False), (20.0, True)])
def test_rows_within_a_recording_say_more_than_how_many_there_are(worth, left):
    motion = two_recordings()
    begin = motion.begins[1]

    def later(effect):
        return worth * (effect.instant > begin)

    start = effects.Payload(1, instant=begin + 2.0)
    assert (best(start, later, motion).instant > begin) == left


def test_the_instant_of_a_jump_is_found_wherever_it_is():
    """A narrow peak between two points of the grid, off the best of which it lies."""
    truth = 9.13
    payload = effects.Payload(1, instant=truth)
    added = payload.columns(MOTION) @ [0.5, 0.02, 0.03, 0.01, 0.0]
    path = search(CLEAN.torque() + added, ["payload"]).path()
    fit = path.run()
    (member,) = fit.members
    assert member.effect.instant == pytest.approx(truth, abs=0.05)


def test_another_form_is_taken_where_it_is_more_probable():
    robot = CLEAN.robot(friction=("viscous", "coulomb"))
    torque = CLEAN.torque(joint_2=stribeck(1.0))
    path = search(torque, ["stribeck"], robot=robot).path()
    fit = path.refined(path.fit_effects([effects.Stribeck(1, vs=0.4, k=2)]))
    (member,) = fit.members
    assert member.effect.k == 1
    assert member.effect.vs == pytest.approx(0.3, rel=0.15)
