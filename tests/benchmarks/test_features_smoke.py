"""The benchmark of the regressor matrices runs at small size."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pinocchio")
pytest.importorskip("numba")

HERE = Path(__file__).resolve().parent


def test_script_starts_on_its_own():
    answer = subprocess.run(
        [sys.executable, str(HERE / "bench_features.py"), "--help"],
        capture_output=True,
        text=True,
        check=True,
        cwd=HERE.parent,
    )
    assert "--write" in answer.stdout


def test_regressor_at_small_size():
    import bench_features as bench

    text = bench.report(joints=(1, 3), max_samples=40, rounds=1)
    for name in bench.HEADERS:
        assert name in text
    # The loop is compared with before it is timed.
    assert "40" in text


def test_fit_and_demo_at_small_size():
    import bench_features as bench

    text = bench.report_fit(n_joints=2, n_samples=3000, rounds=1)
    for name in bench.FIT_HEADERS:
        assert name in text
    assert text.count("RobotIdentifier.fit, from positions") == 2
    assert "start to end" in bench.report_demo(rounds=1)
