"""Refinement of shape parameters between the points of the grid."""

from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis.search._refine import ShapePoint, refine_instant
from tests.diagnosis.search._searches import CLEAN, search, stribeck

MOTION = search(CLEAN.torque(), ["stribeck"]).view.motion(None)
GRID = sorted({s["vs"] for s in effects.Stribeck(1).shapes(MOTION)})


def test_bounds_are_neighbouring_grid_points():
    inner = ShapePoint.of(effects.Stribeck(1, vs=GRID[2]), MOTION)
    assert inner.at(inner.low).vs == pytest.approx(GRID[1])
    assert inner.at(inner.high).vs == pytest.approx(GRID[3])
    last = ShapePoint.of(effects.Stribeck(1, vs=GRID[-1]), MOTION)
    assert last.at(last.high).vs == pytest.approx(GRID[-1])


def test_negative_shapes_are_refined_like_positive_ones():
    kinds = [effects.Coupling(1, other=0, ratio=sign * 0.7) for sign in (1, -1)]
    points = [ShapePoint.of(kind, MOTION) for kind in kinds]
    moved = [point.moved(0.1 * point.width).effect.ratio for point in points]
    assert moved[0] == -moved[1] != 0.7


def refine(start, evidence, motion):
    """Refine an instant with a given evidence function."""
    return refine_instant(start, lambda some: np.array([*map(evidence, some)]), motion)


@pytest.mark.parametrize("name", ["stribeck", "ripple"])
def test_shapes_are_refined_between_grid_points(name):
    kind = {"stribeck": effects.Stribeck, "ripple": effects.Ripple}[name]
    (shape, value) = {"stribeck": ("vs", 0.31), "ripple": ("period", 0.23)}[name]
    truth = kind(1, **{shape: value})
    extra = truth.columns(MOTION) @ np.full(len(truth.coefficients), 3.0)
    torque = CLEAN.torque()
    torque[:, 1] += extra
    path = search(torque, [name]).path()
    effect = path.run().members[0].effect
    assert getattr(effect, shape) == pytest.approx(value, rel=0.01)
    assert getattr(effect, shape) not in [s[shape] for s in effect.shapes(MOTION)]


def two_recordings():
    half = MOTION.t.size // 2
    parts = (slice(0, half), slice(half, MOTION.t.size))
    t = MOTION.t + np.where(np.arange(MOTION.t.size) < half, 0.0, 20.0)
    return replace(MOTION, t=t, parts=parts, begins=(t[0], t[half] - 0.5))


def test_instant_with_several_local_maxima():
    motion = replace(MOTION, begins=(MOTION.t[0],))
    grid = [s["instant"] for s in effects.Payload(1).shapes(motion)]
    truth = grid[3] + 0.4 * (grid[4] - grid[3])

    def evidence(effect):
        distance = abs(effect.instant - truth)
        return 1e3 * np.exp(-distance) + 50 * np.cos(60 * distance)

    start = effects.Payload(1, instant=truth + 0.08)
    refined = refine(start, evidence, motion)
    assert refined.instant == pytest.approx(truth, abs=0.05)
    assert refined.instant in motion.t


def test_instant_between_two_recordings():
    motion = two_recordings()
    begin = motion.begins[1]
    start = effects.Payload(1, instant=begin + 2.0)

    def shared(effect):
        return 100.0 * (begin - 5.0 < effect.instant <= begin)

    assert refine(start, shared, motion).instant == begin


def test_instants_avoid_held_out_recordings():
    motion = two_recordings()
    last = motion.t[-1]
    motion = replace(motion, begins=(*motion.begins, last + 1.0))
    start = effects.Payload(1, instant=last - 0.5)
    assert refine(start, lambda effect: effect.instant, motion).instant <= last


@pytest.mark.parametrize(("gain", "moves"), [(4.0, False), (20.0, True)])
def test_instants_within_a_recording_need_more_evidence(gain, moves):
    motion = two_recordings()
    begin = motion.begins[1]

    def later(effect):
        return gain * (effect.instant > begin)

    start = effects.Payload(1, instant=begin + 2.0)
    assert (refine(start, later, motion).instant > begin) == moves


def test_instant_of_a_payload_is_found_between_grid_points():
    truth = 9.13
    payload = effects.Payload(1, instant=truth)
    added = payload.columns(MOTION) @ [0.5, 0.02, 0.03, 0.01, 0.0]
    path = search(CLEAN.torque() + added, ["payload"]).path()
    fit = path.run()
    (member,) = fit.members
    assert member.effect.instant == pytest.approx(truth, abs=0.05)


def test_the_more_probable_form_is_selected():
    robot = CLEAN.robot(friction=("viscous", "coulomb"))
    torque = CLEAN.torque(joint_2=stribeck(1.0))
    path = search(torque, ["stribeck"], robot=robot).path()
    fit = path.refined(path.fit_effects([effects.Stribeck(1, vs=0.4, k=2)]))
    (member,) = fit.members
    assert member.effect.k == 1
    assert member.effect.vs == pytest.approx(0.3, rel=0.15)
