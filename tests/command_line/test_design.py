"""The command design: motion, summary and one-line errors."""

import contextlib
import functools
import io
import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sklearn_vbjfa import RobotIdentifier, load_identified
from sklearn_vbjfa._cli import main
from sklearn_vbjfa.datasets import make_robot_recording
from tests.command_line._running import refused
from tests.hostile._case import URDF

# The robots of these tests have no collision geometry, which gives a warning.
UNCHECKED = 3
# Few harmonics, so that a motion takes a second or two.
QUICK = ("--duration", "4", "--acceleration", "3")
# Fast enough to distinguish friction effects.
FAST = ("--duration", "4", "--acceleration", "20")
JOINTS = ["shoulder", "elbow"]


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Folder with a robot, and the output of identify in ``report``."""
    folder = tmp_path_factory.mktemp("robot")
    urdf = folder / "arm.urdf"
    urdf.write_text(URDF)
    recording = make_robot_recording(
        str(urdf), duration=8.0, dt=0.01, n_harmonics=4, random_state=0
    )
    report = folder / "report"
    report.mkdir()
    robot = RobotIdentifier(str(urdf), dt=recording.dt, friction=("viscous", "coulomb"))
    robot.fit(recording.q, recording.tau).save(report / "identified.json")
    content = {
        "joint_names": JOINTS,
        "effects": [
            {
                "name": "stribeck",
                "joint": 0,
                "rivals": ["viscous_quadratic"],
                "trials": [{"name": "viscous_quadratic", "joint": 0, "shape": {}}],
            }
        ],
        "not_identifiable": [
            {"name": "joint_zero", "joint": 0, "reason": "span", "remedy": ""}
        ],
        "parameters": [
            {"name": "elbow:viscous", "value": 0.5, "interval": [-9.5, 10.5]}
            | {"known": "yes", "unit": "N m s/rad"}
        ],
        "recorded": {"samples": 800, "seconds": 8.0, "rate": 100.0},
        "provenance": {"file": "slow.csv", "description": str(urdf), "held": []},
    }
    (report / "report.json").write_text(json.dumps(content))
    return folder


@pytest.fixture(scope="module")
def designed(home):
    """Folder, printed text and command of one run with a report."""
    out = home / "new" / "motion.csv"
    argv = ["--report", str(home / "report"), *FAST, "--out", str(out)]
    text, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.redirect_stderr(errors):
        assert main(["design", *argv]) == UNCHECKED
    (line,) = errors.getvalue().splitlines()
    assert line.startswith("warning: SELF-COLLISION WAS NOT CHECKED")
    return out, text.getvalue(), argv


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Working folder with a robot only."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(URDF)
    return tmp_path


refusal = functools.partial(refused, "design")


def test_the_motion_is_within_its_limits(designed):
    out, _, _ = designed
    found = pd.read_csv(out)
    header = ["t"] + [f"{kind}_{name}" for kind in "qva" for name in JOINTS]
    assert list(found) == header
    t = found["t"].to_numpy()
    # The sample period of the recordings.
    np.testing.assert_allclose(np.diff(t), 0.01)
    assert t.size == 400
    for name in JOINTS:
        q, v, a = (found[f"{kind}_{name}"] for kind in "qva")
        assert abs(v[0]) < 1e-9
        assert abs(a[0]) < 1e-9
        # Error of central differences: a sixth of dt^2 times the largest jerk.
        jerk = np.abs(np.gradient(a, t)).max()
        np.testing.assert_allclose(
            np.gradient(q, t)[1:-1], v[1:-1], rtol=0, atol=0.01**2 / 5 * jerk
        )
        np.testing.assert_allclose(np.gradient(v, t)[1:-1], a[1:-1], atol=6e-3 * 20)
        assert np.abs(q).max() <= 0.98 * 3
        assert np.abs(v).max() <= 0.98 * 10
        assert np.abs(a).max() <= 0.98 * 20


def test_the_summary_lists_identifiable_and_unidentifiable_effects(designed):
    text = " ".join(designed[1].split())
    assert re.search(
        r"exceed these torques - joint 1 \(shoulder\), from [\d.]+ N m: Stribeck "
        "friction or friction with the square of speed Not identifiable by any "
        r"motion: .*shifted encoder zero \(joint 1 \(shoulder\)\) "
        r"\(absorbed by .*\)",
        text,
    )
    # Shares of the acceleration limit, with the margin of the design.
    largest = np.abs(pd.read_csv(designed[0])["a_shoulder"]).max() / 20
    share = float(re.search(r"joint 1 \(shoulder\) +\d+ % +\d+ % +(\d+) %", text)[1])
    assert share == pytest.approx(100 * largest, abs=1.0)


def test_the_suggested_command_works(home, here, capsys):
    """Columns and gains of the log in the report are kept."""
    folder = shutil.copytree(home / "report", here / "report")
    content = json.loads((folder / "report.json").read_text())
    options = {"columns": "q=x{i}", "dt": "0.01", "gain": "2,2", "friction": "viscous"}
    content["provenance"] |= {"options": options}
    (folder / "report.json").write_text(json.dumps(content))
    assert main(["design", "--report", str(folder), *FAST]) == UNCHECKED
    text = capsys.readouterr().out
    command = shlex.split(re.findall("python -m sklearn_vbjfa (identify .*)", text)[-1])
    assert "slow.csv" not in text
    assert command[command.index("--gain") + 1] == "2,2"
    found = pd.read_csv("motion.csv")
    states = found[[f"{x}_{name}" for x in "qva" for name in JOINTS]].to_numpy()
    tau = load_identified(folder / "identified.json").predict(states)
    found[[f"tau_{name}" for name in JOINTS]] = 0.5 * tau
    found.to_csv("recording.csv", index=False)
    assert main([*command, "--no-search"]) in (0, 3)


def test_an_existing_motion_is_not_replaced(designed, capsys):
    out, _, argv = designed
    before = out.read_bytes()
    line = refusal(capsys, *argv)
    assert "--force to replace a file" in line
    out.write_text("mine")
    assert "exist" in refusal(capsys, *argv)
    assert out.read_text() == "mine"
    out.write_bytes(before)


# Boxes around the links of the arm; adjacent links are not checked.
GEOMETRY = """<collision><origin xyz="0.1 0 0"/><geometry><box size="0.2 0.02 0.02"/>
</geometry></collision></link>"""


def test_unchecked_self_collision_is_the_first_step(designed, here, capsys):
    _, text, _ = designed
    steps = text.partition("Next:")[2].split("\n")
    assert steps[1].startswith("  0. BEFORE IT RUNS: the robot may hit itself")
    assert "\nSELF-COLLISION WAS NOT CHECKED" in text
    described = URDF.replace("</link>", GEOMETRY)
    Path("arm.urdf").write_text(described)
    assert main(["design", "--urdf", "arm.urdf", *QUICK]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "Next:\n  1. Run motion.csv" in captured.out
    assert "SELF-COLLISION" not in captured.out


def test_a_robot_is_required(here, capsys):
    line = refusal(capsys)
    assert "--urdf FILE" in line
    assert "--report FOLDER" in line
    assert "no such robot" in refusal(capsys, "--urdf", "none.urdf")
    Path("empty").mkdir()
    assert "expected the folder" in refusal(capsys, "--report", "empty")
    content = {"effects": [], "joint_names": ["a"]}
    Path("empty/report.json").write_text(json.dumps(content))
    assert "identified.json" in refusal(capsys, "--report", "empty")


def test_options_stored_in_the_report_are_refused(home, here, capsys):
    for option in ("--urdf", "--joints"):
        line = refusal(capsys, "--report", home / "report", option, "elbow")
        assert f"{option} is taken from the report; leave it out" in line


def test_a_missing_limit_is_requested(here, capsys):
    Path("arm.urdf").write_text(URDF.replace('effort="100"', 'effort="0"'))
    line = refusal(capsys, "--urdf", "arm.urdf", *QUICK[:2])
    assert "no torque limit of shoulder, elbow. Give" in line
    assert "--torque or --acceleration" in line


@pytest.mark.slow
def test_relative_gains_require_explicit_limits(home, here, capsys):
    recording = make_robot_recording(
        str(home / "arm.urdf"), duration=8.0, dt=0.01, n_harmonics=4, random_state=0
    )
    robot = RobotIdentifier(
        str(home / "arm.urdf"), dt=0.01, friction=("viscous",), gains="unknown"
    )
    folder = here / "report"
    folder.mkdir()
    robot.fit(recording.q, recording.tau / 8).save(folder / "identified.json")
    (folder / "report.json").write_text((home / "report/report.json").read_text())
    line = refusal(capsys, "--report", folder, "--duration", "4")
    assert "torque gains are relative" in line
    assert main(["design", "--report", str(folder), *FAST]) == UNCHECKED
    assert re.search(r"joint 1 \(shoulder\) .* -$", capsys.readouterr().out, re.M)


def test_a_sufficient_duration_is_suggested(here, capsys):
    short = ("--urdf", "arm.urdf", "--duration", "0.5", "--acceleration", "3")
    line = refusal(capsys, *short)
    assert "too short for shoulder" in line
    # (1 - cos) / 2 through a quarter of the range of 6 rad
    expected = np.ceil(2 * np.pi * np.sqrt(0.75 / 3))
    assert f"Give a duration of {expected:g} s" in line


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--duration=nan", "duration must be"),
        ("--duration=0", "duration must be"),
        ("--dt=-1", "dt must be"),
        ("--torque=1,2,3", "torque must hold one limit, or one for each of 2 joints"),
        ("--torque=inf,1", "gives no torque limit of shoulder"),
        ("--velocity=-1", "Joint 1 has no room: velocity must be positive"),
        ("--torque=a,b", "--torque has an invalid value: 'a,b'"),
        ("--torque=", "--torque has an invalid value: ''"),
    ],
)
def test_invalid_numbers_are_refused(option, message, here, capsys):
    assert message in refusal(capsys, "--urdf", "arm.urdf", option)


def test_unwritable_paths_are_refused(here, capsys):
    urdf = ("--urdf", "arm.urdf")
    Path("folder").mkdir()
    assert "folder exists" in refusal(capsys, *urdf, "--out", "folder", "--force")
    line = refusal(capsys, *urdf, "--out", "arm.urdf/motion.csv")
    assert "arm.urdf is not a folder" in line
    assert "arm.urdf exists" in refusal(capsys, *urdf, "--out", "arm.urdf")
