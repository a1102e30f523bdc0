"""The command simulate: printed errors, files and one-line refusals."""

import csv
import functools
import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from sklearn_vbjfa import RobotIdentifier, load_identified
from sklearn_vbjfa._cli import _input
from sklearn_vbjfa.diagnosis import simulate_windows
from sklearn_vbjfa.effects import Spring
from sklearn_vbjfa.recording import ChannelFinding
from sklearn_vbjfa.simulation import SimulationError
from tests.command_line._running import refused, run


@pytest.fixture(scope="module")
def saved(urdf, recording, tmp_path_factory):
    """File of a robot identified from the whole recording."""
    path = tmp_path_factory.mktemp("saved") / "arm.json"
    robot = RobotIdentifier(str(urdf), dt=recording.dt, friction=("viscous", "coulomb"))
    robot.fit(recording.q, recording.tau).save(path)
    return path


refusal = functools.partial(refused, "simulate")


def printed(capsys, *argv, code=0):
    """Return stdout; check that stderr has only notes and warnings."""
    found, out, err = run(capsys, "simulate", *argv)
    assert found == code
    assert all(x.startswith(("note: ", "warning: ")) for x in err.splitlines())
    return out


def table(text):
    """Read the table of position errors: joint -> cells after the unit."""
    found = {}
    for line in text.splitlines():
        cells = re.split(r"\s{2,}", line.strip())
        if len(cells) > 3 and cells[1] in ("degrees", "mm"):
            found[cells[0]] = [float(x) for x in cells[2:]]
    return found


def rms_degrees(errors):
    return np.rad2deg(np.sqrt(np.mean(errors**2, axis=0)))


def test_a_saved_robot_is_simulated_over_all_rows(good, saved, recording, capsys):
    text = printed(capsys, good, "--model", saved, "--out", "here/there")
    lines = text.splitlines()
    assert lines[0].startswith("Recording 'arm': 3000 samples, 2 joints")
    assert max(map(len, lines)) <= 90
    # The same with the Python API.
    found = simulate_windows(load_identified(saved), recording.q, recording.tau)
    positions, names = table(text), ["shoulder", "elbow"]
    assert list(positions) == names
    for j, name in enumerate(names):
        robots = [found, *found.rivals.values()]
        expected = [rms_degrees(one.errors)[j] for one in robots]
        np.testing.assert_allclose(positions[name], expected, rtol=2e-2)
    assert f"All {found.n_windows} windows" in text
    assert found.verdict() in " ".join(lines)
    # Files.
    folder = good.parent / "here" / "there"
    assert [x.name for x in folder.iterdir()] == ["simulation.csv"]
    assert lines[-1] == "written: here/there/simulation.csv"
    with (folder / "simulation.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * found.n_windows
    about, *ends = rows[0]["unit"], rows[0]["from_s"], rows[0]["to_s"]
    assert (rows[0]["recording"], rows[0]["joint"], about) == (
        "arm",
        names[0],
        "degrees",
    )
    begin = found.starts[0] * recording.dt
    assert [*map(float, ends)] == pytest.approx([begin, begin + 1.0])
    for name, one in ("position_error", found), ("at_rest", found.rivals["at rest"]):
        expected = np.rad2deg(one.errors[0, 0])
        assert float(rows[0][name]) == pytest.approx(expected, rel=1e-3)


def test_direction_outside_the_fit_gives_a_note(good, saved, tmp_path, capsys):
    robot, path = load_identified(saved), tmp_path / "forward.json"
    forward = (replace(x, direction=(1.0, 1.0)) for x in robot.effect_ranges_)
    replace(robot, effect_ranges_=tuple(forward)).save(path)
    _, _, err = run(capsys, "simulate", good, "--model", path)
    assert "shoulder: backward motion, fitted on forward motion only" in err
    _, _, err = run(capsys, "simulate", good, "--model", saved, "--force")
    assert "motion only" not in err


def test_the_model_refutes_mixed_torques(good, urdf, recording, capsys, monkeypatch):
    wrong = ChannelFinding("mixed_torques", (0, 1), "warning", "cables")
    monkeypatch.setattr(_input, "findings", lambda *_: (wrong,))
    for effects, code in ([], 3), ([Spring(0)], 0):
        robot = RobotIdentifier(str(urdf), dt=recording.dt, effects=effects)
        robot.fit(recording.q, recording.tau).save("complete.json")
        found = run(capsys, "simulate", good, "--model", "complete.json", "--force")
        assert ("arm.csv: cables" in found[2]) is (code > 0)
        assert found[0] == code


def test_failed_windows_are_named(good, saved, capsys, monkeypatch):
    from sklearn_vbjfa import IdentifiedRobot

    right, calls = IdentifiedRobot.simulate, []

    def fail_third(self, *given, **named):
        calls.append(1)
        if len(calls) == 3:
            raise SimulationError("It diverges.")
        return right(self, *given, **named)

    monkeypatch.setattr(IdentifiedRobot, "simulate", fail_third)
    text = printed(capsys, good, "--model", saved, code=3)
    count = len(calls)
    line = f"1 of {count} windows failed, the first at arm, "
    line = re.search(line + r"(\S+) to (\S+) s: It diverges\.", " ".join(text.split()))
    begin, end = map(float, line.groups())
    assert end - begin == pytest.approx(1.0)
    assert f"{count - 1} of {count} windows, each" in text
    with open("arm-simulation/simulation.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    failed = [row for row in rows if row["failed"]]
    assert len(failed) == 2
    assert {row["position_error"] for row in failed} == {""}
    assert all(row["at_rest"] for row in failed)


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        ("arm.csv", "give --model FILE"),
        ("arm.csv --urdf U", "unrecognized arguments: --urdf"),
        ("arm.csv --model none.json", "none.json"),
        ("arm.csv --model arm.csv", "expected a saved robot (identified.json)"),
        # A folder refers to the robot in it.
        ("arm.csv --model .", "identified.json"),
        ("none.csv --model M", "none.csv: no such file"),
        ("--model M", "required: LOG"),
        ("arm.csv --model M --window 0", "window must be a time in seconds"),
        ("arm.csv --model M --window 60", "No recording is as long as a window of 60"),
        ("arm.csv --model M --window 0.001", "at least the sample period 0.005 s"),
        ("arm.csv --model M --out arm.csv", "arm.csv is not a folder"),
        ("arm.csv --model M --joints elbow", "2 column(s) q for 1 joint(s)"),
    ],
)
def test_invalid_arguments_are_refused(argv, message, good, urdf, saved, capsys):
    paths = {"U": urdf, "M": saved}
    line = refusal(capsys, *(paths.get(x, x) for x in argv.split()))
    assert message in line
    assert [path.name for path in good.parent.iterdir()] == ["arm.csv"]


