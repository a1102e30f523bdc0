"""Output folders: unwritable ones are refused first, earlier reports are kept."""

import json
import os
import re
import sys
from pathlib import Path

import pytest

from sklearn_vbjfa._cli import main
from tests.hostile._case import URDF, clean_text

QUICK = ("--effects", "none", "--quiet")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(URDF)
    Path("arm.csv").write_text(clean_text())
    return tmp_path


def run(*options, command="identify"):
    return main([command, "arm.csv", "--urdf", "arm.urdf", *QUICK, *options])


@pytest.fixture
def fail_on_read(monkeypatch):
    """Fail if a recording is read: the folder is checked first."""

    def fail(*arguments, **given):
        raise AssertionError("a recording was read")

    monkeypatch.setattr("sklearn_vbjfa.datasets.read_recording", fail)


def test_a_second_run_keeps_the_first_report(here, capsys):
    assert run() == 0
    first = {x.name: x.read_bytes() for x in Path("arm-report").iterdir()}
    capsys.readouterr()
    assert run() == 0
    captured = capsys.readouterr()
    assert "written: arm-report-2" in captured.out
    assert first == {x.name: x.read_bytes() for x in Path("arm-report").iterdir()}
    assert {x.name for x in Path("arm-report-2").iterdir()} == set(first)


def test_a_file_that_cannot_be_written_is_named(here, capsys, monkeypatch):
    assert run("-o", "out") == 0
    monkeypatch.setattr("sklearn_vbjfa.RobotIdentifier.to_mjcf", lambda *_: int("x"))
    assert run("-o", "out", "--force") == 3
    assert "warning: identified.xml is not written" in capsys.readouterr().err
    names = {x.name for x in Path("out").iterdir()}
    assert names >= {"report.html", "identified.urdf", "identified.json"}
    assert "identified.xml" not in names


def test_a_concurrent_run_is_refused(here, capsys):
    part = Path("arm-report/.writing")
    part.mkdir(parents=True)
    assert run() == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert "another run writes to arm-report" in last
    # Files of a killed run are removed after an hour.
    os.utime(part, (0, 0))
    assert run("--json") == 0
    assert not part.exists()
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads(Path("arm-report/report.json").read_text("utf-8"))
    assert printed["headline"]


def test_inspection_is_printed_as_json(here, capsys):
    assert main(["inspect", "arm.csv", "--urdf", "arm.urdf", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["joint_names"] == ["shoulder", "elbow"]
    assert found["faults"] == []
    assert set(found["identifiable"]) == {"shoulder", "elbow"}


def test_a_named_folder_is_not_overwritten(here, capsys, fail_on_read):
    Path("v1.2").mkdir()
    Path("v1.2/report.json").write_text("{}")
    assert run("--out", "v1.2") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "v1.2 holds report.json" in line
    assert "--out v1.2-2" in line
    assert Path("v1.2/report.json").read_text() == "{}"
    with pytest.raises(AssertionError, match="was read"):
        run("--out", "v1.2", "--force")


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
@pytest.mark.parametrize("option", ["--out", "--ranges"])
def test_an_unwritable_folder_is_refused_first(here, capsys, fail_on_read, option):
    assert run(option, "/proc/x") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "/proc cannot be written to (" in line


def test_missing_masses_are_reported_instead_of_the_period(here, capsys):
    text = re.sub('<mass value="[^"]*"', '<mass value="0"', URDF)
    Path("arm.urdf").write_text(text)
    assert main(["inspect", "arm.csv", "--urdf", "arm.urdf"]) in (0, 3)
    captured = capsys.readouterr()
    assert "has no mass" in captured.err
    assert "is inconsistent with the motion" not in captured.out + captured.err
    assert "inertias ask for" not in captured.out + captured.err
