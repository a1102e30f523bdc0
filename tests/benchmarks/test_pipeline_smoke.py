"""The benchmark of the pipeline runs at small size, and its searches are sensible."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pinocchio")
pytest.importorskip("pandas")

HERE = Path(__file__).resolve().parent


def test_script_starts_on_its_own():
    answer = subprocess.run(
        [sys.executable, str(HERE / "bench_pipeline.py"), "--help"],
        capture_output=True,
        text=True,
        check=True,
        cwd=HERE.parent,
    )
    assert "--write" in answer.stdout


def test_projection_helps_where_data_are_short_and_noisy():
    import bench_pipeline as bench

    kinds = [("least squares", "as fitted"), ("least squares", "projected")]
    results = [bench.study(seed, 2.0, 5e-3, kinds) for seed in range(6)]
    errors = np.array([[found[kind].error for kind in kinds] for found in results])
    scores = np.array([[found[kind].score for kind in kinds] for found in results])
    # A convex set with the truth in it: nearer in the metric of the fit, and so on
    # average in that of another motion.
    assert np.median(errors[:, 1] / errors[:, 0]) < 1
    assert np.mean(scores[:, 1] > scores[:, 0]) > 0.5


def test_fine_encoders_leave_a_fraction_of_the_error():
    import bench_pipeline as bench

    kinds = [("PLS", "projected")]
    coarse, fine = (
        np.median(
            [bench.study(seed, 2.0, noise, kinds)[kinds[0]].error for seed in (0, 1)]
        )
        for noise in (5e-3, 1e-4)
    )
    assert fine < coarse


def test_table_at_small_size():
    import bench_pipeline as bench

    kinds = [(name, "projected") for name in ("Lasso", "VB-JFA")]
    text = bench.report(range(1), {"coarse": (2.0, 5e-3)}, kinds)
    for name in (*bench.HEADERS, "as the blocks choose", "best in hindsight"):
        assert name in text
    table = text[text.index("coarse  ") :].splitlines()
    chosen = [line.split()[-2:] for line in table[:2]]
    # one robot: one line was chosen, and one was best
    assert sorted(pair[0] for pair in chosen) == ["0", "1"]
    assert sorted(pair[1] for pair in chosen) == ["0", "1"]