def test_a_recording_of_another_rate(good, saved, recording, tmp_path, capsys):
    source = tmp_path / "slow.npz"
    np.savez(source, q=recording.q[::2], tau=recording.tau[::2], dt=0.01)
    found = [table(printed(capsys, x, "--model", saved)) for x in (good, source)]
    for name, (error, *_) in found[0].items():
        assert found[1][name][0] == pytest.approx(error, rel=0.1)


def test_a_log_is_read_as_that_of_the_report(good, saved, tmp_path, capsys):
    first = table(printed(capsys, good, "--model", saved))
    options = {"columns": "q=pos_{i},tau=amps_{i},t=t", "gain": "-2,4"}
    report = {"provenance": {"options": options | {"effects": "none"}}}
    (tmp_path / "identified.json").write_text(saved.read_text())
    (tmp_path / "report.json").write_text(json.dumps(report))
    names = ["t", "pos_1", "pos_2", "amps_1", "amps_2"]
    log = pd.read_csv(good).set_axis(names, axis=1) / [1, 1, 1, -2, 4]
    log.to_csv("raw.csv", index=False)
    text = printed(capsys, "raw.csv", "--model", tmp_path)
    assert table(text) == first
    assert f': --columns "{options["columns"]}" --gain "-2,4"\n' in text
    assert "options of the report" in refusal(capsys, good, "--model", tmp_path)
    words = "--columns", "q=q{i},tau=tau{i},t=t", "--gain", "1,1"
    assert table(printed(capsys, good, "--model", tmp_path, *words, "--force")) == first


def test_no_file_is_partially_written(good, saved, capsys, monkeypatch):
    folder = good.parent / "arm-simulation"
    folder.mkdir()
    (folder / "simulation.csv").write_text("old")

    def full(*given):
        raise OSError("No space left on device")

    monkeypatch.setattr("sklearn_vbjfa._cli._simulate.errors_table", full)
    code, out, err = run(capsys, "simulate", good, "--model", saved)
    # The errors are printed even if the file cannot be written.
    assert (code, "position error over windows" in out) == (2, True)
    assert err.splitlines()[-1] == "sklearn-vbjfa: No space left on device"
    assert [path.name for path in folder.iterdir()] == ["simulation.csv"]
    assert (folder / "simulation.csv").read_text() == "old"
