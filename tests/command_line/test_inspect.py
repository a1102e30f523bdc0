"""The command inspect: format, channel faults, excitation."""

import numpy as np
import pytest

from sklearn_vbjfa.datasets import make_robot_recording
from tests.command_line._running import refused, run
from tests.recording._logs import KINDS, plain


@pytest.fixture(scope="module")
def recording():
    return make_robot_recording(duration=5.0, dt=0.004, random_state=0)


def inspect(capsys, *argv, code=0):
    """Return stdout and stderr; check the exit code."""
    found, out, err = run(capsys, "inspect", *argv)
    assert found == code, err
    return out, err


def test_a_valid_recording(recording, tmp_path, capsys):
    before = set(tmp_path.iterdir())
    path = plain(recording, tmp_path)
    out, err = inspect(capsys, path, "--urdf", recording.urdf)
    assert err == ""
    assert "\n5 s at 250 Hz\n" in out
    rows = [line for line in out.splitlines() if line.startswith("joint_")]
    assert len(rows) == 6
    span = np.rad2deg([recording.q[:, 0].min(), recording.q[:, 0].max()])
    assert f"{span[0]:.4g} to {span[1]:.4g} deg" in rows[0]
    assert "- none detected" in out
    assert "friction with memory, backlash (too few reversals" in out
    assert set(tmp_path.iterdir()) == before | {path}


def test_findings_are_printed(recording, tmp_path, capsys):
    path = plain(recording, tmp_path)
    path.write_text(path.read_text().replace("tau1,tau2", "tau2,tau1", 1))
    out, _ = inspect(capsys, path, "--urdf", recording.urdf, code=3)
    faults = out.partition("Faults\n")[2]
    assert faults.startswith("- error: ")
    assert "joint_1" in faults.splitlines()[0]


def test_currents_are_no_fault(recording, tmp_path, capsys):
    path = KINDS["UR RTDE record"](recording, tmp_path)
    out, err = inspect(capsys, path, "--urdf", recording.urdf)
    line = " ".join(out.split())
    assert "- torques are recorded in A: identify needs the factors to N m" in line
    assert "or --gain unknown" in line
    assert "gear" not in out
    assert "taken as RTDE of a Universal Robots controller" in err


def test_a_refusal_suggests_a_command(recording, tmp_path, capsys):
    path = plain(recording, tmp_path)
    header, rows = path.read_text().split("\n", 1)
    header = header.replace("q", "angle").replace("tau", "torque")
    path.write_text(f"{header}\n{rows}")
    line = refused("inspect", capsys, path, "--urdf", recording.urdf)
    command = line.partition("this would work: python -m sklearn_vbjfa ")[2]
    assert command.startswith("inspect ")
    assert command.endswith("--columns 'q=angle{i},tau=torque{i}'")


def test_rows_by_joint_are_refused_without_a_command(recording, tmp_path, capsys):
    n, nv = recording.q.shape
    columns = np.repeat(recording.t, nv), np.tile(np.arange(1, nv + 1), n)
    rows = np.column_stack([*columns, recording.q.ravel(), recording.tau.ravel()])
    path, header = tmp_path / "long.csv", "t,joint,q,tau"
    np.savetxt(path, rows, "%.9g", ",", header=header, comments="")
    line = refused("inspect", capsys, path, "--urdf", recording.urdf)
    assert "each row is of one joint (column 'joint')" in line
    assert "this would work" not in line
