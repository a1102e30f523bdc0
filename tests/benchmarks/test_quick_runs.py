"""Every benchmark runs with ``--quick`` and prints its tables, and writes nothing."""

import importlib
import sys
from pathlib import Path

import pytest

pytest.importorskip("pinocchio")

HERE = Path(__file__).parent
NAMES = sorted(p.stem for p in HERE.glob("bench_*.py"))
# Scripts that need measured sets even in a quick run.
MEASURED = ("commands", "protocol_emps", "protocol_tx40", "unitree_go2")


@pytest.mark.parametrize("name", NAMES)
def test_quick_run(name, request, monkeypatch, capsys):
    if name == "bench_commands":
        pytest.importorskip("mujoco")
    monkeypatch.syspath_prepend(str(HERE))
    words = ["--quick", "--write"]
    if name.removeprefix("bench_") in MEASURED:
        words += ["--data-home", str(request.getfixturevalue("measured_data_home"))]
    recorded = importlib.import_module("_report").recorded
    monkeypatch.setattr(recorded, "write", None)
    importlib.import_module(name).main(words)
    text = capsys.readouterr().out
    assert recorded.tables_in(text) or name == "bench_interval_coverage"
    assert f"Made by ``python tests/benchmarks/{name}.py" in text
    for module in [m for m in sys.modules if m in NAMES]:
        del sys.modules[module]
