"""What a command leaves on a terminal: twenty lines."""

import json
import shutil
import textwrap
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from sklearn_vbjfa._cli import main
from sklearn_vbjfa.datasets import load_demo_recording

WIDTH = 80


def lines_on_a_terminal(captured):
    """Lines of all that was printed, as a terminal shows them."""
    printed = [*captured.out.splitlines(), *captured.err.splitlines()]
    return [y for x in printed for y in textwrap.wrap(x, WIDTH) or [""]]


@pytest.fixture(scope="module")
def arm():
    return load_demo_recording().select(0)


@pytest.fixture
def log(arm, tmp_path, monkeypatch):
    """Write changed torques of six joints, with some rows; a working folder."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(arm.urdf, "arm.urdf")

    def write(tau, rows=slice(None)):
        table = np.column_stack([arm.t, arm.q, tau])[rows]
        names = [f"{x}{k + 1}" for x in ("q", "tau") for k in range(arm.nv)]
        header = ",".join(["t", *names])
        np.savetxt("log.csv", table, "%.8g", ",", header=header, comments="")

    return write


def close_loop(capsys, *more):
    argv = ["identify", "log.csv", "--urdf", "arm.urdf", *more]
    code = main(argv)
    report = json.loads(Path("log-report/report.json").read_text(encoding="utf-8"))
    return code, lines_on_a_terminal(capsys.readouterr()), report


@pytest.mark.slow
def test_a_log_with_two_problems(arm, log, capsys):
    """The first is in the verdict with its remedy, both are in the last line."""
    tau = arm.tau.copy()
    limit = np.quantile(np.abs(tau[:, 1]), 0.9)
    tau[:, 1] = np.clip(tau[:, 1], -limit, limit)
    log(tau, np.delete(np.arange(len(tau)), np.r_[700:730, 1500:1530]))
    code, lines, report = close_loop(capsys, "--effects", "none")
    assert code == 3
    assert len(lines) <= 20
    text = " ".join(lines)
    assert "Fix the recording first. The torque of joint_2 is clipped at" in text
    assert "Record with a wider range, or a slower motion." in text
    last = text[text.index("warning: ") :]
    assert "The torque of joint_2 is clipped at" in last
    assert "2 gap(s) of 5 periods or more" in last
    assert len(last) <= 2 * WIDTH
    # Once whole, and once in brief.
    assert text.count("clipped") == 2
    assert text.count("gap(s)") == 1
    told = " ".join(report["provenance"]["warnings"])
    assert "the first after line 701: the recording is split there" in told
