"""The benchmark of a running robot runs, at small size."""

import importlib
import sys
from pathlib import Path

import pytest


def test_online(monkeypatch):
    pytest.importorskip("pinocchio")
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    bench = importlib.import_module("bench_online")
    try:
        rows, refits, p = bench.measure(2, 400, 1)
        text = bench.report(joints=(2,), n_rows=400, n_refits=1)
    finally:
        del sys.modules["bench_online"]
    assert len(rows) == 399
    assert len(refits) >= 1
    assert p == 22
    assert min(min(times) for times in rows) >= 0
    assert "refit, median [ms]" in text
