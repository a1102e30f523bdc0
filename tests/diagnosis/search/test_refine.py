"""Shape parameters are searched between the points of the grid."""

import pytest

pytest.importorskip("pinocchio")

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis.search._refine import Bracket, refined
from tests.diagnosis.search._searches import CLEAN, search

MOTION = search(CLEAN.torque(), ["stribeck"]).view.motion(None)
GRID = sorted({s["vs"] for s in effects.Stribeck(1).shapes(MOTION)})


def test_brackets_reach_to_the_next_points_of_the_grid():
    inner = Bracket.of(effects.Stribeck(1, vs=GRID[2]), "vs", MOTION)
    assert inner.logarithmic
    assert inner.value(inner.low) == pytest.approx(GRID[1])
    assert inner.value(inner.high) == pytest.approx(GRID[3])
    last = Bracket.of(effects.Stribeck(1, vs=GRID[-1]), "vs", MOTION)
    assert last.value(last.high) == pytest.approx(GRID[-1])
    # The sign itself has no smoothing to go on from.
    assert Bracket.of(effects.Coulomb(1), "smoothing", MOTION) is None


def test_the_best_place_between_two_points_is_found():
    truth = (GRID[1] * GRID[2] ** 2) ** (1 / 3)
    start = effects.Stribeck(1, vs=GRID[2])
    best = refined([start], lambda e: -((e.vs / truth - 1) ** 2), MOTION)
    assert best.vs == pytest.approx(truth, rel=0.01)


def test_what_is_no_better_between_stays_on_the_grid():
    start = effects.Stribeck(1, vs=GRID[2])
    assert refined([start], lambda e: float(e.vs == GRID[2]), MOTION) is start
