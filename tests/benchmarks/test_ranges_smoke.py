"""The benchmark of ranges for simulators runs, at small size."""

import importlib
import sys
from pathlib import Path

import pytest


def test_ranges(monkeypatch):
    pytest.importorskip("pinocchio")
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    bench = importlib.import_module("bench_ranges")
    try:
        text = bench.report(trials=3, recordings=(2,), shares=(0.3,))
    finally:
        del sys.modules["bench_ranges"]
    assert "dry friction" in text
    assert text.count("30") >= 1
