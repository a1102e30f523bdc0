"""The examples of the gallery run offline."""

import sys
from pathlib import Path
from unittest import mock

import pytest

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "examples").rglob("plot_*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path, monkeypatch, tmp_path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    # Close figures that other tests left open.
    plt.close("all")
    monkeypatch.chdir(tmp_path)
    code = compile(path.read_text(encoding="utf-8"), str(path), "exec")
    folders = [str(path.parent), *sys.path]
    with (
        mock.patch.object(sys, "argv", [str(path)]),
        mock.patch.object(sys, "path", folders),
    ):
        exec(code, {"__name__": "__main__"})
    assert plt.get_fignums()
    plt.close("all")
