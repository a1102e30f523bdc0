"""Shape parameters are searched between the points of the grid."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis.search._shapes import Bracket, refined
from tests.diagnosis._recordings import record
from tests.diagnosis.search._searches import CLEAN, found, search


@pytest.mark.parametrize("period", [0.23, 0.41])
def test_shapes_are_refined_between_the_points_of_the_grid(period):
    torque = CLEAN.torque(
        joint_2=lambda r: 0.8 * np.cos(2 * np.pi * r.q[:, 1] / period)
    )
    now = search(torque, ["ripple"]).run()
    assert found(now) == [("ripple", 1)]
    (ripple,) = now.effects
    assert ripple.period == pytest.approx(period, rel=0.01)
    assert ripple.period not in [s["period"] for s in ripple.shapes(now.model.motion)]


def test_shapes_are_not_judged_on_what_they_were_tuned_to():
    """A ripple in white noise: its best period helps on all rows, and in no fold."""
    noisy = record("Y", seed=1, duration=24.0, noise=0.5)
    now = search(noisy.torque(), ["ripple"], noisy)
    now.accept(())
    (ripple,) = [e for e in now.candidates_of(0) if e.name == "ripple"]
    family = now.model.family(ripple)
    best = family.effects[now.model.fitted.score([0], family.columns).best]
    now.accept([refined(best, now.model)])
    before = now.model.beside(()).squares
    tuned = 1 - now.model.squares.sum() / before.sum()
    assert tuned > 0.02
    evidence = now.evidence_of(now.model.effects[0])
    assert evidence.gain < 0.5 * tuned
    assert not evidence.significant(0.05)


def test_brackets_reach_to_the_next_points_of_the_grid():
    now = search(CLEAN.torque(), ["stribeck"])
    motion = now.view.motion(None)
    grid = sorted({s["vs"] for s in effects.Stribeck(1).shapes(motion)})
    inner = Bracket.of(effects.Stribeck(1, vs=grid[2]), "vs", motion)
    assert inner.logarithmic
    assert inner.value(inner.low) == pytest.approx(grid[1])
    assert inner.value(inner.high) == pytest.approx(grid[3])
    last = Bracket.of(effects.Stribeck(1, vs=grid[-1]), "vs", motion)
    assert last.value(last.high) == pytest.approx(grid[-1])
    # The sign itself has no smoothing to go on from.
    assert Bracket.of(effects.Coulomb(1), "smoothing", motion) is None
