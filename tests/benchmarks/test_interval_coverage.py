"""Study of coverage: 90 % intervals hold nine tenths of the truths, in every cell."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import bench_interval_coverage as bench
import bench_torque_coverage as torques


def pooled(cells):
    return np.mean(np.concatenate([cell.inside for cell in cells]))


def test_small_study_of_errors():
    """The error after, of whole loops, against the next 50 s."""
    cells = bench.errors(20, 0, durations=(40.0,), noises=("white", "AR(0.9)"))
    assert [len(cell.inside) for cell in cells] == [40, 40]
    # 80 intervals: 3.4 % for one standard deviation
    assert 0.82 < pooled(cells) < 0.97


@pytest.mark.slow
@pytest.mark.parametrize("study", list(bench.STUDIES))
def test_full_study(study):
    """Targets of the table, on 200 data sets a cell.

    A cell of 200 independent intervals of exactly 90 % has a standard deviation of
    2.1 %: one in fifty lies outside 85 to 95 % by chance, one in a thousand outside
    83 to 97 %.
    """
    cells = bench.STUDIES[study](200, 100)
    coverage = np.array([cell.coverage for cell in cells])
    assert np.all((coverage > 0.83) & (coverage < 0.97))
    assert np.sum((coverage < 0.85) | (coverage > 0.95)) <= 1
    assert 0.88 <= pooled(cells) <= 0.92


def test_small_study_of_torques():
    """Deviations of predicted torques, on another motion."""
    rows, shares = torques.simulated(6, 0, arms=(("ZY", 40.0),), noises=("white",))
    assert len(rows[0]) == 5
    # Six data sets: their means scatter by 1.5 %.
    assert 0.85 < shares[0] < 0.95
