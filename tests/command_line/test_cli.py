"""Command line: demo, lists, one-line errors and reproducible output."""

import contextlib
import io
import re
import sys
from pathlib import Path

import pytest

import sklearn_vbjfa
from sklearn_vbjfa import effects
from sklearn_vbjfa._cli import main


def run(argv):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(argv)
    return code, out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def demo():
    return run([])


def test_the_demo_is_identified_without_arguments(demo):
    code, out, err = demo
    assert code == 0
    assert err == ""  # no terminal, no progress
    lines = out.splitlines()
    # Fits on a terminal without scrolling.
    assert len(lines) <= 20
    assert max(map(len, lines)) <= 80
    assert lines[0] == (
        "Recording 'demo': 8000 samples, 6 joints, dt = 0.005 s, 2 recordings"
    )
    assert lines[1].startswith("Load-dependent friction on joint 2 was missing")
    (found,) = [line for line in lines if line.startswith("- ")]
    mu, std = re.match(
        r"- joint 2: load-dependent friction, mu = (\S+) \+- (\S+);", found
    ).groups()
    # True value: see load_demo_recording.
    assert abs(float(mu) - 0.11) < 2 * float(std)


def test_readme_shows_the_printed_output(demo):
    readme = (Path(__file__).resolve().parents[2] / "README.md").read_text("utf-8")
    shown = re.search(r"^```text\n(.*?)^```", readme, flags=re.DOTALL | re.M)[1]
    printed = demo[1]
    # Other versions of the libraries may move a last digit, and with it a column.
    number = re.compile(r"\d+(\.\d+)?")
    words = [number.sub("#", " ".join(text.split())) for text in (shown, printed)]
    assert words[0] in words[1]
    pairs = zip(number.finditer(shown), number.finditer(printed[printed.index("\n") :]))
    for documented, found in pairs:
        assert float(documented[0]) == pytest.approx(float(found[0]), rel=0.1, abs=0.2)


def test_missing_pinocchio_is_reported_in_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    code, out, err = run([])
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert "Pinocchio" in line
    assert "pip install" in line


@pytest.mark.parametrize("argv", [["--nope"], ["nope"], ["identify", "--urdf"]])
def test_wrong_arguments_exit_with_code_2(argv):
    code, out, err = run(argv)
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith("sklearn-vbjfa")


def test_datasets_and_effects_are_listed():
    code, out, _ = run(["datasets"])
    assert code == 0
    assert re.search(r"fetch_kuka_kr300 +two trajectories of a KUKA", out)
    code, out, err = run(["effects"])
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0].split()[:2] == ["name", "effect"]
    # descriptions may continue on further lines, names do not
    assert [x.split()[0] for x in lines[2:] if x[0] != " "] == list(effects.available())


def test_version(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out.strip() == sklearn_vbjfa.__version__


@pytest.mark.slow
def test_the_demo_is_reproducible(demo):
    assert run([]) == demo
