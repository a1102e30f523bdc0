"""Levels that hold and effects that are found, whatever the colour of the residual."""

import numpy as np
import pytest
from scipy import stats

pytest.importorskip("pinocchio")

import bench_false_alarms as bench


def surely_above(count, n, level):
    """Whether so many of n are more than a level explains, at 1 in 1000."""
    return stats.binom.sf(count - 1, n, level) < 1e-3


@pytest.mark.parametrize("kind", ["AR(1), 1.5 s", "AR(1), 5 s", "1/f"])
def test_slow_residuals_are_no_effects(kind):
    """Not more than alpha explains; before memory was taken out, every fourth was."""
    found = [bench.judge(kind, 1, seed, False)["names"] for seed in range(8)]
    alarms = sum(map(bool, found))
    assert not surely_above(alarms, len(found), bench.ALPHA), found


def test_effects_in_slow_residuals_are_found():
    kind = "AR(1), 1.5 s"
    verdicts = [bench.judge(kind, 1, seed, True) for seed in range(0, 12, 2)]
    assert np.mean([v["found"] for v in verdicts]) >= 0.8


@pytest.mark.slow
@pytest.mark.parametrize("which", ["null", "power"])
def test_levels_and_power_in_every_cell(which):
    """Noise of one joint: a hundred recordings a cell, or 26 with an effect."""
    trials = 100 if which == "null" else 26
    kinds = list(bench.RESIDUALS)[:7]
    verdicts = bench.study(trials, 1000, (which,), joints=(1,), residuals=kinds)
    assert not any("error" in v for v in verdicts)
    if which == "power":
        assert bench.power(verdicts) > 0.9
        return
    assert bench.alarms(verdicts) <= bench.ALPHA
    for kind in kinds:
        own = [v for v in verdicts if v["residual"] == kind]
        count = sum(bool(v["names"]) for v in own)
        assert not surely_above(count, len(own), 0.075), kind
