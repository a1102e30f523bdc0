"""Bad and odd logs: exit codes and reasons; suggested commands work."""

import csv
import json
import shlex
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from sklearn_vbjfa._cli import main
from sklearn_vbjfa.datasets import load_demo_recording
from tests.command_line import _bad_logs

TABLE = tomllib.loads(Path(__file__).with_name("bad_logs.toml").read_text("utf-8"))
CASES = [
    pytest.param(name, marks=[] if case.get("quick") else [pytest.mark.slow])
    for name, case in TABLE.items()
]
SUGGESTION = "this would work: python -m sklearn_vbjfa "


def make_arm(folder):
    """Return 20 s of an arm with six joints, for files in a folder."""
    recording = load_demo_recording().select(0)
    urdf = Path(shutil.copy(recording.urdf, folder / "arm.urdf"))
    columns = (recording.clock, recording.q, recording.tau)
    return _bad_logs.Arm(folder, urdf, *(x[::2] for x in columns))


@pytest.fixture
def arm(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return make_arm(tmp_path)


def identify(log, urdf, out):
    argv = ["identify", log, "--urdf", urdf, "--no-search", "-o", out, "-q"]
    return main(list(map(str, argv)))


def read_parameters(out):
    """Return values and standard deviations of the identifiable parameters."""
    with Path(out, "parameters.csv").open(newline="", encoding="utf-8") as file:
        rows = [x for x in csv.DictReader(file) if x["identifiable"] == "yes"]
    return {x["parameter"]: (float(x["value"]), float(x["std"])) for x in rows}


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    arm = make_arm(tmp_path_factory.mktemp("sound"))
    out = arm.folder / "out"
    assert identify(*write_case(arm, {}), out) == 0
    return read_parameters(out)


def write_case(arm, case):
    """Write the files of a case; return the paths of the log and of the robot."""
    for name, options in case.get("values", {}).items():
        arm = replace(arm, **getattr(_bad_logs, name)(arm, **options))
    ((name, options),) = case.get("file", {"encoded": {}}).items()
    paths = getattr(_bad_logs, name)(arm, **options)
    return paths if isinstance(paths, tuple) else (paths, arm.urdf)


@pytest.mark.parametrize("name", CASES)
def test_bad_logs(name, arm, reference, capsys):
    case = TABLE[name]
    code = identify(*write_case(arm, case), "out")
    out, err = capsys.readouterr()
    assert code == case["exit"], f"{err}\n{out}"
    message = err
    if code != 2:
        report = json.loads(Path("out/report.json").read_text("utf-8"))
        message += " ".join(x["message"] for x in report["channels"])
    assert case.get("words", "") in message
    if code == 0:
        found = read_parameters("out")
        # A barely identifiable parameter may be missing from one of both.
        assert len(found.keys() & reference.keys()) > 0.9 * len(reference)
        for key, (value, std) in reference.items():
            if key in found and not key.startswith(case.get("changed", "none")):
                off = abs(found[key][0] - value)
                assert off < 3 * std + 0.05 * abs(value), (key, found[key], value, std)
    _, suggested, command = err.partition(SUGGESTION)
    if suggested:
        # The suggested command works.
        assert main(shlex.split(command)) in (0, 3), capsys.readouterr().err
