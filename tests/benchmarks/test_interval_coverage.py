"""Study of coverage: 90 % intervals hold nine tenths of the truths, in every cell."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import bench_interval_coverage as bench


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

    A cell of 200 independent intervals of 90 % has a standard deviation of 2.1 %.
    """
    cells = bench.STUDIES[study](200, 100)
    outside = [cell.label for cell in cells if not 0.85 <= cell.coverage <= 0.95]
    assert outside == []
    assert 0.88 <= pooled(cells) <= 0.92
