"""The gallery runs, offline, in less than 30 s a script."""

import runpy
import time
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "examples").rglob("*.py"))


def test_there_are_examples():
    assert EXAMPLES


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_has_cells_and_a_title(path):
    text = path.read_text(encoding="utf-8")
    assert text.startswith('"""\n=')
    assert text.count("\n# %%\n") >= 3


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path, monkeypatch, tmp_path):
    pytest.importorskip("pinocchio")
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    started = time.process_time()
    runpy.run_path(str(path), run_name="__main__")
    figures = plt.get_fignums()
    plt.close("all")
    # Processor time: other work on the machine does not count.
    assert time.process_time() - started < 30.0
    assert figures
