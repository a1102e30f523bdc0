"""The gallery runs offline."""

import re
import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "examples").rglob("plot_*.py"))
MEASURED, RUNS = (
    next(path for path in EXAMPLES if path.stem == stem)
    for stem in ("plot_measured_robots", "plot_ten_runs")
)


def run(path):
    """Run a script as the gallery does; return the number of its figures."""
    pytest.importorskip("pinocchio")
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    # Figures that other tests left open do not count.
    plt.close("all")
    code = compile(path.read_text(encoding="utf-8"), str(path), "exec")
    beside = [str(path.parent), *sys.path]
    with (
        mock.patch.object(sys, "argv", [str(path)]),
        mock.patch.object(sys, "path", beside),
    ):
        exec(code, {"__name__": "__main__"})
    figures = plt.get_fignums()
    plt.close("all")
    return len(figures)


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path, monkeypatch, tmp_path):
    assert path.read_text(encoding="utf-8").startswith('"""\n=')
    monkeypatch.chdir(tmp_path)
    assert run(path)


@pytest.mark.slow
def test_measured_robots_are_diagnosed(measured_data_home, monkeypatch, capsys):
    monkeypatch.setenv("SKLEARN_VBJFA_DATA", str(measured_data_home))
    assert run(MEASURED) == 1
    out = capsys.readouterr().out
    assert len(re.findall("^--- ", out, re.MULTILINE)) == 4
    # The wrist of the TX40 is coupled, as was published with the recording.
    assert re.search("^joint_[56]: coupling, ", out, re.MULTILINE)


def test_without_measured_robots_the_table_is_shown(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("SKLEARN_VBJFA_DATA", str(tmp_path))
    assert run(MEASURED) == 1
    out = capsys.readouterr().out
    for stage in ("development", "confirmation"):
        table = MEASURED.parents[2] / "docs" / "tables" / f"measured_sets_{stage}.rst"
        assert table.read_text(encoding="utf-8").strip() in out


@pytest.mark.slow
def test_ten_runs_give_what_is_shown_without_them(
    measured_data_home, monkeypatch, capsys, tmp_path
):
    shown = []
    for home, count in ((tmp_path, 1), (measured_data_home, 3)):
        monkeypatch.setenv("SKLEARN_VBJFA_DATA", str(home))
        assert run(RUNS) == count
        out = capsys.readouterr().out
        rows = re.findall(r"^(free|prior|fixed) +([\d. ]+)$", out, re.MULTILINE)
        assert [way for way, _ in rows] == [
            w for w in ("free", "prior", "fixed") for _ in range(3)
        ]
        shown.append([np.array(row.split(), dtype=float) for _, row in rows])
    # In thousandths of kg m^2, of up to 46.
    np.testing.assert_allclose(*shown, atol=0.3)
