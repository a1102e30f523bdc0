"""The comparison with FIGAROH: what it counts, how it judges and what it refuses."""

import json
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import bench_figaroh as bench

HERE = Path(__file__).resolve().parent


def test_script_starts_on_its_own():
    answer = subprocess.run(
        [sys.executable, str(HERE / "bench_figaroh.py"), "--help"],
        capture_output=True,
        text=True,
        check=True,
        cwd=HERE.parent,
    )
    assert "--figaroh-python" in answer.stdout


def test_lines_are_counted_without_blanks_comments_and_docstrings():
    text = textwrap.dedent(
        '''
        """Docstring
        of two lines."""

        import os  # a comment beside code counts as code

        # A comment.
        def f(
            x,
        ):
            """Docstring."""
            return """text
            that is code"""
        '''
    )
    assert bench.count_lines(text, ".py") == 1 + 3 + 2
    assert bench.count_lines("a: 1\n\n  # no\n  b: 2  # yes\n", ".yaml") == 2
    assert bench.count_lines('{\n  "a": 1\n}\n', ".json") == 3


def test_every_row_has_its_files():
    for name in bench.SETS:
        for row in bench.contestants(name, 10.0, 0.01):
            lines = bench.user_lines(row, name)
            assert len(lines) == len(row.files) + 1
            assert min(lines) > 1


def test_the_stage_to_replace_stands_in_the_settings_once():
    for name in bench.SETS:
        text = (bench.SCRIPTS / f"figaroh_{name}.yaml").read_text(encoding="utf-8")
        assert text.count(bench._STAGE) == 1


@pytest.fixture
def part():
    """Two joints, two recordings; the second joint stands still half of the time."""
    dt, n = 0.002, 10_000
    t = dt * np.arange(n)
    q = np.column_stack([np.sin(3 * t), np.where(t < 10, 0.0, np.sin(3 * (t - 10)))])
    tau = np.column_stack([5 * np.sin(2 * np.pi * t), 2 * np.cos(2 * np.pi * t)])
    return {"q": q, "tau": tau, "groups": np.repeat([0, 1], n // 2), "dt": dt}


def test_error_is_the_share_of_the_deviation_that_is_missed(part):
    error, counts = bench.held_out_error(0.9 * part["tau"], part, part, 10.0, 0.0)
    # The torques have mean zero but for the samples that are left out.
    np.testing.assert_allclose(error, 0.1, rtol=0.01)
    margin = round(2 / 10.0 / part["dt"])
    # The first joint never rests; the second does until 10 s.
    assert counts[0] == len(part["q"]) - 4 * margin
    assert counts[1] < 0.55 * len(part["q"])


def test_error_counts_only_what_passes_the_filter(part):
    t = part["dt"] * np.arange(len(part["q"]))
    fast = np.sin(2 * np.pi * 100 * t)[:, None]
    error, _ = bench.held_out_error(part["tau"] + fast, part, part, 10.0, 0.05)
    assert error.max() < 1e-3


def test_error_leaves_out_standstill_and_ends(part):
    wrong = part["tau"].copy()
    wrong[1000:4000, 1] += 7.0
    wrong[:20] += 1.0
    error, _ = bench.held_out_error(wrong, part, part, 10.0, "auto")
    assert error.max() < 1e-3


def test_missing_interpreter_is_one_line():
    with pytest.raises(SystemExit, match="No interpreter at nowhere") as refusal:
        bench.main(["--figaroh-python", "nowhere"])
    assert "\n" not in str(refusal.value)


def test_interpreter_without_figaroh_is_one_line(tmp_path):
    # Without site-packages no distribution is found.
    shell = tmp_path / "python"
    shell.write_text(f'#!/bin/sh\nexec "{sys.executable}" -S -E "$@"\n')
    shell.chmod(0o755)
    with pytest.raises(SystemExit, match="has no FIGAROH") as refusal:
        bench.main(["--figaroh-python", str(shell)])
    assert "\n" not in str(refusal.value)


def test_missing_recording_is_one_line(monkeypatch):
    def absent(name, data_home):
        raise OSError("no network")

    monkeypatch.setattr(bench, "figaroh_versions", lambda python: "")
    monkeypatch.setattr(bench, "load", absent)
    with pytest.raises(SystemExit, match="recording ur5 is absent: no network"):
        bench.main(["--figaroh-python", "python"])


def test_own_script_runs_in_its_own_process(tmp_path):
    from sklearn_vbjfa.datasets import load_demo_recording

    recording = load_demo_recording()
    parts = [
        {
            "q": recording.q[rows],
            "tau": recording.tau[rows],
            "groups": np.zeros(1500, dtype=int),
            "dt": recording.dt,
        }
        for rows in (slice(0, 1500), slice(4000, 5500))
    ]
    settings = tmp_path / "settings.json"
    settings.write_text(json.dumps({"friction": ["viscous", "coulomb"]}))
    row = bench.Contestant(label="ours", files=("vbjfa_user.py",))
    outcome = bench.run_script(row, sys.executable, recording.urdf, parts, settings)
    error, counts = bench.held_out_error(
        outcome.predicted, parts[1], parts[0], 10.0, 0.05
    )
    # 5 % of torque noise behind the filter, but for the load friction of joint 2.
    assert np.delete(error, 1).max() < 0.1
    assert counts.min() > 0
    assert "times the noise floor" in bench.quotation(outcome.said)
    assert 0 < outcome.seconds < outcome.seconds_with_import


def test_failed_script_says_why(tmp_path):
    settings = tmp_path / "settings.json"
    settings.write_text("{}")
    (tmp_path / "robot.urdf").write_text("<robot name='r'></robot>")
    row = bench.Contestant(label="ours", files=("vbjfa_user.py",))
    part = {"q": np.zeros((5, 1)), "tau": np.zeros((5, 1)), "groups": [0], "dt": 0.1}
    with pytest.raises(RuntimeError, match="ours ended with an error: "):
        bench.run_script(
            row, sys.executable, str(tmp_path / "robot.urdf"), (part, part), settings
        )


def test_quotation_keeps_the_validation_and_the_insights():
    said = textwrap.dedent(
        """
        ======
          IDENTIFICATION QUALITY REPORT
        ======
          Reported estimate: physical_fit
          Base parameters: 58
        ------
          Validation (separate set, n=3)
            joint_1    RMSE 1
        ======
        * Only an insight.
        """
    )
    block = bench.quotation(said).splitlines()
    assert block[:2] == [".. code-block:: text", ""]
    assert [line.strip() for line in block[2:]] == [
        "Reported estimate: physical_fit",
        "Validation (separate set, n=3)",
        "joint_1    RMSE 1",
        "* Only an insight.",
    ]
