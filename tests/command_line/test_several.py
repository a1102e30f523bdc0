"""Several recordings in one command."""

import contextlib
import io
import json
from pathlib import Path

import numpy as np
import pytest

from sklearn_vbjfa._cli import main
from sklearn_vbjfa.datasets import make_robot_recording
from tests.command_line import _running
from tests.command_line._running import write_csv
from tests.command_line.test_close_loop import FILES
from tests.hostile._case import URDF

RUNS = ("runs/a.csv", "runs/b.csv", "runs/c.csv")
# Options that keep the runs short.
SHORT = {"identify": ("--effects", "spring")}


@pytest.fixture(scope="module")
def motions(urdf):
    """Three motions of a robot that has a spring on its shoulder."""
    recording = make_robot_recording(
        str(urdf), duration=8.0, dt=0.01, n_recordings=3, random_state=0
    )
    recording.tau[:, 0] += 4.0 * recording.q[:, 0]
    return [recording.select(k) for k in range(3)]


@pytest.fixture
def here(motions, tmp_path, monkeypatch):
    """Working folder with a robot, and the folder runs with three recordings."""
    monkeypatch.chdir(tmp_path)
    fill(tmp_path, motions)
    return tmp_path


def fill(folder, motions):
    (folder / "arm.urdf").write_text(URDF)
    (folder / "runs").mkdir()
    for name, motion in zip("abc", motions):
        write_csv(folder / f"runs/{name}.csv", motion)


@pytest.fixture(scope="module")
def identified(motions, tmp_path_factory):
    """Folder, exit code and output of identify on all three recordings."""
    folder = tmp_path_factory.mktemp("closed")
    fill(folder, motions)
    out = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out):
        argv = ["identify", *RUNS, "--urdf", "arm.urdf", *SHORT["identify"]]
        code = main(argv)
    return folder, code, out.getvalue()


def run(capsys, command, *argv):
    """Return the exit code, stdout, and the lines on stderr of a command."""
    options = ("--urdf", "arm.urdf", *SHORT.get(command, ()))
    code, out, err = _running.run(capsys, command, *argv, *options)
    return code, out, err.splitlines()


def refusal(capsys, command, *argv):
    """Return the only line on stderr of a refused run, which writes nothing."""
    before = sorted(Path().rglob("*"))
    code, out, err = run(capsys, command, *argv)
    assert (code, out) == (2, "")
    assert sorted(Path().rglob("*")) == before
    (line,) = err
    assert line.startswith("sklearn-vbjfa: ")
    return line


def test_the_report_covers_all_recordings(identified):
    folder, code, out = identified
    folder = folder / "runs-report"
    assert code == 0
    assert out.startswith("Recording 'runs': 2400 samples, 2 joints, dt = 0.01 s, 3 ")
    assert sorted(path.name for path in folder.iterdir()) == FILES
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert report["provenance"]["file"] == list(RUNS)
    assert report["provenance"]["recordings"] == ["a", "b", "c"]
    assert report["provenance"]["samples"] == 2400
    assert [effect["name"] for effect in report["effects"]] == ["spring"]
    page = (folder / "report.html").read_text(encoding="utf-8")
    text = page[page.index("Provenance and method</h2>") :]
    for expected in (*RUNS, "3 recordings (a, b and c)"):
        assert expected in text


def test_files_are_equivalent_to_segments_of_one_file(here, identified, capsys):
    tables = [np.loadtxt(name, delimiter=",", skiprows=1) for name in RUNS]
    labels = np.repeat([1, 2, 3], [len(table) for table in tables])
    header = "t,q1,q2,tau1,tau2,segment"
    whole = np.column_stack([np.vstack(tables), labels])
    np.savetxt("one.csv", whole, delimiter=",", header=header, comments="", fmt="%.10g")
    assert run(capsys, "identify", "one.csv")[0] == 0
    paths = identified[0] / "runs-report/report.json", Path("one-report/report.json")
    several, one = (json.loads(x.read_text(encoding="utf-8")) for x in paths)
    differ = {key for key in one if one[key] != several[key]}
    assert differ == {"provenance"}
    assert one["provenance"]["file"] == "one.csv"


def test_inspection_of_several(here, capsys):
    code, out, err = run(capsys, "inspect", *RUNS)
    assert (code, err) == (0, [])
    assert "3 recordings" in out.splitlines()[0]
    assert "a 8 s, b 8 s, c 8 s" in out
    # Nothing is written.
    assert {path.name for path in here.iterdir()} == {"arm.urdf", "runs"}


def test_recordings_may_follow_options(here, capsys):
    argv = ["inspect", "runs/a.csv", "--urdf", "arm.urdf", "runs/b.csv"]
    assert main(argv) == 0
    assert "a 8 s, b 8 s" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["effects", "runs/a.csv"], "runs/a.csv; see sklearn-vbjfa effects -h"),
        (["inspect", "a.csv", "--colums", "q=a"], "--colums; did you mean --columns?"),
        (["inpsect", "a.csv"], "'inpsect' is not a command; did you mean inspect?"),
        (["inspect", "a.csv"], "give --urdf FILE"),
    ],
)
def test_unknown_arguments_are_refused(argv, words, here, capsys):
    assert main(argv) == 2
    assert words in capsys.readouterr().err


def test_the_folder_of_the_recordings_is_not_written_to(here, capsys):
    line = refusal(capsys, "identify", *RUNS, "--out", "runs")
    assert "runs holds a.csv, b.csv, c.csv" in line


def test_a_bad_file_is_named(here, capsys):
    Path("runs/d.csv").write_text("t,q1,tau1\n0,0.1,a\n1,0.2,b\n")
    assert "runs/d.csv: " in refusal(capsys, "inspect", "runs")
