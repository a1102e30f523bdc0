"""Where files go: folders that take none are told first, earlier reports stay."""

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
def nothing_read(monkeypatch):
    """Fail if a recording is read: the folder is looked at before."""

    def fail(*arguments, **given):
        raise AssertionError("a recording was read")

    monkeypatch.setattr("sklearn_vbjfa.datasets.read_recording", fail)


def test_a_second_run_does_not_replace_the_report_of_the_first(here, capsys):
    assert run() == 0
    first = {x.name: x.read_bytes() for x in Path("arm-report").iterdir()}
    capsys.readouterr()
    assert run() == 0
    told = capsys.readouterr()
    assert "written: arm-report-2" in told.out
    assert first == {x.name: x.read_bytes() for x in Path("arm-report").iterdir()}
    assert {x.name for x in Path("arm-report-2").iterdir()} == set(first)


def test_one_of_two_runs_at_once_is_refused(here, capsys):
    part = Path("arm-report/.writing")
    part.mkdir(parents=True)
    assert run() == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert "another run writes to arm-report" in last
    # What a killed run left an hour and more ago is cleaned up.
    os.utime(part, (0, 0))
    assert run("--json") == 0
    assert not part.exists()
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads(Path("arm-report/report.json").read_text("utf-8"))
    assert printed["headline"]


def test_inspection_is_printed_as_data(here, capsys):
    assert main(["inspect", "arm.csv", "--urdf", "arm.urdf", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["joint_names"] == ["shoulder", "elbow"]
    assert found["faults"] == []
    assert set(found["identifiable"]) == {"shoulder", "elbow"}


def test_a_folder_that_is_named_is_not_written_over(here, capsys, nothing_read):
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
def test_a_folder_that_takes_no_files_is_told_first(here, capsys, nothing_read, option):
    assert run(option, "/proc/x") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "/proc cannot be written to (" in line


def test_a_description_without_masses_is_named_and_not_the_period(here, capsys):
    text = re.sub('<mass value="[^"]*"', '<mass value="0"', URDF)
    Path("arm.urdf").write_text(text)
    assert main(["inspect", "arm.csv", "--urdf", "arm.urdf"]) in (0, 3)
    told = capsys.readouterr()
    assert "has no mass" in told.err
    assert "is inconsistent with the motion" not in told.out + told.err
    assert "inertias ask for" not in told.out + told.err
