"""The benchmark of torques state by state runs, at small size."""

import importlib
import sys
from pathlib import Path

import pytest


def test_step(monkeypatch):
    pytest.importorskip("pinocchio")
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    bench = importlib.import_module("bench_step")
    try:
        n, times, alone, off = bench.measure(3, ("drift", "presliding", "jerk"), 50)
        text = bench.report(joints=(2,), n_states=50)
    finally:
        del sys.modules["bench_step"]
    assert n == 2
    assert len(times) == len(alone) == 50
    assert off < 1e-12
    assert "whole library" in text
